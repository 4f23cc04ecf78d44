"""Content of the page for one diagnosis, with its texts and the proposed test. It is stored, so it validates itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, Field

from tissueid.app.words import sentence
from tissueid.device import DeviceDescription
from tissueid.formatting import clean
from tissueid.gap.diagnosis import Diagnosis
from tissueid.gap.diagnosis_content import MOST_ROWS, DiagnosisContent, Finite
from tissueid.gap.next_experiment import candidate_tests, odds
from tissueid.instrument.twin_list import model_of_file, twin_url, twins_in
from tissueid.language import _, marked
from tissueid.messages import Message, Verbatim, translated
from tissueid.sessions import Session
from tissueid.stimuli.kinds.noise import Noise
from tissueid.stored_values import LONGEST_TEXT, MessageText
from tissueid.test_settings import TestSettings
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

    title: MessageText
    why: MessageText
    gains: Annotated[tuple[tuple[MessageText, Finite, MessageText], ...], Field(max_length=MOST_ROWS)]
    fields: Annotated[Mapping[str, Any], AfterValidator(_form_fields)] | None
    by_hand: MessageText
    put: MessageText = ""


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


_PUT = {
    "spring": marked("Put the calibration spring under the probe in place of the tissue."),
    "free_air": marked(
        "Lay the instrument level, with nothing under the probe and nothing in its way, and push the probe to the "
        "middle of its stroke."
    ),
}
"""Test: what to put under the probe in place of tissue."""


def proposal_of(diagnosis: Diagnosis, session: Session) -> Proposal | None:
    """Return the proposed next test; None if there is no doubt or no test would help."""
    step = diagnosis.next_experiment
    if step is None:
        return None
    instructions = {item.kind: item.instruction for item in candidate_tests(diagnosis.dataset)}
    gains = sorted((step.gains or {step.kind: step.gain_nats}).items(), key=lambda item: -item[1])
    title = instructions.get(step.kind, step.kind.replace("_", " "))
    fields = None if step.settings is None else _fields(step.settings, session)
    return Proposal(
        title,
        step.why,
        tuple((instructions.get(kind, kind.replace("_", " ")), gain, odds(gain)) for kind, gain in gains),
        fields,
        "" if fields is not None else _by_hand(title),
        _PUT.get(step.kind, ""),
    )


def session_url(device: DeviceDescription, twin: Path | None, folders: Sequence[Path]) -> str:
    """Return the URL of the simulated instrument of a session; "" if the instrument is real or not found.

    Args:
        device: the instrument of the session; the simulation of a twin states its name and version.
        twin: the twin that the diagnosis began with.
        folders: folders that are searched for twins.
    """
    if twin is not None and model_of_file(twin) == device.model:
        return twin_url(twin)
    by_folder = (twins_in(folder).items() for folder in dict.fromkeys(folders))
    return next((url for twins in by_folder for url, model in twins if model == device.model), "")


def prepared_words(step: Proposal, device: DeviceDescription, url: str) -> str:
    """Return the notice for a prepared test: its title, what to put under the probe, which instrument.

    Args:
        step: the test.
        device: the instrument of the diagnosed session.
        url: its URL if the form has chosen it; "" if the form keeps its own choice.
    """
    fields = step.fields or {}
    title = as_title(step.title)
    if "max_force_n" in fields:
        title = _("{title}, {low:.1f} to {high:.1f} N as far as the limits allow").format(
            title=title, low=fields.get("min_force_n", 0.0), high=fields["max_force_n"]
        )
    if url:
        instrument = translated(
            Message("gap.simulation_chosen", "The simulation of the session is chosen as the instrument.")
        )
    elif device.simulated:
        instrument = _("The session is of an unknown simulation: choose the simulation as the instrument.")
    else:
        instrument = translated(
            Message(
                "gap.choose_instrument",
                "Choose the instrument of the session: {model}, {serial}.",
                model=Verbatim(clean(device.model)),
                serial=Verbatim(clean(device.serial_number)),
            )
        )
    parts = (
        _("Prepared: {title}.").format(title=title),
        as_sentence(step.put),
        instrument,
        _("Check the instrument and the site, then start the test."),
    )
    return " ".join(filter(None, parts))


def _by_hand(title: str) -> str:
    return Message(
        "gap.by_hand",
        "By hand: {title}. The window cannot run this test: record it with the program of the instrument, then "
        "diagnose that session.",
        title=title,
    )


def _fields(settings: TestSettings, session: Session) -> dict[str, Any]:
    fields: dict[str, Any] = settings.model_dump(include={"min_force_n", "max_force_n", "seconds"}, exclude_none=True)
    fields["stimulus_kind"] = settings.stimulus or Noise.name
    fields["distribution"] = settings.distribution or "uniform"
    fields["under_probe"] = settings.kind or ""
    used = {_seed(test.stimulus) for test in session.tests}
    fields["seed"] = next(seed for seed in count(1) if seed not in used)
    site = next((test.site for test in session.tests if test.site), "")
    site = settings.site if fields["under_probe"] else site
    if site:
        fields["site"] = clean(site)[:80]
    if fields["under_probe"]:
        fields["pseudonym"] = ""  # no person is measured
    elif session.subject.pseudonym:
        fields["pseudonym"] = clean(session.subject.pseudonym)[:80]
    return fields


def _seed(stimulus: Mapping[str, Any]) -> int | None:
    played = stimulus.get("stimulus")
    seed = played.get("seed") if isinstance(played, dict) else None
    return seed if isinstance(seed, int) else None
