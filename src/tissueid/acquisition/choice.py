"""What a test plays, as people choose it: on the command line and in the window."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tissueid.acquisition.stimulus_file import load_stimulus
from tissueid.errors import UnusableInputError
from tissueid.stimuli.base import OpenLoopKind, Stimulus, StimulusKind, guided, specified
from tissueid.stimuli.feedback import FeedbackKind
from tissueid.stimuli.kinds.noise import Noise

FIXTURES = ("spring", "free_air")
"""What may be under the probe in place of tissue: kinds of test, as a session has them."""
PRELOAD_S = 0.5
"""Thesis 7.1.1: the mean load is held this long to acclimate the tissue."""


@dataclass(frozen=True, kw_only=True)
class NoiseChoice:
    """Noise over a range of force. The defaults keep the probe on the skin throughout."""

    distribution: str = "gaussian"
    min_force_n: float = 0.5
    max_force_n: float = 10.5
    seconds: float = 4.0
    seed: int = 1

    def stimulus(self, sample_rate_hz: float) -> Stimulus:
        """The stimulus with its preload.

        Raises:
            UnusableInputError: the choices do not make one.
        """
        return guided(Noise.from_options(self.noise_options(sample_rate_hz)).build(), PRELOAD_S)

    def noise_options(self, sample_rate_hz: float) -> dict[str, float | str]:
        """Return the choices by the names that kinds of stimulus have for them, SI."""
        return {
            "distribution": self.distribution,
            "force_min_n": self.min_force_n,
            "force_max_n": self.max_force_n,
            "seconds": self.seconds,
            "seed": self.seed,
            "sample_rate": sample_rate_hz,
        }


def playable(
    specification: StimulusKind, build: Callable[[OpenLoopKind], Stimulus] = lambda kind: kind.build()
) -> Stimulus | FeedbackKind:
    """Return what a test plays by a specification: built by ``build`` with its preload, or generated during the test.

    Raises:
        UnusableInputError: it is too large, or can neither be built nor generated.
    """
    if isinstance(specification, FeedbackKind):
        return specification
    if not isinstance(specification, OpenLoopKind):
        raise UnusableInputError(f"the stimulus {specification.name!r} can neither be built nor generated")
    specification.check_size()
    return guided(build(specification), PRELOAD_S)


def playable_file(path: Path) -> Stimulus | FeedbackKind:
    """Return a saved stimulus as a test plays it, with a preload where it has none.

    Raises:
        UnusableInputError: the file cannot be read, or does not hold a stimulus that this version builds.
    """
    loaded = load_stimulus(path)
    if isinstance(loaded, FeedbackKind) or loaded.preload_s > 0.0:
        return loaded
    return guided(loaded, PRELOAD_S)


def test_kind(stimulus: Stimulus | FeedbackKind) -> str:
    """Return the kind of test that a stimulus makes on tissue, as a session has it."""
    kind = stimulus if isinstance(stimulus, FeedbackKind) else specified(stimulus.description)[0]
    return kind.test_kind


test_kind.__test__ = False  # type: ignore[attr-defined]  # not a test case, whatever pytest takes the name for
