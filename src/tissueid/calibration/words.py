"""Calibrations in words: what each figure is called, its value with its deviation and unit, and the verdict."""

from __future__ import annotations

from tissueid.calibration.file import Calibration, Quantity
from tissueid.records import Estimate
from tissueid.wording import named_unit, people_unit, plus_minus

_LABELS = {
    "current_offset_a": "Current that reads where none flows",
    "current_residual_a": "Scatter about the line of current",
    "voltage_gain": "Voltage for one volt of command",
    "voltage_offset_v": "Voltage that reads where none is",
    "force_constant_n_per_a": "Force constant",
    "calibration_relative_uncertainty": "Relative uncertainty of force, the reference's included",
    "spring_n_per_m": "Spring that it was held against",
    "spring_slope_m_per_a": "Reading of position for one ampere",
    "force_position_m": "Reading where no current flows",
    "hysteresis_m": "Hysteresis",
    "position_gain": "Reading for one unit of position",
    "position_offset_m": "Reading where the position is zero",
    "position_nonlinearity_m": "Largest distance of a place from the line",
    "stroke_min_m": "Beginning of the stroke",
    "stroke_max_m": "End of the stroke",
    "carrying_current_a": "Current that carries the moving part",
    "moving_weight_n": "Weight of the moving part along the stroke",
    "temperature_at_rest_c": "Thermometer before the coil was used",
    "temperature_offset_c": "Thermometer above the room",
    "temperature_rise_c": "Rise of the thermometer under the voltages",
    "heat_j": "Heat that went into the coil meanwhile",
    "acceleration_gain": "Accelerometer's reading for gravity",
    "acceleration_offset_m_s2": "Accelerometer's zero",
    "gravity_along_stroke_m_s2": "Gravity along the stroke",
    "supply_position_drift_m": "Drift of the position at rest",
    "supply_resistance_drift": "Relative drift of the resistance",
    "supply_voltage_drift": "Relative drift of the voltage",
    "supply_current_zero_drift": "Drift of the current's zero",
    "linear_region_min_m": "Linear region from",
    "linear_region_max_m": "Linear region to",
    "moving_mass_kg": "Moving mass",
    "resistance_in_the_sweep_ohm": "Resistance in the sweep",
    "spring_over_flux": "Force constant by the spring over that by flux linkage",
    "position_over_stage": "Reading for one unit of the stage's way",
    "least_vaf_percent": "Least VAF of a position",
}
_CHANNELS = {
    "voltage_v": "voltage",
    "current_a": "current",
    "position_m": "position",
    "temperature_c": "temperature",
    "acceleration_x_m_s2": "acceleration along the stroke",
}
_UNITS = {"m/s^2": "m/s²"}


def label_of(name: str) -> str:
    """What a figure of a calibration is called."""
    for kind, words in (("noise_", "Noise of a sample of"), ("mains_", "Mains in")):
        if name.startswith(kind) and name.removeprefix(kind) in _CHANNELS:
            return f"{words} {_CHANNELS[name.removeprefix(kind)]}"
    return _LABELS.get(name) or named_unit(name)[0]


def readable(name: str, found: Quantity) -> tuple[str, str, str]:
    """Label, value with its deviation, and unit, as people read them."""
    unit, scale = people_unit(_UNITS.get(found.unit, found.unit))
    if found.unit == "m/A":
        unit, scale = "mm/A", 1e3
    elif name == "calibration_relative_uncertainty":
        unit, scale = "%", 100.0
    elif found.unit == "m" and 0.0 < max(abs(found.value), found.std or 0.0) < 1e-4:
        unit, scale = "µm", 1e6
    elif found.unit in ("A", "V") and 0.0 < max(abs(found.value), found.std or 0.0) < 0.1:
        unit, scale = f"m{found.unit}", 1e3
    return label_of(name), plus_minus(Estimate(found.value, found.std), scale), unit


def verdict_of(calibration: Calibration) -> str:
    """The verdict in a line."""
    if calibration.verdict == "passed":
        return "passed: good for use" if calibration.quantities else "passed, and holds no figures"
    return "failed: it is kept, and never put in force"


def notes_of(calibration: Calibration) -> tuple[str, ...]:
    """What else is worth saying of a calibration, as its conditions keep it."""
    found = calibration.conditions
    return tuple(str(value) for name, value in found.items() if name.startswith("note_"))
