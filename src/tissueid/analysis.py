"""From a saved test to fitted and validated models: what the command line, the window and the report share."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Model
from tissueid.identification.registry import get_engine
from tissueid.identification.validation import validated
from tissueid.records import Record
from tissueid.sessions import Session, Test

FIT_SHARE = 0.75
"""Without another test to validate on, this much of the test is fitted and the rest is held out."""

REPORT_ENGINES = ("lms", "spectral", "wiener")


@dataclass(frozen=True)
class Analysis:
    """One engine fitted to one test. ``fit_part`` and ``held_out`` index ``record`` and ``held_out_record``."""

    model: Model
    record: Record
    fit_part: slice
    held_out_record: Record
    held_out: slice
    test: int
    validated_on: str


def analyse(
    session: Session,
    engine: str,
    options: Mapping[str, Any] | None = None,
    *,
    test: int | None = None,
    validate: int | None = None,
    input_name: str = "force",
    output_name: str = "position",
) -> Analysis:
    """Fit one engine to one test and score its free-run simulation on data that was not fitted.

    ``test`` is the number of the fitted test (the first stochastic one by default); ``validate`` that of the test
    it is scored on. Without it the last quarter of the fitted test is held out.

    Raises:
        UnusableInputError: unknown engine, option, test or signal, or a record that cannot carry the fit.
    """
    if input_name == output_name:
        raise UnusableInputError(f"input and output are the same signal, {input_name!r}")
    specification = get_engine(engine).from_options(options or {})
    fitted = session.test(test)
    record = fitted.record(input_name, output_name)
    if validate is not None and validate != fitted.number:
        other = session.test(validate)
        held_out_record = other.record(input_name, output_name)
        fit_part, held_out = slice(0, len(record)), slice(0, len(held_out_record))
        validated_on = f"test {other.number}"
    elif validate is None:
        cut = round(FIT_SHARE * len(record))
        held_out_record, fit_part, held_out = record, slice(0, cut), slice(cut, len(record))
        validated_on = f"the last {100 * (1 - FIT_SHARE):.0f} % of test {fitted.number}"
    else:
        raise UnusableInputError(f"test {validate} is the one that is fitted: validate on another, or on none")
    begin = time.perf_counter()
    model = specification.fit(record, fit_part)
    seconds = time.perf_counter() - begin
    model = validated(model, held_out_record, held_out).with_report(seconds=seconds)
    return Analysis(model, record, fit_part, held_out_record, held_out, fitted.number, validated_on)


def analyse_all(
    session: Session, engines: Iterable[str] = REPORT_ENGINES, *, test: Test | None = None, validate: int | None = None
) -> dict[str, Analysis]:
    """Several engines on one test, by name, with their default options."""
    number = None if test is None else test.number
    return {name: analyse(session, name, test=number, validate=validate) for name in engines}
