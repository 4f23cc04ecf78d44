"""Stimuli from files: waveforms of any samples, and saved stimuli at another scale and offset (Chen 2010, 2.4.2)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar, Self

import numpy as np
from pydantic import Field, model_validator

from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.stimuli.base import (
    GUIDED,
    MAX_SAMPLES,
    MIN_SPAN,
    Array,
    OpenLoopKind,
    Stimulus,
    StimulusKind,
    Unit,
    crest_factor,
    parse_description,
    stimulus,
)
from tissueid.test_settings import LARGEST_OFFSET, LARGEST_SCALE


@stimulus
class Waveform(OpenLoopKind):
    """Samples from a file, times ``scale``, plus ``offset``.

    A description holds the name of the file and the SHA-256 of its samples, not the samples: a session has these as its
    recorded command. It is made by :func:`from_samples`.
    """

    name: ClassVar[str] = "waveform"
    title: ClassVar[str] = marked("Waveform from a file")
    listed: ClassVar[bool] = False

    file: str = Field(max_length=255, description=marked("Name of the file"))
    sha256: str = Field(
        pattern="^[0-9a-f]{64}$", description=marked("SHA-256 of the samples as little-endian float64, before scaling")
    )
    samples: int = Field(ge=1, le=MAX_SAMPLES, description=marked("Number of samples"))
    unit: Unit = Field("N", description=marked("Unit: N or V"))
    scale: float = Field(1.0, ge=-LARGEST_SCALE, le=LARGEST_SCALE, description=marked("Factor of all samples"))
    offset: float = Field(
        0.0, ge=-LARGEST_OFFSET, le=LARGEST_OFFSET, description=marked("Added to all samples after the factor, N or V")
    )
    sample_rate: float = Field(2000.0, gt=0.0, le=1e6, description=marked("Sample rate, Hz"))

    def planned_samples(self) -> int:
        """Return the number of samples."""
        return self.samples

    def build(self) -> Stimulus:
        """Refuse: the samples are in the file.

        Raises:
            UnusableInputError: always.
        """
        raise UnusableInputError(
            "stimulus.waveform_samples",
            "the samples of the waveform {file} are not in its description: read that file, or use the recorded "
            "command",
            file=self.file,
        )

    def from_samples(self, values: Array) -> Stimulus:
        """Return the stimulus of the samples of the file (n,), at ``sample_rate``."""
        return Stimulus(
            values=self.scale * values + self.offset,
            sample_rate_hz=self.sample_rate,
            description=self.describe(),
            seed=0,
            crest_factor=_crest(values),
            unit=self.unit,
            start_value=float(self.scale * values[0] + self.offset),
        )


@stimulus
class Scaled(OpenLoopKind):
    """Another stimulus, times ``scale``, plus ``offset``."""

    name: ClassVar[str] = "scaled"
    title: ClassVar[str] = marked("Saved stimulus, scaled")
    listed: ClassVar[bool] = False

    stimulus: dict[str, Any] = Field(description=marked("Description of the other stimulus, without its preload"))
    scale: float = Field(1.0, ge=-LARGEST_SCALE, le=LARGEST_SCALE, description=marked("Factor of all samples"))
    offset: float = Field(
        0.0, ge=-LARGEST_OFFSET, le=LARGEST_OFFSET, description=marked("Added to all samples after the factor, N or V")
    )

    @model_validator(mode="after")
    def _check_inner(self) -> Self:
        if self.stimulus.get("type") in (GUIDED, self.name):
            raise UnusableInputError(
                "scaled.nested", "a scaled stimulus cannot contain a preload or another scaled stimulus"
            )
        if not isinstance(self.inner, OpenLoopKind):
            raise UnusableInputError(
                "scaled.feedback",
                "the stimulus '{name}' is generated during the test and cannot be scaled: change its range of force",
                name=self.inner.name,
            )
        return self

    @property
    def inner(self) -> StimulusKind:
        """Specification of the other stimulus.

        Raises:
            UnusableInputError: its description is not valid.
        """
        return parse_description(self.stimulus)[0]

    def planned_samples(self) -> int | None:
        """Return the number of samples of the other stimulus."""
        return self.inner.planned_samples() if isinstance(self.inner, OpenLoopKind) else None

    def build(self) -> Stimulus:
        """Build the other stimulus and scale it.

        Raises:
            UnusableInputError: it cannot be built.
        """
        assert isinstance(self.inner, OpenLoopKind)
        built = self.inner.build()
        start = built.start_value
        return replace(
            built,
            values=self.scale * built.values + self.offset,
            description=self.describe(),
            start_value=None if start is None else self.scale * start + self.offset,
        )


def _crest(values: Array) -> float:
    """Return the crest factor of values (n,); NaN for values that do not vary."""
    return crest_factor(values) if float(np.ptp(values)) > MIN_SPAN else float("nan")
