"""Content of the page for one diagnosis, with the proposed test. It is stored in files, so it validates itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import AfterValidator, Field

from tissueid.app.words import sentence
from tissueid.formatting import clean
from tissueid.gap.diagnosis_content import MOST_ROWS, DiagnosisContent, Finite
from tissueid.language import marked
from tissueid.messages import translated
from tissueid.stored_values import LONGEST_TEXT, StoredText
from tissueid.twin.effect import Stage

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


def _form_fields(fields: Mapping[str, Any]) -> Mapping[str, Any]:
    for name, value in fields.items():
        if name not in _FORM_FIELDS or not isinstance(value, _FORM_FIELDS[name]):
            raise ValueError(f"a test has no field {name[:20]!r}")
        if isinstance(value, int | float) and not abs(value) <= _GREATEST_FIELD:
            raise ValueError(f"{name} is too large")
        if isinstance(value, str) and len(value) > LONGEST_TEXT:
            raise ValueError(f"{name} is too long")
    return fields


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
class PageContent(DiagnosisContent):
    """A diagnosis as the page shows it, with the proposed test as the form of the guided test takes it."""

    proposal: Proposal | None


STAGE_TITLES: dict[Stage, str] = {
    "drive": marked("Amplifier"),
    "coil": marked("Coil"),
    "mechanics": marked("Moving part"),
    "tissue": marked("Tissue"),
    "sensing": marked("Sensors"),
    "environment": marked("Environment"),
}
SIGNALS = (marked("Voltage"), marked("Current"), marked("Position"), marked("current"), marked("position"))
"""Names of the compared signals; ``voltage`` is marked in the chain."""
VERDICT_TITLES = {"effect": marked("Effect named"), "no_gap": marked("No gap"), "unexplained": marked("Unexplained")}
STATE_TITLES = {"changed": marked("Session changed since"), "missing": marked("Session file missing")}
"""State of the session file of a diagnosis."""


def as_sentence(text: str) -> str:
    """Return a text of a diagnosis, translated, with a capital and a full stop; "" stays ""."""
    return sentence(clean(translated(text)))


def as_title(text: str) -> str:
    """Return a text of a diagnosis, translated, with a capital and without a full stop, unbroken before %."""
    return as_sentence(text).rstrip(".").replace(" %", "\u00a0%")
