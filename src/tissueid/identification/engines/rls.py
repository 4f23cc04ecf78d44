"""Recursive least squares: the response is updated at each sample."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tissueid.identification.base import Array, option
from tissueid.identification.correlation import convolve_at_rest
from tissueid.identification.impulse_response import kernel_std, memory_warnings
from tissueid.identification.model_family import Family
from tissueid.identification.online import recursive_least_squares as recursion
from tissueid.identification.online.identifier import Identifier, OnlineEngine, OnlineModel
from tissueid.identification.preparation import SAMPLES_PER_PARAMETER, PreparedRecord, prepare
from tissueid.identification.registry import engine
from tissueid.identification.second_order_fit import fit_second_order
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Record

_RETAINED_TIME_CONSTANTS = 4.0
"""Time constants of forgetting after which the weight of a residual is neglected."""


@dataclass(frozen=True, eq=False)
class RlsModel(OnlineModel):
    """The response after the last sample, with its standard deviations ``impulse_response_std`` (lags,)."""

    impulse_response_std: Array


class RlsIdentifier(Identifier):
    """State of recursive least squares during a record; created by :meth:`Rls.start`.

    ``first_variance`` is the initial variance of every lag of the response per sample, for output noise of unit
    variance: one over the ridge.
    """

    options: Rls

    def __init__(
        self,
        options: Rls,
        sample_rate_hz: float,
        input_std: float,
        operating_point: tuple[float | None, float | None],
        units: tuple[str, str] = ("N", "m"),
        begin: int = 0,
    ) -> None:
        super().__init__(options, sample_rate_hz, operating_point, units, begin)
        self._constant = input_std
        self.first_variance = options.covariance / input_std**2
        self._triangle, self._work, self._scalars = recursion.start(
            self.lags, self.first_variance, self._constant, options.forgetting
        )

    def _advance(self, u: Array, y: Array, errors: Array) -> None:
        recursion.advance(self._triangle, self._work, self._scalars, u, y, errors)

    def _response(self) -> Array:
        return self._work[recursion.COEFFICIENTS, : self.lags]

    @property
    def offset(self) -> float:
        """Output at the operating point of the input."""
        return self.output_mean + self._constant * float(self._work[recursion.COEFFICIENTS, self.lags])

    @property
    def covariance(self) -> Array:
        """Covariance of the response per sample, (lags, lags), for white output noise of unit variance (Eq. 6.4)."""
        return recursion.covariance(self._triangle, self._work, self._scalars)[: self.lags, : self.lags]

    @property
    def updates(self) -> int:
        """Number of samples used for updates."""
        return int(self._scalars[recursion.UPDATES])


@engine
class Rls(OnlineEngine):
    """RLS engine.

    Assumes a linear system whose response decays within ``memory``, and output noise that is independent of the input.
    With a forgetting factor of 1 the response equals the regularised least-squares solution over all samples, to
    rounding; below 1, older samples weigh less but the ridge does not, so that the covariance is bounded.
    """

    name: ClassVar[str] = "rls"
    label: ClassVar[str] = "RLS"
    title: ClassVar[str] = marked(
        "Recursive least-squares finite impulse response (Chen 2010, Eqs. 6.1-6.5) with an offset."
    )
    family: ClassVar[Family] = Family.LINEAR
    identifier: ClassVar[type[RlsIdentifier]] = RlsIdentifier

    forgetting: float = option(
        1.0,
        marked("Forgetting factor"),
        marked("Weight of each sample relative to the next; 1 forgets nothing"),
        ge=0.9,
        le=1.0,
    )
    covariance: float = option(
        200.0,
        marked("Initial variance"),
        marked("Initial variance of the response, relative to the ratio of noise and input variance"),
        gt=0.0,
        le=1e6,
    )

    def fit(self, record: Record, fit_part: slice | None = None) -> RlsModel:
        """Run the recursion over a record, or over a contiguous part of it.

        Raises:
            UnusableInputError: nothing varies, too few samples, or a memory longer than the part.
        """
        prepared = prepare(record, fit_part, self.memory_s)
        return self.model_of(self.run(prepared), prepared)

    def model_of(self, identifier: RlsIdentifier, prepared: PreparedRecord) -> RlsModel:
        """Return the model of an identifier, scored on a prepared record."""
        record, used = prepared.record, prepared.used
        lags, rate = identifier.lags, identifier.sample_rate_hz
        kernel = identifier.impulse_response / rate
        x = record.input - identifier.input_mean
        modelled = identifier.offset + convolve_at_rest(kernel, x)
        residuals = np.where(used, record.output - modelled, np.nan)
        covariance = identifier.covariance
        second_order = fit_second_order(record, used, self.hold)
        warnings, findings = self._warnings(identifier, covariance)
        trajectory, trajectory_s, trajectory_position = identifier.trajectory
        return RlsModel(
            report=self.report(
                record,
                used,
                modelled,
                lags + 1,
                parameters=second_order.parameters,
                warnings=(*prepared.warnings, *warnings, *memory_warnings(kernel), *second_order.warnings),
                findings=findings,
                details={
                    "vaf_tracking_percent": identifier.tracking_vaf_percent,
                    "vaf_parametric_percent": second_order.vaf_percent,
                },
            ),
            sample_rate_hz=rate,
            memory_samples=lags,
            impulse_response=kernel * rate,
            impulse_response_std=self.response_std(identifier, covariance, x, residuals, prepared.part) * rate,
            lag_s=identifier.lag_s,
            input_mean=identifier.input_mean,
            output_mean=identifier.offset,
            trajectory=trajectory,
            trajectory_s=trajectory_s,
            trajectory_position=trajectory_position,
            second_order=second_order,
        )

    def response_std(
        self, identifier: RlsIdentifier, covariance: Array, x: Array, residuals: Array, part: slice
    ) -> Array:
        """Return the standard deviation of each lag (lags,) for coloured noise, with the weights of forgetting."""
        forgetting, n = self.forgetting, identifier.updates
        weight = weight_squares = float(n)
        begin = part.start
        if forgetting < 1.0:
            weight = (1.0 - forgetting**n) / (1.0 - forgetting)
            weight_squares = (1.0 - forgetting ** (2 * n)) / (1.0 - forgetting**2)
            remembered = round(_RETAINED_TIME_CONSTANTS / (1.0 - forgetting))
            begin = max(begin, part.stop - max(remembered, 4 * identifier.lags))
        recent = slice(begin, part.stop)
        known = int(np.isfinite(residuals[recent]).sum())
        about = x[recent] - np.nanmean(
            x[recent]
        )  # during a test the operating point may differ from the mean; the offset compensates
        std = kernel_std(covariance * weight, about, residuals[recent])
        return std * float(np.sqrt(known * weight_squares) / weight)

    def _warnings(self, identifier: RlsIdentifier, covariance: Array) -> tuple[list[str], tuple[str, ...]]:
        """Return a warning if the memory exceeds the retained samples, and a finding on directions that are not
        excited.
        """
        lags = identifier.lags
        warnings: list[str] = []
        remembered = 1.0 / (1.0 - self.forgetting) if self.forgetting < 1.0 else np.inf
        if remembered < SAMPLES_PER_PARAMETER * lags:
            warnings.append(
                Message(
                    "rls.short_memory",
                    "a forgetting factor of {forgetting:g} retains {samples:.0f} samples for {lags} lags, fewer than "
                    "{fewest} for each: raise it, or shorten the memory",
                    forgetting=self.forgetting,
                    samples=remembered,
                    lags=lags,
                    fewest=SAMPLES_PER_PARAMETER,
                )
            )
        unexcited = min(lags, round(float(np.trace(covariance)) / identifier.first_variance))
        if unexcited == 0:
            return warnings, ()
        if self.forgetting < 1.0:
            finding = Message(
                "rls.bounded",
                "the input does not excite {unexcited} of {lags} directions of the response: the ridge determines "
                "them and is not forgotten, so that the covariance stays bounded",
                unexcited=unexcited,
                lags=lags,
            )
        else:
            finding = Message(
                "rls.unexcited",
                "the input does not excite {unexcited} of {lags} directions of the response: the ridge determines them",
                unexcited=unexcited,
                lags=lags,
            )
        return warnings, (finding,)
