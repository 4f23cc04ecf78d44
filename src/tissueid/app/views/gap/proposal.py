"""The next experiment as the page offers it: what it is for, and how it is done."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import count, pairwise
from typing import Any

from tissueid.app.words import sentence
from tissueid.core_words import said_by_core
from tissueid.gap.diagnosis import Diagnosis
from tissueid.gap.menu import menu
from tissueid.gap.next_experiment import odds
from tissueid.language import _
from tissueid.sessions import Session
from tissueid.wording import clean

_BY_FORM = ("smaller_amplitude", "larger_amplitude", "shallower", "deeper")
"""Tests of the menu that the form of the guided test can be filled in for."""
_OPTIONS = {"--min-force": "min_force_n", "--max-force": "max_force_n", "--seconds": "seconds"}


@dataclass(frozen=True)
class Proposal:
    """A test that would tell the rivals apart.

    ``gains`` are the title of every test on the menu, its expected gain (nats) and the odds that this amounts to, best
    first. ``fields`` are what the form of the guided test is filled in with, None where the form has no such test.
    """

    title: str
    why: str
    gains: tuple[tuple[str, float, str], ...]
    fields: Mapping[str, Any] | None
    by_hand: str


def proposal_of(found: Diagnosis, session: Session) -> Proposal | None:
    """What a diagnosis would have measured next; None where nothing is in doubt, or nothing would help."""
    step = found.next_experiment
    if step is None:
        return None
    words = {item.kind: sentence(said_by_core(item.words)).rstrip(".") for item in menu(found.observed)}
    gains = sorted((step.gains or {step.kind: step.gain_nats}).items(), key=lambda item: -item[1])
    title = words.get(step.kind, step.kind.replace("_", " ").capitalize())
    fields = _fields(step.command_line, session) if step.kind in _BY_FORM and step.command_line else None
    return Proposal(
        title,
        sentence(said_by_core(step.why.rstrip("."))),
        tuple((words.get(kind, kind.replace("_", " ").capitalize()), gain, odds(gain)) for kind, gain in gains),
        fields,
        "" if fields is not None else _by_hand(title),
    )


def _by_hand(title: str) -> str:
    return _(
        "By hand: {title}. The form on the page Measure has no such test: have it recorded from the command line, "
        "which the answer for scripts (Export JSON…) gives, or with the instrument's own program. Then diagnose that "
        "session."
    ).format(title=title)


def _fields(command_line: str, session: Session) -> dict[str, Any]:
    given = dict(pairwise(shlex.split(command_line)))
    found: dict[str, Any] = {ours: float(given[option]) for option, ours in _OPTIONS.items() if option in given}
    found["distribution"] = given.get("--distribution", "uniform")
    used = {_seed(test.stimulus) for test in session.tests}
    found["seed"] = next(seed for seed in count(1) if seed not in used)
    site = next((test.site for test in session.tests if test.site), "")
    if site:
        found["site"] = clean(site)[:80]
    if session.subject.pseudonym:
        found["pseudonym"] = clean(session.subject.pseudonym)[:80]
    return found


def _seed(stimulus: Mapping[str, Any]) -> int | None:
    played = stimulus.get("stimulus")
    seed = played.get("seed") if isinstance(played, dict) else None
    return seed if isinstance(seed, int) else None
