"""Averaged readings of an instrument at rest and at constant voltages, and robust straight lines through them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from tissueid.acquisition import play
from tissueid.errors import CancelledError, UnusableInputError
from tissueid.instrument import Instrument, Limits, join_blocks
from tissueid.messages import Message
from tissueid.records import Estimate

OUTLIER_RATIO = 5.0
"""Distance from the line, in robust standard deviations of all points, beyond which a point is an outlier."""
_NORMAL = 1.4826
"""Ratio of the standard deviation to the median absolute deviation of a normal distribution."""


@dataclass(frozen=True, eq=False)
class StraightLine:
    """y = intercept + slope x, with residuals (n,) and outlier flags (n,) of all points."""

    slope: Estimate
    intercept: Estimate
    residuals: NDArray[np.float64]
    outliers: NDArray[np.bool_]

    @property
    def scatter(self) -> float:
        """Standard deviation of the inliers about the line."""
        return float(np.std(self.residuals[~self.outliers]))

    @property
    def worst(self) -> float:
        """Largest deviation of an inlier from the line."""
        return float(np.abs(self.residuals[~self.outliers]).max())

    def at(self, x: float) -> float:
        """Return the value of the line at ``x``."""
        return self.intercept.value + self.slope.value * x


def straight_line(x: NDArray[np.float64], y: NDArray[np.float64], noise: float = 0.0) -> StraightLine:
    """Fit a line to points (x, y), shape (n,) each; ``noise`` is the known standard deviation of y.

    The Theil-Sen estimator (Theil 1950, Sen 1968) identifies the inliers; least squares through them gives slope,
    intercept and their standard deviations. Up to a quarter of the points may be outliers.

    Raises:
        UnusableInputError: fewer than three points, or all at one x.
    """
    if x.size < 3 or float(np.ptp(x)) == 0.0:
        raise UnusableInputError("line.points", "a line needs at least three points that are not all at one position")
    slope, intercept, *_ = stats.theilslopes(y, x)
    away = np.abs(y - intercept - slope * x)
    scale = max(noise, _NORMAL * float(np.median(away)), 1e-12 * float(np.abs(y).max()))
    outliers = away > OUTLIER_RATIO * scale
    if np.ptp(x[~outliers]) == 0.0 or np.count_nonzero(~outliers) < 3:
        raise UnusableInputError("line.none", "the points do not lie on a line")
    line = stats.linregress(x[~outliers], y[~outliers])
    return StraightLine(
        slope=Estimate(float(line.slope), float(line.stderr)),
        intercept=Estimate(float(line.intercept), float(line.intercept_stderr)),
        residuals=y - line.intercept - line.slope * x,
        outliers=outliers,
    )


POLL_S = 0.05
"""Longest wait for samples, s."""
SETTLED_SHARE = 0.4
"""Final share of each level that is averaged: coil and spring are at rest by then."""
_MIN_SAMPLES = 10
"""Least number of samples of a mean."""
_STALE_S = 0.2
"""Samples that are skipped first, s: they may have been taken before the fixture was moved."""
_MEASURED = ("voltage", "current", "position")
_AVERAGED = ("command", *_MEASURED)

OnProgress = Callable[[float], None]
Cancelled = Callable[[], bool]


@dataclass(frozen=True, eq=False)
class Levels:
    """Means over the settled part of each level, shape (levels,) each, SI, and the noise of these means by channel.

    ``command_v`` is the command, rounded to the step of the converter.
    """

    command_v: NDArray[np.float64]
    voltage_v: NDArray[np.float64]
    current_a: NDArray[np.float64]
    position_m: NDArray[np.float64]
    noise: dict[str, float]
    rest: NDArray[np.void]
    """Settled samples of the levels at 0 V, of dtype SAMPLE."""
    first_temperature_c: float
    last_temperature_c: float
    heat_j: float
    """Heat dissipated in the coil, J: measured voltage times current."""


def hold_levels(
    instrument: Instrument,
    levels_v: NDArray[np.float64],
    limits: Limits,
    *,
    hold_s: float,
    rise_s: float = 0.0,
    progress: OnProgress = lambda _: None,
    cancelled: Cancelled = lambda: False,
) -> Levels:
    """Hold voltages, shape (levels,), for ``hold_s`` each, and return the mean readings of each level.

    The voltage changes from level to level by a raised cosine of ``rise_s``.

    Raises:
        UnusableInputError: a level has too few samples.
        CancelledError, LimitError, InstrumentError: the coil is released.
    """
    rate = instrument.device.sample_rate_hz
    hold = round(hold_s * rate)
    blocks: list[NDArray[np.void]] = []

    def take(samples: NDArray[np.void], fraction: float) -> None:
        blocks.append(samples)
        progress(fraction)

    command = _smoothed_steps(np.asarray(levels_v, np.float64), hold, round(rise_s * rate))
    run = play(instrument, command, limits, on_samples=take, cancelled=cancelled)
    samples = join_blocks(blocks)
    index = samples["index"].astype(np.int64) - run.first_index
    level, settled = index // hold, index % hold >= hold * (1 - SETTLED_SHARE)
    received = np.all([np.isfinite(samples[name]) for name in _MEASURED], axis=0)
    means = np.zeros((len(_AVERAGED), len(levels_v)))  # (channels, levels)
    variances = np.zeros_like(means)
    for number in range(len(levels_v)):
        chosen = samples[settled & received & (level == number)]
        if chosen.size < _MIN_SAMPLES:
            raise UnusableInputError(
                "calibration.samples_lost.voltage",
                "samples were lost while a steady voltage was applied: check the cable and repeat the calibration",
            )
        for row, name in enumerate(_AVERAGED):
            means[row, number] = chosen[name].mean()
            variances[row, number] = chosen[name].var() / chosen.size
    at_zero = np.isin(level, np.flatnonzero(np.asarray(levels_v) == 0.0))
    temperature = samples["temperature"][np.isfinite(samples["temperature"])]
    quarter = round(0.25 * rate)
    power = np.nan_to_num(samples["voltage"] * samples["current"])
    return Levels(
        command_v=np.round(means[0], 9),
        voltage_v=means[1],
        current_a=means[2],
        position_m=means[3],
        noise={name: float(np.sqrt(variances[row].mean())) for row, name in enumerate(_AVERAGED)},
        rest=samples[settled & received & at_zero],
        first_temperature_c=float(temperature[:quarter].mean()) if temperature.size else float("nan"),
        last_temperature_c=float(temperature[-quarter:].mean()) if temperature.size else float("nan"),
        heat_j=float(power.sum() / rate),
    )


def _smoothed_steps(levels_v: NDArray[np.float64], hold: int, rise: int) -> NDArray[np.float64]:
    """Return the command, shape (levels * hold,), V, with raised cosines of ``rise`` samples between the levels."""
    command = np.repeat(levels_v, hold)
    if rise:
        share = 0.5 - 0.5 * np.cos(np.pi * (np.arange(rise) + 0.5) / rise)
        before = 0.0
        for number, volts in enumerate(levels_v):
            command[number * hold : number * hold + rise] = before + share * (volts - before)
            before = volts
    return command


def rest_samples(
    instrument: Instrument,
    seconds: float,
    *,
    progress: OnProgress = lambda _: None,
    cancelled: Cancelled = lambda: False,
) -> NDArray[np.void]:
    """Return the samples received while the coil is free and nothing moves, shape (n,), of dtype SAMPLE.

    Raises:
        UnusableInputError: more than half of the samples were lost.
        CancelledError: ``cancelled`` returned True.
        InstrumentError: see ``poll``.
    """
    wanted = round(seconds * instrument.device.sample_rate_hz)
    skip = round(_STALE_S * instrument.device.sample_rate_hz)
    seen, blocks = -skip, []
    while seen < wanted:
        if cancelled():
            raise CancelledError(Message("cancelled.coil_free", "cancelled; the coil is free"))
        samples = instrument.poll(POLL_S)
        if samples.size:
            blocks.append(samples[max(0, -seen) :])
            seen += samples.size
            progress(min(1.0, max(0.0, seen / wanted)))
    samples = join_blocks(blocks)[:wanted]
    received = samples[np.all([np.isfinite(samples[name]) for name in _MEASURED], axis=0)]
    if received.size < wanted / 2:
        raise UnusableInputError(
            "calibration.samples_lost.rest",
            "samples were lost while the instrument was at rest: check the cable and repeat the calibration",
        )
    return received


def mean(samples: NDArray[np.void], name: str) -> float:
    """Return the mean of one signal of samples (n,)."""
    return float(np.mean(samples[name]))


def noise_of_mean(samples: NDArray[np.void], name: str, blocks: int = 10) -> float:
    """Return the standard deviation of the mean of one signal, from the means of blocks, so that drift is included."""
    means = [float(part.mean()) for part in np.array_split(np.asarray(samples[name]), blocks)]
    return float(np.std(means, ddof=1) / np.sqrt(blocks))
