"""Amplitude distributions, each by its quantile function, and their registry.

A signal has a distribution exactly when its sorted samples are ``levels(n)`` of the distribution. Infinite tails are
cut at a number of standard deviations from the mean, without an accumulation of samples at the cut.

A distribution is one class with the decorator ``distribution``. A further one is a file in ``distribution_kinds/`` or
an entry point in the group ``tissueid.distributions``; the command line and the window then offer it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar, TypeVar

import numpy as np
import scipy
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.plugins import Registry

Array = NDArray[np.float64]

_MIN_SPAN, _MAX_SPAN = 1e-300, 1e300
"""Smallest and largest span of quantiles that can be scaled to a range without underflow or overflow."""


class Distribution(ABC):
    """A distribution of amplitudes over a finite range."""

    name: ClassVar[str]

    @classmethod
    def from_options(cls, cut: float, quantiles: tuple[float, ...], probabilities: tuple[float, ...]) -> Distribution:
        """Return the distribution for the options of a stimulus; by default it has none.

        Args:
            cut: standard deviations from the mean at which an infinite tail is cut.
            quantiles: table of values.
            probabilities: of the values; empty where they are evenly spaced.

        Raises:
            UnusableInputError: the table is not valid.
        """
        del cut, quantiles, probabilities
        return cls()

    @abstractmethod
    def quantile(self, probability: Array) -> Array:
        """Return the amplitude, in any unit, that is not exceeded with each probability (k,)."""

    def levels(self, n: int) -> Array:
        """Return n amplitudes (n,), ascending from -1, the lower end of the range, to 1, the upper.

        They are the quantiles at n evenly spaced probabilities from 0 to 1. The mean of an asymmetric distribution is
        not 0.

        Raises:
            UnusableInputError: n is below 2.
        """
        if n < 2:
            raise UnusableInputError("distribution.samples", "a distribution needs at least 2 samples, not {n}", n=n)
        raw = self.quantile(np.linspace(0.0, 1.0, n))
        levels = 2.0 * (raw - raw[0]) / (raw[-1] - raw[0]) - 1.0
        return np.asarray(np.clip(levels, -1.0, 1.0), dtype=np.float64)


_Declared = TypeVar("_Declared", bound=type[Distribution])
_distributions: Registry[Distribution] = Registry(
    "distribution",
    Distribution,  # type: ignore[type-abstract]
    "tissueid.stimuli.distribution_kinds",
    "tissueid.distributions",
)


def distribution(declared: _Declared) -> _Declared:
    """Register a distribution under its ``name``; used as a decorator.

    Raises:
        ValueError: another class already has that name.
    """
    _distributions.register(declared)
    return declared


def get_distribution(name: str) -> type[Distribution]:
    """Return the distribution registered under a name.

    Raises:
        UnusableInputError: no distribution has that name.
    """
    return _distributions.get(name)


def distribution_names() -> tuple[str, ...]:
    """Return the names of all distributions, in alphabetical order."""
    return _distributions.names()


@distribution
@dataclass(frozen=True)
class Uniform(Distribution):
    """Uniform distribution over the range."""

    name: ClassVar[str] = "uniform"

    def quantile(self, probability: Array) -> Array:
        """Return amplitudes (k,) at probabilities (k,)."""
        return 2.0 * probability - 1.0

    def levels(self, n: int) -> Array:
        """Return evenly spaced amplitudes (n,) from -1 to 1."""
        if n < 2:
            raise UnusableInputError("distribution.samples", "a distribution needs at least 2 samples, not {n}", n=n)
        return np.linspace(-1.0, 1.0, n)


@distribution
@dataclass(frozen=True)
class Gaussian(Distribution):
    """Normal distribution, truncated at ``cut`` standard deviations on either side of the mean."""

    name: ClassVar[str] = "gaussian"
    cut: float = 3.0

    @classmethod
    def from_options(cls, cut: float, quantiles: tuple[float, ...], probabilities: tuple[float, ...]) -> Distribution:
        """Return the distribution with this cut."""
        return cls(cut)

    def quantile(self, probability: Array) -> Array:
        """Return amplitudes (k,) at probabilities (k,), in standard deviations before truncation."""
        beyond = scipy.special.ndtr(-self.cut)
        below = scipy.special.ndtri(beyond + probability * (1.0 - 2.0 * beyond))
        above = -scipy.special.ndtri(beyond + (1.0 - probability) * (1.0 - 2.0 * beyond))
        return np.asarray(0.5 * (below + above), dtype=np.float64)  # symmetric to the last bit


@distribution
@dataclass(frozen=True)
class Rayleigh(Distribution):
    """Rayleigh distribution: length of a vector of two Gaussian components, truncated ``cut`` standard deviations above
    the mean.
    """

    name: ClassVar[str] = "rayleigh"
    cut: float = 3.0

    @classmethod
    def from_options(cls, cut: float, quantiles: tuple[float, ...], probabilities: tuple[float, ...]) -> Distribution:
        """Return the distribution with this cut."""
        return cls(cut)

    def quantile(self, probability: Array) -> Array:
        """Return amplitudes (k,) at probabilities (k,), in standard deviations of a component."""
        reach = np.sqrt(0.5 * np.pi) + self.cut * np.sqrt(2.0 - 0.5 * np.pi)
        kept = -np.expm1(-0.5 * reach**2)
        return np.asarray(np.sqrt(-2.0 * np.log1p(-probability * kept)), dtype=np.float64)


@distribution
@dataclass(frozen=True)
class Exponential(Distribution):
    """Exponential distribution, truncated ``cut`` standard deviations above the mean."""

    name: ClassVar[str] = "exponential"
    cut: float = 3.0

    @classmethod
    def from_options(cls, cut: float, quantiles: tuple[float, ...], probabilities: tuple[float, ...]) -> Distribution:
        """Return the distribution with this cut."""
        return cls(cut)

    def quantile(self, probability: Array) -> Array:
        """Return amplitudes (k,) at probabilities (k,), in means before truncation."""
        kept = -np.expm1(-(1.0 + self.cut))
        return np.asarray(-np.log1p(-probability * kept), dtype=np.float64)


@distribution
@dataclass(frozen=True)
class Binary(Distribution):
    """Both ends of the range with equal probability; an odd number of samples has one more at the lower end."""

    name: ClassVar[str] = "binary"

    def quantile(self, probability: Array) -> Array:
        """Return amplitudes (k,), -1 or 1, at probabilities (k,)."""
        return np.where(probability > 0.5, 1.0, -1.0)


@distribution
@dataclass(frozen=True)
class Quantiles(Distribution):
    """Distribution given by a table of quantiles, interpolated linearly.

    ``values`` (m,) belong to ``probabilities`` (m,), by default evenly spaced from 0 to 1. The lowest value is scaled
    to the lower end of the range and the highest to the upper end. A repeated value is held for the share of time
    between its probabilities.

    Raises:
        UnusableInputError: the tables are not a quantile function.
    """

    name: ClassVar[str] = "quantiles"
    values: tuple[float, ...]
    probabilities: tuple[float, ...] = ()

    @classmethod
    def from_options(cls, cut: float, quantiles: tuple[float, ...], probabilities: tuple[float, ...]) -> Distribution:
        """Return the distribution of the given tables."""
        return cls(quantiles, probabilities)

    def __post_init__(self) -> None:
        if len(self.values) < 2:
            raise UnusableInputError(
                "quantiles.few", "quantiles need at least 2 values, not {values}", values=len(self.values)
            )
        if any(b < a for a, b in pairwise(self.values)):
            raise UnusableInputError("quantiles.fall", "the values of quantiles must not decrease: sort them")
        if not self.values[-1] > self.values[0]:
            raise UnusableInputError(
                "quantiles.equal",
                "all values of the quantiles are {values:g}: give at least two",
                values=self.values[0],
            )
        if not _MIN_SPAN <= self.values[-1] - self.values[0] <= _MAX_SPAN:
            raise UnusableInputError(
                "quantiles.scale",
                "the quantiles from {low:g} to {high:g} cannot be scaled to a range: give values closer to 1",
                low=self.values[0],
                high=self.values[-1],
            )
        if not self.probabilities:
            return
        if len(self.probabilities) != len(self.values):
            raise UnusableInputError(
                "quantiles.lengths",
                "quantiles need a probability for each value: {values} values, {probabilities} probabilities",
                values=len(self.values),
                probabilities=len(self.probabilities),
            )
        if self.probabilities[0] != 0.0 or self.probabilities[-1] != 1.0:
            raise UnusableInputError("quantiles.ends", "the probabilities of quantiles must begin at 0 and end at 1")
        if any(b <= a for a, b in pairwise(self.probabilities)):
            raise UnusableInputError("quantiles.rise", "the probabilities of quantiles must be strictly rising")

    def quantile(self, probability: Array) -> Array:
        """Return amplitudes (k,) at probabilities (k,), in the unit of the values."""
        given = self.probabilities or np.linspace(0.0, 1.0, len(self.values))
        return np.asarray(np.interp(probability, given, self.values), dtype=np.float64)


def kolmogorov_distance(values: Array, levels: Array) -> float:
    """Return the Kolmogorov-Smirnov distance between the empirical distributions of values (n,) and levels (m,)."""
    sorted_values, sorted_levels = np.sort(values), np.sort(levels)
    steps = np.concatenate([sorted_values, sorted_levels])
    share = np.searchsorted(sorted_values, steps, side="right") / sorted_values.size
    wanted = np.searchsorted(sorted_levels, steps, side="right") / sorted_levels.size
    return float(np.max(np.abs(share - wanted)))
