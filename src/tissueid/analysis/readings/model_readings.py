"""Readings from an identified model: the same step and an impulse, applied to a model of a stochastic test.

The uncertainty of the step is that of the fit: the curves of ``dpn`` are drawn from the covariance of their
coefficients, every other engine is fitted to resampled stretches of its record (``validation.bootstrap``). What a model
cannot describe, such as creep beyond its memory, is not part of it: such readings have no value.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tissueid.analysis import Analysis
from tissueid.analysis.readings.decay_readings import (
    DECAY_DEFINITIONS,
    LocalSystem,
    determined,
    system_decay,
    trace_figures,
)
from tissueid.analysis.readings.reading import NO_UNCERTAINTY, Reading
from tissueid.analysis.readings.step_course import Array, StepCourse
from tissueid.analysis.readings.step_readings import POINTS, StepPoints, read_points, step_readings
from tissueid.errors import CancelledError, UnusableInputError
from tissueid.identification.base import Engine, Model
from tissueid.identification.engines.dpn import DpnModel
from tissueid.identification.engines.wiener import WienerModel
from tissueid.identification.second_order import SecondOrder
from tissueid.identification.second_order_fit import SecondOrderFit
from tissueid.identification.validation.bootstrap import Method, bootstrap
from tissueid.messages import Message
from tissueid.records import Record

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
    cancelled: Callable[[], bool] | None = None,
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
        cancelled: called before each draw; the work ends if it returns True.

    Raises:
        UnusableInputError: the model does not relate force and position, has another sample rate, or cannot be
            simulated for this step.
        CancelledError: ``cancelled`` returned True.
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
            found = _draws(analysis, engine, force, course, local is None, draws, seed, progress, cancelled)
            found = found[np.isfinite(found[:, : response.size]).any(axis=1)]
            std = np.asarray(_from_rest(found[:, : response.size], course).std(axis=0, ddof=1))
            rows = np.array([read_points(row, course).values for row in found[:, : response.size]])
            covariance = np.cov(rows, rowvar=False)
            tapped = found[:, response.size :]
        except UnusableInputError as error:
            reason = Message("readings.no_draws", "the uncertainty is not known: {reason}", reason=error.message)
    points = StepPoints(points.values, covariance, points.times_s, points.reasons, reason)
    step = step_readings(points, direction=math.copysign(1.0, course.step_n))
    if creep := _no_creep(model, course):
        step = tuple(one if one.definition.name in _WITHOUT_CREEP else _without(one, creep) for one in step)
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
    known = np.isfinite(force)
    filled = np.interp(np.arange(force.size), np.flatnonzero(known), force[known])
    response = model.simulate(np.concatenate([np.full(lead, course.low_n), filled]))[lead:]
    if not np.isfinite(response).all():
        raise UnusableInputError("readings.no_simulation", "the model cannot be simulated for this step")
    return np.asarray(response, dtype=np.float64)


_WITHOUT_CREEP = frozenset({"ue_m", "ur_m", "r5"})
"""Readings that depend on the first 0.1 s after a step only, if the creep has ended before the release."""


def _without(reading: Reading, reason: str) -> Reading:
    """Return a reading without its value; an earlier reason is kept."""
    return replace(reading, found=None, reason=reading.reason if reading.found is None else reason)


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
        place = float(np.median(model.known.position))
        here = np.array([place])
        known = model.known
        figures = [float(band.value[0]) for band in (known.mass(here), known.damping(here), known.stiffness(here))]
        return LocalSystem(SecondOrder(*figures), _finite(known.log_covariance(place)))
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


def _finite(covariance: Array) -> Array | None:
    return covariance if np.isfinite(covariance).all() else None


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
    cancelled: Callable[[], bool] | None,
) -> Array:
    """Return simulated steps, and the decay of each where it is simulated, of drawn models: (draws, n + 0 or 5)."""

    def statistic(model: Model) -> Array:
        response = _simulated(model, force, course)
        return np.concatenate([response, _tap(model, analysis.record)]) if tapped else response

    model = analysis.model
    if isinstance(model, DpnModel):
        return _parametric_draws(model, statistic, draws, seed, progress, cancelled)
    record, part = analysis.record, analysis.fit_part
    method: Method = "blocks" if record[part].valid.all() else "residuals"
    bands = bootstrap(
        engine, record, part, statistic, draws, seed, method=method, progress=progress, cancelled=cancelled
    )
    return bands.draws


def _parametric_draws(
    model: DpnModel,
    statistic: Callable[[Model], Array],
    draws: int,
    seed: int,
    progress: Callable[[int, int], None] | None,
    cancelled: Callable[[], bool] | None,
) -> Array:
    """Return the statistic of models whose coefficients are drawn from their covariance, shape (draws, k).

    Raises:
        UnusableInputError: the covariance is unknown.
        CancelledError: ``cancelled`` returned True.
    """
    curves, covariance = model.known.curves, model.known.covariance
    if not np.isfinite(covariance).all():
        raise UnusableInputError("readings.no_covariance", "the fit did not converge")
    rng = np.random.Generator(np.random.PCG64(seed))
    rows = []
    for done, theta in enumerate(rng.multivariate_normal(curves.theta, covariance, draws, method="svd")):
        if cancelled is not None and cancelled():
            raise CancelledError(Message("readings.cancelled", "the readings were cancelled"))
        drawn = curves.with_theta(theta)
        known = replace(model.known, curves=drawn)
        rest = drawn.tables.rest(model.input_mean)
        rows.append(statistic(replace(model, known=known, rest_position=rest)))
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
    found = trace_figures(time, moved, acceleration, math.nan if mass is None else mass.value)
    return np.array([found[one.name] for one in DECAY_DEFINITIONS])


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
