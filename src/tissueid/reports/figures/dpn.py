"""Figures of the dynamic-parameter nonlinearity: parameter curves with bands, and the static force."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from tissueid.analysis.curves.diagnostics import Array
from tissueid.analysis.curves.units import is_mechanical
from tissueid.errors import UnusableInputError
from tissueid.formatting import axis_label, fixed
from tissueid.identification.dpn.confidence_bands import CurveBand
from tissueid.identification.engines.dpn import DpnModel
from tissueid.language import _, marked
from tissueid.messages import Message
from tissueid.reports.figures.registry import Drawn, Subject, figure
from tissueid.reports.panels import cloud
from tissueid.reports.style import DASHES, FULL_WIDTH, HALF_WIDTH, MUTED, ORANGE, POINTS, SERIES, new_figure

_STEPS = 160


@figure(
    DpnModel,
    "depth-profile",
    marked("Mass, damping and stiffness against depth"),
    marked("Curves of mass, damping and stiffness against depth with 95 % bands, and the distribution of depths."),
    group="nonlinear",
    place=30,
)
def curves(subject: Subject[DpnModel]) -> Drawn:
    """Draw M(y), B(y) and K(y) with their bands over the visited depths."""
    model = subject.model
    position, origin = _visited(subject)
    known = model.known
    ways = (1, -1) if known.curves.direction.size else (0,)
    names = {1: _("into the tissue"), -1: _("out of the tissue"), 0: _("damping")}
    drawn = new_figure(FULL_WIDTH, 4.3)
    every = drawn.subplots(2, 3, sharex=True, height_ratios=(3.2, 1.0))
    depth_mm = 1e3 * (position - origin)
    _curve(every[0, 0], depth_mm, known.mass(position), 1e3, SERIES[0], DASHES[0], _("mass"))
    for way, colour, dash in zip(ways, SERIES, DASHES, strict=False):
        _curve(every[0, 1], depth_mm, known.damping(position, way), 1.0, colour, dash, names[way])
    _curve(every[0, 2], depth_mm, known.stiffness(position), 1.0, SERIES[0], DASHES[0], _("tangent, dF/dy"))
    surface = model.surface_position_m
    if surface is not None:
        secant = known.secant(position, surface)
        _curve(every[0, 2], depth_mm, secant, 1.0, SERIES[1], DASHES[1], _("secant, F over depth"))
    for axes, label in zip(every[0], (_("Mass (g)"), _("Damping (N·s/m)"), _("Stiffness (N/m)")), strict=True):
        axes.set_ylabel(label)
        axes.set_ylim(bottom=0.0)
        if len(axes.get_legend_handles_labels()[1]) > 1:
            axes.legend(loc="best")
    for axes in every[1]:
        axes.hist(1e3 * (known.position - origin), bins=60, color=MUTED, alpha=0.5, histtype="stepfilled")
        axes.set_xlabel(_("Depth (mm)") if origin else _("Position (mm)"))
        axes.locator_params(axis="y", nbins=3)
    every[1, 0].set_ylabel(_("Samples"))
    drawn.align_ylabels()
    middle = np.array([float(np.median(known.position))])
    at, stiffness = fixed(1e3 * (float(middle[0]) - origin), 2), known.stiffness(middle)
    return drawn, _(
        "Curves with pointwise 95 % bands; below, the number of samples at each depth: where there are few, the bands "
        "widen. At the median of {at} mm the tangent stiffness is {stiffness} N/m. Damping that differs between the "
        "way in and the way out is drawn as two curves."
    ).format(at=at, stiffness=fixed(float(stiffness.value[0]), 0))


@figure(
    DpnModel,
    "static-force",
    marked("Static force against depth"),
    marked("Force of the tissue at rest against depth, with its 95 % band, over the measured force and position."),
    group="nonlinear",
    wide=False,
    place=32,
)
def static_force(subject: Subject[DpnModel]) -> Drawn:
    """Draw F(y), the integral of the tangent stiffness, over the samples."""
    model, record = subject.model, subject.record
    position, origin = _visited(subject)
    drawn = new_figure(HALF_WIDTH, 3.9)
    axes = drawn.subplots()
    cloud(axes, 1e3 * (subject.fitted_output - origin), subject.fitted_input, POINTS[0])
    band = model.known.force(position)
    depth_mm = 1e3 * (position - origin)
    half = np.where(np.isfinite(band.low + band.high), band.high - band.value, 0.0)
    axes.fill_between(depth_mm, band.value - half, band.value + half, color=ORANGE, alpha=0.25, linewidth=0.0)
    axes.plot(depth_mm, band.value, color=ORANGE, linewidth=2.0, label=_("at rest, F(y)"))
    axes.set_xlabel(_("Depth (mm)") if origin else _("Position (mm)"))
    axes.set_ylabel(axis_label(record.input_name, record.input_unit))
    axes.legend(loc="upper left")
    return drawn, _(
        "The force that holds the probe at each depth, with its 95 % band, and the samples: their loops about the "
        "curve are inertia and damping. A curve that bends upwards means that the tissue stiffens."
    )


def _curve(axes: Axes, depth_mm: Array, band: CurveBand, scale: float, colour: str, dash: object, label: str) -> None:
    known = np.isfinite(band.low + band.high)
    low, high = np.where(known, band.low, band.value), np.where(known, band.high, band.value)
    axes.fill_between(depth_mm, scale * low, scale * high, color=colour, alpha=0.2, linewidth=0.0)
    axes.plot(depth_mm, scale * band.value, color=colour, linestyle=dash, linewidth=1.6, label=label)


def _visited(subject: Subject[DpnModel]) -> tuple[Array, float]:
    """Return positions (k,), m, over the central part of the visited range, and the origin of depth, m.

    Raises:
        UnusableInputError: the input is not a force, or the output is not a position.
    """
    if not is_mechanical(subject.record):
        raise UnusableInputError(
            Message(
                "report.not_mechanical",
                "mass, damping and stiffness need a force as the input and a position as the output",
            )
        )
    low, high = subject.model.known.central()
    origin = subject.surface_position_m if np.isfinite(subject.surface_position_m) else 0.0
    return np.linspace(low, high, _STEPS), origin
