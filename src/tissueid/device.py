"""What an instrument is: the figures that a session carries in its ``/instrument`` attributes."""

from __future__ import annotations

from dataclasses import dataclass, field


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

    def voltage_for_force(self, force_n: float) -> float:
        """Volts that hold a steady coil force: V = F R / (force constant), no motion, no back-EMF."""
        return force_n * self.coil_resistance_ohm / (self.force_constant_n_per_a * self.amplifier_gain)
