"""Comparison of the sessions that the command line and the window made."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any

import numpy as np

from tissueid.sessions import Session


def assert_same_session(one: Session, other: Session, except_for: tuple[str, ...] = ()) -> None:
    """Check that two sessions hold the same, apart from some attributes of the session and notes of its tests."""
    for field in fields(Session):
        if field.name not in (*except_for, "tests"):
            assert _same(getattr(one, field.name), getattr(other, field.name)), field.name
    assert len(one.tests) == len(other.tests)
    for a, b in zip(one.tests, other.tests, strict=True):
        for field in fields(a):
            first, second = getattr(a, field.name), getattr(b, field.name)
            if field.name == "notes":
                first, second = ({k: v for k, v in notes.items() if k not in except_for} for notes in (first, second))
            assert _same(first, second), f"test {a.number}: {field.name}"


def _same(one: Any, other: Any) -> bool:
    """Return whether two values are equal, NaN included."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_same(value, other[name]) for name, value in one.items())
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other, equal_nan=True)
    if isinstance(one, float) and isinstance(other, float) and math.isnan(one):
        return math.isnan(other)
    if hasattr(one, "__dataclass_fields__"):
        return type(one) is type(other) and all(
            _same(getattr(one, f), getattr(other, f)) for f in one.__dataclass_fields__
        )
    return bool(one == other)
