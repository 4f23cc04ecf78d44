"""Stimulus of a test as selected on the command line and in the window."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tissueid.acquisition.stimulus_file import load_stimulus
from tissueid.errors import UnusableInputError
from tissueid.messages import Message
from tissueid.stimuli.base import OpenLoopKind, Stimulus, StimulusKind, parse_description, with_preload
from tissueid.stimuli.feedback import FeedbackKind
from tissueid.stimuli.kinds.noise import Noise

FIXTURES = ("spring", "free_air")
"""Kinds of test in which the probe is not on tissue, as stored in a session."""
PRELOAD_S = 0.5
"""Default length of the preload, s, in which the tissue settles at the mean load (thesis 7.1.1)."""


@dataclass(frozen=True, kw_only=True)
class NoiseChoice:
    """Noise over a range of force, N. The defaults keep the probe on the skin throughout."""

    distribution: str = "gaussian"
    min_force_n: float = 0.5
    max_force_n: float = 10.5
    seconds: float = 4.0
    seed: int = 1

    def stimulus(self, sample_rate_hz: float) -> Stimulus:
        """Return the stimulus with its preload.

        Raises:
            UnusableInputError: the values are invalid.
        """
        return with_preload(Noise.from_options(self.noise_options(sample_rate_hz)).build(), PRELOAD_S)

    def noise_options(self, sample_rate_hz: float) -> dict[str, float | str]:
        """Return the values under the option names of the kinds of stimulus, SI."""
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
    """Return the stimulus of a specification with its preload, or the specification itself if it needs feedback.

    Raises:
        UnusableInputError: it is too large, or can neither be built nor generated during a test.
    """
    if isinstance(specification, FeedbackKind):
        return specification
    if not isinstance(specification, OpenLoopKind):
        raise UnusableInputError(
            Message("stimulus.not_playable", "the stimulus '{name}' cannot be played", name=specification.name)
        )
    specification.check_size()
    return with_preload(build(specification), PRELOAD_S)


def playable_file(path: Path) -> Stimulus | FeedbackKind:
    """Return a saved stimulus; adds a preload if it has none.

    Raises:
        UnusableInputError: the file cannot be read, or contains no stimulus that this version can build.
    """
    loaded = load_stimulus(path)
    if isinstance(loaded, FeedbackKind) or loaded.preload_s > 0.0:
        return loaded
    return with_preload(loaded, PRELOAD_S)


def test_kind(stimulus: Stimulus | FeedbackKind) -> str:
    """Return the kind of a test on tissue with this stimulus, as stored in a session."""
    kind = stimulus if isinstance(stimulus, FeedbackKind) else parse_description(stimulus.description)[0]
    return kind.test_kind


test_kind.__test__ = False  # type: ignore[attr-defined]  # keeps pytest from collecting it
