"""Texts about a calibration: labels of its quantities, its verdict, its problems and notes."""

from __future__ import annotations

from tissueid.calibration.file import CalibratedQuantity, Calibration
from tissueid.formatting import label_and_unit, plus_minus
from tissueid.language import marked
from tissueid.messages import Message, message_from
from tissueid.records import Estimate
from tissueid.units import unit_for

_LABELS = {
    "current_offset_a": marked("Zero of the current channel"),
    "current_residual_a": marked("Scatter about the line of current"),
    "voltage_gain": marked("Voltage per volt of command"),
    "voltage_offset_v": marked("Zero of the voltage channel"),
    "coil_resistance_ohm": marked("Coil resistance"),
    "coil_inductance_h": marked("Coil inductance"),
    "bearing_damping_n_s_per_m": marked("Bearing damping"),
    "force_constant_n_per_a": marked("Force constant"),
    "calibration_relative_uncertainty": marked("Relative uncertainty of force, including the reference"),
    "spring_n_per_m": marked("Stiffness of the calibration spring"),
    "spring_slope_m_per_a": marked("Position reading per ampere"),
    "force_position_m": marked("Position reading without current"),
    "hysteresis_m": marked("Hysteresis"),
    "position_gain": marked("Reading per unit of position"),
    "position_offset_m": marked("Reading at position zero"),
    "position_nonlinearity_m": marked("Largest deviation from the line of position"),
    "stroke_min_m": marked("Start of the stroke"),
    "stroke_max_m": marked("End of the stroke"),
    "carrying_current_a": marked("Current that carries the moving part"),
    "moving_weight_n": marked("Weight of the moving part along the stroke"),
    "temperature_at_rest_c": marked("Temperature reading before use"),
    "temperature_offset_c": marked("Temperature reading above room temperature"),
    "temperature_rise_c": marked("Temperature rise during the voltage steps"),
    "heat_j": marked("Heat put into the coil by the voltage steps"),
    "acceleration_gain": marked("Accelerometer reading relative to gravity"),
    "acceleration_offset_m_s2": marked("Zero of the accelerometer"),
    "gravity_along_stroke_m_s2": marked("Gravity along the stroke"),
    "supply_position_drift_m": marked("Drift of the position at rest"),
    "supply_resistance_drift": marked("Relative drift of the resistance"),
    "supply_voltage_drift": marked("Relative drift of the voltage"),
    "supply_current_zero_drift": marked("Drift of the zero of the current channel"),
    "linear_region_min_m": marked("Start of the linear region"),
    "linear_region_max_m": marked("End of the linear region"),
    "moving_mass_kg": marked("Moving mass"),
    "resistance_in_the_sweep_ohm": marked("Resistance during the sweep"),
    "spring_over_flux": marked("Ratio of force constants, spring to flux linkage"),
    "position_over_stage": marked("Position reading per unit of stage travel"),
    "least_vaf_percent": marked("Lowest VAF of all positions"),
    "noise_voltage_v": marked("Noise of the voltage per sample"),
    "noise_current_a": marked("Noise of the current per sample"),
    "noise_position_m": marked("Noise of the position per sample"),
    "noise_temperature_c": marked("Noise of the temperature per sample"),
    "noise_acceleration_x_m_s2": marked("Noise of the acceleration along the stroke per sample"),
    "mains_voltage_v": marked("Mains interference in the voltage"),
    "mains_current_a": marked("Mains interference in the current"),
    "mains_position_m": marked("Mains interference in the position"),
    "mains_temperature_c": marked("Mains interference in the temperature"),
    "mains_acceleration_x_m_s2": marked("Mains interference in the acceleration along the stroke"),
}
"""Label of each quantity of a calibration file."""
CHANNELS = {
    "voltage": marked("voltage"),
    "current": marked("current"),
    "position": marked("position"),
    "temperature": marked("temperature"),
    "acceleration_x": marked("acceleration along the stroke"),
}
"""Name of each channel within a sentence."""
_KINDS = {"static": marked("Static calibration"), "sweep": marked("Dynamic sweep")}


def label_of(name: str) -> str:
    """Return the label of a quantity in English; ``translated`` gives it in the active language."""
    return _LABELS.get(name) or label_and_unit(name)[0]


def readable(name: str, found: CalibratedQuantity) -> tuple[str, str, str]:
    """Return label, value with standard deviation, and display unit of a quantity."""
    unit, scale = unit_of_quantity(name, found)
    return label_of(name), plus_minus(Estimate(found.value, found.std), scale), unit


def unit_of_quantity(name: str, found: CalibratedQuantity) -> tuple[str, float]:
    """Return the display unit of a quantity, with a prefix for small values, and the factor to it."""
    if name == "calibration_relative_uncertainty":
        return "%", 100.0
    return unit_for(found.unit, max(abs(found.value), found.std or 0.0))


def verdict_of(calibration: Calibration) -> Message:
    """Return the verdict of a calibration."""
    if calibration.verdict == "failed":
        return Message("calibration.verdict.failed", "failed: it is kept but never used")
    if not calibration.quantities:
        return Message("calibration.verdict.empty", "passed, but contains no quantities")
    return Message("calibration.verdict.passed", "passed: ready for use")


def headline_of(calibration: Calibration) -> Message:
    """Return kind and verdict of a calibration as a headline."""
    return Message(
        "calibration.headline", "{kind} {verdict}", kind=_KINDS[calibration.kind], verdict=verdict_of(calibration)
    )


def problems_of(calibration: Calibration) -> tuple[str, ...]:
    """Return the problems of a failed calibration, as messages where its file keeps them."""
    return _as_messages(calibration, calibration.problems)


def notes_of(calibration: Calibration) -> tuple[str, ...]:
    """Return the notes that a calibration keeps among its conditions, as messages where its file keeps them."""
    notes = (str(value) for name, value in calibration.conditions.items() if name.startswith("note_"))
    return _as_messages(calibration, tuple(notes))


def _as_messages(calibration: Calibration, texts: tuple[str, ...]) -> tuple[str, ...]:
    known = {stored_text(message): message for message in map(message_from, calibration.messages)}
    return tuple(known.get(text, text) for text in texts)


def stored_text(message: str) -> str:
    """Return a message as the text that a calibration file can hold: one line of at most 500 characters."""
    return " ".join(str(message).split())[:500]
