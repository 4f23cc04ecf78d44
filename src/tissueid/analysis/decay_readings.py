"""Readings of tapping probes (Myoton) from the free decay after an impulse or after the release of a step.

Published formulas (MyotonPRO user manual, Appendix 2; US patent 9808183): oscillation frequency F, here 1 / (t3 - t1)
of the acceleration peaks as in earlier devices, because the window of the manufacturer's spectrum is not published;
logarithmic decrement D = ln(a1 / a3); dynamic stiffness S = a1 m / dl; relaxation time R = tR - t1; creep
C = R / (t1 - tT). a1 is the acceleration at the largest displacement dl, at t1; a3 that one period later; the
displacement begins at tT and is zero again at tR. The published m is that of the probe; here it is the moving mass of
the model, so that S is a stiffness.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from tissueid.analysis.step_readings import (
    LARGEST_RELATIVE_STD,
    NO_UNCERTAINTY,
    SHARPEST_S,
    UNDETERMINED,
    Array,
    Definition,
    Reading,
    StepCourse,
    estimate,
)
from tissueid.errors import UnusableInputError
from tissueid.identification.impulse_response import dependence_samples, long_run_covariance
from tissueid.identification.second_order import SecondOrder
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Estimate

FREQUENCY = Definition("frequency_hz", "F", marked("oscillation frequency"), "Hz")
DECREMENT = Definition("decrement", "D", marked("logarithmic decrement of the acceleration"), "")
STIFFNESS = Definition("stiffness_n_per_m", "S", marked("dynamic stiffness"), "N/m")
RELAXATION = Definition("relaxation_s", "R", marked("relaxation time, from the largest displacement to zero"), "s")
CREEP = Definition("creep", "C", marked("relaxation time relative to deformation time"), "")
DECAY_DEFINITIONS = (FREQUENCY, DECREMENT, STIFFNESS, RELAXATION, CREEP)

_STEP = 1e-4
"""Step of the logarithms of mass, damping and stiffness in numeric derivatives."""


@dataclass(frozen=True, eq=False)
class LocalSystem:
    """A second-order system with the covariance (3, 3) of log M, log B and log K; None where it is unknown."""

    system: SecondOrder
    log_covariance: Array | None


def system_decay(local: LocalSystem) -> tuple[Reading, ...]:
    """Return the readings of the decay after an impulse, with standard deviations to first order.

    All follow from the damped oscillation in closed form. An overdamped system has a stiffness only.
    """
    theta = np.log([local.system.mass, local.system.damping, local.system.stiffness])
    stiffness = _propagated(STIFFNESS, theta, local.log_covariance, lambda m, b, k: k)
    if local.system.decay_and_frequency[1] <= 0.0:
        reason = Message(
            "readings.overdamped",
            "there is no oscillation: the damping ratio is {ratio:.2f}",
            ratio=local.system.damping_ratio,
        )
        readings = {definition.name: Reading(definition, None, reason) for definition in DECAY_DEFINITIONS} | {
            STIFFNESS.name: stiffness
        }
        return tuple(readings[definition.name] for definition in DECAY_DEFINITIONS)
    figures: tuple[tuple[Definition, Callable[[float, float, float], float]], ...] = (
        (FREQUENCY, lambda m, b, k: _poles(m, b, k)[1] / (2.0 * math.pi)),
        (DECREMENT, lambda m, b, k: _decrement(*_poles(m, b, k))),
        (STIFFNESS, lambda m, b, k: k),
        (RELAXATION, lambda m, b, k: _relaxation(*_poles(m, b, k))),
        (CREEP, lambda m, b, k: _relaxation(*_poles(m, b, k)) / _largest(*_poles(m, b, k))),
    )
    return tuple(_propagated(definition, theta, local.log_covariance, figure) for definition, figure in figures)


def _poles(mass: float, damping: float, stiffness: float) -> tuple[float, float]:
    """Return decay, 1/s, and angular frequency, rad/s, of a system; the latter at least a small number."""
    decay, squared = SecondOrder(mass, damping, stiffness).decay_and_frequency
    return decay, math.sqrt(max(squared, 1e-12))


def _decrement(decay: float, frequency: float) -> float:
    return 2.0 * math.pi * decay / frequency


def _largest(decay: float, frequency: float) -> float:
    """Return the time from the impulse to the largest displacement, s."""
    return math.atan2(frequency, decay) / frequency


def _relaxation(decay: float, frequency: float) -> float:
    """Return the time from the largest displacement to the next zero, s."""
    return math.pi / frequency - _largest(decay, frequency)


def _propagated(
    definition: Definition, theta: Array, covariance: Array | None, figure: Callable[[float, float, float], float]
) -> Reading:
    """Return a function of M, B and K with its standard deviation from the covariance (3, 3) of their logarithms."""
    value = figure(*np.exp(theta))
    if covariance is None:
        return Reading(definition, Estimate(value), NO_UNCERTAINTY)
    slopes = np.empty(3)
    for k in range(3):
        step = np.zeros(3)
        step[k] = _STEP
        slopes[k] = (figure(*np.exp(theta + step)) - figure(*np.exp(theta - step))) / (2.0 * _STEP)
    used = np.abs(slopes) > 1e-9 * max(abs(value), 1e-300)
    return determined(definition, value, float(slopes[used] @ covariance[np.ix_(used, used)] @ slopes[used]))


def determined(definition: Definition, value: float, variance: float) -> Reading:
    """Return a reading; without a value where its standard deviation is more than half of it."""
    estimated = estimate(value, variance)
    if estimated.std is None:
        return Reading(definition, estimated, NO_UNCERTAINTY)
    if estimated.std > LARGEST_RELATIVE_STD * abs(value):
        return Reading(definition, None, UNDETERMINED)
    return Reading(definition, estimated)


# -- the published formulas on a trace --------------------------------------------------------------------------


def trace_figures(time_s: Array, displacement: Array, acceleration: Array, mass_kg: float) -> dict[str, float]:
    """Return the readings of a trace by the published formulas; NaN where the trace lacks a peak.

    Args:
        time_s: from the beginning of the deformation, evenly spaced, shape (n,).
        displacement: from rest, m, positive into the tissue, shape (n,).
        acceleration: m/s2, shape (n,).
        mass_kg: mass that moves.
    """
    top = int(np.argmax(displacement))
    first = _peak(-acceleration, top, lowest=True)
    figures = dict.fromkeys((definition.name for definition in DECAY_DEFINITIONS), math.nan)
    if displacement[top] <= 0.0 or first is None:
        return figures
    figures[STIFFNESS.name] = float(-acceleration[top] * mass_kg / displacement[top])
    below = np.flatnonzero(displacement[top:] <= 0.0)
    if below.size:
        crossing = top + int(below[0])
        share = displacement[crossing - 1] / (displacement[crossing - 1] - displacement[crossing])
        zero_s = time_s[crossing - 1] + share * (time_s[crossing] - time_s[crossing - 1])
        figures[RELAXATION.name] = float(zero_s - time_s[top])
        figures[CREEP.name] = figures[RELAXATION.name] / float(time_s[top]) if time_s[top] > 0.0 else math.nan
        second = _peak(-acceleration, crossing)
        if second is not None:
            period = float(np.interp(second[0] - first[0], np.arange(time_s.size), time_s - time_s[0]))
            figures[FREQUENCY.name] = 1.0 / period
            figures[DECREMENT.name] = math.log(first[1] / second[1]) if second[1] > 0.0 < first[1] else math.nan
    return figures


def _peak(values: Array, start: int, *, lowest: bool = False) -> tuple[float, float] | None:
    """Return place, in samples, and height of the local maximum after ``start``, or nearest before it (``lowest``)."""
    rising = np.diff(values) > 0.0
    peaks = np.flatnonzero(rising[:-1] & ~rising[1:]) + 1
    wanted = peaks[peaks <= start][-1:] if lowest else peaks[peaks > start][:1]
    if lowest and not wanted.size:
        wanted = peaks[peaks > start][:1]
    if not wanted.size:
        return None
    k = int(wanted[0])
    before, here, after = values[k - 1 : k + 2]
    bend = before - 2.0 * here + after
    shift = 0.5 * (before - after) / bend if bend else 0.0
    return k + shift, float(here - 0.25 * (before - after) * shift)


# -- a recorded release -----------------------------------------------------------------------------------------


_SETTLED_S = 0.25
"""Longest part of the hold after a release that is fitted, s: several periods of tissue and probe."""
_SLOWEST_HZ, _FASTEST_HZ = 2.0, 200.0
_LEAST_PEAK = 3.0
"""Height of the second acceleration peak in standard deviations of the residual."""


@dataclass(frozen=True, eq=False)
class Release:
    """Decay after a release: times (n,) from it, s, the position (n,) relative to its end, m, and the fitted one."""

    time_s: Array
    position: Array
    fitted: Array
    readings: tuple[Reading, ...]


def recorded_release(force: Array, position: Array, course: StepCourse) -> Release:
    """Fit a damped oscillation with creep to the position after the last return of the force to its first level.

    The fit begins where the force has arrived, so that the decay is free. Frequency and decrement are those of the
    oscillation; the relaxation time is from the release to the first return to the position of the end.

    Raises:
        UnusableInputError: the force is not released suddenly, or too few samples follow.
    """
    rate = course.sample_rate_hz
    share = (force - course.low_n) / course.step_n
    middle, spread_s2, begin, end = _last_release(share, course)
    t = np.arange(end - begin) / rate
    y = position[begin:end]
    if not np.isfinite(y).all():
        raise UnusableInputError("readings.release_gap", "samples are missing after the release")
    scale = float(np.ptp(y)) or 1.0
    rest = position[max(begin, course.cycles[-1].end - y.size // 4) : course.cycles[-1].end]
    y = (y - float(np.nanmean(rest))) / scale

    def model(theta: Array) -> tuple[Array, Array]:
        decay, frequency, slow = np.exp(theta)
        fast = np.exp(-decay * t)
        columns = (np.ones(t.size), fast * np.cos(frequency * t), fast * np.sin(frequency * t), np.exp(-slow * t))
        basis = np.stack(columns, axis=1)
        gains = np.linalg.lstsq(basis, y, rcond=1e-10)[0]
        return gains, basis @ gains

    low = np.log([1.0, 2.0 * math.pi * _SLOWEST_HZ, 1.0])
    high = np.log([2e3, 2.0 * math.pi * _FASTEST_HZ, 60.0])
    starts = [
        np.log([d * f, f, 10.0]) for f in 2.0 * math.pi * np.array([8.0, 15.0, 25.0, 40.0, 70.0]) for d in (0.2, 0.7)
    ]
    start = min(starts, key=lambda s: float(np.sum((y - model(s)[1]) ** 2)))
    theta = optimize.least_squares(
        lambda s: y - model(s)[1], np.clip(start, low + 1e-6, high - 1e-6), bounds=(low, high), x_scale=0.1
    ).x
    gains, fitted = model(theta)
    whole = np.concatenate([theta, gains])

    def response(all_: Array) -> Array:
        decay, frequency, slow = np.exp(all_[:3])
        fast = np.exp(-decay * t)
        wave = all_[4] * np.cos(frequency * t) + all_[5] * np.sin(frequency * t)
        return np.asarray(all_[3] + fast * wave + all_[6] * np.exp(-slow * t))

    slopes = np.stack([_slope(response, whole, k) for k in range(whole.size)], axis=1)
    error = y - fitted
    covariance = _sandwich(slopes, error, rate)
    decay, frequency = float(np.exp(theta[0])), float(np.exp(theta[1]))
    readings = list(_release_readings(decay, frequency, covariance[:2, :2]))
    later = math.hypot(gains[1], gains[2]) * math.exp(-2.0 * math.pi * decay / frequency)
    if later < _LEAST_PEAK * float(np.std(error)):
        reason = Message("readings.no_second_peak", "the oscillation decays within one period: there is no second peak")
        readings = [Reading(reading.definition, None, reason) for reading in readings]
    rounded_s = min(decay, 0.5 / math.sqrt(spread_s2)) * spread_s2 if spread_s2 > 0.0 else 0.0
    readings[3] = _release_relaxation(t, fitted, error, (begin - middle) / rate - rounded_s)
    return Release(t, scale * y, scale * fitted, tuple(readings))


def _release_relaxation(t: Array, fitted: Array, error: Array, since_release_s: float) -> Reading:
    """Return the time from the release to the first return to the position of the end, s.

    ``since_release_s`` is the time from a sudden release of the same effect to the first fitted sample.
    """
    course = fitted * np.sign(fitted[0])
    crossed = np.flatnonzero((course[:-1] > 0.0) & (course[1:] <= 0.0))
    if not crossed.size:
        reason = Message("readings.no_return", "the position never passes its end during the decay")
        return Reading(RELAXATION, None, reason)
    k = int(crossed[0])
    fall = float(course[k] - course[k + 1])
    step = float(t[1] - t[0])
    value = since_release_s + float(t[k]) + step * float(course[k]) / fall
    return determined(RELAXATION, value, (float(np.std(error)) * step / fall) ** 2)


def _last_release(share: Array, course: StepCourse) -> tuple[float, float, int, int]:
    """Return the middle of the last return of the force, in samples, the variance of its edge, s2, the first free
    sample after it, and the end of the decay.

    An edge that is symmetric about its middle delays the zeros of exp(-a t) cos(b t) by a times its variance, to second
    order: exp(s u), averaged over the edge, is exp(s^2 var / 2).

    Raises:
        UnusableInputError: there is no sudden return, or too few samples follow.
    """
    rate, last = course.sample_rate_hz, course.cycles[-1]
    if math.isnan(last.release):
        raise UnusableInputError("readings.no_release", "the test ends before the force is released")
    smooth = np.convolve(np.nan_to_num(share), np.full(5, 0.2), "same")
    away = int(np.flatnonzero(smooth[: last.end] > 0.25)[-1])
    settled = np.flatnonzero(smooth[away : last.end] < 0.05)
    if not settled.size or settled[0] > SHARPEST_S * rate:
        raise UnusableInputError(
            "readings.slow_return", "the force returns too slowly for a free decay of the position"
        )
    begin = int(away + settled[0])
    end = min(last.end - round(0.5 * SHARPEST_S * rate), begin + round(_SETTLED_S * rate))
    if end - begin < round(2.0 * SHARPEST_S * rate):
        raise UnusableInputError("readings.short_release", "the test ends too soon after the release")
    width = round(SHARPEST_S * rate)
    first = max(0, away - width)
    level = float(np.median(smooth[max(0, first - width) : first + 1]))
    if level < 0.25:
        raise UnusableInputError("readings.no_release", "the test ends before the force is released")
    edge = smooth[first : begin + 1] / level
    k = int(np.flatnonzero(edge > 0.5)[-1])
    middle = k + (edge[k] - 0.5) / (edge[k] - edge[k + 1])
    reach = math.ceil(1.5 * (edge.size - 1 - middle))
    around = slice(max(0, first + k - reach), first + k + reach + 2)
    fall = np.nan_to_num(share[around]) / level
    offset = np.arange(around.start, around.start + fall.size) - (first + float(middle))
    moment = 2.0 * float(np.sum(offset * (fall - (offset < 0.0))))  # second moment about the middle, by parts
    return first + float(middle), max(moment, 0.0) / rate**2, begin, end


def _slope(response: Callable[[Array], Array], at: Array, k: int) -> Array:
    step = np.zeros(at.size)
    step[k] = 1e-5 * max(1.0, abs(float(at[k])))
    return np.asarray((response(at + step) - response(at - step)) / (2.0 * step[k]), dtype=np.float64)


def _sandwich(slopes: Array, error: Array, rate: float) -> Array:
    """Return the covariance (p, p) of a least-squares fit for autocorrelated errors (n,)."""
    size = np.sqrt(np.sum(slopes**2, axis=0))
    size[size == 0.0] = 1.0
    scaled = slopes / size
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-12, hermitian=True)
    influence = (scaled @ inverse) * error[:, None]
    n, p = slopes.shape
    covariance = long_run_covariance(influence, dependence_samples(error, rate)) * n / max(1, n - p)
    return np.asarray(covariance / np.outer(size, size), dtype=np.float64)


def _release_readings(decay: float, frequency: float, covariance: Array) -> tuple[Reading, ...]:
    """Return the readings of a release; ``covariance`` (2, 2) is of the logarithms of decay and frequency."""
    no_mass = Message(
        "readings.no_mass", "the release gives no mass: the identified model gives the stiffness of the decay"
    )
    no_tap = Message("readings.no_tap", "a release has no deformation time: the identified model gives it")
    decrement = _decrement(decay, frequency)
    contrast = np.array([1.0, -1.0])
    return (
        determined(
            FREQUENCY, frequency / (2.0 * math.pi), float(covariance[1, 1]) * (frequency / (2.0 * math.pi)) ** 2
        ),
        determined(DECREMENT, decrement, float(contrast @ covariance @ contrast) * decrement**2),
        Reading(STIFFNESS, None, no_mass),
        Reading(RELAXATION, None, ""),
        Reading(CREEP, None, no_tap),
    )
