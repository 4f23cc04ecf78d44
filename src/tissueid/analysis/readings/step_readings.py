"""Readings of suction probes (Cutometer, DermaLab) from the course of the position during steps of force.

Ue is the displacement 0.1 s after the load, Uf that at the end of the hold, Uv = Uf - Ue the creep between, Ur the
recovery 0.1 s after the release and Ua that at the end of the cycle (Chen 2010, Fig. 1.2; the time of 0.1 s: J. Cosmet.
Sci. 67 (2016) 37). R0 to R9 are made of them; R3, R4 and R9 compare cycles (Dobrev, Skin Res. Technol. 11 (2005) 120).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tissueid.analysis.readings.reading import (
    LARGEST_RELATIVE_STD,
    NO_UNCERTAINTY,
    Definition,
    Reading,
    estimate,
)
from tissueid.analysis.readings.step_course import SHARPEST_S, Array, StepCourse, StepCycle
from tissueid.language import marked
from tissueid.messages import Message

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
        place = places[name]
        if isinstance(place, str):
            reasons[k] = place
            continue
        begin, end = max(0, math.ceil(place[0])), min(position.size, math.floor(place[1]) + 1)
        part = position[begin:end]
        known = part[np.isfinite(part)]
        if known.size < max(1, 0.5 * part.size):
            reasons[k] = Message("readings.not_received", "the samples at this time were not received")
            continue
        values[k], times[k] = float(known.mean()), 0.5 * (begin + end - 1) / rate
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
        return _too_slow(cycle.rise_s)
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


def _too_slow(seconds: float) -> Message:
    return Message(
        "readings.slow_rise",
        "the force rises within {seconds:.2g} s, which is too slow to separate displacement and creep",
        seconds=seconds,
    )


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
    return tuple(_reading(points, direction, *one) for one in DEFINITIONS)


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
    found = estimate(n, _variance(slopes, points.covariance))
    return Reading(definition, found, "" if found.std is not None else points.no_covariance)


_NOTHING_BELOW = Message("readings.no_denominator", "the displacement that it is divided by is within the noise")


def _weights(terms: _Terms) -> Array:
    return np.array([terms.get(name, 0.0) for name in POINTS])


def _dot(weights: Array, values: Array) -> float:
    used = weights != 0.0
    return float(weights[used] @ values[used])


def _variance(weights: Array, covariance: Array) -> float:
    used = weights != 0.0
    return float(weights[used] @ covariance[np.ix_(used, used)] @ weights[used])
