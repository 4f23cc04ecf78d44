"""A claim of docs/engines.md beside what was measured."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Claim:
    """One row of the table: what was measured, what is asked of it, what came out, and whether that is enough."""

    what: str
    asked: str
    measured: str
    kept: bool
