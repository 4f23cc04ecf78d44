"""Noise, even and odd distortion of a recorded multisine, from the driven lines that its stimulus declares."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tissueid.errors import UnusableInputError
from tissueid.identification.validation.distortion import Distortion, distortion
from tissueid.language import marked
from tissueid.messages import Listing, Message
from tissueid.records import Record
from tissueid.stimuli.kinds.multisine import multisine_from_description


def is_multisine(described: Mapping[str, Any]) -> bool:
    """Return whether a session describes a stimulus as a multisine, whichever software made it."""
    return "multisine" in str(described).lower()


def distortion_of(record: Record, described: Mapping[str, Any]) -> Distortion:
    """Return the levels in a record (n,) of a multisine; the driven lines are estimated where none are declared.

    Raises:
        UnusableInputError: all lines were driven, or the record is not that of an odd multisine.
    """
    known = multisine_from_description(described)
    if known is None:
        return distortion(record)
    if known.lines == "full":
        raise UnusableInputError(
            "distortion.all_lines_driven",
            "the multisine drove every line, and distortion shows only on lines that are not driven",
        )
    return distortion(record, known.period, known.driven_lines().tolist(), known.settling_s)


def described_levels(levels: Distortion) -> str:
    """Return noise, even and odd levels relative to the output, as far as they are known; empty where none is."""
    rows = (
        (marked("noise {level:.1f} dB"), levels.noise_rms),
        (marked("even {level:.1f} dB"), levels.even_rms),
        (marked("odd {level:.1f} dB"), levels.odd_rms),
    )
    known = ((template, levels.relative_db(level)) for template, level in rows)
    items = tuple(Message("distortion.level", template, level=level) for template, level in known if level is not None)
    return Message("distortion.levels", "{levels}", levels=Listing(items)) if items else ""
