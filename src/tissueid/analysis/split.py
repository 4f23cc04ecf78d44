"""What is fitted and what is held out of the tests of a session."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tissueid.configuration import spring_of
from tissueid.errors import UnusableInputError
from tissueid.records import Record, joined
from tissueid.sessions import Session, Test

QUARTERS = 4
FIT_SHARE = 1.0 - 1.0 / QUARTERS
"""Without another test to validate on, this much of each test is fitted and the rest is held out."""


@dataclass(frozen=True, eq=False)
class Split:
    """Fitted and held-out samples. ``fit_part`` and ``held_out`` index ``record`` and ``held_out_record``.

    ``tests`` are the numbers of the fitted tests, ``records`` what they hold, whole, where a part of each is held out
    and nothing where another test is, whose number is ``validated``. ``external_spring_n_per_m`` stood beside the
    tissue in all of them, where the record is force and position.

    Several tests are joined with a gap between each two, which no engine reaches across. What is held out of them are
    then separate stretches: ``held_out_record`` holds the whole input, which a free run needs, and as outputs those
    that were not fitted alone; the others are NaN.
    """

    record: Record
    fit_part: slice
    held_out_record: Record
    held_out: slice
    tests: tuple[int, ...]
    validated_on: str
    records: tuple[Record, ...] = ()
    validated: int | None = None
    external_spring_n_per_m: float = 0.0
    configuration: str = "indentation"

    @property
    def fitted(self) -> Record:
        """What was fitted, cut out."""
        return self.record[self.fit_part]

    @property
    def unseen(self) -> Record:
        """The held-out record with every output that is not held out hidden (NaN)."""
        output = np.full(len(self.held_out_record), np.nan)
        output[self.held_out] = self.held_out_record.output[self.held_out]
        return replace(self.held_out_record, output=output)

    @property
    def other_quarters(self) -> tuple[Split, ...]:
        """The same tests with another quarter of each held out in place of the last; none when another test is.

        Every ``held_out_record`` is as long as this one's, so that errors on all quarters can be laid together.
        """
        return tuple(_hold_out(self.records, quarter, self.tests) for quarter in range(QUARTERS - 1) if self.records)


def split(
    session: Session,
    *,
    test: int | None = None,
    also: Sequence[int] = (),
    validate: int | None = None,
    input_name: str = "force",
    output_name: str = "position",
) -> Split:
    """Take tests out of a session and part them.

    ``test`` is the number of the fitted test (the first stochastic one by default), ``also`` those of further ones
    that are fitted together with it, ``validate`` that of the test that the models are scored on. Without it the last
    quarter of every fitted test is held out.

    Raises:
        UnusableInputError: no such test or signal, a test named twice, or tests that cannot be fitted together, such as
            those of different configurations or with different external springs.
    """
    if input_name == output_name:
        raise UnusableInputError(f"input and output are the same signal, {input_name!r}")
    first = session.test(test)
    tests = [first, *map(session.test, also)]
    numbers = tuple(t.number for t in tests)
    for number in numbers:
        if numbers.count(number) > 1:
            raise UnusableInputError(f"test {number} is named twice among the tests to fit")
    if validate in numbers:
        raise UnusableInputError(f"test {validate} is one that is fitted: validate on another, or on none")
    spring = _common_spring(tests if validate is None else [*tests, session.test(validate)])
    if (input_name, output_name) != ("force", "position"):
        spring = 0.0
    records = tuple(t.record(input_name, output_name) for t in tests)
    if validate is not None:
        record = joined(records)
        other = session.test(validate).record(input_name, output_name)
        whole = slice(0, len(record)), slice(0, len(other))
        parts = Split(record, whole[0], other, whole[1], numbers, f"test {validate}", validated=validate)
    else:
        parts = split_records(records, numbers)
    return replace(parts, external_spring_n_per_m=spring, configuration=first.configuration)


def _common_spring(tests: Sequence[Test]) -> float:
    """The external spring of all the tests, N/m.

    Raises:
        UnusableInputError: they differ in it.
    """
    springs = [spring_of(test.notes) for test in tests]
    for test, spring in zip(tests, springs, strict=True):
        if test.configuration != tests[0].configuration:
            raise UnusableInputError(
                f"tests {tests[0].number} and {test.number} are of different configurations, {tests[0].configuration} "
                f"and {test.configuration}: analyse them one by one"
            )
        if spring != springs[0]:
            raise UnusableInputError(
                f"tests {tests[0].number} and {test.number} had external springs of {springs[0]:g} and {spring:g} N/m: "
                "analyse them one by one"
            )
    return springs[0]


def split_records(records: Sequence[Record], tests: tuple[int, ...] = (1,)) -> Split:
    """Hold the last quarter of every record out; ``tests`` are the numbers that stand for them.

    Raises:
        UnusableInputError: there are none, or they differ in sample rate, signals or units.
    """
    if len(records) != 1:
        return _hold_out(records, QUARTERS - 1, tests)
    record, cut = records[0], round(FIT_SHARE * len(records[0]))
    whole = tuple(records)
    return Split(record, slice(0, cut), record, slice(cut, len(record)), tests, _quarter_of(tests), whole)


def _hold_out(records: Sequence[Record], quarter: int, tests: tuple[int, ...]) -> Split:
    """Hold a quarter of every record out, by its number from 0, and join what is before and after it."""
    kept: list[Record] = []
    unseen: list[Record] = []
    for record in records:
        first, end = (round(q * len(record) / QUARTERS) for q in (quarter, quarter + 1))
        kept += [record[part] for part in (slice(0, first), slice(end, len(record))) if part.start < part.stop]
        output = np.full(len(record), np.nan)
        output[first:end] = record.output[first:end]
        unseen.append(replace(record, output=output))
    fitted, held_out = joined(kept), joined(unseen)
    whole = slice(0, len(fitted)), slice(0, len(held_out))
    return Split(fitted, whole[0], held_out, whole[1], tests, _quarter_of(tests, quarter), tuple(records))


def _quarter_of(tests: Sequence[int], quarter: int = QUARTERS - 1) -> str:
    share = f"the {('first', 'second', 'third', 'last')[quarter]} {100 / QUARTERS:.0f} %"
    if len(tests) == 1:
        return f"{share} of test {tests[0]}"
    return f"{share} each of tests {', '.join(map(str, tests[:-1]))} and {tests[-1]}"
