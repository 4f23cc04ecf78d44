"""Images of kernels: second-order Volterra kernels, and kernels against depth with their spectra."""

from __future__ import annotations

import numpy as np

from tissueid.analysis import Analysis
from tissueid.app.views.researcher.labels_of_tests import signal_title
from tissueid.app.views.researcher.plot_data import Array, Image
from tissueid.formatting import display_unit
from tissueid.identification.partitions.model import PartitionedModel
from tissueid.identification.volterra.model import VolterraModel
from tissueid.language import _

_MS = 1e3
_DEPTHS = 60
"""Rows of an image over depth, whose partitions may be of different widths."""
_MOST = 400
_FINER = 4
"""Zero-padding factor of the spectrum of a kernel."""
_LEFT = 0.02
"""Frequencies with less than this share of the maximum magnitude are not shown."""


def images_of(analysis: Analysis) -> tuple[Image, ...]:
    """Return the images of a model; none for most engines."""
    model, record = analysis.model, analysis.record
    out, out_scale = display_unit(record.output_unit)
    into, in_scale = display_unit(record.input_unit)
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
        axis = f"{signal_title(record.output_name)} ({out})"
        unit = f"{out}/({into}·s)"
        lags = _MS * model.lag_s
        kernels = Image(_("Kernels against depth"), unit, lags, out_scale * depth, values, _("Lag (ms)"), axis)
        return kernels, *_magnitude_of(kernels, model.lag_s, f"{out}/{into}")
    return ()


def _magnitude_of(kernels: Image, lag_s: Array, unit: str) -> tuple[Image, ...]:
    """Return the magnitude of the frequency response at each depth, up to the last significant frequency."""
    if lag_s.size < 2:
        return ()
    count, spacing_s = _FINER * lag_s.size, float(lag_s[1] - lag_s[0])  # lags may be several samples apart
    magnitude = spacing_s * np.abs(np.fft.rfft(kernels.values, count, axis=0))
    frequency_hz = np.asarray(np.fft.rfftfreq(count, spacing_s), np.float64)
    left = magnitude.max(axis=1)
    last = int(np.flatnonzero(left > _LEFT * left.max())[-1]) + 1
    step = -(-last // _MOST)
    shown = slice(0, max(last, _FINER), step)
    title = _("Bode magnitude against depth")
    return (Image(title, unit, frequency_hz[shown], kernels.y, magnitude[shown], _("Frequency (Hz)"), kernels.y_label),)
