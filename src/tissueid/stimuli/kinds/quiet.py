"""Zero force: records disturbances and sensor noise."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field

from tissueid.language import marked
from tissueid.stimuli.base import OpenLoopKind, Stimulus, stimulus


@stimulus
class Quiet(OpenLoopKind):
    """Zero force: records disturbances and sensor noise.

    The probe rests on the tissue with its own weight, or hangs free if the device does not point down. The record shows
    pulse, respiration, hand tremor, mains hum and sensor noise.
    """

    name: ClassVar[str] = "quiet"
    title: ClassVar[str] = marked("Quiet: no force")
    test_kind: ClassVar[str] = "quiet"

    seconds: float = Field(1.5, gt=0.0, le=600.0, description=marked("Length, s"))
    sample_rate: float = Field(2000.0, gt=0.0, le=1e6, description=marked("Sample rate, Hz"))

    def build(self) -> Stimulus:
        """Build the history, shape (seconds * sample_rate,), N: zeros. The crest factor is NaN."""
        samples = max(1, round(self.seconds * self.sample_rate))
        return Stimulus(
            values=np.zeros(samples),
            sample_rate_hz=self.sample_rate,
            description=self.describe(),
            seed=0,
            crest_factor=float("nan"),
            start_value=0.0,
        )
