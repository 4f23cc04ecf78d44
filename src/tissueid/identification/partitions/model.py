"""Partitioned model: kernels by depth, or by depth and direction, with free-run and scheduled simulation."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissueid.formatting import number
from tissueid.identification.base import Array, Mask, Model
from tissueid.identification.depth_profile import DepthProfile
from tissueid.identification.partitions.estimation import Contrast, LocalEstimates
from tissueid.identification.partitions.parameters import LocalParameters, means_and_slopes, profile
from tissueid.identification.partitions.regression import UNKNOWN, Cells, PartitionedKernels, Partitions
from tissueid.identification.preparation import SAMPLES_PER_PARAMETER, complete_after_rest
from tissueid.identification.second_order_fit import SecondOrderFit
from tissueid.identification.validation import vaf_percent
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Estimate, Record

_SIGNIFICANT = 2.6
"""Standard deviations beyond which a change with depth or direction is significant (99 % of a normal variable)."""

_LARGE_LOSS_POINTS = 5.0
"""Difference of scheduled and free-run VAF, percentage points, above which a warning is given."""

_SHARES = {"mass_kg": "mass", "damping_n_s_per_m": "damping", "stiffness_n_per_m": "stiffness"}


def by_direction(local: LocalEstimates, way: int) -> LocalParameters:
    """Return the local parameters of inward (1) or outward (-1) motion; the mass is the same."""
    if local.contrast is None:
        return local.local
    share = np.clip(way * local.contrast.share, -0.95, None)  # (K, 2)
    more = local.contrast.root.shape[2]
    logs, root = local.local.log_parameters.copy(), np.pad(local.local.root, ((0, 0), (0, 0), (0, more)))
    logs[:, 1:] += np.log1p(share)
    root[:, 1:, -more:] = (way / (1.0 + share))[:, :, None] * local.contrast.root
    return replace(local.local, log_parameters=logs, root=root)


def profile_of(local: LocalEstimates, partitions: Partitions, cells: Cells, used: Mask) -> DepthProfile:
    """Return one row for each cell; with directions, rows of inward and then of outward motion."""
    support = np.bincount(cells[used], minlength=partitions.count)
    if not local.certain:
        local = replace(local, local=replace(local.local, root=np.full_like(local.local.root, np.nan)))
    if not partitions.directional or local.local.position.size == partitions.count:
        return profile(local.local, partitions, support)
    ways = [by_direction(local, way) for way in (1, -1)]
    both = LocalParameters(
        position=np.concatenate([way.position for way in ways]),
        log_parameters=np.concatenate([way.log_parameters for way in ways]),
        root=np.concatenate([way.root for way in ways]),
        sign=local.local.sign,
    )
    return profile(both, partitions, support)


def named_parameters(
    local: LocalEstimates, partitions: Partitions, position: float, linear: SecondOrderFit
) -> dict[str, Estimate]:
    """Return mass, damping and stiffness at a position, m, and their slopes; a gain for other signals."""
    if not linear.mechanical:
        return linear.parameters
    estimates = means_and_slopes(local.local, position)
    if local.contrast is not None:
        for way, word in ((1, "in"), (-1, "out")):
            there = means_and_slopes(by_direction(local, way), position)
            for name, unit in (("damping", "n_s_per_m"), ("stiffness", "n_per_m")):
                estimates[f"{name}_{word}_{unit}"] = there.get(f"{name}_{unit}", Estimate(math.nan))
    if not local.certain:
        estimates = {name: Estimate(estimate.value) for name, estimate in estimates.items()}
    missing = {name: linear.parameters[name] for name in _SHARES if name not in estimates}
    return estimates | missing


def details_of(
    model: PartitionedModel, record: Record, scored: Mask, scheduled: Array, solved: PartitionedKernels
) -> dict[str, float]:
    """Return figures beyond the common ones.

    ``vaf_of_place_percent`` is the VAF of the mean output of each partition, without any input: a baseline of the
    scheduled VAF.
    """
    y = record.output[scored]
    cells = model.partitions.cells(record.output)[scored]
    means = np.bincount(cells, weights=y, minlength=model.partitions.count).astype(np.float64)
    means /= np.maximum(np.bincount(cells, minlength=model.partitions.count), 1)
    return {
        "vaf_scheduled_fitted_percent": vaf_percent(y, scheduled[scored]),
        "vaf_of_place_percent": vaf_percent(y, means[cells]),
        "condition_number": solved.condition,
        "partitions": float(model.partitions.count),
        "lags": float(model.lag_s.size),
        "lag_spacing": float(model.lag_spacing),
    }


def fit_warnings(vaf: float, details: dict[str, float], local: LocalEstimates, few: bool) -> tuple[str, ...]:
    """Return warnings on the fit."""
    messages = list(local.warnings)
    if few:
        messages.append(
            Message(
                "partitions.few_samples",
                "fewer than {fewest} usable samples for each parameter: record longer, or take fewer partitions",
                fewest=SAMPLES_PER_PARAMETER,
            )
        )
    lost = details["vaf_scheduled_fitted_percent"] - vaf
    if lost > _LARGE_LOSS_POINTS:
        messages.append(
            Message(
                "partitions.needs_measured_depth",
                "in free run the model loses {points:.1f} points of VAF: the score with the measured output as the "
                "schedule depends on the measured depth",
                points=lost,
            )
        )
    missing = int(np.count_nonzero(~local.local.determined))
    if missing:
        messages.append(
            Message(
                "partitions.not_second_order",
                "{missing} of {kernels} kernels are not those of a second-order system",
                missing=missing,
                kernels=int(local.local.determined.size),
            )
        )
    return tuple(messages)


def findings(local: LocalEstimates, partitions: Partitions, linear: SecondOrderFit) -> tuple[str, ...]:
    """Return how stiffness, damping and mass change with depth, and whether damping depends on the direction.

    Nothing is stated where the standard deviations do not hold.
    """
    if not linear.mechanical or np.count_nonzero(local.local.determined) < 2 or not local.certain:
        return ()
    determined = np.flatnonzero(local.local.determined)
    first, last = (
        determined[np.argmin(local.local.position[determined])],
        determined[np.argmax(local.local.position[determined])],
    )
    messages: list[str] = []
    for index, name, unit in (
        (2, marked("stiffness"), "N/m"),
        (1, marked("damping"), "N·s/m"),
        (0, marked("mass"), "g"),
    ):
        values = np.exp(local.local.log_parameters[:, index]) * (1e3 if unit == "g" else 1.0)
        change = float(np.log(values[last] / values[first]))
        spread = float(np.linalg.norm(local.local.root[last, index] - local.local.root[first, index]))
        depths = {"low": 1e3 * local.local.position[first], "high": 1e3 * local.local.position[last]}
        ends = {"start": number(values[first], 3), "end": number(values[last], 3), "unit": unit}
        if abs(change) <= _SIGNIFICANT * spread:
            messages.append(
                Message(
                    "depth.constant",
                    "{name} does not change beyond its uncertainty from {low:.2f} to {high:.2f} mm",
                    name=name,
                    **depths,
                )
            )
        elif change > 0.0:
            messages.append(
                Message(
                    "depth.rises",
                    "{name} rises from {start} to {end} {unit} from {low:.2f} to {high:.2f} mm",
                    name=name,
                    **ends,
                    **depths,
                )
            )
        else:
            messages.append(
                Message(
                    "depth.falls",
                    "{name} falls from {start} to {end} {unit} from {low:.2f} to {high:.2f} mm",
                    name=name,
                    **ends,
                    **depths,
                )
            )
    if local.contrast is not None:
        messages += [_direction_finding(local.contrast, kind) for kind in (1, 0)]
    return tuple(messages)


def _direction_finding(contrast: Contrast, kind: int) -> Message:
    """Return whether damping (0) or stiffness (1) depends on the direction, by its weighted mean over the cells."""
    spread = np.linalg.norm(contrast.root[:, kind], axis=1)
    weight = 1.0 / np.maximum(spread, 1e-12) ** 2
    share = float(np.sum(weight * contrast.share[:, kind]) / np.sum(weight))
    std = float(np.linalg.norm(weight @ contrast.root[:, kind]) / np.sum(weight))
    name, prefix = (marked("stiffness"), "stiffness_") if kind else (marked("damping"), "")
    values = {"name": name, "percent": 100.0 * abs(share), "std": 100.0 * std}
    if abs(share) <= _SIGNIFICANT * std:
        return Message(
            f"direction.{prefix}none",
            "{name} does not depend on the direction beyond its uncertainty ({percent:.1f} ± {std:.1f} %)",
            **values | {"percent": 100.0 * share},
        )
    if share > 0.0:
        return Message(
            f"direction.{prefix}larger_inward",
            "{name} is larger in inward than in outward motion: {percent:.1f} ± {std:.1f} % above and below their mean",
            **values,
        )
    return Message(
        f"direction.{prefix}larger_outward",
        "{name} is larger in outward than in inward motion: {percent:.1f} ± {std:.1f} % above and below their mean",
        **values,
    )


_TIE = 1e-9
"""Penalty that prefers the cell of the previous sample among equals, relative to the partitioned range."""


@njit(cache=True)
def scheduled_run(x: Array, cells: Cells, kernels: Array, offsets: Array, spacing: int, at_output: bool) -> Array:
    """Return the response to an input in given cells.

    Args:
        x: input without NaN, minus its reference, shape (memory - 1 + n,): the first samples only fill the memory.
        cells: cell of each of them, not negative.
        kernels: per sample, shape (cells, lags).
        offsets: shape (cells,).
        spacing: samples between lags.
        at_output: the cell of the output sample selects the kernel for all lags, instead of the cell at each lag.

    Returns:
        Output, shape (n,).
    """
    lags = kernels.shape[1]
    warm = (lags - 1) * spacing
    output = np.empty(x.size - warm)
    for n in range(output.size):
        now = cells[n + warm]
        total = offsets[now]
        for lag in range(lags):
            sample = n + warm - lag * spacing
            total += kernels[now if at_output else cells[sample], lag] * x[sample]
        output[n] = total
    return output


@njit(cache=True)
def free_run(
    x: Array,
    kernels: Array,
    offsets: Array,
    spacing: int,
    at_output: bool,
    inner: Array,
    directional: bool,
    pole: float,
    rest_cell: int,
    rest_output: float,
) -> tuple[Array, Cells]:
    """Return the response to an input in the cells of the response itself.

    At each sample every cell is tried. The cell whose output lies in its own range is used; if there is none or
    several, the one with the smallest distance, and among equals the previous cell or one adjacent to it.

    Args:
        x: input without NaN, minus its reference, shape (memory - 1 + n,): the first samples only fill the memory, all
            of them in ``rest_cell``.
        kernels: per sample, shape (cells, lags); with directions the cells of an increasing output come first.
        offsets: shape (cells,).
        spacing: samples between lags.
        at_output: as for :func:`scheduled_run`.
        inner: inner breakpoints, (depths - 1,).
        directional: whether cells differ by direction.
        pole: of the first-order low-pass between output and selection.
        rest_cell: cell before the first sample.
        rest_output: output before the first sample.

    Returns:
        Output and cells, both of shape (n,).
    """
    span = inner[-1] - inner[0] if inner.size > 1 else abs(rest_output)
    tie = _TIE * max(span, 1e-12)
    count, lags = kernels.shape
    depths = inner.size + 1
    warm = (lags - 1) * spacing
    output = np.empty(x.size - warm)
    cells = np.full(x.size, rest_cell)
    seen, last = rest_output, rest_cell
    for n in range(output.size):
        past = 0.0
        if not at_output:
            for lag in range(1, lags):
                sample = n + warm - lag * spacing
                past += kernels[cells[sample], lag] * x[sample]
        best, least, best_seen = -1, np.inf, 0.0
        for cell in range(count):
            value = offsets[cell] + past + kernels[cell, 0] * x[n + warm]
            if at_output:
                for lag in range(1, lags):
                    value += kernels[cell, lag] * x[n + warm - lag * spacing]
            passed = pole * seen + (1.0 - pole) * value
            depth = cell % depths
            miss = 0.0
            if depth > 0:
                miss = max(miss, inner[depth - 1] - passed)
            if depth < depths - 1:
                miss = max(miss, passed - inner[depth])
            if directional:
                miss = max(miss, seen - passed if cell < depths else passed - seen)
            miss += tie * (abs(depth - last % depths) + (0.5 if cell // depths != last // depths else 0.0))
            if miss < least:
                best, least, best_seen = cell, miss, passed
                output[n] = value
        cells[n + warm] = best
        seen, last = best_seen, best
    return output, cells[warm:]


@dataclass(frozen=True, eq=False)
class PartitionedModel(Model):
    """y(n) = offset + sum over lags of kernels[cell](lag) times input, the cell selected by depth (Chen 2010, chapter
    5).

    ``kernels`` (cells, lags) with ``kernels_std`` are in output per input and second, at ``lag_s`` (lags,), which are
    ``lag_spacing`` samples apart; they act on the input minus ``reference``. ``offsets`` (cells,) are equal if all
    cells share one. ``direction`` (cells,) is 1 for cells of an increasing output, which come first, -1 for those of a
    decreasing one, and 0 without directions. With ``at_output`` the cell of the output sample selects the kernel for
    all lags, else the cell of the output at the time of each lag. ``operating_kernels`` (K, lags), by depth only, act
    on the input minus its mean and give mass, damping and stiffness. A free run starts at ``rest_position``.

    ``memory_samples`` is three times the memory of the kernels if the simulated output selects the kernels: so long
    after a gap, two runs of one model agree to rounding.
    """

    partitions: Partitions
    kernels: Array
    kernels_std: Array
    offsets: Array
    lag_s: Array
    lag_spacing: int
    reference: float
    at_output: bool
    input_mean: float
    rest_cell: int
    rest_position: float
    operating_kernels: Array
    local: DepthProfile | None

    @property
    def breakpoints_m(self) -> Array:
        """Breakpoints of depth, (K + 1,), in the unit of the output."""
        return self.partitions.breakpoints

    @property
    def direction(self) -> NDArray[np.int_]:
        """Direction of each cell, (cells,)."""
        return self.partitions.direction

    @property
    def window(self) -> int:
        """Samples from the first lag to the last, both included."""
        return (self.lag_s.size - 1) * self.lag_spacing + 1

    def simulate(self, u: Array) -> Array:
        """Simulate in free run: input (n,), output (n,), with kernels selected by the simulated output.

        At rest at the mean input of the fit before the first sample. Each output is a finite sum of kernels times
        inputs, so that the simulation is stable for any sequence of cells.
        """
        u = np.asarray(u, dtype=np.float64)
        x = np.concatenate([np.full(self.window - 1, self.input_mean), np.where(np.isfinite(u), u, self.input_mean)])
        output, _ = free_run(
            x - self.reference,
            self.kernels / self._rate,
            self.offsets,
            self.lag_spacing,
            self.at_output,
            self.partitions.breakpoints[1:-1],
            self.partitions.directional,
            self.partitions.pole,
            self.rest_cell,
            self.rest_position,
        )
        output[~complete_after_rest(np.isfinite(u), self.memory_samples)] = np.nan
        return output  # type: ignore[no-any-return]  # compiled

    def simulate_scheduled(self, record: Record) -> Array:
        """Simulate with kernels selected by the measured output, shape (n,), as in the thesis.

        The measured output selects the kernel that predicts it, so that a score of this simulation is not that of a
        free run. NaN where the memory contains an input or output that was not received.
        """
        self.check_rate(record)
        cells = self.partitions.cells(record.output)
        usable = np.isfinite(record.input) & (cells != UNKNOWN)
        rest = self.window - 1
        x = np.concatenate([np.full(rest, self.input_mean), np.where(usable, record.input, self.input_mean)])
        placed = np.concatenate([np.full(rest, self.rest_cell), np.where(usable, cells, self.rest_cell)])
        output = scheduled_run(
            x - self.reference,
            placed.astype(np.int64),
            self.kernels / self._rate,
            self.offsets,
            self.lag_spacing,
            self.at_output,
        )
        output[~complete_after_rest(usable, self.window)] = np.nan
        return output  # type: ignore[no-any-return]  # compiled

    def depth_profile(self) -> DepthProfile | None:
        """Return the mass, damping and stiffness of each cell; None if the record is not force and position."""
        return self.local

    @property
    def _rate(self) -> float:
        """Lags per second."""
        return self.sample_rate_hz / self.lag_spacing


def equilibrium(
    kernels: Array, offsets: Array, steady: float, partitions: Partitions, position: float
) -> tuple[int, float]:
    """Return cell and output in equilibrium with a steady input (minus the reference).

    The cell is the one whose output is closest to its range, and among equals the one nearest to ``position``.
    ``kernels`` (cells, lags) are per sample.
    """
    outputs = offsets + steady * kernels.sum(axis=1)  # (cells,)
    inner = partitions.breakpoints[1:-1]
    low = np.concatenate([[-np.inf], inner])
    high = np.concatenate([inner, [np.inf]])
    depth = np.arange(outputs.size) % partitions.depths
    miss = np.maximum(np.maximum(low[depth] - outputs, outputs - high[depth]), 0.0)
    tie = 1e-9 * np.abs(outputs - position)
    cell = int(np.argmin(miss + tie))
    return cell, float(outputs[cell])
