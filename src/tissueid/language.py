"""The language of the window and of its reports: translation of English texts by gettext catalogues.

English is the language of the code, the command line, files and logs. A catalogue is
``languages/CODE/LC_MESSAGES/tissueid.po``; ``make translations`` extracts the texts and compiles the catalogues by
Babel. A text without a translation stays English. Data (sites, notes, file names, the audit log) is never translated.
Numbers have the decimal mark of the language where they are shown, and a point in files.
"""

from __future__ import annotations

import contextlib
import functools
import gettext
from pathlib import Path

ENGLISH = "en"
FOLDER = Path(__file__).with_name("languages")
DOMAIN = "tissueid"


_COMMA = frozenset({"de"})
"""Languages with a decimal comma."""


class _Active:
    """The active language and its catalogue."""

    code = ENGLISH
    catalogue = gettext.NullTranslations()


class _Number(float):
    """A number that is filled into a text with a decimal comma."""

    def __format__(self, form: str) -> str:
        return decimal(super().__format__(form))


class _WithComma(str):
    """A text whose numbers get a decimal comma."""

    __slots__ = ()

    def format(self, *args: object, **values: object) -> str:
        """Fill the fields."""
        numbers = {name: _Number(value) for name, value in values.items() if isinstance(value, float)}
        return super().format(*args, **(values | numbers))


def decimal(number: str) -> str:
    """Return a number, as text with a decimal point, with the decimal mark of the active language."""
    return number.replace(".", ",") if _Active.code in _COMMA else number


def _(text: str) -> str:
    """Return ``text`` in the active language. Fill named fields afterwards, by ``format``."""
    return _said(_Active.catalogue.gettext(text)) if text else ""


def plural(singular: str, many: str, count: int) -> str:
    """Return the form of a text for ``count`` things in the active language."""
    return _said(_Active.catalogue.ngettext(singular, many, count))


def _said(text: str) -> str:
    return _WithComma(text) if _Active.code in _COMMA and "{" in text else text


def marked(text: str) -> str:
    """Return ``text`` unchanged. Marks a constant for extraction; translate it where it is shown."""
    return text


def current_language() -> str:
    """Return the code of the active language."""
    return _Active.code


def set_language(code: str) -> None:
    """Make a language active for every text translated from now on; an unknown code means English."""
    code = code if code in languages() else ENGLISH
    if code != _Active.code:
        _Active.catalogue = gettext.NullTranslations() if code == ENGLISH else read_catalogue(code)
        _Active.code = code


_NAME = marked("name of this language")


@functools.cache
def languages() -> dict[str, str]:
    """Return the languages that can be chosen: code and own name, English first. Damaged catalogues are left out."""
    names = {ENGLISH: "English"}
    for code in sorted(path.parents[1].name for path in FOLDER.glob(f"*/LC_MESSAGES/{DOMAIN}.mo")):
        with contextlib.suppress(Exception):  # gettext raises OSError, ValueError, struct.error, IndexError and others
            names[code] = read_catalogue(code).gettext(_NAME)
    return names


@functools.cache
def read_catalogue(code: str) -> gettext.NullTranslations:
    """Return the catalogue of a language; it is read once."""
    return gettext.translation(DOMAIN, FOLDER, [code])
