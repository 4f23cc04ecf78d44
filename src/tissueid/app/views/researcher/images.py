"""Kernels as images: the second-order one of a Volterra series, and those that follow depth."""

from __future__ import annotations

import numpy as np

from tissueid.analysis import Analysis
from tissueid.app.language import _
from tissueid.app.views.researcher.drawn import Image
from tissueid.identification.partitions.model import PartitionedModel
from tissueid.identification.volterra.model import VolterraModel
from tissueid.wording import people_unit

_MS = 1e3
_DEPTHS = 60
"""Rows of an image over depth, whose partitions may be of different widths."""
_MOST = 400


def images_of(analysis: Analysis) -> tuple[Image, ...]:
    """The images that a model has, none for most."""
    model, record = analysis.model, analysis.record
    out, out_scale = people_unit(record.output_unit)
    into, in_scale = people_unit(record.input_unit)
    out, into = out or "1", into or "1"
    if isinstance(model, VolterraModel) and model.kernel2 is not None:
        step = -(-model.lag_s.size // _MOST)
        lags = _MS * model.lag_s[::step]
        values = out_scale / in_scale**2 * model.kernel2[::step, ::step]
        unit = f"{out}/({into}²·s²)"
        return (Image(_("Second-order kernel"), unit, lags, lags, values, _("First lag (ms)"), _("Second lag (ms)")),)
    if isinstance(model, PartitionedModel) and len(model.operating_kernels):
        edges = model.breakpoints_m
        depth = np.linspace(edges[0], edges[-1], _DEPTHS)
        rows = np.clip(np.searchsorted(edges, depth, "right") - 1, 0, len(model.operating_kernels) - 1)
        values = out_scale / in_scale * model.operating_kernels[rows].T  # (lags, depths)
        axis = f"{record.output_name.capitalize()} ({out})"
        unit = f"{out}/({into}·s)"
        return (
            Image(_("Kernels against depth"), unit, _MS * model.lag_s, out_scale * depth, values, _("Lag (ms)"), axis),
        )
    return ()
