"""Joint least-squares refinement of a Wiener cascade, and the covariance of its static nonlinearity.

The Hunter-Korenberg iteration regresses on the inverse of noisy outputs, which causes a bias where g is curved. Here
the simulation error is minimised over kernel and g together: Gauss-Newton, with g refitted at each step (variable
projection, Golub and Pereyra 1973). The normal equations are solved without being formed, by conjugate gradients whose
products are a convolution and a correlation, with the correlation matrix of the input as preconditioner; directions
that the input does not excite are not changed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tissueid.identification.base import Array
from tissueid.identification.effective_samples import dependence_samples, long_run_covariance
from tissueid.identification.wiener.iteration import Cascade, LinearStage

_STEPS = 10
_TOLERANCE = 1e-3
"""Relative decrease of the squared error below which the iteration ends."""

_STEP_TOLERANCE, _STEP_PRODUCTS = 1e-2, 20
_COVARIANCE_TOLERANCE, _COVARIANCE_PRODUCTS = 1e-6, 100


class _Slopes:
    """Derivatives J (m, lags) of the simulated output with respect to the kernel of a cascade, as products.

    A change of the kernel's sum can be compensated by g, so only changes that keep the sum are considered.
    """

    def __init__(self, stage: LinearStage, cascade: Cascade) -> None:
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


def refine(stage: LinearStage, cascade: Cascade) -> Cascade:
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
                better = Cascade(kernel, nonlinearity, rss)
                break
        if better is None:
            break
        gained = cascade.rss - better.rss
        cascade = better
        if gained <= _TOLERANCE * cascade.rss:
            break
    return cascade


def coefficient_covariance(stage: LinearStage, cascade: Cascade) -> Array:
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
