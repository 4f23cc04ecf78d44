"""Curves of a diagnosis as window and report draw them and files keep them, in display units; they check themselves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PlainSerializer, PlainValidator

from tissueid.stored_values import Name, StoredText

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

    name: StoredText
    low: float
    high: float
    role: Literal["model", "measured", "check"]


def _check_curves(x: NDArray[np.float64], *others: NDArray[Any]) -> None:
    if not x.size or any(item.size != x.size for item in others) or not np.isfinite(x).all():
        raise ValueError("the curves of a figure differ in length, or their axis has a value that is not finite")
