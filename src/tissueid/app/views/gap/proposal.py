"""The next experiment as the page offers it: what it is for, and how it is done."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import count, pairwise
from pathlib import Path
from typing import Any

from tissueid.app.words import sentence
from tissueid.core_words import said_by_core
from tissueid.device import DeviceDescription
from tissueid.gap.diagnosis import Diagnosis
from tissueid.gap.menu import menu
from tissueid.gap.next_experiment import odds
from tissueid.instrument.twin_list import model_of_file, twin_url, twins_in
from tissueid.language import _, marked
from tissueid.sessions import Session
from tissueid.stimuli.kinds.noise import Noise
from tissueid.wording import clean

_OPTIONS = {"--min-force": "min_force_n", "--max-force": "max_force_n", "--seconds": "seconds"}
_PUT = {
    "spring": marked("Put the calibration spring under the probe in place of the tissue."),
    "free_air": marked(
        "Lay the instrument level, with nothing under the probe and nothing in its way, and push the probe to the "
        "middle of its stroke."
    ),
}
"""What to put under the probe where that is no tissue."""


@dataclass(frozen=True)
class Proposal:
    """A test that would tell the rivals apart.

    ``gains`` are the title of every test on the menu, its expected gain (nats) and the odds that this amounts to, best
    first. ``fields`` are what the form of the guided test is filled in with, None where it is not known how the test is
    run. ``put`` says what to put under the probe, empty for the same tissue.
    """

    title: str
    why: str
    gains: tuple[tuple[str, float, str], ...]
    fields: Mapping[str, Any] | None
    by_hand: str
    put: str = ""


def proposal_of(found: Diagnosis, session: Session) -> Proposal | None:
    """What a diagnosis would have measured next; None where nothing is in doubt, or nothing would help."""
    step = found.next_experiment
    if step is None:
        return None
    words = {item.kind: sentence(said_by_core(item.words)).rstrip(".") for item in menu(found.observed)}
    gains = sorted((step.gains or {step.kind: step.gain_nats}).items(), key=lambda item: -item[1])
    title = words.get(step.kind, step.kind.replace("_", " ").capitalize())
    fields = _fields(step.command_line, session) if step.command_line else None
    return Proposal(
        title,
        sentence(said_by_core(step.why.rstrip("."))),
        tuple((words.get(kind, kind.replace("_", " ").capitalize()), gain, odds(gain)) for kind, gain in gains),
        fields,
        "" if fields is not None else _by_hand(title),
        _(_PUT[step.kind]) if step.kind in _PUT else "",
    )


def session_url(device: DeviceDescription, twin: Path | None, folders: Sequence[Path]) -> str:
    """Return the address of the simulated instrument of a session; empty where it is real or not found.

    Args:
        device: the instrument of the session; the simulation of a twin states its name and version.
        twin: the twin that the diagnosis began with.
        folders: where twins are looked for.
    """
    if twin is not None and model_of_file(twin) == device.model:
        return twin_url(twin)
    known = (twins_in(folder).items() for folder in dict.fromkeys(folders))
    return next((url for found in known for url, model in found if model == device.model), "")


def prepared_words(step: Proposal, device: DeviceDescription, url: str) -> str:
    """Return what to say of a test that was prepared: what it is, what to put under the probe, which instrument.

    Args:
        step: the test.
        device: the instrument of the diagnosed session.
        url: its address where it was chosen on the form; empty where the choice was left as it was.
    """
    fields = step.fields or {}
    words = step.title
    if "max_force_n" in fields:
        words = _("{title}, {low:.1f} to {high:.1f} N as far as the limits allow").format(
            title=words, low=fields.get("min_force_n", 0.0), high=fields["max_force_n"]
        )
    if url:
        instrument = _("The simulation of the session is chosen as the instrument.")
    elif device.simulated:
        instrument = _("The session is of a simulation, and does not state which: choose it as the instrument.")
    else:
        instrument = _("Choose the instrument of the session: {model}, {serial}.").format(
            model=clean(device.model), serial=clean(device.serial_number)
        )
    said = (
        _("Prepared: {title}.").format(title=words),
        step.put,
        instrument,
        _("Check the instrument and the site, then start the test."),
    )
    return " ".join(filter(None, said))


def _by_hand(title: str) -> str:
    return _(
        "By hand: {title}. How to run it on this instrument is not known: record it with the instrument's own program, "
        "then diagnose that session."
    ).format(title=title)


def _fields(command_line: str, session: Session) -> dict[str, Any]:
    given = dict(pairwise(shlex.split(command_line)))
    found: dict[str, Any] = {ours: float(given[option]) for option, ours in _OPTIONS.items() if option in given}
    found["stimulus_kind"] = given.get("--stimulus", Noise.name)
    found["distribution"] = given.get("--distribution", "uniform")
    found["under_probe"] = given.get("--kind", "")
    used = {_seed(test.stimulus) for test in session.tests}
    found["seed"] = next(seed for seed in count(1) if seed not in used)
    site = next((test.site for test in session.tests if test.site), "")
    site = given.get("--site", "") if found["under_probe"] else site
    if site:
        found["site"] = clean(site)[:80]
    if found["under_probe"]:
        found["pseudonym"] = ""  # no person is measured
    elif session.subject.pseudonym:
        found["pseudonym"] = clean(session.subject.pseudonym)[:80]
    return found


def _seed(stimulus: Mapping[str, Any]) -> int | None:
    played = stimulus.get("stimulus")
    seed = played.get("seed") if isinstance(played, dict) else None
    return seed if isinstance(seed, int) else None
