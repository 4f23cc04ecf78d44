"""A distribution and an autocorrelation, both as asked: the first exactly, the second to a stated error."""

from __future__ import annotations

from typing import ClassVar, Self

from pydantic import Field, model_validator

from tissueid.errors import UnusableInputError
from tissueid.stimuli.base import Stimulus, stimulus
from tissueid.stimuli.distributions import DistributionName
from tissueid.stimuli.interchange import Interchanged, OnProgress, arrange, interchange
from tissueid.stimuli.joint_limits import least_error
from tissueid.stimuli.shaped import Shaped


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

    distribution: DistributionName = Field("uniform", description="Distribution over the range")
    lags: int = Field(500, ge=1, le=5000, description="Lags over which the autocorrelation is to be right")
    tolerance: float = Field(
        1e-6, ge=1e-12, le=1.0, description="Sum of squared differences of the autocorrelation over the lags, at most"
    )
    max_trials: int = Field(2_000_000, ge=1, le=10**9, description="Swaps to try before giving up")

    @model_validator(mode="after")
    def _can_be_reached(self) -> Self:
        if self.lags > self.samples // 2:
            raise UnusableInputError(
                f"{self.lags} lags need at least {2 * self.lags} samples, not {self.samples}: "
                "ask for fewer lags or a longer stimulus"
            )
        levels = self.wanted_distribution().levels(self.samples)
        bound = least_error(levels, self.wanted_spectrum().autocorrelation(self.lags, self.sample_rate))
        if bound.error > self.tolerance:
            raise UnusableInputError(
                f"no {self.distribution} signal has this autocorrelation: {bound.reason}; the error cannot fall below "
                f"{bound.error:.2g}, and {self.tolerance:g} was asked for"
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
            hint = f" (two-valued ones stop at about {_coarse(designed):.1g})" if self.distribution == "binary" else ""
            raise UnusableInputError(
                f"after {designed.tried} tried swaps the error of the autocorrelation over {designed.lags} lags is "
                f"{designed.error:.2g}, not {self.tolerance:g}{hint}: allow more (max_trials), ask for less "
                "(tolerance, lags) or for a longer stimulus"
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
