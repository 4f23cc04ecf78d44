"""Mapping of the columns of an imported file to signals and units, with checks of plausibility."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.messages import Action, Message, Verbatim
from tissueid.sessions.imports.imported_table import ImportedTable
from tissueid.sessions.model import SIGNAL_UNITS, STAND_INS
from tissueid.units import Unit, alternatives, known_unit, unit_named

ROLES = (*SIGNAL_UNITS, *STAND_INS.values())
"""Roles of columns: time, a signal of the format, or input and output of another system."""

_TIME_NAMES = frozenset({"time", "t", "x_value", "timestamp", "zeit", "temps", "tempo", "elapsed", "elapsed time"})
_NAMED_LIKE = {
    "position": ("pos", "disp", "depth", "weg", "indent", "stroke", "auslenkung", "eindr", "deplacement"),
    "force": ("force", "kraft", "load", "fz", "newton"),
    "voltage": ("volt", "spannung"),
    "current": ("curr", "strom", "amp"),
    "command": ("command", "cmd", "soll"),
    "temperature": ("temp",),
}
"""Parts of the names of columns that indicate each signal, in English, German and French."""
_TIME_UNITS = ("s", "ms", "us", "min")

_PLAUSIBLE = {
    "force": (0.02, 200.0),
    "position": (2e-5, 0.2),
    "command": (0.02, 300.0),
    "voltage": (0.02, 300.0),
    "current": (0.002, 50.0),
}
"""Plausible difference between highest and lowest value, SI."""
_LARGEST = {"force": 1000.0, "position": 1.0, "command": 500.0, "voltage": 500.0, "current": 100.0}
"""Largest plausible absolute value, SI."""
_TEMPERATURES = (-40.0, 250.0)


@dataclass(frozen=True)
class Mapped:
    """One signal: the index of its column, from 0, its header, and its unit."""

    role: str
    place: int
    header: str
    unit: Unit


def parse_map(options: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Return column and unit by role from ROLE=COLUMN:UNIT options; the unit is "" if it is not given.

    Raises:
        UnusableInputError: an option is invalid, or a role is unknown, given twice or missing.
    """
    found: dict[str, tuple[str, str]] = {}
    for option in options:
        role, equals, rest = option.partition("=")
        role = role.strip()
        if not equals or not rest.strip():
            raise UnusableInputError(f"--map is ROLE=COLUMN:UNIT, such as force=2:N, not {option!r}")
        if role not in ROLES:
            raise UnusableInputError(f"--map knows no {role!r}; it knows {', '.join(ROLES)}")
        if role in found:
            raise UnusableInputError(f"--map says twice which column is {role}")
        column, colon, unit = rest.rpartition(":")
        if not colon or ")" in unit:  # the colon of MATLAB's x(:,2)
            column, unit = rest, ""
        if unit:
            _checked(role, unit_named(unit))
        found[role] = (column, unit)
    if len(found.keys() - {"time"}) < 2:
        raise UnusableInputError("--map has to name at least two signals, an input and an output")
    return found


def mapped(file: ImportedTable, wanted: dict[str, tuple[str, str]]) -> tuple[list[Mapped], list[str]]:
    """Return the requested columns, and notices where the file states something else.

    Raises:
        UnusableInputError: there is no such column, one is used twice, or a unit is missing.
    """
    found: list[Mapped] = []
    notices: list[str] = []
    for role, (column, unit) in wanted.items():
        place = file.place(column)
        chosen_column = file.columns[place]
        if any(other.place == place for other in found):
            raise UnusableInputError(
                Message("import.column_twice", "column '{column}' is used for two signals", column=Verbatim(column))
            )
        if not unit and not chosen_column.unit:
            raise UnusableInputError(
                Message(
                    "import.no_unit",
                    "column '{column}' does not state its unit: choose it ({action})",
                    column=Verbatim(chosen_column.header or column),
                    action=Action("import.unit", f"--map {role}={column}:UNIT", marked("the list Unit")),
                )
            )
        chosen = _checked(role, unit_named(unit or chosen_column.unit))
        if unit and chosen_column.unit and chosen != known_unit(chosen_column.unit):
            notices.append(
                Message(
                    "import.other_unit",
                    "{role}: the file says {stated}, and was read in {used}, as requested",
                    role=role,
                    stated=Verbatim(chosen_column.unit),
                    used=chosen.symbol,
                )
            )
        found.append(Mapped(role, place, chosen_column.header or f"column {place + 1}", chosen))
    return found, notices


def guessed_role(file: ImportedTable, place: int) -> str:
    """Return the probable role of a column by its name or else by its unit; "" if unknown."""
    column = file.columns[place]
    if place == file.time or column.name.casefold() in _TIME_NAMES:
        return "time"
    name = column.name.casefold()
    unit = known_unit(column.unit) if column.unit else None
    fits = [role for role in _NAMED_LIKE if unit is None or SIGNAL_UNITS[role] == unit.si]
    named = [role for role in fits if any(part in name for part in _NAMED_LIKE[role])]
    if named:
        return named[0]
    return fits[0] if unit is not None and len(fits) == 1 else ""


def time_column(file: ImportedTable, taken: Sequence[Mapped]) -> Mapped | None:
    """Return the time column by the rules of the format, or by its name; None if there is none."""
    places = [file.time] if file.time is not None else []
    places += [place for place, column in enumerate(file.columns) if column.name.casefold() in _TIME_NAMES]
    for place in places:
        column = file.columns[place]
        if all(other.place != place for other in taken) and column.unit in ("", *_TIME_UNITS):
            return Mapped("time", place, column.header, unit_named(column.unit or "s"))
    return None


def doubts(role: str, unit: Unit, values: NDArray[np.float64], *, quiet: bool = False) -> list[str]:
    """Return notices about implausible values of a signal in SI, shape (n,).

    Raises:
        UnusableInputError: it holds no number.
    """
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        raise UnusableInputError(
            Message(
                "import.no_numbers",
                "{role}: none of its {samples} samples is a number",
                role=role,
                samples=int(values.size),
            )
        )
    notices: list[str] = []
    infinite = int(np.isinf(values).sum())
    if infinite:
        notices.append(
            Message(
                "import.infinite",
                "{role}: {count} samples are infinite; the analysis treats them as missing",
                role=role,
                count=infinite,
            )
        )
    low, high = float(finite.min()), float(finite.max())
    size, spread = max(abs(low), abs(high)), high - low
    if spread == 0.0:
        notices.append(Message("import.constant", "{role} never changes: it is always {value:g}", role=role, value=low))
    elif size > 1e30:
        notices.append(
            Message(
                "import.too_large", "{role} reaches {value:.3g}, which no instrument measures", role=role, value=size
            )
        )
    elif role == "temperature" and not (_TEMPERATURES[0] <= low and high <= _TEMPERATURES[1]):
        notices.append(
            Message(
                "import.temperature",
                "temperature ranges from {low:.4g} to {high:.4g} °C: is it in {unit}?",
                low=low,
                high=high,
                unit=unit.symbol,
            )
        )
    elif role in _PLAUSIBLE:
        least, most = _PLAUSIBLE[role]
        if spread > most or size > _LARGEST[role] or (spread < least and not quiet):
            others = _better(unit, spread, least, most)
            notices.append(
                Message(
                    "import.implausible",
                    "{role} ranges from {low:.4g} to {high:.4g} {si}, which is implausible: is it in {unit}? Units "
                    "that would fit: {others}.",
                    role=role,
                    low=low,
                    high=high,
                    si=unit.si,
                    unit=unit.symbol,
                    others=", ".join(others) or marked("none"),
                )
            )
    return notices


def _better(unit: Unit, spread: float, least: float, most: float) -> list[str]:
    """Return the units in which the range would be plausible."""
    fits = []
    for other in alternatives(unit.si):
        would = spread * unit.divisor / unit.factor * other.factor / other.divisor
        if other != unit and least <= would <= most:
            fits.append(other.symbol)
    return fits


def _checked(role: str, unit: Unit) -> Unit:
    """Return the unit after checking that it fits the quantity of the signal.

    Raises:
        UnusableInputError: it does not.
    """
    expected = SIGNAL_UNITS.get(role)
    if expected is not None and unit.si != expected:
        known = ", ".join(other.symbol for other in alternatives(expected))
        raise UnusableInputError(
            Message(
                "import.wrong_unit",
                "{role} is measured in {expected}, not in {unit}; its units are {units}",
                role=role,
                expected=expected,
                unit=unit.symbol,
                units=known,
            )
        )
    return unit
