"""The language of the window and of the reports that it writes: English texts are looked up when they are used.

English is what the code says, and what the command line speaks; ``languages/CODE.toml`` has English = translation,
grouped by page. A text without a translation stays English. What is kept or exchanged (sites, notes, file names, the
audit log) is never translated, and numbers keep their decimal point.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

LANGUAGES = {"en": "English", "de": "Deutsch"}
"""What can be chosen, each in its own words."""
ENGLISH = "en"
FOLDER = Path(__file__).with_name("languages")


class _InForce:
    """The language that is spoken, and its texts; English needs none."""

    code = ENGLISH
    texts: dict[str, str] = {}  # noqa: RUF012 - replaced as a whole, never changed


def _(text: str) -> str:
    """A text in the language of the window; where it has named fields, fill them in afterwards by ``format``."""
    return _InForce.texts.get(text, text)


def plural(one: str, many: str, count: int) -> str:
    """The text for one or for another number of things, in the language of the window."""
    return _(one if count == 1 else many)


def marked(text: str) -> str:
    """The text as it is, marked for the catalogue: for constants, which are looked up when they are used."""
    return text


def spoken() -> str:
    """The code of the language in force."""
    return _InForce.code


def speak(code: str) -> None:
    """Take on a language, for everything that is made from now on; one that is not known is English.

    Raises:
        OSError, tomllib.TOMLDecodeError: the catalogue, which comes with the program, is damaged.
    """
    code = code if code in LANGUAGES else ENGLISH
    if code != _InForce.code:
        _InForce.texts = {} if code == ENGLISH else catalogue(code)
        _InForce.code = code


def catalogue(code: str) -> dict[str, str]:
    """The texts of a language, from all pages.

    Raises:
        OSError, tomllib.TOMLDecodeError: there is no catalogue, or it is damaged.
    """
    with (FOLDER / f"{code}.toml").open("rb") as file:
        pages: dict[str, dict[str, str]] = tomllib.load(file)
    return {text: said for page in pages.values() for text, said in page.items()}
