"""Nonlinear least squares within bounds: the one Levenberg-Marquardt loop of the engines and of the gap.

A problem provides the quadratic model of its cost at a point and tries steps; the loop chooses damping and decides when
to stop (Levenberg 1944; Marquardt 1963). Slopes may be approximate, such as those updated by secants (Broyden 1965): a
problem recomputes them when a step fails or gains little.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from tissueid.identification.base import Array

_LEAST_DAMPING, _MOST_DAMPING = 1e-9, 1e6
_LOWERED, _RAISED = 5.0, 10.0
"""Factors of the damping after a successful step and after a failed one."""
_HOPELESS = 1e200
_WITHOUT_EFFECT = 1e-12
"""Share of the strongest effect below which a parameter is treated as without effect."""
_POOR = 0.3
"""Share of the predicted gain below which the Jacobian is recomputed after a step."""
_NEGLIGIBLE = 1e-12
"""Predicted gain of a failed step, relative to the cost, at which the search ends."""


class Point(Protocol):
    """Parameters with their cost."""

    @property
    def theta(self) -> Array:
        """Parameters (p,); used only where a problem has bounds."""

    @property
    def cost(self) -> float:
        """The cost to minimise."""


P = TypeVar("P", bound=Point)
E = TypeVar("E")


class Problem(ABC, Generic[P]):
    """A cost to minimise: a sum of squares, with priors where there are any."""

    @abstractmethod
    def linearised(self, at: P) -> tuple[Array, Array]:
        """Return the Gauss-Newton matrix (p, p) and minus half the gradient (p,) at a point."""

    @abstractmethod
    def attempt(self, at: P, step: Array) -> P | None:
        """Return the point after a step (p,); None if it cannot be evaluated."""

    def refresh(self, at: P) -> bool:
        """Recompute approximate slopes at a point. Return False if they were exact already, which is the default."""
        return False


@dataclass(frozen=True)
class Minimum(Generic[P]):
    """End of a search: the best point, whether the search converged, and the number of accepted steps."""

    point: P
    converged: bool
    steps: int


@dataclass(frozen=True)
class Bounds:
    """Lower and upper bounds of the parameters and the largest change of each in a step, shape (p,) each."""

    low: Array
    high: Array
    reach: Array

    @classmethod
    def of_steps(cls, reach: Array) -> Bounds:
        """Return bounds of the steps only."""
        infinite = np.full(reach.shape, np.inf)
        return cls(-infinite, infinite, reach)


def minimise(
    problem: Problem[P],
    at: P,
    *,
    most_steps: int,
    tolerance: float,
    idle_steps: int = 1,
    damping: float = 1e-3,
    bounds: Bounds | None = None,
) -> Minimum[P]:
    """Minimise a cost from a starting point; the result is never worse than the start.

    Args:
        problem: the cost.
        at: starting point, within the bounds.
        most_steps: maximum number of accepted steps.
        tolerance: relative gain of a step below which it is idle.
        idle_steps: number of idle steps in succession after which the search has converged.
        damping: initial damping, relative to the diagonal of the Gauss-Newton matrix.
        bounds: of parameters and steps; none by default. A parameter at its bound whose gradient points outwards is
            fixed for the step; ``attempt`` keeps the others within the bounds.
    """
    model: tuple[Array, Array] | None = None
    steps = idle = 0
    while steps < most_steps:
        model = problem.linearised(at) if model is None else model
        step, damping = _damped_step(*model, at, damping, bounds)
        trial = problem.attempt(at, step)
        if trial is not None and trial.cost < at.cost:
            idle = idle + 1 if at.cost - trial.cost < tolerance * at.cost else 0
            at, steps, damping = trial, steps + 1, max(damping / _LOWERED, _LEAST_DAMPING)
            if idle >= idle_steps and not problem.refresh(at):
                return Minimum(at, True, steps)
            model = None
        elif problem.refresh(at):
            model = None
        elif damping > _MOST_DAMPING or float(step @ model[1]) <= _NEGLIGIBLE * at.cost:
            return Minimum(at, True, steps)
        else:
            damping *= _RAISED
    return Minimum(at, False, steps)


@dataclass(frozen=True, eq=False)
class ErrorPoint:
    """Parameters (p,) with the errors (m,), minus their derivatives (m, p), and the cost."""

    theta: Array
    error: Array
    slopes: Array
    cost: float


class ErrorProblem(Problem[ErrorPoint]):
    """A sum of squared errors whose derivatives are known at every point."""

    def linearised(self, at: ErrorPoint) -> tuple[Array, Array]:
        """Return the Gauss-Newton matrix and the descent."""
        return at.slopes.T @ at.slopes, at.slopes.T @ at.error


@dataclass(frozen=True, eq=False)
class SecantPoint(Generic[E]):
    """Parameters (p,) with their residuals (m,), what was evaluated with them, and the cost."""

    theta: Array
    residuals: Array
    extra: E
    cost: float


class SecantProblem(Problem[SecantPoint[E]], Generic[E]):
    """Squared residuals and normal priors; the Jacobian is updated by secants where these suffice (Broyden 1965).

    Args:
        evaluate: returns residuals (m,) and anything else that belongs to parameters (p,).
        derivatives: returns the Jacobian (m, p) of the residuals at parameters (p,) with residuals (m,).
        steps: steps of the derivatives, which scale the parameters, shape (p,).
        bounds: of the parameters.
        prior: mean and standard deviation of each parameter, shape (p,) each.
    """

    def __init__(
        self,
        evaluate: Callable[[Array], tuple[Array, E]],
        derivatives: Callable[[Array, Array], Array],
        steps: Array,
        bounds: Bounds,
        prior: tuple[Array, Array],
    ) -> None:
        self._evaluate, self._derivatives = evaluate, derivatives
        self._steps, self._bounds = steps, bounds
        self._mean, self._std = prior
        self._last: SecantPoint[E] | None = None
        self._exact = False
        self._set_jacobian(np.empty((0, steps.size)))

    def start(self, theta: Array, derivatives: Callable[[Array, Array], Array] | None = None) -> SecantPoint[E]:
        """Return the starting point. ``derivatives`` replaces the exact Jacobian there by an approximate one."""
        self._last = at = self._point(theta)
        self._set_jacobian((derivatives or self._derivatives)(theta, at.residuals))
        self._exact = derivatives is None
        return at

    def restart(self, at: SecantPoint[E]) -> SecantPoint[E]:
        """Return a point at which another search begins; its Jacobian is recomputed when that is needed."""
        self.follow(at)
        self._last, self._exact = at, False
        return at

    def attempt(self, at: SecantPoint[E], step: Array) -> SecantPoint[E]:
        """Evaluate the parameters after a step, clipped to their bounds."""
        return self._point(np.clip(at.theta + step, self._bounds.low, self._bounds.high))

    def linearised(self, at: SecantPoint[E]) -> tuple[Array, Array]:
        """Return the quadratic model; the Jacobian is recomputed after a step that gained less than predicted."""
        if self.follow(at):
            self.refresh(at)
        descent = -self._transposed_times(at.residuals) - (at.theta - self._mean) * self._std**-2.0
        return self._normal + np.diag(self._std**-2.0), descent

    def refresh(self, at: SecantPoint[E]) -> bool:
        """Recompute the Jacobian unless it was exact at the last point."""
        if self._exact:
            return False
        self._set_jacobian(self._derivatives(at.theta, at.residuals))
        self._exact, self._last = True, at
        return True

    def follow(self, at: SecantPoint[E]) -> bool:
        """Update the Jacobian by the secant to a new point. Return whether the step gained less than predicted."""
        last = self._last
        if last is None or at is last:
            return False
        moved = at.theta - last.theta
        expected = last.residuals + self._times(moved)
        scaled = moved / self._steps
        self._add_secant(at.residuals - expected, scaled / self._steps / float(scaled @ scaled))
        self._last, self._exact = at, False
        return last.cost - at.cost < _POOR * (last.cost - self._cost(at.theta, expected))

    # The Jacobian is that of the last derivatives and the secants since: a sum of products of columns and rows. Adding
    # a secant to it and to the normal matrix takes a pass over the residuals, and no copy of the Jacobian.

    @property
    def jacobian(self) -> Array:
        """The Jacobian (m, p) at the last point."""
        if self._columns:
            self._set_jacobian(self._base + np.stack(self._columns, axis=1) @ np.stack(self._rows), self._normal)
        return self._base

    def _set_jacobian(self, jacobian: Array, normal: Array | None = None) -> None:
        self._base = jacobian
        self._normal: Array = jacobian.T @ jacobian if normal is None else normal
        self._columns: list[Array] = []
        self._rows: list[Array] = []

    def _add_secant(self, column: Array, row: Array) -> None:
        across = np.outer(self._transposed_times(column), row)
        self._normal = self._normal + across + across.T + float(column @ column) * np.outer(row, row)
        self._columns.append(column)
        self._rows.append(row)

    def _times(self, step: Array) -> Array:
        change = self._base @ step
        for column, row in zip(self._columns, self._rows, strict=True):
            change += float(row @ step) * column
        return change

    def _transposed_times(self, values: Array) -> Array:
        product = self._base.T @ values
        for column, row in zip(self._columns, self._rows, strict=True):
            product = product + float(column @ values) * row
        return product

    def _point(self, theta: Array) -> SecantPoint[E]:
        residuals, extra = self._evaluate(theta)
        return SecantPoint(theta, residuals, extra, self._cost(theta, residuals))

    def _cost(self, theta: Array, residuals: Array) -> float:
        from_prior = (theta - self._mean) / self._std
        return float(residuals @ residuals + from_prior @ from_prior)


def _damped_step(
    matrix: Array, descent: Array, at: Point, damping: float, bounds: Bounds | None
) -> tuple[Array, float]:
    """Return a step (p,) within the reach of every parameter, and the damping that it needed."""
    scale = np.diag(matrix).copy()
    free = scale > _WITHOUT_EFFECT**2 * float(np.max(scale, initial=0.0))
    reach: Array | float = np.inf
    if bounds is not None:
        free &= ~(((at.theta <= bounds.low) & (descent < 0.0)) | ((at.theta >= bounds.high) & (descent > 0.0)))
        # A parameter of little effect is damped: a step over its whole reach costs a share of the total.
        scale += at.cost / bounds.reach**2
        reach = bounds.reach[free]
    step = np.zeros(descent.size)
    if not free.any():
        return step, damping
    size = np.sqrt(scale[free])
    inner = matrix[np.ix_(free, free)] / (size[:, None] * size)
    right = descent[free] / size
    diagonal = inner.diagonal().copy()
    while damping < _HOPELESS:  # also ends where slopes are not finite
        inner.flat[:: right.size + 1] = diagonal + damping
        part = np.linalg.solve(inner, right) / size
        if (np.abs(part) <= reach).all():
            step[free] = part
            return step, damping
        damping *= 3.0
    return step, damping
