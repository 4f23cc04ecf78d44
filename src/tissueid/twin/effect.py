"""What an effect declares of itself: its equation, parameters, stage, signature, source and rivals.

Adding an effect is adding one file to ``tissueid.twin.effects`` that ends in ``EFFECT = Effect(...)``; another package
adds one under the entry point group ``tissueid.effects``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tissueid.twin import bus

Stage = Literal["drive", "coil", "mechanics", "tissue", "sensing", "environment"]
STAGES: tuple[Stage, ...] = ("drive", "coil", "mechanics", "tissue", "sensing", "environment")
"""In the order of the chain."""
STAGE_NAMES: Mapping[Stage, str] = {
    "drive": "amplifier",
    "coil": "coil",
    "mechanics": "moving part (mechanics)",
    "tissue": "tissue",
    "sensing": "sensors",
    "environment": "surroundings",
}
"""What people read for a stage."""

FloatArray = NDArray[np.float64]
Hook = Callable[[int, FloatArray, FloatArray, FloatArray, float], None]
Recording = Callable[["Readings", FloatArray], "Readings"]


@dataclass(frozen=True)
class Readings:
    """What the recorder is given and what it keeps: arrays of shape (n,), SI, one number a sample."""

    time: FloatArray
    voltage: FloatArray
    current: FloatArray
    position: FloatArray
    sample_rate_hz: float


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect, with the range in which it is looked for.

    ``neutral`` is the value at which the effect vanishes (``inf`` where only a limit does); where several parameters
    have a neutral value, any one at its own is enough, unless the effect says that they vanish ``jointly``. ``low``
    and ``high`` bound the fit; ``logarithmic`` says that it is fitted by its logarithm, so both are then positive.
    ``per_test`` says that every test has a value of its own (a phase, say). ``fixed`` says that it is not searched
    for: it keeps the value that ``from_test`` or the start gives it, and costs a fit nothing. ``prior`` is the value
    thought likeliest before seeing data and ``prior_std`` how far off it may be, in units of the fitted quantity (of
    its natural logarithm where ``logarithmic``); None: no opinion in bounds.
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

    def __post_init__(self) -> None:
        if not self.low < self.high or (self.logarithmic and self.low <= 0.0):
            raise ValueError(f"parameter {self.name}: {self.low} to {self.high} is no range to fit in")


@dataclass(frozen=True)
class Effect:
    """One effect that a recording may contain and the baseline twin does not model.

    Either ``hook`` acts inside the integration at ``places`` (see ``tissueid.twin.bus``), or ``recording`` turns what
    the sensors met into what was recorded, sample by sample, or both. ``starts`` are sets of parameters to begin a fit
    at, in the order of ``parameters``; they differ where the error has more than one valley.

    Raises:
        ValueError: a declaration that cannot work.
    """

    name: str
    stage: Stage
    title: str
    equation: str
    """With its neutral value, as a person reads it."""
    signature: str
    """What it leaves in the records: in which signals, when, at what frequencies."""
    source: str
    parameters: tuple[Parameter, ...]
    starts: tuple[tuple[float, ...], ...]
    mistaken_for: tuple[str, ...] = ()
    places: tuple[int, ...] = ()
    hook: Hook | None = None
    recording: Recording | None = None
    needs: frozenset[str] = frozenset({"position"})
    """Recorded signals without which it cannot be told."""
    from_test: Callable[[Mapping[str, FloatArray], float], Mapping[str, float]] | None = None
    """Where the search for a ``per_test`` parameter starts, read from the test's signals and sample rate.

    The signals are ``command``, ``voltage``, ``current`` and ``position`` as recorded, NaN where nothing was, each of
    shape (n,). Beside them may stand ``predicted_voltage``, ``predicted_current`` and ``predicted_position``, the
    baseline's own after its refit: what is estimated is then the sharper for it."""
    from_tests: Callable[[Sequence[Mapping[str, FloatArray]], float], Sequence[Mapping[str, float]]] | None = None
    """The same for all tests in which it acts at once, where these have something in common (a rate of breathing)."""
    read_again: bool = False
    """Whether ``from_test`` is asked once more where a fit with the effect ended: what is predicted is then what the
    rest of the chain makes of the test, without the effect."""
    starts_from: Callable[[Sequence[Mapping[str, FloatArray]], float], tuple[tuple[float, ...], ...]] | None = None
    """Further starts, found in the signals of all tests (as ``from_test`` has them) and their sample rate.

    What lies in narrow valleys (a period, a step) is read from the record so; none is found where there is nothing."""
    scan: tuple[tuple[float, ...], ...] = ()
    """Points on a fine grid where the valleys are narrow (a resonance): the one that shows best becomes a start."""
    special_case_of: str = ""
    """The effect that this one is a special case of; parameters of the same name mean the same in both."""
    irreducible: Callable[[FloatArray], Mapping[str, float]] | None = None
    """What stays unexplained however well the effect is known: a standard deviation by signal, from the parameters.

    It comes besides the noise: a score that weighs errors by the noise alone would take it for a gap."""
    jointly: bool = False
    """Whether it vanishes only with all its parameters that have a neutral value at theirs, as two quadratures do."""
    exact: bool = False
    """Whether its law has one form in every instrument: where it is the cause, little but noise is left.

    Laws of materials differ from one to the next, and leave more."""
    switches: bool = False
    """Whether something begins or ends at instants that its parameters move.

    A signal then has corners along a parameter, and slopes are taken over wider steps."""
    remedy: str = ""
    """What a technician does about it, in one sentence."""
    on_spring: bool = field(default=True)
    """Whether it is there as well while the calibration spring or nothing is under the probe."""

    def __post_init__(self) -> None:
        if self.stage not in STAGES:
            raise ValueError(f"effect {self.name}: there is no stage {self.stage!r}")
        if self.hook is not None and len(self.parameters) > bus.MOST_PARAMETERS:
            raise ValueError(f"effect {self.name}: a hook takes at most {bus.MOST_PARAMETERS} parameters")
        if not self.starts or any(len(start) != len(self.parameters) for start in (*self.starts, *self.scan)):
            raise ValueError(f"effect {self.name}: a start gives every parameter a value")
        if (self.hook is None) != (not self.places):
            raise ValueError(f"effect {self.name}: a hook needs the places that call it, and they a hook")
        if self.hook is None and self.recording is None:
            raise ValueError(f"effect {self.name}: it neither hooks into the chain nor changes what is recorded")

    @property
    def order(self) -> int:
        """Number of parameters that a fit searches for; those that every test has for its own count once."""
        return sum(not parameter.fixed for parameter in self.parameters)


def kin(one: Effect, other: Effect) -> bool:
    """Whether one of two effects is a special case of the other."""
    return one.special_case_of == other.name or other.special_case_of == one.name
