"""Engines whose kernels depend on depth (``depth``), and on depth and direction of motion (``direction``)."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar, Literal

import numpy as np

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Family, Mask, option
from tissueid.identification.depth_levels import is_stepped
from tissueid.identification.depth_profile import DepthProfile
from tissueid.identification.memory import MemoryEngine
from tissueid.identification.partitions.estimation import DepthEstimator, LocalEstimates
from tissueid.identification.partitions.model import (
    PartitionedModel,
    details_of,
    equilibrium,
    findings,
    fit_warnings,
    free_run,
    named_parameters,
    profile_of,
)
from tissueid.identification.partitions.parameters import local_parameters
from tissueid.identification.partitions.regression import (
    UNKNOWN,
    Breakpoints,
    Cells,
    PartitionedKernels,
    Partitions,
    low_pass_pole,
    place_breakpoints,
    solve_along_lags,
    solve_at_output,
)
from tissueid.identification.preparation import (
    SAMPLES_PER_PARAMETER,
    PreparedRecord,
    complete_windows,
    part_mask,
    prepare,
)
from tissueid.identification.registry import engine
from tissueid.identification.second_order_fit import SecondOrderFit, fit_second_order
from tissueid.identification.volterra.regressors import LagGrid, automatic_grid, lag_grid, shortened
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Record

Offset = Literal["auto", "common", "mean", "partition"]
_OFFSETS = (marked("auto"), marked("common"), marked("mean"), marked("partition"))
"""Choices of the option as a form shows them, for translation."""

_MOST_COEFFICIENTS = 2000
"""Largest number of coefficients of all kernels on an automatic grid."""
_FEWEST_LAGS = 41
"""Number of lags of a kernel up to which they are not limited."""

_ROUNDS = 3
"""Number of times that the fitted samples are assigned to partitions by the model's own output."""


_SETTLING_MEMORIES = 3
"""Memories of the kernels after which the initial state of a free run has decayed."""

_STEPPED = Message(
    "partitions.stepped",
    "the input is stepped: an offset for each partition, or the engine localized, gives more accurate mass, damping "
    "and stiffness",
)
_OWN_OFFSETS = Message("partitions.own_offsets", "the input is stepped: every partition has its own offset")


class PartitionEngine(MemoryEngine):
    """Options and fit that both engines share."""

    directional: ClassVar[bool]
    usual_memory_s: ClassVar[float] = 0.06
    memory_margin: ClassVar[float] = 1.0

    partitions: int = option(7, marked("Partitions"), marked("Number of depth partitions"), ge=1, le=100)
    breakpoints: Breakpoints = option(
        "count", marked("Breakpoints"), marked("Partitions with equal counts of samples, or of equal width")
    )
    breakpoints_m: tuple[float, ...] | None = option(
        None,
        marked("Given breakpoints"),
        marked("Increasing positions of the cuts, m; replace the number of partitions"),
    )
    filter_hz: float | None = option(
        None,
        marked("Low-pass"),
        marked("Cutoff of the low-pass for the output that selects the partition; no low-pass if not given"),
        gt=0.0,
        le=1e6,
    )
    downsample: int | None = option(
        None,
        marked("Downsampling"),
        marked("Samples between the lags of the kernels; from the input if not given"),
        ge=1,
        le=1000,
    )
    offset: Offset = option(
        "auto",
        marked("Offset"),
        marked(
            "One offset and the force as measured (common, Eq. 5.1), one offset and the force about its mean (mean), "
            "or a linear model with an offset for each partition (partition); auto uses partition for stepped records"
        ),
    )
    correct: bool = option(
        True,
        marked("Bias correction"),
        marked("Subtract the bias of the estimator, found on a simulated tissue with the estimated parameters"),
    )

    def fit(self, record: Record, fit_part: slice | None = None) -> PartitionedModel:
        """Fit the kernels to a record, or to a contiguous part of it.

        Raises:
            UnusableInputError: nothing varies, too few samples, a memory longer than the part, breakpoints outside the
                motion, or a partition with too few samples.
        """
        rate = record.sample_rate_hz
        first = prepare(record, fit_part, 1.0 / rate, 1)
        grid, cut = _grid(self, first)
        rows = prepare(record, fit_part, grid.memory_samples / rate, 1).used
        if not rows.any():
            raise UnusableInputError(
                "partitions.no_sample", "no usable sample: the record is full of gaps, or the memory is too long"
            )
        partitions = _cut(self, record.output, rows, rate)
        stepped = is_stepped(record.input, rows, grid.memory_samples)
        offset = self.offset if self.offset != "auto" else "partition" if stepped else "common"
        at_output = offset == "partition"
        n_parameters = partitions.count * (grid.lags + int(at_output)) + int(not at_output)
        prepared = prepare(record, fit_part, grid.memory_samples / rate, n_parameters)
        cells = partitions.cells(record.output)
        used = _usable(prepared, cells, grid, n_parameters, at_output)
        _check_support(partitions, cells, used, grid)
        linear = fit_second_order(record, prepared.used, self.hold)
        reference = 0.0 if offset == "common" else prepared.input_mean
        if at_output:
            solved, assigned = _assigned_by_model(record, prepared, partitions, cells, used, grid)
        else:
            solved = solve_along_lags(record.input, record.output, reference, cells, partitions.count, used, grid, rate)
            assigned = cells
        local = _local(self, prepared, partitions, solved, assigned, used, grid, linear)
        profile = profile_of(local, partitions, cells, used) if linear.mechanical else None
        model = _model(solved, prepared, partitions, grid, local, profile, self)
        fitted = _reported(model, record, prepared, used, solved, local, linear)
        report = fitted.report
        own, doubted = ((_OWN_OFFSETS,), ()) if at_output else ((), (_STEPPED,))
        return fitted.with_report(
            warnings=(*cut, *report.warnings, *(doubted if stepped else ())),
            findings=(*report.findings, *(own if stepped else ())),
        )


def _cut(engine: PartitionEngine, output: Array, rows: Mask, sample_rate_hz: float) -> Partitions:
    """Return the partitions of the output (n,) at the rows of a mask (n,)."""
    pole = low_pass_pole(engine.filter_hz, sample_rate_hz)
    whole = Partitions(np.array([-np.inf, np.inf]), engine.directional, pole)
    seen = np.where(rows, whole.filtered(output), np.nan)
    places = place_breakpoints(seen, engine.partitions, engine.breakpoints, engine.breakpoints_m)
    return replace(whole, breakpoints=places)


def _grid(engine: PartitionEngine, first: PreparedRecord) -> tuple[LagGrid, tuple[str, ...]]:
    """Return the lags, and a warning if there are fewer than the memory needs."""
    rate = first.record.sample_rate_hz
    if engine.downsample is not None:
        return lag_grid(engine.memory_s, rate, engine.downsample), ()
    kernels = engine.partitions * (2 if engine.directional else 1)
    grid = automatic_grid(engine.memory_s, first.record.input[first.part] - first.input_mean, rate)
    return shortened(grid, max(_FEWEST_LAGS, _MOST_COEFFICIENTS // kernels), rate)


def _usable(prepared: PreparedRecord, cells: Cells, grid: LagGrid, n_parameters: int, at_output: bool) -> Mask:
    """Return the mask (n,) of the rows: prepared samples whose cell is known, along the lags throughout the memory."""
    in_cell = cells != UNKNOWN
    used = prepared.used & (in_cell if at_output else complete_windows(in_cell, grid.memory_samples))
    if int(used.sum()) < n_parameters:
        raise UnusableInputError(
            "partitions.too_few_samples",
            "{count} usable samples are too few for {parameters} parameters: record longer, take fewer "
            "partitions, or shorten the memory",
            count=int(used.sum()),
            parameters=n_parameters,
        )
    return used


def _check_support(partitions: Partitions, cells: Cells, used: Mask, grid: LagGrid) -> None:
    support = np.bincount(cells[used], minlength=partitions.count)
    least = int(np.argmin(support))
    if support[least] <= grid.lags:
        raise UnusableInputError(
            "partitions.too_few_in_one",
            "partition {number} of {partitions} has {count} samples, too few for its {parameters} parameters: "
            "take fewer partitions, cut them by equal count, or record longer",
            number=least + 1,
            partitions=partitions.count,
            count=int(support[least]),
            parameters=grid.lags,
        )


def _assigned_by_model(
    record: Record, prepared: PreparedRecord, partitions: Partitions, cells: Cells, used: Mask, grid: LagGrid
) -> tuple[PartitionedKernels, Cells]:
    """Return the linear models of each cell, with samples assigned by the free run of a model, initially that of Eq.
    5.1.

    Assignment by the measured output would sort the samples by noise and model error, and the kernels would be biased
    towards zero. The iteration with the smallest error is returned.
    """
    rate, mean = record.sample_rate_hz, prepared.input_mean
    complete = used & complete_windows(cells != UNKNOWN, grid.memory_samples)
    first = solve_along_lags(record.input, record.output, 0.0, cells, partitions.count, complete, grid, rate)
    _, own = _free_run_cells(record, prepared, partitions, grid, first)
    best: tuple[float, PartitionedKernels, Cells] | None = None
    for assigned in (own, cells):
        for _ in range(_ROUNDS):
            try:
                solved = solve_at_output(
                    record.input, record.output, mean, assigned, partitions.count, used, grid, rate
                )
            except UnusableInputError:
                if assigned is cells and best is None:
                    raise
                break
            output, own = _free_run_cells(record, prepared, partitions, grid, solved)
            error = float(np.mean((record.output[used] - output[used]) ** 2))
            if best is None or error < best[0]:
                best = (error, solved, assigned)
            if np.array_equal(own[used], assigned[used]):
                break
            assigned = own
        if best is not None:
            break
    assert best is not None
    return best[1], best[2]


def _free_run_cells(
    record: Record, prepared: PreparedRecord, partitions: Partitions, grid: LagGrid, solved: PartitionedKernels
) -> tuple[Array, Cells]:
    """Return free-run output and cells, (n,) each, for the input of the record; missing inputs are replaced by the
    mean.
    """
    mean = prepared.input_mean
    steady = mean - solved.reference
    rest_cell, rest = equilibrium(solved.kernels, solved.offsets, steady, partitions, prepared.output_mean)
    x = np.concatenate(
        [np.full(grid.memory_samples - 1, mean), np.where(np.isfinite(record.input), record.input, mean)]
    )
    return free_run(  # type: ignore[no-any-return]  # compiled
        x - solved.reference,
        solved.kernels,
        solved.offsets,
        grid.spacing,
        solved.at_output,
        partitions.breakpoints[1:-1],
        partitions.directional,
        partitions.pole,
        rest_cell,
        rest,
    )


def _local(
    engine: PartitionEngine,
    prepared: PreparedRecord,
    partitions: Partitions,
    solved: PartitionedKernels,
    assigned: Cells,
    used: Mask,
    grid: LagGrid,
    linear: SecondOrderFit,
) -> LocalEstimates:
    """Return the parameters against depth, by the method that belongs to the chosen offset."""
    record = prepared.record
    if solved.at_output:
        x = np.where(part_mask(len(record), prepared.part), record.input - prepared.input_mean, np.nan)
        local = local_parameters(solved, partitions, record.output[used], assigned[used], x, grid, linear)
        return LocalEstimates(local, solved)
    depth_only = replace(partitions, directional=False)
    estimator = DepthEstimator(
        prepared=prepared,
        used=used,
        partitions=depth_only,
        grid=grid,
        linear=linear,
    )
    if engine.correct:
        estimates = estimator.corrected()
        return estimates if engine.directional else replace(estimates, contrast=None)
    return estimator.estimate(record.output)


def _model(
    solved: PartitionedKernels,
    prepared: PreparedRecord,
    partitions: Partitions,
    grid: LagGrid,
    local: LocalEstimates,
    profile: DepthProfile | None,
    engine: PartitionEngine,
) -> PartitionedModel:
    rate = prepared.record.sample_rate_hz
    per_second = rate / grid.spacing
    steady = prepared.input_mean - solved.reference
    rest_cell, rest = equilibrium(solved.kernels, solved.offsets, steady, partitions, prepared.output_mean)
    own_past = not solved.at_output or partitions.directional or partitions.pole > 0.0
    return PartitionedModel(
        report=engine.unscored(0, solved.parameters),
        sample_rate_hz=rate,
        memory_samples=grid.memory_samples * (_SETTLING_MEMORIES if own_past else 1),
        partitions=partitions,
        kernels=solved.kernels * per_second,
        kernels_std=solved.kernels_std * per_second,
        offsets=solved.offsets,
        lag_s=np.arange(grid.lags) * grid.spacing / rate,
        lag_spacing=grid.spacing,
        reference=solved.reference,
        at_output=solved.at_output,
        input_mean=prepared.input_mean,
        rest_cell=rest_cell,
        rest_position=rest,
        operating_kernels=local.solved.kernels * per_second,
        local=profile,
    )


def _reported(
    model: PartitionedModel,
    record: Record,
    prepared: PreparedRecord,
    used: Mask,
    solved: PartitionedKernels,
    local: LocalEstimates,
    linear: SecondOrderFit,
) -> PartitionedModel:
    """Return the model with its report: scores of the free run on the fitted samples, parameters, findings and
    warnings.
    """
    simulated = model.simulate(record.input)
    scored = used & np.isfinite(simulated)
    if int(scored.sum()) < 2:
        scored = used
    scheduled = model.simulate_scheduled(record)
    model = model.with_fit_scores(record, scored, simulated)
    details = details_of(model, record, scored, scheduled, solved)
    parameters = named_parameters(local, model.partitions, float(np.median(record.output[used])), linear)
    few = int(used.sum()) < SAMPLES_PER_PARAMETER * solved.parameters
    return model.with_report(
        n_samples=int(used.sum()),
        parameters=parameters,
        warnings=(
            *prepared.warnings,
            *solved.warnings,
            *linear.left_out,
            *fit_warnings(model.report.vaf_percent, details, local, few and not prepared.warnings),
        ),
        findings=findings(local, model.partitions, linear),
        details=details,
    )


@engine
class Depth(PartitionEngine):
    """Depth engine.

    Assumes that the dynamics depend on the position of the probe but not on its history, that the output is a monotone
    function of the input in steady state, and that the response decays within ``memory``.
    """

    name: ClassVar[str] = "depth"
    label: ClassVar[str] = marked("Depth")
    title: ClassVar[str] = marked("Kernels that depend on depth (Chen 2010, 5.1-5.3).")
    family: ClassVar[Family] = Family.DEPTH
    directional: ClassVar[bool] = False


@engine
class Direction(PartitionEngine):
    """Direction engine.

    Damping and stiffness in indentation and retraction are estimated together with kernels that depend on depth only,
    because the kernels of Eq. 5.3 cannot distinguish a damping from a stiffness that depends on direction. The mass is
    assumed to be equal in both directions.
    """

    name: ClassVar[str] = "direction"
    label: ClassVar[str] = marked("Direction")
    title: ClassVar[str] = marked(
        "Kernels that depend on depth and on whether the probe moves in or out (Chen 2010, 5.4, Eqs. 5.3-5.4)."
    )
    family: ClassVar[Family] = Family.DIRECTION
    directional: ClassVar[bool] = True

    partitions: int = option(
        5, marked("Partitions"), marked("Number of depth partitions; there are twice as many kernels"), ge=1, le=50
    )
    filter_hz: float | None = option(
        50.0,
        marked("Low-pass"),
        marked("Cutoff of the low-pass for the output that selects the partition"),
        gt=0.0,
        le=1e6,
    )
    offset: Literal["common", "mean"] = option(  # type: ignore[assignment]  # fewer choices than the base
        "common",
        marked("Offset"),
        marked("The force as measured (Eq. 5.3), or about its mean; all kernels share one offset"),
    )
