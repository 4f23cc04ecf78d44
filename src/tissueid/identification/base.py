"""Interface of every identification engine: a frozen specification, a frozen model and a frozen report.

An engine declares its options; ``fit`` turns a record into a model. Fits read no clock and no file: the caller adds
the time of a fit by :meth:`Model.with_report`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from functools import wraps
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from tissueid.errors import UnusableInputError
from tissueid.identification.blas_threads import one_blas_thread
from tissueid.identification.depth_profile import DepthProfile
from tissueid.language import marked
from tissueid.messages import Message, stored
from tissueid.plan_options import option_error
from tissueid.records import Estimate, Record
from tissueid.stored_values import MaybeNumber, Name, Number, Texts, finite

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def vaf_percent(measured: Array, modelled: Array) -> float:
    """Return the variance accounted for, % (Eq. 3.13), over the samples where both arrays (n,) are finite.

    Negative if the error varies more than the measurement. NaN with fewer than two samples, or if the measurement is
    constant.
    """
    used = np.isfinite(measured) & np.isfinite(modelled)
    if used.sum() < 2:
        return float("nan")
    variance = float(np.var(measured[used]))
    if variance == 0.0:
        return float("nan")
    return 100.0 * (1.0 - float(np.var(measured[used] - modelled[used])) / variance)


def aic(residuals: Array, n_parameters: float) -> float:
    """Return Akaike's information criterion of Gaussian residuals (n,) (Eqs. 3.14-3.15); NaN are ignored."""
    finite = residuals[np.isfinite(residuals)]
    if finite.size == 0:
        return float("nan")
    rss = float(finite @ finite)
    if rss == 0.0:
        return float("-inf")
    return 2.0 * n_parameters + finite.size * (math.log(2.0 * math.pi * rss / finite.size) + 1.0)


def aicc(residuals: Array, n_parameters: float) -> float:
    """Return AIC with the second-order correction for few samples (Eq. 3.16); NaN if n <= k + 1."""
    n = int(np.isfinite(residuals).sum())
    if n <= n_parameters + 1:
        return float("nan")
    return aic(residuals, n_parameters) + 2.0 * n_parameters * (n_parameters + 1) / (n - n_parameters - 1)


class Family(StrEnum):
    """Kind of model that an engine fits, in order of complexity; of equally good models the simpler is preferred.

    An engine declares its family by ``family: ClassVar[Family]``; the default is ``OTHER``, the last.
    """

    LINEAR = marked("linear")
    STATIC = marked("linear blocks and static nonlinearities")
    PARAMETRIC = marked("parameters that follow depth")
    DEPTH = marked("depth partitions")
    DIRECTION = marked("depth and direction partitions")
    KERNELS = marked("Volterra kernels")
    OTHER = marked("other")

    @property
    def rank(self) -> int:
        """Position in the order of complexity: 0 is the simplest."""
        return list(Family).index(self)

    @property
    def interpretability(self) -> str:
        """How well results of different tests can be compared as numbers (Chen 2010, Table 8.1)."""
        if self is Family.KERNELS:
            return marked("poor")
        return marked("not rated") if self is Family.OTHER else marked("good")


SIGNIFICANT = 0.05
"""Largest p-value of the held-out score at which a fit counts as predictive."""

PREDICTS_NOTHING = Message(
    "engine.predicts_nothing",
    "the model predicts nothing of held-out data: its parameters are no results",
)
"""Warning in the report of a fit that ``predicts_nothing``."""

NEGATIVE_MASS = Message(
    "engine.negative_mass",
    "a negative mass or stiffness does not exist: the output falls as the input rises; check the signs of the two "
    "signals",
)
"""Warning of every engine with a mass; the parameters of such a fit are not compared in a study."""
_FALLS = Message("second_order.reversed", "the output falls as the input rises: check the signs of the two signals")
NOTHING_TO_PREDICT = Message(
    "engine.nothing_to_predict",
    "the held-out output does not vary above its noise: there is no held-out score",
)


@dataclass(frozen=True)
class FitReport:
    """Scores, parameters, findings and warnings of a fit.

    ``vaf_percent`` is the variance accounted for (Eq. 3.13) of the free-run simulation on the fitted samples;
    ``vaf_validation_percent`` the same on held-out samples; ``vaf_scheduled_percent`` is the held-out score with the
    measured output as the schedule, for engines that have one. ``validation_p_value`` is the probability that a
    simulation unrelated to the measurement scores as well on held-out samples. ``findings`` are results in words,
    ``warnings`` limits of their validity. ``details`` holds further figures of one engine, such as the condition
    number. ``model`` names what the engine chose among models whose parameters have other meanings: values of different
    ones are not comparable; "" where there is no such choice. Unknown figures are None.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    engine: Name
    options: Annotated[dict[Name, Any], Field(max_length=60)]
    n_samples: Annotated[int, Field(ge=0)]
    n_parameters: Annotated[int, Field(ge=0)]
    vaf_percent: Number
    vaf_validation_percent: MaybeNumber = None
    validation_p_value: MaybeNumber = None
    vaf_scheduled_percent: MaybeNumber = None
    aic: MaybeNumber = None
    aicc: MaybeNumber = None
    parameters: Annotated[dict[Name, Estimate], Field(max_length=200)] = field(default_factory=dict)
    seconds: MaybeNumber = None
    warnings: Texts = ()
    findings: Texts = ()
    details: Annotated[dict[Name, Number], Field(max_length=200)] = field(default_factory=dict)
    model: Annotated[str, Field(max_length=60)] = ""

    @property
    def predicts_nothing(self) -> bool:
        """Whether the free run fails on held-out data: its VAF is 0 or less, or not significant."""
        vaf, p_value = self.vaf_validation_percent, self.validation_p_value
        if vaf is None or math.isnan(vaf):
            return False
        return vaf <= 0.0 or (p_value is not None and p_value > SIGNIFICANT)

    @property
    def reportable_parameters(self) -> dict[str, Estimate]:
        """The parameters; empty where the fit predicts nothing."""
        return {} if self.predicts_nothing else self.parameters

    def as_dict(self) -> dict[str, Any]:
        """Return the keys of ``tissueid identify --json`` in SI units. Values that are not finite become None."""
        texts = {"warnings": self.warnings, "findings": self.findings}
        answer: dict[str, Any] = finite(
            asdict(self)
            | {"predicts_nothing": self.predicts_nothing}
            | {name: list(map(str, values)) for name, values in texts.items()}
            | {"messages": {name: list(map(stored, values)) for name, values in texts.items()}}
        )
        del answer["aic"]
        return answer


@dataclass(frozen=True, eq=False)
class Model(ABC):
    """Fitted system that can be simulated.

    ``memory_samples`` is the number of input samples, including the present one, that an output sample depends on.
    Scores exclude the ``memory_samples - 1`` outputs after the start of a record and after every gap in its input,
    because the input that they depend on was not recorded.
    """

    report: FitReport
    sample_rate_hz: float
    memory_samples: int

    @abstractmethod
    def simulate(self, u: Array) -> Array:
        """Simulate in free run: return the output (n,) for an input (n,), without the measured output.

        The system is at rest at the input's operating point before the first sample. The output is NaN where the
        memory contains an input that is NaN.
        """

    def simulate_scheduled(self, record: Record) -> Array | None:
        """Simulate with the measured output as the schedule; return (n,), or None for models without a schedule."""
        return None

    def depth_profile(self) -> DepthProfile | None:
        """Return mass, damping and stiffness against depth; None for models that do not depend on depth."""
        return None

    def predict(self, record: Record, horizon: int) -> Array:
        """Predict each output from the input up to now and the output up to ``horizon`` samples ago.

        The default is that of an output-error model: noise is added to the output and independent of its past, so the
        best prediction at any horizon is the simulation. An engine with a noise model overrides this method.

        Raises:
            UnusableInputError: the horizon is less than one sample, or the record has another sample rate.
        """
        check_horizon(horizon)
        self.check_rate(record)
        return self.simulate(record.input)

    def residuals(self, record: Record) -> Array:
        """Return measured output minus free-run simulation, (n,); NaN where either is unknown."""
        self.check_rate(record)
        return record.output - self.simulate(record.input)

    def with_report(self, **changes: Any) -> Self:
        """Return a copy with fields of its report replaced, for example ``seconds``."""
        return replace(self, report=replace(self.report, **changes))

    def with_fit_scores(self, record: Record, used: Mask, simulated: Array | None = None) -> Self:
        """Return a copy with the scores of its free run, by default simulated here, on samples (n,) of a record."""
        modelled = self.simulate(record.input) if simulated is None else simulated
        return self.with_report(**_fit_scores(record, used, modelled, self.report.n_parameters))

    def without_validation(self) -> Self:
        """Return a copy without scores on held-out samples, which do not vary above their noise, and a warning."""
        warnings = tuple(warning for warning in self.report.warnings if warning != PREDICTS_NOTHING)
        return self.with_report(
            vaf_validation_percent=None,
            validation_p_value=None,
            vaf_scheduled_percent=None,
            warnings=(NOTHING_TO_PREDICT, *warnings),
        )

    def with_validation(self, vaf_percent: float, p_value: float, scheduled_percent: float | None = None) -> Self:
        """Return a copy with its scores on held-out samples, and a warning where it predicts nothing there."""
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
        """Raise for a record with another sample rate than the fitted one.

        Raises:
            UnusableInputError: the sample rates differ by more than one part in a million.
        """
        if not math.isclose(record.sample_rate_hz, self.sample_rate_hz, rel_tol=1e-6):
            raise UnusableInputError(
                "engine.other_sample_rate",
                "the model was fitted at {fitted:g} Hz and cannot be run at {given:g} Hz: resample the record",
                fitted=self.sample_rate_hz,
                given=record.sample_rate_hz,
            )


@dataclass(frozen=True, eq=False)
class FittedCurve:
    """One curve of a plot: ``x`` and ``y`` (n,), its ``label`` in the legend; ``points`` draws points instead of a
    line.
    """

    x: Array
    y: Array
    label: str = ""
    points: bool = False


@dataclass(frozen=True)
class LineFigure:
    """A line plot that an engine declares without drawing code; reports draw it for each of its models.

    ``key`` is a short name of lower-case letters, digits and hyphens. ``curves`` returns the curves of a model and
    raises ``UnusableInputError`` if the model has none. ``group`` is the section of the page that shows the plot.
    """

    key: str
    heading: str
    alt: str
    caption: str
    x_label: str
    y_label: str
    curves: Callable[[Any], Sequence[FittedCurve]]
    group: Literal["record", "linear", "nonlinear", "validation"] = "linear"


def option(default: Any, title: str, description: str, **bounds: Any) -> Any:
    """Return an option of an engine: default, label and help in a form, and bounds (``gt``, ``le``, ...)."""
    return Field(default, title=title, description=description, **bounds)


class Engine(BaseModel, ABC):
    """Specification of a fit: options with bounds, titles and descriptions, from which forms and help are made.

    A subclass needs ``name``, ``fit`` and its options. The other declarations are optional: ``label`` is the name shown
    to users (default: ``name`` with a capital), ``title`` one sentence on what is fitted (default: the first paragraph
    of the docstring), ``family`` its kind for the recommendation. Texts in ``marked("...")`` are translated.
    ``figures`` are drawn in reports; ``in_report`` adds the engine to the standard report of a test, ``in_report_of``
    to that of a test for which it is made.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    name: ClassVar[str]
    label: ClassVar[str] = ""
    title: ClassVar[str] = ""
    family: ClassVar[Family] = Family.OTHER
    figures: ClassVar[tuple[LineFigure, ...]] = ()
    in_report: ClassVar[bool] = False

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        """Fill label and title of an engine that does not declare them; let its fits use one thread and be checked."""
        super().__pydantic_init_subclass__(**kwargs)
        if "fit" in cls.__dict__ and not getattr(cls.fit, "__isabstractmethod__", False):
            setattr(cls, "fit", _checked(cls.fit))  # noqa: B010
        name = getattr(cls, "name", "")
        if "label" not in cls.__dict__:
            cls.label = name[:1].upper() + name[1:]
        if "title" not in cls.__dict__:
            cls.title = " ".join((cls.__doc__ or "").split("\n\n")[0].split())

    @classmethod
    def in_report_of(cls, record: Record) -> bool:
        """Return whether the standard report of a test with this record includes the engine; default: ``in_report``."""
        return cls.in_report

    @abstractmethod
    def fit(self, record: Record, fit_part: slice | None = None) -> Model:
        """Fit the engine to a record, or to a contiguous part of it, and return the model.

        Raises:
            UnusableInputError: the record is not sufficient for this fit; the message gives the reason.
        """

    def for_record(self, record: Record, fit_part: slice | None) -> Self:
        """Return the specification with values from the record for options that are not given; every fit begins so."""
        return self

    def with_test_values(self, surface_position_m: float | None, weight_n: float | None) -> Self:
        """Return the specification with what the test knows about its placement, for options that are not given.

        Args:
            surface_position_m: position of the tissue surface, m; None if unknown.
            weight_n: weight of the moving part along the stroke, N into the tissue; None if unknown. The signal force
                does not include it.
        """
        return self

    def common(self, details: Sequence[Mapping[str, float]]) -> Self:
        """Return the specification with one model for many tests; itself if it leaves no choice.

        Args:
            details: those of the report of each test, fitted as specified.
        """
        return self

    @classmethod
    def from_options(cls, options: Mapping[str, Any]) -> Self:
        """Return the specification with options from a command line or a form.

        Raises:
            UnusableInputError: an option is unknown or out of its bounds.
        """
        try:
            return cls(**options)
        except ValidationError as error:
            what = Message("engine.named", "engine {name}", name=cls.name)
            raise UnusableInputError(option_error(what, cls.model_fields, error)) from error

    def options(self) -> dict[str, Any]:
        """Return the options as plain values for JSON."""
        return self.model_dump(mode="json")

    def unscored(self, n_samples: int, n_parameters: int, **fields: Any) -> FitReport:
        """Return the report of a fit before its model can be simulated; see :meth:`Model.with_fit_scores`."""
        return FitReport(self.name, self.options(), n_samples, n_parameters, math.nan, **fields)

    def report(
        self, record: Record, used: Mask, modelled: Array, n_parameters: int, *, offset: float = 0.0, **fields: Any
    ) -> FitReport:
        """Return the report of a fit.

        Args:
            record: the data.
            used: the fitted samples, (n,).
            modelled: the output of the model, (n,).
            n_parameters: number of fitted parameters.
            offset: constant to add to the modelled output.
            fields: further fields of ``FitReport``.
        """
        scores = _fit_scores(record, used, modelled, n_parameters, offset)
        return replace(self.unscored(int(used.sum()), n_parameters, **fields), **scores)


def _fit_scores(record: Record, used: Mask, modelled: Array, n_parameters: int, offset: float = 0.0) -> dict[str, Any]:
    residuals = np.where(used, record.output - modelled - offset, np.nan)
    return {
        "vaf_percent": vaf_percent(record.output[used], modelled[used]),
        "aic": aic(residuals, n_parameters),
        "aicc": aicc(residuals, n_parameters),
    }


def _with_sign_warning(model: Model) -> Model:
    """Return the model with a warning where its mass is negative or its output falls as the input rises."""
    parameters = model.report.parameters
    profile = model.depth_profile() if "mass_kg" not in parameters else None
    signed = parameters.get("mass_kg", parameters.get("stiffness_n_per_m", Estimate(math.nan))).value
    if profile is not None and np.isfinite(profile.mass).any():
        signed = float(np.nanmedian(profile.mass))
    if signed < 0.0:
        return model.with_report(warnings=(NEGATIVE_MASS, *model.report.warnings))
    if "gain" in parameters and parameters["gain"].value < 0.0:
        return model.with_report(warnings=(*model.report.warnings, _FALLS))
    return model


def _checked(fit: Callable[..., Model]) -> Callable[..., Model]:
    """Return a fit with one thread and the options of the record, whose model has the warnings of every engine."""

    @wraps(fit)
    def fitted(self: Engine, record: Record, fit_part: slice | None = None, **options: Any) -> Model:
        with one_blas_thread(), refused_if_not_computed(self.name):
            model = fit(self.for_record(record, fit_part), record, fit_part, **options)
        return _with_sign_warning(_with_parametric_warning(model)) if isinstance(model, Model) else model

    return fitted


PARAMETRIC = "vaf_parametric_percent"
"""Name of the detail of a report with the score of mass, damping and stiffness alone."""
_SHORTFALL_PERCENT, _SHORTFALL_RATIO = 0.1, 1.5
"""Difference, in %, and ratio of what they and the response leave of the output, above which they get a warning."""


def _with_parametric_warning(model: Model) -> Model:
    """Return the model with a warning if mass, damping and stiffness explain much less than the response shown."""
    report = model.report
    spare = max(report.n_samples - report.n_parameters, 1)
    unexplained = 100.0 - report.details.get(PARAMETRIC, 100.0)
    least = (100.0 - report.vaf_percent) * max(report.n_samples, 1) / spare
    if not (unexplained - least > _SHORTFALL_PERCENT and unexplained > _SHORTFALL_RATIO * least):
        return model
    warning = Message(
        "second_order.explains_less",
        "mass, damping and stiffness belong to a second-order system that explains {parametric:.2f} % of the fitted "
        "output, and the response explains {response:.2f} %: they can be biased by more than their standard deviations",
        parametric=100.0 - unexplained,
        response=report.vaf_percent,
    )
    return model.with_report(warnings=(*report.warnings, warning))


_NUMERICAL = (ArithmeticError, ValueError, MemoryError)
"""Exceptions of numpy and scipy for numbers with which they cannot compute; ``LinAlgError`` is a ``ValueError``."""


@contextmanager
def refused_if_not_computed(name: str) -> Iterator[None]:
    """Turn a numerical failure of the engine ``name`` into a refusal of the record. Other errors pass.

    Raises:
        UnusableInputError: numpy or scipy cannot compute with the numbers of this record.
    """
    try:
        yield
    except _NUMERICAL as error:
        if isinstance(error, ValidationError):  # a specification with wrong options is a programming error
            raise
        said = f"{type(error).__name__}: {error}".splitlines()[0]
        raise UnusableInputError(
            "engine.not_computed",
            "the engine {name} cannot be computed for this record: {problem}",
            name=name,
            problem=said,
        ) from error


def check_horizon(horizon: int) -> None:
    """Raise for a prediction horizon below one sample.

    Raises:
        UnusableInputError: ``horizon`` is less than 1.
    """
    if horizon < 1:
        raise UnusableInputError(
            "engine.horizon", "the prediction horizon must be at least one sample, got {horizon}", horizon=horizon
        )
