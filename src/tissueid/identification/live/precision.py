"""Precision of mass, damping and stiffness, estimated from a record so far."""

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
"""Factor on the standard deviations of a fit during a test, because of repeated looks.

A test that ends at a target standard deviation tends to end at a low estimate of it. Without the factor, the 95 %
intervals contained 93 to 95 % of the damping and 97 to 99 % of mass and stiffness at the end of such tests.
"""


@dataclass(frozen=True)
class Precision:
    """The second-order fit to a record so far, with the relative standard deviations of its parameters.

    ``seconds`` is the length of the record. ``relative_std`` holds the standard deviation of mass, damping and
    stiffness divided by the value, widened by ``WIDENING``, and infinite if unknown.
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
    """Fit the second-order system to all of a record, as ``lms`` does, and return it with the precision of its
    parameters.

    The standard deviations account for autocorrelated residuals, also those due to nonlinearity
    (:func:`fit_second_order`). Every call searches again from the start: a search that continues from the previous
    result can stay in a local minimum with a small standard deviation.

    Args:
        record: force and position so far, without the preload.
        memory: seconds that are not fitted at the start and after each gap.
        hold: course of the input between samples.

    Raises:
        UnusableInputError: nothing varies, or the record is shorter than its memory.
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
