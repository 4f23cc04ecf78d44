"""Thermal model of the coil: winding temperature calculated from the measured current.

The firmware has an independent model. Both stop a test independently of the sensor: a sensor lags behind the winding,
and a failed sensor may read room temperature.

The constants are conservative with respect to the estimates of the desktop coil. Both devices use wire of the same
gauge, so heat capacity and cooling surface scale with the length of the wire, which scales with the resistance.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tissueid.device import DESKTOP, DeviceDescription

HEAT_CAPACITY_J_PER_K = 16.5
"""Heat capacity of the desktop coil, J/K. Estimate: 18 J/K for 40 g of copper and the bobbin."""

THERMAL_RESISTANCE_K_PER_W = 9.0
"""Thermal resistance from the desktop coil to the room, K/W. Estimate: 8 K/W."""

AMBIENT_C = 25.0
COPPER_PER_K = 0.0039
"""Relative increase of the resistance of copper per kelvin above 20 degC."""

PLAUSIBLE_C = (-20.0, 150.0)
"""Range of plausible sensor readings, degC; outside it the sensor has failed or is unplugged."""


class WindingTemperature:
    """First-order model of the winding; ``temperature_c`` is NaN until the first plausible sensor reading.

    It runs as long as the instrument is open, also between tests. A warmer sensor reading replaces the calculated
    temperature; a cooler one does not. Heat, heat capacity and cooling all scale with the coil resistance, so the
    temperature depends on the current alone, not on whether the resistance was measured warm.
    """

    def __init__(self, device: DeviceDescription) -> None:
        self.temperature_c = float("nan")
        self._resistance_ohm = device.coil_resistance_ohm
        self._interval_s = 1.0 / device.sample_rate_hz
        wire = device.coil_resistance_ohm / DESKTOP.coil_resistance_ohm
        self._heat_capacity = HEAT_CAPACITY_J_PER_K * wire
        self._thermal_resistance = THERMAL_RESISTANCE_K_PER_W / wire

    def take(self, current_a: NDArray[np.float64], sensor_c: NDArray[np.float64], highest_a: float) -> None:
        """Add samples in order, both of shape (n,). A lost sample (NaN) counts as ``highest_a``."""
        readings = sensor_c[(sensor_c >= PLAUSIBLE_C[0]) & (sensor_c <= PLAUSIBLE_C[1])]
        sensor = float(np.add.reduce(readings)) / readings.size if readings.size else math.nan
        if math.isnan(self.temperature_c):
            self.temperature_c = sensor
        if current_a.size == 0 or math.isnan(self.temperature_c):
            return
        squared = np.where(np.isfinite(current_a), current_a, highest_a) ** 2
        # Integrate in steps of 0.1 s: one step over a long gap would overestimate the heat loss.
        steps = max(1, squared.size // round(0.1 / self._interval_s))
        for part in np.array_split(squared, steps) if steps > 1 else (squared,):
            resistance = self._resistance_ohm * (1.0 + COPPER_PER_K * max(0.0, self.temperature_c - 20.0))
            lost_w = (self.temperature_c - AMBIENT_C) / self._thermal_resistance
            heat_w = resistance * (float(np.add.reduce(part)) / part.size)
            self.temperature_c += (heat_w - lost_w) * part.size * self._interval_s / self._heat_capacity
        if readings.size:
            self.temperature_c = max(self.temperature_c, sensor)

    def cool(self, seconds: float) -> None:
        """Add a time without current, s."""
        kept = float(np.exp(-seconds / (self._heat_capacity * self._thermal_resistance)))
        self.temperature_c = AMBIENT_C + (self.temperature_c - AMBIENT_C) * kept
