"""How well a record so far determines mass, damping and stiffness."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from tissueid.identification.preparation import prepare
from tissueid.identification.second_order import Hold
from tissueid.identification.second_order_fit import SecondOrderFit, fit_second_order
from tissueid.records import Estimate, Record

Parameter = Literal["mass", "damping", "stiffness"]
PARAMETERS: tuple[Parameter, ...] = get_args(Parameter)

WIDENING = 1.05
"""What the standard deviations of a fit are multiplied with, because the fit is one of many looks.

A test that ends on its own standard deviation ends with one of the smaller ones. Without this, 93 to 95 % of the 95 %
intervals of the damping held at the end of such a test, and 97 to 99 % of those of mass and stiffness.
"""


@dataclass(frozen=True)
class Precision:
    """The second-order fit to a record so far, and what its standard deviations are worth.

    ``seconds`` is the length of the record. ``relative_std`` holds the standard deviation of each of mass, damping and
    stiffness over its value, widened by ``WIDENING``, and infinite where the record does not say.
    """

    seconds: float
    second_order: SecondOrderFit
    relative_std: dict[Parameter, float]

    @property
    def estimates(self) -> dict[Parameter, Estimate]:
        """Mass, damping and stiffness, kg, N s/m, N/m, with their standard deviations."""
        system, sign = self.second_order.system, self.second_order.sign
        values = (sign * system.mass, sign * system.damping, sign * system.stiffness)
        return {
            name: Estimate(value, abs(value) * spread if math.isfinite(spread := self.relative_std[name]) else None)
            for name, value in zip(PARAMETERS, values, strict=True)
        }


def precision(record: Record, memory: float = 0.125, hold: Hold = "band-limited") -> Precision:
    """Fit the second-order system to all of a record, as ``lms`` does, and say how well it is known.

    The standard deviations carry the dependence of neighbouring residuals and hold when the residual is what a
    nonlinear tissue does beyond the line (:func:`fit_second_order`). Every look searches afresh: begun where an earlier
    look ended, the search can stay in a minimum that the record has long contradicted, and be sure of it.

    Args:
        record: force and position so far, without the preload.
        memory: seconds; as many at the start and after each gap are not fitted.
        hold: what the input does between samples.

    Raises:
        UnusableInputError: nothing varies yet, or the record is shorter than its memory.
    """
    prepared = prepare(record, None, memory, len(PARAMETERS))
    fitted = fit_second_order(record, prepared.used, hold)
    return Precision(len(record) / record.sample_rate_hz, fitted, _relative(fitted))


def _relative(fitted: SecondOrderFit) -> dict[Parameter, float]:
    spread = np.full(len(PARAMETERS), np.inf)
    if fitted.log_covariance is not None:
        variance = np.diag(fitted.log_covariance)
        spread = np.where(np.isfinite(variance), WIDENING * np.sqrt(np.maximum(variance, 0.0)), np.inf)
    return dict(zip(PARAMETERS, spread.tolist(), strict=True))
