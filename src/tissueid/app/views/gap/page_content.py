"""Content of the page for one diagnosis: texts, shares and curves. It is stored in files, so it validates itself.

Texts are messages, which the page translates when it shows them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, Field

from tissueid.gap.diagnosis_curves import MOST_ROWS, BudgetRow, Finite, GapProfile, GapSpectrum, SignalOverlay
from tissueid.records import Estimate
from tissueid.stored_values import LONGEST_TEXT, StoredText
from tissueid.twin.effect import STAGES, Stage

if TYPE_CHECKING:
    pass

_MOST_LINES = 100
_FORM_FIELDS: Mapping[str, type | tuple[type, ...]] = {
    "min_force_n": (int, float),
    "max_force_n": (int, float),
    "seconds": (int, float),
    "seed": int,
    "stimulus_kind": str,
    "distribution": str,
    "under_probe": str,
    "site": str,
    "pseudonym": str,
}
_GREATEST_FIELD = 2**31 - 1
_PROFILES = frozenset({"depth_m", "velocity_m_s", "time_s"})


def _known_share(value: float) -> float:
    if not (math.isnan(value) or 0.0 <= value <= 1.0):
        raise ValueError("a probability must be 0 to 1 or NaN")
    return value


def _form_fields(fields: Mapping[str, Any]) -> Mapping[str, Any]:
    for name, value in fields.items():
        if name not in _FORM_FIELDS or not isinstance(value, _FORM_FIELDS[name]):
            raise ValueError(f"a test has no field {name[:20]!r}")
        if isinstance(value, int | float) and not abs(value) <= _GREATEST_FIELD:
            raise ValueError(f"{name} is too large")
        if isinstance(value, str) and len(value) > LONGEST_TEXT:
            raise ValueError(f"{name} is too long")
    return fields


Name = Annotated[str, Field(max_length=LONGEST_TEXT)]
Lines = Annotated[tuple[StoredText, ...], Field(max_length=_MOST_LINES)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]


@dataclass(frozen=True)
class StageContent:
    """One stage of the signal chain: its share of the gap (0 to 1), whether it is at fault, and the evidence."""

    stage: Stage
    share: Share
    lit: bool
    evidence: Lines


@dataclass(frozen=True)
class Fitted:
    """A fitted parameter: its meaning, and its value in SI units."""

    meaning: StoredText
    value: Estimate
    si_unit: Name


@dataclass(frozen=True)
class Rival:
    """One candidate of the ranking; ``figures`` are its fitted parameters."""

    title: StoredText
    stage: Stage
    named: bool
    probability: Annotated[float, AfterValidator(_known_share)]
    odds: StoredText
    closed: StoredText
    alike: StoredText
    signature: StoredText
    remedy: StoredText
    figures: Annotated[tuple[Fitted, ...], Field(max_length=MOST_ROWS)]


@dataclass(frozen=True)
class Proposal:
    """A test that would separate the candidates.

    ``gains`` holds the title, the expected gain (nats) and the corresponding odds of every candidate test, best first.
    ``fields`` are values for the form of the guided test, None if the window cannot run the test. ``put`` says what to
    put under the probe; "" for the same tissue.
    """

    title: StoredText
    why: StoredText
    gains: Annotated[tuple[tuple[StoredText, Finite, StoredText], ...], Field(max_length=MOST_ROWS)]
    fields: Annotated[Mapping[str, Any], AfterValidator(_form_fields)] | None
    by_hand: StoredText
    put: StoredText = ""


@dataclass(frozen=True)
class PageContent:
    """A diagnosis as the page shows it."""

    verdict: Literal["effect", "no_gap", "unexplained"]
    effect: StoredText
    headline: StoredText
    level: Literal["good", "check", "poor"]
    means: Lines
    todo: Lines
    remarks: Lines
    stages: tuple[StageContent, ...]
    at_fault: tuple[Stage, ...]
    spectrum: GapSpectrum | None
    profiles: dict[Name, GapProfile]
    ranking: Annotated[tuple[Rival, ...], Field(max_length=MOST_ROWS)]
    closing: StoredText
    overlays: Annotated[tuple[SignalOverlay, ...], Field(max_length=3)]
    proposal: Proposal | None
    offered: Annotated[tuple[tuple[Name, StoredText, bool], ...], Field(max_length=MOST_ROWS)]
    """Effects to accept: name, title with its probability, and whether the diagnosis names it."""

    budget: Annotated[tuple[BudgetRow, ...], Field(max_length=MOST_ROWS)]
    """The waterfall from the gap before to the noise."""

    def __post_init__(self) -> None:
        if [item.stage for item in self.stages] != list(STAGES):
            raise ValueError("the stages are not those of the signal chain")
        if not set(self.profiles) <= _PROFILES:
            raise ValueError("a profile has an unknown name")
