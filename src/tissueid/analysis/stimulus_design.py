"""Comparison of a designed stimulus with its specification: amplitudes, autocorrelation, lines, load of the coil."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.formatting import fixed, number, with_unit
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.stimuli import Stimulus, StimulusKind, parse_description
from tissueid.stimuli.distributions import kolmogorov_distance
from tissueid.stimuli.interchange import InterchangeResult, autocorrelation
from tissueid.stimuli.kinds.designed import Designed
from tissueid.stimuli.kinds.multisine import Multisine
from tissueid.stimuli.shape_options import Shaped
from tissueid.stimuli.stimulus_check import StimulusCheck

LAGS = 500
"""Lags over which the error of the autocorrelation is summed where the stimulus does not say."""

_GRID = 1 << 13
"""Samples of a transform on whose frequencies a target's power is drawn."""

Array = NDArray[np.float64]
Row = tuple[str, str]


@dataclass(frozen=True, eq=False)
class StimulusDesign:
    """A stimulus, the device that is to play it, and the check of the two.

    ``search`` is the interchange that led to it, where there was one and it is known.
    """

    stimulus: Stimulus
    device: DeviceDescription
    appraisal: StimulusCheck
    search: InterchangeResult | None = None

    @cached_property
    def specification(self) -> StimulusKind:
        """What it was built from, without its preload."""
        return parse_description(self.stimulus.description)[0]

    @cached_property
    def played(self) -> Array:
        """The values after the preload, (n,)."""
        return self.stimulus.values[round(self.stimulus.preload_s * self.stimulus.sample_rate_hz) :]

    @cached_property
    def intended_amplitudes(self) -> Array | None:
        """Specified amplitudes (n,), ascending, in the unit of the stimulus; None if not specified."""
        kind = self.specification
        if not isinstance(kind, Shaped):
            return None
        return kind.scale_to_range(kind.build_distribution().levels(self.played.size))

    @cached_property
    def autocorrelation(self) -> Array:
        """Its autocorrelation (lags + 1,) from lag 0, as the interchange counts it.

        Raises:
            UnusableInputError: the values do not vary, or are too few.
        """
        if self.played.size < 3:
            raise UnusableInputError("design.too_short", "the stimulus is too short for an autocorrelation")
        return autocorrelation(self.played, min(self.lags, self.played.size - 2))

    @property
    def lags(self) -> int:
        """Number of lags of the autocorrelation."""
        return int(getattr(self.specification, "lags", LAGS))

    @cached_property
    def target_autocorrelation(self) -> Array | None:
        """The autocorrelation (lags + 1,) that was asked for; None where none was."""
        kind = self.specification
        if not isinstance(kind, Shaped):
            return None
        return kind.build_spectrum().autocorrelation(self.autocorrelation.size - 1, kind.sample_rate)

    @property
    def autocorrelation_error(self) -> float | None:
        """Sum of squared differences from the target over lags 1 to the last (Chen 2010, 6.1)."""
        target = self.target_autocorrelation
        if target is None:
            return None
        apart = (self.autocorrelation - target)[1:]
        return float(apart @ apart)

    @cached_property
    def target_power(self) -> tuple[Array, Array] | None:
        """Frequencies, Hz, and specified power density of any scale; None if not specified."""
        kind = self.specification
        if not isinstance(kind, Shaped):
            return None
        density = kind.build_spectrum().power(_GRID, kind.sample_rate)
        return np.asarray(np.fft.rfftfreq(_GRID, 1.0 / kind.sample_rate), dtype=np.float64), density

    @property
    def amplitude_distance(self) -> float | None:
        """Largest difference of the distribution of amplitudes from the intended one, 0 to 1."""
        wanted = self.intended_amplitudes
        return None if wanted is None else kolmogorov_distance(self.played, wanted)

    def rows(self) -> tuple[Row, ...]:
        """Return what was found, as label and value."""
        return (*_check_rows(self.appraisal), *self._rows())

    def answer(self) -> dict[str, Any]:
        """Return what was reached of what was asked for, as JSON holds it; None where nothing was asked."""
        kind, search = self.specification, self.search
        return {
            "amplitude_distance": self.amplitude_distance,
            # A constant signal, such as that of a quiet test, has none.
            "autocorrelation_lags": self.autocorrelation.size - 1 if np.ptp(self.played) > 0.0 else None,
            "autocorrelation_error": self.autocorrelation_error,
            "interchange": None
            if search is None
            else {
                "error_before": search.error_before,
                "error": search.error,
                "tried": search.tried,
                "accepted": search.accepted,
                "drift": search.drift,
            },
            "lines": None
            if not isinstance(kind, Multisine)
            else {
                "resolution_hz": kind.resolution_hz,
                "driven": kind.driven_lines().tolist(),
                "detection": kind.detection_lines().tolist(),
            },
        }

    def _rows(self) -> Iterator[Row]:
        distance, error, kind = self.amplitude_distance, self.autocorrelation_error, self.specification
        if distance is not None:
            yield (
                marked("Largest deviation from the intended distribution"),
                Message("design.deviation", "{percent} % of the samples", percent=number(100.0 * distance, 2)),
            )
        if error is not None:
            lags = self.autocorrelation.size - 1
            label = Message("design.correlation_error", "Autocorrelation, squared error over {lags} lags", lags=lags)
            yield label, number(error, 2)
        if self.search is not None:
            yield (
                marked("Swaps accepted"),
                Message(
                    "design.swaps",
                    "{accepted} of {tried} tried",
                    accepted=self.search.accepted,
                    tried=self.search.tried,
                ),
            )
        if isinstance(kind, Designed):
            shares = ", ".join(number(100.0 * std, 2) for std in kind.predicted_std)
            yield (
                marked("Predicted uncertainty of mass, damping, stiffness"),
                Message("design.uncertainty", "{shares} % (standard deviations)", shares=shares),
            )
        if isinstance(kind, Multisine):
            driven, detection = kind.driven_lines(), kind.detection_lines()
            yield (
                marked("Lines driven"),
                Message(
                    "design.lines",
                    "{count}, at multiples of {spacing} Hz",
                    count=int(driven.size),
                    spacing=number(kind.resolution_hz),
                ),
            )
            yield marked("Detection lines"), str(detection.size) if detection.size else marked("none")


def _check_rows(check: StimulusCheck) -> Iterator[Row]:
    yield marked("Length"), with_unit(fixed(check.seconds, 2), "s")
    yield marked("Range of force"), _range(check.force_min_n, check.force_max_n, 2, "N")
    yield marked("Command, coil at rest"), _range(check.voltage_min_v, check.voltage_max_v, 1, "V")
    yield marked("Mean and standard deviation"), f"{fixed(check.force_mean_n, 2)} N, {fixed(check.force_std_n, 2)} N"
    yield marked("Crest factor"), fixed(check.crest_factor, 2)
    yield (
        marked("95 % and 99 % of the power below"),
        f"{fixed(check.power_95_hz, 0)} Hz, {fixed(check.power_99_hz, 0)} Hz",
    )
    yield (
        marked("Steepest edge"),
        Message(
            "design.edge",
            "{edge} N/ms, {ratio} times that of painless noise",
            edge=fixed(check.steepest_edge_n_per_ms, 2),
            ratio=fixed(check.edge_ratio, 1),
        ),
    )
    yield marked("Current, rms and peak"), f"{fixed(check.rms_current_a, 2)} A, {fixed(check.peak_current_a, 2)} A"
    warmth = check.heating
    yield (
        marked("Heating of the coil"),
        Message(
            "design.heating",
            "{expected} K ({least} to {most} K)",
            expected=fixed(warmth.expected_k, 1),
            least=fixed(warmth.least_k, 1),
            most=fixed(warmth.most_k, 1),
        ),
    )


def _range(low: float, high: float, decimals: int, unit: str) -> Message:
    values = {"low": fixed(low, decimals), "high": fixed(high, decimals), "unit": unit}
    return Message("design.range", "{low} to {high} {unit}", **values)
