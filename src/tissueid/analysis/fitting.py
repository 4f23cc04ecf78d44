"""One engine fitted to the tests of a session and scored on what was held out, with the time that it took."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

from numba.core.event import install_timer

from tissueid.analysis.split import Split, split
from tissueid.errors import UnusableInputError
from tissueid.identification.base import Engine, Model
from tissueid.identification.depth_profile import DepthProfile
from tissueid.identification.external_spring import has_stiffness, profile_without_spring, without_spring
from tissueid.identification.registry import get_engine
from tissueid.identification.validation import validated
from tissueid.records import Record
from tissueid.sessions import Session, Test

REPORT_ENGINES = ("lms", "spectral", "wiener")


@dataclass(frozen=True)
class Analysis:
    """One engine fitted to one or several tests. ``fit_part`` and ``held_out`` index the records as in ``Split``.

    ``test`` is the number of the first test that was fitted, ``tests`` are those of all.

    ``external_spring_n_per_m`` stood beside the tissue: the stiffness among the model's parameters and that of
    ``depth_profile`` are without it. The model itself, its response and its figures are of both together.
    """

    model: Model
    record: Record
    fit_part: slice
    held_out_record: Record
    held_out: slice
    test: int
    validated_on: str
    tests: tuple[int, ...] = ()
    external_spring_n_per_m: float = 0.0
    configuration: str = "indentation"

    def depth_profile(self, model: Model | None = None) -> DepthProfile | None:
        """Mass, damping and stiffness of the tissue against depth, without an external spring.

        By another ``model`` of the same record, if one is given; None for models that hold no depth.
        """
        profile = (model or self.model).depth_profile()
        if profile is None or not self.external_spring_n_per_m:
            return profile
        return profile_without_spring(profile, self.external_spring_n_per_m)


def analyse(
    session: Session,
    engine: str,
    options: Mapping[str, Any] | None = None,
    *,
    test: int | None = None,
    also: Sequence[int] = (),
    validate: int | None = None,
    input_name: str = "force",
    output_name: str = "position",
) -> Analysis:
    """Fit one engine and score its free-run simulation on data that was not fitted.

    ``test`` is the number of the fitted test (the first stochastic one by default); ``also`` are those of tests that
    are fitted together with it; ``validate`` is that of the test it is scored on. Without it the last quarter of every
    fitted test is held out.

    Raises:
        UnusableInputError: unknown engine, option, test or signal, or a record that cannot carry the fit.
    """
    specification = get_engine(engine).from_options(options or {})
    parts = split(session, test=test, also=also, validate=validate, input_name=input_name, output_name=output_name)
    return fit_split(specification, parts)


def analyse_all(
    session: Session, engines: Iterable[str] = REPORT_ENGINES, *, test: Test | None = None, validate: int | None = None
) -> dict[str, Analysis]:
    """Several engines on one test, by name, with their default options."""
    number = None if test is None else test.number
    return {name: analyse(session, name, test=number, validate=validate) for name in engines}


def fit_split(specification: Engine, parts: Split) -> Analysis:
    """Fit a specification to the fitted part of a split and score it on the held-out one.

    Raises:
        UnusableInputError: the record cannot carry the fit.
    """
    model, seconds = timed_fit(specification, parts.record, parts.fit_part)
    with _its_own_fault(specification):
        model = validated(model, parts.held_out_record, parts.held_out).with_report(seconds=seconds)
    return Analysis(
        _without_spring(model, parts.external_spring_n_per_m),
        parts.record,
        parts.fit_part,
        parts.held_out_record,
        parts.held_out,
        parts.tests[0],
        parts.validated_on,
        parts.tests,
        parts.external_spring_n_per_m,
        parts.configuration,
    )


def _without_spring(model: Model, spring_n_per_m: float) -> Model:
    """The model with the external spring taken off the stiffness that it reports, and a line that says so."""
    report = model.report
    if not spring_n_per_m or not (has_stiffness(report.parameters) or model.depth_profile() is not None):
        return model
    line = (
        f"The external spring of {spring_n_per_m:g} N/m is subtracted from the stiffness; natural frequency, damping "
        "ratio, curves and figures of the response are those of tissue and spring together."
    )
    parameters = without_spring(report.parameters, spring_n_per_m)
    return replace(model, report=replace(report, parameters=parameters, findings=(*report.findings, line)))


def timed_fit(specification: Engine, record: Record, fit_part: slice | None) -> tuple[Model, float]:
    """Fit, and return the model with the seconds that it took.

    Compiled loops are built the first time that a machine meets them, and loaded from a cache afterwards. Neither is
    counted, so that an engine's figure does not depend on which ran first.

    Raises:
        UnusableInputError: the record cannot carry the fit.
    """
    compiling: list[float] = []
    begin = time.perf_counter()
    with _its_own_fault(specification), install_timer("numba:compiler_lock", compiling.append):
        model = specification.fit(record, fit_part)
        if not isinstance(model, Model):
            raise TypeError(f"fit returned {type(model).__name__}, not a model")
    return model, max(0.0, time.perf_counter() - begin - sum(compiling))


@contextmanager
def _its_own_fault(engine: Engine) -> Iterator[None]:
    """Tell a fault of another package's engine as that engine's, so that it costs no other; ours are defects.

    Raises:
        UnusableInputError: the engine of another package failed.
    """
    try:
        yield
    except UnusableInputError:
        raise
    except Exception as error:
        if type(engine).__module__.startswith("tissueid."):
            raise
        said = f"{type(error).__name__}: {error}".splitlines()[0]
        raise UnusableInputError(f"the engine {engine.name}, of another package, failed: {said}") from error
