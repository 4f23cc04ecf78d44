"""Content of a diagnosis as window and report show it and files keep it: texts, shares, and curves in display units.

The classes check themselves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, PlainSerializer, PlainValidator

from tissueid.records import Estimate
from tissueid.stored_values import LONGEST_TEXT, MessageText
from tissueid.twin.effect import STAGES, Stage

MOST_POINTS = 100_000
"""Maximum number of points of a curve."""
MOST_ROWS = 500
_CHANNELS = frozenset({"voltage", "current", "position"})
_SPECTRA = frozenset({"recorded", "residual", "linear", "even", "odd", "noise"})


def _numbers(values: object) -> NDArray[np.float64]:
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, OverflowError) as error:
        raise ValueError("a curve must be a list of numbers") from error
    if array.ndim != 1 or array.size > MOST_POINTS or np.isinf(array).any():
        raise ValueError(f"a curve must have one dimension and at most {MOST_POINTS} numbers, finite or NaN")
    return array


def _marks(values: object) -> NDArray[np.bool_]:
    array = np.asarray(values)
    if array.ndim != 1 or array.size > MOST_POINTS or (array.size and array.dtype != np.bool_):
        raise ValueError("marks must be a list of true and false")
    return array.astype(np.bool_)


Curve = Annotated[NDArray[np.float64], PlainValidator(_numbers), PlainSerializer(np.ndarray.tolist, list[float])]
Marks = Annotated[NDArray[np.bool_], PlainValidator(_marks), PlainSerializer(np.ndarray.tolist, list[bool])]
Finite = Annotated[float, Field(allow_inf_nan=False)]


@dataclass(frozen=True, eq=False)
class GapSpectrum:
    """Amplitude spectral densities of a signal and of the baseline's residual.

    ``frequency`` (Hz) and the arrays of ``lines`` have shape (n,); NaN is not drawn. ``bands`` (Hz) are significant.
    """

    channel: Name
    frequency: Curve
    lines: dict[Name, Curve]
    bands: Annotated[tuple[tuple[Finite, Finite], ...], Field(max_length=MOST_ROWS)]

    def __post_init__(self) -> None:
        if self.channel not in _CHANNELS or set(self.lines) != _SPECTRA:
            raise ValueError("a spectrum has an unknown channel, or missing or unknown lines")
        _check_curves(self.frequency, *self.lines.values())


@dataclass(frozen=True, eq=False)
class GapProfile:
    """Error against depth, velocity or time: middle of each bin, and error over noise, shape (bins,).

    ``above`` marks the bins that are significant.
    """

    middle: Curve
    error: Curve
    above: Marks

    def __post_init__(self) -> None:
        if self.middle.size:
            _check_curves(self.middle, self.error, self.above)
        if not np.isfinite(self.error).all():
            raise ValueError("an error is not finite")


@dataclass(frozen=True, eq=False)
class SignalOverlay:
    """One signal of a stretch: time (s), recorded and simulated, and their differences, in display units, (n,).

    ``after`` and ``left_after`` are None if no effect was fitted. ``noise`` is one standard deviation, in the unit of
    the differences.
    """

    channel: Name
    time: Curve
    recorded: Curve
    before: Curve
    after: Curve | None
    left_before: Curve
    left_after: Curve | None
    noise: Finite

    def __post_init__(self) -> None:
        if self.channel not in _CHANNELS:
            raise ValueError(f"there is no channel {self.channel[:20]!r}")
        curves = (self.recorded, self.before, self.after, self.left_before, self.left_after)
        _check_curves(self.time, *(curve for curve in curves if curve is not None))


@dataclass(frozen=True)
class BudgetRow:
    """One bar of the gap budget: its name, and where it begins and ends, as shares of the signal (0 to 1)."""

    name: MessageText
    low: float
    high: float
    role: Literal["model", "measured", "check"]


def _check_curves(x: NDArray[np.float64], *others: NDArray[Any]) -> None:
    if not x.size or any(item.size != x.size for item in others) or not np.isfinite(x).all():
        raise ValueError("the curves of a figure differ in length, or their axis has a value that is not finite")


_MOST_LINES = 100
_PROFILES = frozenset({"depth_m", "velocity_m_s", "time_s", "current_a", "amplitude_n", "mains_phase_rad"})


def _known_share(value: float) -> float:
    if not (math.isnan(value) or 0.0 <= value <= 1.0):
        raise ValueError("a probability must be 0 to 1 or NaN")
    return value


Name = Annotated[str, Field(max_length=LONGEST_TEXT)]
Lines = Annotated[tuple[MessageText, ...], Field(max_length=_MOST_LINES)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]


@dataclass(frozen=True)
class StageContent:
    """One stage of the signal chain: its share of the gap (0 to 1), whether it is at fault, and the evidence."""

    stage: Stage
    share: Share
    lit: bool
    evidence: Lines


@dataclass(frozen=True)
class Fitted:
    """A fitted parameter: its meaning, and its value in SI units."""

    meaning: MessageText
    value: Estimate
    si_unit: Name


@dataclass(frozen=True)
class Rival:
    """One candidate of the ranking; ``figures`` are its fitted parameters."""

    title: MessageText
    stage: Stage
    named: bool
    probability: Annotated[float, AfterValidator(_known_share)]
    odds: MessageText
    closed: MessageText
    alike: MessageText
    signature: MessageText
    remedy: MessageText
    figures: Annotated[tuple[Fitted, ...], Field(max_length=MOST_ROWS)]


@dataclass(frozen=True)
class DiagnosisContent:
    """A diagnosis as page and report show it. Texts are messages, which are translated when they are shown."""

    verdict: Literal["effect", "no_gap", "unexplained"]
    effect: MessageText
    headline: MessageText
    level: Literal["good", "check", "poor"]
    means: Lines
    todo: Lines
    remarks: Lines
    stages: tuple[StageContent, ...]
    at_fault: tuple[Stage, ...]
    spectrum: GapSpectrum | None
    profiles: dict[Name, GapProfile]
    ranking: Annotated[tuple[Rival, ...], Field(max_length=MOST_ROWS)]
    closing: MessageText
    overlays: Annotated[tuple[SignalOverlay, ...], Field(max_length=3)]
    offered: Annotated[tuple[tuple[Name, MessageText, bool], ...], Field(max_length=MOST_ROWS)]
    """Effects to accept: name, title with its probability, and whether the diagnosis names it."""

    budget: Annotated[tuple[BudgetRow, ...], Field(max_length=MOST_ROWS)]
    """The waterfall from the gap before to the noise."""

    def __post_init__(self) -> None:
        if [item.stage for item in self.stages] != list(STAGES):
            raise ValueError("the stages are not those of the signal chain")
        if not set(self.profiles) <= _PROFILES:
            raise ValueError("a profile has an unknown name")
