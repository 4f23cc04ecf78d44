"""Disturbances that do not depend on the command: mains lines, motion in quiet tests, lost samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.gap.dataset import Dataset, DatasetTest
from tissueid.gap.excitation import interpolated
from tissueid.gap.noise import coarse_step

FloatArray = NDArray[np.float64]

MAINS_HZ = (50.0, 60.0)
_OFF_HZ = 0.3
_HARMONICS = 12
_LINE_POWER_RATIO = 30.0
"""Least power of a line relative to the median of its neighbours: exceeded by chance once in 10^9 (2^-30)."""
_NEIGHBOURS = (3, 14)
_BLOCK_S = 0.25
_MOST_LAG = 60
_MOST_REMAINING = 0.3
"""Largest remaining share of the squared difference once each block is shifted: lost samples only shift a record."""
MARGIN = 1.2
"""Largest error in floors that counts as noise: the noise is known to about 5 %."""
SETTLING_S = 0.5
"""Time at the start of a quiet record in which the probe comes to rest, s."""


@dataclass(frozen=True)
class Lines:
    """Mains in a signal: ``mains_hz`` (0 where there is none), its waveform, shape (n,), and its standard deviation.

    ``exact_hz`` is the frequency at which it was found.
    """

    mains_hz: float
    waveform: FloatArray
    deviation: float
    exact_hz: float = 0.0


def mains_lines(residual: FloatArray, rate_hz: float) -> Lines:
    """Return the mains frequency and its harmonics in a residual, shape (n,)."""
    none = Lines(0.0, np.zeros_like(residual), 0.0)
    known = np.isfinite(residual)
    if known.sum() < 0.5 * residual.size or residual.size < 512:
        return none
    values = interpolated(residual)
    found = [(_standing(values, hz, rate_hz), hz) for hz in MAINS_HZ]
    standing, hz = max(found, key=lambda item: sum(ratio for ratio, _ in item[0]))
    chosen = [k for ratio, k in standing if ratio > _LINE_POWER_RATIO]
    if not chosen:
        return none
    time = np.arange(residual.size) / rate_hz

    def waveform(at_hz: float) -> FloatArray:
        columns = [np.ones_like(time)]
        for k in chosen:
            phase = 2.0 * np.pi * k * at_hz * time
            columns += [np.sin(phase), np.cos(phase)]
        design = np.stack(columns, axis=1)
        weights = np.linalg.solve(design[known].T @ design[known], design[known].T @ residual[known])
        return np.asarray(design[:, 1:] @ weights[1:])

    # The mains differs slightly from its nominal frequency.
    waves = [(waveform(hz + off), hz + off) for off in np.linspace(-_OFF_HZ, _OFF_HZ, 21)]
    best, exact = max(waves, key=lambda wave: float(np.var(wave[0])))
    return Lines(hz, best, float(np.std(best)), float(exact))


def _standing(values: FloatArray, hz: float, rate_hz: float) -> list[tuple[float, int]]:
    # Power of each harmonic over the median of its neighbours, which for noise is log 2 of the mean.
    window = np.hanning(values.size)
    power = np.abs(np.fft.rfft((values - values.mean()) * window)) ** 2
    spacing = rate_hz / values.size
    found = []
    for k in range(1, _HARMONICS + 1):
        middle = round(k * hz / spacing)
        if middle + _NEIGHBOURS[1] >= power.size or middle - _NEIGHBOURS[1] < 1:
            continue
        near = np.concatenate(
            [
                power[middle - _NEIGHBOURS[1] : middle - _NEIGHBOURS[0]],
                power[middle + _NEIGHBOURS[0] : middle + _NEIGHBOURS[1]],
            ]
        )
        found.append((float(power[middle - 1 : middle + 2].max() / max(np.median(near), 1e-300)), k))
    return found


def settling_samples(size: int, rate_hz: float) -> int:
    """Return how many of the first samples of a quiet record are left out: at most half of them."""
    return min(round(SETTLING_S * rate_hz), size // 2)


def quiet_motion(residual: FloatArray, rate_hz: float) -> float:
    """Return the standard deviation of a quiet record without a linear trend and slow relaxations, SI."""
    known = np.isfinite(residual)
    known[: settling_samples(residual.size, rate_hz)] = False
    time = np.arange(residual.size)[known] / rate_hz
    design = np.stack([np.ones_like(time), time, np.exp(-time / 0.3), np.exp(-time / 0.08)], axis=1)
    weights, *_ = np.linalg.lstsq(design, residual[known], rcond=1e-10)
    return float(np.std(residual[known] - design @ weights))


def rests(dataset: Dataset) -> bool:
    """Return whether there are quiet tests on tissue and the position shows only noise in each of them.

    A position in steps can conceal a motion. Nothing is subtracted: a slow wave looks like a trend.
    """
    quiet = [test for test in dataset.tests if test.quiet and test.fixture == "tissue"]
    return bool(quiet) and all(_is_noise(test, dataset.noise.get("position", 0.0)) for test in quiet)


def _is_noise(test: DatasetTest, noise: float) -> bool:
    position = test.signals["position"]
    settled = position[settling_samples(position.size, test.sample_rate_hz) :]
    if coarse_step(position) or not np.isfinite(settled).any():
        return False
    return float(np.nanstd(settled)) <= MARGIN * noise


def lags(reference: FloatArray, signal: FloatArray, rate_hz: float) -> tuple[NDArray[np.int64], float]:
    """Return the lag (positive: behind) of a signal in each quarter second, samples, shape (blocks,).

    Blocks in which the reference hardly changes are left out. Also return the share of the squared difference that
    remains once each block is shifted.
    """
    block = max(32, round(_BLOCK_S * rate_hz))
    one, other = interpolated(reference), interpolated(signal)
    spread = float(np.std(one))
    found, before, after = [], 0.0, 0.0
    for first in range(_MOST_LAG, one.size - block - _MOST_LAG, block):
        part = other[first : first + block]
        if np.std(one[first : first + block]) < 0.2 * spread or spread == 0.0:
            continue
        errors = [
            float(np.sum((part - one[first - lag : first - lag + block]) ** 2)) for lag in range(-_MOST_LAG, _MOST_LAG)
        ]
        found.append(int(np.argmin(errors)) - _MOST_LAG)
        before, after = before + errors[_MOST_LAG], after + min(errors)
    return np.array(found, np.int64), after / before if before > 0.0 else 1.0


def lost_samples(reference: FloatArray, signal: FloatArray, rate_hz: float) -> int:
    """Return the shift of a signal against its reference over a test, samples; 0 where it is constant."""
    found, stays = lags(reference, signal, rate_hz)
    if found.size < 4 or stays > _MOST_REMAINING:
        return 0
    moved = int(found[-1] - found[0])
    # Losses accumulate: most changes of the lag have one sign.
    steps = np.diff(found)
    same = np.sum(np.sign(steps) == np.sign(moved)) if moved else 0
    return moved if abs(moved) >= 2 and same >= np.sum(steps != 0) * 0.7 else 0
