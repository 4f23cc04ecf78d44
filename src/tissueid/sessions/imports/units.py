"""Units of imported records and their conversion to SI."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.messages import Message, Verbatim


@dataclass(frozen=True)
class Unit:
    """A unit: a value in ``si`` is value * ``factor`` / ``divisor`` + ``offset``.

    Factor and divisor are separate because 1000 is exact in floating point and 0.001 is not: 3 mm is
    3.0 / 1000.0, the float closest to 0.003.
    """

    symbol: str
    si: str
    factor: float = 1.0
    divisor: float = 1.0
    offset: float = 0.0

    def to_si(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return values in SI, same shape; values that are in SI already are unchanged."""
        if self.factor != 1.0:
            values = values * self.factor
        if self.divisor != 1.0:
            values = values / self.divisor
        return values + self.offset if self.offset else values


_UNITS = (
    Unit("N", "N"),
    Unit("mN", "N", divisor=1e3),
    Unit("uN", "N", divisor=1e6),
    Unit("kN", "N", factor=1e3),
    Unit("gf", "N", factor=9.80665, divisor=1e3),
    Unit("kgf", "N", factor=9.80665),
    Unit("V", "V"),
    Unit("mV", "V", divisor=1e3),
    Unit("uV", "V", divisor=1e6),
    Unit("A", "A"),
    Unit("mA", "A", divisor=1e3),
    Unit("uA", "A", divisor=1e6),
    Unit("m", "m"),
    Unit("cm", "m", divisor=1e2),
    Unit("mm", "m", divisor=1e3),
    Unit("um", "m", divisor=1e6),
    Unit("nm", "m", divisor=1e9),
    Unit("in", "m", factor=254.0, divisor=1e4),
    Unit("degC", "degC"),
    Unit("K", "degC", offset=-273.15),
    Unit("s", "s"),
    Unit("ms", "s", divisor=1e3),
    Unit("us", "s", divisor=1e6),
    Unit("min", "s", factor=60.0),
    Unit("m s-2", "m s-2"),
    Unit("mm s-2", "m s-2", divisor=1e3),
    Unit("g", "m s-2", factor=9.80665),
    Unit("m/s", "m/s"),
    Unit("mm/s", "m/s", divisor=1e3),
    Unit("Pa", "Pa"),
    Unit("kPa", "Pa", factor=1e3),
    Unit("rad", "rad"),
    Unit("1", "1"),
)
_BY_SYMBOL = {unit.symbol: unit for unit in _UNITS}
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

_BRACKETED = re.compile(r"(.*?)\s*[(\[{]\s*([^()\[\]{}]*?)\s*[)\]}]\s*", re.DOTALL)
_TAILED = re.compile(r"(.*\S)\s*(?:[/,;]\s*|_)(\S(?:.*\S)?)\s*", re.DOTALL)


def known_unit(text: str) -> Unit | None:
    """Return the unit that a text names by symbol or word; None if it names none."""
    text = text.strip()
    symbol = _ALIASES.get(text, text)
    return _BY_SYMBOL.get(symbol) or _BY_SYMBOL.get(_WORDS.get(text.lower(), ""))


def unit_named(text: str) -> Unit:
    """Return the unit that a text names.

    Raises:
        UnusableInputError: it names none.
    """
    if (unit := known_unit(text)) is None:
        raise UnusableInputError(
            Message(
                "import.unknown_unit",
                "'{unit}' is not a known unit; known are {units}",
                unit=Verbatim(text),
                units=", ".join(unit.symbol for unit in _UNITS),
            )
        )
    return unit


def alternatives(si: str) -> tuple[Unit, ...]:
    """Return all units of the same quantity."""
    return tuple(unit for unit in _UNITS if unit.si == si)


def name_and_unit(header: str) -> tuple[str, str]:
    """A column's header as its bare name and its unit's symbol: "Force [mN]" or "force_mN"; "" where it tells none."""
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
