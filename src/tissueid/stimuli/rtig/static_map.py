"""The static force over depth, learnt while it is being used: a penalised regression with forgetting.

What is measured obeys ``force = F(y) + B(y) y' + M y''`` (Chen 2010, Eq. 3.33). F is a polygon over evenly spaced
knots, B a coarser one, M one number; all are linear in what is measured, so one set of normal equations holds them. A
penalty on the bends of F carries its slope on to depths that were not visited yet, and a mild one on B and M keeps
them at rest while nothing moves.
"""

from __future__ import annotations

import numpy as np

from tissueid.stimuli.base import Array

KNOTS = 20
_DAMPING_KNOTS = 4
_BEND = 0.3
"""Weight of a bend of F between knots, in samples."""

_ORIGIN = 4.0
"""Weight of no force at the surface, in samples: what is first known of a tissue."""

_OUTSIDE = 1.0
"""Knot distances beyond the ends up to which samples are used."""

_LEAST_SLOPE, _MOST_SLOPE = 0.005, 60.0
"""Slopes of F that are believed, in the range of force over the range of depth."""


class StaticMap:
    """F(y), B(y) and M as they are known; ``forget`` is the share of all knowledge that a sample takes away."""

    def __init__(self, depth: tuple[float, float], force: tuple[float, float], slope: float, forget: float) -> None:
        self.knots = np.linspace(min(0.0, depth[0]), depth[1], KNOTS)
        self._step = float(self.knots[1] - self.knots[0])
        self._coarse = np.linspace(self.knots[0], self.knots[-1], _DAMPING_KNOTS)
        self._usual_keep = self._keep = 1.0 - forget
        usual = (force[1] - force[0]) / (depth[1] - depth[0])
        self._slopes = (_LEAST_SLOPE * usual, _MOST_SLOPE * usual)
        n = KNOTS + _DAMPING_KNOTS + 1
        self._normal = np.zeros((n, n))
        self._right = np.zeros(n)
        bend = np.zeros((KNOTS - 2, n))
        for row in range(KNOTS - 2):
            bend[row, row : row + 3] = 1.0, -2.0, 1.0
        self._prior = _BEND * bend.T @ bend
        # The guessed slope holds only until anything is known.
        weak = np.zeros((KNOTS - 1, n))
        for row in range(KNOTS - 1):
            weak[row, row : row + 2] = -1.0, 1.0
        self._prior += 1e-3 * weak.T @ weak
        self._prior_right = 1e-3 * weak.T @ np.full(KNOTS - 1, slope * self._step)
        origin = self._rows(np.zeros(1), np.zeros(1), np.zeros(1))[0]
        self._prior += _ORIGIN * np.outer(origin, origin)
        ridge = np.arange(KNOTS, n)
        self._prior[ridge, ridge] += [*[1e-4] * _DAMPING_KNOTS, 1e-1]
        self._solve()

    def forget(self, haste: float) -> None:
        """Multiply the rate of forgetting by ``haste``, relative to the usual rate."""
        self._keep = self._usual_keep**haste

    def _rows(self, depth: Array, speed: Array, acceleration: Array) -> Array:
        """Regressors (n, knots + damping knots + 1) of states (n,)."""
        n = depth.size
        rows = np.zeros((n, KNOTS + _DAMPING_KNOTS + 1))
        at = np.arange(n)
        place = (depth - self.knots[0]) / self._step
        k = np.clip(np.floor(place), 0, KNOTS - 2).astype(np.int64)
        rows[at, k] = 1.0 - (place - k)
        rows[at, k + 1] = place - k
        coarse = np.clip((depth - self._coarse[0]) / (self._coarse[1] - self._coarse[0]), 0.0, _DAMPING_KNOTS - 1.0)
        k = np.minimum(coarse.astype(np.int64), _DAMPING_KNOTS - 2)
        rows[at, KNOTS + k] = (1.0 - (coarse - k)) * speed
        rows[at, KNOTS + k + 1] = (coarse - k) * speed
        rows[:, -1] = acceleration
        return rows

    def learn(self, force: Array, depth: Array, speed: Array, acceleration: Array) -> Array:
        """Take states (n,) in SI and the force (n,), N, that they were measured with; none of them NaN.

        Returns the errors of the force, N, (n,), as it was predicted before any of them was learnt from.
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
        # Slopes are clipped about the best known knot, so that the part that was measured stays where it is.
        best = int(np.argmax(np.diagonal(self._normal)[:KNOTS]))
        steps = slopes * self._step
        self._force = np.empty(KNOTS)
        self._force[best] = solution[best]
        self._force[best + 1 :] = solution[best] + np.cumsum(steps[best:])
        self._force[:best] = solution[best] - np.cumsum(steps[:best][::-1])[::-1]
        self._damping = np.maximum(solution[KNOTS:-1], 0.0)
        self.mass = max(float(solution[-1]), 0.0)

    def force(self, depth: Array) -> Array:
        """F at depths (n,), m; straight on beyond the ends."""
        place = (depth - self.knots[0]) / self._step
        k = np.clip(np.floor(place), 0, KNOTS - 2).astype(np.int64)
        return np.asarray(self._force[k] + (place - k) * (self._force[k + 1] - self._force[k]))

    def slope(self, depth: Array) -> Array:
        """Slope of F, N/m, at depths (n,), m."""
        k = np.clip(np.floor((depth - self.knots[0]) / self._step), 0, KNOTS - 2).astype(np.int64)
        return np.asarray((self._force[k + 1] - self._force[k]) / self._step)

    def depth(self, force: float) -> float:
        """Depth, m, at which F reaches a force, N; the nearest end where it does not."""
        return float(np.interp(force, self._force, self.knots))

    def damping(self, depth: Array) -> Array:
        """B, N s/m, at depths (n,), m."""
        return np.interp(depth, self._coarse, self._damping)
