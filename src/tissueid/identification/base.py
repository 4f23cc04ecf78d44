"""The interface of every identification engine: a frozen specification, a frozen model, a frozen report.

An engine is a declaration of options; ``fit`` turns a record into a model. Nothing is half fitted, nothing
changes afterwards, and nothing here reads a clock or a file: the caller who timed a fit adds the seconds with
:meth:`Model.with_report`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from tissueid.errors import UnusableInputError
from tissueid.identification.depth_profile import DepthProfile
from tissueid.identification.family import Family
from tissueid.options import refused
from tissueid.records import Estimate, Record

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SIGNIFICANT = 0.05
"""Chance of an unrelated simulation doing as well on held-out data beyond which a fit does not count as predicting."""

PREDICTS_NOTHING = "the model predicts nothing of data that it was not fitted to: its parameters are no results"
"""Warning in the report of a fit that ``predicts_nothing``."""


def _finite_or_none(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


@dataclass(frozen=True)
class FitReport:
    """What a fit says about itself.

    ``vaf_percent`` is the variance accounted for (Eq. 3.13) of the free-run simulation on the fitted samples;
    ``vaf_validation_percent`` the same on samples that were not fitted; ``vaf_scheduled_percent`` is filled only
    by engines that can be driven by the measured output. ``validation_p_value`` is the chance that a simulation
    unrelated to the measurement follows it as well on those samples. ``findings`` says in words what the fit
    found, ``warnings`` what to know before trusting it. ``details`` holds further figures of one engine, such as the
    condition number. Figures that cannot be had are None.
    """

    engine: str
    options: dict[str, Any]
    n_samples: int
    n_parameters: int
    vaf_percent: float
    vaf_validation_percent: float | None = None
    validation_p_value: float | None = None
    vaf_scheduled_percent: float | None = None
    aic: float | None = None
    aicc: float | None = None
    parameters: dict[str, Estimate] = field(default_factory=dict)
    seconds: float | None = None
    warnings: tuple[str, ...] = ()
    findings: tuple[str, ...] = ()
    details: dict[str, float] = field(default_factory=dict)

    @property
    def predicts_nothing(self) -> bool:
        """Whether the free run tells nothing of held-out data: its VAF is 0 or less, or not significant."""
        found, p_value = self.vaf_validation_percent, self.validation_p_value
        if found is None or math.isnan(found):
            return False
        return found <= 0.0 or (p_value is not None and p_value > SIGNIFICANT)

    @property
    def reportable_parameters(self) -> dict[str, Estimate]:
        """The parameters, or none where the fit predicts nothing: those are no results."""
        return {} if self.predicts_nothing else self.parameters

    def as_dict(self) -> dict[str, Any]:
        """Return the keys of ``tissueid identify --json``: SI units, and None for what is not finite."""
        return {
            "engine": self.engine,
            "options": dict(self.options),
            "n_samples": self.n_samples,
            "n_parameters": self.n_parameters,
            "vaf_percent": _finite_or_none(self.vaf_percent),
            "vaf_validation_percent": _finite_or_none(self.vaf_validation_percent),
            "validation_p_value": _finite_or_none(self.validation_p_value),
            "predicts_nothing": self.predicts_nothing,
            "vaf_scheduled_percent": _finite_or_none(self.vaf_scheduled_percent),
            "aicc": _finite_or_none(self.aicc),
            "parameters": {
                name: {"value": _finite_or_none(estimate.value), "std": _finite_or_none(estimate.std)}
                for name, estimate in self.parameters.items()
            },
            "seconds": _finite_or_none(self.seconds),
            "warnings": list(self.warnings),
            "findings": list(self.findings),
            "details": {name: _finite_or_none(value) for name, value in self.details.items()},
        }


@dataclass(frozen=True, eq=False)
class Model(ABC):
    """What a fit leaves: a system that can be simulated.

    ``memory_samples`` is how many input samples, the present one included, an output sample depends on. Scores
    leave out the ``memory_samples - 1`` outputs after the start of a record and after every gap in its input,
    because there the model is asked about an input that nobody recorded.
    """

    report: FitReport
    sample_rate_hz: float
    memory_samples: int

    @abstractmethod
    def simulate(self, u: Array) -> Array:
        """Simulate free-run: input of shape (n,) in, output of shape (n,) out, and nothing else seen.

        The system is taken to rest at the input's operating point before the first sample. Where the memory
        holds an input that is NaN, the output is NaN.
        """

    def simulate_scheduled(self, record: Record) -> Array | None:
        """Simulate with the measured output as the schedule, shape (n,); None for models without a schedule."""
        return None

    def depth_profile(self) -> DepthProfile | None:
        """Mass, damping and stiffness against depth, None for models that hold no depth."""
        return None

    def predict(self, record: Record, horizon: int) -> Array:
        """Predict each output from the input up to now and the output up to ``horizon`` samples ago.

        Models of this kind hold that what they do not explain is noise added to the output and unrelated to
        its own past (output error). Under that belief past outputs tell nothing that the input did not, and the
        best prediction is the simulation, whatever the horizon. It is returned as such: a smaller error at short
        horizons would need a noise model, which an engine that has one gives by overriding this method.

        Raises:
            UnusableInputError: the horizon is less than one sample, or the record has another sample rate.
        """
        check_horizon(horizon)
        self.check_rate(record)
        return self.simulate(record.input)

    def residuals(self, record: Record) -> Array:
        """Measured output less free-run simulation, shape (n,); NaN where either is unknown."""
        self.check_rate(record)
        return record.output - self.simulate(record.input)

    def with_report(self, **changes: Any) -> Self:
        """Return the same model with fields of its report replaced, for example ``seconds``."""
        return replace(self, report=replace(self.report, **changes))

    def with_validation(self, vaf_percent: float, p_value: float, scheduled_percent: float | None = None) -> Self:
        """Return the same model with its scores on held-out samples, and a warning where it predicts nothing there."""
        report = replace(
            self.report,
            vaf_validation_percent=vaf_percent,
            validation_p_value=p_value,
            vaf_scheduled_percent=scheduled_percent,
        )
        warnings = tuple(warning for warning in report.warnings if warning != PREDICTS_NOTHING)
        if report.predicts_nothing:
            warnings = (PREDICTS_NOTHING, *warnings)
        return replace(self, report=replace(report, warnings=warnings))

    def check_rate(self, record: Record) -> None:
        """Refuse a record that was not sampled as the fitted one was.

        Raises:
            UnusableInputError: the sample rates differ by more than one part in a million.
        """
        if not math.isclose(record.sample_rate_hz, self.sample_rate_hz, rel_tol=1e-6):
            raise UnusableInputError(
                f"the model was fitted at {self.sample_rate_hz:g} Hz and cannot be run at "
                f"{record.sample_rate_hz:g} Hz: resample the record"
            )


class Engine(BaseModel, ABC):
    """The specification of a fit: options with bounds, which double as the limits of a form."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    name: ClassVar[str]
    family: ClassVar[Family] = Family.OTHER

    @abstractmethod
    def fit(self, record: Record, fit_part: slice | None = None) -> Model:
        """Fit the engine to a record, or to a contiguous part of it, and return the model.

        Raises:
            UnusableInputError: the record cannot carry this fit; the line says why.
        """

    @classmethod
    def from_options(cls, options: Mapping[str, Any]) -> Self:
        """Build the specification from named options, as a command line or a form gives them.

        Raises:
            UnusableInputError: an option is unknown or out of its bounds.
        """
        try:
            return cls(**options)
        except ValidationError as error:
            raise UnusableInputError(refused(f"engine {cls.name}", cls.model_fields, error)) from error

    def options(self) -> dict[str, Any]:
        """Return the options as plain values, fit for JSON."""
        return self.model_dump(mode="json")


def check_horizon(horizon: int) -> None:
    """Refuse a prediction horizon below one sample.

    Raises:
        UnusableInputError: ``horizon`` is less than 1.
    """
    if horizon < 1:
        raise UnusableInputError(f"the prediction horizon must be at least one sample, not {horizon}")
