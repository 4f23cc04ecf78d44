"""Choices that the form of a test offers. Independent of Qt."""

from __future__ import annotations

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
