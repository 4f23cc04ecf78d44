"""What repeats in the same session say of how much there is to be explained."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tissueid.analysis.split import FIT_SHARE, Split
from tissueid.errors import UnusableInputError
from tissueid.identification.validation.repeats import Ceiling, ceiling
from tissueid.records import Record
from tissueid.sessions import Session, Test

_USABLE = 0.8
"""A repeat that holds less than this of the samples which the test itself holds is left out."""


def repeats(session: Session, number: int) -> tuple[Test, ...]:
    """A test and the others of the session that repeat it, or that it repeats; itself first.

    Raises:
        UnusableInputError: there is no such test.
    """
    test = session.test(number)
    first = number if test.repeat_of is None else test.repeat_of
    others = [t for t in session.tests if first in (t.number, t.repeat_of) and t.number != number]
    return (test, *others)


def known_ceiling(session: Session, parts: Split) -> Ceiling | None:
    """The highest held-out VAF that a model could reach, from repeats of the test that is held out or a part of it.

    None without repeats, and where the fitted tests do not all repeat one another. Repeats that broke off or have lost
    too much are left out, and ``left_out`` says so.

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
    records, left_out = [first], []
    for test in same[1:]:
        if wanted and (reason := _too_little(test, names, part, wanted)):
            left_out.append(f"test {test.number} was left out: {reason}")
        else:
            records.append(test.record(*names))
    if len(records) < 2:
        raise UnusableInputError(f"no other repeat can be used: {', '.join(left_out)}")
    return replace(ceiling(records, None if parts.validated is not None else part), left_out=tuple(left_out))


def _received(record: Record, part: slice) -> int:
    return int(np.sum(np.isfinite(record.input[part]) & np.isfinite(record.output[part])))


def _too_little(test: Test, names: tuple[str, str], part: slice, wanted: int) -> str:
    """Why a repeat cannot stand beside a test that holds ``wanted`` samples there; empty where it can."""
    ended = "was broken off" if test.status == "aborted" else "is short or has gaps"
    if test.samples <= round(test.preload_s * test.sample_rate_hz):
        return f"it {ended}, within its preload"
    share = _received(test.record(*names), part) / wanted
    return "" if share >= _USABLE else f"it {ended}, and holds {100.0 * share:.0f} % of what is compared"
