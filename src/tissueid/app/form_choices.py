"""Choices that the form of a test offers, and the check of its subject. Independent of Qt."""

from __future__ import annotations

import re
from typing import get_args

from tissueid.acquisition.stimulus_choice import PRELOAD_S
from tissueid.instrument import PROFILES
from tissueid.stimuli.kinds.noise import Noise

DEFAULT_URL = "simulated://forearm"
FROM_FILE = "file"
MULTISTEP = "multistep"
SITES = (
    "left forearm, posterior",
    "left forearm, anterior",
    "right forearm, posterior",
    "right forearm, anterior",
    "left upper arm",
    "right upper arm",
    "left thigh",
    "right thigh",
    "left calf",
    "right calf",
    "abdomen",
    "material sample",
)
"""Suggested sites; any text is allowed."""
DISTRIBUTIONS: tuple[str, ...] = tuple(
    name for name in get_args(Noise.model_fields["distribution"].annotation) if name != "binary"
)
"""Distributions offered: without "binary", whose edges hurt (thesis 3.1.1)."""


def longest_stimulus_s(limits: str) -> float:
    """Return the longest stimulus that a profile of limits allows after the preload, s."""
    return PROFILES[limits].max_seconds - PRELOAD_S


_WORD = re.compile(r"[^\W\d_]+(?:['’-][^\W\d_]+)*\.?")
_PARTICLES = frozenset(
    {"de", "den", "der", "del", "di", "da", "du", "la", "le", "van", "von", "zu", "zur", "bin", "al"}
)
_TITLES = frozenset({"mr", "mrs", "ms", "dr", "prof", "herr", "frau"})
_SHORTEST_SHOUTED = 3
"""Letters of a word in capitals that may be a name; shorter ones are abbreviations."""
_MOST_WORDS = 6


def reads_like_name(text: str) -> bool:
    """Whether a pseudonym looks like a real name: two capitalised words and nothing else, as in "John Smith".

    Initials, titles, particles and the order "Smith, John" are known; anything with a digit in it is a code.
    """
    parts = text.replace(",", " ").split()
    if not 2 <= len(parts) <= _MOST_WORDS or not all(_WORD.fullmatch(part) for part in parts):
        return False
    words = [part for part in parts if part.lower() not in _PARTICLES]
    named = [word for word in words if word.lower().rstrip(".") not in _TITLES]
    titled = len(named) < len(words)
    full = [word for word in named if _capitalised(word)]
    initials = [word for word in named if len(word.rstrip(".")) == 1 and word[0].isupper()]
    return len(full) + len(initials) == len(named) and (len(named) >= 2 or titled) and bool(full)


def _capitalised(word: str) -> bool:
    letters = word.rstrip(".")
    if letters.isupper():
        return len(letters) >= _SHORTEST_SHOUTED
    return len(letters) > 1 and letters[0].isupper()
