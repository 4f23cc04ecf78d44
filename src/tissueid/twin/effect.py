"""Declaration of an effect: equation, parameters, stage, signature, source and rivals.

To add an effect, add one file to ``tissueid.twin.effects`` that ends in ``EFFECT = Effect(...)``, or an entry point of
the group ``tissueid.effects`` to another package.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum, auto
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tissueid.language import marked
from tissueid.twin import bus

Stage = Literal["drive", "coil", "mechanics", "tissue", "sensing", "environment"]
STAGES: tuple[Stage, ...] = ("drive", "coil", "mechanics", "tissue", "sensing", "environment")
"""Stages in the order of the chain."""
STAGE_NAMES: Mapping[Stage, str] = {
    "drive": marked("amplifier"),
    "coil": marked("coil"),
    "mechanics": marked("moving part (mechanics)"),
    "tissue": marked("tissue"),
    "sensing": marked("sensors"),
    "environment": marked("surroundings"),
}
"""Displayed names of the stages."""


class ActsOn(IntEnum):
    """What an effect acts on, in the order of evaluation: from the command to the recorded numbers.

    An effect sees the changes by effects on earlier members. Effects on one member do not read what the others change.
    The order is that of the signals in a device, and that of the equations: terms that scale with the elastic force
    of the tissue refer to this force alone.
    """

    HELD_COMMAND = auto()
    AMPLIFIER_GAIN = auto()
    AMPLIFIER_RESPONSE = auto()
    AMPLIFIER_OUTPUT = auto()
    AMPLIFIER_LIMIT = auto()
    SURFACE = auto()
    """Position and velocity of the surface: before everything that depends on the depth."""
    COIL = auto()
    """Resistance, inductance and force constant."""
    COIL_CURRENT = auto()
    """The current that follows from them."""
    PROBE = auto()
    """Forces on the moving part, without and with tissue."""
    ELASTIC_FORCE = auto()
    """The elastic force of the twin's tissue, as a factor."""
    ELASTIC_LOOPS = auto()
    """Forces that grow with the elastic force."""
    TISSUE = auto()
    """Further forces, damping and mass of the tissue."""
    CONTACT = auto()
    """The total force of the tissue, which pushes only."""
    FRAME = auto()
    """The frame, which takes the reaction of all forces."""
    LIFT_OFF = auto()
    """The end of contact, with the force of the accelerated frame. A real-time simulation then adds no contact."""
    SENSOR = auto()
    """The place that the position sensor reads."""
    SENSOR_PLAY = auto()
    SENSOR_RESPONSE = auto()
    CLOCK = auto()
    CHANNELS = auto()
    """The signals between sensors and converters."""
    CONVERTER = auto()
    LINK = auto()
    """The samples on their way to the record."""


_ACTS_ON: Mapping[Stage, ActsOn] = {
    "drive": ActsOn.AMPLIFIER_GAIN,
    "coil": ActsOn.COIL,
    "mechanics": ActsOn.PROBE,
    "tissue": ActsOn.TISSUE,
    "sensing": ActsOn.SENSOR,
    "environment": ActsOn.SURFACE,
}

SCALES = ("force_constant_n_per_a", "stroke_m")
"""Properties of the instrument with which parameters can scale."""

FloatArray = NDArray[np.float64]
Hook = Callable[[int, FloatArray, FloatArray, FloatArray, float], None]
Recording = Callable[["Readings", FloatArray], "Readings"]


@dataclass(frozen=True)
class Readings:
    """Signals before or after the sensors: arrays of shape (n,), SI."""

    time: FloatArray
    voltage: FloatArray
    current: FloatArray
    position: FloatArray
    sample_rate_hz: float


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect, with its bounds in a fit.

    ``neutral`` is the value at which the effect vanishes (``inf`` for a limit). Where several parameters have a neutral
    value, one of them is sufficient, unless the effect vanishes ``jointly``. ``low`` and ``high`` are the bounds of the
    fit. A ``logarithmic`` parameter is fitted by its logarithm, and its bounds are positive. A ``per_test`` parameter
    has its own value in every test (for instance a phase). A ``fixed`` parameter is not fitted: it keeps the value of
    ``estimate_from_record`` or of the start. ``prior`` is its most probable value before the data and ``prior_std`` the
    standard deviation, in units of the fitted quantity (of its natural logarithm where ``logarithmic``); None: no
    prior. ``default`` is its value where the file of a twin was written before the effect had it. With ``scales_with``,
    a property of the instrument and an exponent, bounds, prior and starts hold for the default instrument; for another
    one they are multiplied by the ratio of its property to the default, to that power.
    """

    name: str
    unit: str
    neutral: float | None
    low: float
    high: float
    logarithmic: bool = False
    per_test: bool = False
    fixed: bool = False
    prior: float | None = None
    prior_std: float | None = None
    meaning: str = ""
    default: float | None = None
    scales_with: tuple[str, int] | None = None

    def __post_init__(self) -> None:
        if not self.low < self.high or (self.logarithmic and self.low <= 0.0):
            raise ValueError(f"parameter {self.name}: {self.low} to {self.high} is no range to fit in")
        if self.scales_with is not None and self.scales_with[0] not in SCALES:
            raise ValueError(
                f"parameter {self.name}: scales with one of {', '.join(SCALES)}, not {self.scales_with[0]}"
            )

    def scaled(self, factor: float) -> Parameter:
        """Return the parameter with its neutral value, bounds and prior multiplied by a factor."""
        neutral, prior = (None if value is None else factor * value for value in (self.neutral, self.prior))
        spread = self.prior_std if self.prior_std is None or self.logarithmic else factor * self.prior_std
        low, high = factor * self.low, factor * self.high
        return replace(self, neutral=neutral, low=low, high=high, prior=prior, prior_std=spread)


@dataclass(frozen=True)
class Effect:
    """One effect that a recording can contain and that the baseline twin does not model.

    Either ``hook`` acts inside the integration at ``places`` (see ``tissueid.twin.bus``), or ``recording`` maps the
    signals before the sensors to the recorded ones, or both. ``starts`` are starting points of a fit, each with a value
    of every parameter; there are several where the cost has several minima.

    Raises:
        ValueError: the declaration is not consistent.
    """

    name: str
    stage: Stage
    title: str
    equation: str
    """Equation with its neutral value, as text."""
    signature: str
    """Trace of the effect in the records: signals, times and frequencies."""
    source: str
    parameters: tuple[Parameter, ...]
    starts: tuple[tuple[float, ...], ...]
    mistaken_for: tuple[str, ...] = ()
    places: tuple[int, ...] = ()
    hook: Hook | None = None
    recording: Recording | None = None
    needs: frozenset[str] = frozenset({"position"})
    """Recorded signals that are required to identify the effect."""
    estimate_from_record: Callable[[Mapping[str, FloatArray], float], Mapping[str, float]] | None = None
    """Return starting values of ``per_test`` parameters, estimated from the signals and the sample rate of a test.

    The signals are ``command``, ``voltage``, ``current`` and ``position`` as recorded, shape (n,), NaN where not
    received. They can include ``predicted_voltage``, ``predicted_current`` and ``predicted_position`` of the refitted
    baseline, which makes the estimates more precise.
    """
    estimate_from_records: (
        Callable[[Sequence[Mapping[str, FloatArray]], float], Sequence[Mapping[str, float]]] | None
    ) = None
    """The same for all tests at once, for parameters shared by the tests, such as a breathing rate."""
    re_estimate: bool = False
    """Whether ``estimate_from_record`` is repeated after a fit, with the prediction of the fit without the effect."""
    starts_from: Callable[[Sequence[Mapping[str, FloatArray]], float], tuple[tuple[float, ...], ...]] | None = None
    """Return further starting points, estimated from the signals of all tests and their sample rate.

    For parameters with narrow minima, such as a period or a step.
    """
    scan: tuple[tuple[float, ...], ...] = ()
    """Starting points on a fine grid for narrow minima, such as a resonance: the best aligned one is used."""
    other_minima: tuple[Mapping[str, float], ...] = ()
    """Values of some parameters from which a fitted set is fitted again: narrow minima that show only once the other
    parameters are near their values, such as the frequency of a second mode."""
    special_case_of: str = ""
    """Name of the effect that includes this one as a special case. Parameters of the same name have the same meaning.
    """
    irreducible: Callable[[FloatArray], Mapping[str, float]] | None = None
    """Return the standard deviation by signal that the effect leaves at the given parameters even if they are exact.

    It is added to the noise: otherwise a score would count it as a gap.
    """
    jointly: bool = False
    """Whether it vanishes only when all parameters with a neutral value have it, as two quadratures do."""
    exact: bool = False
    """Whether the law is the same in every instrument, so that the residual of the true cause is close to noise.

    Laws of materials differ between specimens and leave a larger residual.
    """
    switches: bool = False
    """Whether the effect contains events whose times depend on its parameters.

    A signal then has corners along a parameter, and derivatives use larger steps.
    """
    remedy: str = ""
    """Advice to the technician, in one sentence."""
    on_spring: bool = True
    """Whether it acts in tests on the calibration spring and in free air as well."""
    at_rest: bool = False
    """Whether it moves the probe without a command as well: it is no cause where quiet tests show only noise."""
    in_living_tissue: bool = False
    """Whether living tissue in general shows it: a search fits all such effects together."""
    acts_on: ActsOn | None = None
    """What it acts on, which determines when it is evaluated; None: what effects of its stage usually act on."""
    in_laboratory: bool = True
    """Whether the simulated laboratory of the blind check has an independent effect of the same name."""

    def __post_init__(self) -> None:
        texts = (self.name, self.title, self.equation, self.signature, self.source, self.remedy)
        if not all(isinstance(text, str) for text in texts) or re.fullmatch(r"[a-z][a-z0-9_]{0,63}", self.name) is None:
            raise ValueError(
                f"effect {self.name!r}: its name needs small letters, digits and _, its other texts are texts"
            )
        if not all(isinstance(parameter, Parameter) for parameter in self.parameters):
            raise ValueError(f"effect {self.name}: a parameter is of another class")
        if self.stage not in STAGES:
            raise ValueError(f"effect {self.name}: there is no stage {self.stage!r}")
        if self.hook is not None and len(self.parameters) > bus.MOST_PARAMETERS:
            raise ValueError(f"effect {self.name}: a hook takes at most {bus.MOST_PARAMETERS} parameters")
        if not self.starts or any(len(start) != len(self.parameters) for start in (*self.starts, *self.scan)):
            raise ValueError(f"effect {self.name}: a start gives every parameter a value")
        names = {parameter.name for parameter in self.parameters if not parameter.fixed}
        if any(not set(values) <= names for values in self.other_minima):
            raise ValueError(f"effect {self.name}: another minimum is a value of a fitted parameter")
        if (self.hook is None) != (not self.places):
            raise ValueError(f"effect {self.name}: a hook needs the places that call it, and they a hook")
        if self.hook is None and self.recording is None:
            raise ValueError(f"effect {self.name}: it neither hooks into the chain nor changes what is recorded")

    @property
    def evaluation(self) -> tuple[int, int, str]:
        """Return the key by which effects are ordered for evaluation, whatever the order in which they are given."""
        return self.acts_on or _ACTS_ON[self.stage], STAGES.index(self.stage), self.name

    @property
    def models_lift_off(self) -> bool:
        """Return whether it models the end of contact. A real-time simulation then adds no contact of its own."""
        return self.acts_on is ActsOn.LIFT_OFF

    @property
    def neutral(self) -> tuple[Mapping[str, float], ...]:
        """Return the sets of parameter values with which it vanishes; one set where it vanishes ``jointly``."""
        values = {item.name: item.neutral for item in self.parameters if item.neutral is not None}
        return (values,) if self.jointly else tuple({name: value} for name, value in values.items())

    @property
    def weak_starts(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """The middle and the last starting point, each ten times closer to vanishing."""
        middle, last = self.starts[len(self.starts) // 2], self.starts[-1]
        return self._weakened(middle), self._weakened(last)

    def _weakened(self, start: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(_weakened(item, value) for item, value in zip(self.parameters, start, strict=True))

    def scaled(self, ratios: Mapping[str, float]) -> Effect:
        """Return the effect with bounds, priors and starts for an instrument.

        Args:
            ratios: properties of the instrument over those of the default one, by name.
        """
        scales = [item.scales_with for item in self.parameters]
        if not any(scales):
            return self
        factors = [1.0 if scale is None else ratios[scale[0]] ** scale[1] for scale in scales]
        parameters = tuple(item.scaled(factor) for item, factor in zip(self.parameters, factors, strict=True))
        starts, scan = (
            tuple(tuple(np.multiply(start, factors).tolist()) for start in points)
            for points in (self.starts, self.scan)
        )
        return replace(self, parameters=parameters, starts=starts, scan=scan)

    @property
    def order(self) -> int:
        """Number of fitted parameters; a parameter with a value for each test counts once."""
        return sum(not parameter.fixed for parameter in self.parameters)


def _weakened(parameter: Parameter, value: float) -> float:
    if parameter.neutral is None or parameter.fixed or np.isinf(parameter.neutral):
        # Near infinity, as without any lift-off, nothing would change with the parameter.
        return value
    weak = parameter.neutral + 0.1 * (value - parameter.neutral)
    return min(max(weak, parameter.low), parameter.high)


def nested(first: Effect, second: Effect) -> bool:
    """Return whether one of two effects is a special case of the other."""
    return first.special_case_of == second.name or second.special_case_of == first.name
