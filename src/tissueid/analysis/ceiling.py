"""Highest VAF that a model could reach, from repeats of a test in the same session."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tissueid.analysis.split import FIT_SHARE, Split
from tissueid.errors import UnusableInputError
from tissueid.identification.validation.repeats import Ceiling, ceiling
from tissueid.messages import Listing, Message
from tissueid.records import Record
from tissueid.sessions import Session, Test

_USABLE = 0.8
"""Smallest share of the test's samples that a repeat must hold to be used."""


def repeats(session: Session, number: int) -> tuple[Test, ...]:
    """Return a test and the tests of the session that repeat it, or that it repeats; itself first.

    Raises:
        UnusableInputError: there is no such test.
    """
    test = session.test(number)
    first = number if test.repeat_of is None else test.repeat_of
    others = [t for t in session.tests if first in (t.number, t.repeat_of) and t.number != number]
    return (test, *others)


def known_ceiling(session: Session, parts: Split) -> Ceiling | None:
    """Return the highest held-out VAF that a model could reach, from repeats of the held-out test or part.

    None without repeats, and where the fitted tests do not all repeat one another. Repeats that ended early or lost too
    many samples are listed in ``left_out``.

    Raises:
        UnusableInputError: the repeats are not alike, or hold too few samples, or none can be used.
    """
    number = parts.tests[0] if parts.validated is None else parts.validated
    same = repeats(session, number)
    if len(same) < 2 or (parts.validated is None and not {t.number for t in same}.issuperset(parts.tests)):
        return None
    names = parts.record.input_name, parts.record.output_name
    first = same[0].record(*names)
    part = slice(0, len(first)) if parts.validated is not None else slice(round(FIT_SHARE * len(first)), len(first))
    wanted = _received(first, part)
    records = [first]
    left_out: list[Message] = []
    for test in same[1:]:
        if wanted and (reason := _too_little(test, names, part, wanted)):
            left_out.append(
                Message("ceiling.left_out", "test {number} was left out: {reason}", number=test.number, reason=reason)
            )
        else:
            records.append(test.record(*names))
    if len(records) < 2:
        raise UnusableInputError(
            "ceiling.no_repeat", "no other repeat can be used: {left_out}", left_out=Listing(tuple(left_out))
        )
    return replace(ceiling(records, None if parts.validated is not None else part), left_out=tuple(left_out))


def _received(record: Record, part: slice) -> int:
    return int(np.sum(np.isfinite(record.input[part]) & np.isfinite(record.output[part])))


def _too_little(test: Test, names: tuple[str, str], part: slice, wanted: int) -> str:
    """Return why a repeat cannot be used, where ``wanted`` samples are compared; empty where it can."""
    aborted = test.status == "aborted"
    if test.samples <= round(test.preload_s * test.sample_rate_hz):
        if aborted:
            return Message("ceiling.ended_in_preload", "it ended early, within its preload")
        return Message("ceiling.only_preload", "it holds nothing but its preload")
    share = _received(test.record(*names), part) / wanted
    if share >= _USABLE:
        return ""
    if aborted:
        return Message(
            "ceiling.ended_early",
            "it ended early, and holds {percent:.0f} % of the compared samples",
            percent=100.0 * share,
        )
    return Message(
        "ceiling.incomplete",
        "it is short or has gaps, and holds {percent:.0f} % of the compared samples",
        percent=100.0 * share,
    )
