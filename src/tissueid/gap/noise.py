"""Sensor noise of each channel, from the top of the recorded spectrum."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import firwin, welch

from tissueid.gap.dataset import CHANNELS, LEAST_NOISE, DatasetTest
from tissueid.gap.excitation import interpolated

FloatArray = NDArray[np.float64]

ALIKE = 1.25
"""Largest ratio between estimates of the same noise."""
COARSE_M = 2e-6
"""Step of a position reading above which it is an effect, m; finer steps are the converter's."""
_LAGS = 6
"""Samples over which a channel follows its upstream signal in the estimate of the noise."""
_BLOCK = 256
"""Samples of a block for a spectrum."""
_MIDDLE_HALF = 0.693
"""Mean absolute value of the middle half of normal deviates, in standard deviations."""


def channel_noise(tests: Sequence[DatasetTest]) -> dict[str, float]:
    """Return the standard deviation of each channel's white noise, SI: the least of all tests.

    Estimated from the top sixth of the spectrum, without the part that follows linearly from the upstream signal
    (voltage from the command, current from voltage and motion); and, for repeated tests, from half of the difference of
    the repeats.
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
            # Average similar estimates: the least of many would be too low, and larger ones contain more than noise.
            noise[name] = float(np.mean([level for level in levels if level <= ALIKE * min(levels)]))
    if "position" in noise:
        # Quantization noise of coarse steps is not sensor noise.
        steps = max(coarse_step(test.signals["position"]) for test in tests)
        noise["position"] = max(np.sqrt(max(noise["position"] ** 2 - steps**2 / 12.0, 0.0)), 0.05 * steps)
    return noise


def _without_upstream(test: DatasetTest, name: str) -> list[FloatArray]:
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
        # The back-EMF, from motion without the noise of the position.
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
    # Low-pass at a third of the Nyquist frequency, with odd reflection at both ends.
    kernel = firwin(41, 0.35)
    whole = interpolated(values)
    before, after = 2.0 * whole[0] - whole[20:0:-1], 2.0 * whole[-1] - whole[-2:-22:-1]
    return np.convolve(np.concatenate([before, whole, after]), kernel, "valid")


def coarse_step(values: FloatArray) -> float:
    """Return the step of a position reading, m: the least distance of two occurring values.

    0 where it is finer than the noise of a good sensor.
    """
    distances = np.diff(np.unique(values[np.isfinite(values)]))
    step = float(np.min(distances[distances > 1e-7], initial=np.inf))
    return step if COARSE_M < step < np.inf else 0.0


def _level_by_neighbours(test: DatasetTest) -> float:
    # A static function of the command is linear over three neighbouring commands.
    known = np.isfinite(test.signals["voltage"])
    order = np.argsort(test.command[known], kind="stable")
    at, values = test.command[known][order], test.signals["voltage"][known][order]
    span = at[2:] - at[:-2]
    share = np.where(span > 0.0, (at[1:-1] - at[:-2]) / np.where(span > 0.0, span, 1.0), 0.5)
    bend = values[1:-1] - (1.0 - share) * values[:-2] - share * values[2:]
    size = np.sort(np.abs(bend) / np.sqrt(1.0 + share**2 + (1.0 - share) ** 2))
    if size.size < 256 or not np.ptp(test.command) > 0.0:
        return 0.0
    # The mean of the middle half: a median would be one of the few steps of the converter.
    return float(np.mean(size[size.size // 4 : 3 * size.size // 4])) / _MIDDLE_HALF


def _level(values: FloatArray) -> float:
    if np.isfinite(values).sum() < _BLOCK:
        return 0.0
    known = interpolated(values)[values.size // 10 :]
    if known.size < _BLOCK:
        return 0.0
    # The median over blocks ignores jumps at the start of a stimulus or at lost samples.
    _, density = welch(known, 1.0, nperseg=_BLOCK, average="median")
    return float(np.sqrt(0.5 * np.mean(density[round(0.84 * density.size) :])))
