"""Plots of Volterra models: contributions of the orders, slices of kernels, input at the spacing of the lags."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tissueid.analysis.curves.kernels import second_order_kernel
from tissueid.analysis.curves.plot import Array, Axis, Curve, Plot, Surface
from tissueid.analysis.curves.signals import POWER_DENSITY, density_curve
from tissueid.analysis.curves.units import FREQUENCY, LAG, kernel_unit, signal_axis
from tissueid.analysis.curves.validation import KINDS, ROLES, cloud_plot
from tissueid.errors import UnusableInputError
from tissueid.formatting import fixed
from tissueid.identification.volterra.model import VolterraModel
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Record
from tissueid.units import display_unit

NO_KERNELS = Message("report.no_kernels", "a model of order zero has no kernels")
_SLICES_AT = np.array([0.1, 0.35, 0.6, 0.85])
"""Shares of the third-order kernel's cumulated magnitude at whose lags slices are drawn."""
_DECADES = 7.0
"""Decades below the largest density of the input that are shown."""


def third_order_slices(model: VolterraModel, record: Record) -> list[Plot]:
    """Return slices of the third-order kernel over two lags at a few values of its third lag, on one scale.

    Raises:
        UnusableInputError: the kernel has fewer than three lags.
    """
    kernel = model.kernel3
    assert kernel is not None
    unit, scale = kernel_unit(record, 3)
    lag_ms = 1e3 * model.lag_s
    if lag_ms.size < 3:
        raise UnusableInputError("report.few_lags_third", "the third-order kernel has fewer than three lags")
    strength = np.cumsum(np.abs(kernel).sum(axis=(0, 1)))
    shown = np.unique(np.searchsorted(strength, _SLICES_AT * strength[-1]))
    top = scale * float(np.abs(kernel[:, :, shown]).max())
    first, second = Axis(marked("First lag"), "ms"), Axis(marked("Second lag"), "ms")
    return [
        Plot(
            Message("plot.third_lag", "third lag {lag} ms", lag=fixed(float(lag_ms[lag]), 1)),
            first,
            second,
            (Surface(lag_ms, lag_ms, scale * kernel[:, :, lag], unit=unit if lag == shown[-1] else "", limit=top),),
            square=True,
        )
        for lag in shown
    ]


def kernel_and_spectrum(label: str, model: VolterraModel, record: Record) -> tuple[Plot, Plot]:
    """Return the second-order kernel and the magnitude of its two-dimensional Fourier transform.

    Raises:
        UnusableInputError: the model has no second-order kernel, or fewer than three lags.
    """
    surface = second_order_kernel(model, record).surface
    assert surface is not None
    magnitude = np.abs(np.fft.fftshift(np.fft.fft2(surface.values)))
    spacing_s = model.lag_spacing / model.sample_rate_hz
    frequency_hz = np.asarray(np.fft.fftshift(np.fft.fftfreq(model.lag_s.size, spacing_s)), np.float64)
    frequency = replace(FREQUENCY, log=False)
    spectrum = Surface(
        frequency_hz, frequency_hz, magnitude / magnitude.max(), marked("relative to maximum"), signed=False
    )
    return (
        Plot(label, LAG, LAG, (replace(surface, name=""),), square=True),
        Plot("", frequency, frequency, (spectrum,), square=True),
    )


def impulse_contribution_plot(model: VolterraModel, record: Record, height: float) -> Plot:
    """Return the contribution of each order to the response to an impulse (Chen 2010, Eq. 4.15 and Fig. 4.3).

    Raises:
        UnusableInputError: the model has no kernels.
    """
    if model.kernel1 is None:
        raise UnusableInputError(NO_KERNELS)
    response, scale = model.impulse_response(height), display_unit(record.output_unit)[1]
    orders = [
        (marked("first order"), response.first),
        (marked("second order"), response.second),
        (marked("third order"), response.third),
    ][: model.order]
    lag_ms = 1e3 * model.lag_s
    parts = [Curve(lag_ms, scale * (response.total - response.zeroth), marked("total"), "text")]
    parts += [
        Curve(lag_ms, scale * values, label, colour, kind)
        for (label, values), colour, kind in zip(orders, ROLES, KINDS, strict=False)
    ]
    y = replace(signal_axis(f"change_of_{record.output_name}", record.output_unit), zero=True)
    return Plot("", LAG, y, tuple(parts))


def contribution_plots(model: VolterraModel, record: Record, part: slice) -> list[Plot]:
    """Return measured against modelled output of a part as orders are added (Chen 2010, Figs. 4.3 and 4.10).

    Raises:
        UnusableInputError: the model has no kernels, or no output was received.
    """
    if model.kernel1 is None:
        raise UnusableInputError(NO_KERNELS)
    measured = record.output[part]
    known = measured[np.isfinite(measured)]
    if not known.size:
        raise UnusableInputError("report.no_output", "no output was received in the fitted part")
    ends = float(known.min()), float(known.max())
    return [
        cloud_plot(modelled[part], measured, record.output_unit, label, ROLES[place % len(ROLES)], ends=ends)
        for place, (label, modelled) in enumerate(_cumulated(model, record.input))
    ]


def _cumulated(model: VolterraModel, u: Array) -> list[tuple[str, Array]]:
    """Return labels and outputs (n,) as contributions are added one after the other."""
    sums = np.cumsum(model.contributions(u), axis=0)
    shown = [(marked("first order"), sums[1])]
    if model.kernel2 is not None:
        diagonal_only = replace(model, kernel2=np.diag(np.diag(model.kernel2)), kernel3=None, order=2)
        shown.append((marked("and diagonal of the second"), np.sum(diagonal_only.contributions(u), axis=0)))
        shown.append((marked("and all of the second"), sums[2]))
    if model.kernel3 is not None:
        shown.append((Message("volterra.third_order", "and the third order"), sums[3]))
    return shown


def spacing_plot(model: VolterraModel, u: Array, si_unit: str) -> Plot:
    """Return power spectra of the input (n,), in ``si_unit``, at several sample rates (Chen 2010, Fig. 4.8).

    Raises:
        UnusableInputError: the input is too short or too full of gaps for a spectrum.
    """
    curves, halves = [], []
    steps = sorted({1, model.lag_spacing, max(2, 2 * model.lag_spacing)})
    for step, colour, kind in zip(steps, ROLES, KINDS, strict=False):
        rate = model.sample_rate_hz / step
        name = Message("plot.rate", "{rate} Hz", rate=fixed(rate, 0))
        if step == model.lag_spacing:
            name = Message("plot.rate_of_lags", "{rate} Hz (the lags)", rate=fixed(rate, 0))
        curve = density_curve(u[::step], rate, si_unit, name, colour, kind)
        if curve is not None:
            curves.append(curve)
            halves.append(Curve(np.array([0.5 * rate]), np.zeros(1), "", "muted", "position", width=0.7))
    if not curves:
        raise UnusableInputError(
            "report.no_spectrum", "the fitted part is too short, or has too many gaps, for a power spectrum"
        )
    top = max(float(curve.y.max()) for curve in curves)
    y = Axis(POWER_DENSITY, f"{display_unit(si_unit)[0]}²/Hz", log=True, limits=(10.0**-_DECADES * top, 3.0 * top))
    return Plot("", FREQUENCY, y, (*curves, *halves))


__all__ = [
    "NO_KERNELS",
    "contribution_plots",
    "impulse_contribution_plot",
    "kernel_and_spectrum",
    "spacing_plot",
    "third_order_slices",
]
