"""Quick electrical check of the coil, gentle enough on skin: the first step of thesis 2.4.1, not a calibration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tissueid.calibration.coil import resistance_of
from tissueid.calibration.file import utc_date
from tissueid.calibration.step_levels import hold_levels, straight_line
from tissueid.instrument import CLINICAL, Instrument, Limits
from tissueid.records import Estimate

LEVELS_V = (0.0, 3.0, 6.0, 9.0, 12.0)
"""Voltages of the check, V: up to 3 N into the tissue."""
HOLD_S = 0.3
"""Time at each voltage, s."""


@dataclass(frozen=True)
class ElectricalCheck:
    """Result of the check: coil resistance, offset of the current channel, and noise at rest."""

    coil_resistance_ohm: Estimate
    current_offset_a: Estimate
    position_noise_m: float
    residual_a: float
    passed: bool
    date: str

    def as_calibration(self) -> dict[str, float | str]:
        """Return the check as the calibration attributes of a session."""
        return {
            "kind": "electrical check",
            "date": self.date,
            "coil_resistance_ohm": self.coil_resistance_ohm.value,
            "coil_resistance_std_ohm": self.coil_resistance_ohm.std or 0.0,
            "current_offset_a": self.current_offset_a.value,
            "position_noise_m": self.position_noise_m,
            "verdict": "passed" if self.passed else "failed",
        }


def check_coil(
    instrument: Instrument,
    limits: Limits = CLINICAL,
    *,
    tolerance: float = 0.05,
    progress: Callable[[float], None] = lambda _: None,
    cancelled: Callable[[], bool] = lambda: False,
) -> ElectricalCheck:
    """Hold five voltages, fit current against measured voltage, and compare the resistance with the nominal one.

    The check passes if the resistance lies within the relative ``tolerance`` of the nominal value.

    Raises:
        UnusableInputError: a level has no samples, or the current does not follow the voltage (open coil).
    """
    levels = hold_levels(instrument, np.array(LEVELS_V), limits, hold_s=HOLD_S, progress=progress, cancelled=cancelled)
    line = straight_line(levels.voltage_v, levels.current_a, levels.noise["current"])
    device = instrument.device
    resistance = resistance_of(line, device)
    return ElectricalCheck(
        coil_resistance_ohm=resistance,
        current_offset_a=line.intercept,
        position_noise_m=float(np.std(np.diff(levels.rest["position"])) / np.sqrt(2.0)),
        residual_a=line.scatter,
        passed=bool(abs(resistance.value / device.coil_resistance_ohm - 1.0) <= tolerance),
        date=utc_date(),
    )
