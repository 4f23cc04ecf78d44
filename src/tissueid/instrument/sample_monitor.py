"""Checks of the host on all samples of an instrument: limits, plausibility and calculated coil temperature."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.device import DeviceDescription
from tissueid.errors import InstrumentError, LimitError
from tissueid.instrument.interface import Run
from tissueid.instrument.limits import LIFT_S, Limits, check_samples, coil_too_hot
from tissueid.instrument.plausibility import Plausibility
from tissueid.instrument.thermal import PLAUSIBLE_C, WindingTemperature
from tissueid.messages import Message

_NO_TEMPERATURE = Message(
    "sensor.no_temperature",
    "the temperature sensor of the coil gives no usable reading: check its plug and cable",
)


class SampleMonitor:
    """Host-side checks of one opened instrument; the calculated temperature carries over from test to test.

    Args:
        nominal: the instrument's own properties; an active calibration can only make the checks stricter.
        winding: whether to calculate the temperature; False for an in-process simulation, which has no coil.
    """

    def __init__(self, nominal: DeviceDescription, *, winding: bool = True) -> None:
        self._nominal = nominal
        self._plausibility = Plausibility(nominal)
        self._winding = WindingTemperature(nominal) if winding else None
        self._highest_a = 0.0
        self._lifted = False

    @property
    def winding_c(self) -> float:
        """Return the calculated temperature of the winding, degC; NaN where none is calculated."""
        return np.nan if self._winding is None else self._winding.temperature_c

    def arm(self, temperature_c: NDArray[np.float64], limits: Limits) -> None:
        """Check the temperature before a run is armed, and reset the checks of a run.

        ``temperature_c``, shape (k,), are the newest readings of the sensor.

        Raises:
            InstrumentError: the sensor is missing or its reading is implausible.
            LimitError: the coil is already too hot.
        """
        readings = temperature_c[np.isfinite(temperature_c)]
        if readings.size == 0:
            raise InstrumentError(_NO_TEMPERATURE)
        sensor = float(readings.mean())
        if not PLAUSIBLE_C[0] <= sensor <= PLAUSIBLE_C[1]:
            raise InstrumentError(
                Message(
                    "sensor.wrong_temperature",
                    "the temperature sensor of the coil gives no usable reading ({temperature:.0f} °C): "
                    "check its plug and cable",
                    temperature=sensor,
                )
            )
        if (hottest := max(sensor, np.nan_to_num(self.winding_c, nan=sensor))) > limits.max_temperature_c:
            raise coil_too_hot(hottest, limits)
        self._plausibility.begin(at_low_end=limits.min_position_m <= 0.0)
        self._highest_a = 0.0
        self._lifted = False

    def expect_command(self, command_v: NDArray[np.float64]) -> None:
        """Add commands of the run, shape (n,), V: they bound the current that a lost sample may have carried."""
        volts = float(np.abs(command_v).max(initial=0.0)) * self._nominal.amplifier_gain
        self._highest_a = max(self._highest_a, volts / self._nominal.coil_resistance_ohm)

    def check(
        self,
        samples: NDArray[np.void],
        limits: Limits | None,
        run: Run | None,
        calibrated: tuple[NDArray[np.void], DeviceDescription] | None = None,
    ) -> None:
        """Check samples as read, shape (k,), each once and in order. Without ``limits`` no test is armed.

        ``calibrated`` holds the same samples corrected by the active calibration, and its device description; the
        limits must hold for both.

        Raises:
            LimitError, InstrumentError: a check failed. The caller releases the coil.
        """
        if self._winding is not None:
            highest_a = 0.0 if run is None else self._highest_a
            self._winding.take(samples["current"], samples["temperature"], highest_a)
        if limits is None:
            return
        first_index = run.first_index if run else None
        resting = self._resting_at_near_end(samples, limits, first_index)
        check_samples(_without_position(samples, resting), self._nominal, limits, first_index)
        if calibrated is not None:
            check_samples(_without_position(calibrated[0], resting), calibrated[1], limits, first_index)
        if np.any(samples["temperature"] < PLAUSIBLE_C[0]):
            raise InstrumentError(_NO_TEMPERATURE)
        if self.winding_c > limits.max_temperature_c:
            raise LimitError(
                Message(
                    "limit.winding_temperature",
                    "the coil is at {temperature:.0f} °C by its current; the limit is {limit:g} °C: let it cool",
                    temperature=self.winding_c,
                    limit=limits.max_temperature_c,
                )
            )
        if run is not None:
            self._plausibility.check(samples[samples["index"] >= run.first_index])

    def _resting_at_near_end(
        self, samples: NDArray[np.void], limits: Limits, first_index: int | None
    ) -> NDArray[np.bool_]:
        """Return where, shape (k,), the probe still rests at the near end of its stroke and is permitted to.

        A free probe rests there when the instrument points upwards. The near limit applies from the first sample of
        the run inside it, or after ``LIFT_S``.
        """
        off = np.zeros(samples.size, dtype=np.bool_)
        if first_index is not None and samples.size:
            off = (samples["position"] >= limits.min_position_m) & (samples["index"] >= first_index)
            off |= samples["index"] >= first_index + round(LIFT_S * self._nominal.sample_rate_hz)
            off = np.logical_or.accumulate(off) | self._lifted
            self._lifted = bool(off[-1])
        return np.asarray(~off & (samples["position"] < limits.min_position_m))


def _without_position(samples: NDArray[np.void], mask: NDArray[np.bool_]) -> NDArray[np.void]:
    """Return the samples with position NaN where ``mask`` is true."""
    if not mask.any():
        return samples
    samples = samples.copy()
    samples["position"][mask] = np.nan
    return samples
