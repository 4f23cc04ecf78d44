"""Amplitude distributions, each by its quantile function, and the exact amplitudes that a signal of n samples holds.

A signal has a distribution exactly when its samples, sorted, are the distribution's ``levels(n)``. Tails without end
are cut, at a stated number of standard deviations from the mean, and what is left is the distribution: no samples
are heaped up at the cut.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError

Array = NDArray[np.float64]

DistributionName = Literal["gaussian", "uniform", "rayleigh", "exponential", "binary", "quantiles"]

_NEAREST, _FARTHEST = 1e-300, 1e300
"""Spans of quantiles that can be scaled to a range without leaving the numbers there are."""


class Distribution(ABC):
    """A distribution of amplitudes over a range with ends."""

    @abstractmethod
    def quantile(self, probability: Array) -> Array:
        """The amplitude, in a unit of its own, that is not exceeded with each probability (k,)."""

    def levels(self, n: int) -> Array:
        """The n amplitudes (n,), ascending from -1, the lower end of the range, to 1, the upper.

        They are the quantiles at n evenly spaced probabilities from 0 to 1. A distribution that leans keeps its lean:
        its mean is not 0.

        Raises:
            UnusableInputError: n is below 2.
        """
        if n < 2:
            raise UnusableInputError(f"a distribution needs at least 2 samples, not {n}")
        raw = self.quantile(np.linspace(0.0, 1.0, n))
        levels = 2.0 * (raw - raw[0]) / (raw[-1] - raw[0]) - 1.0
        return np.asarray(np.clip(levels, -1.0, 1.0), dtype=np.float64)


@dataclass(frozen=True)
class Uniform(Distribution):
    """Every amplitude of the range as often as every other."""

    def quantile(self, probability: Array) -> Array:
        """Amplitudes (k,) at probabilities (k,)."""
        return 2.0 * probability - 1.0

    def levels(self, n: int) -> Array:
        """Evenly spaced amplitudes (n,) from -1 to 1."""
        if n < 2:
            raise UnusableInputError(f"a distribution needs at least 2 samples, not {n}")
        return np.linspace(-1.0, 1.0, n)


@dataclass(frozen=True)
class Gaussian(Distribution):
    """The normal distribution up to ``cut`` standard deviations on either side."""

    cut: float = 3.0

    def quantile(self, probability: Array) -> Array:
        """Amplitudes (k,) at probabilities (k,), in standard deviations before the cut."""
        beyond = scipy.special.ndtr(-self.cut)
        below = scipy.special.ndtri(beyond + probability * (1.0 - 2.0 * beyond))
        above = -scipy.special.ndtri(beyond + (1.0 - probability) * (1.0 - 2.0 * beyond))
        return np.asarray(0.5 * (below + above), dtype=np.float64)  # symmetric to the last bit


@dataclass(frozen=True)
class Rayleigh(Distribution):
    """The length of a vector of two Gaussian components, up to ``cut`` standard deviations above its mean."""

    cut: float = 3.0

    def quantile(self, probability: Array) -> Array:
        """Amplitudes (k,) at probabilities (k,), in standard deviations of a component."""
        reach = np.sqrt(0.5 * np.pi) + self.cut * np.sqrt(2.0 - 0.5 * np.pi)
        kept = -np.expm1(-0.5 * reach**2)
        return np.asarray(np.sqrt(-2.0 * np.log1p(-probability * kept)), dtype=np.float64)


@dataclass(frozen=True)
class Exponential(Distribution):
    """The waiting time for a chance event, up to ``cut`` standard deviations above its mean."""

    cut: float = 3.0

    def quantile(self, probability: Array) -> Array:
        """Amplitudes (k,) at probabilities (k,), in means before the cut."""
        kept = -np.expm1(-(1.0 + self.cut))
        return np.asarray(-np.log1p(-probability * kept), dtype=np.float64)


@dataclass(frozen=True)
class Binary(Distribution):
    """The two ends of the range, each half of the time; of an odd number of samples one more at the lower."""

    def quantile(self, probability: Array) -> Array:
        """Amplitudes (k,), -1 or 1, at probabilities (k,)."""
        return np.where(probability > 0.5, 1.0, -1.0)


@dataclass(frozen=True)
class Quantiles(Distribution):
    """Any distribution, by its quantiles: straight lines between ``values`` (m,) at ``probabilities`` (m,).

    Without probabilities the values are evenly spaced in probability from 0 to 1. The least value is brought to the
    lower end of the range and the greatest to the upper. A value given twice is an amplitude that is held for the
    share of the time between its probabilities.

    Raises:
        UnusableInputError: the tables are no quantile function.
    """

    values: tuple[float, ...]
    probabilities: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if len(self.values) < 2:
            raise UnusableInputError(f"quantiles need at least 2 values, not {len(self.values)}")
        if any(b < a for a, b in pairwise(self.values)):
            raise UnusableInputError("the values of quantiles must not fall: sort them")
        if not self.values[-1] > self.values[0]:
            raise UnusableInputError(f"all values of the quantiles are {self.values[0]:g}: give at least two")
        if not _NEAREST <= self.values[-1] - self.values[0] <= _FARTHEST:
            raise UnusableInputError(
                f"the quantiles from {self.values[0]:g} to {self.values[-1]:g} are too near or too far to be scaled: "
                "give values nearer 1"
            )
        if not self.probabilities:
            return
        if len(self.probabilities) != len(self.values):
            raise UnusableInputError(
                f"quantiles need a probability for each value: {len(self.values)} values, "
                f"{len(self.probabilities)} probabilities"
            )
        if self.probabilities[0] != 0.0 or self.probabilities[-1] != 1.0:
            raise UnusableInputError("the probabilities of quantiles must begin at 0 and end at 1")
        if any(b <= a for a, b in pairwise(self.probabilities)):
            raise UnusableInputError("the probabilities of quantiles must rise from one to the next")

    def quantile(self, probability: Array) -> Array:
        """Amplitudes (k,) at probabilities (k,), in the unit of the values."""
        given = self.probabilities or np.linspace(0.0, 1.0, len(self.values))
        return np.asarray(np.interp(probability, given, self.values), dtype=np.float64)


def kolmogorov_distance(values: Array, levels: Array) -> float:
    """Largest difference between the shares of values (n,) and of levels (m,) that lie at or below any amplitude."""
    one, other = np.sort(values), np.sort(levels)
    steps = np.concatenate([one, other])
    share = np.searchsorted(one, steps, side="right") / one.size
    wanted = np.searchsorted(other, steps, side="right") / other.size
    return float(np.max(np.abs(share - wanted)))
