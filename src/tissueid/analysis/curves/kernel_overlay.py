"""Plots of kernels of several fits side by side: Volterra kernels, and kernels by depth (Chen 2010, 4.3, 5.3)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tissueid.analysis.curves.diagnostics import Prediction
from tissueid.analysis.curves.kernels import kernels_by_depth, second_order_kernel
from tissueid.analysis.curves.overlay import named, style_of
from tissueid.analysis.curves.plot import Array, Axis, Curve, Plot, Surface
from tissueid.analysis.curves.units import LAG, kernel_unit
from tissueid.analysis.curves.validation import cloud_plot, prediction_plots
from tissueid.analysis.overlay import Overlay, OverlayEntry
from tissueid.errors import UnusableInputError
from tissueid.identification.partitions.model import PartitionedModel
from tissueid.identification.volterra.model import VolterraModel
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.units import display_unit

_NO_VOLTERRA = Message("overlay.no_volterra", "no fit has Volterra kernels")
_NO_PARTITIONS = Message("overlay.no_partitions", "no fit has kernels by depth")
_STRETCH_S = 0.5
"""Seconds of the output that are drawn."""
_NOISE = 5.0
"""Ratio of the height of a kernel to the median height of all from which it is cut off."""
_DIAGONAL = marked("along the diagonal")


def first_kernels(found: Overlay) -> tuple[Plot, Plot]:
    """Return the first-order kernels and the diagonals of the second-order kernels, laid over each other.

    Chen 2010, Figs. 4.12 and 4.14.

    Raises:
        UnusableInputError: no fit has kernels.
    """
    first, diagonal = [], []
    entries = _volterra(found)
    record = entries[0].analysis.record
    (unit, scale), (unit2, scale2) = kernel_unit(record), kernel_unit(record, 2)
    for entry in entries:
        model = entry.analysis.model
        assert isinstance(model, VolterraModel)
        style = named(found.label(entry)), *style_of(found, entry)
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


def second_kernels(found: Overlay) -> list[Plot]:
    """Return the second-order kernel of every fit with its VAF (Chen 2010, Figs. 4.5, 4.8, 4.12 to 4.15).

    Kernels of the same fit share the scale of their colours, so that tests can be compared.

    Raises:
        UnusableInputError: no fit has a second-order kernel.
    """
    entries = [entry for entry in _volterra(found) if getattr(entry.analysis.model, "kernel2", None) is not None]
    surfaces: list[tuple[OverlayEntry, Surface]] = []
    for entry in entries:
        model = entry.analysis.model
        assert isinstance(model, VolterraModel)
        surface = second_order_kernel(model, entry.analysis.record).surface
        assert surface is not None
        surfaces.append((entry, replace(surface, name="")))
    if not surfaces:
        raise UnusableInputError("overlay.no_second_kernel", "no fit has a second-order kernel")
    tops: dict[str, float] = {}
    for entry, surface in surfaces:
        tops[entry.fit.label] = max(tops.get(entry.fit.label, 0.0), float(np.abs(surface.values).max()))
    first, second = Axis(marked("First lag"), "ms"), Axis(marked("Second lag"), "ms")
    return [
        Plot(
            _with_vaf(found.label(entry), entry.analysis.model.report.vaf_percent),
            first,
            second,
            (replace(surface, limit=tops[entry.fit.label]),),
            square=True,
        )
        for entry, surface in surfaces
    ]


def partition_columns(found: Overlay) -> list[tuple[Plot, Plot, Plot]]:
    """Return output, measured against modelled output, and kernels by depth of every fit (Chen 2010, Figs. 5.6 to 5.8).

    The run is scheduled by the measured output, as in the thesis, over the fitted samples.

    Raises:
        UnusableInputError: no fit has kernels by depth.
    """
    made = []
    for entry in found.entries:
        analysis, model = entry.analysis, entry.analysis.model
        if not isinstance(model, PartitionedModel) or model.partitions.depths < 2:
            continue
        run = _scheduled_run(entry)
        output = prediction_plots([run], _STRETCH_S)[0]
        title = _with_vaf(found.label(entry), entry.shown_percent)
        cloud = cloud_plot(run.predicted, run.measured, run.output_unit, colour=style_of(found, entry)[0])
        image = kernels_by_depth(model, analysis.record)
        low, high = display_unit(run.output_unit)[1] * model.breakpoints_m[[0, -1]]
        depth = replace(image.y, limits=(float(low), float(high)))  # of its own, so that no other plot shares it
        image = replace(image, title="", y=depth)
        made.append((replace(output, title=title, y=replace(output.y, limits=depth.limits)), cloud, image))
    if not made:
        raise UnusableInputError(_NO_PARTITIONS)
    return made


def _scheduled_run(entry: OverlayEntry) -> Prediction:
    analysis = entry.analysis
    model, record, part = analysis.model, analysis.record, analysis.fit_part
    modelled = model.simulate_scheduled(record)
    run: Array = model.simulate(record.input) if modelled is None else modelled
    return Prediction(
        label=marked("modelled"),
        time_s=record.time[part],
        input=record.input[part],
        measured=record.output[part],
        predicted=run[part],
        sample_rate_hz=record.sample_rate_hz,
        output_name=record.output_name,
        output_unit=record.output_unit,
        memory_samples=model.memory_samples,
    )


def _with_vaf(label: str, percent: float) -> str:
    return Message("overlay.with_vaf", "{name}, VAF {percent:.1f} %", name=named(label), percent=percent)


def _volterra(found: Overlay) -> list[OverlayEntry]:
    """Return the entries with Volterra kernels.

    Raises:
        UnusableInputError: there is none.
    """
    entries = [entry for entry in found.entries if isinstance(entry.analysis.model, VolterraModel)]
    if not entries:
        raise UnusableInputError(_NO_VOLTERRA)
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
    right, left = low[low > 0.0].min(initial=peak), low[low < 0.0].max(initial=-peak)
    return Lobes(
        lag_s=peak * spacing_s,
        negative=bool(diagonal[peak] < 0.0),
        width_s=float(right - left) * spacing_s,
        side_lobe=float((-kernel / diagonal[peak]).max(initial=0.0)),
    )


__all__ = ["Lobes", "first_kernels", "kernel_lobes", "partition_columns", "second_kernels"]
