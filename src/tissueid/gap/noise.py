"""The sensor noise of each channel, from what is recorded at the top of its spectrum."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import firwin, welch

from tissueid.gap.driving import bridged
from tissueid.gap.observed import CHANNELS, LEAST_NOISE, ObservedTest

FloatArray = NDArray[np.float64]

ALIKE = 1.25
"""Estimates of one noise lie within this ratio."""
COARSE_M = 2e-6
"""Steps of a position reading that are coarser than this are an effect; finer ones are the converter's."""
_LAGS = 6
"""Samples over which a channel follows the signal upstream of it, as far as its noise is concerned."""
_STRETCH = 256
"""Samples of a stretch over which a spectrum is taken."""
_MIDDLE_HALF = 0.693
"""Mean size of the middle half of a normal variable's sizes, in standard deviations."""


def channel_noise(tests: Sequence[ObservedTest]) -> dict[str, float]:
    """Standard deviation of each channel's white noise, SI: the least that any test shows.

    From the uppermost sixth of the spectrum, after what follows linearly from the signal upstream (voltage from the
    command, current from the voltage and the motion) has been taken away there; and, where a test was repeated, from
    half of the repeats' difference.
    """
    noise: dict[str, float] = {}
    for name in CHANNELS:
        levels = [_level_by_neighbours(test) for test in tests if name == "voltage" and name in test.signals]
        levels += [_level(values) for test in tests for values in _without_upstream(test, name)]
        for test in tests:
            for first in tests:
                if test.repeat_of == first.number and name in test.signals and name in first.signals:
                    size = min(test.signals[name].size, first.signals[name].size)
                    levels.append(_level(test.signals[name][:size] - first.signals[name][:size]) / np.sqrt(2.0))
        levels = [level for level in levels if level > 0.0]
        if not levels and any(name in test.signals for test in tests):
            noise[name] = LEAST_NOISE[name]
        if levels:
            # Each is a little uncertain, so that the least of many would be too low; what is higher is no noise alone.
            noise[name] = float(np.mean([level for level in levels if level <= ALIKE * min(levels)]))
    if "position" in noise:
        # Coarse steps make noise of their own, which is no noise of the sensor.
        steps = max(coarse_step(test.signals["position"]) for test in tests)
        noise["position"] = max(np.sqrt(max(noise["position"] ** 2 - steps**2 / 12.0, 0.0)), 0.05 * steps)
    return noise


def _without_upstream(test: ObservedTest, name: str) -> list[FloatArray]:
    if name not in test.signals:
        return []
    values = test.signals[name]
    upstream = {
        "voltage": [test.command],
        "current": [test.signals.get("voltage", test.command)],
        "position": [],
    }[name]
    columns = [np.roll(source, lag) for source in upstream for lag in range(_LAGS)]
    if name == "current":
        # The back-EMF, from motion without the position's noise.
        motion = _smooth(test.signals["position"])
        columns += [np.roll(motion, lag) for lag in range(-_LAGS // 2, _LAGS // 2 + 1)]
    if not columns:
        return [values]
    known = np.isfinite(values) & np.all([np.isfinite(column) for column in columns], axis=0)
    known[:_LAGS] = False
    known[-_LAGS:] = False
    if known.sum() < 256:
        return []
    design = np.stack([column[known] for column in columns] + [np.ones(int(known.sum()))], axis=1)
    design /= np.linalg.norm(design, axis=0) + np.finfo(np.float64).tiny
    found, *_ = np.linalg.lstsq(design, values[known], rcond=1e-10)
    return [values, values[known] - design @ found]


def _smooth(values: FloatArray) -> FloatArray:
    # Below a third of half the sample rate; both ends go on by odd reflection.
    kernel = firwin(41, 0.35)
    whole = bridged(values)
    before, after = 2.0 * whole[0] - whole[20:0:-1], 2.0 * whole[-1] - whole[-2:-22:-1]
    return np.convolve(np.concatenate([before, whole, after]), kernel, "valid")


def coarse_step(values: FloatArray) -> float:
    """The step of a position reading, m: the least distance of two values that occur.

    0 where that is finer than the noise of a good sensor.
    """
    distances = np.diff(np.unique(values[np.isfinite(values)]))
    step = float(np.min(distances[distances > 1e-7], initial=np.inf))
    return step if COARSE_M < step < np.inf else 0.0


def _level_by_neighbours(test: ObservedTest) -> float:
    # A voltage that is any static function of the command, however bent, is straight over three neighbouring commands.
    known = np.isfinite(test.signals["voltage"])
    order = np.argsort(test.command[known], kind="stable")
    at, values = test.command[known][order], test.signals["voltage"][known][order]
    apart = at[2:] - at[:-2]
    share = np.where(apart > 0.0, (at[1:-1] - at[:-2]) / np.where(apart > 0.0, apart, 1.0), 0.5)
    bend = values[1:-1] - (1.0 - share) * values[:-2] - share * values[2:]
    size = np.sort(np.abs(bend) / np.sqrt(1.0 + share**2 + (1.0 - share) ** 2))
    if size.size < 256 or not np.ptp(test.command) > 0.0:
        return 0.0
    # The mean of the middle half: a median would be one of the converter's few steps.
    return float(np.mean(size[size.size // 4 : 3 * size.size // 4])) / _MIDDLE_HALF


def _level(values: FloatArray) -> float:
    if np.isfinite(values).sum() < _STRETCH:
        return 0.0
    known = bridged(values)[values.size // 10 :]
    if known.size < _STRETCH:
        return 0.0
    # The median over stretches passes by jumps, where a stimulus begins or samples were lost.
    _, density = welch(known, 1.0, nperseg=_STRETCH, average="median")
    return float(np.sqrt(0.5 * np.mean(density[round(0.84 * density.size) :])))
