"""Plots of kernels over two lags, or over lag and depth."""

from __future__ import annotations

import numpy as np

from tissueid.analysis.curves.plot import Array, Axis, Plot, Surface
from tissueid.analysis.curves.units import LAG, kernel_unit, ratio_unit, signal_axis
from tissueid.errors import UnusableInputError
from tissueid.identification.base import Model
from tissueid.identification.partitions.model import PartitionedModel
from tissueid.identification.volterra.model import VolterraModel
from tissueid.language import marked
from tissueid.records import Record
from tissueid.units import display_unit

_MOST_FREQUENCIES = 400
_FINER = 4
"""Zero-padding factor of the spectrum of a kernel."""
_LEFT = 0.02
"""Frequencies with less than this share of the maximum magnitude are not shown."""


def second_order_kernel(model: VolterraModel, record: Record) -> Plot:
    """Return the second-order kernel over two lags (Chen 2010, Figs. 4.3, 4.6b and 4.9).

    Raises:
        UnusableInputError: the model has no second-order kernel, or fewer than three lags.
    """
    kernel = model.kernel2
    if kernel is None:
        raise UnusableInputError(
            "report.no_second_kernel", "a model of order {order} has no second-order kernel", order=model.order
        )
    if kernel.shape[0] < 3:
        raise UnusableInputError("report.few_lags", "the second-order kernel has fewer than three lags")
    unit, scale = kernel_unit(record, 2)
    title, lag_ms = marked("Second-order kernel"), 1e3 * model.lag_s
    surface = Surface(lag_ms, lag_ms, scale * kernel, title, unit)
    return Plot(title, Axis(marked("First lag"), "ms"), Axis(marked("Second lag"), "ms"), (surface,))


def kernels_by_depth(model: PartitionedModel, record: Record) -> Plot:
    """Return the kernels about the mean input over lag and depth (Chen 2010, Figs. 5.5c and d).

    Raises:
        UnusableInputError: there are fewer than two partitions or three lags.
    """
    if model.partitions.depths < 2 or model.lag_s.size < 3:
        raise UnusableInputError("report.no_image", "an image needs at least two partitions and three lags")
    unit, scale = kernel_unit(record)
    title, name = marked("Kernels against depth"), marked("Kernel")
    return _over_depth(title, name, unit, LAG, 1e3 * model.lag_s, scale * model.operating_kernels, model, record)


def magnitude_by_depth(model: PartitionedModel, record: Record) -> Plot:
    """Return the magnitude of the frequency response at each depth, up to the last significant frequency.

    Raises:
        UnusableInputError: there are fewer than two partitions or three lags.
    """
    kernels = kernels_by_depth(model, record).surface
    assert kernels is not None
    spacing_s = float(model.lag_s[1] - model.lag_s[0])  # lags may be several samples apart
    count = _FINER * model.lag_s.size
    magnitude = spacing_s * np.abs(np.fft.rfft(kernels.values, count, axis=1))
    frequency_hz = np.asarray(np.fft.rfftfreq(count, spacing_s), np.float64)
    largest = magnitude.max(axis=0)
    last = int(np.flatnonzero(largest > _LEFT * largest.max())[-1]) + 1
    some = slice(0, max(last, _FINER), -(-last // _MOST_FREQUENCIES))
    title, name, unit = marked("Bode magnitude against depth"), marked("Magnitude"), ratio_unit(record)[0]
    frequency = Axis(marked("Frequency"), "Hz")
    return _over_depth(title, name, unit, frequency, frequency_hz[some], magnitude[:, some], model, record)


def kernel_plots(model: Model, record: Record) -> tuple[Plot, ...]:
    """Return the plots of the kernels of a model; none for most engines."""
    try:
        if isinstance(model, VolterraModel):
            return (second_order_kernel(model, record),)
        if isinstance(model, PartitionedModel):
            return kernels_by_depth(model, record), magnitude_by_depth(model, record)
    except UnusableInputError:
        pass
    return ()


def _over_depth(
    title: str, name: str, unit: str, x: Axis, across: Array, rows: Array, model: PartitionedModel, record: Record
) -> Plot:
    """Return rows of values (partitions, columns) over the partitions of depth, deep at the bottom."""
    edges = display_unit(record.output_unit)[1] * model.breakpoints_m
    surface = Surface(across, 0.5 * (edges[1:] + edges[:-1]), rows, name, unit, edges=edges)
    return Plot(title, x, signal_axis(record.output_name, record.output_unit, reverse=True), (surface,))


__all__ = ["kernel_plots", "kernels_by_depth", "magnitude_by_depth", "second_order_kernel"]
