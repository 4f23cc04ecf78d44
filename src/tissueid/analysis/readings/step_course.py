"""Steps of force in a record: levels, and the times of load and release."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError

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
    known = np.isfinite(force)
    if np.mean(known) < 0.5:
        raise UnusableInputError("readings.no_samples", "fewer than half of the samples were received")
    return np.interp(np.arange(force.size), np.flatnonzero(known), force[known])


def _smooth(share: Array, sample_rate_hz: float) -> Array:
    width = max(1, round(_SMOOTHED_S * sample_rate_hz)) | 1
    padded = np.pad(share, width // 2, mode="edge")
    return np.convolve(padded, np.full(width, 1.0 / width), "valid")


def _cycles(share: Array, rate: float) -> list[StepCycle]:
    """Return the cycles of a smoothed force (n,), relative to the step."""
    ups, downs = _edges(share)
    found = []
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
        found.append(StepCycle(rise, hold_end, release, following, (top - start) / rate, release_s))
    return found


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
