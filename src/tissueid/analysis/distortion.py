"""Noise, even and odd distortion of a recorded multisine, by the lines that its stimulus says it drove."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tissueid.errors import UnusableInputError
from tissueid.identification.validation.distortion import Distortion, distortion
from tissueid.records import Record
from tissueid.stimuli.kinds.multisine import played_multisine
from tissueid.wording import fixed


def is_multisine(described: Mapping[str, Any]) -> bool:
    """True where a session's description of a stimulus speaks of a multisine, of ours or from elsewhere."""
    return "multisine" in str(described).lower()


def distortion_of(record: Record, described: Mapping[str, Any]) -> Distortion:
    """Levels in a record (n,) of a multisine; the driven lines are found where the description does not say them.

    Raises:
        UnusableInputError: all lines were driven, or the record is not that of an odd multisine.
    """
    known = played_multisine(described)
    if known is None:
        return distortion(record)
    if known.lines == "full":
        raise UnusableInputError("the multisine drove every line, and distortion shows on lines that are not driven")
    return distortion(record, known.period, known.driven_lines().tolist(), known.settling_s)


def levels_in_words(levels: Distortion) -> str:
    """Noise, even and odd levels relative to the output, those that could be had; empty where none could."""
    return ", ".join(
        f"{what} {fixed(decibel, 1)} dB"
        for what, level in (("noise", levels.noise_rms), ("even", levels.even_rms), ("odd", levels.odd_rms))
        if (decibel := levels.relative_db(level)) is not None
    )
