"""Figure of the impulse response estimated by correlation."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from tissueid.analysis.curves.units import kernel_unit
from tissueid.formatting import number
from tissueid.identification.engines.lms import Lms, LmsModel
from tissueid.language import _, marked
from tissueid.records import Record
from tissueid.reports.captions import second_order
from tissueid.reports.figures.registry import Drawn, Subject, figure
from tissueid.reports.style import BLUE, DASHES, HALF_WIDTH, MUTED, ORANGE, drawing, new_figure


@figure(
    LmsModel,
    "impulse",
    marked("Impulse response"),
    marked("Impulse response against lag: points with a band of one deviation, and the second-order curve."),
    group="linear",
    wide=False,
    place=40,
    standard=Lms.name,
)
def _impulse_response(subject: Subject[LmsModel]) -> Drawn:
    return impulse_response_figure(subject.model, subject.record), _caption(subject.model)


@drawing
def impulse_response_figure(model: LmsModel, record: Record) -> Figure:
    """Draw the impulse response, its deviation at every lag, and the second-order fit (Chen 2010, Fig. 3.5)."""
    per_unit, scale = kernel_unit(record)
    figure = new_figure(HALF_WIDTH, 4.6)
    axes = figure.subplots()
    lag_ms = 1e3 * model.lag_s
    response, std = scale * model.impulse_response, scale * model.impulse_response_std
    axes.axhline(0.0, color=MUTED, linewidth=0.8)
    axes.fill_between(
        lag_ms, response - std, response + std, color=BLUE, alpha=0.22, linewidth=0.0, label=_("± 1 standard deviation")
    )
    axes.plot(lag_ms, response, color=BLUE, linestyle="none", marker=".", markersize=4.0, label=_("each lag by itself"))
    fit_s = np.linspace(0.0, float(model.lag_s[-1]), 400)
    fitted = scale * model.second_order.sign * model.second_order.system.impulse_response(fit_s)
    axes.plot(1e3 * fit_s, fitted, color=ORANGE, linestyle=DASHES[1], linewidth=1.6, label=_("second order"))
    axes.set_xlim(0.0, float(lag_ms[-1]) or 1.0)
    axes.set_xlabel(_("Lag (ms)"))
    axes.set_ylabel(_("Impulse response ({unit})").format(unit=per_unit))
    axes.legend(loc="upper right")
    return figure


def _caption(model: LmsModel) -> str:
    memory_ms = 1e3 * model.memory_samples / model.sample_rate_hz
    text = _(
        "The response rises, and should be over well before the end of the memory of {memory} ms; the "
        "points should scatter about the curve within the band. The last lags also carry what comes after the memory. "
        "A curve that dips below zero is that of a damping ratio below one."
    ).format(memory=number(memory_ms, 3))
    return f"{text} {second_order(model.second_order)}"
