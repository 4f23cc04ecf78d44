"""The coil's temperature by calculation, from the current that was measured: what the host believes of the winding.

The firmware has a model of its own. Neither knows of the other, and both stop a test whatever the sensor says: a sensor
lags behind the winding it sits on, and a broken one reads room temperature for ever.

The figures lie on the hot side of the desktop coil's. Both devices are wound with wire of the same gage, so copper and
cooling surface go as the length of the wire, and that as the resistance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.device import DESKTOP, DeviceDescription

HEAT_CAPACITY_J_PER_K = 16.5
"""The desktop coil's is estimated at 18 J/K: 40 g of copper and the bobbin."""

THERMAL_RESISTANCE_K_PER_W = 9.0
"""The desktop coil's is estimated at 8 K/W."""

AMBIENT_C = 25.0
COPPER_PER_K = 0.0039
"""Growth of copper's resistance a kelvin above 20 degC."""

PLAUSIBLE_C = (-20.0, 150.0)
"""A sensor that says something else is broken or unplugged."""


class Winding:
    """Temperature of the winding, degC, NaN until a plausible reading was there to begin from.

    It goes on for as long as an instrument is open, tests or none. A sensor that is warmer is believed; one that is
    cooler is not, once the model has begun. The coil's size follows from the device's resistance: heat, copper and
    cooling go by it alike, so the temperature follows from the current alone, and a resistance that was measured warm,
    by a calibration, gives the same as the nominal one.
    """

    def __init__(self, device: DeviceDescription) -> None:
        self.temperature_c = float("nan")
        self._resistance_ohm = device.coil_resistance_ohm
        self._interval_s = 1.0 / device.sample_rate_hz
        wire = device.coil_resistance_ohm / DESKTOP.coil_resistance_ohm
        self._heat_capacity = HEAT_CAPACITY_J_PER_K * wire
        self._thermal_resistance = THERMAL_RESISTANCE_K_PER_W / wire

    def take(self, current_a: NDArray[np.float64], sensor_c: NDArray[np.float64], worst_a: float) -> None:
        """Samples in their order, both of shape (n,); a lost one (NaN) is taken to have carried ``worst_a``."""
        readings = sensor_c[(sensor_c >= PLAUSIBLE_C[0]) & (sensor_c <= PLAUSIBLE_C[1])]
        sensor = float(readings.mean()) if readings.size else float("nan")
        if np.isnan(self.temperature_c):
            self.temperature_c = sensor
        if current_a.size == 0 or np.isnan(self.temperature_c):
            return
        squared = np.where(np.isfinite(current_a), current_a, worst_a) ** 2
        # At the end of a gap of seconds the loss would be overestimated by one straight step: it is cut up.
        for part in np.array_split(squared, max(1, squared.size // round(0.1 / self._interval_s))):
            resistance = self._resistance_ohm * (1.0 + COPPER_PER_K * max(0.0, self.temperature_c - 20.0))
            lost_w = (self.temperature_c - AMBIENT_C) / self._thermal_resistance
            heat_w = resistance * float(part.mean())
            self.temperature_c += (heat_w - lost_w) * part.size * self._interval_s / self._heat_capacity
        if readings.size:
            self.temperature_c = max(self.temperature_c, sensor)

    def rest(self, seconds: float) -> None:
        """No current for so long."""
        kept = float(np.exp(-seconds / (self._heat_capacity * self._thermal_resistance)))
        self.temperature_c = AMBIENT_C + (self.temperature_c - AMBIENT_C) * kept
