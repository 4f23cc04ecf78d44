"""Status of a calibration (usable, stale or rejected), and plausibility of its quantities."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

import platformdirs

from tissueid.atomic_write import unused_path
from tissueid.calibration.file import CalibratedQuantity, Calibration, read_calibration
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.formatting import label_and_unit, plus_minus
from tissueid.language import marked
from tissueid.messages import Message, Quantity, Verbatim, message_from
from tissueid.records import Estimate
from tissueid.units import unit_for

VARIABLE = "TISSUEID_CALIBRATIONS"
"""Environment variable that names a calibration folder other than the user's own."""
_MAX_FILES = 5000
"""Maximum number of files in the folder."""


@dataclass(frozen=True)
class Stored:
    """Calibration and its file. ``problem`` is the reason why ``calibration`` is None."""

    path: Path
    calibration: Calibration | None
    problem: str = ""

    @property
    def made(self) -> datetime:
        """Date of the calibration; the earliest possible date if it cannot be read."""
        return self.calibration.made if self.calibration else datetime.min.replace(tzinfo=UTC)


def calibration_folder(given: Path | None = None) -> Path | None:
    """Return the calibration folder: ``given``, else from the environment variable, else the user's own.

    The current folder is never used: the active calibration must not depend on where a program is started. None if the
    folder does not exist yet, because no instrument was calibrated on this account.

    Raises:
        UnusableInputError: the given or named folder does not exist.
    """
    named = os.environ.get(VARIABLE)
    chosen = given if given is not None else Path(named) if named else None
    if chosen is not None:
        if not chosen.is_dir():
            raise UnusableInputError(
                "calibration.no_folder", "there is no calibration folder {folder}", folder=str(chosen)
            )
        return chosen
    own = user_calibration_folder()
    return own if own.is_dir() else None


def user_calibration_folder() -> Path:
    """Return the calibration folder in the user's data folder; it need not exist."""
    return platformdirs.user_data_path("tissueid") / "calibration_data"


def create_calibration_folder(given: Path | None = None) -> Path:
    """Return ``calibration_folder(given)``, and create it if it does not exist yet.

    Raises:
        UnusableInputError: the given or named folder does not exist, or the user's own cannot be created.
    """
    folder = calibration_folder(given) or user_calibration_folder()
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise UnusableInputError(
            "file.no_new_folder",
            "cannot create the folder {folder}: {reason}",
            folder=str(folder),
            reason=str(error.strerror),
        ) from error
    return folder


def free_name(folder: Path, serial_number: str, kind: str, moment: datetime) -> Path:
    """Return an unused path for a new calibration, named by instrument, kind and time."""
    name = f"{re.sub(r'[^A-Za-z0-9-]+', '-', serial_number).strip('-') or 'unknown'}-{kind}-{moment:%Y-%m-%d_%H-%M-%S}"
    suffixes = (".toml", ".html", ".h5")
    return unused_path(
        folder / f"{name}.toml",
        separator="_",
        taken=lambda path: any(path.with_suffix(suffix).exists() for suffix in suffixes),
    )


def is_in_calibration_folder(path: Path) -> bool:
    """Return whether ``path`` is in the calibration folder, where tests look for calibrations."""
    try:
        folder = calibration_folder()
    except UnusableInputError:
        return False
    return folder is not None and path.parent.resolve() == folder.resolve()


def stored_calibrations(folder: Path | None) -> tuple[Stored, ...]:
    """Return all TOML files of a folder, newest first; unreadable files have the reason as ``problem``.

    Raises:
        UnusableInputError: the folder cannot be read or has too many files.
    """
    if folder is None:
        return ()
    try:
        files = sorted(path for path in folder.iterdir() if path.suffix == ".toml" and not path.name.startswith("."))
    except OSError as error:
        raise UnusableInputError(
            "file.folder_unreadable",
            "cannot read the folder {folder}: {reason}",
            folder=str(folder),
            reason=str(error.strerror),
        ) from error
    if len(files) > _MAX_FILES:
        raise UnusableInputError(
            "calibration.too_many",
            "{folder} contains {count} calibrations; the limit is {limit}: move old ones to another folder",
            folder=str(folder),
            count=len(files),
            limit=_MAX_FILES,
        )
    stored = [_stored(path) for path in files]
    return tuple(sorted(stored, key=lambda item: (item.made, item.path.name), reverse=True))


def _stored(path: Path) -> Stored:
    try:
        return Stored(path, read_calibration(path))
    except UnusableInputError as error:
        return Stored(path, None, error.message)


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


def readable(name: str, quantity: CalibratedQuantity) -> tuple[str, str, str]:
    """Return label, value with standard deviation, and display unit of a quantity."""
    unit, scale = unit_of_quantity(name, quantity)
    return label_of(name), plus_minus(Estimate(quantity.value, quantity.std), scale), unit


def unit_of_quantity(name: str, quantity: CalibratedQuantity) -> tuple[str, float]:
    """Return the display unit of a quantity, with a prefix for small values, and the factor to it."""
    if name == "calibration_relative_uncertainty":
        return "%", 100.0
    return unit_for(quantity.unit, max(abs(quantity.value), quantity.std or 0.0))


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
    by_text = {stored_text(message): message for message in map(message_from, calibration.messages)}
    return tuple(by_text.get(text, text) for text in texts)


def stored_text(message: str) -> str:
    """Return a message as the text that a calibration file can hold: one line of at most 500 characters."""
    return " ".join(str(message).split())[:500]


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
        if (quantity := calibration.quantities.get(name)) is not None:
            usual = getattr(nominal, name)
            if not abs(quantity.value - usual) <= tolerance * abs(usual):  # false for a nominal NaN
                return Message(
                    "calibration.implausible.nominal",
                    "{label} is {value:.4g}, more than {percent:.0f} % from the nominal {nominal:.4g}",
                    label=label_of(name),
                    name=name,
                    value=quantity.value,
                    percent=100.0 * tolerance,
                    nominal=usual,
                )
    for name, (least, most) in BOUNDS.items():
        if (quantity := calibration.quantities.get(name)) is not None and not least <= quantity.value <= most:
            return Message(
                "calibration.implausible.bounds",
                "{label} is {value:.4g}, which is not between {least:g} and {most:g}",
                label=label_of(name),
                name=name,
                value=quantity.value,
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


State = Literal["valid", "stale", "foreign", "failed", "implausible", "damaged"]
"""State of one calibration: ``valid`` and ``stale`` ones are used, the latter with a warning; others are rejected."""

_CLOCK_DAYS = 1.0
"""Largest clock lead of the calibrating computer, days."""


@dataclass(frozen=True)
class FileStatus:
    """State of a calibration file without reference to a device."""

    state: State
    message: str

    @property
    def usable(self) -> bool:
        """Whether the calibrated device would use it."""
        return self.state in ("valid", "stale")


def file_status(item: Stored, now: datetime) -> FileStatus:
    """Return the state of a calibration from readability, verdict and age alone."""
    calibration = item.calibration
    if calibration is None:
        return FileStatus("damaged", Message("calibration.damaged", "cannot be used: {problem}", problem=item.problem))
    state, reason = _state_by_age(calibration, now)
    if state == "valid":
        days_left = calibration.valid_days - calibration.age_days(now)
        return FileStatus(
            state, Message("calibration.days_left", "passed, valid for {days:.0f} more days", days=days_left)
        )
    return FileStatus(state, reason)


def status_for_device(item: Stored, nominal: DeviceDescription, now: datetime) -> tuple[State, str]:
    """Return the state of a calibration for a device, and the reason; "" if valid."""
    calibration = item.calibration
    if calibration is None:
        return "damaged", item.problem
    if calibration.serial_number != nominal.serial_number:
        return "foreign", Message(
            "calibration.other_device",
            "it belongs to {found}, not to {expected}",
            found=Verbatim(calibration.serial_number),
            expected=Verbatim(nominal.serial_number),
        )
    if calibration.model != nominal.model:
        return "foreign", Message(
            "calibration.other_model",
            "it is of the model '{found}', not '{expected}'",
            found=Verbatim(calibration.model),
            expected=Verbatim(nominal.model),
        )
    if strange := first_implausible(calibration, nominal) if calibration.verdict == "passed" else "":
        return "implausible", strange
    return _state_by_age(calibration, now)


def _state_by_age(calibration: Calibration, now: datetime) -> tuple[State, str]:
    if calibration.verdict == "failed":
        if not calibration.problems:
            return "failed", Message("calibration.failed", "the calibration failed")
        return "failed", Message(
            "calibration.failed_because", "the calibration failed: {problem}", problem=problems_of(calibration)[0]
        )
    age = calibration.age_days(now)
    if age < -_CLOCK_DAYS:
        return "implausible", Message(
            "calibration.future",
            "it was made on {date}, which is in the future: check the clock",
            date=calibration.date[:10],
        )
    if age > calibration.valid_days:
        return "stale", Message(
            "calibration.stale",
            "it is {days:.0f} days old and was valid for {valid_days}: calibrate again",
            days=age,
            valid_days=calibration.valid_days,
        )
    return "valid", ""
