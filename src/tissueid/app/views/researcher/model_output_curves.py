"""Curves of the measured and simulated output on held-out data."""

from __future__ import annotations

import numpy as np

from tissueid.analysis import Analysis
from tissueid.app.views.researcher.plot_data import Array, Line
from tissueid.errors import UnusableInputError
from tissueid.messages import Message
from tissueid.units import display_unit

_COLUMNS = 3000
"""Columns of a thinned curve: more than any screen is wide. Shorter records are kept sample by sample."""


def model_output(analysis: Analysis) -> tuple[Line, Line, Line]:
    """Return measured output, simulated output and residual against time (s), in display units.

    The simulation is the free run. ``out_x`` and ``out_y`` of the simulated output and of the residual are those of
    the simulation scheduled by the measured output, for engines that have one.

    Raises:
        UnusableInputError: no held-out sample was both received and simulated.
    """
    from tissueid.analysis.curves.plot import thin
    from tissueid.reports.diagnostics import held_out_prediction  # which imports matplotlib

    found = held_out_prediction("", analysis)
    record, scale = analysis.held_out_record, display_unit(found.output_unit)[1]
    scheduled = analysis.model.simulate_scheduled(record)
    if not np.isfinite(found.residual).any():
        raise UnusableInputError(Message("research.no_held_out", "no held-out sample was both received and simulated"))
    time_s, measured = found.time_s, scale * found.measured

    def line(values: Array, other: Array | None) -> Line:
        x, y = thin(time_s, values, _COLUMNS)
        return Line(x, y) if other is None else Line(x, y, None, None, *thin(time_s, other, _COLUMNS))

    by_schedule = None if scheduled is None else scale * scheduled[analysis.held_out]
    left = None if by_schedule is None else measured - by_schedule
    return line(measured, None), line(scale * found.predicted, by_schedule), line(scale * found.residual, left)


__all__ = ["model_output"]
