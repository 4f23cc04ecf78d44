"""Figures of the dynamic-parameter nonlinearity: parameter curves with bands, and the static force."""

from __future__ import annotations

import numpy as np

from tissueid.analysis.curves.depth import dpn_plots, static_force_plot
from tissueid.analysis.curves.plot import Array, is_mechanical
from tissueid.errors import UnusableInputError
from tissueid.formatting import fixed
from tissueid.identification.engines.dpn import DpnModel
from tissueid.language import _, marked
from tissueid.reports.depth_panels import draw_over_samples
from tissueid.reports.figures.registry import Drawn, Subject, figure
from tissueid.reports.plot_renderer import column_figure
from tissueid.reports.style import FULL_WIDTH, new_figure

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
    *plots, samples = dpn_plots(model, position, subject.surface_position_m)
    drawn = new_figure(FULL_WIDTH, 4.3)
    draw_over_samples(drawn, plots, samples, key=True)
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
    record = subject.record[subject.analysis.fit_part]
    plot = static_force_plot(subject.model, record, _visited(subject)[0], subject.surface_position_m)
    return column_figure([plot], 3.9), _(
        "The force that holds the probe at each depth, with its 95 % band, and the samples: their loops about the "
        "curve are inertia and damping. A curve that bends upwards means that the tissue stiffens."
    )


def _visited(subject: Subject[DpnModel]) -> tuple[Array, float]:
    """Return positions (k,), m, over the central part of the visited range, and the origin of depth, m.

    Raises:
        UnusableInputError: the input is not a force, or the output is not a position.
    """
    if not is_mechanical(subject.record):
        raise UnusableInputError(
            "report.not_mechanical",
            "mass, damping and stiffness need a force as the input and a position as the output",
        )
    low, high = subject.model.known.central()
    origin = subject.surface_position_m if np.isfinite(subject.surface_position_m) else 0.0
    return np.linspace(low, high, _STEPS), origin
