"""What an instrument is: the figures that a session carries in its ``/instrument`` attributes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

GRAVITY_M_S2 = 9.80665

SIMULATED_SERIAL = "TWIN-"
"""Beginning of the serial number of an instrument that the twin plays."""

SIMULATED_LINE = "Simulated instrument: not a measurement of a person."
"""Remark on every page of a session that a simulation recorded."""


@dataclass(frozen=True)
class DeviceDescription:
    """Nominal figures of an indenter, SI. Defaults: the desktop research device (Chen 2010, 2.2.1)."""

    model: str = "desktop indenter"
    serial_number: str = "unknown"
    coil_resistance_ohm: float = 12.0
    coil_inductance_h: float = 1.00e-3
    force_constant_n_per_a: float = 3.0
    moving_mass_kg: float = 0.060
    bearing_damping_n_s_per_m: float = 3.5
    amplifier_gain: float = 1.0
    amplifier_limit_v: float = 48.0
    stroke_m: float = 0.032
    sample_rate_hz: float = 2000.0
    calibration_spring_n_per_m: float = 1000.0
    calibration_relative_uncertainty: float = 0.02
    firmware_version: str = ""
    protocol_version: str = ""
    calibration: dict[str, float | str] = field(default_factory=dict)

    @property
    def simulated(self) -> bool:
        """Whether it is a simulation, by its own name: in this process, of a twin, or of the firmware."""
        return "simulat" in self.model.lower() or self.serial_number.startswith(SIMULATED_SERIAL)

    def voltage_for_force(self, force_n: float) -> float:
        """Volts that hold a steady coil force: V = F R / (force constant), no motion, no back-EMF."""
        return force_n * self.coil_resistance_ohm / (self.force_constant_n_per_a * self.amplifier_gain)

    @property
    def greatest_force_n(self) -> float:
        """The steady coil force that the amplifier can hold, N, in whole tenths."""
        most = self.amplifier_limit_v / (self.voltage_for_force(1.0) * max(1.0, self.amplifier_gain))
        return math.floor(10.0 * most) / 10.0

    def weight_n(self, gravity_along_stroke_m_s2: float = GRAVITY_M_S2) -> float:
        """Pull of gravity on the moving part along the stroke, N into the tissue; by default straight down."""
        return self.moving_mass_kg * gravity_along_stroke_m_s2


DESKTOP = DeviceDescription()
"""The desktop research device (thesis 2.2.1)."""

_WIRE = 9.5 / DESKTOP.coil_resistance_ohm
"""Length of the handheld's wire over the desktop's, by their resistances; of the same gage, and its turns alike."""

HANDHELD = DeviceDescription(
    model="handheld indenter",
    coil_resistance_ohm=9.5,
    coil_inductance_h=DESKTOP.coil_inductance_h * _WIRE**2,
    force_constant_n_per_a=DESKTOP.force_constant_n_per_a * 0.35 / 0.53 * _WIRE,
    moving_mass_kg=0.0395,
)
"""The handheld device (thesis 2.2.2: 9.5 ohm, 0.35 T, 39.5 g of 256 g, 32 mm).

Force constant and inductance are not given there. They follow from the desktop's: the force constant goes as field and
length of wire, the inductance as the square of the turns. A calibration puts them right.
"""


def angle_deg(a: tuple[float, float], b: tuple[float, float]) -> float:
    """The angle between two vectors in one plane, degrees from 0 to 180; 0 where one of them has no length."""
    length = math.hypot(*a) * math.hypot(*b)
    if length == 0.0:
        return 0.0
    return math.degrees(math.acos(max(-1.0, min(1.0, (a[0] * b[0] + a[1] * b[1]) / length))))
