"""The host's judge over the samples of an instrument: limits, plausibility and temperature, from poll to poll."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.device import DeviceDescription
from tissueid.errors import InstrumentError, LimitError
from tissueid.instrument.interface import Run
from tissueid.instrument.limits import LIFT_S, Limits, check_samples
from tissueid.instrument.plausibility import Plausibility
from tissueid.instrument.thermal import PLAUSIBLE_C, Winding

NO_TEMPERATURE = "the coil's temperature sensor gives no usable reading{}: check its plug and cable"

BY_CURRENT = "by its current"
"""Of a temperature that was calculated, not read."""


class Judge:
    """One for each opening of an instrument, so that the winding stays warm from test to test.

    ``nominal`` are the instrument's own figures; a calibration in force can only make the judge stricter. ``winding``
    False leaves the temperature by calculation out: a simulation in this process has no coil.
    """

    def __init__(self, nominal: DeviceDescription, *, winding: bool = True) -> None:
        self._nominal = nominal
        self._plausibility = Plausibility(nominal)
        self._winding = Winding(nominal) if winding else None
        self._worst_a = 0.0
        self._lifted = False

    @property
    def winding_c(self) -> float:
        """The winding's temperature by calculation, degC; NaN where there is none."""
        return np.nan if self._winding is None else self._winding.temperature_c

    def arm(self, temperature_c: NDArray[np.float64], limits: Limits) -> None:
        """A run is about to be armed; ``temperature_c``, shape (k,), are the newest readings of the coil's sensor.

        Raises:
            InstrumentError: the sensor is missing or cannot be right.
            LimitError: the coil is too hot already.
        """
        readings = temperature_c[np.isfinite(temperature_c)]
        if readings.size == 0:
            raise InstrumentError(NO_TEMPERATURE.format(""))
        sensor = float(readings.mean())
        if not PLAUSIBLE_C[0] <= sensor <= PLAUSIBLE_C[1]:
            raise InstrumentError(NO_TEMPERATURE.format(f" ({sensor:.0f} °C)"))
        if (hottest := max(sensor, np.nan_to_num(self.winding_c, nan=sensor))) > limits.max_temperature_c:
            raise LimitError(
                f"the coil is at {hottest:.0f} °C; the limit is {limits.max_temperature_c:g} °C: let it cool"
            )
        self._plausibility.begin(at_low_end=limits.min_position_m <= 0.0)
        self._worst_a = 0.0
        self._lifted = False

    def ask(self, command_v: NDArray[np.float64]) -> None:
        """Commands, shape (n,), V, that the run may play: what a lost sample may have carried."""
        volts = float(np.abs(command_v).max(initial=0.0)) * self._nominal.amplifier_gain
        self._worst_a = max(self._worst_a, volts / self._nominal.coil_resistance_ohm)

    def take(
        self,
        samples: NDArray[np.void],
        limits: Limits | None,
        run: Run | None,
        calibrated: tuple[NDArray[np.void], DeviceDescription] | None = None,
    ) -> None:
        """Judge samples as they were read, shape (k,), each once and in their order; without ``limits`` none is armed.

        ``calibrated`` are the same samples by the calibration in force and the figures that go with it: the limits are
        held by them as well.

        Raises:
            LimitError, InstrumentError: the caller releases the coil.
        """
        if self._winding is not None:
            worst_a = 0.0 if run is None else self._worst_a
            self._winding.take(samples["current"], samples["temperature"], worst_a)
        if limits is None:
            return
        first_index = run.first_index if run else None
        resting = self._at_the_near_end(samples, limits, first_index)
        check_samples(_passed_over(samples, resting), self._nominal, limits, first_index)
        if calibrated is not None:
            check_samples(_passed_over(calibrated[0], resting), calibrated[1], limits, first_index)
        if np.any(samples["temperature"] < PLAUSIBLE_C[0]):
            raise InstrumentError(NO_TEMPERATURE.format(""))
        if self.winding_c > limits.max_temperature_c:
            raise LimitError(
                f"the coil is at {self.winding_c:.0f} °C {BY_CURRENT}; "
                f"the limit is {limits.max_temperature_c:g} °C: let it cool"
            )
        if run is not None:
            self._plausibility.take(samples[samples["index"] >= run.first_index])

    def _at_the_near_end(self, samples: NDArray[np.void], limits: Limits, first_index: int | None) -> NDArray[np.bool_]:
        """Samples, shape (k,), at which the probe has not come off the near end of its stroke yet, and need not have.

        There a free probe rests when the instrument points upwards. The near limit counts once the probe was inside it
        in this run, or had half a second to.
        """
        off = np.zeros(samples.size, dtype=np.bool_)
        if first_index is not None and samples.size:
            off = (samples["position"] >= limits.min_position_m) & (samples["index"] >= first_index)
            off |= samples["index"] >= first_index + round(LIFT_S * self._nominal.sample_rate_hz)
            off = np.logical_or.accumulate(off) | self._lifted
            self._lifted = bool(off[-1])
        return np.asarray(~off & (samples["position"] < limits.min_position_m))


def _passed_over(samples: NDArray[np.void], there: NDArray[np.bool_]) -> NDArray[np.void]:
    """The samples with no position where ``there`` is true."""
    if not there.any():
        return samples
    samples = samples.copy()
    samples["position"][there] = np.nan
    return samples
