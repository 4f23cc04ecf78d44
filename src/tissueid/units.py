"""The table of units: symbols, conversions to SI, and the units in which a value is shown. All other modules use SI.

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

from tissueid.errors import UnusableInputError
from tissueid.messages import Message, Verbatim


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


RECORDED = (
    Unit("N", "N"),
    Unit("mN", "N", divisor=1e3),
    Unit("uN", "N", divisor=1e6, shown="µN"),
    Unit("kN", "N", factor=1e3),
    Unit("gf", "N", factor=9.80665, divisor=1e3),
    Unit("kgf", "N", factor=9.80665),
    Unit("V", "V"),
    Unit("mV", "V", divisor=1e3),
    Unit("uV", "V", divisor=1e6, shown="µV"),
    Unit("A", "A"),
    Unit("mA", "A", divisor=1e3),
    Unit("uA", "A", divisor=1e6, shown="µA"),
    Unit("m", "m"),
    Unit("cm", "m", divisor=1e2),
    Unit("mm", "m", divisor=1e3),
    Unit("um", "m", divisor=1e6, shown="µm"),
    Unit("nm", "m", divisor=1e9),
    Unit("in", "m", factor=254.0, divisor=1e4),
    Unit("degC", "degC", shown="°C"),
    Unit("K", "degC", offset=-273.15),
    Unit("s", "s"),
    Unit("ms", "s", divisor=1e3),
    Unit("us", "s", divisor=1e6, shown="µs"),
    Unit("min", "s", factor=60.0),
    Unit("m s-2", "m s-2", shown="m/s²"),
    Unit("mm s-2", "m s-2", divisor=1e3, shown="mm/s²"),
    Unit("g", "m s-2", factor=9.80665),
    Unit("m/s", "m/s"),
    Unit("mm/s", "m/s", divisor=1e3),
    Unit("Pa", "Pa"),
    Unit("kPa", "Pa", factor=1e3),
    Unit("rad", "rad"),
    Unit("1", "1"),
)
"""Units of the signals of a record."""
DERIVED = (
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
"""Units of other quantities."""
_BY_SYMBOL = {unit.symbol: unit for unit in RECORDED}
_TABLE = {(unit.symbol, unit.si): unit for unit in (*RECORDED, *DERIVED)}
_CLINICAL = {"m": "mm", "kg": "g", "H": "mH", "m/A": "mm/A", "rad/s": "Hz", "rad": "°"}
"""Displayed unit of each SI unit that is displayed in another one."""
_FINE = {"m": ("um", 1e-4), "A": ("mA", 0.1), "V": ("mV", 0.1)}
"""Displayed unit of small values, and the limit below which it is used, by SI unit."""

_ALIASES = {
    "µN": "uN", "μN": "uN", "µV": "uV", "μV": "uV", "µA": "uA", "μA": "uA", "µm": "um", "μm": "um", "µs": "us",
    "μs": "us", "°C": "degC", "C": "degC", "deg C": "degC", "sec": "s", "m/s2": "m s-2", "m/s^2": "m s-2",
    "m/s²": "m s-2", "m_per_s2": "m s-2", "mm/s2": "mm s-2", "mm/s^2": "mm s-2", "mm/s²": "mm s-2", "m_per_s": "m/s",
    "-": "1",
}  # fmt: skip
_WORDS = {
    "newton": "N", "newtons": "N", "millinewton": "mN", "millinewtons": "mN", "volt": "V", "volts": "V",
    "millivolt": "mV", "millivolts": "mV", "ampere": "A", "amperes": "A", "amp": "A", "amps": "A",
    "milliampere": "mA", "milliamperes": "mA", "milliamps": "mA", "meter": "m", "meters": "m", "metre": "m",
    "metres": "m", "millimeter": "mm", "millimeters": "mm", "millimetre": "mm", "millimetres": "mm",
    "micron": "um", "microns": "um", "micrometer": "um", "micrometers": "um", "micrometre": "um", "micrometres": "um",
    "inch": "in", "inches": "in", "degc": "degC", "deg c": "degC", "degree c": "degC", "degrees c": "degC",
    "celsius": "degC", "kelvin": "K", "second": "s", "seconds": "s", "sec": "s", "millisecond": "ms",
    "milliseconds": "ms", "msec": "ms",
}  # fmt: skip
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
_BRACKETED = re.compile(r"(.*?)\s*[(\[{]\s*([^()\[\]{}]*?)\s*[)\]}]\s*", re.DOTALL)
_TAILED = re.compile(r"(.*\S)\s*(?:[/,;]\s*|_)(\S(?:.*\S)?)\s*", re.DOTALL)


# -- names and symbols ------------------------------------------------------------------------------------------------


def known_unit(text: str) -> Unit | None:
    """Return the unit of a signal that a text names by symbol or word; None if it names none."""
    text = text.strip()
    symbol = _ALIASES.get(text, text)
    return _BY_SYMBOL.get(symbol) or _BY_SYMBOL.get(_WORDS.get(text.lower(), ""))


def unit_named(text: str) -> Unit:
    """Return the unit of a signal that a text names.

    Raises:
        UnusableInputError: it names none.
    """
    if (unit := known_unit(text)) is None:
        raise UnusableInputError(
            Message(
                "import.unknown_unit",
                "'{unit}' is not a known unit; known are {units}",
                unit=Verbatim(text),
                units=", ".join(unit.symbol for unit in RECORDED),
            )
        )
    return unit


def alternatives(si: str) -> tuple[Unit, ...]:
    """Return all units of signals of the same quantity."""
    return tuple(unit for unit in RECORDED if unit.si == si)


def split_header(header: str) -> tuple[str, str]:
    """Return the name and the symbol of the unit in a column header, such as "Force [mN]" or "force_mN".

    The symbol is "" where the header has none.
    """
    header = header.strip()
    if match := _BRACKETED.fullmatch(header):
        unit = known_unit(match[2])
        return match[1] or header, unit.symbol if unit else ""
    for tail in ("m_per_s2", "m_per_s"):
        if header.endswith(f"_{tail}"):
            return header.removesuffix(f"_{tail}"), _ALIASES[tail]
    match = _TAILED.fullmatch(header)
    if match and (unit := _BY_SYMBOL.get(_ALIASES.get(match[2], match[2]))) and unit.symbol != "1":
        return match[1], unit.symbol
    return header, ""


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
    unit = _TABLE.get((_CLINICAL.get(si, si), si))
    return (si_unit, 1.0) if unit is None else (unit.text, unit.scale)


def fine_unit(si_unit: str) -> tuple[str, float]:
    """Return the displayed unit of small values of an SI unit, such as µm, and the factor to it."""
    if si_unit not in _FINE:
        return display_unit(si_unit)
    unit = _TABLE[_FINE[si_unit][0], si_unit]
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
        unit = _TABLE[symbol if clinical else si, si]
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
    _Active.system = next((known for known in SYSTEMS if known == system), "clinical")


def unit_of(figure: Figure) -> FigureUnit:
    """Return the unit of a figure in the active system."""
    return FIGURES[_Active.system][figure]


def shown(unit: str) -> tuple[str, float]:
    """Return the symbol of ``unit`` ("mm/(N·s)") in the active system and the factor that converts to it."""
    if _Active.system == "clinical":
        return unit, 1.0
    below = min((place for place in (unit.find("/"), unit.find(" per ")) if place >= 0), default=len(unit))
    factor = 1.0
    for part in _PART.finditer(unit):
        power = _POWERS[part.group(2)]
        si = _COHERENT[part.group(1)]
        factor *= (1.0 / _TABLE[part.group(1), si].scale) ** (power if part.start() < below else -power)
    return _PART.sub(lambda part: _COHERENT[part.group(1)] + part.group(2), unit), factor


def shown_si(si_unit: str) -> tuple[str, float]:
    """Return the display unit of an SI unit in the active system and the factor that converts to it."""
    unit, scale = display_unit(si_unit)
    unit, factor = shown(unit)
    return unit, scale * factor


def shown_label(label: str) -> tuple[str, float]:
    """Return a label with its unit in brackets, "Depth (mm)", in the active system, and the factor of that unit."""
    found = _BRACKET.search(label)
    if found is None:
        return label, 1.0
    unit, factor = shown(found.group(1))
    return f"{label[: found.start(1)]}{unit}{label[found.end(1) :]}", factor
