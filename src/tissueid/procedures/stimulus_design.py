"""Building of a stimulus, which may take long: with progress, and cancellable."""

from __future__ import annotations

import math

from tissueid.messages import Message, Verbatim
from tissueid.procedures.control import Control
from tissueid.stimuli import OpenLoopKind, Stimulus
from tissueid.stimuli.interchange import InterchangeProgress, InterchangeResult
from tissueid.stimuli.kinds.interchange import Interchange


def design_stimulus(specification: OpenLoopKind, control: Control) -> tuple[Stimulus, InterchangeResult | None]:
    """Build a stimulus; also return the interchange search if there was one.

    Raises:
        UnusableInputError: the stimulus cannot be built.
        CancelledError: it was cancelled.
    """
    specification.check_size()
    step = Message("stimulus.designing", "designing {name}", name=Verbatim(specification.name))
    control.progress(0.0, step)
    search: InterchangeResult | None = None
    if isinstance(specification, Interchange):
        first: list[InterchangeProgress] = []

        def follow(found: InterchangeProgress) -> None:
            control.check()
            first[:] = first or [found]
            control.progress(_share(first[0], found), step)

        search = specification.design(follow)
        built = specification.stimulus_from(search)
    else:
        built = specification.build()
    control.progress(1.0, step)
    return built, search


def _share(first: InterchangeProgress, step: InterchangeProgress) -> float:
    """Return the completed share of a search: of the decades of error, or of the allowed swaps."""
    tried = step.tried / step.max_trials
    if not first.error > step.tolerance:
        return tried
    fallen = math.log(first.error / step.error) / math.log(first.error / step.tolerance)
    return min(max(fallen, tried), 1.0)
