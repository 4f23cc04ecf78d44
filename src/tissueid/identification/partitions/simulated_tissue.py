"""Simulated tissue with the parameters of a partitioned fit, driven by the record's input."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array
from tissueid.identification.dpn.simulation import Curves, simulate_dpn
from tissueid.identification.partitions.cells import Partitions
from tissueid.identification.partitions.parameters import LocalParameters
from tissueid.identification.preparation import PreparedRecord
from tissueid.identification.second_order import Hold

_ROWS = 2049
_MARGIN = 0.25
_DEGREE = 2
_SCATTER = 0.03
"""Relative standard deviation of every cell about the curves, in addition to its own."""

_LARGEST_CONTRAST = 0.95

_DIRECTION_SPEED_SHARE = 0.05
"""Share of the typical speed over which the direction changes."""


@dataclass(frozen=True, eq=False)
class Contrast:
    """Half the difference between indentation and retraction of damping and stiffness, relative to their mean.

    ``share`` (K, 2) holds those of damping and stiffness at each cell, linear in depth; ``root`` (K, 2, m) is a square
    root of their covariance. ``level_n`` is half the difference of the force at the middle of the cells, N: a dry
    friction and the difference that stiffness has accumulated up to there. ``log_width`` is the logarithm of the
    width of the transition between the directions, relative to the assumed one. ``misfit`` is the error of the
    simulated tissue relative to the output, both as standard deviations.
    """

    share: Array
    root: Array
    level_n: float = 0.0
    log_width: float = 0.0
    misfit: float = 0.0

    @classmethod
    def none(cls, count: int) -> Contrast:
        """Return a contrast of zero without uncertainty for ``count`` cells."""
        return cls(np.zeros((count, 2)), np.zeros((count, 2, 0)))


@dataclass(frozen=True, eq=False)
class CellLines:
    """Curves through the values of the cells: parabolas for the simulation, and lines for the correction.

    Interpolating the cells' own values would amplify their noise. ``basis`` (K, lines) holds the lines at the cells,
    ``pick`` (lines, K) fits them; ``weight`` (K,) is the weight of each cell.
    """

    position: Array
    basis: Array
    pick: Array
    weight: Array

    @classmethod
    def through(cls, local: LocalParameters) -> CellLines:
        """Return the lines for cells with known parameters."""
        position = local.position
        weight = 1.0 / np.sqrt(np.einsum("kim,kim->k", local.root, local.root) / 3.0 + _SCATTER**2)
        basis = _powers(position, position, min(1, position.size - 1))
        return cls(position, basis, np.linalg.pinv(basis * weight[:, None]) * weight, weight)

    def unit_changes(self) -> list[Array]:
        """Return a unit change of each line of each logarithm at the cells, (K, 3) each."""
        changes = []
        for line in self.basis.T:
            for value in range(3):
                change = np.zeros((self.position.size, 3))
                change[:, value] = line
                changes.append(change)
        return changes

    def coefficients(self, values: Array) -> Array:
        """Return the coefficients (degree + 1, 3) of the parabolas through values (K, 3)."""
        powers = _powers(self.position, self.position, min(_DEGREE, self.position.size - 1))
        return np.asarray(np.linalg.pinv(powers * self.weight[:, None]) @ (values * self.weight[:, None]))

    def smooth(self, values: Array) -> Array:
        """Return the parabolas through values (K, 3) at the cells."""
        return self.at(self.position, self.coefficients(values))

    def at(self, position: Array, coefficients: Array) -> Array:
        """Return the parabolas at positions (m,), (m, 3), extrapolated linearly."""
        degree = coefficients.shape[0] - 1
        low, high = float(self.position.min()), float(self.position.max())
        inside = np.clip(position, low, high)
        value = _powers(inside, self.position, degree) @ coefficients
        if degree == 0:
            return np.asarray(value)
        step = 1e-3 * (high - low)
        rise = value - _powers(np.clip(inside, low + step, high - step), self.position, degree) @ coefficients
        return np.asarray(value + rise * (np.abs(position - inside) / step)[:, None], dtype=np.float64)

    def line_at(self, position: Array) -> Array:
        """Return the lines at positions (m,), (m, lines), constant beyond the cells."""
        inside = np.clip(position, self.position.min(), self.position.max())
        return _powers(inside, self.position, self.basis.shape[1] - 1)


@dataclass(frozen=True, eq=False)
class FittedTissue:
    """M(y) y'' + B(y) y' + F(y) = u with smooth curves, driven by the input of a record.

    ``rest`` is the output under the mean input, ``sign`` is -1 if the output decreases with increasing input.
    """

    lines: CellLines
    prepared: PreparedRecord
    low: float
    high: float
    rest: float
    sign: float
    hold: Hold
    speed_scale: float

    @classmethod
    def through(
        cls, local: LocalParameters, prepared: PreparedRecord, partitions: Partitions, hold: Hold, rest: float
    ) -> FittedTissue:
        """Return the tissue for a fit whose cells all have parameters."""
        low, high = (float(partitions.breakpoints[end]) for end in (0, -1))
        margin = _MARGIN * (high - low)
        speed = np.diff(prepared.record.output) * prepared.record.sample_rate_hz
        scale = _DIRECTION_SPEED_SHARE * float(np.nanstd(speed))
        return cls(CellLines.through(local), prepared, low - margin, high + margin, rest, local.sign, hold, scale)

    def output(self, coefficients: Array, contrast: Contrast) -> Array | None:
        """Return the output (n,), NaN where that of the record is; None if the curves cannot be simulated.

        Args:
            coefficients: parabolas of log M, log B, log K, (degree + 1, 3).
            contrast: of damping and stiffness at the cells.
        """
        record = self.prepared.record
        grid = np.linspace(self.low, self.high, _ROWS)
        mass, damping, stiffness = np.exp(self.lines.at(grid, coefficients)).T
        share = self.lines.line_at(grid) @ (self.lines.pick @ contrast.share)  # (rows, 2)
        share = np.clip(share, -_LARGEST_CONTRAST, _LARGEST_CONTRAST)
        direction = np.arctanh(share[:, 0])
        force, turned = _integrals(np.array([stiffness, share[:, 1] * stiffness]), float(grid[1] - grid[0]))
        middle = float(np.mean(self.lines.position))
        turned = turned - float(np.interp(middle, grid, turned)) + contrast.level_n
        mean = self.sign * self.prepared.input_mean
        turns = bool(np.any(contrast.share)) or contrast.level_n != 0.0
        curves = Curves(
            low=self.low,
            spacing=float(grid[1] - grid[0]),
            mass=mass,
            damping=damping / np.cosh(direction),
            force=force - float(np.interp(self.rest, grid, force)) + mean,
            direction=direction if turns else None,
            speed_scale=self.speed_scale * float(np.exp(contrast.log_width)) if turns else 0.0,
            turned_force=turned if turns else None,
        )
        try:
            run = simulate_dpn(curves, self.sign * record.input, record.sample_rate_hz, rest_input=mean, hold=self.hold)
        except UnusableInputError:
            return None
        return None if run.diverged_at is not None else np.where(np.isfinite(record.output), run.position, np.nan)


def _integrals(values: Array, spacing: float) -> Array:
    """Return the integrals (k, rows) of curves (k, rows) at equal steps from the first row, by the trapezoidal rule."""
    steps = np.cumsum(0.5 * (values[:, 1:] + values[:, :-1]) * spacing, axis=1)
    return np.concatenate([np.zeros((values.shape[0], 1)), steps], axis=1)


def _powers(position: Array, cells: Array, degree: int) -> Array:
    """Return the Legendre polynomials over the range of the cells' positions, (positions, degree + 1)."""
    low, high = float(cells.min()), float(cells.max())
    scaled = (2.0 * position - low - high) / max(high - low, 1e-12)
    return np.asarray(np.polynomial.legendre.legvander(scaled, degree), dtype=np.float64)
