"""Normalised blocks of a cascade, their covariance, and mass, damping and stiffness linearised at rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from tissueid.identification.base import Array, Mask
from tissueid.identification.cascades.blocks import (
    Blocks,
    CascadeData,
    Structure,
    multiplied,
    run,
    slopes,
    with_scaled_argument,
    with_zero_at,
)
from tissueid.identification.impulse_response import convolve_at_rest, dependence_samples, long_run_covariance
from tissueid.identification.second_order import Hold
from tissueid.identification.second_order_fit import SecondOrderFit, fit_second_order
from tissueid.identification.static_nonlinearity import StaticNonlinearity
from tissueid.messages import Message
from tissueid.records import Estimate, Record

_SIGNIFICANT_STD = 3.0
"""Significance threshold of a kernel's sum, in standard deviations; a smaller sum is not used as a divisor."""

_NEGLIGIBLE_SENSITIVITY, _UNDETERMINED = 1e-12, 1e-9
"""Relative thresholds below which a parameter, or a direction in parameter space, counts as undetermined."""

_STEP = 0.01
"""Step of the numerical derivatives, in standard deviations."""


@dataclass(frozen=True, eq=False)
class Normalised:
    """A cascade with normalised gains; None for blocks that the structure does not have.

    ``inner`` maps the absolute input and ``outer`` the output of the first kernel; both are zero at rest. The kernels,
    each (lags,), are per sample.
    """

    structure: Structure
    inner: StaticNonlinearity | None
    first: Array
    outer: StaticNonlinearity | None
    second: Array | None
    offset: float
    input_mean: float

    def simulate(self, u: Array) -> Array:
        """Return the free run for an input (n,), initially at rest; NaN where the memory contains a NaN."""
        u = np.asarray(u, dtype=np.float64)
        signal = convolve_at_rest(self.first, u - self.input_mean if self.inner is None else self.inner(u))
        if self.outer is not None:
            signal = self.outer(signal)
        if self.second is not None:
            signal = convolve_at_rest(self.second, signal)
        return np.asarray(self.offset + signal, dtype=np.float64)

    def small_signal_kernel(self) -> Array:
        """Return the kernel linearised at rest, (lags,) or (2 lags - 1,) for LNL, per sample."""
        kernel = self.first if self.second is None else np.convolve(self.first, self.second)
        gain = 1.0
        if self.inner is not None:
            gain *= float(self.inner.slope(np.array([self.input_mean]))[0])
        if self.outer is not None:
            gain *= float(self.outer.slope(np.zeros(1))[0])
        return np.asarray(gain * kernel)


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Covariance (r, r) along the r directions (p, r) of :attr:`Blocks.vector` that the record determines."""

    blocks: Blocks
    directions: Array
    covariance: Array

    def of(self, figure: Callable[[Blocks], Array]) -> Array:
        """Return the covariance (k, k), to first order, of quantities (k,) independent of the division of gains."""
        by_direction = []
        for direction, variance in zip(self.directions.T, np.diag(self.covariance), strict=True):
            step = _STEP * float(np.sqrt(max(variance, 0.0)))
            if step == 0.0:
                by_direction.append(np.zeros_like(figure(self.blocks)))
                continue
            above = figure(self.blocks.with_vector(self.blocks.vector + step * direction))
            below = figure(self.blocks.with_vector(self.blocks.vector - step * direction))
            by_direction.append((above - below) / (2.0 * step))
        slope = np.array(by_direction)  # (r, k)
        return np.asarray(slope.T @ self.covariance @ slope, dtype=np.float64)


def uncertainty(blocks: Blocks, data: CascadeData) -> Uncertainty:
    """Return the covariance of fitted blocks, valid for coloured residuals and an incomplete model (White 1982).

    Directions that do not change the output, such as a gain moved between blocks, are left out.
    """
    signals = run(blocks, data)
    by_all = slopes(blocks, data, signals)  # (p, rows)
    error = data.measured - signals.output[data.rows]
    size = np.linalg.norm(by_all, axis=1)
    size[size <= _NEGLIGIBLE_SENSITIVITY * float(np.max(size))] = np.inf
    by_all /= size[:, None]
    values, vectors = linalg.eigh(by_all @ by_all.T)
    kept = values > _UNDETERMINED * values[-1]
    influence = ((vectors[:, kept] / values[kept]).T @ by_all) * error  # (r, rows)
    block = dependence_samples(error, data.prepared.record.sample_rate_hz)
    n = data.rows.size
    covariance = long_run_covariance(influence.T, block) * n / max(1, n - blocks.n_parameters)
    return Uncertainty(blocks, vectors[:, kept] / size[:, None], covariance)


def has_steady_gains(blocks: Blocks, data: CascadeData, vector_covariance: Uncertainty) -> tuple[bool, bool]:
    """Return whether the first and the second kernel have a steady-state gain that differs significantly from zero."""

    def shares(some: Blocks) -> Array:
        kernels = [data.bank.basis @ weights for weights in (some.first, some.second) if weights is not None]
        return np.array([kernel.sum() / np.linalg.norm(kernel) for kernel in kernels])

    certain = np.abs(shares(blocks)) > _SIGNIFICANT_STD * np.sqrt(np.diag(vector_covariance.of(shares)))
    return bool(certain[0]), bool(certain[-1])


def normalise_gains(blocks: Blocks, data: CascadeData, steady_gains: tuple[bool, bool]) -> Normalised:
    """Return the blocks with normalised gains; the output is unchanged."""
    inner, outer = blocks.inner, blocks.outer
    first = data.bank.basis @ blocks.first
    second = None if blocks.second is None else data.bank.basis @ blocks.second
    if inner is not None:
        inner = with_zero_at(inner, data.rest)
        if outer is not None:
            spread = _spread(inner, data)
            inner, first = multiplied(inner, 1.0 / spread), first * spread
    if inner is not None or outer is not None:
        gain = _gain(first, steady_gains[0])
        first = first / gain
        if outer is not None:
            outer = with_zero_at(with_scaled_argument(outer, 1.0 / gain), 0.0)
        elif inner is not None:
            inner = multiplied(inner, gain)
    if second is not None and outer is not None:
        gain = _gain(second, steady_gains[1])
        second, outer = second / gain, multiplied(outer, gain)
    return Normalised(blocks.structure, inner, first, outer, second, blocks.offset, data.rest)


def _gain(kernel: Array, is_steady: bool) -> float:
    if is_steady:
        return float(kernel.sum())
    peak = float(kernel[int(np.argmax(np.abs(kernel)))])
    return float(np.copysign(np.linalg.norm(kernel), peak))


def _spread(inner: StaticNonlinearity, data: CascadeData) -> float:
    """Return the spread of the curve's values relative to the input's, negative for a curve that mostly falls."""
    x = data.input[data.rows] - data.rest
    values = inner(data.input[data.rows])
    falling = float(x @ (values - values.mean())) < 0.0
    share = float(np.std(values) / np.std(x))
    return -share if falling else share


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
    normal: Normalised, normalise: Callable[[Blocks], Normalised], vector_covariance: Uncertainty, small: SecondOrderFit
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

    log_gain = vector_covariance.of(lambda some: np.log(np.abs([np.sum(normalise(some).small_signal_kernel())])))
    spread = float(np.sqrt(max(0.0, float(log_gain[0, 0]))))
    ratios = {"mass_kg": (1.0, 0.0, -1.0), "damping_n_s_per_m": (0.0, 1.0, -1.0)}
    estimates = dict(parameters)
    for name in ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m", "gain"):
        if name not in estimates:
            continue
        value = estimates[name].value
        shape = small.estimate(value, ratios[name]) if name in ratios else Estimate(value, 0.0)
        estimates[name] = Estimate(
            value, None if shape.std is None else float(np.hypot(shape.std, abs(value) * spread))
        )
    return estimates, []


def _flat(curve: StaticNonlinearity | None, rest: float) -> bool:
    """Return whether the slope of a curve at rest is negligible against its steepest slope."""
    if curve is None:
        return False
    slopes = np.abs(curve.slope(np.append(np.linspace(curve.low, curve.high, _PLACES), rest)))
    return bool(slopes[-1] <= _FLAT * float(np.max(slopes)))
