"""Which calibration is in force: the newest that can be believed lays its figures over the nominal ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from tissueid.calibration.judging import judged
from tissueid.calibration.layers import BETWEEN, NO_REGION, POSITION, Used, joined, laid_over, number_of
from tissueid.calibration.store import Stored, calibration_folder, stored_calibrations
from tissueid.device import DeviceDescription
from tissueid.instrument import Correction, Instrument

_CHANNELS = {
    "current": (None, "current_offset_a"),
    "voltage": (None, "voltage_offset_v"),
    "position": ("position_gain", "position_offset_m"),
    "temperature": (None, "temperature_offset_c"),
    "acceleration_x": ("acceleration_gain", "acceleration_offset_m_s2"),
}
"""What each recorded channel is corrected by. Gains of current and voltage are within force constant and resistance."""
_NOT_FOR_A_SWEEP = (
    "force_constant_n_per_a",
    "force_constant_n_per_a_std",
    "calibration_relative_uncertainty",
    "warnings",
)
"""What a sweep goes by only after it: it must not know the force constant that it looks for."""
NOT_CALIBRATED = "not calibrated: the nominal figures are used"


@dataclass(frozen=True)
class InForce:
    """What an instrument goes by: its figures, and in words what was made of the calibrations there are."""

    device: DeviceDescription
    words: str
    warnings: tuple[str, ...]

    @property
    def state(self) -> str:
        """``valid``, ``stale`` or ``none``."""
        return str(self.device.calibration.get("state", "none"))


def calibrated(
    instrument: Instrument, folder: Path | None = None, *, wanted: bool = True, now: datetime | None = None
) -> InForce:
    """Put the newest calibrations of an instrument in force, from a folder (``calibration_folder``).

    With ``wanted`` false, or where there is none, the nominal figures are.

    Raises:
        UnusableInputError: the folder cannot be read.
        InstrumentError: a test is running.
    """
    now = now or datetime.now(UTC)
    stored = stored_calibrations(calibration_folder(folder)) if wanted else ()
    device = put_in_force(instrument.nominal, stored, now)
    instrument.use_calibration(device, corrections(device))
    return InForce(device, in_words(device, now), warnings_of(device))


def go_by_static(
    instrument: Instrument, folder: Path | None = None, now: datetime | None = None
) -> dict[str, float | str]:
    """Correct what is read by the static calibration in force; a sweep from before is out of force meanwhile.

    For a sweep, which must not go by what one before it found. Returns which calibration that is, as conditions of what
    is measured; nothing where there is none.

    Raises:
        UnusableInputError: the folder cannot be read.
        InstrumentError: a test is running.
    """
    nominal = instrument.nominal
    stored = [
        item
        for item in stored_calibrations(calibration_folder(folder))
        if item.calibration is not None and item.calibration.kind == "static"
    ]
    known = put_in_force(nominal, stored, now or datetime.now(UTC))
    kept = {name: value for name, value in known.calibration.items() if not name.endswith(_NOT_FOR_A_SWEEP)}
    if warnings := [line for line in warnings_of(known) if line != NO_REGION]:
        kept["warnings"] = joined(warnings)
    device = replace(nominal, coil_resistance_ohm=known.coil_resistance_ohm, calibration=kept)
    instrument.use_calibration(device, corrections(device))
    return static_conditions(device)


def static_conditions(device: DeviceDescription) -> dict[str, float | str]:
    """Under which static calibration something is measured: its file, its date, its scale of the position."""
    known = device.calibration
    return {name: known[name] for name in ("static_file", "static_date", *POSITION) if name in known}


def put_in_force(nominal: DeviceDescription, stored: Sequence[Stored], now: datetime) -> DeviceDescription:
    """The device with calibrated figures over the nominal ones; ``calibration`` says whose and since when.

    The newest sweep that can be used is; of static calibrations each figure is that of the newest that holds it, good
    ones before stale ones, so that one of a few steps does not undo a whole one. All that was refused on the way and is
    this device's own, and all that is older than the newest, is a warning. Where there is nothing at all, the device
    stays as it was.
    """
    used: dict[str, list[Used]] = {"static": [], "sweep": []}
    warnings: list[str] = []
    refused = False
    for item in sorted(stored, key=lambda item: (item.made, item.path.name), reverse=True):
        state, reason = judged(item, nominal, now)
        calibration = item.calibration
        if state == "damaged":
            warnings.append(reason)
        if calibration is None or calibration.serial_number != nominal.serial_number:
            continue
        before = used[calibration.kind]
        if state in ("valid", "stale"):
            if before and before[0].made == calibration.made and before[0].differs(calibration):
                warnings.append(
                    f"{before[0].file} and {item.path.name} are of the same time and differ: the former is used; "
                    "take the wrong one away"
                )
            before.append(Used(item.path.name, calibration, state, reason))
        elif not before:
            refused = refused or calibration.kind == "static"
            warnings.append(f"{item.path.name}: {reason}")
    found = laid_over(nominal, used["static"], used["sweep"][:1], warnings)
    if refused and not used["static"] and used["sweep"]:
        found = replace(found, calibration=found.calibration | {"static_state": "refused"})
    return found


def corrections(device: DeviceDescription) -> dict[str, Correction]:
    """By what the recorded channels are corrected under the calibration that a device carries."""
    known = device.calibration
    found: dict[str, Correction] = {}
    for channel, (gain, offset) in _CHANNELS.items():
        correction = Correction(number_of(known, gain, 1.0), number_of(known, offset, 0.0))
        if correction != Correction():
            found[channel] = correction
    return found


def warnings_of(device: DeviceDescription) -> tuple[str, ...]:
    """What is to be said of the calibration that a device carries."""
    return tuple(line for line in str(device.calibration.get("warnings", "")).split(BETWEEN) if line)


def _age(date: str, now: datetime) -> str:
    try:
        made = datetime.fromisoformat(date)
        days = now - (made if made.tzinfo else made.replace(tzinfo=UTC))
    except (ValueError, OverflowError):
        return "an unknown time ago"
    whole = max(0, round(days.total_seconds() / 86400.0))
    return "today" if whole == 0 else "yesterday" if whole == 1 else f"{whole} days ago"


def in_words(device: DeviceDescription, now: datetime | None = None) -> str:
    """The calibration that a device carries, in a line: "calibrated 12 days ago, linear from 4.0 to 27.5 mm".

    Where only the sweep is in force it says so, and by what force is known then.
    """
    known = device.calibration
    dates = [str(known[name]) for name in ("static_date", "sweep_date") if known.get(name)]
    if not dates:
        return NOT_CALIBRATED
    age = _age(min(dates), now or datetime.now(UTC))
    words = f"calibrated {age}"
    if not known.get("static_date"):
        force = "nominal force" if "force_constant_n_per_a" not in known else "force by the sweep"
        static = "static calibration refused" if known.get("static_state") == "refused" else "no static calibration"
        words = f"{static}: {force}, sweep of {age}"
    if known.get("state") == "stale":
        words = f"calibration is stale: {words}"
    low, high = known.get("linear_region_min_m"), known.get("linear_region_max_m")
    if isinstance(low, float) and isinstance(high, float):
        return f"{words}, linear from {1e3 * low:.1f} to {1e3 * high:.1f} mm"
    return f"{words}, linear region not known"
