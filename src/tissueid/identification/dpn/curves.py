"""Mass, damping and stiffness as smooth positive functions of depth with few coefficients.

The logarithm of each curve is a Legendre series over the visited positions: degree 0 is a constant, degree 1 the
exponential growth of Chen 2010, C.1.4. The curves are positive by construction, and a higher degree does not change the
meaning of lower coefficients. The force is the integral of the tangent stiffness and therefore monotone; the stiffness
of Eq. 3.33 is its secant from the surface.

Outside the visited positions the linear term continues for half their range and the others keep their end values: a
polynomial would diverge there, and a constant would end an exponential growth without reason.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from tissueid.identification.base import Array
from tissueid.identification.dpn.simulation import DAMPING, DIRECTION, FORCE, INERTIA, MASS, Curves

MARGIN = 0.5
"""Margin of the tables beyond the visited range, as a share of it."""

_ROWS = 2049
_LARGEST = 40.0
"""Bound on the logarithm of a ratio within one curve, far beyond measured values."""


@dataclass(frozen=True, eq=False)
class LogCurves:
    """The curves of one model.

    ``mass``, ``damping`` and ``stiffness`` are Legendre coefficients of the logarithm, of shapes (degree + 1,), over
    the positions from ``low`` to ``high`` (m); ``level`` is the force (N) at their middle. ``direction`` is the
    Legendre series of the logarithm of the factor by which damping is higher in indentation and lower in retraction, at
    speeds well above ``speed_scale`` (m/s); its shape is (0,) if damping does not depend on direction. ``inertia`` is
    the share of M'(y) y'^2 that acts as a resisting force, of shape (1,), or (0,) without that term.
    """

    low: float
    high: float
    mass: Array
    damping: Array
    stiffness: Array
    level: float
    direction: Array
    speed_scale: float
    inertia: Array

    @property
    def theta(self) -> Array:
        """All coefficients in one array, shape (p,): mass, damping, stiffness, level, direction, inertia."""
        return np.concatenate([self.mass, self.damping, self.stiffness, [self.level], self.direction, self.inertia])

    @property
    def places(self) -> dict[str, slice]:
        """Slice of each curve's coefficients in ``theta``."""
        sizes = [self.mass.size, self.damping.size, self.stiffness.size, 1, self.direction.size, self.inertia.size]
        ends = np.cumsum(sizes).tolist()
        names = ("mass", "damping", "stiffness", "level", "direction", "inertia")
        return {name: slice(end - size, end) for name, size, end in zip(names, sizes, ends, strict=True)}

    @property
    def owner(self) -> NDArray[np.int64]:
        """Column of the compiled loop's table that each coefficient changes, shape (p,)."""
        sizes = (self.mass.size, self.damping.size, self.stiffness.size + 1, self.direction.size, self.inertia.size)
        return np.repeat(np.array([MASS, DAMPING, FORCE, DIRECTION, INERTIA], dtype=np.int64), sizes)

    def with_theta(self, theta: Array) -> LogCurves:
        """Return a copy with other coefficients (p,)."""
        at = self.places
        return replace(
            self,
            mass=theta[at["mass"]],
            damping=theta[at["damping"]],
            stiffness=theta[at["stiffness"]],
            level=float(theta[at["level"]][0]),
            direction=theta[at["direction"]],
            inertia=theta[at["inertia"]],
        )

    def with_degrees(self, **degrees: int) -> LogCurves:
        """Return a copy with series of other degrees: added coefficients are zero, coefficients above are dropped."""
        changed = {}
        for name, degree in degrees.items():
            series = np.zeros(degree + 1)
            old = getattr(self, name)[: degree + 1]
            series[: old.size] = old
            changed[name] = series
        return replace(self, **changed)  # type: ignore[arg-type]

    @cached_property
    def grid(self) -> Array:
        """Positions of the tables, m, shape (rows,)."""
        reach = MARGIN * (self.high - self.low)
        return np.asarray(np.linspace(self.low - reach, self.high + reach, _ROWS), dtype=np.float64)

    def basis(self, position: Array, terms: int) -> Array:
        """Return the Legendre terms at positions (k,), shape (k, terms).

        Outside the visited positions the linear term continues for half their range; the others keep their end values.
        """
        x = 2.0 * (position - self.low) / (self.high - self.low) - 1.0
        inside = np.clip(x, -1.0, 1.0)
        values = legendre.legvander(inside, max(terms - 1, 1))[:, :terms]
        if terms > 1:
            values[:, 1] = np.clip(x, -1.0 - 2.0 * MARGIN, 1.0 + 2.0 * MARGIN)
        return np.asarray(values, dtype=np.float64)

    def masses(self, position: Array) -> Array:
        """Return M at positions (k,), kg."""
        return self._positive(self.mass, position)

    def dampings(self, position: Array) -> Array:
        """Return B at positions (k,), N s/m; the geometric mean of both directions if they differ."""
        return self._positive(self.damping, position)

    def stiffnesses(self, position: Array) -> Array:
        """Return the tangent stiffness dF/dy at positions (k,), N/m."""
        return self._positive(self.stiffness, position)

    def forces(self, position: Array) -> Array:
        """Return F at positions (k,), N."""
        return np.asarray(np.interp(position, self.grid, self.tables.force), dtype=np.float64)

    def _positive(self, series: Array, position: Array) -> Array:
        log = self.basis(position, series.size) @ series
        return np.asarray(np.exp(np.clip(log, -_LARGEST, _LARGEST)), dtype=np.float64)

    @cached_property
    def tables(self) -> Curves:
        """The curves on the grid, for the simulation."""
        grid = self.grid
        force = self.level + self._integrated(self._positive(self.stiffness, grid)[:, None])[:, 0]
        directed = self.direction.size > 0
        return Curves(
            low=float(grid[0]),
            spacing=float(grid[1] - grid[0]),
            mass=self._positive(self.mass, grid),
            damping=self._positive(self.damping, grid),
            force=force,
            direction=self.basis(grid, self.direction.size) @ self.direction if directed else None,
            speed_scale=self.speed_scale if directed else 0.0,
            inertia=float(self.inertia.sum()),
            margin=MARGIN * (self.high - self.low),
        )

    def slopes(self) -> Array:
        """Return the derivative of each coefficient's curve with respect to it, on the grid, shape (rows, p)."""
        grid = self.grid
        terms = max(self.mass.size, self.damping.size, self.stiffness.size, self.direction.size)
        basis = self.basis(grid, terms)
        stiffness = self._positive(self.stiffness, grid)
        by_stiffness = self._integrated(stiffness[:, None] * basis[:, : self.stiffness.size])
        parts = [
            basis[:, : self.mass.size],
            basis[:, : self.damping.size],
            by_stiffness,
            np.ones((grid.size, 1)),
            basis[:, : self.direction.size],
            np.ones((grid.size, self.inertia.size)),
        ]
        return np.ascontiguousarray(np.hstack(parts))

    def growths(self, position: Array, terms: int) -> Array:
        """Return the derivatives of the Legendre terms with respect to position, 1/m, at visited positions (k,), shape
        (k, terms).
        """
        x = np.clip(2.0 * (position - self.low) / (self.high - self.low) - 1.0, -1.0, 1.0)
        each = [legendre.legval(x, legendre.legder(np.eye(max(terms, 2))[j])) for j in range(terms)]
        return np.asarray(np.column_stack(each) * 2.0 / (self.high - self.low), dtype=np.float64)

    def force_slopes(self, position: Array) -> Array:
        """Return the derivatives of F at positions (k,) with respect to the coefficients, shape (k, p)."""
        slopes = np.zeros((position.size, self.theta.size))
        table = self.slopes()
        for column in np.flatnonzero(self.owner == FORCE):
            slopes[:, column] = np.interp(position, self.grid, table[:, column])
        return slopes

    def _integrated(self, values: Array) -> Array:
        """Return the integrals of columns (rows, k) over the grid from its middle, by Simpson's rule on cells and half
        cells.
        """
        spacing = self.grid[1] - self.grid[0]
        cells = 0.5 * (values[1:] + values[:-1])
        curvature = np.zeros_like(values)
        curvature[1:-1] = values[2:] - 2.0 * values[1:-1] + values[:-2]
        cells -= (curvature[1:] + curvature[:-1]) / 24.0
        total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(cells, axis=0)]) * spacing
        return np.asarray(total - total[values.shape[0] // 2], dtype=np.float64)
