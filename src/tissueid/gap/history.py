"""The gap of several sessions against one twin, in order of time, and the first session in which it grew."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from tissueid.gap.statement import Level, effect_title
from tissueid.language import marked
from tissueid.messages import Listing, Message, Verbatim


@dataclass(frozen=True)
class GapHistoryEntry:
    """One session: its file, its time of recording (ISO 8601; "" where unknown) and its diagnosis.

    ``answer`` is the JSON of ``gap diagnose`` against the twin; None where the session cannot be used, for the
    ``reason``.
    """

    file: str
    created: str
    answer: dict[str, Any] | None
    reason: str = ""

    @property
    def grew(self) -> bool:
        """Whether there is a gap against the twin: more than noise and what the twin is known to leave."""
        return self.answer is not None and self.answer["verdict"] != "no_gap"

    @property
    def combination(self) -> tuple[str, ...]:
        """Named new effects."""
        return () if self.answer is None else tuple(self.answer["combination"])

    @property
    def time(self) -> datetime | None:
        """Time of recording, UTC; None where it is unknown."""
        try:
            found = datetime.fromisoformat(self.created)
        except ValueError:
            return None
        return found.astimezone(UTC) if found.tzinfo is not None else found.replace(tzinfo=UTC)

    def gap(self, name: str) -> float:
        """Return a figure of the gap, such as ``before``; NaN where there is none."""
        value = None if self.answer is None else self.answer["gap"][name]
        return float("nan") if value is None else float(value)

    def as_answer(self) -> dict[str, Any]:
        """Return plain values for JSON, SI."""
        if self.answer is None:
            reason = self.reason.as_dict() if isinstance(self.reason, Message) else None
            return {"file": self.file, "created": self.created, "verdict": None, "gap": None, "combination": []} | {
                "error": str(self.reason),
                "message": reason,
            }
        return {"file": self.file, "created": self.created, "grew": self.grew} | self.answer


@dataclass(frozen=True)
class GapHistory:
    """Sessions in order of time; those without a time come last, by name."""

    entries: tuple[GapHistoryEntry, ...]

    @classmethod
    def of(cls, entries: Sequence[GapHistoryEntry]) -> GapHistory:
        """Return the history of sessions in any order."""
        last = datetime.max.replace(tzinfo=UTC)
        return cls(tuple(sorted(entries, key=lambda entry: (entry.time or last, entry.file))))

    @property
    def first_grown(self) -> GapHistoryEntry | None:
        """The first session in which the gap grew; None where it grew in none."""
        return next((entry for entry in self.entries if entry.grew), None)

    def as_answer(self) -> dict[str, Any]:
        """Return the JSON of ``tissueid gap watch``."""
        first = self.first_grown
        return {
            "sessions": [entry.as_answer() for entry in self.entries],
            "first_grown": None if first is None else first.file,
            "grown_effects": [] if first is None else list(first.combination),
        }


def history_headline(history: GapHistory) -> tuple[Message, Level]:
    """Return the first session in which the gap grew, and what grew, in one line, with its level."""
    first = history.first_grown
    if first is None:
        count = sum(entry.answer is not None for entry in history.entries)
        return Message("watch.not_grown", "The gap grew in none of {count} sessions", count=count), "good"
    causes: tuple[str, ...] = tuple(effect_title(name) for name in first.combination) or (marked("cause unexplained"),)
    cause = Listing(causes, marked(" and "))
    return Message(
        "watch.grown", "The gap grew first in {file}: {cause}", file=Verbatim(first.file), cause=cause
    ), "check"
