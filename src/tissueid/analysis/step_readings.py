"""One reading of a commercial probe: a value with its uncertainty, or the reason why there is none."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.messages import Message, stored
from tissueid.records import Estimate

NOT_COMPARABLE = Message(
    "readings.not_comparable",
    "The readings are those of this instrument's probe and force. A suction probe applies negative pressure through an "
    "aperture, and a tapping probe has a mass of its own: lengths, frequencies and stiffness are not comparable with "
    "theirs in absolute terms; compare the ratios R2, R5, R6 and R7. Research use only.",
)
"""What every table of readings says about its use."""

LARGEST_RELATIVE_STD = 0.5
"""Relative standard deviation above which a ratio or a property of a decay counts as undetermined."""


@dataclass(frozen=True)
class Definition:
    """Name in files, symbol, meaning and SI unit of a reading."""

    name: str
    symbol: str
    meaning: str
    si_unit: str


@dataclass(frozen=True)
class Reading:
    """A reading in SI units.

    ``estimate`` is None where there is no value; its ``std`` is None where the uncertainty is unknown. ``reason`` says
    why in both cases.
    """

    definition: Definition
    estimate: Estimate | None
    reason: str = ""

    @property
    def value(self) -> float | None:
        """The value, SI; None if there is none."""
        return None if self.estimate is None else self.estimate.value

    def as_dict(self) -> dict[str, Any]:
        """Return symbol, unit, value, standard deviation and reason for JSON."""
        return {
            "symbol": self.definition.symbol,
            "unit": self.definition.si_unit,
            "value": self.value,
            "std": None if self.estimate is None else self.estimate.std,
            "reason": str(self.reason) or None,
            "reason_message": stored(self.reason) if self.reason else None,
        }


def as_answer(readings: Iterable[Reading]) -> dict[str, Any]:
    """Return readings by name for JSON."""
    return {reading.definition.name: reading.as_dict() for reading in readings}


def estimate(value: float, variance: float) -> Estimate:
    """Return a value with the root of its variance; without one where that is not finite."""
    return Estimate(value, math.sqrt(max(variance, 0.0)) if math.isfinite(variance) else None)


UNDETERMINED = Message(
    "readings.undetermined", "its standard deviation is more than half of its value: the data do not determine it"
)
NO_UNCERTAINTY = Message("readings.no_uncertainty", "the fit gives no uncertainty")


Array = NDArray[np.float64]

_SMOOTHED_S = 0.004
"""Length of the moving mean of the force that finds its edges: shorter than a rise, longer than the noise."""
_EDGE = 0.1
"""Distance from a level, as a share of the step, at which an edge begins or ends."""
_LEAST_HELD = 0.6
"""Least share of the samples within ``_EDGE`` of one of the two levels; noise has about a tenth, a sine half."""
SHARPEST_S = 0.05
"""Longest rise or release that counts as a step: half of the time at which the elastic part is read."""


@dataclass(frozen=True)
class StepCycle:
    """One load and release; times in samples from the start of the record.

    ``rise`` and ``release`` are where the force passes the middle of the step; a smooth step acts like a sudden one
    there. ``hold_end`` is the last sample before the release begins, ``end`` that of the cycle. ``rise_s`` and
    ``release_s`` are the lengths of the edges. Without a release, it and ``release_s`` are NaN.
    """

    rise: float
    hold_end: int
    release: float
    end: int
    rise_s: float
    release_s: float


@dataclass(frozen=True)
class StepCourse:
    """Cycles of a step test with the two levels of its force, N; ``low_n`` is the level before the first step."""

    low_n: float
    high_n: float
    cycles: tuple[StepCycle, ...]
    sample_rate_hz: float

    @property
    def step_n(self) -> float:
        """Height of the step, N."""
        return self.high_n - self.low_n

    @property
    def hold_s(self) -> float:
        """Time from the first load to its release, s."""
        first = self.cycles[0]
        return (first.hold_end - first.rise) / self.sample_rate_hz


def find_steps(force: Array, sample_rate_hz: float) -> StepCourse:
    """Find load and release in a force (n,), N; NaN is a sample that was not received.

    Raises:
        UnusableInputError: the force is not held at two levels, or never steps from the first to the second.
    """
    force = _filled(force)
    low, high = (float(np.quantile(force, share)) for share in (0.02, 0.98))
    span = high - low
    if span <= 0.0:
        raise _no_step()
    low, high = float(np.median(force[force < low + 0.25 * span])), float(np.median(force[force > high - 0.25 * span]))
    first = float(np.median(force[: max(1, round(0.02 * sample_rate_hz))]))
    if abs(first - high) < abs(first - low):
        low, high = high, low
    share = (force - low) / (high - low)
    held = (np.abs(share) < _EDGE) | (np.abs(share - 1.0) < _EDGE)
    if float(np.mean(held)) < _LEAST_HELD:
        raise _no_step()
    cycles = tuple(_cycles(_smooth(share, sample_rate_hz), sample_rate_hz))
    if not cycles:
        raise _no_step()
    return StepCourse(low, high, cycles, sample_rate_hz)


def _no_step() -> UnusableInputError:
    return UnusableInputError(
        "readings.no_step",
        "the force of this test is not a step that is held: record one with the stimulus {stimulus}",
        stimulus="step_hold",
    )


def _filled(force: Array) -> Array:
    """Return a force with missing samples interpolated, which is only used to find the edges.

    Raises:
        UnusableInputError: fewer than half of the samples were received.
    """
    received = np.isfinite(force)
    if np.mean(received) < 0.5:
        raise UnusableInputError("readings.no_samples", "fewer than half of the samples were received")
    return np.interp(np.arange(force.size), np.flatnonzero(received), force[received])


def _smooth(share: Array, sample_rate_hz: float) -> Array:
    width = max(1, round(_SMOOTHED_S * sample_rate_hz)) | 1
    padded = np.pad(share, width // 2, mode="edge")
    return np.convolve(padded, np.full(width, 1.0 / width), "valid")


def _cycles(share: Array, rate: float) -> list[StepCycle]:
    """Return the cycles of a smoothed force (n,), relative to the step."""
    ups, downs = _edges(share)
    cycles = []
    for number, (start, top) in enumerate(ups):
        following = share.size - 1
        if number + 1 < len(ups):
            following = _before(*ups[number + 1], rate)
        later = [edge for edge in downs if edge[0] >= top and edge[1] <= following]
        rise = _crossing(share, start, top)
        if later:
            away, bottom = later[0]
            release, release_s, hold_end = (
                _crossing(share, away, bottom),
                (bottom - away) / rate,
                _before(away, bottom, rate),
            )
        else:
            release, release_s, hold_end = float("nan"), float("nan"), following
        cycles.append(StepCycle(rise, hold_end, release, following, (top - start) / rate, release_s))
    return cycles


def _before(start: int, end: int, rate: float) -> int:
    """Return the last sample before an edge of which ``start`` and ``end`` are at a tenth of its height."""
    return start - round(min(0.5 * (end - start), 0.5 * SHARPEST_S * rate) + _SMOOTHED_S * rate)


def _edges(share: Array) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Return (last sample at the old level, first sample at the new level) of every load and of every full release."""
    state = np.zeros(share.size, dtype=np.int8)  # 1 at the upper level, -1 at the lower one, 0 between
    state[share > 1.0 - _EDGE], state[share < _EDGE] = 1, -1
    at = np.flatnonzero(state)
    changes = np.flatnonzero(np.diff(state[at]))
    pairs = [(int(at[k]), int(at[k + 1])) for k in changes]
    return [p for p in pairs if state[p[1]] == 1], [p for p in pairs if state[p[1]] == -1]


def _crossing(share: Array, first: int, last: int) -> float:
    """Return where an edge passes the middle of the step, in samples."""
    part = share[first : last + 1] - 0.5
    crossed = np.flatnonzero(np.sign(part[:-1]) != np.sign(part[1:]))
    k = int(crossed[0])
    return first + k + float(part[k] / (part[k] - part[k + 1]))


ELASTIC_S = 0.1
"""Time after a step at which the elastic part is read, s."""
WINDOW_S = 0.01
"""Length of the mean that one position is read from, s."""
_BASELINE_S = 0.1
"""Longest mean of the position before the first step, s."""
_FEWEST_WINDOWS = 10
"""Fewest windows before the first step from which noise and drift are estimated."""

POINTS = ("start", "elastic", "final", "retracted", "relaxed", "last_final", "last_relaxed")
"""Positions that the readings are made of: before the first step, 0.1 s after it, at the end of the hold, 0.1 s after
the release, at the end of the cycle, and the third and fifth of the last cycle."""

_Terms = dict[str, float]
_UE: _Terms = {"elastic": 1.0, "start": -1.0}
_UV: _Terms = {"final": 1.0, "elastic": -1.0}
_UF: _Terms = {"final": 1.0, "start": -1.0}
_UR: _Terms = {"final": 1.0, "retracted": -1.0}
_UA: _Terms = {"final": 1.0, "relaxed": -1.0}

DEFINITIONS: tuple[tuple[Definition, _Terms, _Terms | None], ...] = (
    (Definition("ue_m", "Ue", marked("immediate displacement, 0.1 s after the load"), "m"), _UE, None),
    (Definition("uv_m", "Uv", marked("creep from then to the end of the hold"), "m"), _UV, None),
    (Definition("uf_m", "Uf", marked("displacement at the end of the hold"), "m"), _UF, None),
    (Definition("ur_m", "Ur", marked("recovery 0.1 s after the release"), "m"), _UR, None),
    (Definition("ua_m", "Ua", marked("recovery at the end of the cycle"), "m"), _UA, None),
    (Definition("r0_m", "R0", marked("Uf of the first cycle"), "m"), _UF, None),
    (
        Definition("r1_m", "R1", marked("displacement that remains, Uf - Ua"), "m"),
        {"relaxed": 1.0, "start": -1.0},
        None,
    ),
    (Definition("r2", "R2", marked("gross elasticity, Ua/Uf"), ""), _UA, _UF),
    (
        Definition("r3_m", "R3", marked("largest displacement of the last cycle"), "m"),
        {"last_final": 1.0, "start": -1.0},
        None,
    ),
    (
        Definition("r4_m", "R4", marked("displacement that remains after the last cycle"), "m"),
        {"last_relaxed": 1.0, "start": -1.0},
        None,
    ),
    (Definition("r5", "R5", marked("net elasticity, Ur/Ue"), ""), _UR, _UE),
    (Definition("r6", "R6", marked("creep relative to immediate displacement, Uv/Ue"), ""), _UV, _UE),
    (Definition("r7", "R7", marked("biological elasticity, Ur/Uf"), ""), _UR, _UF),
    (Definition("r8_m", "R8", marked("recovery of the first cycle, Ua"), "m"), _UA, None),
    (Definition("r9_m", "R9", marked("fatigue, R3 - R0"), "m"), {"last_final": 1.0, "final": -1.0}, None),
)
"""Every reading as a sum of positions, or as a ratio of two sums."""


@dataclass(frozen=True, eq=False)
class StepPoints:
    """The positions ``POINTS`` (7,), m, with their covariance (7, 7) and their times (7,), s.

    A position is NaN where ``reasons`` says why it cannot be read. The covariance is NaN where it is unknown, for the
    reason ``no_covariance``.
    """

    values: Array
    covariance: Array
    times_s: Array
    reasons: tuple[str, ...]
    no_covariance: str = ""


def read_points(position: Array, course: StepCourse) -> StepPoints:
    """Read the positions of a course from a position (n,), m, without uncertainty.

    NaN in the position is a sample that is not known.
    """
    rate, first, last = course.sample_rate_hz, course.cycles[0], course.cycles[-1]
    half = 0.5 * WINDOW_S * rate
    before = first.rise - max(half, 0.5 * first.rise_s * rate + half)
    span = min(_BASELINE_S * rate, before)
    places: dict[str, tuple[float, float] | str] = {
        "start": (before - span, before) if span >= half else _too_short(),
        "elastic": _after_load(first, half, rate),
        "final": (first.hold_end - 2.0 * half, first.hold_end),
        "retracted": _after_release(first, half, rate),
        "relaxed": _at_end(first, half),
        "last_final": (last.hold_end - 2.0 * half, last.hold_end),
        "last_relaxed": _at_end(last, half),
    }
    if last is first:
        places["last_final"] = places["last_relaxed"] = _ONE_CYCLE
    if first.hold_end - first.rise < ELASTIC_S * rate + 2.0 * half:
        places["elastic"] = _too_short()
    values, times, reasons = np.full(len(POINTS), np.nan), np.full(len(POINTS), np.nan), [""] * len(POINTS)
    for k, name in enumerate(POINTS):
        interval = places[name]
        if isinstance(interval, str):
            reasons[k] = interval
            continue
        begin, end = max(0, math.ceil(interval[0])), min(position.size, math.floor(interval[1]) + 1)
        part = position[begin:end]
        received = part[np.isfinite(part)]
        if received.size < max(1, 0.5 * part.size):
            reasons[k] = Message("readings.not_received", "the samples at this time were not received")
            continue
        values[k], times[k] = float(received.mean()), 0.5 * (begin + end - 1) / rate
    unknown = np.full((len(POINTS), len(POINTS)), np.nan)
    return StepPoints(values, unknown, times, tuple(reasons), NO_UNCERTAINTY)


_ONE_CYCLE = Message(
    "readings.one_cycle",
    "it compares repeated cycles and the test has one: play {stimulus} with cycles=5",
    stimulus="step_hold",
)
_NO_RELEASE = Message("readings.no_release", "the test ends before the force is released")


def _too_short() -> Message:
    return Message(
        "readings.short_hold",
        "the force is held for less than {seconds:g} s, the time of this reading",
        seconds=ELASTIC_S,
    )


def _after_load(cycle: StepCycle, half: float, rate: float) -> tuple[float, float] | str:
    if cycle.rise_s > SHARPEST_S:
        return Message(
            "readings.slow_rise",
            "the force rises within {seconds:.2g} s, which is too slow to separate displacement and creep",
            seconds=cycle.rise_s,
        )
    middle = cycle.rise + ELASTIC_S * rate
    return middle - half, middle + half


def _after_release(cycle: StepCycle, half: float, rate: float) -> tuple[float, float] | str:
    if math.isnan(cycle.release):
        return _NO_RELEASE
    if cycle.release_s > SHARPEST_S:
        return Message(
            "readings.slow_release",
            "the force is released within {seconds:.2g} s, or in two steps: play {stimulus} with cycles=1",
            seconds=cycle.release_s,
            stimulus="step_hold",
        )
    middle = cycle.release + ELASTIC_S * rate
    return (middle - half, middle + half) if middle + half <= cycle.end else _too_short()


def _at_end(cycle: StepCycle, half: float) -> tuple[float, float] | str:
    if math.isnan(cycle.release):
        return _NO_RELEASE
    return cycle.end - 2.0 * half, float(cycle.end)


def recorded_points(position: Array, course: StepCourse) -> StepPoints:
    """Read the positions of a recorded course, with a covariance from its noise floor and drift.

    Both are those of the position (n,), m, before the first step. The noise floor is the standard deviation of means
    over ``WINDOW_S``; each reading is one such mean. The drift is the slope there, or its standard deviation where that
    is larger; it adds to a position in proportion to its distance in time from the first step.
    """
    points = read_points(position, course)
    rate = course.sample_rate_hz
    width = max(1, round(WINDOW_S * rate))
    before = position[: max(0, math.floor(course.cycles[0].rise - 0.5 * WINDOW_S * rate))]
    windows = before[before.size % width :].reshape(-1, width)
    windows = windows[np.isfinite(windows).all(axis=1)]
    if len(windows) < _FEWEST_WINDOWS:
        reason = Message(
            "readings.short_baseline",
            "noise and drift are not known: the position before the first step lasts less than {seconds:g} s",
            seconds=_FEWEST_WINDOWS * WINDOW_S,
        )
        return StepPoints(points.values, points.covariance, points.times_s, points.reasons, reason)
    means = windows.mean(axis=1)
    t = (np.arange(means.size) - 0.5 * (means.size - 1)) * width / rate
    slope = float(t @ means / (t @ t))
    rest = means - means.mean() - slope * t
    variance = float(rest @ rest) / (means.size - 2)
    correlation = min(max(float(rest[:-1] @ rest[1:]) / float(rest @ rest), 0.0), 0.95) if variance > 0.0 else 0.0
    widened = (1.0 + correlation) / (1.0 - correlation)
    drift = math.sqrt(slope**2 + widened * variance / float(t @ t))
    span = max(1, min(means.size, round(_BASELINE_S / WINDOW_S)))
    noise = np.full(len(POINTS), variance)
    noise[0] = variance * widened / span
    away = np.nan_to_num(points.times_s - points.times_s[0])
    covariance = np.diag(noise) + drift**2 * np.outer(away, away)
    return StepPoints(points.values, covariance, points.times_s, points.reasons)


def step_readings(points: StepPoints, *, direction: float = 1.0) -> tuple[Reading, ...]:
    """Return all readings of the positions; ``direction`` is -1 for a step to a lower force."""
    return tuple(_reading(points, direction, *row) for row in DEFINITIONS)


def _reading(
    points: StepPoints, direction: float, definition: Definition, above: _Terms, below: _Terms | None
) -> Reading:
    for name in (*above, *(below or ())):
        if reason := points.reasons[POINTS.index(name)]:
            return Reading(definition, None, reason)
    top = direction * _weights(above)
    n, slopes = _dot(top, points.values), top
    if below is not None:
        bottom = direction * _weights(below)
        d = _dot(bottom, points.values)
        spread = _variance(bottom, points.covariance)
        if d == 0.0 or spread > (LARGEST_RELATIVE_STD * d) ** 2:
            return Reading(definition, None, _NOTHING_BELOW)
        n = n / d
        slopes = (top - n * bottom) / d
    estimated = estimate(n, _variance(slopes, points.covariance))
    return Reading(definition, estimated, "" if estimated.std is not None else points.no_covariance)


_NOTHING_BELOW = Message("readings.no_denominator", "the displacement that it is divided by is within the noise")


def _weights(terms: _Terms) -> Array:
    return np.array([terms.get(name, 0.0) for name in POINTS])


def _dot(weights: Array, values: Array) -> float:
    used = weights != 0.0
    return float(weights[used] @ values[used])


def _variance(weights: Array, covariance: Array) -> float:
    used = weights != 0.0
    return float(weights[used] @ covariance[np.ix_(used, used)] @ weights[used])
