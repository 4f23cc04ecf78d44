"""One diagnosis, off the window's thread: what is asked for, the work, and what comes of it."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from tissueid.app.views.gap.apart import Step, done_apart
from tissueid.errors import UnusableInputError
from tissueid.language import ENGLISH, _, marked, speak

if TYPE_CHECKING:
    from tissueid.app.views.gap.story import Story
    from tissueid.gap.diagnosis import Diagnosis
    from tissueid.gap.search import Work
    from tissueid.gap.workers import Crew
    from tissueid.instrument.twin_file import TwinFile

WORDS: Mapping[Work, str] = {
    "baseline": marked("Fitting the baseline twin"),
    "screening": marked("Looking at every known effect"),
    "likeliest candidates": marked("Fitting the likeliest effects"),
    "candidates": marked("Fitting the other effects"),
    "leading candidates": marked("Fitting the leading effects to the end"),
    "further starting points": marked("Fitting from further starting points"),
    "further candidates": marked("Fitting further effects to the end"),
    "near relations": marked("Fitting near relations of what leads"),
    "pairs": marked("Fitting pairs of effects"),
    "leading pairs": marked("Fitting the leading pairs to the end"),
    "members of the pair": marked("Fitting each half of the best pair"),
    "further pairs": marked("Fitting further pairs of effects"),
    "further leading pairs": marked("Fitting further pairs to the end"),
}
"""What the search is busy with, as the page says it."""
_ENDS: frozenset[Work] = frozenset({"leading candidates", "near relations", "leading pairs", "further leading pairs"})
_LAST = marked("Working out where, which and how far")


@dataclass(frozen=True)
class Asked:
    """What is to be diagnosed; without a ``twin`` from the nominal one. ``fit`` and ``check`` number tests.

    ``language`` is that in which the story is told.
    """

    session: Path
    twin: Path | None = None
    fit: tuple[int, ...] = ()
    check: tuple[int, ...] = ()
    language: str = ENGLISH


@dataclass(frozen=True)
class Result:
    """A diagnosis with what it was asked of; ``story`` is what the page shows of it.

    Of all fits only the baseline's and the best one's are kept: the others take a hundred megabytes.
    """

    asked: Asked
    session_id: str
    site: str
    twin: TwinFile | None
    diagnosis: Diagnosis
    story: Story


def numbers_of_tests(text: str, what: str) -> tuple[int, ...]:
    """Numbers as a person types them, with commas or blanks between.

    Raises:
        UnusableInputError: something else stands there.
    """
    try:
        return tuple(int(part) for part in text.replace(",", " ").split())
    except ValueError:
        raise UnusableInputError(
            _("{what}: give numbers of tests with commas between them, not {text!r}").format(what=what, text=text[:40])
        ) from None


def run(asked: Asked, step: Step, cancelled: Callable[[], bool], *, apart: bool) -> Result | None:
    """Diagnose a session, with ``apart`` in other processes; None where it was cancelled.

    Raises:
        UnusableInputError: the session, the twin or the numbers of tests cannot be used.
    """
    step(marked("Starting"), 0, 0)
    if apart:
        return done_apart(functools.partial(_diagnosed, asked), step, cancelled)
    from tissueid.gap.fitting import Cancelled
    from tissueid.gap.workers import Alone

    try:
        return _diagnosed(asked, step, Alone(), cancelled)
    except Cancelled:
        return None


def _diagnosed(asked: Asked, step: Step, crew: Crew, cancelled: Callable[[], bool]) -> Result:
    # Imported here and not above: the window should not wait for what only this needs.
    from tissueid.app.views.gap.story import story_of
    from tissueid.gap import diagnose, observe
    from tissueid.gap.named import believing
    from tissueid.gap.search import Found, Progress
    from tissueid.instrument.twin_file import read_twin
    from tissueid.sessions import read_session

    speak(asked.language)  # in another process nobody has yet

    def told(progress: Progress) -> None:
        over = progress.what in _ENDS and progress.done == progress.total
        step(_LAST if over else WORDS[progress.what], progress.done, progress.total)

    step(marked("Reading the session"), 0, 0)
    twin = None if asked.twin is None else read_twin(asked.twin)
    session = read_session(asked.session)
    observed = observe(session, asked.fit, asked.check)
    known: tuple[str, ...] = ()
    if twin is not None:
        observed, known = believing(observed, twin.twin), twin.twin.effects
    found = diagnose(observed, crew, known=known, progress=told, cancelled=cancelled)
    found = replace(found, found=Found(found.found.baseline, (), ()))
    sites = dict.fromkeys(test.site for test in session.tests if test.site)
    return Result(asked, session.session_id, next(iter(sites), ""), twin, found, story_of(found, session))
