"""Noise of a recording: of each channel from the top of its spectrum, outliers, and disturbances of other origin.

Disturbances do not depend on the command: mains lines, motion in quiet tests, lost samples. Outliers are isolated, and
belong neither to the noise floor nor to an effect. The noise of a channel is estimated from the top of its spectrum, to
which outliers contribute. A noise floor that includes them would hide them. Outliers are therefore identified in the
residual of the refitted baseline against a robust scale (Davies and Gather, J. Am. Stat. Assoc. 88 (1993) 782-792).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import firwin, welch

from tissueid.gap.dataset import CHANNELS, LEAST_NOISE, Dataset, DatasetTest, interpolated
from tissueid.gap.fitting import Fit
from tissueid.messages import Message

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
class MainsLines:
    """Mains in a signal: ``mains_hz`` (0 where there is none), its waveform, shape (n,), and its standard deviation.

    ``exact_hz`` is the frequency at which it was found.
    """

    mains_hz: float
    waveform: FloatArray
    deviation: float
    exact_hz: float = 0.0


def mains_lines(residual: FloatArray, rate_hz: float) -> MainsLines:
    """Return the mains frequency and its harmonics in a residual, shape (n,)."""
    none = MainsLines(0.0, np.zeros_like(residual), 0.0)
    finite = np.isfinite(residual)
    if finite.sum() < 0.5 * residual.size or residual.size < 512:
        return none
    values = interpolated(residual)
    candidates = [(_standing(values, hz, rate_hz), hz) for hz in MAINS_HZ]
    standing, hz = max(candidates, key=lambda item: sum(ratio for ratio, _ in item[0]))
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
        weights = np.linalg.solve(design[finite].T @ design[finite], design[finite].T @ residual[finite])
        return np.asarray(design[:, 1:] @ weights[1:])

    # The mains differs slightly from its nominal frequency.
    waves = [(waveform(hz + off), hz + off) for off in np.linspace(-_OFF_HZ, _OFF_HZ, 21)]
    best, exact = max(waves, key=lambda wave: float(np.var(wave[0])))
    return MainsLines(hz, best, float(np.std(best)), float(exact))


def _standing(values: FloatArray, hz: float, rate_hz: float) -> list[tuple[float, int]]:
    # Power of each harmonic over the median of its neighbours, which for noise is log 2 of the mean.
    window = np.hanning(values.size)
    power = np.abs(np.fft.rfft((values - values.mean()) * window)) ** 2
    spacing = rate_hz / values.size
    ratios = []
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
        ratios.append((float(power[middle - 1 : middle + 2].max() / max(np.median(near), 1e-300)), k))
    return ratios


def settling_samples(size: int, rate_hz: float) -> int:
    """Return how many of the first samples of a quiet record are left out: at most half of them."""
    return min(round(SETTLING_S * rate_hz), size // 2)


def quiet_motion(residual: FloatArray, rate_hz: float) -> float:
    """Return the standard deviation of a quiet record without a linear trend and slow relaxations, SI."""
    usable = np.isfinite(residual)
    usable[: settling_samples(residual.size, rate_hz)] = False
    time = np.arange(residual.size)[usable] / rate_hz
    design = np.stack([np.ones_like(time), time, np.exp(-time / 0.3), np.exp(-time / 0.08)], axis=1)
    weights, *_ = np.linalg.lstsq(design, residual[usable], rcond=1e-10)
    return float(np.std(residual[usable] - design @ weights))


def rests(dataset: Dataset) -> bool:
    """Return whether there are quiet tests on tissue and the position shows only noise in each of them.

    A position in steps can conceal a motion. Nothing is subtracted: a slow wave looks like a trend.
    """
    quiet = [test for test in dataset.tests if test.quiet and test.fixture == "tissue"]
    for test in quiet:
        position = test.signals["position"]
        settled = position[settling_samples(position.size, test.sample_rate_hz) :]
        if coarse_step(position) or not np.isfinite(settled).any():
            return False
        if not float(np.nanstd(settled)) <= MARGIN * dataset.noise.get("position", 0.0):
            return False
    return bool(quiet)


def lost_samples(reference: FloatArray, signal: FloatArray, rate_hz: float) -> int:
    """Return the shift of a signal against its reference over a test, samples (positive: behind); 0 where it is
    constant.

    The lag of each quarter second is that of the least squared difference. Blocks in which the reference hardly changes
    are left out.
    """
    block = max(32, round(_BLOCK_S * rate_hz))
    filled_reference, filled_signal = interpolated(reference), interpolated(signal)
    spread = float(np.std(filled_reference))
    lags, before, after = [], 0.0, 0.0
    for first in range(_MOST_LAG, filled_reference.size - block - _MOST_LAG, block):
        part = filled_signal[first : first + block]
        if np.std(filled_reference[first : first + block]) < 0.2 * spread or spread == 0.0:
            continue
        errors = [
            float(np.sum((part - filled_reference[first - lag : first - lag + block]) ** 2))
            for lag in range(-_MOST_LAG, _MOST_LAG)
        ]
        lags.append(int(np.argmin(errors)) - _MOST_LAG)
        before, after = before + errors[_MOST_LAG], after + min(errors)
    if len(lags) < 4 or not after <= _MOST_REMAINING * before or before == 0.0:
        return 0
    moved = lags[-1] - lags[0]
    # Losses accumulate: most changes of the lag have one sign.
    steps = np.diff(lags)
    same = np.sum(np.sign(steps) == np.sign(moved)) if moved else 0
    return moved if abs(moved) >= 2 and same >= np.sum(steps != 0) * 0.7 else 0


_NEIGHBOUR_WEIGHTS = np.array([-1.0, 4.0, 0.0, 4.0, -1.0]) / 6.0
"""Weights of the cubic through two readings on either side, which predicts the reading between them."""
_SPREAD = float(np.sqrt(1.0 + _NEIGHBOUR_WEIGHTS @ _NEIGHBOUR_WEIGHTS))
"""Standard deviation of the distance from that cubic, in deviations of white noise."""
_QUARTER = 0.3186
"""Lower quartile of the absolute value of a normal variable, in standard deviations.

The quartile is used instead of the median because one outlier affects five distances."""
HEAVY = 1.5
"""Least ratio of the channel's noise to the robust scale at which the noise is impulsive."""
FAR = 6.0
"""Least distance of an outlier, in robust standard deviations."""


def robust_noise(fitted: Fit) -> dict[str, float]:
    """Return the robust standard deviation of each channel's noise, SI: the least of all tests."""
    levels: dict[str, float] = {}
    for test, predicted in zip(fitted.parameters.dataset.tests, fitted.predictions, strict=True):
        for name in fitted.parameters.dataset.channels:
            if name == "position" and coarse_step(test.signals[name]) > 0.0:
                continue  # most neighbouring readings are then equal
            away = _from_neighbours(test.signals[name] - predicted[name])
            distances = np.abs(away[np.isfinite(away)])
            level = float(np.quantile(distances, 0.25)) / (_QUARTER * _SPREAD) if distances.size else np.inf
            levels[name] = min(levels.get(name, np.inf), level)
    return levels


def with_robust_noise(fitted: Fit) -> Dataset:
    """Return the tests with the robust noise of channels with outliers; the same object where there are none."""
    dataset = fitted.parameters.dataset
    ordinary = robust_noise(fitted)
    if dataset.equivalent is not None:
        # Its noise is no less than a share of the motion, which says nothing about outliers.
        measured = channel_noise(dataset.tests)
        ordinary = {name: level for name, level in ordinary.items() if measured[name] >= dataset.noise[name]}
    heavy = {
        name: level for name, level in ordinary.items() if 0.0 < HEAVY * level < dataset.noise[name] and level < np.inf
    }
    heavy = {name: level for name, level in heavy.items() if level > 0.05 * dataset.noise[name]}
    if not heavy:
        return dataset
    remarks = [
        Message(
            "gap.impulsive_noise",
            "the {channel} has isolated outliers, several times the noise of the other readings",
            channel=name,
        )
        for name in heavy
    ]
    return replace(
        dataset,
        noise=dataset.noise | heavy,
        remarks=(*dataset.remarks, *remarks),
        impulsive={name: dataset.noise[name] for name in heavy},
    )


def without_outliers(dataset: Dataset, fitted: Fit) -> Dataset:
    """Return the tests without outliers: they are replaced by NaN, as readings that were not received."""
    if not dataset.impulsive:
        return dataset
    tests = []
    for test, predicted in zip(dataset.tests, fitted.predictions, strict=True):
        signals = dict(test.signals)
        for name in dataset.impulsive:
            away = _from_neighbours(test.signals[name] - predicted[name])
            signals[name] = np.where(np.abs(away) > FAR * _SPREAD * dataset.noise[name], np.nan, test.signals[name])
        tests.append(replace(test, signals=signals))
    return replace(dataset, tests=tuple(tests))


def _from_neighbours(residual: FloatArray) -> FloatArray:
    # Distance of every reading from the cubic through its neighbours; NaN where one of them is missing.
    away = np.full_like(residual, np.nan)
    if residual.size >= _NEIGHBOUR_WEIGHTS.size:
        away[2:-2] = residual[2:-2] - np.convolve(residual, _NEIGHBOUR_WEIGHTS, "valid")
    return away


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
    usable = np.isfinite(values) & np.all([np.isfinite(column) for column in columns], axis=0)
    usable[:_LAGS] = False
    usable[-_LAGS:] = False
    if usable.sum() < 256:
        return []
    design = np.stack([column[usable] for column in columns] + [np.ones(int(usable.sum()))], axis=1)
    design /= np.linalg.norm(design, axis=0) + np.finfo(np.float64).tiny
    weights, *_ = np.linalg.lstsq(design, values[usable], rcond=1e-10)
    return [values, values[usable] - design @ weights]


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
    finite = np.isfinite(test.signals["voltage"])
    order = np.argsort(test.command[finite], kind="stable")
    at, values = test.command[finite][order], test.signals["voltage"][finite][order]
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
    settled = interpolated(values)[values.size // 10 :]
    if settled.size < _BLOCK:
        return 0.0
    # The median over blocks ignores jumps at the start of a stimulus or at lost samples.
    _, density = welch(settled, 1.0, nperseg=_BLOCK, average="median")
    return float(np.sqrt(0.5 * np.mean(density[round(0.84 * density.size) :])))
