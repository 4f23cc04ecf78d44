"""Content of the page for one diagnosis: texts, shares and curves. It is stored in files, so it validates itself.

Texts are messages, which the page translates when it shows them, or plain strings from files of earlier versions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, PlainSerializer, PlainValidator

from tissueid.language import marked
from tissueid.records import Estimate
from tissueid.stored_values import LONGEST_TEXT, StoredText
from tissueid.twin.effect import STAGES, Stage

if TYPE_CHECKING:
    from tissueid.analysis.curves.plot import Plot

MOST_POINTS = 100_000
"""Maximum number of points of a curve."""
_MOST_LINES = 100
_MOST_ROWS = 500
_CHANNELS = frozenset({"voltage", "current", "position"})
_SPECTRA = frozenset({"recorded", "residual", "linear", "even", "odd", "noise"})
_FORM_FIELDS: Mapping[str, type | tuple[type, ...]] = {
    "min_force_n": (int, float),
    "max_force_n": (int, float),
    "seconds": (int, float),
    "seed": int,
    "stimulus_kind": str,
    "distribution": str,
    "under_probe": str,
    "site": str,
    "pseudonym": str,
}
_GREATEST_FIELD = 2**31 - 1
_PROFILES = frozenset({"depth_m", "velocity_m_s", "time_s"})


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


def _known_share(value: float) -> float:
    if not (math.isnan(value) or 0.0 <= value <= 1.0):
        raise ValueError("a probability must be 0 to 1 or NaN")
    return value


def _form_fields(fields: Mapping[str, Any]) -> Mapping[str, Any]:
    for name, value in fields.items():
        if name not in _FORM_FIELDS or not isinstance(value, _FORM_FIELDS[name]):
            raise ValueError(f"a test has no field {name[:20]!r}")
        if isinstance(value, int | float) and not abs(value) <= _GREATEST_FIELD:
            raise ValueError(f"{name} is too large")
        if isinstance(value, str) and len(value) > LONGEST_TEXT:
            raise ValueError(f"{name} is too long")
    return fields


def _listed(values: NDArray[Any]) -> list[Any]:
    found: list[Any] = values.tolist()
    return found


Curve = Annotated[NDArray[np.float64], PlainValidator(_numbers), PlainSerializer(_listed)]
Marks = Annotated[NDArray[np.bool_], PlainValidator(_marks), PlainSerializer(_listed)]
Name = Annotated[str, Field(max_length=LONGEST_TEXT)]
Lines = Annotated[tuple[StoredText, ...], Field(max_length=_MOST_LINES)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


@dataclass(frozen=True)
class StageContent:
    """One stage of the signal chain: its share of the gap (0 to 1), whether it is at fault, and the evidence."""

    stage: Stage
    share: Share
    lit: bool
    evidence: Lines


@dataclass(frozen=True)
class SpectrumContent:
    """Amplitude spectral densities of a signal and of the baseline's residual, as decimal logarithms.

    ``frequency`` (Hz) and the arrays of ``lines`` (``unit``/√Hz) have shape (n,); NaN is not drawn. ``bands`` are the
    significant bands.
    """

    channel: Name
    unit: Name
    frequency: Curve
    lines: dict[Name, Curve]
    bands: Annotated[tuple[tuple[Finite, Finite], ...], Field(max_length=_MOST_ROWS)]

    def __post_init__(self) -> None:
        _check_channel(self.channel)
        if set(self.lines) != _SPECTRA:
            raise ValueError("a spectrum has missing or unknown lines")
        _check_alike(self.frequency, *self.lines.values())
        _check_finite(self.frequency)

    @property
    def plot(self) -> Plot:
        """The spectrum as it is drawn."""
        from tissueid.gap.diagnosis_plots import spectrum_plot

        lines = {name: 10.0**values for name, values in self.lines.items()}
        bands = [(10.0**low, 10.0**high) for low, high in self.bands]
        return spectrum_plot(self.channel, 10.0**self.frequency, lines, bands)


@dataclass(frozen=True)
class ProfileContent:
    """Error against depth, velocity or time: ``middle`` of each bin, log10 of error over noise, shape (bins,)."""

    middle: Curve
    error: Curve
    above: Marks

    def __post_init__(self) -> None:
        if self.middle.size:
            _check_alike(self.middle, self.error, self.above)
        _check_finite(self.middle)
        _check_finite(self.error)

    def plot(self, name: str) -> Plot:
        """Return the profile of a name as it is drawn."""
        from tissueid.gap.diagnosis_plots import profile_plot

        return profile_plot(name, self.middle, 10.0**self.error, self.above)


@dataclass(frozen=True)
class Overlay:
    """One signal: time (s), recorded and simulated (``unit``), residuals and noise (``fine_unit``), shape (n,).

    ``after`` and ``left_after`` are None if no effect was fitted.
    """

    channel: Name
    unit: Name
    fine_unit: Name
    time: Curve
    recorded: Curve
    before: Curve
    after: Curve | None
    left_before: Curve
    left_after: Curve | None
    noise: Finite

    def __post_init__(self) -> None:
        _check_channel(self.channel)
        curves = (self.recorded, self.before, self.after, self.left_before, self.left_after)
        _check_alike(self.time, *(curve for curve in curves if curve is not None))
        _check_finite(self.time)

    @property
    def plots(self) -> tuple[Plot, Plot]:
        """The signals, and what the simulation leaves, as they are drawn."""
        from tissueid.gap.diagnosis_plots import SignalOverlay, overlay_plots

        curves = self.time, self.recorded, self.before, self.after, self.left_before, self.left_after
        return overlay_plots(SignalOverlay(self.channel, *curves, self.noise))


@dataclass(frozen=True)
class Fitted:
    """A fitted parameter: its meaning, and its value in SI units."""

    meaning: StoredText
    value: Estimate
    si_unit: Name


@dataclass(frozen=True)
class Rival:
    """One candidate of the ranking; ``figures`` are its fitted parameters."""

    title: StoredText
    stage: Stage
    named: bool
    probability: Annotated[float, AfterValidator(_known_share)]
    odds: StoredText
    closed: StoredText
    alike: StoredText
    signature: StoredText
    remedy: StoredText
    figures: Annotated[tuple[Fitted, ...], Field(max_length=_MOST_ROWS)]


@dataclass(frozen=True)
class Proposal:
    """A test that would separate the candidates.

    ``gains`` holds the title, the expected gain (nats) and the corresponding odds of every candidate test, best first.
    ``fields`` are values for the form of the guided test, None if the window cannot run the test. ``put`` says what to
    put under the probe; "" for the same tissue.
    """

    title: StoredText
    why: StoredText
    gains: Annotated[tuple[tuple[StoredText, Finite, StoredText], ...], Field(max_length=_MOST_ROWS)]
    fields: Annotated[Mapping[str, Any], AfterValidator(_form_fields)] | None
    by_hand: StoredText
    put: StoredText = ""


@dataclass(frozen=True)
class BudgetContent:
    """One bar of the gap budget, from ``low`` to ``high`` as shares of the signals' deviation, NaN where unknown."""

    name: StoredText
    low: float
    high: float
    role: Literal["model", "measured", "check"]


@dataclass(frozen=True)
class PageContent:
    """A diagnosis as the page shows it. ``gap`` is before, after (None without a candidate) and noise, as shares."""

    verdict: Literal["effect", "no_gap", "unexplained"]
    effect: StoredText
    headline: StoredText
    level: Literal["good", "check", "poor"]
    means: Lines
    todo: Lines
    remarks: Lines
    stages: tuple[StageContent, ...]
    at_fault: tuple[Stage, ...]
    spectrum: SpectrumContent | None
    profiles: dict[Name, ProfileContent]
    ranking: Annotated[tuple[Rival, ...], Field(max_length=_MOST_ROWS)]
    gap: tuple[float, float | None, float]
    closing: StoredText
    overlays: Annotated[tuple[Overlay, ...], Field(max_length=len(_CHANNELS))]
    proposal: Proposal | None
    offered: Annotated[tuple[tuple[Name, StoredText, bool], ...], Field(max_length=_MOST_ROWS)]
    """Effects to accept: name, title with its probability, and whether the diagnosis names it."""

    budget: Annotated[tuple[BudgetContent, ...], Field(max_length=_MOST_ROWS)] = ()
    """The waterfall from the gap before to the noise."""

    def __post_init__(self) -> None:
        if not self.budget:
            # A file of an earlier version.
            before, after, noise = self.gap
            rows = [BudgetContent(marked("Before"), 0.0, before, "model")]
            rows += [] if after is None else [BudgetContent(marked("After"), 0.0, after, "measured")]
            rows.append(BudgetContent(marked("Noise alone"), 0.0, noise, "check"))
            object.__setattr__(self, "budget", tuple(rows))
        if [item.stage for item in self.stages] != list(STAGES):
            raise ValueError("the stages are not those of the signal chain")
        if not set(self.profiles) <= _PROFILES:
            raise ValueError("a profile has an unknown name")


def _check_channel(name: str) -> None:
    if name not in _CHANNELS:
        raise ValueError(f"there is no channel {name[:20]!r}")


def _check_alike(first: NDArray[Any], *others: NDArray[Any]) -> None:
    if not first.size or any(item.size != first.size for item in others):
        raise ValueError("the curves of a figure differ in length")


def _check_finite(values: NDArray[np.float64]) -> None:
    if not np.isfinite(values).all():
        raise ValueError("an axis holds a value that is not finite")
