"""The diagnosis as plain values for JSON, under the contract's names, SI."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from tissueid.atomic_write import atomic_file, private_folder
from tissueid.errors import UnusableInputError
from tissueid.gap.diagnosis import Diagnosis
from tissueid.gap.statement import Level, alternatives_of, effect_title, headline_of, members_of, ordered_candidates
from tissueid.language import marked
from tissueid.messages import Listing, Message, Verbatim, stored


def as_answer(found: Diagnosis) -> dict[str, Any]:
    """Return the JSON of ``tissueid gap diagnose``."""
    figures = found.gap
    return {
        "verdict": found.verdict,
        "gap": {
            "before": figures.before,
            "after": figures.after,
            "floor": figures.floor,
            "closed": figures.closed,
            "closed_ci": list(figures.closed_ci),
            "announced": figures.predicted_closed,
        },
        "where": found.where.as_answer(),
        "ranking": [
            {
                "effect": item.effect,
                "stage": item.stage,
                "probability": item.probability,
                "closed": item.closed,
                "closed_ci": list(item.closed_ci),
                "indistinguishable": list(item.indistinguishable),
                "parameters": item.parameters,
            }
            for item in (ordered_candidates(found) if found.combination else found.ranking)
        ],
        "combination": list(found.combination),
        "budget": _budget(found),
        "remains": None if found.budget is None else {"share": found.budget.remains, "stage": found.budget.remains_in},
        "detection_limits": {
            name: None if limit is None else dict(vars(limit)) for name, limit in found.detection_limits.items()
        },
        "members": [
            {
                "effect": item.effect,
                "probability": item.probability,
                "rivals": [{"effect": name, "probability": share} for name, share in item.rivals],
            }
            for item in members_of(found)
        ],
        "next_experiment": None
        if found.next_experiment is None
        else {
            "kind": found.next_experiment.kind,
            "why": str(found.next_experiment.why),
            "message": stored(found.next_experiment.why),
            "separates": list(found.next_experiment.separates),
            "gain_nats": found.next_experiment.gain_nats,
            "separation": found.next_experiment.separation,
            "gains": found.next_experiment.gains,
            "command_line": found.next_experiment.command_line,
        },
        "ceiling": found.ceiling,
        "remarks": [str(remark) for remark in found.remarks],
        "remark_messages": list(map(stored, found.remarks)),
        "statement": stored(headline_of(found)[0]),
        "seconds": found.seconds,
    }


def _budget(found: Diagnosis) -> list[dict[str, Any]]:
    # In the order of adding; empty where nothing is named.
    alternatives = alternatives_of(found)
    return [
        {
            "effect": step.effect,
            "stage": step.stage,
            "closed_when_added": step.added,
            "closed_when_added_ci": list(step.added_ci),
            "closed_when_removed": step.removed,
            "closed_when_removed_ci": list(step.removed_ci),
            "gap_after": step.gap_after,
            "alternatives": list(alternatives[step.effect]),
        }
        for step in (() if found.budget is None else found.budget.steps)
    ]


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


FOLDER = "answers"
_MOST_BYTES = 20_000_000
_KEYS = {"verdict", "gap", "where", "ranking", "combination"}


def store_answer(folder: Path, key: str, answer: dict[str, Any]) -> None:
    """Store an answer; raise UnusableInputError where it cannot be written."""
    path = answer_path(folder, key)
    try:
        private_folder(path.parent)
        with atomic_file(path) as partial:
            # NaN is kept, so that stored answers score exactly as fresh ones.
            body = json.dumps(answer, default=lambda item: item.item())
            partial.write_text(f'{{"sha256": "{_digest(body)}", "content": {body}}}', encoding="utf-8")
    except OSError as error:
        reason = error.strerror or ""
        raise UnusableInputError(
            "blind.unwritable", "cannot write {path}: {reason}", path=str(path), reason=reason
        ) from error


def stored_answer(folder: Path, key: str) -> dict[str, Any] | None:
    """Return a stored answer or None; raise UnusableInputError where the file holds something else."""
    found = stored_content(folder, key)
    if found is not None and not found.keys() >= _KEYS:
        raise _unreadable(answer_path(folder, key))
    return found


def answer_path(folder: Path, key: str) -> Path:
    """Return the file of an answer."""
    return folder / FOLDER / f"{key}.json"


def stored_content(folder: Path, key: str) -> dict[str, Any] | None:
    """Return what ``store_answer`` stored or None; raise UnusableInputError where the file holds something else."""
    path = answer_path(folder, key)
    if not path.exists():
        return None
    try:
        usable = path.is_file() and path.stat().st_size <= _MOST_BYTES
        found = json.loads(path.read_text(encoding="utf-8")) if usable else None
        content, digest = (found.get("content"), found.get("sha256")) if isinstance(found, dict) else (None, None)
        if isinstance(content, dict) and digest == _digest(json.dumps(content)):
            return content
    except (OSError, ValueError, RecursionError) as error:
        raise _unreadable(path) from error
    raise _unreadable(path)


def _digest(body: str) -> str:
    return hashlib.sha256(body.encode()).hexdigest()


def _unreadable(path: Path) -> UnusableInputError:
    return UnusableInputError(
        "blind.unreadable_answer", "{path} holds no answer: delete it to diagnose again", path=str(path)
    )
