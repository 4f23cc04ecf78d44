"""Slow force ramp up and down: quasi-static loading curve."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field, model_validator

from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.stimuli.base import Array, Ranged, Stimulus, crest_factor, stimulus

SECONDS = 4.5
"""Default length, s."""
_MIN_SAMPLES = 4


@stimulus
class SlowRamp(Ranged):
    """Slow ramp from the lowest to the highest force and back: static force-depth curve and its hysteresis loop.

    Inertia and viscous forces are negligible: loading and unloading show stiffness, and their difference friction or
    hysteresis. It begins and ends at the lowest force, and its preload is held there.
    """

    name: ClassVar[str] = "slow_ramp"
    title: ClassVar[str] = marked("Slow ramp")
    test_kind: ClassVar[str] = "slow_ramp"

    seconds: float = Field(SECONDS, gt=0.0, le=600.0, description=marked("Total length of rise and fall, s"))
    sample_rate: float = Field(2000.0, gt=0.0, le=1e6, description=marked("Sample rate, Hz"))

    @model_validator(mode="after")
    def _check_length(self) -> SlowRamp:
        if round(self.seconds * self.sample_rate) < _MIN_SAMPLES:
            raise UnusableInputError(
                "slow_ramp.short", "a ramp needs at least {least} samples: lengthen it", least=_MIN_SAMPLES
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
            start_value=low,
        )


def ramp(samples: int) -> Array:
    """Return a linear rise from 0 to 1 and back, shape (samples,)."""
    up = np.linspace(0.0, 1.0, samples - samples // 2)
    return np.concatenate([up, up[::-1][samples % 2 :]])
