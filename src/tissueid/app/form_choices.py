"""Choices that the form of a test offers, and the check of its subject. Independent of Qt."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, get_args

from tissueid.acquisition.stimulus_choice import PRELOAD_S, NoiseChoice
from tissueid.instrument import PROFILES
from tissueid.language import marked
from tissueid.procedures.demo import LARGE_CLIPPED, LARGE_N
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


@dataclass(frozen=True)
class Preset:
    """A test that is chosen in one step.

    ``force_n`` are its lowest and highest force; the highest is lowered to that of the instrument if ``lowered``. Else
    the test is offered only where the limits and the instrument allow its forces.
    """

    name: str
    title: str
    kind: str
    force_n: tuple[float, float]
    seconds: float
    options: tuple[tuple[str, Any], ...] = ()
    lowered: bool = True

    @property
    def needed_n(self) -> float:
        """Force that the limits must allow, N."""
        return 0.0 if self.lowered else max(map(abs, self.force_n))


_USUAL = NoiseChoice()
PRESETS = (
    Preset(
        "standard",
        marked("Standard skin test"),
        Noise.name,
        (_USUAL.min_force_n, _USUAL.max_force_n),
        _USUAL.seconds,
    ),
    Preset(
        "thesis",
        marked("Thesis test, −5 to 12 N"),
        Noise.name,
        LARGE_N,
        _USUAL.seconds,
        (("clipped", LARGE_CLIPPED),),
        lowered=False,
    ),
    Preset("depths", marked("Equal depths"), "rtig", (-0.6, 10.0), 5.0),
)
"""Tests that are offered by name; the thesis test is that of the demonstration (thesis 3.1.3 and Fig. 3.8)."""


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
