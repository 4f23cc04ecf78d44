"""Mass, damping and stiffness at each depth from the kernels of a partitioned model.

A kernel along the lags is not the small-signal response at its depth: while the probe moves, the kernel changes, and
the steady load then acts through another kernel. To first order the response is H / (1 - x H'), with H' the derivative
of the frequency response with respect to depth and x the steady input there. This linearisation of the fitted model
removes most of the averaging described in Chen 2010, 5.2. A kernel selected by the output sample has its own offset and
is the small-signal response already.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from tissueid.identification.base import Array
from tissueid.identification.depth_profile import DepthProfile
from tissueid.identification.partitions.regression import Cells, PartitionedKernels, Partitions
from tissueid.identification.second_order import Complex, Hold, SecondOrder, sampled_response_at
from tissueid.identification.second_order_fit import SecondOrderFit
from tissueid.identification.volterra.regressors import LagGrid, input_spectrum
from tissueid.records import Estimate

_EXCITED_POWER = 1e-4
"""Input power above which a frequency is used, relative to the strongest."""

_LARGEST_LOG_DIFFERENCE = math.log(1000.0)
"""Largest difference of a logarithm from that of the whole record; beyond it the parameters are undetermined."""

_SCATTER = 0.03
"""Relative standard deviation added to every cell's parameters when a line is fitted to them."""

_STEP = 1e-5

_LINE, _PARABOLA = 3, 5
"""Minimum numbers of cells for a line and for a parabola through them."""

_UNITS = (("mass_kg", "mass_slope_kg_per_m"), ("damping_n_s_per_m", "damping_slope_n_s_per_m2"))
_NAMES = (*_UNITS, ("stiffness_n_per_m", "stiffness_slope_n_per_m2"))


@dataclass(frozen=True, eq=False)
class LocalParameters:
    """Logarithms of mass, damping and stiffness, (cells, 3), at ``position`` (cells,), NaN if undetermined.

    ``root`` (cells, 3, m) is a square root of the covariance of all of them: its products summed over m. ``sign`` is -1
    if the output decreases with increasing input.
    """

    position: Array
    log_parameters: Array
    root: Array
    sign: float

    @property
    def determined(self) -> NDArray[np.bool_]:
        """Mask of the cells that have parameters, (cells,)."""
        return np.isfinite(self.log_parameters[:, 0])


@dataclass(frozen=True, eq=False)
class _Band:
    """The excited frequencies (bins,), their input power, and the transform of the lags."""

    frequency_hz: Array
    power: Array
    turn: Complex  # (bins, lags)
    sample_rate_hz: float
    hold: Hold

    def response(self, log_parameters: Array) -> tuple[Complex, Complex]:
        """Return the sampled response (bins,) and its derivatives (3, bins) with respect to log M, log B, log K."""
        mass, damping, stiffness = np.exp(log_parameters)
        system = SecondOrder(float(mass), float(damping), float(stiffness))
        return sampled_response_at(system, self.frequency_hz, self.sample_rate_hz, self.hold)

    def fit(self, target: Complex, start: Array) -> tuple[Array, Array] | None:
        """Return the log M, B, K (3,) nearest to a response (bins,), and the derivatives (3, 2 bins) with respect to
        it.

        Errors are weighted by the output power that they cause under the input of the record. None if no parameters
        near the start fit, or for a response that is zero.
        """
        size = float(np.sqrt(np.sum(self.power * np.abs(target) ** 2)))
        if not 0.0 < size < np.inf:
            return None
        weight = np.sqrt(self.power) / size

        def split(values: Complex) -> Array:
            weighted = values * weight
            return np.concatenate([weighted.real, weighted.imag], axis=-1)

        last: tuple[Array, Complex, Complex] = (np.empty(0), target, target)

        def response(trial: Array) -> tuple[Complex, Complex]:
            """Return the response and its derivatives, which are asked for one after the other."""
            nonlocal last
            if not np.array_equal(last[0], trial):
                last = (trial.copy(), *self.response(trial))
            return last[1:]

        low, high = start - _LARGEST_LOG_DIFFERENCE, start + _LARGEST_LOG_DIFFERENCE
        solution = optimize.least_squares(
            lambda trial: split(response(trial)[0] - target),
            start,
            jac=lambda trial: split(response(trial)[1]).T,
            bounds=(low, high),
        )
        theta = np.asarray(solution.x, dtype=np.float64)
        slopes = split(response(theta)[1])  # (3, 2 bins)
        if not solution.success or np.any((theta < low + 0.01) | (theta > high - 0.01)):
            return None
        gram = slopes @ slopes.T
        if np.linalg.cond(gram) > 1e12:
            return None
        carried = np.linalg.solve(gram, slopes) * np.concatenate([weight, weight])
        return theta, carried


def local_parameters(
    solved: PartitionedKernels,
    partitions: Partitions,
    output: Array,
    cells: Cells,
    x: Array,
    grid: LagGrid,
    linear: SecondOrderFit,
) -> LocalParameters:
    """Return the parameters of each cell's kernel, with the covariance of all of them.

    Args:
        solved: the kernels; those along the lags must be about the mean input, or the steady input is poorly known.
        partitions: the cells.
        output: of the fitted part, (n,).
        cells: of the same samples, (n,).
        x: input (n,) with its mean removed, NaN for samples that are not fitted.
        grid: the lags.
        linear: second-order system of the whole record, which is the starting point and gives the hold.
    """
    band = _band(x, grid, linear)
    position = np.array([_centre(output[cells == cell], solved.at_output) for cell in range(partitions.count)])
    begin = np.log([linear.system.mass, linear.system.damping, linear.system.stiffness])
    count, width = partitions.count, solved.kernel_root.shape[2]
    log_parameters, root = np.full((count, 3), np.nan), np.zeros((count, 3, width))
    for cell in range(count):
        fitted = band.fit(linear.sign * (band.turn @ solved.kernels[cell]), begin)
        if fitted is not None:
            log_parameters[cell], carried = fitted
            root[cell] = carried @ _split(linear.sign * (band.turn @ solved.kernel_root[cell]))
    direct = LocalParameters(position, log_parameters, root, linear.sign)
    if solved.at_output:
        return direct
    return _linearised(direct, partitions, solved, band)


def profile(local: LocalParameters, partitions: Partitions, support: NDArray[np.int_]) -> DepthProfile:
    """Return the parameters as a depth profile; ``support`` (cells,) is the number of samples in each cell."""
    values = local.sign * np.exp(local.log_parameters)
    std = np.exp(local.log_parameters) * np.sqrt(np.einsum("kim,kim->ki", local.root, local.root))
    depth = np.arange(partitions.count) % partitions.depths
    return DepthProfile(
        position=local.position,
        low=partitions.breakpoints[depth],
        high=partitions.breakpoints[depth + 1],
        direction=partitions.direction,
        mass=values[:, 0],
        mass_std=std[:, 0],
        damping=values[:, 1],
        damping_std=std[:, 1],
        stiffness=values[:, 2],
        stiffness_std=std[:, 2],
        support=support,
    )


def means_and_slopes(local: LocalParameters, position: float) -> dict[str, Estimate]:
    """Return mass, damping and stiffness at a position (m), and their derivatives with respect to depth there.

    They are read from weighted curves through the logarithms of the cells: parabolas for five or more cells, lines for
    three or four. Scatter of the cells beyond their standard deviations widens the result's.
    """
    determined = local.determined
    estimates: dict[str, Estimate] = {}
    count = int(determined.sum())
    if count == 0:
        return estimates
    distance = local.position[determined] - position
    size = float(np.max(np.abs(distance))) or 1.0
    degree = 2 if count >= _PARABOLA else int(count >= _LINE)
    powers = np.vander(distance / size, degree + 1, increasing=True)
    for index, (name, slope_name) in enumerate(_NAMES):
        root = local.root[determined, index]
        weight = 1.0 / np.sqrt(np.einsum("km,km->k", root, root) + _SCATTER**2)
        pick = np.linalg.pinv(powers * weight[:, None]) * weight
        coefficients = pick @ local.log_parameters[determined, index]
        residual = local.log_parameters[determined, index] - powers @ coefficients
        spare = max(1, count - degree - 1)
        scatter = float(np.sum((weight * residual) ** 2) / np.sum(weight**2)) * count / spare
        std = np.sqrt(np.sum((pick @ root) ** 2, axis=1) + scatter * np.sum(pick**2, axis=1))
        value = local.sign * math.exp(float(coefficients[0]))
        estimates[name] = Estimate(value, abs(value) * float(std[0]))
        if degree:
            slope = value * float(coefficients[1]) / size
            estimates[slope_name] = Estimate(slope, math.hypot(value * float(std[1]) / size, slope * float(std[0])))
    return estimates


def _band(x: Array, grid: LagGrid, linear: SecondOrderFit) -> _Band:
    rate = linear.sample_rate_hz
    frequency, power = input_spectrum(x, rate)
    used = np.flatnonzero((power > _EXCITED_POWER * float(power[1:].max())) & (frequency > 0.0))
    turn = np.exp(-2j * np.pi * np.outer(frequency[used], np.arange(grid.lags) * grid.spacing / rate))
    return _Band(frequency[used], power[used], turn, rate, linear.hold)


def _centre(output: Array, at_output: bool) -> float:
    """Return the position to which a cell's kernel belongs, from the outputs in it; NaN for an empty cell.

    A line fitted to a parabola has the slope of the parabola not at the mean, but shifted towards the longer tail.
    """
    if output.size == 0:
        return math.nan
    mean = float(np.mean(output))
    if not at_output:
        return mean
    away = output - mean
    moved = float(np.mean(away**3)) / (2.0 * max(float(np.mean(away**2)), 1e-300))
    return float(np.clip(mean + moved, output.min(), output.max()))


def _linearised(
    direct: LocalParameters, partitions: Partitions, solved: PartitionedKernels, band: _Band
) -> LocalParameters:
    """Return the response of the fitted model to small inputs at rest at each depth, as a second-order system."""
    determined = direct.determined
    slope = _depth_slopes(direct, partitions.direction)  # (cells, cells): slope at each cell from all logarithms
    log_parameters, root = np.full_like(direct.log_parameters, np.nan), np.zeros_like(direct.root)
    offset, offset_root = float(solved.offsets[0]), solved.offset_root[0]
    filled = np.where(determined[:, None], direct.log_parameters, 0.0)
    turning = slope @ filled  # (cells, 3)
    turning_root = np.einsum("ck,kim->cim", slope, direct.root)
    for cell in np.flatnonzero(determined):
        own = direct.log_parameters[cell]
        depth = direct.sign * (direct.position[cell] - offset)

        def answer(values: Array, depth: float = depth) -> Complex:
            """Return the response (bins,) from log M, B, K, their slopes, and a shift of the offset."""
            response, slopes = band.response(values[:3])
            steady = (depth - values[6]) * math.exp(values[2])
            turned = np.einsum("i,ij->j", values[3:6], slopes)
            return np.asarray(response / (1.0 - direct.sign * steady * turned), dtype=np.complex128)

        at = np.concatenate([own, turning[cell], [0.0]])
        fitted = band.fit(answer(at), own)
        if fitted is None:
            continue
        log_parameters[cell], carried = fitted
        size = np.array([1.0, 1.0, 1.0, *([1.0 / _span(partitions)] * 3), _span(partitions)])
        moves = np.array(
            [answer(at + _STEP * size * unit) - answer(at - _STEP * size * unit) for unit in np.eye(7)], np.complex128
        )
        slopes_by = carried @ _split((moves / (2.0 * _STEP * size[:, None])).T)  # (3, 7)
        changes = np.vstack([direct.root[cell], turning_root[cell], direct.sign * offset_root[None]])
        root[cell] = slopes_by @ changes
    return LocalParameters(direct.position, log_parameters, root, direct.sign)


def _depth_slopes(direct: LocalParameters, direction: NDArray[np.int_]) -> Array:
    """Return rows (cells, cells) that map the logarithms to the slope of a line through the cells of each direction."""
    rows = np.zeros((direct.position.size, direct.position.size))
    for way in np.unique(direction):
        mine = np.flatnonzero(direct.determined & (direction == way))
        if mine.size < 2:
            continue
        spread = np.einsum("kim,kim->k", direct.root[mine], direct.root[mine]) / 3.0
        weight = 1.0 / (spread + _SCATTER**2)
        away = direct.position[mine] - np.average(direct.position[mine], weights=weight)
        rows[np.ix_(np.flatnonzero(direction == way), mine)] = weight * away / np.sum(weight * away**2)
    return rows


def _span(partitions: Partitions) -> float:
    return float(partitions.breakpoints[-1] - partitions.breakpoints[0])


def _split(values: Complex) -> Array:
    """Return the real part stacked on the imaginary part along the first axis."""
    return np.concatenate([values.real, values.imag], axis=0)
