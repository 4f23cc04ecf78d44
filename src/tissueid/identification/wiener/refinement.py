"""Joint least-squares refinement of a Wiener cascade, and the covariance of its static nonlinearity.

The Hunter-Korenberg iteration regresses on the inverse of noisy outputs, which causes a bias where g is curved. Here
the simulation error is minimised over kernel and g together: Gauss-Newton, with g refitted at each step (variable
projection, Golub and Pereyra 1973). The normal equations are solved without being formed, by conjugate gradients whose
products are a convolution and a correlation, with the correlation matrix of the input as preconditioner; directions
that the input does not excite are not changed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tissueid.identification.base import Array, Mask
from tissueid.identification.correlation import dependence_samples, long_run_covariance
from tissueid.identification.second_order import Hold
from tissueid.identification.second_order_fit import SecondOrderFit, fit_second_order
from tissueid.identification.static_nonlinearity import ExponentialCurve, StaticNonlinearity
from tissueid.identification.wiener.iteration import LinearStage, WienerCascade
from tissueid.messages import Message
from tissueid.records import Estimate, Record

_FLAT = 1e-3
"""Slope of g, relative to its largest, below which an output does not determine z."""

_SIGNIFICANT_STD = 2.0
"""Significance threshold of C2, in standard deviations, for a curved nonlinearity."""


def fit_linear_stage(
    record: Record, used: Mask, z: Array, nonlinearity: StaticNonlinearity, hold: Hold
) -> SecondOrderFit:
    """Fit a second-order system to the linear stage by the error of the measured output.

    The output error is divided by the slope of g to give an error of z, and weighted by that slope, so that the fit
    minimises the error of the measured output to first order and its covariance is that of the measurement.
    """
    stage = replace(record, output=z, output_unit=record.input_unit)
    start = fit_second_order(stage, used, hold)
    slope = np.zeros(z.size)
    slope[used] = np.abs(nonlinearity.slope(z[used]))
    steep = slope > _FLAT * float(np.max(slope))
    carried = z.copy()
    carried[steep] += (record.output[steep] - nonlinearity(z[steep])) / nonlinearity.slope(z[steep])
    weights = np.where(steep, slope, 0.0) / float(np.mean(slope[used]))
    return fit_second_order(replace(stage, output=carried), used, hold, weights, start)


def wiener_parameters(
    nonlinearity: StaticNonlinearity,
    covariance: Array,
    stage: SecondOrderFit,
    mean_input: float,
    *,
    scaling: float,
    surface: float | None,
    c3: float,
    mechanical: bool,
) -> dict[str, Estimate]:
    """Return the named estimates of a cascade.

    ``scaled_mass_s2`` and ``scaled_damping_s`` are M/K and B/K of the linear stage times ``scaling``. Mass, damping and
    stiffness are those at the mean input (Eqs. 3.27-3.29); for signals other than N and m, a gain instead.

    Args:
        nonlinearity: g.
        covariance: of its coefficients, shape (p, p).
        stage: the second-order system of the linear stage.
        mean_input: input at which mass, damping and stiffness are reported.
        scaling: assigned stiffness of the linear stage.
        surface: known offset of g, or None.
        c3: known C3, if the offset is unknown.
        mechanical: the record is of N and m.
    """
    found: dict[str, Estimate] = {}
    if isinstance(nonlinearity, ExponentialCurve):
        in_m, per_n, in_n = ("_m", "_per_n", "_n") if mechanical else ("", "", "")
        for place, name in enumerate((f"c1{in_m}", f"c2{per_n}", f"c3{in_n}", f"offset{in_m}")):
            found[name] = derived(
                nonlinearity,
                covariance,
                lambda g, place=place: g.thesis_constants(surface, c3)[place],  # type: ignore[misc]
            )
    mass = stage.estimate(scaling * stage.system.mass / stage.system.stiffness, (1.0, 0.0, -1.0))
    damping = stage.estimate(scaling * stage.system.damping / stage.system.stiffness, (0.0, 1.0, -1.0))
    found |= {"scaled_mass_s2": mass, "scaled_damping_s": damping}
    here = np.array([mean_input])
    if mechanical:
        stiffness = derived(nonlinearity, covariance, lambda g: 1.0 / float(g.slope(here)[0]))
        found |= {
            "mass_kg": _product(mass, stiffness, 1.0 / scaling),
            "damping_n_s_per_m": _product(damping, stiffness, 1.0 / scaling),
            "stiffness_n_per_m": stiffness,
        }
    else:
        found["gain"] = derived(nonlinearity, covariance, lambda g: float(g.slope(here)[0]))
    return found | {name: stage.parameters[name] for name in ("natural_frequency_rad_per_s", "damping_ratio")}


def straightness_warning(nonlinearity: StaticNonlinearity, parameters: dict[str, Estimate]) -> list[str]:
    """Return a warning if the curvature of an exponential is not significant."""
    if not isinstance(nonlinearity, ExponentialCurve):
        return []
    bend = next(estimate for name, estimate in parameters.items() if name.startswith("c2"))
    if bend.std is not None and abs(bend.value) > _SIGNIFICANT_STD * bend.std:
        return []
    return [
        Message(
            "wiener.straight",
            "the nonlinearity is straight within its uncertainty: only the product of C1 and C2 is determined",
        )
    ]


def derived(
    nonlinearity: StaticNonlinearity, covariance: Array, figure: Callable[[StaticNonlinearity], float]
) -> Estimate:
    """Return a function of g with its standard deviation to first order; None for a deviation that is not finite."""
    value = figure(nonlinearity)
    slopes = np.zeros(nonlinearity.coefficients.size)
    for k, spread in enumerate(np.sqrt(np.maximum(np.diag(covariance), 0.0))):
        if spread > 0.0:
            step = np.zeros(slopes.size)
            step[k] = 0.01 * spread
            above = figure(nonlinearity.with_coefficients(nonlinearity.coefficients + step))
            below = figure(nonlinearity.with_coefficients(nonlinearity.coefficients - step))
            slopes[k] = (above - below) / (2.0 * step[k])
    variance = float(slopes @ covariance @ slopes)
    return Estimate(value, float(np.sqrt(variance)) if np.isfinite(variance) and variance > 0.0 else None)


def _product(first: Estimate, second: Estimate, factor: float) -> Estimate:
    """Return the product of two estimates with independent errors."""
    value = first.value * second.value * factor
    if first.std is None or second.std is None:
        return Estimate(value)
    relative = np.hypot(first.std / first.value, second.std / second.value)
    return Estimate(value, abs(value) * float(relative))


_STEPS = 10
_TOLERANCE = 1e-3
"""Relative decrease of the squared error below which the iteration ends."""

_STEP_TOLERANCE, _STEP_PRODUCTS = 1e-2, 20
_COVARIANCE_TOLERANCE, _COVARIANCE_PRODUCTS = 1e-6, 100


class _Slopes:
    """Derivatives J (m, lags) of the simulated output with respect to the kernel of a cascade, as products.

    A change of the kernel's sum can be compensated by g, so only changes that keep the sum are considered.
    """

    def __init__(self, stage: LinearStage, cascade: WienerCascade) -> None:
        z = stage.input_mean + stage.response(cascade.kernel)
        self.stage = stage
        self.by_g = cascade.nonlinearity.jacobian(z)  # (m, p)
        self.error = stage.y - cascade.nonlinearity(z)
        self._slope = cascade.nonlinearity.slope(z)

    def forward(self, kernel: Array) -> Array:
        """Return J kernel, shape (m,)."""
        return np.asarray(self._slope * self.stage.response(kernel - kernel.mean()))

    def backward(self, values: Array) -> Array:
        """Return J' values, shape (lags,), for values (m,)."""
        products = self.stage.products(self._slope * values)
        return np.asarray(products - products.mean())

    def solve(self, right: Array, project: Callable[[Array], Array], tolerance: float, products: int) -> Array:
        """Solve J' P J kernel = right for the kernel (lags,); ``project`` applies the projection P to a vector (m,).

        Preconditioned conjugate gradients with at most ``products`` products, ended when a product gains less than
        ``tolerance`` of the total gain, so that directions that are not excited are never entered.
        """
        kernel = np.zeros(self.stage.lags)
        residual = right
        conditioned = self._precondition(residual)
        direction = conditioned
        size = float(np.dot(residual, conditioned))
        gained = 0.0
        for _ in range(products):
            product = self.backward(project(self.forward(direction)))
            curvature = float(np.dot(direction, product))
            if curvature <= 0.0:
                break
            length = size / curvature
            kernel = kernel + length * direction
            gained += length * size
            if length * size <= tolerance * gained:
                break
            residual = residual - length * product
            conditioned = self._precondition(residual)
            before, size = size, float(np.dot(residual, conditioned))
            direction = conditioned + (size / before) * direction
        return kernel

    def _precondition(self, values: Array) -> Array:
        answer = self.stage.solve(values)
        return np.asarray(answer - answer.mean(), dtype=np.float64)


def refine(stage: LinearStage, cascade: WienerCascade) -> WienerCascade:
    """Minimise the simulation error over kernel and g together. The result is never worse than the start."""
    for _ in range(_STEPS):
        slopes = _Slopes(stage, cascade)
        q, _ = np.linalg.qr(slopes.by_g)  # (m, p)

        def off_g(values: Array, q: Array = q) -> Array:
            return np.asarray(values - q @ (values @ q))

        step = slopes.solve(slopes.backward(off_g(slopes.error)), off_g, _STEP_TOLERANCE, _STEP_PRODUCTS)
        better = None
        for share in (1.0, 0.5, 0.25, 0.125):
            kernel = cascade.kernel + share * step
            kernel = kernel / kernel.sum()
            z = stage.input_mean + stage.response(kernel)
            nonlinearity = cascade.nonlinearity.refit(z, stage.y)
            error = stage.y - nonlinearity(z)
            rss = float(np.dot(error, error))
            if rss < cascade.rss:
                better = WienerCascade(kernel, nonlinearity, rss)
                break
        if better is None:
            break
        gained = cascade.rss - better.rss
        cascade = better
        if gained <= _TOLERANCE * cascade.rss:
            break
    return cascade


def coefficient_covariance(stage: LinearStage, cascade: WienerCascade) -> Array:
    """Return the covariance (p, p) of the coefficients of g, for an unknown kernel and coloured residuals.

    The component of each coefficient's effect that the kernel can explain is projected out.
    """
    slopes = _Slopes(stage, cascade)
    own = np.empty_like(slopes.by_g)  # (m, p)
    for k, column in enumerate(slopes.by_g.T):
        share = slopes.solve(
            slopes.backward(column), lambda values: values, _COVARIANCE_TOLERANCE, _COVARIANCE_PRODUCTS
        )
        own[:, k] = column - slopes.forward(share)
    influence = own @ np.linalg.pinv(own.T @ own) * slopes.error[:, None]
    n, p = own.shape
    block = dependence_samples(slopes.error, stage.solved.prepared.record.sample_rate_hz)
    return np.asarray(long_run_covariance(influence, block) * n / max(1, n - stage.lags - p))
