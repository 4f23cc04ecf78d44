"""A test and its analyses, and what several figures and pages share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from tissueid.analysis import Analysis
from tissueid.analysis.curves.validation import Prediction
from tissueid.identification.base import Model
from tissueid.identification.engines.spectral import SpectralModel
from tissueid.reports.figures.registry import Subject
from tissueid.reports.page import surface_of
from tissueid.sessions import Session, Test


@dataclass(frozen=True)
class Material:
    """A test, its analyses, and what several figures share."""

    session: Session
    test: Test
    analyses: Mapping[str, Analysis]
    predictions: tuple[Prediction, ...]
    refused: Mapping[str, str] = field(default_factory=dict)
    """Engines that could not use the test, and why."""

    @property
    def spectra(self) -> SpectralModel | None:
        """The spectra, when that engine was run."""
        return next((a.model for a in self.analyses.values() if isinstance(a.model, SpectralModel)), None)

    @property
    def subjects(self) -> list[Subject[Model]]:
        """The models, to be drawn."""
        surface = surface_of(self.test)
        return [Subject(name, a.model, a, surface) for name, a in self.analyses.items()]

    @property
    def any(self) -> Analysis | None:
        """Any analysis, for what all of them share."""
        return next(iter(self.analyses.values()), None)

    @property
    def held_out_s(self) -> tuple[float, float] | None:
        """When the held-out part begins and ends, if it is a part of this test."""
        analysis = self.any
        if analysis is None or analysis.held_out_record is not analysis.record:
            return None
        start = round(self.test.preload_s * self.test.sample_rate_hz)
        first, end, _ = analysis.held_out.indices(len(analysis.record))
        return (start + first) / self.test.sample_rate_hz, (start + end) / self.test.sample_rate_hz
