"""Checks that a report in German contains no English text."""

import re
from functools import cache
from html import escape

from matplotlib.figure import Figure
from matplotlib.text import Text
from reports.page_check import checked

from tissueid.formatting import clean
from tissueid.language import set_language
from tools import translations

SAME = {
    "Position (mm)",
    "Phase (°)",
    "Test",
    "Test 2",
    "Status",
    "LMS",
    "Spectral",
    "Wiener",
    "AICc",
    "toeplitz",
    "hann",
}
"""Texts that are the same in both languages."""
NAMES = {
    "als",
    "cascade",
    "chen",
    "depth",
    "direction",
    "equal",
    "localized",
    "low_crest",
    "odd_random",
    "designed",
    "rtig",
    "spectral",
    "tissueid",
    "volterra",
}
"""Names of engines, of choices of options and of authors: English words that stay."""


def in_both(texts, same):
    """Return the texts with a word that the English and the German report share, except names and units."""
    english, german = ({" ".join(text.split()) for text in one} for one in texts)
    assert len(english) > 20
    return {text for text in english & german if re.search(r"[A-Za-z]{3}", text)} - same


def in_each_language(make):
    """Return the results of ``make`` in English and in German."""
    made = []
    try:
        for code in ("en", "de"):
            set_language(code)
            made.append(make())
    finally:
        set_language("en")
    return made


def in_german(make):
    """Return the result of ``make`` in German."""
    try:
        set_language("de")
        return make()
    finally:
        set_language("en")


def shown(source):
    """Return what a person reads on a page, piece by piece: text nodes, and texts for screen readers."""
    page = checked(source)
    return [*page.text.splitlines(), *(str(said.get("aria-label", "")) for _tag, said in page.tags)]


def texts_of(picture):
    """Return all texts of a picture: heading, caption, text for screen readers, and what is drawn."""
    drawn = picture.figure.findobj(Text) if isinstance(picture.figure, Figure) else ()
    return [picture.heading, picture.caption, picture.alt, picture.block.missing, *(item.get_text() for item in drawn)]


def texts_as_svg(figure, _key, alt):
    """Return an SVG element with the texts of a figure, numbers of the axes included, without drawing it."""
    for axes in figure.axes:
        axes.get_xticklabels()  # which sets their texts
        axes.get_yticklabels()
    texts = (item.get_text() for item in figure.findobj(Text) if item.get_visible())
    inside = "".join(f"<text>{escape(clean(text))}</text>" for text in texts if text)
    return f'<svg role="img" aria-label="{escape(clean(alt))}">{inside}</svg>'


def english_in(texts, data=()):
    """Return the texts that contain an English word, each after that word; ``data`` are words of the record.

    English is a word of the texts of the program that occurs in no German translation.
    """
    allowed = {part for name in NAMES for part in name.split("_")} | {
        word for text in data for word in _words(str(text))
    }
    found = {(word, text) for text in texts for word in _words(text) if word in _english() and word not in allowed}
    return sorted(found)


@cache
def _english():
    (path,) = translations.paths()
    entries = [entry for entry in translations.read(path) if entry.id]
    english = {word for entry in entries for text in _forms(entry.id) for word in _words(text)}
    german = {word for entry in entries for text in _forms(entry.string) for word in _words(text)}
    assert len(english - german) > 1000
    return english - german


def _forms(text):
    return text if isinstance(text, list | tuple) else (text,)


def _words(text):
    return {word.lower() for word in re.findall(r"[A-Za-zÄÖÜäöüß]{3,}", re.sub(r"\{\w+(:[^}]*)?\}", "", text))}
