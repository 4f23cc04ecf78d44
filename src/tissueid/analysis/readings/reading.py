"""One reading of a commercial probe: a value with its uncertainty, or the reason why there is none."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from tissueid.messages import Message, stored
from tissueid.records import Estimate

NOT_COMPARABLE = Message(
    "readings.not_comparable",
    "The readings are those of this instrument's probe and force. A suction probe applies negative pressure through an "
    "aperture, and a tapping probe has a mass of its own: lengths, frequencies and stiffness are not comparable with "
    "theirs in absolute terms; compare the ratios R2, R5, R6 and R7. Research use only.",
)
"""What every table of readings says about its use."""

LARGEST_RELATIVE_STD = 0.5
"""Relative standard deviation above which a ratio or a property of a decay counts as undetermined."""


@dataclass(frozen=True)
class Definition:
    """Name in files, symbol, meaning and SI unit of a reading."""

    name: str
    symbol: str
    meaning: str
    si_unit: str


@dataclass(frozen=True)
class Reading:
    """A reading in SI units.

    ``found`` is None where there is no value; its ``std`` is None where the uncertainty is unknown. ``reason`` says why
    in both cases.
    """

    definition: Definition
    found: Estimate | None
    reason: str = ""

    @property
    def value(self) -> float | None:
        """The value, SI; None if there is none."""
        return None if self.found is None else self.found.value

    def as_dict(self) -> dict[str, Any]:
        """Return symbol, unit, value, standard deviation and reason for JSON."""
        return {
            "symbol": self.definition.symbol,
            "unit": self.definition.si_unit,
            "value": self.value,
            "std": None if self.found is None else self.found.std,
            "reason": str(self.reason) or None,
            "reason_message": stored(self.reason) if self.reason else None,
        }


def as_answer(readings: Iterable[Reading]) -> dict[str, Any]:
    """Return readings by name for JSON."""
    return {reading.definition.name: reading.as_dict() for reading in readings}


def estimate(value: float, variance: float) -> Estimate:
    """Return a value with the root of its variance; without one where that is not finite."""
    return Estimate(value, math.sqrt(max(variance, 0.0)) if math.isfinite(variance) else None)


UNDETERMINED = Message(
    "readings.undetermined", "its standard deviation is more than half of its value: the data do not determine it"
)
NO_UNCERTAINTY = Message("readings.no_uncertainty", "the fit gives no uncertainty")
