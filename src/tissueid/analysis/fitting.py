"""Fits of engines to tests of a session, scored on held-out data; scores of several models on the same samples."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Protocol, Unpack, runtime_checkable

import numpy as np
from numba.core.event import install_timer

from tissueid.analysis.split import NOMINAL_RELATIVE_STD, Actuator, Coil, Selection, Split, split
from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Engine, Family, FitReport, Mask, Model, refused_if_not_computed
from tissueid.identification.depth_profile import DepthProfile
from tissueid.identification.preparation import scored_samples
from tissueid.identification.recommendation_messages import ModelCandidate
from tissueid.identification.registry import get_engine, report_engines
from tissueid.identification.second_order import has_stiffness, profile_without_spring, without_spring
from tissueid.identification.second_order_fit import SecondOrderFit
from tissueid.identification.validation import aic, aicc, vaf_percent, validated
from tissueid.identification.validation.scores import unrelated_p_value
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Record, joined
from tissueid.sessions import Session, Test

_DIFFERS = 2.6
"""Standard deviations between C3 and the weight beyond which they differ (99 % of a normal variable)."""
NOTHING_HELD_OUT = marked("the fitted samples: nothing was held out")
"""What an analysis of whole tests was validated on."""


@dataclass(frozen=True)
class Analysis:
    """One engine fitted to one or several tests. ``fit_part`` and ``held_out`` index the records as in ``Split``.

    ``test`` is the number of the first fitted test, ``tests`` are the numbers of all.

    ``external_spring_n_per_m`` is the stiffness of a spring parallel to the tissue. It is subtracted from the stiffness
    among the model's parameters and in ``depth_profile``; the model itself and its response include it.

    ``actuator`` is the moving part of the instrument where mass and damping of the tissue alone were asked for; they
    are among the model's parameters as ``tissue_...``, in addition to those of coil and tissue.
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
    actuator: Actuator | None = None

    def depth_profile(self, model: Model | None = None) -> DepthProfile | None:
        """Return mass, damping and stiffness of the tissue against depth, without the external spring.

        ``model`` is another model of the same record to use instead; None for models that do not depend on depth.
        """
        profile = (model or self.model).depth_profile()
        if profile is None or not self.external_spring_n_per_m:
            return profile
        return profile_without_spring(profile, self.external_spring_n_per_m)

    def as_answer(self) -> dict[str, Any]:
        """Return the result for JSON: report, fitted tests, validation part, and parameters against depth."""
        profile = self.depth_profile()
        answer: dict[str, Any] = {}
        if self.actuator is not None:
            alone = None if profile is None else self.actuator.without(profile)
            answer = {
                "actuator": {
                    "mass_kg": {"value": self.actuator.mass.value, "std": self.actuator.mass.std},
                    "damping_n_s_per_m": {"value": self.actuator.damping.value, "std": self.actuator.damping.std},
                    "calibrated": self.actuator.calibrated,
                },
                "tissue_depth_profile": None if alone is None else alone.as_rows(),
            }
        return (
            answer
            | self.model.report.as_dict()
            | {
                "test": self.test,
                "tests": list(self.tests),
                "validated_on": self.validated_on,
                "external_spring_n_per_m": self.external_spring_n_per_m,
                "depth_profile": None if profile is None else profile.as_rows(),
            }
        )


def analyse(
    session: Session,
    engine: str,
    options: Mapping[str, Any] | None = None,
    *,
    tissue_alone: bool = False,
    **selection: Unpack[Selection],
) -> Analysis:
    """Fit one engine and score its free-run simulation on held-out data.

    Args:
        session: the session that holds the tests.
        engine: name of the engine.
        options: options of the engine by name.
        tissue_alone: also report mass and damping without those of the actuator.
        selection: tests and signals, as for :func:`split`.

    Raises:
        UnusableInputError: unknown engine, option, test or signal, or a record that cannot carry the fit.
    """
    specification = get_engine(engine).from_options(options or {})
    parts = split(session, **selection)
    signals = selection.get("input_name", "force"), selection.get("output_name", "position")
    if tissue_alone and signals == ("force", "position"):
        parts = replace(parts, actuator=Actuator.of(session.instrument))
    return fit_split(specification, parts)


def analyse_all(
    session: Session,
    engines: Iterable[str] | None = None,
    *,
    test: Test | None = None,
    validate: int | None = None,
    tissue_alone: bool = False,
) -> dict[str, Analysis]:
    """Fit several engines, by default those of the test's standard report, to it. Return the analyses by engine."""
    number = None if test is None else test.number
    names = engines_of(session.test(number)) if engines is None else engines
    return {name: analyse(session, name, test=number, validate=validate, tissue_alone=tissue_alone) for name in names}


def engines_of(test: Test) -> tuple[str, ...]:
    """Return the names of the engines of the standard report of a test.

    They are the usual ones for a test without a record, such as one that was stopped in its preload: each of them then
    gives the reason. Of a ramp or a hold, the report has stiffness and relaxation.
    """
    if test.kind in ("slow_ramp", "step_hold"):
        return ("viscoelastic",)
    try:
        record = test.record()
    except UnusableInputError:
        return report_engines()
    return report_engines(record)


def fit_split(specification: Engine, parts: Split) -> Analysis:
    """Fit a specification to the fitted part of a split and score it on the held-out one.

    Raises:
        UnusableInputError: the record cannot carry the fit.
    """
    completed = specification.with_test_values(parts.surface_position_m, parts.weight_n)
    model, seconds = timed_fit(completed, parts.record, parts.fit_part)
    model = _with_test_values(model, specification, completed, parts.weight_n)
    with _engine_errors(specification):
        model = validated(model, parts.held_out_record, parts.held_out).with_report(seconds=seconds)
    model = model if parts.scorable else model.without_validation()
    model = _without_spring(
        model if parts.coil is None else _behind_coil(model, parts.coil), parts.external_spring_n_per_m
    )
    return Analysis(
        model if parts.actuator is None else _with_tissue_alone(model, parts.actuator),
        parts.record,
        parts.fit_part,
        parts.held_out_record,
        parts.held_out,
        parts.tests[0],
        parts.validated_on,
        parts.tests,
        parts.external_spring_n_per_m,
        parts.configuration,
        parts.actuator,
    )


def _with_tissue_alone(model: Model, actuator: Actuator) -> Model:
    """Return the model with mass and damping of the tissue alone among its parameters, and a finding about them."""
    report = model.report
    more = actuator.remainders(report.parameters)
    if not more:
        return model
    values = {"mass": 1e3 * actuator.mass.value, "damping": actuator.damping.value}
    if actuator.calibrated:
        line = Message(
            "analysis.actuator_of_sweep",
            "Tissue alone: the moving mass of {mass:.1f} g and the bearing damping of {damping:.2f} N s/m of the "
            "calibration sweep are subtracted, with their uncertainties.",
            **values,
        )
    else:
        line = Message(
            "analysis.actuator_nominal",
            "Tissue alone: the nominal moving mass of {mass:.1f} g and bearing damping of {damping:.2f} N s/m are "
            "subtracted, with an assumed uncertainty of {percent:.0f} %; a calibration sweep measures them.",
            percent=100.0 * NOMINAL_RELATIVE_STD,
            **values,
        )
    return model.with_report(parameters=report.parameters | more, findings=(*report.findings, line))


def _behind_coil(model: Model, coil: Coil) -> Model:
    """Return a model from the voltage with mass, damping and stiffness behind the coil, and a finding about them, where
    it reports a second-order fit of voltage to position.
    """
    report = model.report
    second_order = getattr(model, "second_order", None)
    if not isinstance(second_order, SecondOrderFit) or not second_order.parameters.items() <= report.parameters.items():
        return model
    line = Message(
        "analysis.behind_coil",
        "Mass, damping and stiffness follow from the coil's resistance of {resistance:.2f} ohm and force constant of "
        "{force_constant:.2f} N/A: the back-EMF damping of {damping:.2f} N s/m is subtracted, the inductance "
        "neglected.",
        resistance=coil.resistance.value,
        force_constant=coil.force_constant.value,
        damping=coil.force_constant.value**2 / coil.resistance.value,
    )
    parameters = report.parameters | second_order.behind_coil(coil.resistance, coil.force_constant)
    return model.with_report(parameters=parameters, findings=(*report.findings, line))


def _with_test_values(model: Model, given: Engine, used: Engine, weight_n: float | None) -> Model:
    """Return the model with the options as given, and among its details, as ``known_...``, those of the test.

    A load C3 that differs significantly from the weight of the moving part becomes a finding.
    """
    report, options = model.report, given.options()
    changed = {name: value for name, value in used.options().items() if value != options[name]}
    taken = {f"known_{name}": v for name, v in changed.items() if isinstance(v, float) and options[name] is None}
    as_given = report.options | {name: options[name] for name in changed}
    model = replace(model, report=replace(report, options=as_given, details=report.details | taken))
    load = report.parameters.get("c3_n")
    if weight_n is None or load is None or load.std is None or abs(load.value - weight_n) <= _DIFFERS * load.std:
        return model
    line = Message(
        "analysis.load_is_not_weight",
        "C3 of {load:.2f} ± {std:.2f} N is not the weight of the moving part, {weight:.2f} N: the exponential does not "
        "describe the tissue down to its surface",
        load=load.value,
        std=load.std,
        weight=weight_n,
    )
    return model.with_report(findings=(*report.findings, line))


def fit_whole(specification: Engine, parts: Split) -> Analysis:
    """Fit a specification to the whole tests of a split; nothing is held out, and the report has no held-out score.

    The held-out part of the analysis is the fitted one, so that its figures show the fitted samples.

    Raises:
        UnusableInputError: the record cannot carry the fit.
    """
    record = joined(parts.records)
    whole = slice(0, len(record))
    everything = replace(
        parts,
        record=record,
        fit_part=whole,
        held_out_record=record,
        held_out=whole,
        validated_on=NOTHING_HELD_OUT,
        records=(),
    )
    analysis = fit_split(specification, everything)
    model = analysis.model.with_report(vaf_validation_percent=None, validation_p_value=None, vaf_scheduled_percent=None)
    return replace(analysis, model=model)


def _without_spring(model: Model, spring_n_per_m: float) -> Model:
    """Return the model with the external spring subtracted from its reported stiffness, and add a finding about it."""
    report = model.report
    if not spring_n_per_m or not (has_stiffness(report.parameters) or model.depth_profile() is not None):
        return model
    line = Message(
        "analysis.spring_subtracted",
        "The external spring of {spring:g} N/m is subtracted from the stiffness of tables and profiles; natural "
        "frequency, damping ratio, curves, figures of the response and the findings below are those of tissue and "
        "spring together.",
        spring=spring_n_per_m,
    )
    parameters = without_spring(report.parameters, spring_n_per_m)
    return replace(model, report=replace(report, parameters=parameters, findings=(line, *report.findings)))


def timed_fit(specification: Engine, record: Record, fit_part: slice | None) -> tuple[Model, float]:
    """Fit, and return the model with the time of the fit, s.

    The time to compile loops or to load them from the cache is not counted, so that the time does not depend on which
    engine ran first.

    Raises:
        UnusableInputError: the record cannot carry the fit.
    """
    compiling: list[float] = []
    begin = time.perf_counter()
    with _engine_errors(specification), install_timer("numba:compiler_lock", compiling.append):
        model = specification.fit(record, fit_part)
        if not isinstance(model, Model):
            raise TypeError(f"fit returned {type(model).__name__}, not a model")
    return model, max(0.0, time.perf_counter() - begin - sum(compiling))


@contextmanager
def _engine_errors(engine: Engine) -> Iterator[None]:
    """Turn a numerical failure of an engine, and any exception of one of another package, into a refusal of the record.

    Raises:
        UnusableInputError: the engine failed on this record.
    """
    try:
        with refused_if_not_computed(engine.name):
            yield
    except UnusableInputError:
        raise
    except Exception as error:
        if type(engine).__module__.startswith("tissueid."):
            raise
        said = f"{type(error).__name__}: {error}".splitlines()[0]
        raise UnusableInputError(
            "engine.failed", "the engine {name}, of another package, failed: {problem}", name=engine.name, problem=said
        ) from error


_SHARED = 0.5
"""Smallest share of the other models' samples that must remain. A model that leaves fewer is scored on its own."""

_SECOND_ORDER_PARAMETERS = 4
"""Number of parameters of the second-order model: mass, damping, stiffness and offset."""


@dataclass(frozen=True, eq=False)
class Scored:
    """An analysis whose report holds the scores on shared samples.

    ``parameters`` is the effective number of parameters where the engine reports it. ``residual`` (n,) is the error on
    the fitted record, from which VAF and AICc follow, and ``error`` (n,) that on the held-out record; NaN where it is
    not scored. ``own_samples`` is true where the scored samples are not the shared ones.
    """

    analysis: Analysis
    parameters: float
    own_samples: bool
    residual: Array
    error: Array

    @property
    def n_fitted(self) -> int:
        """Number of samples of VAF and AICc."""
        return int(np.isfinite(self.residual).sum())

    @property
    def aicc(self) -> float | None:
        """AICc; None where the model was scored on its own samples, as it cannot be compared."""
        return None if self.own_samples else self.analysis.model.report.aicc


@runtime_checkable
class Reducible(Protocol):
    """A linear model that also holds a second-order system."""

    @property
    def input_mean(self) -> float:
        """Mean input: the operating point."""

    @property
    def output_mean(self) -> float:
        """Output at the mean input."""

    @property
    def second_order(self) -> SecondOrderFit:
        """The second-order system fitted to the model's response."""


def effective_parameters(report: FitReport) -> float:
    """Return the effective number of parameters: below the number of parameters where a prior restricts them."""
    return report.details.get("effective_parameters", float(report.n_parameters))


def scored(analyses: Sequence[Analysis], parts: Split) -> list[Scored]:
    """Score models of one split, each on the samples that all of them can simulate."""
    unseen = parts.unseen
    simulated = [(a.model.simulate(parts.record.input), a.model.simulate(unseen.input)) for a in analyses]
    fitted, fitted_own = _shared(
        [
            scored_samples(parts.record, a.model.memory_samples, parts.fit_part) & np.isfinite(own)
            for a, (own, _) in zip(analyses, simulated, strict=True)
        ]
    )
    held_out, held_out_own = _shared(
        [
            scored_samples(unseen, a.model.memory_samples) & np.isfinite(other)
            for a, (_, other) in zip(analyses, simulated, strict=True)
        ]
    )
    rows = []
    for k, analysis in enumerate(analyses):
        report, (own, other) = analysis.model.report, simulated[k]
        parameters = effective_parameters(report)
        residual = np.where(fitted[k], parts.record.output - own, np.nan)
        error = np.where(held_out[k], unseen.output - other, np.nan)
        scheduled = analysis.model.simulate_scheduled(parts.held_out_record)
        model = analysis.model.with_validation(
            vaf_percent(unseen.output, unseen.output - error),
            unrelated_p_value(analysis.model, unseen, other, held_out[k]),
            None if scheduled is None else vaf_percent(np.where(held_out[k], unseen.output, np.nan), scheduled),
        ).with_report(
            vaf_percent=vaf_percent(parts.record.output, parts.record.output - residual),
            aic=aic(residual, parameters),
            aicc=aicc(residual, parameters),
        )
        model = model if parts.scorable else model.without_validation()
        own_samples = fitted_own[k] or held_out_own[k]
        rows.append(Scored(replace(analysis, model=model), parameters, own_samples, residual, error))
    return rows


def candidates(rows: Sequence[Scored], families: Sequence[Family], parts: Split) -> list[ModelCandidate]:
    """Return the candidates of a recommendation: every model, and the second-order system of the best linear one."""
    contenders = [
        ModelCandidate(
            engine=row.analysis.model.report.engine,
            family=family,
            error=row.error,
            parameters=row.parameters,
            vaf_percent=row.analysis.model.report.vaf_percent,
            aicc=row.aicc,
            scheduled_percent=row.analysis.model.report.vaf_scheduled_percent,
        )
        for row, family in zip(rows, families, strict=True)
    ]
    linear = [
        row
        for row, family in zip(rows, families, strict=True)
        if family is Family.LINEAR and isinstance(row.analysis.model, Reducible)
    ]
    best = max(linear, key=lambda row: row.analysis.model.report.vaf_percent, default=None)
    return contenders if best is None else [*contenders, _second_order(best, parts)]


def _second_order(row: Scored, parts: Split) -> ModelCandidate:
    """Return the second-order system of a linear model as a separate candidate."""
    model = row.analysis.model
    assert isinstance(model, Reducible)
    residual = _second_order_error(model, parts.record, np.isfinite(row.residual))
    error = held_out_error(model, parts, second_order=True)
    return ModelCandidate(
        engine=model.report.engine,
        family=Family.LINEAR,
        error=np.where(np.isfinite(row.error), error, np.nan),
        parameters=_SECOND_ORDER_PARAMETERS,
        vaf_percent=vaf_percent(parts.record.output, parts.record.output - residual),
        aicc=None if row.own_samples else aicc(residual, _SECOND_ORDER_PARAMETERS),
        second_order=True,
    )


def held_out_error(model: Model, parts: Split, *, second_order: bool = False) -> Array:
    """Return measured minus free-run simulated output on the held-out record, (n,), NaN where it is not scored.

    ``second_order`` takes the second-order system of a linear model in place of the model.
    """
    unseen = parts.unseen
    used = scored_samples(unseen, model.memory_samples)
    if second_order and isinstance(model, Reducible):
        return _second_order_error(model, unseen, used)
    return np.where(used, unseen.output - model.simulate(unseen.input), np.nan)


def _second_order_error(model: Reducible, record: Record, used: Mask) -> Array:
    received = np.where(np.isfinite(record.input), record.input - model.input_mean, 0.0)
    return np.where(used, record.output - model.output_mean - model.second_order.simulate(received), np.nan)


def _shared(masks: Sequence[Mask]) -> tuple[list[Mask], list[bool]]:
    """Return for each mask (n,) the samples to score, and whether they are its own because it shares too few."""
    own = [False] * len(masks)
    while True:
        together = [k for k in range(len(masks)) if not own[k]]
        common = np.logical_and.reduce([masks[k] for k in together])
        if common.sum() >= _SHARED * max(masks[k].sum() for k in together):
            return [masks[k] if own[k] else common for k in range(len(masks))], own
        own[min(together, key=lambda k: int(masks[k].sum()))] = True


def scheduled_scores(analysis: Analysis) -> tuple[float | None, float | None]:
    """Return VAF (percent) and AICc of the run scheduled by the measured output, on the fitted samples."""
    model, record = analysis.model, analysis.record
    run = model.simulate_scheduled(record)
    if run is None:
        return None, None
    residual = (record.output - run)[analysis.fit_part]
    finite = np.isfinite(residual)
    measured = record.output[analysis.fit_part][finite]
    return vaf_percent(measured, measured - residual[finite]), aicc(residual, model.report.n_parameters)
