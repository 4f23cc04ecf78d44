"""Plausibility of a calibration: allowed deviation of its quantities from the nominal values."""

from __future__ import annotations

from tissueid.calibration.file import Calibration
from tissueid.calibration.labels import label_of
from tissueid.device import DeviceDescription
from tissueid.language import marked
from tissueid.messages import Message, Quantity

IMPLAUSIBLE = 0.20
"""Relative deviation from the nominal value above which a calibrated value is rejected."""
DEVICE_TOLERANCES = {
    "coil_resistance_ohm": IMPLAUSIBLE,
    "force_constant_n_per_a": IMPLAUSIBLE,
    "moving_mass_kg": IMPLAUSIBLE,
    "coil_inductance_h": 0.5,
    "bearing_damping_n_s_per_m": 0.5,
}
"""Calibrated device properties and the largest relative deviation of each from its nominal value."""
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
"""Lower and upper bound of every other quantity that is applied, SI."""
_STROKE_MARGIN_M = 2e-3
"""Largest distance of an end of the stroke, or of the linear region, outside the nominal stroke, m."""
_RANGES = {"linear_region": marked("linear region"), "stroke": marked("stroke")}


def first_implausible(calibration: Calibration, nominal: DeviceDescription) -> str:
    """Return the first implausible quantity of a calibration of this device as a message; "" without one."""
    for name, tolerance in DEVICE_TOLERANCES.items():
        if (found := calibration.quantities.get(name)) is not None:
            usual = getattr(nominal, name)
            if not abs(found.value - usual) <= tolerance * abs(usual):  # false for a nominal NaN
                return Message(
                    "calibration.implausible.nominal",
                    "{label} is {value:.4g}, more than {percent:.0f} % from the nominal {nominal:.4g}",
                    label=label_of(name),
                    name=name,
                    value=found.value,
                    percent=100.0 * tolerance,
                    nominal=usual,
                )
    for name, (least, most) in BOUNDS.items():
        if (found := calibration.quantities.get(name)) is not None and not least <= found.value <= most:
            return Message(
                "calibration.implausible.bounds",
                "{label} is {value:.4g}, which is not between {least:g} and {most:g}",
                label=label_of(name),
                name=name,
                value=found.value,
                least=least,
                most=most,
            )
    for kind, label in _RANGES.items():
        ends = [calibration.quantities.get(f"{kind}_{end}_m") for end in ("min", "max")]
        found_m = [end.value for end in ends if end is not None]
        on_stroke = all(-_STROKE_MARGIN_M <= end_m <= nominal.stroke_m + _STROKE_MARGIN_M for end_m in found_m)
        if len(found_m) == 2 and not (on_stroke and found_m[0] < found_m[1]):
            low, high = (Quantity(1e3 * end_m, "mm", 1) for end_m in found_m)
            return Message(
                "calibration.implausible.range",
                "the {range} from {low} to {high} is not on the stroke",
                range=label,
                low=low,
                high=high,
            )
        if not on_stroke:
            return Message(
                "calibration.implausible.end",
                "an end of the {range}, {end}, is not on the stroke",
                range=label,
                end=Quantity(1e3 * found_m[0], "mm", 1),
            )
    return ""
