"""Thermal model of the winding, which has neither the lag nor the faults of a sensor.

One heat capacity and one thermal resistance, both chosen for a higher temperature than the coil's (docs/safety.md gives
the margins). They are those of the desktop coil; for another coil of the same wire, copper mass and surface are
proportional to the resistance. The model runs from reset to reset in every state; no request of the host changes it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

COIL_OHM = 12.0
"""Resistance of the coil to which the next two constants belong."""

HEAT_CAPACITY_J_PER_K = 16.5
THERMAL_RESISTANCE_K_PER_W = 9.0
AMBIENT_C = 28.0
COPPER_PER_K = 0.0039
"""Relative increase of copper's resistance per kelvin above 20 degC."""

RESTART_MARGIN_K = 5.0
"""Margin after a reset, K: the winding may be warmer than its sensor, which lags."""

SENSOR_RANGE_C = (20.0, 150.0)
"""Plausible range of the sensor, degC; a reading outside it is replaced by the nearer end."""


class WindingModel:
    """Integrates the heat of the measured current. ``temperature_c`` is NaN until the first samples after a reset.

    ``resistance_ohm`` is the nominal resistance of the coil, which determines the length of its wire.
    """

    def __init__(self, resistance_ohm: float, sample_rate_hz: float) -> None:
        self._resistance_ohm = resistance_ohm
        wire = resistance_ohm / COIL_OHM
        self._heat_capacity = HEAT_CAPACITY_J_PER_K * wire
        self._thermal_resistance = THERMAL_RESISTANCE_K_PER_W / wire
        self._interval_s = 1.0 / sample_rate_hz
        self.temperature_c = float("nan")

    def advance(self, current_a: NDArray[np.float64], sensor_c: NDArray[np.float64]) -> None:
        """Advance by the samples of one block, both of shape (n,). The sensor can raise the temperature, never lower
        it.
        """
        if current_a.size == 0:
            return
        low, high = SENSOR_RANGE_C
        sensor = min(max(float(np.add.reduce(sensor_c)) / sensor_c.size, low), high)
        if math.isnan(self.temperature_c):
            self.temperature_c = sensor + RESTART_MARGIN_K
        resistance = self._resistance_ohm * (1.0 + COPPER_PER_K * max(0.0, self.temperature_c - 20.0))
        heat_w = resistance * (float(np.add.reduce(current_a**2)) / current_a.size)
        lost_w = (self.temperature_c - AMBIENT_C) / self._thermal_resistance
        self.temperature_c += (heat_w - lost_w) * current_a.size * self._interval_s / self._heat_capacity
        self.temperature_c = max(self.temperature_c, sensor)
