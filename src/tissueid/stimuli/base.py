"""What can be played: specifications that build a force history, and how they are found.

A kind of stimulus registers by one declaration in a file of its own in this package; other packages add theirs by
an entry point in the group ``tissueid.stimuli``. A built stimulus carries a description from which it can be built
again, sample for sample.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from tissueid.device import DeviceDescription
from tissueid.errors import LimitError, UnusableInputError
from tissueid.plugins import Registry

GUIDED = "guided"
RISE_S = 0.05
"""Time, s, over which a guided stimulus rises to the mean load."""

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Stimulus:
    """A force history to be played: ``values`` (n,) in N at ``sample_rate_hz``.

    ``description`` is plain data, enough for :func:`rebuild`. ``crest_factor`` is the peak over the
    root-mean-square of the part about its mean. ``preload_s`` seconds at the start hold the mean load.
    """

    values: Array
    sample_rate_hz: float
    description: dict[str, Any]
    seed: int
    crest_factor: float
    preload_s: float = 0.0

    def __len__(self) -> int:
        return self.values.size

    @property
    def seconds(self) -> float:
        """Length, s."""
        return self.values.size / self.sample_rate_hz


class StimulusKind(BaseModel, ABC):
    """The specification of a stimulus: options with bounds, which double as the limits of a form."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    name: ClassVar[str]

    @abstractmethod
    def build(self) -> Stimulus:
        """Build the force history. The same specification always gives the same samples."""

    @classmethod
    def from_options(cls, options: Mapping[str, Any]) -> Self:
        """Build the specification from named options.

        Raises:
            UnusableInputError: an option is unknown, out of its bounds, or at odds with another.
        """
        try:
            return cls(**options)
        except ValidationError as error:
            first = error.errors()[0]
            option = ".".join(str(part) for part in first["loc"])
            raise UnusableInputError(f"stimulus {cls.name}, option {option!r}: {first['msg']}") from error

    def describe(self) -> dict[str, Any]:
        """Return the kind and its options as plain values, fit for JSON."""
        return {"type": self.name} | self.model_dump(mode="json")


_Kind = TypeVar("_Kind", bound=type[StimulusKind])
_kinds: Registry[StimulusKind] = Registry("stimulus", StimulusKind, "tissueid.stimuli", "tissueid.stimuli")  # type: ignore[type-abstract]


def stimulus(declared: _Kind) -> _Kind:
    """Register a kind of stimulus under its ``name``; used as a decorator.

    Raises:
        ValueError: another class already has that name.
    """
    _kinds.register(declared)
    return declared


def get_stimulus(name: str) -> type[StimulusKind]:
    """Return the kind of stimulus registered under a name.

    Raises:
        UnusableInputError: there is none of that name; the line lists those that there are.
    """
    return _kinds.get(name)


def stimulus_names() -> tuple[str, ...]:
    """Return the names of all kinds of stimulus, in alphabetical order."""
    return _kinds.names()


def rebuild(description: Mapping[str, Any]) -> Stimulus:
    """Build a stimulus again from its description, as a session holds it.

    Raises:
        UnusableInputError: the description is of no known kind, or its options do not hold.
    """
    fields = dict(description)
    kind = fields.pop("type", None)
    if kind == GUIDED:
        return guided(rebuild(fields.get("stimulus", {})), preload_s=float(fields.get("preload_s", 0.5)))
    if not isinstance(kind, str):
        raise UnusableInputError("the description of the stimulus does not say its type")
    return get_stimulus(kind).from_options(fields).build()


def guided(played: Stimulus, preload_s: float = 0.5) -> Stimulus:
    """Put a preload before a stimulus: a raised-cosine rise to its mean load, then a hold.

    The hold lets the tissue come to rest at the operating point, which is where identification takes it to begin
    (Chen 2010, 3.1.3).

    Args:
        played: what follows the preload.
        preload_s: length of the preload, s, the rise of ``RISE_S`` included.

    Raises:
        UnusableInputError: the preload is shorter than its rise.
    """
    if not preload_s >= RISE_S:
        raise UnusableInputError(f"the preload must last at least its rise of {RISE_S:g} s, not {preload_s:g} s")
    mean = float(np.mean(played.values))
    n = round(preload_s * played.sample_rate_hz)
    rise = np.minimum(np.arange(n) / (RISE_S * played.sample_rate_hz), 1.0)
    preload = mean * 0.5 * (1.0 - np.cos(np.pi * rise))
    return Stimulus(
        values=np.concatenate([preload, played.values]),
        sample_rate_hz=played.sample_rate_hz,
        description={"type": GUIDED, "preload_s": preload_s, "stimulus": played.description},
        seed=played.seed,
        crest_factor=played.crest_factor,
        preload_s=preload_s,
    )


def to_voltage(force: Array, device: DeviceDescription) -> Array:
    """Volts, shape (n,), that would hold each force (n,) in N on a coil at rest.

    Raises:
        LimitError: the amplifier cannot give that voltage.
    """
    voltage = np.asarray(force, dtype=np.float64) * device.voltage_for_force(1.0)
    peak = float(np.max(np.abs(voltage), initial=0.0))
    if peak > device.amplifier_limit_v:
        raise LimitError(
            f"the stimulus asks for {peak:.3g} V and the amplifier gives {device.amplifier_limit_v:g} V: "
            "lower the force range"
        )
    return voltage


def crest_factor(values: Array) -> float:
    """Peak over root-mean-square of values (n,) about their mean (Chen 2010, 3.1.1)."""
    about = values - np.mean(values)
    return float(np.max(np.abs(about)) / np.sqrt(np.mean(about**2)))
