"""Readings from an identified model: the same step and an impulse, applied to a model of a stochastic test.

The uncertainty of the step is that of the fit: the curves of ``dpn`` are drawn from the covariance of their
coefficients, every other engine is fitted to resampled stretches of its record (``validation.bootstrap``). What a model
cannot describe, such as creep beyond its memory, is not part of it: such readings have no value.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tissueid.analysis.decay_readings import (
    DECAY_DEFINITIONS,
    LocalSystem,
    Release,
    determined,
    recorded_release,
    system_decay,
    trace_figures,
)
from tissueid.analysis.fitting import Analysis
from tissueid.analysis.step_readings import (
    DEFINITIONS,
    NO_UNCERTAINTY,
    NOT_COMPARABLE,
    POINTS,
    Array,
    Reading,
    StepCourse,
    StepPoints,
    as_answer,
    find_steps,
    read_points,
    recorded_points,
    step_readings,
)
from tissueid.configuration import spring_of
from tissueid.errors import UnusableInputError
from tissueid.identification.base import Engine, Model
from tissueid.identification.engines.dpn import DpnModel
from tissueid.identification.engines.wiener import WienerModel
from tissueid.identification.second_order import SecondOrder
from tissueid.identification.second_order_fit import SecondOrderFit
from tissueid.identification.validation.bootstrap import Method, bootstrap
from tissueid.messages import Message, stored
from tissueid.records import Record
from tissueid.sessions import Session, Test
from tissueid.stimuli.kinds.quasi_static import StepHold

DRAWS = 40
"""Number of refits or draws; the standard deviation is then known within about a tenth."""
_SETTLING_S = 1.0
"""Hold before the step in a simulation, s, added to the memory of the model."""
_TAP_S = 0.002
"""Length of the impulse on a model that is simulated, s: a tenth of a period of tissue and probe or less."""
_DECAY_S = 0.4
"""Length of a simulated decay, s."""
_CREEP_MARGIN = 0.95
"""Share of the hold that the memory of a model must cover to describe the creep."""
_VISITED = 0.005
"""Share of the fitted input below and above the range that counts as visited."""


@dataclass(frozen=True, eq=False)
class ModelReadings:
    """Readings of a model.

    ``time_s``, ``response_m`` and ``std_m`` (n,) are the simulated step, relative to the position before it; the last
    is None without an uncertainty. ``local`` is the second-order system about which the decay is computed; None if the
    model was simulated. ``notes`` are limits of the validity.
    """

    step: tuple[Reading, ...]
    decay: tuple[Reading, ...]
    points: StepPoints | None
    time_s: Array
    response_m: Array
    std_m: Array | None
    local: LocalSystem | None
    notes: tuple[str, ...]


def model_readings(
    analysis: Analysis,
    engine: Engine,
    force: Array,
    course: StepCourse,
    *,
    draws: int = DRAWS,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> ModelReadings:
    """Compute the readings of a fitted model.

    Args:
        analysis: the fit of a stochastic test.
        engine: its specification, for refits.
        force: of the step, N, shape (n,), at the sample rate of the model.
        course: the steps in it.
        draws: number of refits or draws for the uncertainty; 0 for none.
        seed: of the random generator.
        progress: called with the number of draws done, and the total.

    Raises:
        UnusableInputError: the model does not relate force and position, has another sample rate, or cannot be
            simulated for this step.
    """
    model, record = analysis.model, analysis.record
    if (record.input_unit, record.output_unit) != ("N", "m"):
        raise UnusableInputError("readings.no_mechanics", "readings need a force in N and a position in m")
    model.check_rate(replace(record, sample_rate_hz=course.sample_rate_hz))
    response = _simulated(model, force, course)
    points = read_points(response, course)
    notes = list(_notes(analysis, course))
    local = local_system(model)
    covariance, tapped = np.full((len(POINTS), len(POINTS)), np.nan), np.full((0, len(DECAY_DEFINITIONS)), np.nan)
    std: Array | None = None
    reason: str = NO_UNCERTAINTY
    if draws >= 2:
        try:
            drawn = _draws(analysis, engine, force, course, local is None, draws, seed, progress)
            drawn = drawn[np.isfinite(drawn[:, : response.size]).any(axis=1)]
            std = np.asarray(_from_rest(drawn[:, : response.size], course).std(axis=0, ddof=1))
            rows = np.array([read_points(row, course).values for row in drawn[:, : response.size]])
            covariance = np.cov(rows, rowvar=False)
            tapped = drawn[:, response.size :]
        except UnusableInputError as error:
            reason = Message("readings.no_draws", "the uncertainty is not known: {reason}", reason=error.message)
    points = StepPoints(points.values, covariance, points.times_s, points.reasons, reason)
    step = step_readings(points, direction=math.copysign(1.0, course.step_n))
    if creep := _no_creep(model, course):
        step = tuple(
            reading
            if reading.definition.name in _WITHOUT_CREEP
            else replace(reading, estimate=None, reason=reading.reason if reading.estimate is None else creep)
            for reading in step
        )
    decay = system_decay(local) if local is not None else _simulated_decay(model, record, tapped)
    time: Array = (np.arange(response.size, dtype=np.float64) - course.cycles[0].rise) / course.sample_rate_hz
    return ModelReadings(step, decay, points, time, _from_rest(response, course), std, local, tuple(notes))


def _from_rest(response: Array, course: StepCourse) -> Array:
    """Return simulated positions (..., n) relative to the mean before the first step."""
    end = max(1, math.floor(course.cycles[0].rise - 0.02 * course.sample_rate_hz))
    begin = max(0, end - round(0.1 * course.sample_rate_hz))
    return np.asarray(response - response[..., begin:end].mean(axis=-1, keepdims=True), dtype=np.float64)


def _simulated(model: Model, force: Array, course: StepCourse) -> Array:
    """Return the simulated position (n,), m, from rest at the first level.

    Raises:
        UnusableInputError: the simulation has no value.
    """
    lead = model.memory_samples + round(_SETTLING_S * course.sample_rate_hz)
    received = np.isfinite(force)
    filled = np.interp(np.arange(force.size), np.flatnonzero(received), force[received])
    response = model.simulate(np.concatenate([np.full(lead, course.low_n), filled]))[lead:]
    if not np.isfinite(response).all():
        raise UnusableInputError("readings.no_simulation", "the model cannot be simulated for this step")
    return np.asarray(response, dtype=np.float64)


_WITHOUT_CREEP = frozenset({"ue_m", "ur_m", "r5"})
"""Readings that depend on the first 0.1 s after a step only, if the creep has ended before the release."""


def _no_creep(model: Model, course: StepCourse) -> str:
    """Return why a model cannot describe the creep of a hold; "" if it can."""
    if isinstance(model, DpnModel):
        return Message(
            "readings.model_without_creep", "the engine {engine} assumes that there is no creep", engine="dpn"
        )
    memory_s = model.memory_samples / model.sample_rate_hz
    if memory_s < _CREEP_MARGIN * course.hold_s:
        return Message(
            "readings.short_memory",
            "the model remembers {memory:.3g} s and the hold lasts {hold:.3g} s: later creep is not part of it",
            memory=memory_s,
            hold=course.hold_s,
        )
    return ""


def _notes(analysis: Analysis, course: StepCourse) -> list[str]:
    """Return limits of the validity: extrapolation beyond the visited forces, and a fit that predicts nothing."""
    notes: list[str] = []
    fitted = analysis.record.input[analysis.fit_part]
    fitted = fitted[np.isfinite(fitted)]
    low, high = (float(np.quantile(fitted, share)) for share in (_VISITED, 1.0 - _VISITED))
    levels = sorted((course.low_n, course.high_n))
    if levels[0] < low or levels[1] > high:
        notes.append(
            Message(
                "readings.extrapolated",
                "the step goes from {from_n:.1f} to {to_n:.1f} N and the fitted test from {low:.1f} to {high:.1f} N: "
                "the model is extrapolated",
                from_n=levels[0],
                to_n=levels[1],
                low=low,
                high=high,
            )
        )
    if analysis.model.report.predicts_nothing:
        notes.append(Message("readings.predicts_nothing", "the model predicts nothing of held-out data: do not use it"))
    return notes


# -- local second-order system ----------------------------------------------------------------------------------


def local_system(model: Model) -> LocalSystem | None:
    """Return the second-order system of a model about its operating point, with the covariance of log M, B, K.

    Of ``wiener`` it is that at the mean input, of ``dpn`` that at the median position. None for a model without one;
    its decay is simulated.
    """
    if isinstance(model, DpnModel):
        estimated = model.estimated
        position = float(np.median(estimated.position))
        here = np.array([position])
        figures = [
            float(band.value[0]) for band in (estimated.mass(here), estimated.damping(here), estimated.stiffness(here))
        ]
        covariance = estimated.log_covariance(position)
        return LocalSystem(SecondOrder(*figures), covariance if np.isfinite(covariance).all() else None)
    fitted = getattr(model, "second_order", None)
    if not isinstance(fitted, SecondOrderFit):
        return None
    if not isinstance(model, WienerModel):
        direct = fitted.mechanical and model.report.engine in _DIRECT
        return LocalSystem(fitted.system, fitted.log_covariance) if direct else None
    parameters = model.report.parameters
    if "stiffness_n_per_m" not in parameters:
        return None
    stiffness = parameters["stiffness_n_per_m"]
    stage = fitted.system
    factor = stiffness.value / stage.stiffness
    system = SecondOrder(factor * stage.mass, factor * stage.damping, stiffness.value)
    if fitted.log_covariance is None or stiffness.std is None:
        return LocalSystem(system, None)
    turned = np.array([[1.0, 0.0, -1.0], [0.0, 1.0, -1.0], [0.0, 0.0, 0.0]])
    spread = (stiffness.std / stiffness.value) ** 2
    return LocalSystem(system, turned @ fitted.log_covariance @ turned.T + spread)


_DIRECT = frozenset({"lms", "spectral", "rls"})
"""Engines whose second-order system is that of the whole record, from force to position."""


# -- uncertainty ------------------------------------------------------------------------------------------------


def _draws(
    analysis: Analysis,
    engine: Engine,
    force: Array,
    course: StepCourse,
    tapped: bool,
    draws: int,
    seed: int,
    progress: Callable[[int, int], None] | None,
) -> Array:
    """Return simulated steps, and the decay of each where it is simulated, of drawn models: (draws, n + 0 or 5)."""

    def statistic(model: Model) -> Array:
        response = _simulated(model, force, course)
        return np.concatenate([response, _tap(model, analysis.record)]) if tapped else response

    model = analysis.model
    if isinstance(model, DpnModel):
        return _parametric_draws(model, statistic, draws, seed, progress)
    record, part = analysis.record, analysis.fit_part
    method: Method = "blocks" if record[part].valid.all() else "residuals"
    return bootstrap(engine, record, part, statistic, draws, seed, method=method, progress=progress).draws


def _parametric_draws(
    model: DpnModel,
    statistic: Callable[[Model], Array],
    draws: int,
    seed: int,
    progress: Callable[[int, int], None] | None,
) -> Array:
    """Return the statistic of models whose coefficients are drawn from their covariance, shape (draws, k).

    Raises:
        UnusableInputError: the covariance is unknown.
    """
    curves, covariance = model.estimated.curves, model.estimated.covariance
    if not np.isfinite(covariance).all():
        raise UnusableInputError("readings.no_covariance", "the fit did not converge")
    rng = np.random.Generator(np.random.PCG64(seed))
    rows = []
    for done, theta in enumerate(rng.multivariate_normal(curves.theta, covariance, draws, method="svd")):
        drawn = curves.with_theta(theta)
        estimated = replace(model.estimated, curves=drawn)
        rest = drawn.tables.rest(model.input_mean)
        rows.append(statistic(replace(model, estimated=estimated, rest_position=rest)))
        if progress is not None:
            progress(done + 1, draws)
    return np.array(rows)


# -- simulated decay --------------------------------------------------------------------------------------------


def _tap(model: Model, record: Record) -> Array:
    """Return the readings of a simulated decay in the order of their definitions, shape (5,); NaN where there is none.

    The impulse is a half sine of ``_TAP_S`` with a tenth of the standard deviation of the input, on its mean.
    """
    rate = model.sample_rate_hz
    lead = model.memory_samples + round(_SETTLING_S * rate)
    width = max(2, round(_TAP_S * rate))
    push = np.sin(np.pi * (np.arange(width) + 0.5) / width) * 0.1 * float(np.nanstd(record.input))
    force = np.full(lead + width + round(_DECAY_S * rate), float(np.nanmean(record.input)))
    at_rest = model.simulate(force)
    force[lead : lead + width] += push
    moved = (model.simulate(force) - at_rest)[lead:]
    mass = model.report.parameters.get("mass_kg")
    time: Array = (np.arange(moved.size, dtype=np.float64) + 0.5 - 0.5 * width) / rate
    acceleration = np.gradient(np.gradient(moved, 1.0 / rate), 1.0 / rate)
    figures = trace_figures(time, moved, acceleration, math.nan if mass is None else mass.value)
    return np.array([figures[definition.name] for definition in DECAY_DEFINITIONS])


def _simulated_decay(model: Model, record: Record, draws: Array) -> tuple[Reading, ...]:
    """Return the readings of a simulated decay, with standard deviations from draws (m, 5)."""
    no_peaks = Message("readings.no_second_peak", "the oscillation decays within one period: there is no second peak")
    no_mass = Message("readings.model_without_mass", "the engine estimates no mass")
    readings = []
    for k, (definition, value) in enumerate(zip(DECAY_DEFINITIONS, _tap(model, record), strict=True)):
        if not math.isfinite(value):
            mass_lacks = definition.name == "stiffness_n_per_m" and "mass_kg" not in model.report.parameters
            readings.append(Reading(definition, None, no_mass if mass_lacks else no_peaks))
            continue
        column = draws[:, k][np.isfinite(draws[:, k])] if draws.size else np.zeros(0)
        variance = float(np.var(column, ddof=1)) if column.size > 0.5 * len(draws) >= 1.0 else math.nan
        readings.append(determined(definition, float(value), variance))
    return tuple(readings)


STEP_KIND = "step_hold"
"""Kind of the tests that hold steps."""
_STANDARD_S = 1.0
"""Length of each hold of a step that is simulated without a recorded one, s."""
_STANDARD_SHARE = 0.05
"""Share of the fitted force below and above such a step."""

NO_STEP_TEST = Message(
    "readings.no_step_test",
    "the session holds no step test: record one with the stimulus {stimulus}",
    stimulus="step_hold",
)
NO_STOCHASTIC_TEST = Message(
    "readings.no_stochastic_test", "the session holds no stochastic test to identify a model from"
)


@dataclass(frozen=True, eq=False)
class RecordedReadings:
    """Readings of a recorded step; ``release`` is None, for the reason ``no_release``, without a free decay.

    ``time_s`` and ``displacement_m`` (n,) are the recording, from the middle of the first step and from the position
    before it.
    """

    test: Test
    course: StepCourse
    step: tuple[Reading, ...]
    decay: tuple[Reading, ...]
    points: StepPoints
    time_s: Array
    displacement_m: Array
    release: Release | None
    no_release: str = ""


@dataclass(frozen=True, eq=False)
class DeviceReadings:
    """The readings of a session; a part that is None is missing for the reason in the field after it."""

    recorded: RecordedReadings | None
    no_recorded: str
    analysis: Analysis | None
    model: ModelReadings | None
    no_model: str
    course: StepCourse | None
    notes: tuple[str, ...]

    def rows(self) -> list[tuple[Reading, Reading]]:
        """Return each reading of the recorded step and of the model, with a reason where a part is missing."""
        definitions = [row[0] for row in DEFINITIONS] + list(DECAY_DEFINITIONS)
        recorded, model = (
            [Reading(definition, None, why) for definition in definitions]
            if part is None
            else [*part.step, *part.decay]
            for part, why in ((self.recorded, self.no_recorded), (self.model, self.no_model))
        )
        return list(zip(recorded, model, strict=True))

    def as_answer(self) -> dict[str, Any]:
        """Return everything for JSON, SI units."""
        rows = self.rows()
        course, recorded, analysis = self.course, self.recorded, self.analysis
        return {
            "step": None
            if course is None
            else {
                "force_low_n": course.low_n,
                "force_high_n": course.high_n,
                "hold_s": course.hold_s,
                "cycles": len(course.cycles),
                "recorded": recorded is not None,
            },
            "recorded": {
                "test": None if recorded is None else recorded.test.number,
                "readings": as_answer(reading for reading, _ in rows),
            },
            "model": {
                "engine": None if analysis is None else analysis.model.report.engine,
                "options": None if analysis is None else analysis.model.report.options,
                "test": None if analysis is None else analysis.test,
                "vaf_validation_percent": None if analysis is None else analysis.model.report.vaf_validation_percent,
                "readings": as_answer(reading for _, reading in rows),
            },
            "notes": [str(note) for note in self.notes],
            "note_messages": [stored(note) for note in self.notes],
        }


def recorded_readings(test: Test) -> RecordedReadings:
    """Compute the readings of a recorded step test.

    Raises:
        UnusableInputError: the test holds no step of a force in N, or no position in m.
    """
    record = test.record()
    if (record.input_unit, record.output_unit) != ("N", "m"):
        raise UnusableInputError("readings.no_mechanics", "readings need a force in N and a position in m")
    course = find_steps(record.input, record.sample_rate_hz)
    points = recorded_points(record.output, course)
    release, reason = None, ""
    try:
        release = recorded_release(record.input, record.output, course)
        decay = release.readings
    except UnusableInputError as error:
        reason = error.message
        decay = tuple(Reading(definition, None, reason) for definition in DECAY_DEFINITIONS)
    start = points.values[0] if math.isfinite(points.values[0]) else float(np.nanmean(record.output[:10]))
    return RecordedReadings(
        test=test,
        course=course,
        step=step_readings(points, direction=math.copysign(1.0, course.step_n)),
        decay=decay,
        points=points,
        time_s=(np.arange(len(record), dtype=np.float64) - course.cycles[0].rise) / record.sample_rate_hz,
        displacement_m=record.output - start,
        release=release,
        no_release=reason,
    )


def step_test(session: Session, number: int | None = None) -> Test | None:
    """Return the step test of a session: that of a number, or the first of its kind; None if there is none."""
    if number is not None:
        return session.test(number)
    return next((test for test in session.tests if test.kind == STEP_KIND), None)


def device_readings(
    test: Test | None,
    fit: Callable[[], Analysis] | None,
    engine: Engine,
    *,
    draws: int = DRAWS,
    progress: Callable[[int, int], None] | None = None,
) -> DeviceReadings:
    """Compute all readings that a step test and a fit give.

    Args:
        test: the step test; None to simulate a step over the fitted forces instead.
        fit: fits the model; None without a stochastic test.
        engine: specification of the model.
        draws: number of refits for the uncertainty of the model's step.
        progress: called with the number of draws done, and the total.

    Raises:
        UnusableInputError: neither the step nor the model gives readings.
    """
    recorded: RecordedReadings | None = None
    no_recorded: str = NO_STEP_TEST
    if test is not None:
        try:
            recorded = recorded_readings(test)
        except UnusableInputError as error:
            no_recorded = error.message
    analysis: Analysis | None = None
    model: ModelReadings | None = None
    no_model: str = NO_STOCHASTIC_TEST
    course = None if recorded is None else recorded.course
    if fit is not None:
        try:
            analysis = fit()
            rate = analysis.record.sample_rate_hz
            force = _standard_step(analysis) if recorded is None else _resampled(recorded.test, rate)
            played = find_steps(force, rate)
            course = course or played
            model = model_readings(analysis, engine, force, played, draws=draws, progress=progress)
        except UnusableInputError as error:
            no_model = error.message
    if recorded is None and model is None:
        raise UnusableInputError(no_recorded if test is not None else no_model if fit is not None else no_recorded)
    notes: list[str] = [NOT_COMPARABLE, *(() if model is None else model.notes)]
    spring = 0.0 if test is None else spring_of(test.notes)
    if analysis is not None:
        spring = spring or analysis.external_spring_n_per_m
    if spring:
        notes.append(
            Message("readings.spring", "all readings include the external spring of {spring:g} N/m", spring=spring)
        )
    return DeviceReadings(recorded, no_recorded, analysis, model, no_model, course, tuple(notes))


def _resampled(test: Test, rate: float) -> Array:
    """Return the force of a step test at the sample rate of the model, N, shape (n,); linear between samples."""
    record = test.record()
    if math.isclose(record.sample_rate_hz, rate, rel_tol=1e-6):
        return record.input
    received = np.isfinite(record.input)
    times = np.arange(int(len(record) * rate / record.sample_rate_hz)) / rate
    return np.asarray(np.interp(times, record.time[received], record.input[received]), dtype=np.float64)


def _standard_step(analysis: Analysis) -> Array:
    """Return a step over nearly all of the fitted forces, N, shape (n,), at the sample rate of the fit.

    Raises:
        UnusableInputError: the force does not vary.
    """
    fitted = analysis.record.input[analysis.fit_part]
    fitted = fitted[np.isfinite(fitted)]
    low, high = (float(np.quantile(fitted, share)) for share in (_STANDARD_SHARE, 1.0 - _STANDARD_SHARE))
    if high <= low:
        raise UnusableInputError("readings.constant_force", "the force of the fitted test does not vary")
    rate = analysis.record.sample_rate_hz
    values = StepHold(cycles=1, seconds=3.0 * _STANDARD_S, sample_rate=rate, force_min_n=0.0, force_max_n=1.0).build()
    return low + (high - low) * values.values
