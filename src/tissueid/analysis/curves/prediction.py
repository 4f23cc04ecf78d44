"""Plots of measured and simulated output, and of the residual."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tissueid.analysis import Analysis
from tissueid.analysis.curves.diagnostics import held_out_prediction, readable_stretch
from tissueid.analysis.curves.plot import Array, Axis, Curve, Plot, thin
from tissueid.analysis.curves.units import signal_axis
from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.units import display_unit

_COLUMNS = 3000
"""Columns of a thinned curve: more than any screen is wide. Shorter records are kept sample by sample."""
_UNSEEN_S = 0.4
"""Length of the held-out motion that is shown, s: enough periods to judge by eye, few enough to distinguish."""


def output_plots(analysis: Analysis) -> tuple[Plot, Plot]:
    """Return measured and simulated output, and the residual, against time on held-out data.

    The simulation is the free run. A faint curve is that of the simulation scheduled by the measured output, for
    engines that have one.

    Raises:
        UnusableInputError: no held-out sample was both received and simulated.
    """
    found = held_out_prediction("", analysis)
    record, (unit, scale) = analysis.held_out_record, display_unit(found.output_unit)
    scheduled = analysis.model.simulate_scheduled(record)
    if not np.isfinite(found.residual).any():
        raise UnusableInputError("research.no_held_out", "no held-out sample was both received and simulated")
    measured = Curve(*_thin(found.time_s, scale * found.measured), marked("broad and pale: measured"), "measured")
    outputs, residuals = [found.predicted], [found.residual]
    if scheduled is not None:
        outputs.append(scheduled[analysis.held_out])
        residuals.append(found.measured - scheduled[analysis.held_out])
    time = Axis(marked("Time from the start of the record"), "s")
    upper, lower = (
        [
            Curve(
                *_thin(found.time_s, scale * values),
                marked("faint: scheduled by the measured output") if place else "",
                "model",
                opacity=0.5 if place else 1.0,
                width=0.8,
            )
            for place, values in enumerate(every)
        ]
        for every in (outputs, residuals)
    )
    difference = marked("Measured less simulated")
    return (
        Plot(
            marked("Measured and simulated output, held out"),
            time,
            signal_axis(found.output_name, found.output_unit),
            (measured, *upper),
        ),
        Plot(difference, time, Axis(difference, unit), tuple(lower)),
    )


def unseen_motion(analyses: Mapping[str, Analysis], engines: tuple[str, ...]) -> Plot:
    """Return a short stretch of held-out output, measured and as simulated by the first of some engines that was run.

    Raises:
        UnusableInputError: none of them was run.
    """
    name = next((name for name in engines if name in analyses), None)
    if name is None:
        raise UnusableInputError("report.no_free_run", "no model could be run on motion that it had not seen")
    found = held_out_prediction(name, analyses[name])
    part = readable_stretch(found, _UNSEEN_S)
    time_s, scale = found.time_s[part] - found.time_s[part][0], display_unit(found.output_unit)[1]
    return Plot(
        marked("Unseen motion"),
        Axis(marked("Time"), "s"),
        signal_axis(found.output_name, found.output_unit),
        (
            Curve(time_s, scale * found.measured[part], marked("measured"), "measured", opacity=0.5, width=2.0),
            Curve(time_s, scale * found.predicted[part], marked("predicted"), "model", width=0.8),
        ),
    )


def _thin(time_s: Array, values: Array) -> tuple[Array, Array]:
    return thin(time_s, values, _COLUMNS)
