"""A distribution and an autocorrelation, both as asked: the first exactly, the second to a stated error."""

from __future__ import annotations

from typing import ClassVar, Self

from pydantic import Field, model_validator

from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.stimuli.autocorrelation_bounds import least_error
from tissueid.stimuli.base import Stimulus, stimulus
from tissueid.stimuli.interchange import Interchanged, OnProgress, arrange, interchange
from tissueid.stimuli.shape_options import DistributionName, Shaped


@stimulus
class Interchange(Shaped):
    """Amplitudes exactly as the distribution has them, in an order whose autocorrelation is as asked (Chen 2010, 6.1).

    Samples are exchanged until the sum of squared differences of the autocorrelation from the target, over ``lags``
    lags, is at most ``tolerance`` (Hunter and Kearney 1983; see :mod:`tissueid.stimuli.interchange` for the definition
    and the method). What no order of the samples can reach is refused before the search where it is known, and after
    it otherwise.

    The history begins with the amplitude nearest its mean, where it crosses it.
    """

    name: ClassVar[str] = "interchange"
    title: ClassVar[str] = marked("Exact amplitudes and spectrum")

    distribution: DistributionName = Field("uniform", description=marked("Distribution over the range"))
    lags: int = Field(500, ge=1, le=5000, description=marked("Lags over which the autocorrelation is to be right"))
    tolerance: float = Field(
        1e-6,
        ge=1e-12,
        le=1.0,
        description=marked("Sum of squared differences of the autocorrelation over the lags, at most"),
    )
    max_trials: int = Field(2_000_000, ge=1, le=10**9, description=marked("Swaps to try before giving up"))

    @model_validator(mode="after")
    def _can_be_reached(self) -> Self:
        if self.lags > self.samples // 2:
            raise UnusableInputError(
                Message(
                    "interchange.lags",
                    "{lags} lags need at least {needed} samples, not {samples}: ask for fewer lags or a "
                    "longer stimulus",
                    lags=self.lags,
                    needed=2 * self.lags,
                    samples=self.samples,
                )
            )
        levels = self.wanted_distribution().levels(self.samples)
        bound = least_error(levels, self.wanted_spectrum().autocorrelation(self.lags, self.sample_rate))
        if bound.error > self.tolerance:
            raise UnusableInputError(
                Message(
                    "interchange.unreachable",
                    "no {distribution} signal has this autocorrelation: {reason}; the error cannot fall "
                    "below {error:.2g}, and {tolerance:g} was asked for",
                    distribution=self.distribution,
                    reason=bound.reason,
                    error=bound.error,
                    tolerance=self.tolerance,
                )
            )
        return self

    def design(self, on_progress: OnProgress | None = None) -> Interchanged:
        """Search for the order, of amplitudes over -1 to 1. What comes of it may have fallen short."""
        spectrum = self.wanted_spectrum()
        levels = self.wanted_distribution().levels(self.samples)
        return interchange(
            arrange(levels, spectrum, self.lags, self.sample_rate, self.seed),
            spectrum.autocorrelation(self.lags, self.sample_rate),
            tolerance=self.tolerance,
            max_trials=self.max_trials,
            seed=self.seed,
            on_progress=on_progress,
        )

    def played(self, designed: Interchanged) -> Stimulus:
        """The history, N or V, of a design of this specification.

        Raises:
            UnusableInputError: the design fell short of the tolerance.
        """
        if not designed.reached:
            hint = ""
            if self.distribution == "binary":
                error = _coarse(designed)
                hint = Message("interchange.binary", " (two-valued ones stop at about {error:.1g})", error=error)
            raise UnusableInputError(
                Message(
                    "interchange.not_reached",
                    "after {tried} tried swaps the error of the autocorrelation over {lags} lags is "
                    "{error:.2g}, not {tolerance:g}{hint}: allow more (max_trials), ask for less (tolerance, "
                    "lags) or for a longer stimulus",
                    tried=designed.tried,
                    lags=designed.lags,
                    error=designed.error,
                    tolerance=self.tolerance,
                    hint=hint,
                )
            )
        return self.as_stimulus(designed.values)

    def build(self) -> Stimulus:
        """Build the history, shape (seconds * sample_rate,), N or V.

        Raises:
            UnusableInputError: the tolerance was not reached.
        """
        return self.played(self.design())


def _coarse(designed: Interchanged) -> float:
    """The error at which a white two-valued signal comes to rest, from the lags per sample.

    A swap changes every lag by 4 / n or so whatever the lag is off by. Of all n^2 / 4 swaps the best is five to six
    standard deviations better than the mean one, and no longer an improvement at this error.
    """
    return (designed.lags / designed.values.size) ** 2 / 7.0
