"""Kinds of stimulus: specifications that build a force or voltage history, and their registry.

A kind of stimulus is one class in a file of its own under ``kinds/``, with its title and the descriptions of its
options; the command line and the window find it there. Other packages add theirs by an entry point in the group
``tissueid.stimuli``. Open-loop kinds are built before the test, and a built stimulus carries a description from which
it can be rebuilt, sample for sample. Feedback kinds are generated during the test (:mod:`tissueid.stimuli.base`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from tissueid.device import DeviceDescription
from tissueid.errors import LimitError, UnusableInputError
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.plan_options import option_error
from tissueid.plugins import Registry

GUIDED = "guided"
"""Type of a stimulus with a preload in its description; fixed by the session format."""
RISE_S = 0.05
"""Time, s, over which a guided stimulus rises to the mean load."""
MAX_PRELOAD_S = 60.0
"""Maximum length of a preload, s."""
MIN_SPAN = 1e-6
"""Minimum range of a stimulus, N or V; a narrower range is lost in rounding."""
MAX_SAMPLES = 5_000_000
"""Maximum number of samples of a stimulus."""

Array = NDArray[np.float64]


Unit = Literal["N", "V"]


@dataclass(frozen=True, eq=False)
class Stimulus:
    """History to play: ``values`` (n,) in ``unit``, N or V, at ``sample_rate_hz``.

    ``description`` is plain data, sufficient for :func:`rebuild`. ``crest_factor`` is peak over RMS of the zero-mean
    part. The first ``preload_s`` seconds hold the mean load, or ``start_value`` for a stimulus that does not start at
    its mean.
    """

    values: Array
    sample_rate_hz: float
    description: dict[str, Any]
    seed: int
    crest_factor: float
    preload_s: float = 0.0
    unit: Unit = "N"
    start_value: float | None = None

    def __len__(self) -> int:
        return self.values.size

    @property
    def seconds(self) -> float:
        """Length, s."""
        return self.values.size / self.sample_rate_hz


class StimulusKind(BaseModel, ABC):
    """Specification of a stimulus: options with bounds, which are also the limits of the form."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    name: ClassVar[str]
    title: ClassVar[str] = ""
    """Title in the window; the name by default."""
    test_kind: ClassVar[str] = "stochastic"
    """Kind of the tests that play the stimulus, in a session."""
    listed: ClassVar[bool] = True
    """Whether the kind can be chosen and designed; the others come from files."""
    applies: ClassVar[Mapping[str, tuple[str, tuple[object, ...]]]] = {}
    """Option: the option on which it depends, and the values of that one with which it applies."""

    @classmethod
    def from_options(cls, options: Mapping[str, Any]) -> Self:
        """Build the specification from named options.

        Raises:
            UnusableInputError: an option is unknown, out of bounds, or inconsistent with another option.
        """
        try:
            return cls(**options)
        except ValidationError as error:
            stimulus = Message("option.stimulus", "stimulus {name}", name=cls.name)
            raise UnusableInputError(option_error(stimulus, cls.model_fields, error)) from error

    def describe(self) -> dict[str, Any]:
        """Return the kind and its options as plain values, fit for JSON."""
        return {"type": self.name} | self.model_dump(mode="json")


def check_range_order(what: str, least: float, greatest: float, unit: str) -> None:
    """Raise for an inverted or empty range of ``what``, such as "force".

    Raises:
        UnusableInputError: the least value is not below the greatest.
    """
    if least >= greatest:
        raise UnusableInputError(
            "stimulus.range",
            "the least {what} ({least:g} {unit}) must be below the greatest ({greatest:g} {unit})",
            what=what,
            least=least,
            greatest=greatest,
            unit=unit,
        )


_WHAT = (marked("force"), marked("voltage"), marked("depth"))
"""Quantities whose range is checked."""


class OpenLoopKind(StimulusKind):
    """A stimulus that is known before the test."""

    @abstractmethod
    def build(self) -> Stimulus:
        """Build the history. The same specification always gives the same samples."""

    def planned_samples(self) -> int | None:
        """Return the number of samples of :meth:`build`, from the options alone; None where it is not known."""
        seconds, rate = getattr(self, "seconds", None), getattr(self, "sample_rate", None)
        return round(seconds * rate) if isinstance(seconds, float) and isinstance(rate, float) else None

    def check_size(self) -> None:
        """Raise for a stimulus with too many samples.

        Raises:
            UnusableInputError: the options ask for more than ``MAX_SAMPLES``.
        """
        samples = self.planned_samples()
        if samples is not None and samples > MAX_SAMPLES:
            raise UnusableInputError(
                "stimulus.samples",
                "the stimulus {name} would have {samples:.3g} samples; the maximum is {limit:.3g}: lower "
                "its length or its sample rate",
                name=self.name,
                samples=samples,
                limit=MAX_SAMPLES,
            )


class Ranged(OpenLoopKind):
    """An open-loop stimulus within a range of force, or of voltage when both its ends are given."""

    force_min_n: float = Field(0.0, ge=-100.0, le=100.0, description=marked("Least force, N"))
    force_max_n: float = Field(8.0, ge=-100.0, le=100.0, description=marked("Greatest force, N"))
    voltage_min_v: float | None = Field(
        None, ge=-1000.0, le=1000.0, description=marked("Least voltage, V: designs the voltage instead of the force")
    )
    voltage_max_v: float | None = Field(None, ge=-1000.0, le=1000.0, description=marked("Greatest voltage, V"))

    @model_validator(mode="after")
    def _check_range(self) -> Self:
        if (self.voltage_min_v is None) != (self.voltage_max_v is None):
            raise UnusableInputError(
                "stimulus.voltage_ends", "a voltage range needs both limits: give voltage_min_v and voltage_max_v"
            )
        low, high, unit = self.span
        check_range_order("force" if unit == "N" else "voltage", low, high, unit)
        if high - low < MIN_SPAN:
            raise UnusableInputError(
                "stimulus.narrow",
                "the range from {low:g} to {high:g} {unit} is narrower than {least:g} {unit}: widen it",
                low=low,
                high=high,
                least=MIN_SPAN,
                unit=unit,
            )
        return self

    @property
    def span(self) -> tuple[float, float, Unit]:
        """Least and greatest value, and their unit."""
        if self.voltage_min_v is None or self.voltage_max_v is None:
            return self.force_min_n, self.force_max_n, "N"
        return self.voltage_min_v, self.voltage_max_v, "V"


_Kind = TypeVar("_Kind", bound=type[StimulusKind])
kinds: Registry[StimulusKind] = Registry("stimulus", StimulusKind, "tissueid.stimuli.kinds", "tissueid.stimuli")  # type: ignore[type-abstract]


def stimulus(declared: _Kind) -> _Kind:
    """Register a kind of stimulus under its ``name``; used as a decorator.

    Raises:
        ValueError: another class already has that name.
    """
    kinds.register(declared)
    return declared


def get_stimulus(name: str) -> type[StimulusKind]:
    """Return the kind of stimulus registered under a name.

    Raises:
        UnusableInputError: no kind has that name; the message lists the known names.
    """
    return kinds.get(name)


def stimulus_names() -> tuple[str, ...]:
    """Return the names of all kinds of stimulus that can be chosen, in alphabetical order."""
    return tuple(name for name in kinds.names() if kinds.get(name).listed)


def build_stimulus(name: str, options: Mapping[str, Any]) -> Stimulus:
    """Build a stimulus of an open-loop kind from named options.

    Raises:
        UnusableInputError: unknown kind, invalid option, or the kind is generated during the test.
    """
    return build_from_specification(get_stimulus(name).from_options(options))


def build_from_specification(specification: StimulusKind, preload_s: float | None = None) -> Stimulus:
    """Build the stimulus of a specification, with a preload of ``preload_s`` seconds if given.

    Raises:
        UnusableInputError: the kind is generated during the test, the stimulus is too long, or the preload too short.
    """
    if not isinstance(specification, OpenLoopKind):
        raise UnusableInputError(
            "stimulus.feedback",
            "the stimulus '{name}' cannot be rebuilt, because it was generated during the test: "
            "use the recorded command",
            name=specification.name,
        )
    specification.check_size()
    built = specification.build()
    return built if preload_s is None else with_preload(built, preload_s)


def parse_description(description: object) -> tuple[StimulusKind, float | None]:
    """Return the specification and the preload length, s (None without preload), from a description.

    The description is validated completely, since it may come from a file.

    Raises:
        UnusableInputError: unknown kind, invalid options, or invalid preload length.
    """
    if not isinstance(description, Mapping) or not all(isinstance(name, str) for name in description):
        raise UnusableInputError("stimulus.description", "the description of the stimulus is not a table of options")
    fields = dict(description)
    kind = fields.pop("type", None)
    if kind == GUIDED:
        preload_s, inner = fields.get("preload_s"), fields.get("stimulus")
        if not isinstance(preload_s, int | float) or not isinstance(inner, Mapping) or inner.get("type") == GUIDED:
            raise UnusableInputError(
                "stimulus.preload_description", "the description of the stimulus with its preload is not valid"
            )
        if not RISE_S <= preload_s <= MAX_PRELOAD_S:
            raise UnusableInputError(
                "stimulus.preload_length",
                "the preload must last from its rise of {rise:g} s up to {limit:g} s",
                rise=RISE_S,
                limit=MAX_PRELOAD_S,
            )
        return parse_description(inner)[0], float(preload_s)
    if not isinstance(kind, str):
        raise UnusableInputError("stimulus.no_type", "the description of the stimulus has no type")
    return get_stimulus(kind[:100]).from_options(fields), None


def rebuild(description: Mapping[str, Any]) -> Stimulus:
    """Rebuild a stimulus from the description that a session stores.

    Raises:
        UnusableInputError: unknown kind, invalid options or preload, or a stimulus generated during the test.
    """
    return build_from_specification(*parse_description(description))


def with_preload(played: Stimulus, preload_s: float = 0.5) -> Stimulus:
    """Add a preload before a stimulus: a raised-cosine rise to its mean load or start value, then a hold.

    The hold lets the tissue settle at the operating point, the initial state that identification assumes (Chen 2010,
    3.1.3).

    Args:
        played: stimulus to play after the preload.
        preload_s: length of the preload, s, including the rise of ``RISE_S``.

    Raises:
        UnusableInputError: the preload is shorter than its rise.
    """
    load = float(np.mean(played.values)) if played.start_value is None else played.start_value
    preload = preload_values(load, preload_s, played.sample_rate_hz)
    return Stimulus(
        values=np.concatenate([preload, played.values]),
        sample_rate_hz=played.sample_rate_hz,
        description={"type": GUIDED, "preload_s": preload_s, "stimulus": played.description},
        seed=played.seed,
        crest_factor=played.crest_factor,
        preload_s=preload_s,
        unit=played.unit,
        start_value=played.start_value,
    )


def preload_values(load: float, preload_s: float, sample_rate_hz: float) -> Array:
    """Return a raised-cosine rise to ``load`` within ``RISE_S``, then a hold: shape (preload_s * sample_rate_hz,).

    Raises:
        UnusableInputError: the preload is shorter than its rise or exceeds the maximum number of samples.
    """
    if not preload_s >= RISE_S:
        raise UnusableInputError(
            "stimulus.preload_short",
            "the preload must last at least its rise of {rise:g} s, not {seconds:g} s",
            rise=RISE_S,
            seconds=preload_s,
        )
    if preload_s * sample_rate_hz > MAX_SAMPLES:
        raise UnusableInputError(
            "stimulus.preload_samples",
            "the preload would have {samples:.3g} samples; the maximum is {limit:.3g}: shorten it",
            samples=preload_s * sample_rate_hz,
            limit=MAX_SAMPLES,
        )
    rise = np.minimum(np.arange(round(preload_s * sample_rate_hz)) / (RISE_S * sample_rate_hz), 1.0)
    return load * 0.5 * (1.0 - np.cos(np.pi * rise))


def to_voltage(values: Array, device: DeviceDescription, unit: Unit = "N") -> Array:
    """Return the command, V, shape (n,), for values (n,) in V, or in N as the static force of a coil at rest.

    Raises:
        LimitError: the voltage exceeds the amplifier limit.
    """
    voltage = np.asarray(values, dtype=np.float64) * (device.voltage_for_force(1.0) if unit == "N" else 1.0)
    peak = float(np.max(np.abs(voltage), initial=0.0))
    if peak > device.amplifier_limit_v:
        if unit == "N":
            advice = Message(
                "stimulus.lower_force",
                "lower the highest force (--max-force) to {force:.1f} N",
                force=device.greatest_force_n,
            )
        else:
            advice = Message("stimulus.lower_voltage", "lower the voltage range (--max-volts) to that")
        raise LimitError(
            "stimulus.amplifier",
            "the stimulus asks for {peak:.3g} V and the amplifier gives {limit:g} V: {advice}",
            peak=peak,
            limit=device.amplifier_limit_v,
            advice=advice,
        )
    return voltage


def crest_factor(values: Array) -> float:
    """Return peak over RMS of the zero-mean part of values (n,) (Chen 2010, 3.1.1)."""
    about = values - np.mean(values)
    return float(np.max(np.abs(about)) / np.sqrt(np.mean(about**2)))


# -- stimuli that are generated during the test from the measured signals (Chen 2010, 6.3) ---------------------------

BLOCK = 50
"""Samples in a block of set-points: 25 ms at 2 kHz, the thesis' feedback cycle (6.3.1)."""


class FeedbackSource(ABC):
    """Generator of one stimulus: takes measured samples and returns blocks of set-points. Reads no clock."""

    @abstractmethod
    def take(self, force: Array, position: Array, first: int) -> None:
        """Process measured force (k,), N, and position (k,), m, in time order; NaN where a sample was lost.

        ``first`` is the index of the first sample relative to the first set-point: negative during the preload.
        """

    @abstractmethod
    def next_block(self) -> Array:
        """Return the next set-points, N, shape (BLOCK,), within the force range of the specification."""

    @abstractmethod
    def report(self) -> dict[str, Any]:
        """Return the results so far as plain values, JSON-serialisable."""


class FeedbackKind(StimulusKind):
    """Specification of a stimulus that is generated during the test."""

    seconds: float = Field(5.0, gt=0.0, le=600.0, description=marked("Length without the preload, s"))
    sample_rate: float = Field(2000.0, gt=0.0, le=1e6, description=marked("Sample rate, Hz"))
    seed: int = Field(
        0,
        ge=0,
        le=2**63 - 1,
        description=marked("Random seed: the same seed and the same measurements give the same samples"),
    )
    lead: int = Field(
        3, ge=1, le=20, description=marked("Number of blocks by which the set-points precede the measurement")
    )
    force_min_n: float = Field(0.0, ge=-100.0, le=100.0, description=marked("Lower limit of the set-points, N"))
    force_max_n: float = Field(10.0, ge=-100.0, le=100.0, description=marked("Upper limit of the set-points, N"))

    @model_validator(mode="after")
    def _check_range(self) -> Self:
        check_range_order("force", self.force_min_n, self.force_max_n, "N")
        return self

    @property
    @abstractmethod
    def preload_n(self) -> float:
        """Load, N, of the preload, also applied when set-points are missing."""

    @abstractmethod
    def start(self, surface_m: float) -> FeedbackSource:
        """Return a source for one test. ``surface_m`` is the position of the tissue surface, m."""
