"""Formatting of numbers, names and units for people. All other modules use SI."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterable
from datetime import datetime
from typing import TYPE_CHECKING, Any

from tissueid.language import _, decimal
from tissueid.messages import MISSING, signed
from tissueid.units import Figure, display_unit, shown_si, split_name, unit_of

if TYPE_CHECKING:  # imports numpy, which commands without numbers do not need
    from tissueid.records import Estimate

ANONYMOUS = "anonymous"
"""Pseudonym, in files, of a subject that has none."""
_ARITHMETIC = 1e-12
"""Share of a value below which a deviation is rounding of the arithmetic."""
_LARGEST_INTEGER = 10**15
_MOST_ITEMS = 12
_LONGEST_TEXT = 1000
_LONGEST_LABEL = 40
_DEEPEST = 4
_FORMULA = re.compile(r"[=+@\t\r]|-(?![\d.]+(e[+-]?\d+)?$)", re.IGNORECASE)
"""Beginning of a text that a spreadsheet takes for a formula; a signed number is none."""
_DIGEST = re.compile(r"[0-9a-f]{40,128}")
_DIGITS = 16
"""Digits of a hash that are shown."""

PRINCIPAL = ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m")
"""The parameters that are asked for first."""


def principal_first(names: Iterable[str]) -> list[str]:
    """Return names of parameters with mass, damping and stiffness first; the others keep their order."""
    return sorted(names, key=lambda name: PRINCIPAL.index(name) if name in PRINCIPAL else len(PRINCIPAL))


_LABELS = {
    "natural_frequency_rad_per_s": "Natural frequency",
    "a1_m_per_n_s": "A₁ of the impulse response",
    "a2_rad_per_s": "A₂ of the impulse response",
    "a3_per_s": "A₃ of the impulse response",
    "c1_m": "Nonlinear constant C₁",
    "c2_per_n": "Nonlinear constant C₂",
    "c3_n": "Load beyond the measured one, C₃",
    "c1": "C₁",
    "c2": "C₂",
    "c3": "C₃",
    "tissue_mass_kg": "Mass of the tissue alone",
    "tissue_damping_n_s_per_m": "Damping of the tissue alone",
    "tissue_damping_in_n_s_per_m": "Damping of the tissue alone, inward",
    "tissue_damping_out_n_s_per_m": "Damping of the tissue alone, outward",
    "spring_1_n_per_m": "Spring in series with damper 1",
    "damper_1_n_s_per_m": "Damper 1",
    "spring_2_n_per_m": "Spring parallel to damper 2",
    "damper_2_n_s_per_m": "Damper 2",
    "stiffness_in_n_per_m": "Stiffness inward",
    "stiffness_out_n_per_m": "Stiffness outward",
    "kernel1_m_per_n_s": "First order",
    "kernel2_m_per_n2_s2": "Second order",
    "seconds": "Length",
    "surface_position_m": "Surface of the tissue",
    "bmi_kg_per_m2": "Body mass index",
    "height_m": "Body height",
    "weight_kg": "Body weight",
    "age_years": "Age",
    "known_surface_position_m": "Origin of the curve",
    "known_c3_n": "Weight of the moving part",
    "aicc_kelvin_voigt": "AICc of Kelvin-Voigt",
    "aicc_maxwell": "AICc of Maxwell",
    "aicc_standard_linear_solid": "AICc of the standard linear solid",
    "aicc_burger": "AICc of Burger",
    "clipped": "Share held at the ends of the range",
    "vaf_linear_percent": "VAF of the linear stage alone",
    "vaf_parametric_percent": "VAF of the second-order model",
    "vaf_within_levels_median_percent": "Median VAF within the levels",
    "level_s": "Time at each level",
    "settle": "Settling time",
    "file_rate_hz": "Sample rate of the file",
    "vaf_within_levels_least_percent": "Smallest VAF within the levels",
}


_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def with_unit(text: str, unit: str) -> str:
    """Return a number with its unit, separated by a space also before % and °, as in SI."""
    return f"{text} {unit}" if unit else text


def number(value: float | None, digits: int = 4) -> str:
    """Return a number with ``digits`` significant digits, never in the form 1e-05; a dash if it is not finite."""
    if value is None or not math.isfinite(value):
        return MISSING
    if value == 0.0:
        return "0"
    mantissa, _mark, power = f"{value:.{digits - 1}e}".partition("e")
    exponent = int(power)
    if not -4 <= exponent < 7:
        return f"{decimal(signed(_trimmed(mantissa)))} × 10{superscript(exponent)}"
    decimals = digits - 1 - exponent
    return decimal(signed(_trimmed(f"{round(value, decimals):.{max(0, decimals)}f}")))


def share_text(share: float) -> str:
    """Return a share in percent with three digits; a word where it is unknown."""
    return f"{number(100.0 * share, 3)} %" if math.isfinite(share) else _("unknown")


def superscript(exponent: int) -> str:
    """Return an exponent in superscript digits."""
    return str(exponent).translate(_SUPERSCRIPT)


def fixed(value: float | None, decimals: int) -> str:
    """Return a number with ``decimals`` decimals; a dash if it is not finite."""
    if value is None or not math.isfinite(value):
        return MISSING
    return decimal(signed(f"{value:.{decimals}f}"))


def grouped(value: float | None) -> str:
    """Return a whole number with thin spaces between thousands; a dash if it is not finite."""
    if value is None or not math.isfinite(value):
        return MISSING
    return signed(f"{round(value):,}".replace(",", "\u202f"))


def estimate(quantity: Estimate, scale: float = 1.0) -> tuple[str, str, str]:
    """Return a value, its deviation and their common power of ten: "4740", "160", "" or "1.837", "0.017", "10⁻⁵".

    The deviation has two digits and the value as many decimals. The deviation is "" where there is none.
    """
    if not math.isfinite(quantity.value):
        return MISSING, "", ""
    value = quantity.value * scale
    std = 0.0 if quantity.std is None else abs(quantity.std * scale)
    if not math.isfinite(std) or std <= _ARITHMETIC * abs(value):
        return number(value), "", ""
    exponent = math.floor(math.log10(max(abs(value), std)))
    power = 0 if -3 <= exponent < 6 else exponent
    decimals = min(8, 1 - math.floor(math.log10(std)) + power)
    shown = [decimal(signed(f"{round(part / 10.0**power, decimals):.{max(0, decimals)}f}")) for part in (value, std)]
    return shown[0], shown[1], f"10{superscript(power)}" if power else ""


def plus_minus(quantity: Estimate, scale: float = 1.0) -> str:
    """Return value ± standard deviation, or the value alone."""
    value, std, power = estimate(quantity, scale)
    if not std:
        return value
    return f"({value} ± {std}) × {power}" if power else f"{value} ± {std}"


def label_and_unit(name: str) -> tuple[str, str]:
    """Split a name such as ``mass_kg`` into its label and SI unit ("" without one)."""
    stem, unit = split_name(name)
    return _LABELS.get(name) or _plain(stem), unit


def figure_text(figure: Figure, value: float | None) -> str:
    """Return an SI value (temperatures in °C) as text with the decimals of its active unit, without the unit."""
    unit = unit_of(figure)
    return fixed(None if value is None else value * unit.factor, unit.decimals)


def value_and_rest(quantity: Estimate, si_unit: str) -> tuple[str, str]:
    """Return the value of an SI figure as text, and its deviation, common power of ten and unit as another text."""
    unit, scale = shown_si(si_unit)
    value, deviation, power = estimate(quantity, scale)
    return value, " ".join(filter(None, [deviation and f"± {deviation}", power, unit]))


def axis_label(name: str, unit: str) -> str:
    """Return the label of a quantity in the active language, with its displayed unit in brackets."""
    label = _(label_and_unit(name)[0])
    label = label if len(label) <= _LONGEST_LABEL else label[:_LONGEST_LABEL] + "…"
    return f"{label} ({unit})" if unit else label


def label_and_value(name: str, value: Any, depth: int = 0) -> tuple[str, str]:
    """Return the label and text of a named setting. Numbers are shown in the unit of the name."""
    if isinstance(value, float) or (isinstance(value, int) and not isinstance(value, bool)):
        label, unit = label_and_unit(name)
        shown, scale = display_unit(unit)
        if scale == 1.0:
            text = plain_text(value)
        else:
            text = number(value * scale, 6) if abs(value) < _LARGEST_INTEGER else plain_text(value)
        return label, text if text == MISSING else with_unit(text, _(shown))
    return label_and_unit(name)[0], plain_text(value, depth)


def plain_text(value: Any, depth: int = 0) -> str:
    """Return any JSON value as one line of text; deep nesting and long texts are cut off."""
    if value is None:
        return "not set"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int) and abs(value) >= _LARGEST_INTEGER:
        return plain_text(str(value))
    if isinstance(value, int):
        return signed(str(value))
    if isinstance(value, float):
        return number(value, 6)
    if isinstance(value, dict | list | tuple) and depth >= _DEEPEST:
        return "…"
    if isinstance(value, dict):
        pairs = [label_and_value(str(name), item, depth + 1) for name, item in list(value.items())[:_MOST_ITEMS]]
        return "; ".join(f"{label}: {text}" for label, text in pairs) + _and_more(value)
    if isinstance(value, list | tuple):
        return ", ".join(plain_text(item, depth + 1) for item in value[:_MOST_ITEMS]) + _and_more(value)
    text = clean(str(value))
    if _DIGEST.fullmatch(text):
        return f"{text[:_DIGITS]}…"
    return (text[:_LONGEST_TEXT] + " …" if len(text) > _LONGEST_TEXT else text) or MISSING


def local_time(created: str) -> datetime | None:
    """Return an ISO 8601 date in the time zone of this computer; None if it is invalid or has no zone."""
    try:
        moment = datetime.fromisoformat(created)
        return moment.astimezone() if moment.tzinfo is not None else None
    except (ValueError, OverflowError, OSError):
        return None


def local_minute(created: str) -> str:
    """Return an ISO 8601 date in local time, such as "2026-11-23 14:32"; empty if it is invalid."""
    moment = local_time(created)
    return "" if moment is None else f"{moment:%Y-%m-%d %H:%M}"


def zone_offset(moment: datetime) -> str:
    """Return the UTC offset of an aware date, such as "UTC+01:00", or "UTC"."""
    offset = f"{moment:%z}"
    return "UTC" if offset in ("", "+0000", "-0000") else f"UTC{offset[:3]}:{offset[3:5]}"


def subject_text(pseudonym: str) -> str:
    """Return a pseudonym as it is shown: cleaned, and "anonymous" in the language of the user."""
    return _("anonymous") if pseudonym == ANONYMOUS else clean(pseudonym).strip()


def clean(text: str) -> str:
    """Return a text with control and other unprintable characters replaced by a space or U+FFFD."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else " " if c.isspace() else "\ufffd" for c in text)


def cell_text(text: str) -> str:
    """Return a text for a cell of a CSV file: an apostrophe before what a spreadsheet would take for a formula."""
    return f"'{text}" if _FORMULA.match(text) else text


def text_of_cell(cell: str) -> str:
    """Return the text that ``cell_text`` made the cell from."""
    return cell[1:] if cell.startswith("'") and _FORMULA.match(cell, 1) else cell


def csv_text(rows: Iterable[Iterable[object]]) -> str:
    """Return rows as CSV; no text is a formula for a spreadsheet, and None is an empty cell."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows([cell_text(cell) if isinstance(cell, str) else cell for cell in row] for row in rows)
    return text.getvalue()


def _and_more(items: dict[Any, Any] | list[Any] | tuple[Any, ...]) -> str:
    return f" … ({len(items)} in all)" if len(items) > _MOST_ITEMS else ""


def _plain(name: str) -> str:
    text = clean(name).replace("_", " ").strip()
    return text[:1].upper() + text[1:] if text else "Unnamed"


def _trimmed(text: str) -> str:
    return text.rstrip("0").rstrip(".") if "." in text else text
