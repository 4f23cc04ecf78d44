"""Plots of partitions of depth and direction: their limits and their kernels (Chen 2010, ch. 5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tissueid.analysis.curves.plot import CONFIDENCE, Array, Axis, Bars, Curve, Plot, depth_roles
from tissueid.analysis.curves.units import LAG, TIME, kernel_unit, signal_axis
from tissueid.analysis.partition_error import PartitionError
from tissueid.identification.partitions.model import PartitionedModel
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Record
from tissueid.units import display_unit

_WAYS = {1: marked("into the tissue"), -1: marked("out of the tissue"), 0: marked("as fitted")}
_STRETCH_S = 4.0
"""Seconds of the output that are drawn."""
_TARGET_PERCENT = 5.0
"""Error that the thesis reaches from 500 samples on."""
_BAR = 0.92
"""Width of the bar of a partition, as a share of the partition."""


def partition_plots(model: PartitionedModel, record: Record, fit_part: slice) -> tuple[Plot, Plot]:
    """Return the output with the limits of the partitions, and the samples in each (Chen 2010, Fig. 5.4a)."""
    scale = display_unit(record.output_unit)[1]
    limits = scale * model.breakpoints_m
    roles = depth_roles(model.partitions.depths)
    first = fit_part.indices(len(record))[0]
    shown = slice(first, first + round(_STRETCH_S * record.sample_rate_hz))
    time_s = record.time[shown]
    lines = [Curve(np.zeros(1), np.array([at]), "", "muted", "level", width=0.8) for at in limits]
    every_other = limits[1:][: (limits.size - 1) // 2 * 2]
    shade = Curve(np.zeros(0), every_other, "", "muted", "spans", opacity=0.12, across=True)
    output = Curve(time_s, scale * record.output[shown], "", roles[-1], width=0.5)
    seen = scale * model.partitions.filtered(record.output)[fit_part]
    counts = np.histogram(seen[np.isfinite(seen)], limits)[0].astype(np.float64)
    middle, width = 0.5 * (limits[1:] + limits[:-1]), _BAR * np.diff(limits)
    bars = [
        Bars(middle[[row]], counts[[row]], width[[row]], colour=role, across=True) for row, role in enumerate(roles)
    ]
    depth = signal_axis(record.output_name, record.output_unit, reverse=True)
    time = replace(TIME, limits=(float(time_s[0]), float(time_s[-1])))
    return (
        Plot("", time, depth, (shade, *lines, output)),
        Plot("", Axis(marked("Samples")), depth, (shade, *lines, *bars)),
    )


def kernel_curves(model: PartitionedModel, record: Record) -> tuple[Plot, Plot]:
    """Return the kernels of each direction, coloured by depth, with 95 % bands of the outermost (Chen 2010, Fig. 5.4b).

    Without directions the second plot shows the kernels about the mean input.
    """
    unit, scale = kernel_unit(record)
    ways = [way for way in (0, 1, -1) if np.any(model.direction == way)]
    shown = [
        (_WAYS[way], scale * model.kernels[model.direction == way], scale * model.kernels_std[model.direction == way])
        for way in ways
    ]
    if len(ways) == 1:
        kernels = scale * model.operating_kernels
        shown.append((marked("about the mean input"), kernels, np.full(kernels.shape, np.nan)))
    lag_ms = 1e3 * model.lag_s
    lag = replace(LAG, limits=(0.0, float(lag_ms[-1]) or 1.0))
    limits = display_unit(record.output_unit)[1] * model.breakpoints_m[[0, -1]]
    depth = replace(signal_axis(record.output_name, record.output_unit), limits=(float(limits[0]), float(limits[1])))
    left, right = (
        Plot(title, lag, Axis(marked("Kernel"), unit, zero=True), tuple(_coloured(lag_ms, rows, std)))
        for title, rows, std in shown[:2]
    )
    return left, replace(right, depths=depth)


def partition_error_plots(errors: Sequence[PartitionError]) -> tuple[Plot, Plot]:
    """Return the error of partitions against the length of a stretch and against all samples (Chen 2010, Fig. 5.2).

    A line for each number of repetitions; the level is 5 %.
    """
    repetitions = sorted({one.repetitions for one in errors})
    by_length, by_points = list[Curve](), list[Curve]()
    for count, role in zip(repetitions, depth_roles(len(repetitions)), strict=True):
        rows = [one for one in errors if one.repetitions == count]
        name = Message("plot.repetitions", "repetitions: {count}", count=count)
        error = np.array([one.mean_percent for one in rows])
        for into, x in ((by_length, [one.continuous for one in rows]), (by_points, [one.points for one in rows])):
            into.append(Curve(np.array(x, np.float64), error, name, role, marker="o"))
    level = Curve(np.ones(1), np.array([_TARGET_PERCENT]), "", "muted", "level", width=0.8)
    y = Axis(marked("Error of M, B and K"), "%", log=True)
    ends = [float(min(one.continuous for one in errors)), float(max(one.continuous for one in errors))]
    whole = [float(min(one.points for one in errors)), float(max(one.points for one in errors))]
    length = Axis(marked("Continuous samples"), log=True, limits=(ends[0], ends[1]))
    points = Axis(marked("Samples"), log=True, limits=(whole[0], whole[1]))
    return Plot("", length, y, (*by_length, level)), Plot("", points, y, (*by_points, level))


def _coloured(lag_ms: Array, rows: Array, std: Array) -> list[Curve]:
    """Return kernels (K, lags) as curves from shallow to deep; the first and the last have bands where known."""
    curves = [Curve(lag_ms, kernel, "", role) for kernel, role in zip(rows, depth_roles(len(rows)), strict=True)]
    for place in {0, len(curves) - 1}:
        half = CONFIDENCE * np.where(np.isfinite(std[place]), std[place], 0.0)
        if half.any():
            curves[place] = replace(curves[place], low=rows[place] - half, high=rows[place] + half)
    return curves


__all__ = ["kernel_curves", "partition_error_plots", "partition_plots"]
