"""The units of the window: clinical units, or SI units without prefixes. Independent of Qt.

Clinical units are those of handheld skin testers: indentation in mm, moving mass in g, force in N, and stiffness in
N/m, as Dellalana et al., Skin Res. Technol. 25 (2019) 289, give it for skin. Reports and printed pages use the same,
so a figure on the screen is the figure on paper; N/mm would part them by a factor of a thousand. SI has m and kg, as
files, JSON and scripts have them. Small quantities (µm, mA, ms) keep their prefix in both systems.

Whatever is computed stays in SI, and most of what is drawn in clinical units: only what is read is converted.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Protocol, get_args, runtime_checkable

from tissueid.formatting import display_unit, estimate, fixed
from tissueid.records import Estimate

System = Literal["clinical", "si"]
SYSTEMS: tuple[System, ...] = get_args(System)

Quantity = Literal[
    "position",
    "velocity",
    "force",
    "stiffness",
    "damping",
    "mass",
    "time",
    "frequency",
    "temperature",
    "current",
    "voltage",
]


@dataclass(frozen=True)
class Unit:
    """A unit: its symbol, how many of it make one coherent SI unit (°C for temperatures), and usual decimals."""

    symbol: str
    factor: float
    decimals: int


_SAME: dict[Quantity, Unit] = {
    "force": Unit("N", 1.0, 1),
    "stiffness": Unit("N/m", 1.0, 0),
    "damping": Unit("N·s/m", 1.0, 2),
    "time": Unit("s", 1.0, 3),
    "frequency": Unit("Hz", 1.0, 1),
    "temperature": Unit("°C", 1.0, 1),
    "current": Unit("A", 1.0, 3),
    "voltage": Unit("V", 1.0, 3),
}
UNITS: Mapping[System, Mapping[Quantity, Unit]] = {
    "clinical": _SAME | {"position": Unit("mm", 1e3, 1), "velocity": Unit("mm/s", 1e3, 1), "mass": Unit("g", 1e3, 1)},
    "si": _SAME | {"position": Unit("m", 1.0, 4), "velocity": Unit("m/s", 1.0, 4), "mass": Unit("kg", 1.0, 4)},
}

_COHERENT = {
    UNITS["clinical"][name].symbol: (
        UNITS["si"][name].symbol,
        UNITS["si"][name].factor / UNITS["clinical"][name].factor,
    )
    for name in ("position", "mass")
}
"""SI unit of each part of a clinical unit, and the factor that converts to it."""
_PART = re.compile(rf"(?<![A-Za-zµ])({'|'.join(_COHERENT)})(?![A-Za-z])([²³⁴]?)")
_POWERS = {"": 1, "²": 2, "³": 3, "⁴": 4}
_BRACKET = re.compile(r"\(((?:[^()]|\([^()]*\))*)\)")


@runtime_checkable
class FollowsUnits(Protocol):
    """A widget that shows figures."""

    def take_units(self) -> None:
        """Show the figures again in the active units."""


class _InForce:
    """The active unit system."""

    system: System = "clinical"


def in_force() -> System:
    """Return the active unit system."""
    return _InForce.system


def use(system: object) -> None:
    """Activate a unit system; an unknown name means clinical units."""
    _InForce.system = next((known for known in SYSTEMS if known == system), "clinical")


def unit_of(quantity: Quantity) -> Unit:
    """Return the unit of a quantity in the active system."""
    return UNITS[_InForce.system][quantity]


def figure(quantity: Quantity, value: float | None) -> str:
    """Return an SI value (temperatures in °C) as text with the decimals of its active unit, without the unit."""
    unit = unit_of(quantity)
    return fixed(None if value is None else value * unit.factor, unit.decimals)


def shown(unit: str) -> tuple[str, float]:
    """Return the symbol of ``unit`` ("mm/(N·s)") in the active system and the factor that converts to it."""
    if _InForce.system == "clinical":
        return unit, 1.0
    below = min((place for place in (unit.find("/"), unit.find(" per ")) if place >= 0), default=len(unit))
    factor = 1.0
    for part in _PART.finditer(unit):
        power = _POWERS[part.group(2)]
        factor *= _COHERENT[part.group(1)][1] ** (power if part.start() < below else -power)
    return _PART.sub(lambda part: _COHERENT[part.group(1)][0] + part.group(2), unit), factor


def shown_si(si_unit: str) -> tuple[str, float]:
    """Return the display unit of an SI unit and the factor that converts to it."""
    unit, scale = display_unit(si_unit)
    unit, factor = shown(unit)
    return unit, scale * factor


def said(found: Estimate, si_unit: str) -> tuple[str, str]:
    """Return the value of an SI figure as text, and its deviation, common power of ten and unit as another text."""
    unit, scale = shown_si(si_unit)
    value, deviation, power = estimate(found, scale)
    return value, " ".join(filter(None, [deviation and f"± {deviation}", power, unit]))


def shown_label(label: str) -> tuple[str, float]:
    """Return a label with its unit in brackets, "Depth (mm)", in the active system, and the factor of that unit."""
    found = _BRACKET.search(label)
    if found is None:
        return label, 1.0
    unit, factor = shown(found.group(1))
    return f"{label[: found.start(1)]}{unit}{label[found.end(1) :]}", factor


__all__ = [
    "SYSTEMS",
    "UNITS",
    "FollowsUnits",
    "Quantity",
    "System",
    "Unit",
    "figure",
    "in_force",
    "said",
    "shown",
    "shown_label",
    "shown_si",
    "unit_of",
    "use",
]
