"""A slow ramp: press as if there were no mass and no damping, and let go again."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field, model_validator

from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.stimuli.base import Array, Ranged, Stimulus, crest_factor, stimulus

SECONDS = 4.5
_LEAST_SAMPLES = 4


@stimulus
class SlowRamp(Ranged):
    """A slow ramp from the least to the greatest force and back: the static law, and its loop.

    So slow, mass and damping take next to no part: what rise and fall show is stiffness, and where they differ friction
    or hysteresis. It begins and ends at its least force, and so does its preload.
    """

    name: ClassVar[str] = "slow_ramp"
    title: ClassVar[str] = marked("Slow ramp")
    test_kind: ClassVar[str] = "slow_ramp"

    seconds: float = Field(SECONDS, gt=0.0, le=600.0, description=marked("Length of rise and fall together, s"))
    sample_rate: float = Field(2000.0, gt=0.0, le=1e6, description=marked("Samples a second"))

    @model_validator(mode="after")
    def _long_enough(self) -> SlowRamp:
        if round(self.seconds * self.sample_rate) < _LEAST_SAMPLES:
            raise UnusableInputError(
                Message(
                    "slow_ramp.short",
                    "a ramp needs {least} samples or more: give it more seconds",
                    least=_LEAST_SAMPLES,
                )
            )
        return self

    def build(self) -> Stimulus:
        """Build the history, shape (seconds * sample_rate,), N or V."""
        low, high, unit = self.span
        values = low + (high - low) * ramp(round(self.seconds * self.sample_rate))
        return Stimulus(
            values=values,
            sample_rate_hz=self.sample_rate,
            description=self.describe(),
            seed=0,
            crest_factor=crest_factor(values),
            unit=unit,
            begins_at=low,
        )


def ramp(samples: int) -> Array:
    """Straight from 0 to 1 and back, shape (samples,)."""
    up = np.linspace(0.0, 1.0, samples - samples // 2)
    return np.concatenate([up, up[::-1][samples % 2 :]])
