"""Figure of the impulse response estimated by correlation."""

from __future__ import annotations

from tissueid.analysis.curves.linear import impulse_response
from tissueid.formatting import number
from tissueid.identification.engines.lms import Lms, LmsModel
from tissueid.language import _, marked
from tissueid.reports.captions import second_order
from tissueid.reports.figures.registry import Drawn, Subject, figure
from tissueid.reports.plot_renderer import column_figure


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
    return column_figure([impulse_response(subject.model, subject.record)], 4.6), _caption(subject.model)


def _caption(model: LmsModel) -> str:
    memory_ms = 1e3 * model.memory_samples / model.sample_rate_hz
    text = _(
        "The response rises, and should be over well before the end of the memory of {memory} ms; the "
        "points should scatter about the curve within the band. The last lags also carry what comes after the memory. "
        "A curve that dips below zero is that of a damping ratio below one."
    ).format(memory=number(memory_ms, 3))
    return f"{text} {second_order(model.second_order)}"
