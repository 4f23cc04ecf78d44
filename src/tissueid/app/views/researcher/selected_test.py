"""A selected test of a session file, and labels of tests: the parts that differ, and the common part once."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, ConfigDict, Field, PlainSerializer

from tissueid.formatting import clean, subject_text
from tissueid.language import _, marked

LONGEST_TEXT = 300
"""Maximum length of a stored text of a task, in characters."""
_LONGEST_PATH = 4096

ShortText = Annotated[str, Field(max_length=LONGEST_TEXT), PlainSerializer(lambda text: text[:LONGEST_TEXT])]


def _short_path(path: object) -> object:
    if not 0 < len(str(path)) <= _LONGEST_PATH:
        raise ValueError(f"a path has 1 to {_LONGEST_PATH} characters")
    return path


@dataclass(frozen=True)
class SelectedTest:
    """A selected test: file, number and label.

    ``site`` and ``pseudonym`` are as the file has them; ``label`` is cleaned and short. ``when`` is the time of the
    session in seconds since 1970, None where it is not known.
    """

    __pydantic_config__ = ConfigDict(extra="forbid", allow_inf_nan=False)

    path: Annotated[Path, BeforeValidator(_short_path)]
    number: Annotated[int, Field(ge=0, le=1_000_000)]
    site: ShortText = ""
    pseudonym: ShortText = ""
    label: ShortText = ""
    when: float | None = None


def timestamp_of(created: str) -> float | None:
    """Return an ISO date as seconds since 1970, in UTC if it has no zone; None if it is no date."""
    try:
        when = datetime.fromisoformat(created)
        seconds = (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()
    except (ValueError, OverflowError, OSError):
        return None
    return seconds if math.isfinite(seconds) else None


_LONGEST = 60
_LONGEST_SIGNAL = 40
SIGNALS = (
    marked("Acceleration x"),
    marked("Acceleration y"),
    marked("Acceleration z"),
    marked("Input"),
    marked("Output"),
)
"""Titles of signals; the others are marked where the window measures them."""


def local_time(when: float | None) -> str:
    """Return local date and time of day to the second; "" if the time is unknown."""
    if when is None:
        return ""
    try:
        return datetime.fromtimestamp(when).strftime("%Y-%m-%d %H:%M:%S")
    except (ValueError, OverflowError, OSError):
        return ""


def signal_title(name: str) -> str:
    """Return the name of a signal in the language of the window, with a capital, e.g. "Acceleration x"."""
    plain = clean(name).replace("_", " ")[:_LONGEST_SIGNAL]
    return _(plain[:1].upper() + plain[1:])


def short_label(test: SelectedTest) -> str:
    """Return date, time and number of a test; its label if the date is unknown."""
    date = local_time(test.when)
    return f"{date} #{test.number}" if date else clean(test.label)


def distinguishing_labels(groups: Sequence[Sequence[SelectedTest]]) -> tuple[str, list[str]]:
    """Return the common part of the labels of groups of tests, and the distinguishing part of each.

    The parts of a name are subject, site, date and time, and number of the test; file and folder are added where these
    are not enough. Groups of the same tests have the same label. With one distinct group nothing is in common, and the
    label is the whole name.
    """
    names = [_parts(group) for group in groups]
    distinct = list(dict.fromkeys(names))
    if len(distinct) < 2:
        return "", [_joined(name[:-2]) or name[-2] for name in names]
    usual = range(len(distinct[0]) - 2)
    differing = [index for index in usual if len({name[index] for name in distinct}) > 1]
    for more in range(len(usual), len(distinct[0])):
        if max(Counter(_of(name, differing) for name in distinct).values()) < 2:
            break
        differing.append(more)
    common = _joined(distinct[0][index] for index in usual if index not in differing)
    return common, [_joined(_of(name, differing)) for name in names]


def _of(name: tuple[str, ...], places: Sequence[int]) -> tuple[str, ...]:
    return tuple(name[index] for index in places)


def _parts(group: Sequence[SelectedTest]) -> tuple[str, ...]:
    """Return subject, site, date, number, file and folder of a group of tests."""
    first = group[0]
    numbers = " ".join(f"#{test.number}" for test in group[:4]) + (" …" if len(group) > 4 else "")
    files = dict.fromkeys(test.path for test in group)
    more = _(" and {count} more").format(count=len(files) - 1) if len(files) > 1 else ""
    date = local_time(first.when)
    parts = subject_text(first.pseudonym), clean(first.site), date, numbers, clean(first.path.stem) + more
    return *(part[:_LONGEST] for part in parts), clean(str(first.path.parent))


def _joined(parts: Iterable[str]) -> str:
    return ", ".join(part for part in parts if part)
