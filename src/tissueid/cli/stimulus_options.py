"""Kinds and options of ``tissueid stimulus``: tables and JSON."""

from __future__ import annotations

import re
import types
from collections.abc import Iterator
from typing import Any, Literal, Union, get_args, get_origin

from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined
from rich.table import Table

from tissueid.cli.output import table
from tissueid.stimuli import FeedbackKind, StimulusKind, get_stimulus, stimulus_names

_BOUNDS = (("ge", "{} or more"), ("gt", "over {}"), ("le", "up to {}"), ("lt", "under {}"))
_SOURCE = re.compile(r"\s*\([^()]*\d{4}[^()]*\)")
_WORDS = {float: "number", int: "whole number", bool: "true or false", str: "text", tuple: "list"}


def kinds_answer() -> list[dict[str, Any]]:
    """Return all kinds for JSON: name, description, whether they are feedback stimuli, options."""
    return [
        {
            "kind": name,
            "what": summary(get_stimulus(name)),
            "generated_while_the_test_runs": issubclass(get_stimulus(name), FeedbackKind),
            "options": list(get_stimulus(name).model_fields),
        }
        for name in stimulus_names()
    ]


def kinds_table() -> Table:
    """Return the table of all kinds."""
    rows = table("Kinds of stimulus", "kind", "generated", "description")
    for column in rows.columns[1:]:
        column.justify = "left"
    for name in stimulus_names():
        kind = get_stimulus(name)
        when = "during the test" if issubclass(kind, FeedbackKind) else "before the test"
        rows.add_row(name, when, summary(kind))
    return rows


def options_table(kind: type[StimulusKind]) -> Table:
    """Return the table of the options of a kind with bounds and defaults."""
    rows = table(f"Options of the stimulus {kind.name}", "option", "default", "values", "description")
    for column in rows.columns[1:]:
        column.justify = "left"
    for name, field in kind.model_fields.items():
        rows.add_row(name, default_of(field), allowed(field), field.description or "")
    return rows


def options_answer(kind: type[StimulusKind]) -> dict[str, Any]:
    """Return the options of a kind as a JSON schema."""
    return kind.model_json_schema()


def summary(kind: type[StimulusKind]) -> str:
    """Return the first line of the description of a kind, without sources."""
    lines = (kind.__doc__ or "").strip().splitlines()
    return _SOURCE.sub("", lines[0]).rstrip(".") if lines else ""


def default_of(field: FieldInfo) -> str:
    """Return the default of an option as text."""
    if field.default is PydanticUndefined:
        return "required"
    if field.default is None or field.default == ():
        return "none"
    return f"{field.default:g}" if isinstance(field.default, float) else str(field.default).lower()


def allowed(field: FieldInfo) -> str:
    """Return the choices of an option, or its type with bounds, as text."""
    choices, kinds = _choices(field.annotation)
    if choices:
        return ", ".join(choices)
    bounds = [words.format(_short(value)) for words, value in _bounds(field)]
    return ", ".join([" or ".join(kinds), *bounds])


def _bounds(field: FieldInfo) -> Iterator[tuple[str, float]]:
    for item in field.metadata:
        for name, words in _BOUNDS:
            value = getattr(item, name, None)
            if isinstance(value, int | float):
                yield words, value


def _short(value: float) -> str:
    if isinstance(value, int) and value == 2**63 - 1:
        return "2⁶³ − 1"
    return f"{value:g}"


def _choices(annotation: Any) -> tuple[list[str], list[str]]:
    """Return the choices of a literal type, and the names of other types."""
    origin = get_origin(annotation)
    if origin is Literal:
        return [str(choice) for choice in get_args(annotation)], []
    if origin in (Union, types.UnionType):
        parts = [_choices(part) for part in get_args(annotation) if part is not type(None)]
        return [choice for choices, _ in parts for choice in choices], [kind for _, kinds in parts for kind in kinds]
    plain = origin if isinstance(origin, type) else annotation
    return [], [_WORDS.get(plain, "value")]
