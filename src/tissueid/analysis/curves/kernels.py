"""Plots of kernels: Volterra kernels, kernels by depth, kernels of several fits."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from tissueid.analysis.curves.overlay_plots import named, style_of
from tissueid.analysis.curves.plot import (
    CONFIDENCE,
    FREQUENCY,
    KINDS,
    LAG,
    TIME,
    Array,
    Axis,
    Bars,
    Curve,
    Plot,
    Surface,
    depth_roles,
    kernel_unit,
    ratio_unit,
    signal_axis,
)
from tissueid.analysis.curves.signals import POWER_DENSITY, density_curve
from tissueid.analysis.curves.validation import ROLES, Prediction, cloud_plot, prediction_plots
from tissueid.analysis.overlay import Overlay, OverlayEntry
from tissueid.errors import UnusableInputError
from tissueid.formatting import fixed
from tissueid.identification.base import Model
from tissueid.identification.partitions.model import PartitionedModel
from tissueid.identification.volterra.structure import VolterraModel
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Record
from tissueid.units import display_unit

_MOST_FREQUENCIES = 400
_FINER = 4
"""Zero-padding factor of the spectrum of a kernel."""
_FIRST_LAG, _SECOND_LAG = Axis(marked("First lag"), "ms"), Axis(marked("Second lag"), "ms")
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
    return Plot(title, _FIRST_LAG, _SECOND_LAG, (surface,))


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
    kernels = cast(Surface, kernels_by_depth(model, record).surface)
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


NO_KERNELS = Message("report.no_kernels", "a model of order zero has no kernels")
_SLICES_AT = np.array([0.1, 0.35, 0.6, 0.85])
"""Shares of the third-order kernel's cumulated magnitude at whose lags slices are drawn."""
_DECADES = 7.0
"""Decades below the largest density of the input that are shown."""


def third_order_slices(model: VolterraModel, record: Record) -> list[Plot]:
    """Return slices of the third-order kernel over two lags at a few values of its third lag, on one scale.

    Raises:
        UnusableInputError: the kernel has fewer than three lags.
    """
    kernel = model.kernel3
    assert kernel is not None
    unit, scale = kernel_unit(record, 3)
    lag_ms = 1e3 * model.lag_s
    if lag_ms.size < 3:
        raise UnusableInputError("report.few_lags_third", "the third-order kernel has fewer than three lags")
    strength = np.cumsum(np.abs(kernel).sum(axis=(0, 1)))
    shown = np.unique(np.searchsorted(strength, _SLICES_AT * strength[-1]))
    top = scale * float(np.abs(kernel[:, :, shown]).max())
    return [
        Plot(
            Message("plot.third_lag", "third lag {lag} ms", lag=fixed(float(lag_ms[lag]), 1)),
            _FIRST_LAG,
            _SECOND_LAG,
            (Surface(lag_ms, lag_ms, scale * kernel[:, :, lag], unit=unit if lag == shown[-1] else "", limit=top),),
            square=True,
        )
        for lag in shown
    ]


def kernel_and_spectrum(label: str, model: VolterraModel, record: Record) -> tuple[Plot, Plot]:
    """Return the second-order kernel and the magnitude of its two-dimensional Fourier transform.

    Raises:
        UnusableInputError: the model has no second-order kernel, or fewer than three lags.
    """
    surface = cast(Surface, second_order_kernel(model, record).surface)
    magnitude = np.abs(np.fft.fftshift(np.fft.fft2(surface.values)))
    spacing_s = model.lag_spacing / model.sample_rate_hz
    frequency_hz = np.asarray(np.fft.fftshift(np.fft.fftfreq(model.lag_s.size, spacing_s)), np.float64)
    frequency = replace(FREQUENCY, log=False)
    spectrum = Surface(
        frequency_hz, frequency_hz, magnitude / magnitude.max(), marked("relative to maximum"), signed=False
    )
    return (
        Plot(label, LAG, LAG, (replace(surface, name=""),), square=True),
        Plot("", frequency, frequency, (spectrum,), square=True),
    )


def impulse_contribution_plot(model: VolterraModel, record: Record, height: float) -> Plot:
    """Return the contribution of each order to the response to an impulse (Chen 2010, Eq. 4.15 and Fig. 4.3).

    Raises:
        UnusableInputError: the model has no kernels.
    """
    if model.kernel1 is None:
        raise UnusableInputError(NO_KERNELS)
    response, scale = model.impulse_response(height), display_unit(record.output_unit)[1]
    orders = [
        (marked("first order"), response.first),
        (marked("second order"), response.second),
        (marked("third order"), response.third),
    ][: model.order]
    lag_ms = 1e3 * model.lag_s
    parts = [Curve(lag_ms, scale * (response.total - response.zeroth), marked("total"), "text")]
    parts += [
        Curve(lag_ms, scale * values, label, colour, kind)
        for (label, values), colour, kind in zip(orders, ROLES, KINDS, strict=False)
    ]
    y = replace(signal_axis(f"change_of_{record.output_name}", record.output_unit), zero=True)
    return Plot("", LAG, y, tuple(parts))


def contribution_plots(model: VolterraModel, record: Record, part: slice) -> list[Plot]:
    """Return measured against modelled output of a part as orders are added (Chen 2010, Figs. 4.3 and 4.10).

    Raises:
        UnusableInputError: the model has no kernels, or no output was received.
    """
    if model.kernel1 is None:
        raise UnusableInputError(NO_KERNELS)
    measured = record.output[part]
    received = measured[np.isfinite(measured)]
    if not received.size:
        raise UnusableInputError("report.no_output", "no output was received in the fitted part")
    ends = float(received.min()), float(received.max())
    return [
        cloud_plot(modelled[part], measured, record.output_unit, label, ROLES[index % len(ROLES)], ends=ends)
        for index, (label, modelled) in enumerate(_cumulated(model, record.input))
    ]


def _cumulated(model: VolterraModel, u: Array) -> list[tuple[str, Array]]:
    """Return labels and outputs (n,) as contributions are added one after the other."""
    sums = np.cumsum(model.contributions(u), axis=0)
    shown = [(marked("first order"), sums[1])]
    if model.kernel2 is not None:
        diagonal_only = replace(model, kernel2=np.diag(np.diag(model.kernel2)), kernel3=None, order=2)
        shown.append((marked("and diagonal of the second"), np.sum(diagonal_only.contributions(u), axis=0)))
        shown.append((marked("and all of the second"), sums[2]))
    if model.kernel3 is not None:
        shown.append((Message("volterra.third_order", "and the third order"), sums[3]))
    return shown


def spacing_plot(model: VolterraModel, u: Array, si_unit: str) -> Plot:
    """Return power spectra of the input (n,), in ``si_unit``, at several sample rates (Chen 2010, Fig. 4.8).

    Raises:
        UnusableInputError: the input is too short or too full of gaps for a spectrum.
    """
    curves, halves = [], []
    steps = sorted({1, model.lag_spacing, max(2, 2 * model.lag_spacing)})
    for step, colour, kind in zip(steps, ROLES, KINDS, strict=False):
        rate = model.sample_rate_hz / step
        name = Message("plot.rate", "{rate} Hz", rate=fixed(rate, 0))
        if step == model.lag_spacing:
            name = Message("plot.rate_of_lags", "{rate} Hz (the lags)", rate=fixed(rate, 0))
        curve = density_curve(u[::step], rate, si_unit, name, colour, kind)
        if curve is not None:
            curves.append(curve)
            halves.append(Curve(np.array([0.5 * rate]), np.zeros(1), "", "muted", "position", width=0.7))
    if not curves:
        raise UnusableInputError(
            "report.no_spectrum", "the fitted part is too short, or has too many gaps, for a power spectrum"
        )
    top = max(float(curve.y.max()) for curve in curves)
    y = Axis(POWER_DENSITY, f"{display_unit(si_unit)[0]}²/Hz", log=True, limits=(10.0**-_DECADES * top, 3.0 * top))
    return Plot("", FREQUENCY, y, (*curves, *halves))


_WAYS = {1: marked("into the tissue"), -1: marked("out of the tissue"), 0: marked("as fitted")}
_PARTITIONED_S = 4.0
"""Seconds of the output that are drawn."""
_BAR = 0.92
"""Width of the bar of a partition, as a share of the partition."""


def partition_plots(model: PartitionedModel, record: Record, fit_part: slice) -> tuple[Plot, Plot]:
    """Return the output with the limits of the partitions, and the samples in each (Chen 2010, Fig. 5.4a)."""
    scale = display_unit(record.output_unit)[1]
    limits = scale * model.breakpoints_m
    roles = depth_roles(model.partitions.depths)
    first = fit_part.indices(len(record))[0]
    shown = slice(first, first + round(_PARTITIONED_S * record.sample_rate_hz))
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
    first, second = (
        Plot(title, lag, Axis(marked("Kernel"), unit, zero=True), tuple(_coloured(lag_ms, rows, std)))
        for title, rows, std in shown[:2]
    )
    return first, replace(second, depths=depth)


def _coloured(lag_ms: Array, rows: Array, std: Array) -> list[Curve]:
    """Return kernels (K, lags) as curves from shallow to deep; the first and the last have bands where known."""
    curves = [Curve(lag_ms, kernel, "", role) for kernel, role in zip(rows, depth_roles(len(rows)), strict=True)]
    for index in {0, len(curves) - 1}:
        half = CONFIDENCE * np.where(np.isfinite(std[index]), std[index], 0.0)
        if half.any():
            curves[index] = replace(curves[index], low=rows[index] - half, high=rows[index] + half)
    return curves


_STRETCH_S = 0.5
"""Seconds of the output that are drawn."""
_NOISE = 5.0
"""Ratio of the height of a kernel to the median height of all from which it is cut off."""
_DIAGONAL = marked("along the diagonal")


def first_kernels(overlay: Overlay) -> tuple[Plot, Plot]:
    """Return the first-order kernels and the diagonals of the second-order kernels, laid over each other.

    Chen 2010, Figs. 4.12 and 4.14.

    Raises:
        UnusableInputError: no fit has kernels.
    """
    first, diagonal = [], []
    entries = _volterra(overlay)
    record = entries[0][0].analysis.record
    (unit, scale), (unit2, scale2) = kernel_unit(record), kernel_unit(record, 2)
    for entry, model in entries:
        style = named(overlay.label(entry)), *style_of(overlay, entry)
        if model.kernel1 is not None:
            first.append(Curve(1e3 * model.lag_s, scale * model.kernel1, *style))
        if model.kernel2 is not None:
            diagonal.append(Curve(1e3 * model.lag_s, scale2 * np.diag(model.kernel2), *style))
    second = Axis(marked("Second-order kernel"), unit2, limits=_without_noise(diagonal), zero=True)
    missing = "" if diagonal else Message("overlay.no_second_kernel", "no fit has a second-order kernel")
    return (
        Plot("", LAG, Axis(marked("First-order kernel"), unit, zero=True), tuple(first)),
        Plot(_DIAGONAL, LAG, second, tuple(diagonal), missing=missing),
    )


def _without_noise(curves: list[Curve]) -> tuple[float, float] | None:
    """Return limits that cut off curves many times as high as the others: kernels by plain least squares can be noise.

    None where no curve is.
    """
    heights = np.array([float(np.abs(curve.y).max()) for curve in curves])
    if not heights.size or float(heights.max()) < _NOISE * float(np.median(heights)):
        return None
    shown = np.concatenate([c.y for c, top in zip(curves, heights, strict=True) if top < _NOISE * np.median(heights)])
    margin = 0.1 * float(np.ptp(shown))
    return float(shown.min()) - margin, float(shown.max()) + margin


def second_kernels(overlay: Overlay) -> list[Plot]:
    """Return the second-order kernel of every fit with its VAF (Chen 2010, Figs. 4.5, 4.8, 4.12 to 4.15).

    Kernels of the same fit share the scale of their colours, so that tests can be compared.

    Raises:
        UnusableInputError: no fit has a second-order kernel.
    """
    surfaces = [
        (entry, replace(cast(Surface, second_order_kernel(model, entry.analysis.record).surface), name=""))
        for entry, model in _volterra(overlay)
        if model.kernel2 is not None
    ]
    if not surfaces:
        raise UnusableInputError("overlay.no_second_kernel", "no fit has a second-order kernel")
    tops: dict[str, float] = {}
    for entry, surface in surfaces:
        tops[entry.fit.label] = max(tops.get(entry.fit.label, 0.0), float(np.abs(surface.values).max()))
    return [
        Plot(
            _with_vaf(overlay.label(entry), entry.analysis.model.report.vaf_percent),
            _FIRST_LAG,
            _SECOND_LAG,
            (replace(surface, limit=tops[entry.fit.label]),),
            square=True,
        )
        for entry, surface in surfaces
    ]


def partition_columns(overlay: Overlay) -> list[tuple[Plot, Plot, Plot]]:
    """Return output, measured against modelled output, and kernels by depth of every fit (Chen 2010, Figs. 5.6 to 5.8).

    The run is scheduled by the measured output, as in the thesis, over the fitted samples.

    Raises:
        UnusableInputError: no fit has kernels by depth.
    """
    made = []
    for entry in overlay.entries:
        analysis, model = entry.analysis, entry.analysis.model
        if not isinstance(model, PartitionedModel) or model.partitions.depths < 2:
            continue
        record, part = analysis.record, analysis.fit_part
        run = Prediction(
            label=marked("modelled"),
            time_s=record.time[part],
            input=record.input[part],
            measured=record.output[part],
            predicted=model.simulate_scheduled(record)[part],
            sample_rate_hz=record.sample_rate_hz,
            output_name=record.output_name,
            output_unit=record.output_unit,
            memory_samples=model.memory_samples,
        )
        output = prediction_plots([run], _STRETCH_S)[0]
        title = _with_vaf(overlay.label(entry), entry.shown_percent)
        cloud = cloud_plot(run.predicted, run.measured, run.output_unit, colour=style_of(overlay, entry)[0])
        image = kernels_by_depth(model, analysis.record)
        low, high = display_unit(run.output_unit)[1] * model.breakpoints_m[[0, -1]]
        depth = replace(image.y, limits=(float(low), float(high)))  # of its own, so that no other plot shares it
        image = replace(image, title="", y=depth)
        made.append((replace(output, title=title, y=replace(output.y, limits=depth.limits)), cloud, image))
    if not made:
        raise UnusableInputError("overlay.no_partitions", "no fit has kernels by depth")
    return made


def _with_vaf(label: str, percent: float) -> str:
    return Message("overlay.with_vaf", "{name}, VAF {percent:.1f} %", name=named(label), percent=percent)


def _volterra(overlay: Overlay) -> list[tuple[OverlayEntry, VolterraModel]]:
    """Return the entries with Volterra kernels, and their models.

    Raises:
        UnusableInputError: there is none.
    """
    entries = [
        (entry, entry.analysis.model) for entry in overlay.entries if isinstance(entry.analysis.model, VolterraModel)
    ]
    if not entries:
        raise UnusableInputError("overlay.no_volterra", "no fit has Volterra kernels")
    return entries


@dataclass(frozen=True)
class Lobes:
    """Shape of a second-order kernel about its largest value on the diagonal, at ``lag_s`` (Chen 2010, Fig. 4.5).

    ``width_s`` is the width at half height across the diagonal. ``side_lobe`` is the largest value of the opposite
    sign, which lies on either side of the diagonal, relative to the peak.
    """

    lag_s: float
    negative: bool
    width_s: float
    side_lobe: float


def kernel_lobes(kernel: Array, spacing_s: float) -> Lobes:
    """Return the lobes of a second-order kernel (lags, lags) at a lag spacing of ``spacing_s``."""
    from scipy.ndimage import map_coordinates  # takes long to import

    diagonal = np.diag(kernel)
    peak = int(np.argmax(np.abs(diagonal)))
    across = np.linspace(-peak, peak, 2001)
    line = map_coordinates(kernel / diagonal[peak], [peak + across, peak - across], order=3)
    low = across[line < 0.5]
    upper, lower = low[low > 0.0].min(initial=peak), low[low < 0.0].max(initial=-peak)
    return Lobes(
        lag_s=peak * spacing_s,
        negative=bool(diagonal[peak] < 0.0),
        width_s=float(upper - lower) * spacing_s,
        side_lobe=float((-kernel / diagonal[peak]).max(initial=0.0)),
    )
