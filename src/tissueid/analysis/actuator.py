"""Tissue without the actuator: mass and damping of the moving part subtracted (Chen 2010, 2.1), and the coil of a test
that is identified from its voltage (C.2.3)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from tissueid.device import DeviceDescription
from tissueid.identification.depth_profile import DepthProfile
from tissueid.records import Estimate

NOMINAL_RELATIVE_STD = 0.08
"""Relative standard deviation of nominal mass and damping: even distributions over 60 to 80 g and 3 to 4 N s/m, the
ranges of Chen 2010, Table 2.1."""

TISSUE_NAMES = {
    "mass_kg": "tissue_mass_kg",
    "damping_n_s_per_m": "tissue_damping_n_s_per_m",
    "damping_in_n_s_per_m": "tissue_damping_in_n_s_per_m",
    "damping_out_n_s_per_m": "tissue_damping_out_n_s_per_m",
}
"""Parameters of coil and tissue together, and the names of their remainders. The actuator has no stiffness."""


@dataclass(frozen=True)
class Actuator:
    """Moving mass, kg, and bearing damping, N s/m; ``calibrated`` if both are from a calibration sweep."""

    mass: Estimate
    damping: Estimate
    calibrated: bool

    @classmethod
    def of(cls, device: DeviceDescription) -> Actuator:
        """Return the actuator of a device, with the deviations of its sweep or of a nominal description."""

        calibrated = all(
            f"{name}_std" in device.calibration for name in ("moving_mass_kg", "bearing_damping_n_s_per_m")
        )
        return cls(
            _calibrated(device, "moving_mass_kg", NOMINAL_RELATIVE_STD),
            _calibrated(device, "bearing_damping_n_s_per_m", NOMINAL_RELATIVE_STD),
            calibrated,
        )

    def remainders(self, parameters: Mapping[str, Estimate]) -> dict[str, Estimate]:
        """Return mass and damping of the tissue alone by their names in ``TISSUE_NAMES``.

        The deviation combines those of the fit and of the actuator, which are independent; None without that of the
        fit.
        """
        found = {}
        for name, new in TISSUE_NAMES.items():
            if name in parameters:
                total, own = parameters[name], self.mass if name == "mass_kg" else self.damping
                std = None if total.std is None else math.hypot(total.std, own.std or 0.0)
                found[new] = Estimate(total.value - own.value, std)
        return found

    def without(self, profile: DepthProfile) -> DepthProfile:
        """Return a depth profile with mass and damping of the tissue alone."""
        return replace(
            profile,
            mass=profile.mass - self.mass.value,
            mass_std=np.hypot(profile.mass_std, self.mass.std or 0.0),
            damping=profile.damping - self.damping.value,
            damping_std=np.hypot(profile.damping_std, self.damping.std or 0.0),
        )


@dataclass(frozen=True)
class Coil:
    """Resistance, ohm, and force constant, N/A, of the coil."""

    resistance: Estimate
    force_constant: Estimate

    @classmethod
    def of(cls, device: DeviceDescription) -> Coil | None:
        """Return the coil of a device; None where the session does not hold its resistance or its force constant."""
        relative_std = device.calibration_relative_uncertainty
        figures = [
            _calibrated(device, name, relative_std) for name in ("coil_resistance_ohm", "force_constant_n_per_a")
        ]
        return cls(*figures) if all(figure.value > 0.0 for figure in figures) else None


def _calibrated(device: DeviceDescription, name: str, relative_std: float) -> Estimate:
    """Return a figure of a device with the deviation of its calibration, or else a relative one; None if NaN."""
    number = getattr(device, name)
    std = device.calibration.get(f"{name}_std")
    if isinstance(std, float) and math.isfinite(std):
        return Estimate(number, std)
    return Estimate(number, relative_std * abs(number) if math.isfinite(relative_std) else None)
