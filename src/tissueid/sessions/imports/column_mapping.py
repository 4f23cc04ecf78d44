"""Mapping of the columns of an imported file to signals and units, with checks of plausibility."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.messages import Action, Message, Verbatim
from tissueid.sessions.imports.imported_table import NAMED_LIKE, TIME_NAMES, Column, ImportedTable, is_named_like
from tissueid.sessions.imports.stated_units import OFFERED, offered_units, unit_named, unit_of
from tissueid.sessions.model import SIGNAL_UNITS, STAND_INS
from tissueid.units import Unit

ROLES = (*SIGNAL_UNITS, *STAND_INS.values())
"""Roles of columns: time, a signal of the format, or input and output of another system."""

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
    index: int
    header: str
    unit: Unit
    is_assumed: bool = False
    """Whether the file does not state the unit, and it was not chosen."""


def parse_map(options: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Return column and unit by role from ROLE=COLUMN:UNIT options; the unit is "" if it is not given.

    Raises:
        UnusableInputError: an option is invalid, or a role is unknown, given twice or missing.
    """
    columns: dict[str, tuple[str, str]] = {}
    for option in options:
        role, equals, rest = option.partition("=")
        role = role.strip()
        if not equals or not rest.strip():
            raise UnusableInputError(f"--map is ROLE=COLUMN:UNIT, such as force=2:N, not {option!r}")
        if role not in ROLES:
            raise UnusableInputError(f"--map knows no {role!r}; it knows {', '.join(ROLES)}")
        if role in columns:
            raise UnusableInputError(f"--map says twice which column is {role}")
        column, colon, unit = rest.rpartition(":")
        if not colon or ")" in unit:  # the colon of MATLAB's x(:,2)
            column, unit = rest, ""
        if unit:
            checked_unit(role, unit)
        columns[role] = (column, unit)
    if len(columns.keys() - {"time"}) < 2:
        raise UnusableInputError("--map has to name at least two signals, an input and an output")
    return columns


def mapped(file: ImportedTable, wanted: dict[str, tuple[str, str]]) -> tuple[list[Mapped], list[str]]:
    """Return the requested columns, and notices where the file states something else.

    Raises:
        UnusableInputError: there is no such column, one is used twice, or a unit is missing.
    """
    columns: list[Mapped] = []
    notices: list[str] = []
    for role, (column, unit) in wanted.items():
        index = file.column_index(column)
        chosen_column = file.columns[index]
        if any(other.index == index for other in columns):
            raise UnusableInputError(
                "import.column_twice", "column '{column}' is used for two signals", column=Verbatim(column)
            )
        header = chosen_column.header or f"column {index + 1}"
        if unit:
            chosen, contrary = _chosen(role, header, chosen_column, unit)
            notices += contrary
        else:
            chosen = _stated(role, column, chosen_column)
        columns.append(Mapped(role, index, header, chosen))
    return columns, notices


def _chosen(role: str, header: str, column: Column, text: str) -> tuple[Unit, list[str]]:
    """Return the unit that a user chose, and notices where the file states another text.

    Raises:
        UnusableInputError: the file states another unit, and the choice does not end in "!".
    """
    chosen = checked_unit(role, text)
    expected = SIGNAL_UNITS.get(role, "")
    stated = "s" if column.dated else column.unit_for(role, expected)
    stated_unit = unit_of(stated, expected) if stated else None
    if not stated or (stated_unit is not None and _size(stated_unit) == _size(chosen)):
        return chosen, []
    if column.dated or (stated_unit is not None and not text.endswith("!") and not _is_weight(stated_unit, chosen)):
        raise UnusableInputError(
            "import.contradiction",
            "column '{column}' is in {stated} by its header, not in {used}: choose {stated}, or write {used}! if the "
            "header is wrong",
            column=Verbatim(header),
            stated=Verbatim(stated),
            used=chosen.symbol,
        )
    return chosen, [
        Message(
            "import.other_unit",
            "{role}: the file says {stated}, and was read in {used}, as requested",
            role=role,
            stated=Verbatim(stated),
            used=chosen.symbol,
        )
    ]


def _stated(role: str, wanted: str, column: Column) -> Unit:
    """Return the unit that the file states for a role.

    Raises:
        UnusableInputError: it states none, an unknown one, or one of another quantity.
    """
    expected = SIGNAL_UNITS.get(role, "")
    stated = "s" if column.dated else column.unit_for(role, expected)
    action = Action("import.unit", f"--map {role}={wanted}:UNIT", marked("the list Unit"))
    header = Verbatim(column.header or wanted)
    if not stated:
        raise UnusableInputError(
            "import.no_unit",
            "column '{column}' does not state its unit: choose it ({action})",
            column=header,
            action=action,
        )
    if unit_of(stated, expected) is None:
        raise UnusableInputError(
            "import.unit_not_known",
            "column '{column}' states the unit '{unit}', which is unknown or has several meanings: choose it "
            "({action}), such as {units}",
            column=header,
            unit=Verbatim(stated),
            action=action,
            units=", ".join(OFFERED.get(expected, ("V", "mm", "degC", "1"))),
        )
    return checked_unit(role, stated)


def _size(unit: Unit) -> tuple[str, float, float, float]:
    return unit.si, unit.factor, unit.divisor, unit.offset


def _is_weight(stated: Unit, chosen: Unit) -> bool:
    """Return whether a stated mass and a chosen force are the same load, such as kg and kgf."""
    return (stated.si, chosen.si) == ("kg", "N") and math.isclose(stated.scale, 9.80665 * chosen.scale)


def guessed_role(file: ImportedTable, index: int) -> str:
    """Return the probable role of a column by its name or else by its unit; "" if unknown."""
    column = file.columns[index]
    if index == file.time or column.dated or column.name.casefold() in TIME_NAMES:
        return "time"
    units = {role: column.unit_for(role, SIGNAL_UNITS[role]) for role in NAMED_LIKE}
    by_unit = [
        role
        for role, stated in units.items()
        if stated and (unit := unit_of(stated, SIGNAL_UNITS[role])) is not None and unit.si == SIGNAL_UNITS[role]
    ]
    unknown = not column.unit or all(unit_of(column.unit, SIGNAL_UNITS[role]) is None for role in NAMED_LIKE)
    named = [role for role in by_unit or (NAMED_LIKE if unknown else ()) if is_named_like(role, column.name)]
    if named:
        return named[0]
    return by_unit[0] if len(by_unit) == 1 else ""


def time_column(file: ImportedTable, taken: Sequence[Mapped]) -> Mapped | None:
    """Return the time column by the rules of the format, or by its name; None if there is none.

    Raises:
        UnusableInputError: it states a unit that is not one of time.
    """
    places = [file.time] if file.time is not None else []
    places += [index for index, column in enumerate(file.columns) if column.name.casefold() in TIME_NAMES]
    dated = [index for index, column in enumerate(file.columns) if column.dated]
    places += dated if len(dated) == 1 else []
    refused: UnusableInputError | None = None
    for index in places:
        column = file.columns[index]
        if any(other.index == index for other in taken):
            continue
        if not column.dated and not column.unit_for("time", "s"):
            return Mapped("time", index, column.header, Unit("s", "s"), is_assumed=True)
        try:
            return Mapped("time", index, column.header, _stated("time", str(index + 1), column))
        except UnusableInputError as error:
            refused = refused or error
    if refused is not None:
        raise refused
    return None


def doubts(role: str, unit: Unit, values: NDArray[np.float64], *, quiet: bool = False) -> list[str]:
    """Return notices about implausible values of a signal in SI, shape (n,).

    Raises:
        UnusableInputError: it holds no number.
    """
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        raise UnusableInputError(
            "import.no_numbers",
            "{role}: none of its {samples} samples is a number",
            role=role,
            samples=int(values.size),
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
    for other in offered_units(unit.si):
        would = spread * unit.divisor / unit.factor * other.factor / other.divisor
        if other.symbol != unit.symbol and least <= would <= most:
            fits.append(other.symbol)
    return fits


def checked_unit(role: str, text: str) -> Unit:
    """Return the unit of a text after checking that it fits the quantity of the signal.

    Raises:
        UnusableInputError: it is unknown, or does not fit.
    """
    expected = SIGNAL_UNITS.get(role, "")
    unit = unit_named(text.removesuffix("!"), role, expected)
    if expected and unit.si != expected:
        raise UnusableInputError(
            "import.wrong_unit",
            "{role} is measured in {expected}, not in {unit}; its units are {units}",
            role=role,
            expected=expected,
            unit=unit.symbol,
            units=", ".join(OFFERED[expected]),
        )
    return unit
