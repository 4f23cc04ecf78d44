"""Which column is which signal, in which unit; and whether the sizes can be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.sessions.imports.table import ForeignFile
from tissueid.sessions.imports.units import Unit, alternatives, known_unit, unit_named
from tissueid.sessions.model import SIGNAL_UNITS, STAND_INS

ROLES = (*SIGNAL_UNITS, *STAND_INS.values())
"""What a column can be: time, a signal of the format, or the bare input and output of something else."""

_TIME_NAMES = frozenset({"time", "t", "x_value", "timestamp", "zeit", "temps", "tempo", "elapsed", "elapsed time"})
_NAMED_LIKE = {
    "position": ("pos", "disp", "depth", "weg", "indent", "stroke", "auslenkung", "eindr", "deplacement"),
    "force": ("force", "kraft", "load", "fz", "newton"),
    "voltage": ("volt", "spannung"),
    "current": ("curr", "strom", "amp"),
    "command": ("command", "cmd", "soll"),
    "temperature": ("temp",),
}
"""Parts of names that columns of each signal often carry, in English, German and French."""
_TIME_UNITS = ("s", "ms", "us", "min")

_PLAUSIBLE = {
    "force": (0.02, 200.0),
    "position": (2e-5, 0.2),
    "command": (0.02, 300.0),
    "voltage": (0.02, 300.0),
    "current": (0.002, 50.0),
}
"""Between the lowest and the highest value, in SI: what instruments that push on things measure."""
_LARGEST = {"force": 1000.0, "position": 1.0, "command": 500.0, "voltage": 500.0, "current": 100.0}
"""Away from zero, for what hardly changes but is too large."""
_TEMPERATURES = (-40.0, 250.0)


@dataclass(frozen=True)
class Mapped:
    """One signal: the place of its column, from 0, its header, and its unit."""

    role: str
    place: int
    header: str
    unit: Unit


def parse_map(options: Sequence[str]) -> dict[str, tuple[str, str]]:
    """ROLE=COLUMN:UNIT options as column and unit by role; the unit is "" where it is left to the file.

    Raises:
        UnusableInputError: one that does not read so, or a role that is not known, given twice or missing.
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


def mapped(file: ForeignFile, wanted: dict[str, tuple[str, str]]) -> tuple[list[Mapped], list[str]]:
    """The columns that are wanted, and notices of what the file says otherwise.

    Raises:
        UnusableInputError: no such column, one for two signals, or no unit.
    """
    found: list[Mapped] = []
    notices = []
    for role, (column, unit) in wanted.items():
        place = file.place(column)
        told = file.columns[place]
        if any(other.place == place for other in found):
            raise UnusableInputError(f"column {column!r} is named for two signals")
        if not unit and not told.unit:
            raise UnusableInputError(
                f"column {told.header or column!r} does not tell its unit: --map {role}={column}:UNIT"
            )
        chosen = _checked(role, unit_named(unit or told.unit))
        if unit and told.unit and chosen != known_unit(told.unit):
            notices.append(f"{role}: the file says {told.unit}, and was read in {chosen.symbol} as --map asks")
        found.append(Mapped(role, place, told.header or f"column {place + 1}", chosen))
    return found, notices


def guessed_role(file: ForeignFile, place: int) -> str:
    """Return the role that a column seems to have, by its name or else by its unit; "" where neither tells."""
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


def time_column(file: ForeignFile, taken: Sequence[Mapped]) -> Mapped | None:
    """The column that is time by the rules of the format, or by its name; None where none is."""
    places = [file.time] if file.time is not None else []
    places += [place for place, column in enumerate(file.columns) if column.name.casefold() in _TIME_NAMES]
    for place in places:
        column = file.columns[place]
        if all(other.place != place for other in taken) and column.unit in ("", *_TIME_UNITS):
            return Mapped("time", place, column.header, unit_named(column.unit or "s"))
    return None


def doubts(role: str, unit: Unit, values: NDArray[np.float64], *, quiet: bool = False) -> list[str]:
    """What is doubtful about a signal in SI, shape (n,): one line each.

    Raises:
        UnusableInputError: it holds no number at all.
    """
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        raise UnusableInputError(f"{role}: not one of {values.size} samples is a number")
    notices = []
    infinite = int(np.isinf(values).sum())
    if infinite:
        notices.append(f"{role}: {infinite} samples are infinite; the analysis takes them for missing")
    low, high = float(finite.min()), float(finite.max())
    size, spread = max(abs(low), abs(high)), high - low
    if spread == 0.0:
        notices.append(f"{role} never changes: it is {low:g} throughout")
    elif size > 1e30:
        notices.append(f"{role} reaches {size:.3g}: no instrument measures that")
    elif role == "temperature" and not (_TEMPERATURES[0] <= low and high <= _TEMPERATURES[1]):
        notices.append(f"temperature goes from {low:.4g} to {high:.4g} degC: is it in {unit.symbol}?")
    elif role in _PLAUSIBLE:
        least, most = _PLAUSIBLE[role]
        if spread > most or size > _LARGEST[role] or (spread < least and not quiet):
            notices.append(
                f"{role} goes from {low:.4g} to {high:.4g} {unit.si}, which is implausible: is it in {unit.symbol}?"
                f"{_better(unit, spread, least, most)}"
            )
    return notices


def _better(unit: Unit, spread: float, least: float, most: float) -> str:
    """Units in which the size would be an ordinary one."""
    fits = []
    for other in alternatives(unit.si):
        would = spread * unit.divisor / unit.factor * other.factor / other.divisor
        if other != unit and least <= would <= most:
            fits.append(other.symbol)
    return f" It would fit {', '.join(fits)}." if fits else ""


def _checked(role: str, unit: Unit) -> Unit:
    """The unit, if it is one of the signal's quantity.

    Raises:
        UnusableInputError: it is not.
    """
    expected = SIGNAL_UNITS.get(role)
    if expected is not None and unit.si != expected:
        known = ", ".join(other.symbol for other in alternatives(expected))
        raise UnusableInputError(f"{role} is measured in {expected}, not in {unit.symbol}; its units are {known}")
    return unit
