"""Local mass, damping and stiffness of a partitioned record, corrected for the bias of the estimator.

The linearised kernels are averages over the width of a partition, over the motion within the memory, and over both
directions. The bias is found by applying the same estimator to a simulated tissue with known parameters, driven by the
input of the record. The parameters of that tissue are adjusted until its estimates equal those of the record (indirect
inference: Gourieroux, Monfort and Renault 1993).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Mask
from tissueid.identification.dpn.simulation import Curves, simulate_dpn
from tissueid.identification.impulse_response import dependence_samples, long_run_covariance
from tissueid.identification.partitions.parameters import LocalParameters, local_parameters
from tissueid.identification.partitions.regression import PartitionedKernels, Partitions, solve_along_lags
from tissueid.identification.preparation import PreparedRecord
from tissueid.identification.second_order import Hold
from tissueid.identification.second_order_fit import SecondOrderFit
from tissueid.identification.volterra.regressors import LagGrid
from tissueid.messages import Message

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
        cells = self.lines.position
        inside = np.clip(grid, cells.min(), cells.max())  # the lines are constant beyond the cells
        lines = _powers(inside, cells, self.lines.basis.shape[1] - 1)
        share = lines @ (self.lines.pick @ contrast.share)  # (rows, 2)
        share = np.clip(share, -_LARGEST_CONTRAST, _LARGEST_CONTRAST)
        direction = np.arctanh(share[:, 0])
        force, turned = _integrals(np.array([stiffness, share[:, 1] * stiffness]), float(grid[1] - grid[0]))
        middle = float(np.mean(cells))
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


_ITERATIONS = 40
_TOLERANCE = 1e-3
_GAIN_TOLERANCE = 1e-5
"""Share of the loss below which a step has gained nothing: 0.3 standard deviations for 8,000 independent samples."""
_DERIVATIVE_STEP = 1e-3
"""Step of the forward differences of the simulated position with respect to the parameters of the contrast."""

_LONGEST_STEP = 0.3
_WIDTH_STD = 1.0
"""Standard deviation of the prior of the logarithm of the width of the transition between the directions."""


def fit_contrast(tissue: FittedTissue, log_parameters: Array, used: Mask) -> Contrast | None:
    """Fit the contrasts of damping and stiffness as linear functions of depth, by the simulation error on a mask (n,).

    The restoring force is F(y) + G(y) in indentation and F(y) - G(y) in retraction, so that the stiffnesses are F' + G'
    and F' - G'; the mass is the same (Chen 2010, 5.4). A dry friction is a level of G and no stiffness. The curves of
    mass, damping and stiffness, starting from ``log_parameters`` (K, 3), a level of the output and the width of the
    transition between the directions are nuisance parameters. The covariance is the sandwich for a misspecified model
    with autocorrelated residuals (White 1982; Newey and West 1987). None if the tissue cannot be simulated or the fit
    does not converge.
    """
    lines, record = tissue.lines, tissue.prepared.record
    start = lines.coefficients(log_parameters)  # (degree + 1, 3)
    logs, turns = start.size, lines.basis.shape[1]
    scale = float(np.nanstd(record.input[used]))  # of the level, N

    def contrast_of(theta: Array) -> Contrast:
        share = lines.basis @ theta[logs:-2].reshape(2, turns).T  # (K, 2)
        return Contrast(share, np.zeros((*share.shape, 0)), scale * float(theta[-2]), float(theta[-1]))

    def simulated(theta: Array) -> Array | None:
        contrast = contrast_of(theta)
        contrast = replace(contrast, share=np.clip(contrast.share, -1.0, 1.0))
        run = tissue.output(theta[:logs].reshape(start.shape), contrast)
        return None if run is None else run[used]

    measured = record.output[used]
    theta = np.concatenate([start.ravel(), np.zeros(2 * turns + 2)])
    run = simulated(theta)
    for _ in range(_ITERATIONS):
        if run is None:
            return None
        error = measured - run
        slopes = _slopes(simulated, theta, run)
        if slopes is None:
            return None
        prior = np.zeros(theta.size)  # of the width: it is not determined where nothing depends on direction
        prior[-1] = float(np.std(error)) / _WIDTH_STD
        slopes = np.vstack([slopes, prior])
        step = np.linalg.lstsq(slopes, np.append(error - error.mean(), -prior[-1] * theta[-1]), rcond=1e-8)[0]
        step /= max(1.0, float(np.max(np.abs(step))) / _LONGEST_STEP)
        loss = partial(_loss, prior=prior[-1])
        bound = loss(error, theta) * (1.0 + 1e-9)
        gained = 0.0
        while np.max(np.abs(step)) > 0.1 * _TOLERANCE:
            tried = simulated(theta + step)
            if tried is not None and loss(measured - tried, theta + step) <= bound:
                gained = bound - loss(measured - tried, theta + step)
                theta, run = theta + step, tried
                break
            step = 0.5 * step
        if np.max(np.abs(step)) < _TOLERANCE or gained < _GAIN_TOLERANCE * bound:
            root = _contrast_root(tissue, logs, theta.size, slopes, measured - run)
            misfit = float(np.std(measured - run) / np.std(measured))
            return replace(contrast_of(theta), root=root, misfit=misfit)
    return None


def _loss(error: Array, theta: Array, prior: float) -> float:
    """Return the sum of squared errors (rows,) without their mean, and of the deviation from the prior."""
    return float(np.var(error)) * error.size + float(prior * theta[-1]) ** 2


def _slopes(simulated: Callable[[Array], Array | None], theta: Array, run: Array) -> Array | None:
    """Return the derivatives (rows, p) of a simulation (rows,), without their means; None if a simulation fails."""
    columns = []
    for unit in np.eye(theta.size):
        moved = simulated(theta + _DERIVATIVE_STEP * unit)
        if moved is None:
            return None
        columns.append((moved - run) / _DERIVATIVE_STEP)
    slopes = np.array(columns).T
    return np.asarray(slopes - slopes.mean(axis=0), dtype=np.float64)


def _contrast_root(tissue: FittedTissue, logs: int, parameters: int, slopes: Array, error: Array) -> Array:
    """Return a square root (K, 2, m) of the covariance of the contrasts at the cells."""
    lines = tissue.lines
    error = error - error.mean()
    influence = np.linalg.pinv(slopes)[logs:-2, :-1].T * error[:, None]  # (rows, 2 lines)
    block = dependence_samples(error, tissue.prepared.record.sample_rate_hz)
    covariance = long_run_covariance(influence, block) * error.size / (error.size - parameters)
    values, vectors = np.linalg.eigh(covariance)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))).reshape(2, -1, values.size)
    return np.asarray(np.einsum("kl,clm->kcm", lines.basis, root))


_ROUNDS = 2
_PROBE = 0.05
"""Change of a logarithm that shows how the estimator answers."""

_LEAST_GAIN = 0.15
"""Lower bound on the sensitivity of an estimate to the parameter, for the correction."""

_MISFIT = 0.02
"""Relative error of the simulated tissue, which does not relax or recruit mass, at which the error of that model equals
that of sampling: 1.5 standard deviations on the simulated skin.
"""
_MOST_WIDENING = 2.0

_LARGEST_CORRECTION = np.log(2.0)
"""Largest plausible correction of a logarithm; beyond it the simulated tissue does not resemble the record."""

_UNCORRECTED = Message(
    "partitions.uncorrected",
    "mass, damping and stiffness are those of the kernels, without bias correction and without uncertainty: a tissue "
    "with these parameters could not be simulated with this record's input",
)


@dataclass(frozen=True, eq=False)
class LocalEstimates:
    """Parameters of K depth ranges about the operating point.

    ``contrast`` holds those of damping and stiffness between directions; None without directions. ``solved`` holds the
    kernels about the mean input.
    """

    local: LocalParameters
    solved: PartitionedKernels
    contrast: Contrast | None = None
    warnings: tuple[str, ...] = ()

    @property
    def certain(self) -> bool:
        """Whether the standard deviations hold: not where the bias of the estimator is known to remain."""
        return _UNCORRECTED not in self.warnings

    @property
    def rest(self) -> float:
        """Output under the mean input."""
        return float(self.solved.offsets[0])


@dataclass(frozen=True, eq=False)
class DepthEstimator:
    """Estimator of parameters against depth from an output, for a fixed input. ``partitions`` are by depth only."""

    prepared: PreparedRecord
    used: Mask
    partitions: Partitions
    grid: LagGrid
    linear: SecondOrderFit

    def estimate(self, output: Array) -> LocalEstimates:
        """Return the parameters for an output (n,), without bias correction."""
        record, prepared = self.prepared.record, self.prepared
        cells = self.partitions.cells(output)
        solved = solve_along_lags(
            record.input,
            output,
            prepared.input_mean,
            cells,
            self.partitions.count,
            self.used,
            self.grid,
            record.sample_rate_hz,
        )
        x = np.full(output.size, np.nan)
        x[prepared.part] = record.input[prepared.part] - prepared.input_mean
        local = local_parameters(
            solved, self.partitions, output[self.used], cells[self.used], x, self.grid, self.linear
        )
        return LocalEstimates(local, solved)

    def corrected(self) -> LocalEstimates:
        """Return the parameters of the record, minus the bias found on a tissue simulated with them.

        Level and slope of each parameter against depth are solved by Newton's method, with the sensitivities of the
        estimator found by simulation. The scatter of the cells about these lines is kept unchanged. Damping and
        stiffness of that tissue may depend on the direction, which the kernels along the lags cannot represent: left
        out, it would appear as a change with depth. If the correction fails, the uncorrected estimates are returned
        with a warning.
        """
        seen = self.estimate(self.prepared.record.output)
        if not self.linear.mechanical or not seen.local.determined.any():
            return seen
        if not seen.local.determined.all():
            return replace(seen, warnings=(_UNCORRECTED,))
        tissue = FittedTissue.through(seen.local, self.prepared, self.partitions, self.linear.hold, seen.rest)
        contrast = fit_contrast(tissue, seen.local.log_parameters, self.used)
        seen = replace(seen, contrast=contrast)
        search = None if contrast is None else _Search.with_sensitivities(self, seen, tissue)
        local = None if search is None or contrast is None else search.solve(contrast)
        return replace(seen, warnings=(_UNCORRECTED,)) if local is None else replace(seen, local=local)


@dataclass(frozen=True, eq=False)
class _Search:
    """Search for the tissue whose simulated record gives the same estimates as the measured record."""

    estimator: DepthEstimator
    seen: LocalEstimates
    tissue: FittedTissue
    inverse: Array  # (6, 6), inverse of the derivatives of the estimated lines with respect to the true ones

    @classmethod
    def with_sensitivities(
        cls, estimator: DepthEstimator, seen: LocalEstimates, tissue: FittedTissue
    ) -> _Search | None:
        """Return a search with the sensitivities of the estimator; None if the tissue cannot be simulated."""
        lines = tissue.lines
        search = cls(estimator, seen, tissue, np.eye(3 * lines.basis.shape[1]))
        sought, still = seen.local.log_parameters, Contrast.none(lines.position.size)
        back = search._re_estimated(sought, still)
        if back is None:
            return None
        columns = []
        for change in lines.unit_changes():
            moved = search._re_estimated(sought + _PROBE * change, still)
            if moved is None:
                return None
            columns.append(np.ravel(lines.pick @ (moved - back)) / _PROBE)
        left_vectors, gains, right = np.linalg.svd(np.array(columns).T)
        return replace(search, inverse=(right.T / np.maximum(gains, _LEAST_GAIN)) @ left_vectors.T)

    def solve(self, contrast: Contrast) -> LocalParameters | None:
        """Return the parameters of a tissue with this contrast between directions; None on failure."""
        lines, wanted = self.tissue.lines, self.seen.local.log_parameters
        sought = wanted
        back = self._re_estimated(sought, contrast)
        for _ in range(_ROUNDS):
            if back is None:
                return None
            missing = np.ravel(lines.pick @ (wanted - back))
            sought = sought + lines.basis @ (self.inverse @ missing).reshape(-1, 3)
            if not np.all(np.abs(sought - wanted) < _LARGEST_CORRECTION):
                return None
            back = self._re_estimated(sought, contrast)
        if back is None:
            return None
        root = self.seen.local.root
        across = np.einsum("lk,kim->lim", lines.pick, root)  # (lines, 3, m)
        widened = (self.inverse @ across.reshape(self.inverse.shape[0], -1)).reshape(across.shape)
        log_parameters = lines.smooth(sought) + wanted - back
        root = root + np.einsum("kl,lim->kim", lines.basis, widened - across)
        widening = min(float(np.hypot(1.0, contrast.misfit / _MISFIT)), _MOST_WIDENING)
        return replace(self.seen.local, log_parameters=log_parameters, root=widening * root)

    def _re_estimated(self, values: Array, contrast: Contrast) -> Array | None:
        """Return the estimates for a tissue with these logarithms (K, 3); None if they are not available."""
        simulated = self.tissue.output(self.tissue.lines.coefficients(values), contrast)
        if simulated is None:
            return None
        try:
            back = self.estimator.estimate(simulated).local
        except UnusableInputError:
            return None
        return back.log_parameters if back.determined.all() else None
