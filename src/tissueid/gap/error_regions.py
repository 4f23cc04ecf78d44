"""Regions of frequency, depth, speed, current, amplitude, time and mains phase with residuals above the floor.

Frequency: the best linear approximation of the residual and its distortions (Pintelon and Schoukens, System
Identification, 2012, ch. 3 and 4): the part coherent with the input is linear, that coherent with its square or cube is
even or odd. Depth and velocity: the restoring-force surface (Masri and Caughey 1979). Every region is tested by the
means of blocks that are longer than the memory of the residual, so that a coloured residual does not appear
significant; Holm's correction keeps the size of all bins of a profile together.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from tissueid.device import DeviceDescription
from tissueid.gap.dataset import Dataset, DatasetTest, interpolated
from tissueid.gap.fitting import Fit
from tissueid.gap.noise import MAINS_HZ, mains_lines
from tissueid.gap.stage_substitution import motion

FloatArray = NDArray[np.float64]
Direction = Literal["both", "into", "out"]
Intervals = tuple[tuple[float, float], ...]

QUANTITIES = ("bands_hz", "depth_m", "time_s", "velocity_m_s", "current_a", "amplitude_n", "mains_phase_rad")
"""Quantities of the regions: frequency, depth, time, velocity, current, root mean square of the stimulus in the last
0.1 s as a force at rest, and phase of the mains, 0 to 2 pi from the start of the test."""

SIZE = 0.01
"""Size of the test of all bins of one profile at squares of ``_EXCESS`` floors; it is smaller below."""
_BLOCK_S = 0.25
_EXCESS = 1.44
"""Squared error in squared floors that counts as noise: the noise is known to about 5 %."""
_ONE_SIDED = 3.0
"""Least ratio of the squared errors of the two directions for naming one of them."""
_BINS = 12
_BANDS_HZ = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 100.0, 150.0, 200.0, 300.0, 450.0, 650.0, 1000.0)
_AMPLITUDE_WINDOW_S = 0.1
"""Window of the size of the recent stimulus, s: several response times of the tissue."""
_MAP = 14
_POINTS = 70


@dataclass(frozen=True)
class ErrorProfile:
    """Profile of the error along a quantity, in floors (root mean square), by bin.

    ``edges``, shape (bins + 1,), SI; ``error``, shape (bins,), NaN for bins without data; ``above`` marks bins
    significantly above the floor.
    """

    edges: FloatArray
    error: FloatArray
    above: NDArray[np.bool_]

    def intervals(self) -> Intervals:
        """Connected bins above the floor."""
        ends = np.flatnonzero(np.diff(np.concatenate([[0], self.above.astype(np.int8), [0]])))
        return tuple(
            (float(self.edges[first]), float(self.edges[end])) for first, end in zip(ends[::2], ends[1::2], strict=True)
        )


@dataclass(frozen=True)
class ErrorSpectrum:
    """Residual by frequency, shape (frequencies,): power densities, SI squared per Hz.

    ``linear``, ``even`` and ``odd`` are the parts coherent with the input, its square and its cube; ``noise`` is the
    floor.
    """

    channel: str
    frequency_hz: FloatArray
    recorded: FloatArray
    residual: FloatArray
    linear: FloatArray
    even: FloatArray
    odd: FloatArray
    noise: FloatArray


@dataclass(frozen=True)
class ErrorSurface:
    """Mean residual over depth (columns) and velocity (rows), in floors; NaN without data."""

    depth_m: FloatArray
    velocity_m_s: FloatArray
    residual: FloatArray


@dataclass(frozen=True)
class ErrorRegions:
    """Significant regions and their profiles.

    ``channel`` is the signal with the largest error in floors, ``mains_hz`` the frequency of the mains in the residual
    (0 where there is none). ``above`` holds the intervals above the floor by the names of ``QUANTITIES``.
    """

    channel: str
    direction: Direction
    mains_hz: float
    above: Mapping[str, Intervals]
    profiles: dict[str, ErrorProfile] = field(repr=False)
    spectra: tuple[ErrorSpectrum, ...] = field(repr=False)
    surface: ErrorSurface | None = field(repr=False)

    def unmarked(self) -> ErrorRegions:
        """Return a copy with the same profiles and no region or bin marked as above the noise."""
        profiles = {name: replace(item, above=np.zeros_like(item.above)) for name, item in self.profiles.items()}
        return replace(self, direction="both", above=dict.fromkeys(QUANTITIES, ()), profiles=profiles)

    def as_answer(self) -> dict[str, Any]:
        """Return plain values for JSON under the contract's names, with the additional regions."""
        intervals = {name: [list(item) for item in self.above[name]] for name in QUANTITIES}
        others = {"direction": self.direction, "mains_hz": self.mains_hz or None, "channel": self.channel}
        return intervals | others


def find_error_regions(dataset: Dataset, baseline: Fit) -> ErrorRegions:
    """Return the regions where the residual of the refitted baseline is above the floor, in the test with the largest
    error."""
    test, channel = _shown_in(dataset, baseline)
    if test is None:
        return ErrorRegions("", "both", 0.0, dict.fromkeys(QUANTITIES, ()), {}, (), None)
    residual = _residual(baseline, test, channel)
    floor = dataset.noise[channel]
    position, velocity = motion(test)
    measured = {
        "depth_m": position - test.surface_m,
        "velocity_m_s": velocity,
        "time_s": np.arange(residual.size) / test.sample_rate_hz,
    }
    if "current" in test.signals:
        measured["current_a"] = interpolated(test.signals["current"])
    if np.ptp(recent := recent_size(test, dataset.instrument)) > 0.0:
        measured["amplitude_n"] = recent
    mains = mains_lines(residual, test.sample_rate_hz)
    if mains_hz := mains.exact_hz or mains_lines(residual**2, test.sample_rate_hz).exact_hz:
        measured["mains_phase_rad"] = 2.0 * np.pi * ((measured["time_s"] * mains_hz) % 1.0)
    profiles = {name: _profile(residual / floor, values, test, name) for name, values in measured.items()}
    profiles["bands_hz"] = _bands(residual, floor, test)
    spectra = tuple(spectrum(dataset, baseline, test, name) for name in dataset.channels if name in test.signals)
    surface = _surface(residual / floor, measured["depth_m"], velocity)
    above = dict.fromkeys(QUANTITIES, ()) | {name: profile.intervals() for name, profile in profiles.items()}
    if mains.mains_hz in MAINS_HZ:
        above["bands_hz"] += ((mains.mains_hz - 0.5, mains.mains_hz + 0.5),)
    direction = _direction(residual / floor, velocity)
    return ErrorRegions(channel, direction, mains_hz, above, profiles, spectra, surface)


def recent_size(test: DatasetTest, device: DeviceDescription) -> FloatArray:
    """Return the root mean square of the stimulus in the last 0.1 s around its mean, N at rest, shape (n,)."""
    newtons_per_volt = device.force_constant_n_per_a / device.coil_resistance_ohm
    newtons = {
        "command": newtons_per_volt * device.amplifier_gain,
        "voltage": newtons_per_volt,
        "current": device.force_constant_n_per_a,
        "input": 1.0,
    }[test.driven_by]
    total = np.concatenate([[0.0], np.cumsum((newtons * (test.command - test.command.mean())) ** 2)])
    last = np.arange(1, total.size)
    first = np.maximum(last - max(round(_AMPLITUDE_WINDOW_S * test.sample_rate_hz), 1), 0)
    return np.asarray(np.sqrt(np.maximum(total[last] - total[first], 0.0) / (last - first)))


def _residual(baseline: Fit, test: DatasetTest, channel: str) -> FloatArray:
    tests = baseline.parameters.dataset.tests
    predicted = next(
        prediction for prediction, other in zip(baseline.predictions, tests, strict=True) if other.number == test.number
    )
    residual = test.signals[channel] - predicted[channel]
    return np.where(test.purpose > 0, residual, np.nan)


def _shown_in(dataset: Dataset, baseline: Fit) -> tuple[DatasetTest | None, str]:
    # Tests of one kind are similar; the largest error in floors is shown best.
    worst: tuple[float, DatasetTest | None, str] = (0.0, None, "")
    for test in dataset.tests:
        for channel in dataset.channels:
            if test.repeat_of is not None or (test.quiet and len(dataset.tests) > 1):
                continue
            times = float(np.sqrt(np.nanmean(_residual(baseline, test, channel) ** 2))) / dataset.noise[channel]
            if times > worst[0]:
                worst = (times, test, channel)
    return worst[1], worst[2]


def _profile(residual: FloatArray, along: FloatArray, test: DatasetTest, name: str) -> ErrorProfile:
    finite = np.isfinite(residual)
    if name == "time_s":
        edges = np.arange(0.0, along[-1] + _BLOCK_S, _BLOCK_S)
    elif name == "mains_phase_rad":
        edges = np.linspace(0.0, 2.0 * np.pi, _BINS + 1)
    else:
        low, high = np.quantile(along[finite], [0.002, 0.998])
        edges = np.linspace(low, max(high, low + 1e-9), _BINS + 1)
    bin_index = np.clip(np.digitize(along, edges) - 1, 0, edges.size - 2)
    seconds = {"time_s": 0.02, "amplitude_n": _AMPLITUDE_WINDOW_S}.get(name, _BLOCK_S)
    block = (np.arange(along.size) / (seconds * test.sample_rate_hz)).astype(np.int64)
    error, p_values = np.full(edges.size - 1, np.nan), np.ones(edges.size - 1)
    for k in range(edges.size - 1):
        inside = finite & (bin_index == k)
        if inside.sum() < 8:
            continue
        error[k] = float(np.sqrt(np.mean(residual[inside] ** 2)))
        p_values[k] = _p_value(residual[inside] ** 2, block[inside])
    return ErrorProfile(edges, error, _holm(p_values))


def _p_value(squares: FloatArray, block: NDArray[np.int64]) -> float:
    """Return the p-value of the squares at the floor: a one-sided test of the block means of their logarithm."""
    means = np.array([squares[block == k].mean() for k in np.unique(block) if (block == k).sum() >= 4])
    if means.size < 4:
        return 1.0
    logs = np.log(np.maximum(means, 1e-12) / _EXCESS)
    spread = float(np.std(logs, ddof=1)) / np.sqrt(means.size)
    return float(student.sf(float(np.mean(logs)) / max(spread, 1e-9), means.size - 1))


def _holm(p_values: FloatArray) -> NDArray[np.bool_]:
    order = np.argsort(p_values)
    above = np.zeros(p_values.size, np.bool_)
    for rank, k in enumerate(order):
        if p_values[k] > SIZE / (p_values.size - rank):
            break
        above[k] = True
    return above


def _direction(residual: FloatArray, velocity: FloatArray) -> Direction:
    finite = np.isfinite(residual)
    slow = 0.1 * float(np.std(velocity))
    into = float(np.mean(residual[finite & (velocity > slow)] ** 2)) if (finite & (velocity > slow)).any() else 0.0
    out = float(np.mean(residual[finite & (velocity < -slow)] ** 2)) if (finite & (velocity < -slow)).any() else 0.0
    if max(into, out) < _EXCESS:
        return "both"
    if into > _ONE_SIDED * out:
        return "into"
    return "out" if out > _ONE_SIDED * into else "both"


def _segments(values: FloatArray, rate_hz: float) -> tuple[FloatArray, NDArray[np.complex128], float]:
    """Return half-overlapping windowed blocks of a signal: frequencies, spectra (blocks, frequencies), norm."""
    size = min(values.size, 1 << int(np.log2(max(values.size / 4, 64))))
    window = np.hanning(size)
    firsts = range(0, values.size - size + 1, size // 2)
    rows = np.stack([(values[k : k + size] - values[k : k + size].mean()) * window for k in firsts])
    return (
        np.fft.rfftfreq(size, 1.0 / rate_hz).astype(np.float64),
        np.fft.rfft(rows, axis=1),
        float(np.sum(window**2)) * rate_hz / 2.0,
    )


def _bands(residual: FloatArray, floor: float, test: DatasetTest) -> ErrorProfile:
    values = np.where(np.isfinite(residual), residual, 0.0)
    hz, spectra, norm = _segments(values, test.sample_rate_hz)
    level = floor**2 / (test.sample_rate_hz / 2.0)
    ratio = np.abs(spectra) ** 2 / norm / level
    edges = np.array([edge for edge in _BANDS_HZ if edge < test.sample_rate_hz / 2.0] + [test.sample_rate_hz / 2.0])
    error, p_values = np.full(edges.size - 1, np.nan), np.ones(edges.size - 1)
    for k in range(edges.size - 1):
        inside = (hz >= edges[k]) & (hz < edges[k + 1])
        if not inside.any():
            continue
        means = ratio[:, inside].mean(axis=1)
        error[k] = float(np.sqrt(np.mean(means)))
        logs = np.log(np.maximum(means, 1e-12) / _EXCESS)
        # Half-overlapping blocks with this window are almost independent.
        spread = max(float(np.std(logs, ddof=1)), 1.0 / np.sqrt(inside.sum())) / np.sqrt(0.9 * means.size)
        p_values[k] = float(student.sf(float(np.mean(logs)) / spread, max(means.size - 1, 1)))
    return ErrorProfile(edges, error, _holm(p_values))


def spectrum(dataset: Dataset, baseline: Fit, test: DatasetTest, channel: str) -> ErrorSpectrum:
    """Return the residual of a channel by frequency, in its parts."""
    residual = _residual(baseline, test, channel)
    values = np.where(np.isfinite(residual), residual, 0.0)
    hz, segments, norm = _segments(values, test.sample_rate_hz)
    _, recorded, _ = _segments(interpolated(test.signals[channel]), test.sample_rate_hz)
    command = (test.command - test.command.mean()) / max(float(np.std(test.command)), 1e-12)
    power = np.mean(np.abs(segments) ** 2, axis=0) / norm
    parts, rest = [], segments
    for values in (command, command**2 - 1.0, command**3 - 3.0 * command):
        _, driver, _ = _segments(values, test.sample_rate_hz)
        # In order, so that a higher order does not explain the part of a lower one again.
        gain = np.sum(rest * driver.conj(), axis=0) / np.maximum(np.sum(np.abs(driver) ** 2, axis=0), 1e-300)
        explained = gain * driver
        # Correct for the part explained by chance.
        biased = np.mean(np.abs(rest) ** 2, axis=0) / rest.shape[0]
        parts.append(np.maximum(np.mean(np.abs(explained) ** 2, axis=0) - biased, 0.0) / norm)
        rest = rest - explained
    noise = np.full_like(hz, dataset.noise[channel] ** 2 / (test.sample_rate_hz / 2.0))
    rows = (hz, np.mean(np.abs(recorded) ** 2, axis=0) / norm, power, *parts, noise)
    return ErrorSpectrum(channel, *(_gathered(row, hz) for row in rows))


def _gathered(values: FloatArray, hz: FloatArray) -> FloatArray:
    """Return means over bands that widen with frequency, which scatter less than single lines."""
    edges = np.unique(np.geomspace(1, hz.size, _POINTS).astype(np.int64))
    return np.array([values[first:end].mean() for first, end in pairwise(edges)])


def _surface(residual: FloatArray, depth: FloatArray, velocity: FloatArray) -> ErrorSurface | None:
    finite = np.isfinite(residual)
    if finite.sum() < 100:
        return None
    across = _grid(depth[finite], 0.005)
    along = _grid(velocity[finite], 0.01)
    if np.ptp(across) <= 0.0 or np.ptp(along) <= 0.0:
        return None
    count, *_ = np.histogram2d(velocity[finite], depth[finite], (along, across))
    total, *_ = np.histogram2d(velocity[finite], depth[finite], (along, across), weights=residual[finite])
    mean = np.where(count >= 5, total / np.maximum(count, 1), np.nan)
    return ErrorSurface(0.5 * (across[1:] + across[:-1]), 0.5 * (along[1:] + along[:-1]), mean)


def _grid(values: FloatArray, off: float) -> FloatArray:
    low, high = np.quantile(values, [off, 1.0 - off])
    return np.linspace(float(low), float(high), _MAP + 1)
