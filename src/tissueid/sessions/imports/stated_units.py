"""Units that files and users state, resolved by pint (docs/decisions/0064-units-of-records.md).

pint knows the factors; here is which of its units measure signals. Any other text is unknown and must be refused by the
caller: a header that means something else must never become a number. pint is imported at the first use.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from fractions import Fraction
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any

from tissueid.errors import UnusableInputError
from tissueid.messages import Verbatim
from tissueid.units import Unit

if TYPE_CHECKING:  # takes a second to import
    import pint

OFFERED = {
    "N": ("N", "mN", "uN", "nN", "kN", "gf", "kgf", "lbf"),
    "m": ("m", "cm", "mm", "um", "nm", "in", "mil"),
    "s": ("s", "ms", "us", "ns", "min", "h"),
    "V": ("V", "mV", "uV"),
    "A": ("A", "mA", "uA"),
    "degC": ("degC", "K", "degF"),
    "m s-2": ("m s-2", "mm s-2", "g"),
}
"""Symbols that lists and messages offer, by the SI unit of the quantity; others are read as well."""
_PREFIXED = frozenset((
    "newton", "meter", "second", "volt", "ampere", "gram", "pascal", "kelvin", "radian", "hertz", "ohm", "henry",
    "farad", "coulomb", "siemens", "tesla", "weber", "watt", "joule", "bar", "meter_Hg", "strain",
))  # fmt: skip
_PLAIN = frozenset((
    "minute", "hour", "day", "inch", "foot", "yard", "thou", "mil", "micron", "force_pound", "force_ounce",
    "force_gram", "force_kilogram", "kip", "dyne", "pound", "ounce", "pound_force_per_square_inch",
    "kip_per_square_inch", "standard_atmosphere", "torr", "degree", "turn", "degree_Celsius", "degree_Fahrenheit",
    "standard_gravity", "revolutions_per_minute", "revolutions_per_second", "percent", "ppm",
))  # fmt: skip
"""Units of pint, by its names, that are read with and without a prefix. Its constants and rare units are not."""
_PREFIXES = ("", "pico", "nano", "micro", "milli", "kilo")
_FURTHER_PREFIXES = {
    "centi": ("meter", "newton"),
    "deci": ("meter", "newton"),
    "hecto": ("pascal",),
    "mega": ("pascal", "hertz", "ohm"),
    "giga": ("pascal", "hertz"),
}
"""Prefixes that are read with these units alone: "Mm" and "MN" in a header are misspelt mm and mN."""
_MEANT = {
    "m": {"mil": "thou"},
    "degC": {"C": "degC", "F": "degF"},
    "m s-2": {"g": "standard_gravity", "G": "standard_gravity", "g0": "standard_gravity"},
}
"""Texts with another meaning for a quantity, by its SI unit."""
_AMBIGUOUS = {
    "C": "degC, coulomb",
    "F": "degF, farad",
    "g": "gram, g0",
    "h": "hour, henry",
    "d": "day",
    "in": "inch",
    "min": "minute",
    "mil": "thou",
}
"""Texts that can mean several things where the quantity is not known, and what to write."""
_ALIASES = (
    (
        re.compile(r"(?:deg(?:rees?)?\.?|°|º)\s*(C|F)(?:elsius|ahrenheit)?", re.IGNORECASE),
        lambda match: f"deg{match[1].upper()}",
    ),
    (re.compile(r"(k?g|lb|oz)s?[ _-]?f(?:orce)?", re.IGNORECASE), lambda match: f"{match[1].lower()}f"),
    (re.compile(r"(kilogram|gram|pound|ounce)s?[ _-]force", re.IGNORECASE), lambda match: f"force_{match[1].lower()}"),
    (re.compile(r"([kmuµμ]?N)([mc]?m|s)"), lambda match: f"{match[1]} {match[2]}"),
    (re.compile(r"kp"), lambda _: "kgf"),
    (re.compile(r"°"), lambda _: "degree"),
)
_SI = ("N", "V", "A", "m", "s", "m/s^2", "m/s", "Pa", "rad", "1", "kg", "H", "ohm", "N/m", "N s/m", "N/A", "rad/s",
       "Hz", "N m", "W", "F", "coulomb", "S", "T", "Wb", "1/m", "m/A", "V/m", "V s")  # fmt: skip
_SYMBOLS = {"m/s^2": "m s-2", "coulomb": "C"}
_LONGEST = 30
_FACTOR = re.compile(r"([A-Za-zµμΩε°%_]+?)(?:\^?(-?[1-4]))?(?![A-Za-z0-9µμΩε°%_])")
_POWERS = str.maketrans({"²": "^2", "³": "^3", "·": "*", "⋅": "*", "×": "*", "Ω": "Ω"})
_BRACKETED = re.compile(r"(.*?)\s*[(\[{]\s*([^()\[\]{}]*?)\s*[)\]}]\s*", re.DOTALL)
_ANY_BRACKETS = re.compile(r"[(\[{]\s*([^()\[\]{}]*?)\s*[)\]}]")
_TAILED = re.compile(r"(.*\S)\s*[/,;]\s*(\S(?:.*\S)?)\s*", re.DOTALL)
_SUFFIXED = re.compile(r"(.*[^\W_])_+([A-Za-zµμ%°]+(?:_per_[A-Za-z]+[23]?)?)")
NO_UNIT = ("1", "-", "–", "—")
"""Texts of a quantity without a unit."""
_NOTHING = ("n/a", "none", "unit", "units", "a.u.", "au", "arb. units")


def unit_of(text: str, expected: str = "") -> Unit | None:
    """Return the unit that a text names; None if it is unknown, or ambiguous for this quantity.

    ``expected`` is the SI unit of the quantity, "" if it is not known. The unit can be one of another quantity.
    """
    text = text.strip().strip("'\"")
    if text in NO_UNIT:
        return Unit("1", "1")
    if not text or len(text) > _LONGEST or text.lower() in _NOTHING:
        return None
    return _unit_of(text, expected)


def unit_named(text: str, role: str, expected: str) -> Unit:
    """Return the unit that a text names.

    Raises:
        UnusableInputError: it is unknown, or ambiguous for this quantity.
    """
    if (unit := unit_of(text, expected)) is not None:
        return unit
    if not expected and _is_ambiguous(text):
        raise UnusableInputError(
            "import.ambiguous_unit",
            "'{unit}' can mean several units: write {units}",
            unit=Verbatim(text.strip()),
            units=_AMBIGUOUS.get(text.strip()) or _AMBIGUOUS[text.strip().lower()],
        )
    offered = OFFERED.get(expected) or tuple(symbol for symbols in OFFERED.values() for symbol in symbols)
    raise UnusableInputError(
        "import.unknown_unit",
        "'{unit}' is not a known unit of {role}; known are {units} and others",
        unit=Verbatim(text),
        role=role,
        units=", ".join(offered),
    )


def offered_units(si: str) -> tuple[Unit, ...]:
    """Return the units that are offered for a quantity, by its SI unit."""
    return tuple(unit for symbol in OFFERED.get(si, ()) if (unit := unit_of(symbol, si)) is not None)


def split_header(header: str) -> tuple[str, str]:
    """Return the name and the text of the unit in a column header, such as "Force [mN]" or "force/mN".

    The text is "" where the header states none; it need not be a known unit. Suffixes such as "_mN" are left to
    ``split_suffix``, because "y_m" and "V_C" have none.
    """
    header = header.strip()
    match = _BRACKETED.fullmatch(header) or _TAILED.fullmatch(header)
    if match is None:
        return header, ""
    stated = match[2]
    if match.re is _BRACKETED:
        recognised = [text for text in _ANY_BRACKETS.findall(header) if _is_text(text) and unit_of(text) is not None]
        stated = recognised[0] if len(recognised) == 1 else stated
    return match[1] or header, stated if _is_text(stated) else ""


def split_suffix(header: str) -> tuple[str, str]:
    """Return the name and the suffix of a header such as "force_mN" that can be a unit; "" without one."""
    match = _SUFFIXED.fullmatch(header.strip())
    return (match[1], match[2]) if match else (header.strip(), "")


def is_clear_suffix(suffix: str, expected: str = "") -> bool:
    """Return whether a suffix is a unit whatever the name before it: "_mN" is, "_m", "_C" and "_in" need not be."""
    if len(suffix) < 2 or (suffix in _AMBIGUOUS and (suffix, expected) != ("min", "s")):
        return False
    unit = unit_of(suffix, expected)
    if expected:
        return unit is not None and unit.si == expected
    return unit is not None and ("_per_" in suffix or any(unit.symbol in symbols for symbols in OFFERED.values()))


def is_a_unit(text: str) -> bool:
    """Return whether a text can be a unit of any quantity."""
    return _is_ambiguous(text) or unit_of(text) is not None


def _is_ambiguous(text: str) -> bool:
    text = text.strip()
    return text in _AMBIGUOUS or (len(text) > 1 and text.lower() in _AMBIGUOUS)


def _is_text(text: str) -> bool:
    """Return whether a text in brackets can state a unit: "(:,2)" and "(3)" cannot."""
    return text in NO_UNIT or any(mark.isalpha() or mark in "%°\"'" for mark in text)


# -- pint -------------------------------------------------------------------------------------------------------------


@cache
def _registry() -> pint.UnitRegistry[float]:
    import pint

    return pint.UnitRegistry()


@lru_cache(4096)
def _unit_of(text: str, expected: str) -> Unit | None:
    if not expected and _is_ambiguous(text):
        return None
    stated, text = (
        text,
        _MEANT.get(expected, {}).get(text, text).translate(_POWERS).replace("**", "^").replace("_per_", "/"),
    )
    text = re.sub(r"\s+per\s+", "/", text)
    for pattern, plain in _ALIASES:
        if pattern.fullmatch(text):
            text = pattern.sub(plain, text)
    try:
        factors = list(_factors(text))
    except ValueError:
        return None
    if len(factors) == 1 and factors[0][1] == 1 and factors[0][0] in ("kelvin", "degree_Celsius", "degree_Fahrenheit"):
        return _temperature(factors[0][0])
    if any(name in ("degree_Celsius", "degree_Fahrenheit") for name, _ in factors):
        return None
    single = len(factors) == 1 and factors[0][1] == 1
    symbol = f"{_product(factors):~C}".replace("µ", "u") if single else stated
    factor, root = _root(factors)
    if (si_unit := _si_units().get(root)) is not None:
        return _made(symbol, si_unit[0], factor / si_unit[1])
    base = _registry().Quantity(1.0, _product(factors)).to_base_units()
    return _made(symbol, f"{base.units:~C}".replace("**", "^"), float(base.magnitude))


def _made(symbol: str, si: str, factor: float) -> Unit:
    """Return a unit with the symbol that is offered for it, if one is, and with exact whole numbers where possible."""
    exact = Fraction(f"{factor:.14g}")
    close = abs(float(exact) - factor) <= 1e-15 * factor
    numerator, divisor = (float(exact.numerator), float(exact.denominator)) if close else (factor, 1.0)
    symbol = _SHORT.get(symbol.replace("**", "^").replace("²", "^2"), symbol)
    return Unit(symbol, si, numerator, divisor)


_SHORT = {"th": "mil", "g_0": "g", "m/s^2": "m s-2", "mm/s^2": "mm s-2", "m_per_s2": "m s-2", "mm_per_s2": "mm s-2",
          "m_per_s": "m/s", "mm_per_s": "mm/s", "Ω": "ohm"}  # fmt: skip
"""Symbols of this project for those of pint."""


def _product(factors: list[tuple[str, int]]) -> pint.Unit:
    """Return the product of units of pint, each by name and exponent."""
    registry = _registry()
    product = registry.Unit("")
    for name, exponent in factors:
        product = product * registry.Unit(name) ** exponent
    return product


def _temperature(name: str) -> Unit:
    registry = _registry()
    at_zero, at_one = (float(registry.Quantity(value, name).to("degree_Celsius").magnitude) for value in (0.0, 1.0))
    symbol = {"kelvin": "K", "degree_Celsius": "degC", "degree_Fahrenheit": "degF"}[name]
    return Unit(symbol, "degC", factor=round(at_one - at_zero, 12), offset=round(at_zero, 9))


@cache
def _si_units() -> dict[frozenset[tuple[str, Any]], tuple[str, float]]:
    """Return symbol and size of the SI unit of each quantity, by its root units."""
    units: dict[frozenset[tuple[str, Any]], tuple[str, float]] = {}
    for symbol in _SI:
        size, root = _root(list(_factors(symbol)))
        units.setdefault(root, (_SYMBOLS.get(symbol, symbol), size))
    return units


def _root(factors: list[tuple[str, int]]) -> tuple[float, frozenset[tuple[str, Any]]]:
    size, unit = _registry().get_root_units(_product(factors))
    assert isinstance(size, int | float)
    return size, frozenset((str(name), power) for name, power in unit._units.items())


def _factors(text: str) -> Iterator[tuple[str, int]]:
    """Yield the names of pint and exponents of a product such as "kN·mm", "m/s^2" or "N/(m s)".

    Raises:
        ValueError: a part is not a unit that is read.
    """
    above, *below = re.split(r"\s*/\s*", text)
    for sign, part in ((1, above), *((-1, part) for part in below)):
        inner = part.removeprefix("(").removesuffix(")") if part.startswith("(") else part
        if sign > 0 and inner == "1":
            continue
        position = count = 0
        while match := _FACTOR.match(inner, position):
            yield _unit_name(match[1]), sign * int(match[2] or 1)
            count += 1
            position = match.end()
            between = re.compile(r"[\s*.-]+(?=[A-Za-zµμΩε°%])|[.\s]*$").match(inner, position)
            position = between.end() if between else position
            if position == len(inner):
                break
        if not count or position != len(inner) or (sign < 0 and count > 1 and inner == part):
            raise ValueError(text)


def _unit_name(text: str) -> str:
    """Return the name of pint, with its prefix, of one symbol or word.

    Raises:
        ValueError: it is not a unit that is read.
    """
    tried = [text]
    if len(text) > 2 and (text.isupper() or text.istitle()):  # "SEC", "Newtons", never "MM" or "KN"
        tried.append(text.lower())
    for each in tried:
        for prefix, name, _ in _registry().parse_unit_name(each):
            further = name in _FURTHER_PREFIXES.get(prefix, ())
            if (name in _PREFIXED and (prefix in _PREFIXES or further)) or (name in _PLAIN and not prefix):
                return "thou" if name == "mil" else f"{prefix}{name}"
    raise ValueError(text)
