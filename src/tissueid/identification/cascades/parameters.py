"""Mass, damping and stiffness of a cascade linearised at rest, each with its standard deviation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tissueid.identification.base import Array, Mask
from tissueid.identification.cascades.blocks import Blocks
from tissueid.identification.cascades.normalisation import Normalised, Uncertainty
from tissueid.identification.correlation import convolve_at_rest
from tissueid.identification.second_order import Hold
from tissueid.identification.second_order_fit import SecondOrderFit, fit_second_order
from tissueid.identification.static_nonlinearity import StaticNonlinearity
from tissueid.messages import Message
from tissueid.records import Estimate, Record

_FLAT = 0.05
"""Slope at rest below which a curve counts as flat there, relative to its steepest slope."""

_PLACES = 101


def fit_linearised(normal: Normalised, record: Record, used: Mask, residuals: Array, hold: Hold) -> SecondOrderFit:
    """Fit the second-order system of the cascade linearised at rest; its residuals (n,) are the noise."""
    x = np.where(np.isfinite(record.input), record.input - normal.input_mean, 0.0)
    small = normal.offset + convolve_at_rest(normal.small_signal_kernel(), x)
    return fit_second_order(replace(record, output=small + residuals), used, hold)


FLAT = Message(
    "hammerstein.flat", "the curve is flat at the mean input: mass, damping and stiffness have no meaning there"
)
"""Warning where the slope of a static curve vanishes at the mean input."""


def parameters_at_rest(
    normal: Normalised, normalise: Callable[[Blocks], Normalised], known: Uncertainty, small: SecondOrderFit
) -> tuple[dict[str, Estimate], list[str]]:
    """Return named estimates at the mean input, and a warning for a curve that is flat there.

    The ratios of mass and damping to stiffness come from the second-order system. The standard deviations also include
    the uncertainty of the curves' slopes, which that system assumes to be known.
    """
    parameters = small.parameters
    if normal.inner is None and normal.outer is None:
        return parameters, []
    if _flat(normal.inner, normal.input_mean) or _flat(normal.outer, 0.0):
        plain = {name: Estimate(estimate.value) for name, estimate in parameters.items()}
        return plain, [FLAT]

    def log_gain(some: Blocks) -> Array:
        return np.log(np.abs([np.sum(normalise(some).small_signal_kernel())]))

    spread = float(np.sqrt(max(0.0, float(known.of(log_gain)[0, 0]))))
    ratios = {"mass_kg": (1.0, 0.0, -1.0), "damping_n_s_per_m": (0.0, 1.0, -1.0)}
    found = dict(parameters)
    for name in ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m", "gain"):
        if name not in found:
            continue
        value = found[name].value
        shape = small.estimate(value, ratios[name]) if name in ratios else Estimate(value, 0.0)
        found[name] = Estimate(value, None if shape.std is None else float(np.hypot(shape.std, abs(value) * spread)))
    return found, []


def _flat(curve: StaticNonlinearity | None, rest: float) -> bool:
    """Return whether the slope of a curve at rest is negligible against its steepest slope."""
    if curve is None:
        return False
    slopes = np.abs(curve.slope(np.append(np.linspace(curve.low, curve.high, _PLACES), rest)))
    return bool(slopes[-1] <= _FLAT * float(np.max(slopes)))
