"""Units in which values are shown. All other modules use SI; units that files state are in ``sessions.imports``.

Values are shown in clinical units or, in a window set to it, in SI units without prefixes. Clinical units are those of
handheld skin testers: indentation in mm, moving mass in g, force in N, and stiffness in N/m, as Dellalana et al., Skin
Res. Technol. 25 (2019) 289, give it for skin. Reports and printed pages always use them. Small quantities (µm, mA, ms)
keep their prefix in both systems.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Unit:
    """A unit: a value in ``si`` is value * ``factor`` / ``divisor`` + ``offset``. ``shown`` differs from the symbol.

    Factor and divisor are separate because 1000 is exact in floating point and 0.001 is not: 3 mm is
    3.0 / 1000.0, the float closest to 0.003.
    """

    symbol: str
    si: str
    factor: float = 1.0
    divisor: float = 1.0
    offset: float = 0.0
    shown: str = ""

    @property
    def text(self) -> str:
        """The symbol for people."""
        return self.shown or self.symbol

    @property
    def scale(self) -> float:
        """Number of these units in one SI unit."""
        return self.divisor / self.factor

    def to_si(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return values in SI, same shape; values that are in SI already are unchanged."""
        if self.factor != 1.0:
            values = values * self.factor
        if self.divisor != 1.0:
            values = values / self.divisor
        return values + self.offset if self.offset else values


SHOWN = {
    (unit.symbol, unit.si): unit
    for unit in (
        Unit("N", "N"),
        Unit("V", "V"),
        Unit("mV", "V", divisor=1e3),
        Unit("A", "A"),
        Unit("mA", "A", divisor=1e3),
        Unit("m", "m"),
        Unit("mm", "m", divisor=1e3),
        Unit("um", "m", divisor=1e6, shown="µm"),
        Unit("degC", "degC", shown="°C"),
        Unit("s", "s"),
        Unit("m s-2", "m s-2", shown="m/s²"),
        Unit("m/s", "m/s"),
        Unit("mm/s", "m/s", divisor=1e3),
        Unit("Pa", "Pa"),
        Unit("rad", "rad"),
        Unit("1", "1"),
        Unit("kg", "kg"),
        Unit("g", "kg", divisor=1e3),
        Unit("H", "H"),
        Unit("mH", "H", divisor=1e3),
        Unit("ohm", "ohm", shown="Ω"),
        Unit("N/A", "N/A", shown="N per A"),
        Unit("N/A^2", "N/A^2", shown="N/A²"),
        Unit("1/A^n", "1/A^n", shown="1/Aⁿ"),
        Unit("N/m", "N/m"),
        Unit("N s/m", "N s/m", shown="N·s/m"),
        Unit("N s/m²", "N s/m²", shown="N·s/m²"),
        Unit("N s²/m²", "N s²/m²", shown="N·s²/m²"),
        Unit("mm/A", "m/A", divisor=1e3),
        Unit("rad/s", "rad/s"),
        Unit("Hz", "Hz"),
        Unit("Hz", "rad/s", factor=2.0 * math.pi),
        Unit("°", "rad", factor=math.pi, divisor=180.0),
        Unit("%", "1", divisor=1e2),
    )
}
"""Units in which values are shown, by symbol and SI unit."""
_CLINICAL = {"m": "mm", "kg": "g", "H": "mH", "m/A": "mm/A", "rad/s": "Hz", "rad": "°"}
"""Displayed unit of each SI unit that is displayed in another one."""
_FINE = {"m": ("um", 1e-4), "A": ("mA", 0.1), "V": ("mV", 0.1)}
"""Displayed unit of small values, and the limit below which it is used, by SI unit."""

_ALIASES = {"°C": "degC", "m/s2": "m s-2", "m/s^2": "m s-2", "m/s²": "m s-2"}
_SUFFIXES = {
    "n_s2_per_m2": "N s²/m²",
    "n_s_per_m2": "N s/m²",
    "n_per_root_hz": "N/√Hz",
    "n_per_m2": "N/m²",
    "kg_per_m2": "kg/m²",
    "kg_per_m": "kg/m",
    "n_s_per_m": "N s/m",
    "n_per_m": "N/m",
    "n_per_a": "N/A",
    "m_per_s": "m/s",
    "m_s2": "m/s²",
    "m_per_n_s": "m/(N s)",
    "rad_per_s": "rad/s",
    "per_n": "1/N",
    "per_s": "1/s",
    "per_m": "1/m",
    "percent": "%",
    "years": "years",
    "kg": "kg",
    "db": "dB",
    "hz": "Hz",
    "ohm": "ohm",
    "rad": "rad",
    "deg": "°",
    "s2": "s²",
    "m": "m",
    "n": "N",
    "v": "V",
    "a": "A",
    "h": "H",
    "s": "s",
    "c": "degC",
}
"""Suffixes of names, longest first, and their SI units."""
_ASSUMED = {"memory": "s", "window": "s", "seconds": "s", "sample_rate": "Hz"}
"""SI units of names without a suffix."""


# -- names and symbols ------------------------------------------------------------------------------------------------


def split_name(name: str) -> tuple[str, str]:
    """Split a name such as ``mass_kg`` into the name without suffix and its SI unit ("" without one)."""
    if name in _ASSUMED:
        return name, _ASSUMED[name]
    for suffix, unit in _SUFFIXES.items():
        if name.endswith(f"_{suffix}"):
            return name.removesuffix(f"_{suffix}"), unit
    return name, ""


# -- clinical units ---------------------------------------------------------------------------------------------------


def display_unit(si_unit: str) -> tuple[str, float]:
    """Return the displayed unit of an SI unit and the factor to it. A unit that is not known is shown unchanged."""
    si = _ALIASES.get(si_unit, si_unit)
    if si in ("", "1"):
        return "", 1.0
    unit = SHOWN.get((_CLINICAL.get(si, si), si))
    return (si_unit, 1.0) if unit is None else (unit.text, unit.scale)


def fine_unit(si_unit: str) -> tuple[str, float]:
    """Return the displayed unit of small values of an SI unit, such as µm, and the factor to it."""
    if si_unit not in _FINE:
        return display_unit(si_unit)
    unit = SHOWN[_FINE[si_unit][0], si_unit]
    return unit.text, unit.scale


def unit_for(si_unit: str, size: float) -> tuple[str, float]:
    """Return the displayed unit for values of a size, in the SI unit, and the factor to it."""
    small = 0.0 < size < _FINE.get(si_unit, ("", 0.0))[1]
    return fine_unit(si_unit) if small else display_unit(si_unit)


# -- the active unit system of the window -----------------------------------------------------------------------------

System = Literal["clinical", "si"]
SYSTEMS: tuple[System, ...] = get_args(System)
Figure = Literal[
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
class FigureUnit:
    """Unit of a figure: its symbol, how many of it make one SI unit, and usual decimals."""

    symbol: str
    factor: float
    decimals: int


_DECIMALS: dict[Figure, tuple[str, str, int, int]] = {
    "position": ("mm", "m", 1, 4),
    "velocity": ("mm/s", "m/s", 1, 4),
    "force": ("N", "N", 1, 1),
    "stiffness": ("N/m", "N/m", 0, 0),
    "damping": ("N s/m", "N s/m", 2, 2),
    "mass": ("g", "kg", 1, 4),
    "time": ("s", "s", 3, 3),
    "frequency": ("Hz", "Hz", 1, 1),
    "temperature": ("degC", "degC", 1, 1),
    "current": ("A", "A", 3, 3),
    "voltage": ("V", "V", 3, 3),
}
"""Clinical unit, SI unit, and decimals in each, by figure."""


def _figures(*, clinical: bool) -> dict[Figure, FigureUnit]:
    made: dict[Figure, FigureUnit] = {}
    for name, (symbol, si, decimals, si_decimals) in _DECIMALS.items():
        unit = SHOWN[symbol if clinical else si, si]
        made[name] = FigureUnit(unit.text, unit.scale, decimals if clinical else si_decimals)
    return made


FIGURES: Mapping[System, Mapping[Figure, FigureUnit]] = {
    "clinical": _figures(clinical=True),
    "si": _figures(clinical=False),
}
_COHERENT = {FIGURES["clinical"][name].symbol: FIGURES["si"][name].symbol for name in ("position", "mass")}
"""SI unit of each part of a clinical unit."""
_PART = re.compile(rf"(?<![A-Za-zµ])({'|'.join(_COHERENT)})(?![A-Za-z])([²³⁴]?)")
_POWERS = {"": 1, "²": 2, "³": 3, "⁴": 4}
_BRACKET = re.compile(r"\(((?:[^()]|\([^()]*\))*)\)")


class _Active:
    """The active unit system."""

    system: System = "clinical"


def in_force() -> System:
    """Return the active unit system."""
    return _Active.system


def use(system: object) -> None:
    """Activate a unit system; an unknown name means clinical units."""
    _Active.system = next((name for name in SYSTEMS if name == system), "clinical")


def unit_of(figure: Figure) -> FigureUnit:
    """Return the unit of a figure in the active system."""
    return FIGURES[_Active.system][figure]


def shown(unit: str) -> tuple[str, float]:
    """Return the symbol of ``unit`` ("mm/(N·s)") in the active system and the factor that converts to it."""
    if _Active.system == "clinical":
        return unit, 1.0
    below = min((index for index in (unit.find("/"), unit.find(" per ")) if index >= 0), default=len(unit))
    factor = 1.0
    for part in _PART.finditer(unit):
        power = _POWERS[part.group(2)]
        si = _COHERENT[part.group(1)]
        factor *= (1.0 / SHOWN[part.group(1), si].scale) ** (power if part.start() < below else -power)
    return _PART.sub(lambda part: _COHERENT[part.group(1)] + part.group(2), unit), factor


def shown_si(si_unit: str) -> tuple[str, float]:
    """Return the display unit of an SI unit in the active system and the factor that converts to it."""
    unit, scale = display_unit(si_unit)
    unit, factor = shown(unit)
    return unit, scale * factor


def shown_label(label: str) -> tuple[str, float]:
    """Return a label with its unit in brackets, "Depth (mm)", in the active system, and the factor of that unit."""
    match = _BRACKET.search(label)
    if match is None:
        return label, 1.0
    unit, factor = shown(match.group(1))
    return f"{label[: match.start(1)]}{unit}{label[match.end(1) :]}", factor
