"""What a test plays, as people choose it: on the command line and in the window."""

from __future__ import annotations

from dataclasses import dataclass

from tissueid.stimuli.base import Stimulus, guided
from tissueid.stimuli.kinds.noise import Noise

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
        options = {
            "distribution": self.distribution,
            "force_min_n": self.min_force_n,
            "force_max_n": self.max_force_n,
            "seconds": self.seconds,
            "seed": self.seed,
            "sample_rate": sample_rate_hz,
        }
        return guided(Noise.from_options(options).build(), PRELOAD_S)
