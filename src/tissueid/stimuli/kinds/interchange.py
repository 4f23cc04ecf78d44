"""Lower bounds of the autocorrelation error that samples of a given distribution can reach in any order.

Both conditions are necessary, not sufficient. They hold for the biased autocorrelation of each record of n samples,
not only on average, so that no rearrangement has an error below the bound.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.stimuli.base import Stimulus, stimulus
from tissueid.stimuli.interchange import InterchangeResult, OnProgress, initial_arrangement, interchange
from tissueid.stimuli.shape_options import DistributionName, Shaped

Array = NDArray[np.float64]

_TRIANGLE_LAGS = 500
"""Largest lag in the pairs of lags that are checked; the number of pairs grows with its square."""


@dataclass(frozen=True)
class Bound:
    """Lower bound of the error, a sum of squares over the lags, and the condition that it follows from."""

    error: float
    reason: str


def error_bound(levels: Array, target: Array) -> Bound:
    """Return a lower bound of the error for levels (n,) and a target autocorrelation (lags + 1,); 0 where unknown."""
    return max(_rearrangement_bound(levels, target), _two_valued_bound(levels, target), key=lambda bound: bound.error)


def _rearrangement_bound(levels: Array, target: Array) -> Bound:
    """Return the bound from the rearrangement inequality: the product sum of two orders is least for
    opposite orders.
    """
    about = np.sort(levels) - np.mean(levels)
    power = float(about @ about)
    least = float(about @ about[::-1]) / power
    lag = np.arange(1, target.size)
    missing = lag * float(np.max(np.abs(about))) ** 2 / power  # products that the end of the record leaves out
    short = np.maximum(least - missing - target[1:], 0.0)
    worst = int(np.argmax(short))
    return Bound(
        float(short @ short),
        Message(
            "autocorrelation.too_low",
            "at lag {lag} it is {value:.3g}, but the minimum for this distribution is {least:.3g}",
            lag=worst + 1,
            value=float(target[worst + 1]),
            least=least,
        ),
    )


def _two_valued_bound(levels: Array, target: Array) -> Bound:
    """Return the bound for two-valued samples: s r(j) + t r(k) + s t r(j + k) >= -1 with s, t = +-1.

    It holds because two of any three samples of +1 or -1 are equal. With s = t = -1 it is the triangle inequality for 1
    - r, the share of time in which two samples differ: the autocorrelation of a two-valued signal has a corner at lag
    0.
    """
    nothing = Bound(0.0, "")
    low, high = float(np.min(levels)), float(np.max(levels))
    lags = min(target.size - 1, _TRIANGLE_LAGS)
    if lags < 2 or not np.all((levels == low) | (levels == high)) or abs(float(np.mean(levels == low)) - 0.5) > 0.01:
        return nothing
    j, k = np.triu_indices(lags)
    j, k = j + 1, k + 1
    j, k = j[j + k <= lags], k[j + k <= lags]
    # With an odd number of samples one value occurs once more: this bounds the change of the mean and of each product.
    slack = 4.0 * abs(float(np.mean(levels == low)) - 0.5)
    best = nothing
    for s, t in ((-1.0, -1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, 1.0)):
        short = -1.0 - (s * target[j] + t * target[k] + s * t * target[j + k]) - slack
        size = np.where(j == k, (s + t) ** 2 + 1.0, 3.0)
        error = np.where(short > 0.0, short, 0.0) ** 2 / size
        worst = int(np.argmax(error))
        if error[worst] > best.error:
            a, b = int(j[worst]), int(k[worst])
            best = Bound(
                float(error[worst]),
                Message(
                    "autocorrelation.two_valued",
                    "its values {value:.4g}, {other_value:.4g} and {both_value:.4g} at lags {lag}, {other} and "
                    "{both} are impossible for a two-valued signal",
                    lag=a,
                    other=b,
                    both=a + b,
                    value=float(target[a]),
                    other_value=float(target[b]),
                    both_value=float(target[a + b]),
                ),
            )
    return best


@stimulus
class Interchange(Shaped):
    """Exact amplitude distribution with a prescribed autocorrelation (Chen 2010, 6.1).

    Samples are swapped until the sum of squared differences of the autocorrelation from the target, over ``lags`` lags,
    is at most ``tolerance`` (Hunter and Kearney 1983; see :mod:`tissueid.stimuli.interchange` for the definition and
    the method). A target below a known bound is rejected before the search, any other unreachable target after it.

    The history begins with the amplitude nearest its mean, at a mean crossing.
    """

    name: ClassVar[str] = "interchange"
    title: ClassVar[str] = marked("Exact amplitudes and spectrum")

    distribution: DistributionName = Field("uniform", description=marked("Distribution over the range"))
    lags: int = Field(
        500, ge=1, le=5000, description=marked("Number of lags at which the autocorrelation is prescribed")
    )
    tolerance: float = Field(
        1e-6,
        ge=1e-12,
        le=1.0,
        description=marked("Maximum sum of squared differences of the autocorrelation over the lags"),
    )
    max_trials: int = Field(2_000_000, ge=1, le=10**9, description=marked("Maximum number of swaps to try"))

    @model_validator(mode="after")
    def _check_reachable(self) -> Self:
        if self.lags > self.samples // 2:
            raise UnusableInputError(
                "interchange.lags",
                "{lags} lags need at least {needed} samples, not {samples}: use fewer lags or a longer stimulus",
                lags=self.lags,
                needed=2 * self.lags,
                samples=self.samples,
            )
        levels = self.build_distribution().levels(self.samples)
        bound = error_bound(levels, self.build_spectrum().autocorrelation(self.lags, self.sample_rate))
        if bound.error > self.tolerance:
            raise UnusableInputError(
                "interchange.unreachable",
                "no {distribution} signal has this autocorrelation: {reason}; the minimum error is "
                "{error:.2g}, above the tolerance of {tolerance:g}",
                distribution=self.distribution,
                reason=bound.reason,
                error=bound.error,
                tolerance=self.tolerance,
            )
        return self

    def design(self, on_progress: OnProgress | None = None) -> InterchangeResult:
        """Search for the order of the amplitudes, scaled to -1 to 1. The result may not have reached the tolerance."""
        spectrum = self.build_spectrum()
        levels = self.build_distribution().levels(self.samples)
        return interchange(
            initial_arrangement(levels, spectrum, self.lags, self.sample_rate, self.seed),
            spectrum.autocorrelation(self.lags, self.sample_rate),
            tolerance=self.tolerance,
            max_trials=self.max_trials,
            seed=self.seed,
            on_progress=on_progress,
        )

    def stimulus_from(self, designed: InterchangeResult) -> Stimulus:
        """Return the history, N or V, of a design of this specification.

        Raises:
            UnusableInputError: the design did not reach the tolerance.
        """
        if not designed.reached:
            hint = ""
            if self.distribution == "binary":
                error = _binary_error_floor(designed)
                hint = Message(
                    "interchange.binary", " (the minimum for a two-valued signal is about {error:.1g})", error=error
                )
            raise UnusableInputError(
                "interchange.not_reached",
                "after {tried} swaps the autocorrelation error over {lags} lags is {error:.2g}, above the "
                "tolerance of {tolerance:g}{hint}: raise max_trials or tolerance, use fewer lags or a "
                "longer stimulus",
                tried=designed.tried,
                lags=designed.lags,
                error=designed.error,
                tolerance=self.tolerance,
                hint=hint,
            )
        return self.as_stimulus(designed.values)

    def build(self) -> Stimulus:
        """Build the history, shape (seconds * sample_rate,), N or V.

        Raises:
            UnusableInputError: the tolerance was not reached.
        """
        return self.stimulus_from(self.design())


def _binary_error_floor(designed: InterchangeResult) -> float:
    """Return the error at which the search stalls for a white two-valued signal, from the lags per sample.

    A swap changes every lag by about 4 / n regardless of the error of the lag. The best of all n^2 / 4 swaps is five to
    six standard deviations better than the mean swap, which is no improvement below this error.
    """
    return (designed.lags / designed.values.size) ** 2 / 7.0
