"""Stimulus with an exact amplitude distribution and an autocorrelation within a stated error."""

from __future__ import annotations

from typing import ClassVar, Self

from pydantic import Field, model_validator

from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.stimuli.autocorrelation_bounds import error_bound
from tissueid.stimuli.base import Stimulus, stimulus
from tissueid.stimuli.interchange import InterchangeResult, OnProgress, initial_arrangement, interchange
from tissueid.stimuli.shape_options import DistributionName, Shaped


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
