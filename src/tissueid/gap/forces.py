"""Kinds of unmodelled force: families of forces along the motion, each scored on held-out data.

The force that the baseline lacks is regressed on depth, velocity, the past of the motion, time or current
(restoring-force surface: Masri and Caughey 1979; Kerschen et al. 2006, section 4). A family is not a model of an
effect: it is a set of shapes flexible enough for any effect of its kind, so that the stage is found even where no known
effect fits (model-error modelling: Ljung 1999). Each shape is transformed to the position by the equation of motion,
linearised along the record, because the noise of the position is white.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from tissueid.gap.dataset import DatasetTest, Purpose, interpolated
from tissueid.gap.fitting import Fit
from tissueid.gap.forward_model import simulate_test
from tissueid.gap.noise import mains_lines
from tissueid.gap.stage_substitution import StageSimulation, motion
from tissueid.language import marked
from tissueid.twin.effect import Stage

FloatArray = NDArray[np.float64]

_RIDGE = 1e-7
"""Ridge, relative to the mean square of the columns: shapes of a family can be nearly collinear."""
_PER_COLUMN = 0.002
"""Penalty of each shape, nats a sample: a larger family is not better because of its size."""
_MEMORIES_S = (0.005, 0.02, 0.08, 0.3, 1.2)
_PLAYS_M = (1e-4, 3e-4, 1e-3)
_SLIPS_M_S = (0.001, 0.005, 0.02)
_DELAYS_S = (0.015, 0.025, 0.035, 0.05, 0.07, 0.1)
_PITCHES_M = np.geomspace(0.0008, 0.008, 18)
_LONGEST_PITCH = 0.8
"""Longest period along the stroke, as a share of the travel: a longer one imitates any curved law."""
_FRAMES_HZ = np.geomspace(12.0, 120.0, 14)
_FRAME_DAMPING = 0.05
_RHYTHMS_HZ = np.concatenate([np.linspace(0.7, 2.0, 14), np.linspace(4.0, 13.0, 37)])


PERIODIC = marked("position, periodically")
DEPTH = marked("depth")
WORK = marked("accumulated work")
PAST = marked("past depth")
HYSTERESIS = marked("hysteresis")
CURRENT_AND_TIME = marked("current and time")
OF_TIME_AND_PAST = (WORK, PAST, HYSTERESIS, CURRENT_AND_TIME)
"""Kinds of force that depend on time or on the past of the motion."""


@dataclass(frozen=True)
class ForceFamily:
    """Forces of one kind. ``gain`` is the reduction of the error on held-out data, nats a sample and test."""

    stage: Stage
    kind: str
    """The quantity that the force depends on."""
    gain: float
    after: float
    """Root mean square of the remaining residual on held-out data, in noise deviations."""
    before: float
    """The same without the family, after a refit of the baseline's own parameters."""


@dataclass(frozen=True)
class Trajectory:
    """The signals of one test along its motion: arrays of shape (n,), SI."""

    test: DatasetTest
    depth: FloatArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    current: FloatArray
    time: FloatArray
    stiffness: FloatArray
    damping: FloatArray
    mass: float
    growth_stiffness: FloatArray
    growth_damping: FloatArray
    residual: FloatArray
    as_force: bool = False
    """Whether the residual is a force (N) and the shapes need no transformation to the position."""


def simulated_trajectory(
    baseline: Fit, answer: StageSimulation, test: DatasetTest, *, recorded: bool = False
) -> Trajectory:
    """Linearise the baseline along the simulated motion of a test, or along the recorded motion."""
    parameters, theta = baseline.parameters, answer.theta
    instrument, met = parameters.instrument(theta), parameters.tissue_of(theta, test)
    residual = answer.residual(test)
    # The recorded motion contains the residual that the shapes are to explain.
    position, velocity = motion(test, None if recorded else answer.predicted[test.number]["position"])
    acceleration = np.gradient(velocity, 1.0 / test.sample_rate_hz)
    depth = position - met.surface_m
    stiff = np.exp(np.clip(met.stiffness_growth_per_m * depth, -12.0, 12.0))
    damp = np.exp(np.clip(met.damping_growth_per_m * depth, -12.0, 12.0))
    tangent = met.stiffness_n_per_m * stiff * (1.0 + met.stiffness_growth_per_m * depth)
    tangent = tangent + met.damping_n_s_per_m * met.damping_growth_per_m * damp * velocity
    return Trajectory(
        test,
        depth,
        position,
        velocity,
        acceleration,
        interpolated(test.signals["current"]) if "current" in test.signals else np.zeros_like(depth),
        np.arange(depth.size) / test.sample_rate_hz,
        tangent,
        instrument.bearing_damping_n_s_per_m + met.damping_n_s_per_m * damp,
        instrument.moving_mass_kg + met.mass_kg,
        stiff,
        damp,
        residual - mains_lines(residual, test.sample_rate_hz).waveform,
    )


def input_output_trajectory(baseline: Fit, answer: StageSimulation, test: DatasetTest) -> Trajectory:
    """Return an input-output record along its motion, with the unmodelled force (Masri and Caughey 1979)."""
    parameters, theta = baseline.parameters, answer.theta
    instrument, met = parameters.instrument(theta), parameters.tissue_of(theta, test)
    position, velocity = motion(test)
    _, acceleration = motion(test, velocity)
    depth = position - met.surface_m
    ones = np.ones_like(depth)
    force = simulate_test(parameters, theta, test).current + instrument.weight_n
    missing = force - instrument.moving_mass_kg * acceleration
    missing = missing - instrument.bearing_damping_n_s_per_m * velocity - met.stiffness_n_per_m * depth
    return Trajectory(
        test,
        depth,
        position,
        velocity,
        acceleration,
        force,
        np.arange(depth.size) / test.sample_rate_hz,
        met.stiffness_n_per_m * ones,
        instrument.bearing_damping_n_s_per_m * ones,
        instrument.moving_mass_kg,
        ones,
        ones,
        np.where(np.isfinite(test.signals["position"]), missing, np.nan),
        as_force=True,
    )


@njit(cache=True)  # type: ignore[untyped-decorator]
def _displacements(forces, stiffness, damping, mass, period):  # type: ignore[no-untyped-def]
    # Displacement caused by each force (rows), by the trapezoidal rule.
    out = np.zeros_like(forces)
    half = 0.5 * period
    for k in range(forces.shape[0]):
        x, v = 0.0, 0.0
        for n in range(1, forces.shape[1]):
            force = 0.5 * (forces[k, n - 1] + forces[k, n])
            b, s = damping[n], stiffness[n]
            rate = (mass * v - half * b * v - period * s * x - half * half * s * v + period * force) / (
                mass + half * b + half * half * s
            )
            x += half * (v + rate)
            v = rate
            out[k, n] = x
    return out


@njit(cache=True)  # type: ignore[untyped-decorator]
def _play(values, radius):  # type: ignore[no-untyped-def]
    out = np.empty_like(values)
    at = values[0]
    for n in range(values.size):
        at = min(max(at, values[n] - radius), values[n] + radius)
        out[n] = at
    return out


@njit(cache=True)  # type: ignore[untyped-decorator]
def _smoothed(values, kept):  # type: ignore[no-untyped-def]
    out = np.empty_like(values)
    at = values[0]
    for n in range(values.size):
        at = kept * at + (1.0 - kept) * values[n]
        out[n] = at
    return out


@njit(cache=True)  # type: ignore[untyped-decorator]
def _resonating(values, natural, damping, period):  # type: ignore[no-untyped-def]
    # Acceleration of a frame of unit mass on a spring under a force.
    out = np.empty_like(values)
    x, v = 0.0, 0.0
    for n in range(values.size):
        a = values[n] - 2.0 * damping * natural * v - natural * natural * x
        v += period * a
        x += period * v
        out[n] = a
    return out


def force_families(
    baseline: Fit,
    answer: StageSimulation,
    tests: Sequence[DatasetTest],
    noise: float,
    *,
    on_tissue: bool,
    recorded: bool = False,
) -> list[ForceFamily]:
    """Score all families of forces on the residuals of some tests, best first.

    Args:
        baseline: the fitted baseline.
        answer: simulated position from the measured current of these tests.
        tests: all on tissue, or all without it.
        noise: standard deviation of the position, m.
        on_tissue: whether to include forces of the tissue.
        recorded: whether forces depend on the recorded motion, which contains the residual, or on the simulated one.
    """
    bare = baseline.parameters.dataset.equivalent is not None
    courses = [
        input_output_trajectory(baseline, answer, test)
        if bare
        else simulated_trajectory(baseline, answer, test, recorded=recorded)
        for test in tests
    ]
    nuisance = [_transported(course, _nuisance(course, on_tissue)) for course in courses]
    before = _left(courses, nuisance, noise)
    families: dict[tuple[Stage, str], ForceFamily] = {}
    for stage, kind, shapes in _shapes(courses, on_tissue):
        if bare and stage not in ("mechanics", "tissue"):
            continue
        columns = [
            np.concatenate([base, _transported(course, rows)])
            for course, base, rows in zip(courses, nuisance, shapes, strict=True)
        ]
        after = _left(courses, columns, noise)
        gain = before - after - _PER_COLUMN * shapes[0].shape[0]
        if not np.isfinite(gain):
            continue  # shapes that diverge, such as a resonance near the sample rate
        if (stage, kind) not in families or gain > families[stage, kind].gain:
            families[stage, kind] = ForceFamily(stage, kind, gain, float(np.exp(after)), float(np.exp(before)))
    return sorted(families.values(), key=lambda item: -item.gain)


def _left(courses: Sequence[Trajectory], columns: Sequence[FloatArray], noise: float) -> float:
    # Half the logarithm of held-out error over noise variance, with one fit to all tests.
    fitted = [course.test.serving(Purpose.FIT) & np.isfinite(course.residual) for course in courses]
    if not any(mask.any() for mask in fitted):
        fitted = [(course.test.purpose > 0) & np.isfinite(course.residual) for course in courses]
    design = np.concatenate([rows[:, mask].T for rows, mask in zip(columns, fitted, strict=True)])
    target = np.concatenate([course.residual[mask] for course, mask in zip(courses, fitted, strict=True)])
    scale = np.maximum(np.sqrt(np.mean(design**2, axis=0)), 1e-30)
    normal = (design / scale).T @ (design / scale)
    normal += _RIDGE * target.size * np.eye(scale.size)
    weights = np.linalg.solve(normal, (design / scale).T @ target) / scale
    squares, count = 0.0, 0
    for course, rows in zip(courses, columns, strict=True):
        held = (course.test.purpose > Purpose.FIT) & np.isfinite(course.residual)
        if not held.any():
            held = (course.test.purpose > 0) & np.isfinite(course.residual)
        error = course.residual[held] - weights @ rows[:, held]
        squares += float(error @ error)
        count += int(held.sum())
    return 0.5 * float(np.log(max(squares / count / noise**2, 1.0)))


def _transported(course: Trajectory, forces: FloatArray) -> FloatArray:
    period = 1.0 / course.test.sample_rate_hz
    if course.as_force:
        return forces
    return np.asarray(
        _displacements(np.ascontiguousarray(forces), course.stiffness, course.damping, course.mass, period)
    )


def _nuisance(course: Trajectory, on_tissue: bool) -> FloatArray:
    rows = [course.current, np.ones_like(course.depth), course.acceleration, course.velocity, course.depth]
    if course.as_force:
        # The force itself would explain the unmodelled force completely.
        return np.stack(rows[1:])
    if on_tissue:
        rows += [
            course.depth * course.growth_stiffness,
            course.depth**2 * course.growth_stiffness,
            course.velocity * course.growth_damping,
            course.velocity * course.depth * course.growth_damping,
        ]
    return np.stack(rows)


def _shapes(courses: Sequence[Trajectory], on_tissue: bool) -> Iterator[tuple[Stage, str, list[FloatArray]]]:
    """Yield stage, kind and shapes in each test, shape (shapes, n)."""
    yield "mechanics", marked("friction"), [_friction(course) for course in courses]
    yield "mechanics", marked("direction-dependent friction"), [_directional_friction(course) for course in courses]
    yield (
        "mechanics",
        marked("speed"),
        [np.stack([course.velocity * np.abs(course.velocity), course.velocity**3]) for course in courses],
    )
    yield "drive", marked("delay"), [np.diff(course.current, prepend=course.current[0])[None, :] for course in courses]
    squares = [np.stack([course.current * np.abs(course.current), course.current**2]) for course in courses]
    yield "coil", marked("current squared"), squares
    yield "coil", CURRENT_AND_TIME, [_by_time(course, course.current) for course in courses]
    yield "mechanics", marked("speed and time"), [_by_time(course, course.velocity) for course in courses]
    along_stroke = [course.current * _powers(course.position - 0.012, 3, 0.004) for course in courses]
    yield "coil", marked("current and position"), along_stroke
    positions = np.concatenate([course.position for course in courses])
    beyond = [np.maximum(course.position - float(np.quantile(positions, 0.97)), 0.0) for course in courses]
    stops = [np.stack([above, above * course.velocity]) for course, above in zip(courses, beyond, strict=True)]
    yield "mechanics", marked("the end of the stroke"), stops
    travelled = np.ptp(_reach(positions))
    for pitch in _PITCHES_M[_LONGEST_PITCH * travelled > _PITCHES_M]:
        waves = [np.stack(_waves(2.0 * np.pi * course.position / pitch, 2)) for course in courses]
        yield "mechanics", PERIODIC, waves
    for hz in _FRAMES_HZ:
        yield "mechanics", marked("a resonance"), [_frame(course, hz) for course in courses]
    if not on_tissue:
        yield "mechanics", marked("position"), [_powers(course.depth, 5, 0.003) for course in courses]
        return
    low, high = _reach(np.concatenate([course.depth for course in courses]))
    yield "tissue", DEPTH, [_splines(course.depth, low, high, 10) for course in courses]
    yield "tissue", marked("direction"), [_by_direction(course) for course in courses]
    yield "tissue", PAST, [_memory(course) for course in courses]
    yield "tissue", HYSTERESIS, [np.stack([_play(course.depth, radius) for radius in _PLAYS_M]) for course in courses]
    yield "tissue", WORK, [_work(course) for course in courses]
    yield "tissue", marked("acceleration and depth"), [_mass(course) for course in courses]
    yield "tissue", marked("lift-off"), [_lifted(course) for course in courses]
    for delay in _DELAYS_S:
        yield "tissue", marked("earlier stretch"), [_response(course, delay) for course in courses]
    for hz in _RHYTHMS_HZ:
        yield (
            "environment",
            marked("periodic motion of the surface"),
            [_periodic_motion(course, hz) for course in courses],
        )


def _powers(values: FloatArray, count: int, scale: float) -> FloatArray:
    return np.stack([(values / scale) ** k for k in range(1, count + 1)])


def _waves(phase: FloatArray, harmonics: int) -> list[FloatArray]:
    return [wave(k * phase) for k in range(1, harmonics + 1) for wave in (np.sin, np.cos)]


def _friction(course: Trajectory) -> FloatArray:
    rows = [np.tanh(course.velocity / slip) for slip in _SLIPS_M_S]
    return np.stack([*rows, *(course.position - _play(course.position, radius) for radius in (1e-5, 5e-5))])


def _directional_friction(course: Trajectory) -> FloatArray:
    rows = [np.tanh(np.maximum(course.velocity, 0.0) / slip) for slip in _SLIPS_M_S[1:]]
    return np.concatenate([_friction(course), np.stack(rows)])


def _by_direction(course: Trajectory) -> FloatArray:
    into = np.maximum(course.velocity, 0.0)
    return np.stack([into, into * course.depth, into * course.growth_damping])


def _memory(course: Trajectory) -> FloatArray:
    pressed = course.depth * course.growth_stiffness
    kept = [np.exp(-1.0 / (course.test.sample_rate_hz * memory)) for memory in _MEMORIES_S]
    return np.stack([_smoothed(pressed, k) for k in kept])


def _work(course: Trajectory) -> FloatArray:
    worked = np.cumsum(np.abs(course.depth * course.velocity))
    worked = worked / max(worked[-1], 1e-30)
    pressed = course.depth * course.growth_stiffness
    return np.stack(
        [pressed * worked, pressed * course.time, pressed * np.exp(-course.time), pressed * np.sqrt(course.time)]
    )


def _by_time(course: Trajectory, values: FloatArray) -> FloatArray:
    return np.stack([values * course.time, values * np.exp(-course.time), values * course.time**2])


def _mass(course: Trajectory) -> FloatArray:
    return np.stack(
        [course.acceleration * course.depth, course.velocity**2, np.maximum(course.depth, 0.0) * course.velocity**2]
    )


def _lifted(course: Trajectory) -> FloatArray:
    off = course.depth < 0.0
    return np.stack([off * course.depth, off * course.velocity, off * 1.0])


def _response(course: Trajectory, delay_s: float) -> FloatArray:
    lag = max(1, round(delay_s * course.test.sample_rate_hz))

    def late(values: FloatArray, memory_s: float) -> FloatArray:
        kept = np.exp(-1.0 / (course.test.sample_rate_hz * memory_s))
        return np.asarray(_smoothed(np.concatenate([np.full(lag, values[0]), values[:-lag]]), kept))

    fast = np.maximum(course.velocity - float(np.std(course.velocity)), 0.0)
    driven = (np.maximum(course.velocity, 0.0), fast, np.maximum(course.depth, 0.0))
    return np.stack([late(values, memory) for values in driven for memory in (0.005, 0.03)])


def _frame(course: Trajectory, hz: float) -> FloatArray:
    pushed = course.current - course.current.mean()
    period = 1.0 / course.test.sample_rate_hz
    moved = _resonating(pushed, 2.0 * np.pi * hz, _FRAME_DAMPING, period)
    return np.stack([moved, np.gradient(moved)])


def _periodic_motion(course: Trajectory, hz: float) -> FloatArray:
    slow = course.time / max(course.time[-1], 1e-9)
    rows = [wave for k in (0.5, 1.0, 1.5, 2.0) for wave in _waves(2.0 * np.pi * k * slow, 1)]
    rows += _waves(2.0 * np.pi * hz * course.time, 4 if hz < 3.0 else 1)
    return np.stack(rows) * course.stiffness


def _reach(values: FloatArray) -> tuple[float, float]:
    low, high = np.quantile(values, [0.002, 0.998])
    return float(low), max(float(high), float(low) + 1e-5)


def _splines(values: FloatArray, low: float, high: float, count: int) -> FloatArray:
    # Cubic B-splines, one fewer: their sum is a constant, which is a parameter of the baseline.
    inner = np.linspace(low, high, count - 2)
    knots = np.concatenate([[low] * 3, inner, [high] * 3])
    return np.asarray(BSpline.design_matrix(np.clip(values, low, high), knots, 3).toarray().T[1:])
