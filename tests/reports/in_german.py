"""A report in English and in German, to find what was left in English."""

import re

from reports.page_check import checked

from tissueid.language import speak

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


def in_both(texts, same):
    """Texts with a word in them that the English and the German report share, but for names and units."""
    english, german = ({" ".join(text.split()) for text in one} for one in texts)
    assert len(english) > 20
    return {text for text in english & german if re.search(r"[A-Za-z]{3}", text)} - same


def in_each_language(make):
    """What a report says in English and in German."""
    said = []
    try:
        for code in ("en", "de"):
            speak(code)
            said.append(make())
    finally:
        speak("en")
    return said


def shown(source):
    """What a person reads on a page, piece by piece: text nodes, and what a screen reader says."""
    page = checked(source)
    return [*page.text.splitlines(), *(str(said.get("aria-label", "")) for _tag, said in page.tags)]
