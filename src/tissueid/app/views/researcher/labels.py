"""Names of tests that tell them apart: what differs among the shown ones, and what they have in common once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from datetime import datetime

from tissueid.app.views.researcher.chosen import Chosen
from tissueid.language import _
from tissueid.wording import clean

_LONGEST = 60


def moment(when: float | None) -> str:
    """Return local date and time of day to the second, or an empty text where the time is not known."""
    if when is None:
        return ""
    try:
        return datetime.fromtimestamp(when).strftime("%Y-%m-%d %H:%M:%S")
    except (ValueError, OverflowError, OSError):
        return ""


def short_label(test: Chosen) -> str:
    """Return date, time and number of a test; the label of the list where the date is not known."""
    date = moment(test.when)
    return f"{date} #{test.number}" if date else clean(test.label)


def labels_apart(groups: Sequence[Sequence[Chosen]]) -> tuple[str, list[str]]:
    """Return what all groups of tests have in common, and for each group what tells it from the others.

    The parts of a name are subject, site, date and time, and number of the test; file and folder are added where these
    are not enough. Groups of the same tests have the same label. With one distinct group nothing is in common, and the
    label is the whole name.
    """
    names = [_parts(group) for group in groups]
    distinct = list(dict.fromkeys(names))
    if len(distinct) < 2:
        return "", [_joined(name[:-2]) or name[-2] for name in names]
    usual = range(len(distinct[0]) - 2)
    differing = [place for place in usual if len({name[place] for name in distinct}) > 1]
    for more in range(len(usual), len(distinct[0])):
        if max(Counter(_of(name, differing) for name in distinct).values()) < 2:
            break
        differing.append(more)
    common = _joined(distinct[0][place] for place in usual if place not in differing)
    return common, [_joined(_of(name, differing)) for name in names]


def _of(name: tuple[str, ...], places: Sequence[int]) -> tuple[str, ...]:
    return tuple(name[place] for place in places)


def _parts(group: Sequence[Chosen]) -> tuple[str, ...]:
    """Subject, site, date, number, file and folder of a group of tests."""
    first = group[0]
    numbers = " ".join(f"#{test.number}" for test in group[:4]) + (" …" if len(group) > 4 else "")
    files = dict.fromkeys(test.path for test in group)
    more = _(" and {count} more").format(count=len(files) - 1) if len(files) > 1 else ""
    date = moment(first.when)
    parts = clean(first.pseudonym), clean(first.site), date, numbers, clean(first.path.stem) + more
    return *(part[:_LONGEST] for part in parts), clean(str(first.path.parent))


def _joined(parts: Iterable[str]) -> str:
    return ", ".join(part for part in parts if part)


__all__ = ["labels_apart", "moment", "short_label"]
