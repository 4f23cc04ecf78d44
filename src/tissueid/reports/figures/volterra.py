"""Figures of Volterra kernels: the kernels, and the contribution of each order (Chen 2010, 4.2 and 4.3)."""

from __future__ import annotations

from typing import cast

import numpy as np

from tissueid.analysis.curves.kernels import (
    NO_KERNELS,
    contribution_plots,
    impulse_contribution_plot,
    second_order_kernel,
    third_order_slices,
)
from tissueid.analysis.curves.linear import first_kernel_plot
from tissueid.analysis.curves.plot import CONFIDENCE, Surface
from tissueid.errors import UnusableInputError
from tissueid.formatting import fixed, number, with_unit
from tissueid.identification.volterra.model import VolterraModel
from tissueid.language import _, marked
from tissueid.reports import captions
from tissueid.reports.figures.registry import Drawn, Subject, figure
from tissueid.reports.plot_renderer import column_figure, draw_kernel, row_figure
from tissueid.reports.style import FULL_WIDTH, new_figure
from tissueid.units import display_unit

_HEIGHT = 2.0
"""Height of the impulse of Eq. 4.15 in standard deviations of the input."""


@figure(
    VolterraModel,
    "first-kernel",
    marked("First-order kernel"),
    marked("First-order kernel against lag with its 95 % band, and the second-order linear system as a dashed curve."),
    group="linear",
    wide=False,
    place=60,
)
def first_kernel(subject: Subject[VolterraModel]) -> Drawn:
    """Draw h1 with its band (Chen 2010, Figs. 4.6a and 4.12)."""
    model = subject.model
    if model.kernel1 is None:
        raise UnusableInputError(NO_KERNELS)
    return column_figure([first_kernel_plot(model, subject.record)], 3.9), _(
        "Close to an impulse response, at {lags} lags. It differs from the best linear system (dashed) by what the "
        "higher orders describe. It should decay before the last lag, and the band should be narrow there."
    ).format(lags=model.lag_s.size)


@figure(
    VolterraModel,
    "second-kernel",
    marked("Second-order kernel"),
    marked("Symmetric image of the second-order kernel over two lags, and the same kernel as a surface."),
    group="nonlinear",
    place=60,
)
def second_kernel(subject: Subject[VolterraModel]) -> Drawn:
    """Draw h2 as an image and as a surface (Chen 2010, Figs. 4.3, 4.6b and 4.9)."""
    model = subject.model
    plot = second_order_kernel(model, subject.record)
    drawn = new_figure(FULL_WIDTH, 4.1)
    draw_kernel(drawn, plot).set_box_aspect(1.0)
    kernel = cast(Surface, plot.surface).values
    text = _(
        "Joint effect of two past inputs. Blue is negative: together they move the tissue less than the sum of both "
        "alone, as where it stiffens with depth. A rounded peak swept in both directions indicates a Wiener system, a "
        "ridge along the diagonal alone a Hammerstein system, a narrow peak with side lobes parameters that change "
        "with depth independently."
    )
    largest = _("The largest value here is positive.")
    if float(kernel.flat[np.argmax(np.abs(kernel))]) < 0.0:
        largest = _("The largest value here is negative.")
    outside = ""
    if model.kernel2_std is not None:
        share = float(np.mean(np.abs(np.asarray(model.kernel2)) > CONFIDENCE * model.kernel2_std))
        outside = _("{percent} % of the kernel lies outside its own 95 % band about zero.").format(
            percent=fixed(100.0 * share, 0)
        )
    return drawn, captions.joined(text, largest, outside)


@figure(
    VolterraModel,
    "third-kernel",
    marked("Third-order kernel"),
    marked("Slices of the third-order kernel over two lags, each at another third lag."),
    group="nonlinear",
    place=64,
    applies=lambda subject: subject.model.kernel3 is not None,
)
def third_kernel(subject: Subject[VolterraModel]) -> Drawn:
    """Draw slices of the third-order kernel at a few values of its third lag."""
    drawn = row_figure(third_order_slices(subject.model, subject.record), 2.7)
    return drawn, _(
        "Joint effect of three past inputs, one slice for each of a few third lags, on one scale. Blue is negative. "
        "The kernel is symmetric in all three lags."
    )


@figure(
    VolterraModel,
    "impulse-contributions",
    marked("Impulse response by contributions"),
    marked("Curves against lag: first-order, second-order and total response to an impulse."),
    group="nonlinear",
    wide=False,
    place=66,
)
def impulse_contributions(subject: Subject[VolterraModel]) -> Drawn:
    """Draw the contribution of each order to the response to an impulse (Chen 2010, Eq. 4.15 and Fig. 4.3)."""
    model = subject.model
    height = _HEIGHT * float(np.nanstd(subject.fitted_input))
    drawn = column_figure([impulse_contribution_plot(model, subject.record, height)], 3.9)
    lasts = fixed(1e3 * model.lag_spacing / model.sample_rate_hz, 1)
    in_unit, in_scale = display_unit(subject.record.input_unit)
    return drawn, _(
        "Response to an input {height} above the operating point ({deviations} standard deviations) for {lasts} ms: "
        "the first order, and the diagonals of the higher orders. Where tissue stiffens, the second order reduces the "
        "response."
    ).format(height=with_unit(number(in_scale * height, 3), in_unit), deviations=number(_HEIGHT), lasts=lasts)


@figure(
    VolterraModel,
    "contributions",
    marked("Residual nonlinearity by contribution"),
    marked("Clouds of measured against modelled output: first order alone, with the diagonal of the second, and all."),
    group="nonlinear",
    place=68,
)
def contributions(subject: Subject[VolterraModel]) -> Drawn:
    """Draw the residual nonlinearity as orders are added (Chen 2010, Figs. 4.3 and 4.10)."""
    plots = contribution_plots(subject.model, subject.record, subject.analysis.fit_part)
    drawn = row_figure(plots, 3.7 if len(plots) < 4 else 3.1)
    return drawn, _(
        "A bend about the diagonal is a nonlinearity that is not described; each panel adds kernels to the previous "
        "one. The line is the mean of the cloud. Samples of the fitted part."
    )
