"""Recursive estimate of the static force over depth: penalised regression with exponential forgetting.

Model: ``force = F(y) + B(y) y' + M y''`` (Chen 2010, Eq. 3.33). F is piecewise linear over evenly spaced knots, B
piecewise linear over coarser knots, M constant; the model is linear in all coefficients, so one set of normal equations
suffices. A penalty on the second differences of F extrapolates its slope to depths not yet visited; a weak ridge on B
and M keeps them defined without motion.
"""

from __future__ import annotations

import numpy as np

from tissueid.stimuli.base import Array

KNOTS = 20
"""Knots of F."""
_DAMPING_KNOTS = 4
"""Knots of B."""
_CURVATURE_WEIGHT = 0.3
"""Weight of a squared second difference of F, in samples."""

_ORIGIN_WEIGHT = 4.0
"""Weight of the prior of zero force at the surface, in samples."""

_OUTSIDE = 1.0
"""Distance beyond the ends, in knot spacings, up to which samples are used."""

_MIN_SLOPE, _MAX_SLOPE = 0.005, 60.0
"""Bounds of the slope of F, relative to force range over depth range."""


class StaticMap:
    """Estimates of F(y), B(y) and M; ``forget`` is the share of the accumulated weight that each sample removes."""

    def __init__(self, depth: tuple[float, float], force: tuple[float, float], slope: float, forget: float) -> None:
        self.knots = np.linspace(min(0.0, depth[0]), depth[1], KNOTS)
        self._step = float(self.knots[1] - self.knots[0])
        self._binary_error_floor = np.linspace(self.knots[0], self.knots[-1], _DAMPING_KNOTS)
        self._usual_keep = self._keep = 1.0 - forget
        usual = (force[1] - force[0]) / (depth[1] - depth[0])
        self._slopes = (_MIN_SLOPE * usual, _MAX_SLOPE * usual)
        n = KNOTS + _DAMPING_KNOTS + 1
        self._normal = np.zeros((n, n))
        self._right = np.zeros(n)
        bend = np.zeros((KNOTS - 2, n))
        for row in range(KNOTS - 2):
            bend[row, row : row + 3] = 1.0, -2.0, 1.0
        self._prior = _CURVATURE_WEIGHT * bend.T @ bend
        # Weak prior of the initial slope.
        weak = np.zeros((KNOTS - 1, n))
        for row in range(KNOTS - 1):
            weak[row, row : row + 2] = -1.0, 1.0
        self._prior += 1e-3 * weak.T @ weak
        self._prior_right = 1e-3 * weak.T @ np.full(KNOTS - 1, slope * self._step)
        origin = self._rows(np.zeros(1), np.zeros(1), np.zeros(1))[0]
        self._prior += _ORIGIN_WEIGHT * np.outer(origin, origin)
        ridge = np.arange(KNOTS, n)
        self._prior[ridge, ridge] += [*[1e-4] * _DAMPING_KNOTS, 1e-1]
        self._solve()

    def forget(self, rate_factor: float) -> None:
        """Set the forgetting rate to ``rate_factor`` times the usual rate."""
        self._keep = self._usual_keep**rate_factor

    def _rows(self, depth: Array, speed: Array, acceleration: Array) -> Array:
        """Return the regressors (n, knots + damping knots + 1) of states (n,)."""
        n = depth.size
        rows = np.zeros((n, KNOTS + _DAMPING_KNOTS + 1))
        at = np.arange(n)
        place = (depth - self.knots[0]) / self._step
        k = np.clip(np.floor(place), 0, KNOTS - 2).astype(np.int64)
        rows[at, k] = 1.0 - (place - k)
        rows[at, k + 1] = place - k
        coarse = np.clip(
            (depth - self._binary_error_floor[0]) / (self._binary_error_floor[1] - self._binary_error_floor[0]),
            0.0,
            _DAMPING_KNOTS - 1.0,
        )
        k = np.minimum(coarse.astype(np.int64), _DAMPING_KNOTS - 2)
        rows[at, KNOTS + k] = (1.0 - (coarse - k)) * speed
        rows[at, KNOTS + k + 1] = (coarse - k) * speed
        rows[:, -1] = acceleration
        return rows

    def learn(self, force: Array, depth: Array, speed: Array, acceleration: Array) -> Array:
        """Update from states (n,) in SI and their measured force (n,), N, without NaN.

        Returns:
            One-step prediction errors of the force, N, (n,), computed before the update.
        """
        reach = _OUTSIDE * self._step
        near = (depth > self.knots[0] - reach) & (depth < self.knots[-1] + reach)
        keep = self._keep**force.size
        every = self._rows(depth, speed, acceleration)
        errors = force - self.force(depth) - every[:, KNOTS:-1] @ self._damping - self.mass * acceleration
        rows = every[near]
        self._normal = keep * self._normal + rows.T @ rows
        self._right = keep * self._right + rows.T @ force[near]
        self._solve()
        return np.asarray(errors)

    def _solve(self) -> None:
        solution = np.linalg.solve(self._normal + self._prior, self._right + self._prior_right)
        slopes = np.clip(np.diff(solution[:KNOTS]) / self._step, *self._slopes)
        # Clip slopes outwards from the best determined knot, so that the measured part does not shift.
        best = int(np.argmax(np.diagonal(self._normal)[:KNOTS]))
        steps = slopes * self._step
        self._force = np.empty(KNOTS)
        self._force[best] = solution[best]
        self._force[best + 1 :] = solution[best] + np.cumsum(steps[best:])
        self._force[:best] = solution[best] - np.cumsum(steps[:best][::-1])[::-1]
        self._damping = np.maximum(solution[KNOTS:-1], 0.0)
        self.mass = max(float(solution[-1]), 0.0)

    def force(self, depth: Array) -> Array:
        """Return F, N, at depths (n,), m; extrapolates linearly."""
        place = (depth - self.knots[0]) / self._step
        k = np.clip(np.floor(place), 0, KNOTS - 2).astype(np.int64)
        return np.asarray(self._force[k] + (place - k) * (self._force[k + 1] - self._force[k]))

    def slope(self, depth: Array) -> Array:
        """Return the slope of F, N/m, at depths (n,), m."""
        k = np.clip(np.floor((depth - self.knots[0]) / self._step), 0, KNOTS - 2).astype(np.int64)
        return np.asarray((self._force[k + 1] - self._force[k]) / self._step)

    def depth(self, force: float) -> float:
        """Return the depth, m, at which F equals a force, N; the nearest end if F does not reach it."""
        return float(np.interp(force, self._force, self.knots))

    def damping(self, depth: Array) -> Array:
        """Return B, N s/m, at depths (n,), m."""
        return np.interp(depth, self._binary_error_floor, self._damping)
