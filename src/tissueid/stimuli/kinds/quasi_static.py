"""Slow histories of force: none, a ramp, and steps with holds."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field, model_validator

from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.stimuli.base import Array, OpenLoopKind, Ranged, Stimulus, crest_factor, stimulus


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


RAMP_SECONDS = 4.5
"""Default length, s."""
_MIN_RAMP_SAMPLES = 4


@stimulus
class SlowRamp(Ranged):
    """Slow ramp from the lowest to the highest force and back: static force-depth curve and its hysteresis loop.

    Inertia and viscous forces are negligible: loading and unloading show stiffness, and their difference friction or
    hysteresis. It begins and ends at the lowest force, and its preload is held there.
    """

    name: ClassVar[str] = "slow_ramp"
    title: ClassVar[str] = marked("Slow ramp")
    test_kind: ClassVar[str] = "slow_ramp"

    seconds: float = Field(RAMP_SECONDS, gt=0.0, le=600.0, description=marked("Total length of rise and fall, s"))
    sample_rate: float = Field(2000.0, gt=0.0, le=1e6, description=marked("Sample rate, Hz"))

    @model_validator(mode="after")
    def _check_length(self) -> SlowRamp:
        if round(self.seconds * self.sample_rate) < _MIN_RAMP_SAMPLES:
            raise UnusableInputError(
                "slow_ramp.short", "a ramp needs at least {least} samples: lengthen it", least=_MIN_RAMP_SAMPLES
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


STEPS_SECONDS, RISE_S = 4.0, 0.01
LEVELS = (0.0, 1.0, 0.5, 0.0)
"""Levels of the holds, relative to the range, in order; all holds have the same length."""


@stimulus
class StepHold(Ranged):
    """Steps with holds: from the lowest to the highest force, halfway back, and back; or cycles of load and release.

    Creep, relaxation and drift appear during the holds. With ``cycles``, the force returns in one step, as the
    readings of suction probes need it (docs/readings.md). The steps are raised cosines of ``rise_s``, because sharp
    edges are painful (Chen 2010, 3.1.1). It begins and ends at the lowest force, and its preload is held there.
    """

    name: ClassVar[str] = "step_hold"
    title: ClassVar[str] = marked("Steps with holds")
    test_kind: ClassVar[str] = "step_hold"

    seconds: float = Field(STEPS_SECONDS, gt=0.0, le=600.0, description=marked("Total length of all holds, s"))
    rise_s: float = Field(RISE_S, ge=0.002, le=10.0, description=marked("Rise time of each step, s"))
    sample_rate: float = Field(2000.0, gt=0.0, le=1e6, description=marked("Sample rate, Hz"))
    cycles: int = Field(
        0,
        ge=0,
        le=50,
        description=marked("Cycles of a step up and a full release, as suction probes play; 0: up, halfway back, back"),
    )

    @property
    def levels(self) -> tuple[float, ...]:
        """Levels of the holds, relative to the range, in order."""
        return (0.0, *((1.0, 0.0) * self.cycles)) if self.cycles else LEVELS

    @model_validator(mode="after")
    def _check_hold_length(self) -> StepHold:
        hold_s = self.seconds / len(self.levels)
        if self.rise_s > hold_s:
            raise UnusableInputError(
                "step_hold.rise",
                "a rise of {rise_s:g} s does not fit into a hold of {hold_s:g} s: increase seconds or shorten rise_s",
                rise_s=self.rise_s,
                hold_s=hold_s,
            )
        if hold_s * self.sample_rate < 1.0:
            raise UnusableInputError("step_hold.short", "each hold needs at least one sample: increase seconds")
        return self

    def planned_samples(self) -> int:
        """Return the number of samples of all holds."""
        return len(self.levels) * round(self.seconds / len(self.levels) * self.sample_rate)

    def build(self) -> Stimulus:
        """Build the history, holds of equal length, N or V."""
        low, high, unit = self.span
        hold = self.planned_samples() // len(self.levels)
        values = low + (high - low) * steps(hold, self.rise_s * self.sample_rate, self.levels)
        return Stimulus(
            values=values,
            sample_rate_hz=self.sample_rate,
            description=self.describe(),
            seed=0,
            crest_factor=crest_factor(values),
            unit=unit,
            start_value=low,
        )


def steps(hold: int, rise: float, levels: tuple[float, ...] = LEVELS) -> Array:
    """Return levels, each for ``hold`` samples, shape (levels hold,), joined by raised cosines of ``rise`` samples."""
    wanted = np.repeat(levels, hold)
    before = np.repeat((levels[0], *levels[:-1]), hold)
    since = np.tile(np.arange(1, hold + 1), len(levels))
    share = 0.5 * (1.0 - np.cos(np.pi * np.minimum(since / max(rise, 1.0), 1.0)))
    return np.asarray(before + (wanted - before) * share, dtype=np.float64)
