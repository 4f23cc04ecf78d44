"""What repeats in the same session say of how much there is to be explained."""

from __future__ import annotations

from tissueid.analysis.split import FIT_SHARE, Split
from tissueid.identification.validation.repeats import Ceiling, ceiling
from tissueid.sessions import Session, Test


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

    None without repeats, and where the fitted tests do not all repeat one another.

    Raises:
        UnusableInputError: the repeats are not alike, or hold too few samples.
    """
    number = parts.tests[0] if parts.validated is None else parts.validated
    same = repeats(session, number)
    if len(same) < 2 or (parts.validated is None and not {t.number for t in same}.issuperset(parts.tests)):
        return None
    names = parts.record.input_name, parts.record.output_name
    records = [test.record(*names) for test in same]
    part = None if parts.validated is not None else slice(round(FIT_SHARE * len(records[0])), len(records[0]))
    return ceiling(records, part)
