"""Common options of stimuli with an amplitude distribution and a spectrum."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.stimuli import spectra
from tissueid.stimuli.base import Array, Ranged, Stimulus, crest_factor
from tissueid.stimuli.distributions import Distribution, distribution_names, get_distribution
from tissueid.stimuli.spectra import Spectrum, SpectrumName

if TYPE_CHECKING:
    DistributionName = str
else:
    DistributionName = Literal[distribution_names()]
    """Choices of the option ``distribution``: all registered distributions."""

_MAX_ROWS = 10_000
"""Largest number of rows of a table."""

_TABLES = {
    "quantiles": ("distribution", "quantiles"),
    "probabilities": ("distribution", "quantiles"),
    "frequencies_hz": ("spectrum", "power"),
    "densities": ("spectrum", "power"),
    "lags_s": ("spectrum", "autocorrelation"),
    "correlations": ("spectrum", "autocorrelation"),
}
"""Option and choice to which each table belongs."""


class Shaped(Ranged):
    """A stimulus with a given distribution over the range and a given spectrum."""

    applies: ClassVar[Mapping[str, tuple[str, tuple[object, ...]]]] = {
        "cutoff_hz": ("spectrum", ("butterworth", "band")),
        "order": ("spectrum", ("butterworth",)),
        "time_constant_s": ("spectrum", ("exponential",)),
        "natural_hz": ("spectrum", ("second_order",)),
        "damping": ("spectrum", ("second_order",)),
        **{table: (option, (choice,)) for table, (option, choice) in _TABLES.items()},
    }

    distribution: DistributionName = Field("gaussian", description=marked("Distribution over the range"))
    spectrum: SpectrumName = Field(
        "butterworth",
        description=marked(
            "Spectrum: low-pass (butterworth), flat (white, or up to the cutoff: band), by its autocorrelation "
            "(exponential, second_order), or a table (power, autocorrelation)"
        ),
    )
    cutoff_hz: float = Field(200.0, gt=0.0, description=marked("butterworth, band: cutoff frequency, Hz"))
    order: int = Field(8, ge=1, le=12, description=marked("butterworth: order of the low-pass"))
    time_constant_s: float = Field(0.005, gt=0.0, le=60.0, description=marked("exponential: time constant, s"))
    natural_hz: float = Field(40.0, gt=0.0, description=marked("second_order: undamped natural frequency, Hz"))
    damping: float = Field(0.3, gt=0.0, lt=1.0, description=marked("second_order: damping ratio"))
    frequencies_hz: tuple[float, ...] = Field(
        (), max_length=_MAX_ROWS, description=marked("power: frequencies, Hz, rising")
    )
    densities: tuple[float, ...] = Field(
        (), max_length=_MAX_ROWS, description=marked("power: density at each, in any unit")
    )
    lags_s: tuple[float, ...] = Field(
        (), max_length=_MAX_ROWS, description=marked("autocorrelation: lags, s, from 0, rising")
    )
    correlations: tuple[float, ...] = Field(
        (), max_length=_MAX_ROWS, description=marked("autocorrelation: value at each lag")
    )
    quantiles: tuple[float, ...] = Field(
        (), max_length=_MAX_ROWS, description=marked("quantiles: values in ascending order")
    )
    probabilities: tuple[float, ...] = Field(
        (),
        max_length=_MAX_ROWS,
        description=marked("quantiles: probability of each value, 0 to 1; evenly spaced by default"),
    )
    cut: float = Field(
        3.0, ge=1.0, le=6.0, description=marked("Truncation of infinite tails, in standard deviations from the mean")
    )
    seconds: float = Field(4.0, gt=0.0, le=600.0, description=marked("Length, s"))
    sample_rate: float = Field(2000.0, gt=0.0, le=1e6, description=marked("Sample rate, Hz"))
    seed: int = Field(0, ge=0, le=2**63 - 1, description=marked("Random seed: the same seed gives the same samples"))

    @model_validator(mode="after")
    def _check_shape(self) -> Self:
        for table, (option, choice) in _TABLES.items():
            if getattr(self, table) and getattr(self, option) != choice:
                raise UnusableInputError(
                    "shape.table",
                    "{table} need {option} '{choice}': set it or omit {table}",
                    table=table,
                    option=option,
                    choice=choice,
                )
        if self.samples < 16:
            raise UnusableInputError(
                "shape.short",
                "{seconds:g} s at {sample_rate:g} Hz is too short for {name}",
                seconds=self.seconds,
                sample_rate=self.sample_rate,
                name=self.name,
            )
        self.check_size()
        self.build_distribution()
        self.build_spectrum().check(self.sample_rate)
        self._check_power()
        return self

    def _check_power(self) -> None:
        """Raise for a spectrum without finite power at the frequencies of a record of this length."""
        if self.spectrum == "butterworth":
            return
        with np.errstate(all="ignore"):
            total = float(np.sum(self.build_spectrum().power(self.samples, self.sample_rate)[1:]))
        if not np.finfo(np.float64).tiny <= total < np.inf:
            raise UnusableInputError(
                "shape.no_power",
                "the spectrum has no power at multiples of {samples:.3g} Hz, the resolution of {seconds:g} "
                "s: use a wider spectrum or a longer stimulus",
                samples=self.sample_rate / self.samples,
                seconds=self.seconds,
            )

    @property
    def samples(self) -> int:
        """Length in samples."""
        return round(self.seconds * self.sample_rate)

    def build_distribution(self) -> Distribution:
        """Return the distribution, over -1 to 1.

        Raises:
            UnusableInputError: the table of quantiles is not valid.
        """
        kind = get_distribution(self.distribution)
        return kind.from_options(self.cut, self.quantiles, self.probabilities)

    def build_spectrum(self) -> Spectrum:
        """Return the spectrum.

        Raises:
            UnusableInputError: the table of power or autocorrelation is not valid.
        """
        match self.spectrum:
            case "butterworth":
                return spectra.Butterworth(self.cutoff_hz, self.order)
            case "white":
                return spectra.White()
            case "band":
                return spectra.Band(self.cutoff_hz)
            case "exponential":
                return spectra.ExponentialDecay(self.time_constant_s)
            case "second_order":
                return spectra.SecondOrderSpectrum(self.natural_hz, self.damping)
            case "power":
                return spectra.PowerTable(self.frequencies_hz, self.densities)
            case "autocorrelation":
                return spectra.AutocorrelationTable(self.lags_s, self.correlations)

    def scale_to_range(self, unit: Array) -> Array:
        """Return values (n,) over the range for values (n,) over -1 to 1."""
        low, high, _ = self.span
        return np.asarray(low + 0.5 * (unit + 1.0) * (high - low), dtype=np.float64)

    def as_stimulus(self, unit: Array) -> Stimulus:
        """Return the stimulus with these values (n,) over -1 to 1."""
        values = self.scale_to_range(unit)
        return Stimulus(
            values=values,
            sample_rate_hz=self.sample_rate,
            description=self.describe(),
            seed=self.seed,
            crest_factor=crest_factor(values),
            unit=self.span[2],
        )
