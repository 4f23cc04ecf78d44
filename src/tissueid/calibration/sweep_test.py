"""One test of a sweep: readings of a stochastic test on the calibration spring at one position."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.calibration.labels import CHANNELS
from tissueid.errors import UnusableInputError
from tissueid.messages import Message
from tissueid.sessions import Test

Array = NDArray[np.float64]

MIN_SECONDS, MAX_SECONDS = 0.5, 60.0
"""Minimum and maximum length of a test, s."""
MIN_RATE_HZ, MAX_RATE_HZ = 1000.0, 20_000.0
"""Sample rates, Hz: lower ones do not resolve coil and filter, higher ones only need more memory."""
_MAX_READING = {"voltage": 1e3, "current": 1e2, "position": 0.2}
"""Largest plausible readings, V, A and m."""
_MAX_SWEEPS = 100
"""Maximum number of repeats of a sweep."""


@dataclass(frozen=True, eq=False)
class SweepTest:
    """Readings (n,) of voltage, V, current, A, and position, m; NaN where a sample was not received.

    ``stage_m`` is the position of a motorised stage, NaN without one; ``rest_m`` the position of the probe there with
    the coil free; ``sweep`` counts the repeats of the whole sweep from 0. Infinite values are replaced by NaN.

    Raises:
        UnusableInputError: readings that are implausible, constant or mostly missing.
    """

    voltage: Array
    current: Array
    position: Array
    sample_rate_hz: float
    stage_m: float = float("nan")
    rest_m: float = float("nan")
    sweep: int = 0

    def __post_init__(self) -> None:
        if not MIN_RATE_HZ <= self.sample_rate_hz <= MAX_RATE_HZ:
            raise UnusableInputError(
                "sweep.sample_rate",
                "the sample rate of a sweep must be {lowest:g} to {highest:g} Hz, not {rate:g} Hz",
                lowest=MIN_RATE_HZ,
                highest=MAX_RATE_HZ,
                rate=self.sample_rate_hz,
            )
        for name, largest in _MAX_READING.items():
            values = np.asarray(getattr(self, name), dtype=np.float64)
            values = np.where(np.isinf(values), np.nan, values)
            if values.shape != (self.position.size,):
                raise UnusableInputError("sweep.lengths", "voltage, current and position of a test differ in length")
            size = float(np.max(np.abs(values), initial=0.0, where=np.isfinite(values)))
            if size > largest:
                raise UnusableInputError(
                    "sweep.too_large",
                    "the {channel} reaches {value:.3g}, which no instrument measures: check the units",
                    channel=CHANNELS[name],
                    value=size,
                )
            object.__setattr__(self, name, values)
        if not MIN_SECONDS <= self.position.size / self.sample_rate_hz <= MAX_SECONDS:
            raise UnusableInputError(
                "sweep.length",
                "a test of a sweep must last {least:g} to {most:g} s, not {seconds:.3g} s",
                least=MIN_SECONDS,
                most=MAX_SECONDS,
                seconds=self.position.size / self.sample_rate_hz,
            )
        received = np.isfinite(self.voltage + self.current + self.position)
        if np.mean(received) < 0.5:
            raise UnusableInputError(
                "sweep.lost", "most samples of a test were lost: check the cable and repeat the sweep"
            )
        for name in _MAX_READING:
            if not np.ptp(getattr(self, name)[received]) > 0.0:
                raise UnusableInputError(
                    "sweep.constant", "the {channel} does not change during a test", channel=CHANNELS[name]
                )

    @classmethod
    def of_session(cls, test: Test) -> SweepTest:
        """Return a test of a session without its preload.

        Raises:
            UnusableInputError: a signal is missing or implausible; names the test.
        """
        preload = test.preload_s * test.sample_rate_hz
        first = round(min(preload, test.samples)) if preload > 0.0 else 0
        if missing := [name for name in _MAX_READING if name not in test.signals]:
            raise _of_test(
                test,
                Message("sweep.no_channel", "it has no {channel}, which a sweep needs", channel=CHANNELS[missing[0]]),
            )
        stage, sweep = test.notes.get("stage_m"), test.notes.get("sweep", 0.0)
        if not (isinstance(sweep, float | int) and 0 <= sweep < _MAX_SWEEPS and sweep == int(sweep)):
            raise _of_test(test, Message("sweep.number", "its number of the sweep, {sweep}, is not valid", sweep=sweep))
        try:
            return cls(
                **{name: test.signals[name][first:] for name in _MAX_READING},
                sample_rate_hz=test.sample_rate_hz,
                stage_m=float(stage) if isinstance(stage, float | int) and abs(stage) <= 1.0 else float("nan"),
                rest_m=test.surface_position_m,
                sweep=int(sweep),
            )
        except UnusableInputError as error:
            raise _of_test(test, error.message) from error

    @property
    def mean_position_m(self) -> float:
        """Mean position, m."""
        return float(np.nanmean(self.position))

    @property
    def swing_m(self) -> float:
        """RMS of the position about its mean, m."""
        return float(np.nanstd(self.position))


def _of_test(test: Test, why: str) -> UnusableInputError:
    return UnusableInputError("sweep.test", "test {number}: {reason}", number=test.number, reason=why)
