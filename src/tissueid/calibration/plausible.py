"""What can be true of an instrument: how far its figures may lie from what it says of itself."""

from __future__ import annotations

from tissueid.calibration.file import Calibration
from tissueid.device import DeviceDescription

IMPLAUSIBLE = 0.20
"""Relative distance from the nominal figure beyond which a calibrated one is not believed."""
LAID_OVER = {
    "coil_resistance_ohm": IMPLAUSIBLE,
    "force_constant_n_per_a": IMPLAUSIBLE,
    "moving_mass_kg": IMPLAUSIBLE,
    "coil_inductance_h": 0.5,
    "bearing_damping_n_s_per_m": 0.5,
}
"""Figures of the device that a calibration measures, and how far each may be from the nominal one."""
BOUNDS = {
    "current_offset_a": (-0.3, 0.3),
    "voltage_offset_v": (-1.0, 1.0),
    "voltage_gain": (1.0 - IMPLAUSIBLE, 1.0 + IMPLAUSIBLE),
    "position_gain": (1.0 - IMPLAUSIBLE, 1.0 + IMPLAUSIBLE),
    "position_offset_m": (-3e-3, 3e-3),
    "temperature_offset_c": (-10.0, 10.0),
    "acceleration_gain": (1.0 - IMPLAUSIBLE, 1.0 + IMPLAUSIBLE),
    "acceleration_offset_m_s2": (-2.0, 2.0),
    "calibration_relative_uncertainty": (0.0, 0.5),
}
"""Between which values every other figure lies that is used."""
_BESIDE_M = 2e-3
"""By so much may an end of the stroke, or of the linear region, lie beside the nominal stroke."""


def implausible(calibration: Calibration, nominal: DeviceDescription) -> str:
    """What cannot be true of a calibration of this device, in words; "" where nothing is."""
    for name, most in LAID_OVER.items():
        if (found := calibration.quantities.get(name)) is not None:
            usual = getattr(nominal, name)
            if not abs(found.value - usual) <= most * abs(usual):  # so that nothing is near a nominal NaN
                return f"{name} is {found.value:.4g}, more than {100 * most:.0f} % from the nominal {usual:.4g}"
    for name, (least, most) in BOUNDS.items():
        if (found := calibration.quantities.get(name)) is not None and not least <= found.value <= most:
            return f"{name} is {found.value:.4g}, which is not between {least:g} and {most:g}"
    for kind in ("linear_region", "stroke"):
        ends = [calibration.quantities.get(f"{kind}_{end}_m") for end in ("min", "max")]
        found_m = [end.value for end in ends if end is not None]
        on_stroke = all(-_BESIDE_M <= end_m <= nominal.stroke_m + _BESIDE_M for end_m in found_m)
        if not on_stroke or (len(found_m) == 2 and not found_m[0] < found_m[1]):
            words = " to ".join(f"{1e3 * end_m:.1f}" for end_m in found_m)
            return f"{kind.replace('_', ' ')} from {words} mm is not on the stroke"
    return ""
