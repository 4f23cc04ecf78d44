"""Demographic values of the subjects of a study, in its file ``subjects.csv``, and photographs of sites."""

from __future__ import annotations

import csv
import io
import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tissueid.atomic_write import atomic_file, private_folder, unused_path
from tissueid.errors import UnusableInputError
from tissueid.formatting import clean, csv_text
from tissueid.language import marked
from tissueid.messages import Message, Verbatim, joined
from tissueid.procedures.output_files import unwritable, write_text
from tissueid.procedures.study_plans import SUBJECTS_FILE
from tissueid.procedures.study_protocol import PHOTOGRAPHS, check_pseudonym

if TYPE_CHECKING:
    from tissueid.procedures.study_protocol import Protocol

_LARGEST_FILE = 10_000_000
_LARGEST_PHOTOGRAPH = 30_000_000
_MOST_PIXELS = 36_000_000
"""Pixels of a photograph: two copies of four bytes each while it is turned stay below ``MEMORY_BYTES``."""
_LONGEST = 200
_SUBJECT = "subject"


@dataclass(frozen=True)
class DemographicField:
    """A value of a subject: title, and the least and greatest number, or the choices of a text (any text if empty).

    ``unit`` is that of the number.
    """

    title: str
    bounds: tuple[float, float] | None = None
    unit: str = ""
    choices: tuple[str, ...] = ()


DEMOGRAPHIC_FIELDS: Mapping[str, DemographicField] = {
    "age_years": DemographicField(marked("Age"), (0.0, 120.0), marked("years")),
    "weight_kg": DemographicField(marked("Body weight"), (1.0, 500.0), "kg"),
    "height_m": DemographicField(marked("Body height"), (0.3, 2.6), "m"),
    "gender": DemographicField(marked("Gender"), choices=(marked("female"), marked("male"), marked("other"))),
    "handedness": DemographicField(marked("Handedness"), choices=(marked("left"), marked("right"), marked("both"))),
    "ethnicity": DemographicField(marked("Ethnicity")),
    "skin_conditions": DemographicField(marked("Skin conditions")),
}
"""Known values by column of the file; the ranges are those of living people, with some room."""


def demographic_value(name: str, text: str) -> str:
    """Return a demographic value as it is stored; "" for one that is not known.

    Raises:
        UnusableInputError: the name is unknown, or the value is not possible.
    """
    if name not in DEMOGRAPHIC_FIELDS:
        raise UnusableInputError(
            "subjects.unknown",
            "'{name}' is no demographic value; known: {known}",
            name=Verbatim(clean(name)[:_LONGEST]),
            known=joined(map(Verbatim, DEMOGRAPHIC_FIELDS)),
        )
    field, value = DEMOGRAPHIC_FIELDS[name], text.strip()
    if not value:
        return ""
    if field.bounds is not None:
        return _number(name, field.bounds, value)
    if field.choices and value not in field.choices:
        raise UnusableInputError(
            "subjects.choice",
            "{name} must be one of {known}, got '{value}'",
            name=Verbatim(name),
            known=joined(map(Verbatim, field.choices)),
            value=Verbatim(clean(value)[:_LONGEST]),
        )
    if not value.isprintable() or len(value) > _LONGEST or "@" in value or value[0] in "=+-":
        raise UnusableInputError(
            "subjects.text",
            "{name} must be one line of at most {most} characters, without '@' and not a formula",
            name=Verbatim(name),
            most=_LONGEST,
        )
    return value


def read_demographics(folder: Path) -> dict[str, dict[str, str]]:
    """Return the rows of ``subjects.csv`` by subject; empty without a file.

    Raises:
        UnusableInputError: the file cannot be read, has no column ``subject``, or a subject is missing or twice.
    """
    path = folder / SUBJECTS_FILE
    if not path.is_file():
        return {}
    try:
        if path.stat().st_size > _LARGEST_FILE:
            raise UnusableInputError("study.subjects_size", "{path} is too large", path=str(path))
        rows = list(csv.DictReader(io.StringIO(path.read_text(encoding="utf-8-sig"), newline="")))
    except (OSError, ValueError, csv.Error) as error:
        why = Verbatim(str(error).splitlines()[0])
        raise UnusableInputError(
            "study.subjects_unreadable", "{path} cannot be read: {reason}", path=str(path), reason=why
        ) from error
    if any(_SUBJECT not in row for row in rows):
        raise UnusableInputError("study.subjects_column", "{path} must have a column 'subject'", path=str(path))
    demographics = {row[_SUBJECT]: {name: value or "" for name, value in row.items() if name} for row in rows}
    if len(demographics) < len(rows) or not all(demographics):
        raise UnusableInputError("study.subjects_twice", "in {path} each row must name another subject", path=str(path))
    return demographics


def save_demographics(folder: Path, subject: str, values: Mapping[str, str]) -> None:
    """Write the values of a subject to ``subjects.csv`` atomically; other rows and columns stay.

    Raises:
        UnusableInputError: the subject is no pseudonym, a value is not possible, or the file cannot be used.
    """
    subject = check_pseudonym(subject)
    checked = {name: demographic_value(name, text) for name, text in values.items()}
    rows = read_demographics(folder)
    rows[subject] = rows.get(subject, {}) | {_SUBJECT: subject} | checked
    columns = list(dict.fromkeys([_SUBJECT, *(name for row in rows.values() for name in row)]))
    lines = [columns, *([row.get(name, "") for name in columns] for row in rows.values())]
    write_text(folder / SUBJECTS_FILE, csv_text(lines))


def missing_demographics(protocol: Protocol, folder: Path, subject: str) -> list[str]:
    """Return the values that the protocol asks for and the file does not have.

    Raises:
        UnusableInputError: the file cannot be read.
    """
    values = read_demographics(folder).get(subject, {})
    return [name for name in protocol.demographics if not values.get(name, "").strip()]


def add_photograph(folder: Path, subject: str, site: str, source: Path) -> Path:
    """Copy a photograph of a site into the folder of a study, and return the copy. No file is replaced.

    Descriptions in the file, such as place, time and owner of the camera, are left out; it is turned upright.

    Raises:
        UnusableInputError: it is no JPEG or PNG picture, too large, or cannot be read or written.
    """
    from tissueid.acquisition.waveform_file import read_at_most  # it imports scipy

    subject = check_pseudonym(subject)
    too_large = Message(
        "photograph.large",
        "{path} is larger than {most:g} MB",
        path=str(source),
        most=_LARGEST_PHOTOGRAPH / 1e6,
    )
    data = read_at_most(source, _LARGEST_PHOTOGRAPH, too_large)
    try:
        suffix, bare = _bare_picture(data)
    except ValueError as error:
        raise UnusableInputError(
            "photograph.kind",
            "{path} is not a JPEG or PNG picture, is damaged, or has more than {most:g} megapixels",
            path=str(source),
            most=_MOST_PIXELS / 1e6,
        ) from error
    site_name = "".join(c if c.isalnum() else "-" for c in site).strip("-")[:60] or "site"
    target = folder / PHOTOGRAPHS / f"{subject} {site_name}{suffix}"
    try:
        private_folder(target.parent)
        target = unused_path(target)
        with atomic_file(target, new=True) as partial:
            partial.write_bytes(bare)
    except OSError as error:
        raise unwritable(target, error) from error
    return target


def _number(name: str, bounds: tuple[float, float], text: str) -> str:
    try:
        value = float(text.replace(",", "."))
    except ValueError:
        value = float("nan")
    if not bounds[0] <= value <= bounds[1]:
        raise UnusableInputError(
            "subjects.range",
            "{name} must be a number from {least:g} to {most:g}, got '{value}'",
            name=Verbatim(name),
            least=bounds[0],
            most=bounds[1],
            value=Verbatim(clean(text)[:_LONGEST]),
        )
    return f"{value:.10g}"


def _bare_picture(data: bytes) -> tuple[str, bytes]:
    """Return ending and content of a JPEG or PNG picture, upright and without descriptions.

    Raises:
        ValueError: it is none, or damaged, or has too many pixels.
    """
    from PIL import Image, ImageOps

    bare = io.BytesIO()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of damaged descriptions, which are left out
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(io.BytesIO(data), formats=("JPEG", "PNG")) as picture:
                kind = "PNG" if picture.format == "PNG" else "JPEG"
                if math.prod(picture.size) > _MOST_PIXELS and "progressive" not in picture.info:
                    picture.draft(None, (picture.width // 2, picture.height // 2))  # decodes a JPEG at half its size
                if math.prod(picture.size) > _MOST_PIXELS:
                    raise ValueError(f"more than {_MOST_PIXELS} pixels")
                ImageOps.exif_transpose(picture, in_place=True)
                picture.info.clear()  # no copy of the pixels: they may take 140 MB
                picture.getexif().clear()
                picture.save(bare, kind, quality=95)
    except Exception as error:
        # On damaged descriptions the library also raises KeyError, TypeError, struct.error and ZeroDivisionError.
        raise ValueError(str(error)) from error
    return (".png" if kind == "PNG" else ".jpg"), bare.getvalue()
