"""What a Hammerstein fit tells beside its kernel and curve: its second-order stage, and the curve's shape."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tissueid.identification.base import Array, Mask
from tissueid.identification.second_order import Hold
from tissueid.identification.second_order_fit import SecondOrderFit, fit_second_order
from tissueid.identification.static_nonlinearity import StaticNonlinearity
from tissueid.identification.wiener.parameters import derived
from tissueid.records import Record

_CERTAIN = 2.0
"""Standard deviations by which a slope of the curve must differ from another, or from zero, to be said to."""

_FLAT = 0.05
"""Share of its steepest slope under which a curve is called flat."""

_SAME = 1e-9
"""Share of its steepest slope by which the slopes of a straight line differ."""

_QUANTILES = (0.05, 0.5, 0.95)


def fit_driven_stage(
    record: Record, used: Mask, nonlinearity: StaticNonlinearity, hold: Hold, start: SecondOrderFit | None = None
) -> SecondOrderFit:
    """Fit a second-order system to the linear stage: from what the curve makes of the input to the measured output.

    ``used`` (n,) masks the outputs to fit.
    """
    driven = replace(record, input=nonlinearity(record.input), input_unit=record.output_unit)
    return fit_second_order(driven, used, hold, start=start)


def told_of_curve(
    nonlinearity: StaticNonlinearity, covariance: Array, x: Array, mean_input: float, unit: str
) -> tuple[list[str], list[str]]:
    """Findings and warnings about a curve with a covariance (p, p) of its coefficients, over inputs x (k,)."""
    places = np.quantile(x, _QUANTILES)
    estimates = [derived(nonlinearity, covariance, lambda f, p=p: float(f.slope(np.array([p]))[0])) for p in places]  # type: ignore[misc]
    changes = [
        derived(nonlinearity, covariance, lambda f, a=a, b=b: float(np.diff(f.slope(np.array([a, b])))[0]))  # type: ignore[misc]
        for a, b in ((places[0], places[1]), (places[1], places[2]))
    ]
    steepest = max(abs(estimate.value) for estimate in estimates)
    findings, warnings = [], []
    if all(abs(change.value) <= max(_CERTAIN * (change.std or 0.0), _SAME * steepest) for change in changes):
        findings.append("the curve is straight within its uncertainty: a linear system says as much")
    else:
        shares = ", ".join(
            f"{100.0 * estimate.value / steepest:.0f} % at {place:.3g} {unit}"
            for estimate, place in zip(estimates, places, strict=True)
        )
        findings.append(f"the curve's slope as a share of its steepest: {shares}")
    if not nonlinearity.invertible:
        low, high = nonlinearity.monotone_range
        findings.append(f"the curve turns back: it keeps its direction from {low:.3g} to {high:.3g} {unit} only")
    here = derived(nonlinearity, covariance, lambda f: float(f.slope(np.array([mean_input]))[0]))
    if here.std is None or abs(here.value) <= max(_CERTAIN * here.std, _FLAT * steepest):
        warnings.append("the curve is flat at the mean input: mass, damping and stiffness have no meaning there")
    return findings, warnings
