"""Figures of Volterra kernels: the kernels themselves, and what each order adds (Chen 2010, 4.2 and 4.3)."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np

from tissueid.errors import UnusableInputError
from tissueid.identification.volterra.model import VolterraModel
from tissueid.reports.diagnostics import CONFIDENCE, Array
from tissueid.reports.figures.registry import Drawn, Subject, figure
from tissueid.reports.panels import diagonal, image, residual_cloud, surface
from tissueid.reports.style import (
    BLUE,
    DASHES,
    FULL_WIDTH,
    HALF_WIDTH,
    INK,
    MUTED,
    ORANGE,
    POINTS,
    SERIES,
    new_figure,
)
from tissueid.reports.units import kernel_unit
from tissueid.wording import axis_label, fixed, number, people_unit

_HEIGHT = 2.0
"""Standard deviations of the input that the impulse of Eq. 4.15 is high."""
_MOST_SLICES = 4


@figure(
    VolterraModel,
    "first-kernel",
    "First-order kernel",
    "First-order kernel against lag with its 95 % band, and the second-order linear system as a dashed curve.",
    group="linear",
    wide=False,
    place=60,
)
def first_kernel(subject: Subject[VolterraModel]) -> Drawn:
    """h1 with its band (Chen 2010, Figs. 4.6a and 4.12)."""
    model = subject.model
    if model.kernel1 is None:
        raise UnusableInputError("a model of order zero has no kernels")
    unit, scale = kernel_unit(subject.record)
    drawn = new_figure(HALF_WIDTH, 3.9)
    axes = drawn.subplots()
    lag_ms, kernel = 1e3 * model.lag_s, scale * model.kernel1
    axes.axhline(0.0, color=MUTED, linewidth=0.8)
    if model.kernel1_std is not None:
        half = CONFIDENCE * scale * model.kernel1_std
        axes.fill_between(
            lag_ms, kernel - half, kernel + half, color=BLUE, alpha=0.22, linewidth=0.0, label="95 % band"
        )
    axes.plot(lag_ms, kernel, color=BLUE, marker=".", markersize=4.0, label="first-order kernel")
    if model.second_order is not None:
        fine = np.linspace(0.0, float(model.lag_s[-1]), 300)
        fitted = scale * model.second_order.sign * model.second_order.system.impulse_response(fine)
        axes.plot(1e3 * fine, fitted, color=ORANGE, linestyle=DASHES[1], label="linear system")
    axes.set_xlim(0.0, float(lag_ms[-1]) or 1.0)
    axes.set_xlabel("Lag (ms)")
    axes.set_ylabel(f"First-order kernel ({unit})")
    axes.legend(loc="upper right")
    return drawn, (
        f"Close to an impulse response, at {model.lag_s.size} lags. It differs from the best linear system (dashed) by "
        "what higher orders take over. It should be over before the last lag, and the band should be narrow there."
    )


@figure(
    VolterraModel,
    "second-kernel",
    "Second-order kernel",
    "Symmetric image of the second-order kernel over two lags, and the same kernel as a surface.",
    group="nonlinear",
    place=60,
)
def second_kernel(subject: Subject[VolterraModel]) -> Drawn:
    """h2 as an image and as a surface (Chen 2010, Figs. 4.3, 4.6b and 4.9)."""
    model = subject.model
    kernel, unit = kernel_in_units(subject)
    lag_ms = 1e3 * model.lag_s
    drawn = new_figure(FULL_WIDTH, 4.1)
    axes = drawn.add_subplot(1, 2, 1)
    image(axes, lag_ms, lag_ms, kernel, f"Second-order kernel ({unit})")
    axes.set_box_aspect(1.0)
    axes.set_xlabel("First lag (ms)")
    axes.set_ylabel("Second lag (ms)")
    relief = surface(drawn, (1, 2, 2), lag_ms, lag_ms, kernel)
    relief.set_xlabel("First lag (ms)")
    relief.set_ylabel("Second lag (ms)")
    sign = "negative" if float(kernel.flat[np.argmax(np.abs(kernel))]) < 0.0 else "positive"
    text = (
        "How two past inputs act together. Blue is negative: together they move the tissue less than the sum of both "
        "alone, as where it stiffens with depth. A rounded peak swept in both directions is a Wiener system, a ridge "
        "along the diagonal alone a Hammerstein system, a narrow peak with side lobes parameters that change with "
        f"depth each in its own way. The largest value here is {sign}"
    )
    if model.kernel2_std is not None:
        told = np.mean(np.abs(np.asarray(model.kernel2)) > CONFIDENCE * model.kernel2_std)
        text += f"; {fixed(100.0 * float(told), 0)} % of the kernel lies outside its own 95 % band about zero"
    return drawn, f"{text}."


def kernel_in_units(subject: Subject[VolterraModel]) -> tuple[Array, str]:
    """The second-order kernel (lags, lags) in people's units, and the unit.

    Raises:
        UnusableInputError: the model has none, or a single lag.
    """
    kernel = subject.model.kernel2
    if kernel is None:
        raise UnusableInputError(f"a model of order {subject.model.order} has no second-order kernel")
    if kernel.shape[0] < 3:
        raise UnusableInputError("the second-order kernel has fewer than three lags")
    unit, scale = kernel_unit(subject.record, 2)
    return scale * kernel, unit


@figure(
    VolterraModel,
    "third-kernel",
    "Third-order kernel",
    "Slices of the third-order kernel over two lags, each at another third lag.",
    group="nonlinear",
    place=64,
    applies=lambda subject: subject.model.kernel3 is not None,
)
def third_kernel(subject: Subject[VolterraModel]) -> Drawn:
    """h3 at a few third lags."""
    model = subject.model
    kernel = cast(Array, model.kernel3)
    unit, scale = kernel_unit(subject.record, 3)
    lag_ms = 1e3 * model.lag_s
    if lag_ms.size < 3:
        raise UnusableInputError("the third-order kernel has fewer than three lags")
    strength = np.cumsum(np.abs(kernel).sum(axis=(0, 1)))
    shown = np.unique(np.searchsorted(strength, np.array([0.1, 0.35, 0.6, 0.85])[:_MOST_SLICES] * strength[-1]))
    drawn = new_figure(FULL_WIDTH, 2.7)
    every = drawn.subplots(1, shown.size, sharey=True, squeeze=False)[0]
    top = scale * float(np.abs(kernel[:, :, shown]).max())
    for place, (axes, lag) in enumerate(zip(every, shown, strict=True)):
        label = f"({unit})" if place == shown.size - 1 else ""
        image(axes, lag_ms, lag_ms, scale * kernel[:, :, lag], label, limit=top)
        axes.set_box_aspect(1.0)
        axes.set_title(f"third lag {fixed(float(lag_ms[lag]), 1)} ms")
        axes.set_xlabel("First lag (ms)")
    every[0].set_ylabel("Second lag (ms)")
    return drawn, (
        "How three past inputs act together, one slice for each of a few third lags, on one scale. Blue is negative. "
        "The kernel is the same whichever two lags are the axes."
    )


@figure(
    VolterraModel,
    "impulse-contributions",
    "Impulse response by contributions",
    "Curves against lag: first-order, second-order and total response to an impulse.",
    group="nonlinear",
    wide=False,
    place=66,
)
def impulse_contributions(subject: Subject[VolterraModel]) -> Drawn:
    """What each order adds to the response to an impulse (Chen 2010, Eq. 4.15 and Fig. 4.3)."""
    model = subject.model
    if model.kernel1 is None:
        raise UnusableInputError("a model of order zero has no kernels")
    height = _HEIGHT * float(np.nanstd(subject.fitted_input))
    response = model.impulse_response(height)
    unit, scale = people_unit(subject.record.output_unit)
    drawn = new_figure(HALF_WIDTH, 3.9)
    axes = drawn.subplots()
    axes.axhline(0.0, color=MUTED, linewidth=0.8)
    parts = [("total", response.total - response.zeroth), ("first order", response.first)]
    parts += [("second order", response.second)] if model.order > 1 else []
    parts += [("third order", response.third)] if model.order > 2 else []
    colours = (INK, *SERIES)
    for (label, values), colour, dash in zip(parts, colours, (DASHES[0], *DASHES), strict=False):
        axes.plot(1e3 * model.lag_s, scale * values, color=colour, linestyle=dash, label=label)
    axes.set_xlabel("Lag (ms)")
    axes.set_ylabel(axis_label(f"change of {subject.record.output_name}".capitalize(), unit))
    axes.legend(loc="best")
    lasts = fixed(1e3 * model.lag_spacing / model.sample_rate_hz, 1)
    in_unit, in_scale = people_unit(subject.record.input_unit)
    return drawn, (
        f"After an input {number(in_scale * height, 3)} {in_unit} above the operating point for {lasts} ms, which is "
        f"{_HEIGHT:g} standard deviations: what the first order answers, and what the diagonals of higher orders add. "
        "Where tissue stiffens, the second order takes away from the first."
    )


@figure(
    VolterraModel,
    "contributions",
    "What is left by each contribution",
    "Clouds of measured against modelled output: first order alone, with the diagonal of the second, and all.",
    group="nonlinear",
    place=68,
)
def contributions(subject: Subject[VolterraModel]) -> Drawn:
    """Residual nonlinearity as orders are added (Chen 2010, Figs. 4.3 and 4.10)."""
    model, record = subject.model, subject.record
    if model.kernel1 is None:
        raise UnusableInputError("a model of order zero has no kernels")
    shown = _cumulated(model, record.input)
    part = subject.analysis.fit_part
    unit, scale = people_unit(record.output_unit)
    measured = scale * record.output[part]
    known = np.isfinite(measured)
    if not known.any():
        raise UnusableInputError("no output was received in the fitted part")
    low, high = float(measured[known].min()), float(measured[known].max())
    drawn = new_figure(FULL_WIDTH, 3.7 if len(shown) < 4 else 3.1)
    every = drawn.subplots(1, max(2, len(shown)), sharex=True, sharey=True)
    for place, (axes, (label, modelled)) in enumerate(zip(every, shown, strict=False)):
        residual_cloud(axes, scale * modelled[part], measured, POINTS[place % len(POINTS)])
        diagonal(axes, low, high)
        axes.set_title(label)
        axes.set_xlabel(axis_label("modelled", unit))
    for axes in every[len(shown) :]:
        axes.set_visible(False)
    every[0].set_ylabel(axis_label("measured", unit))
    return drawn, (
        "A bend about the diagonal is a nonlinearity that is not yet accounted for; each panel adds kernels to the one "
        "before it. The line runs through the middle of the cloud. Samples of the fitted part."
    )


def _cumulated(model: VolterraModel, u: Array) -> list[tuple[str, Array]]:
    """Outputs (n,) as contributions are added, with what they hold."""
    parts = model.contributions(u)
    sums = np.cumsum(parts, axis=0)
    shown = [("first order", sums[1])]
    if model.kernel2 is not None:
        diagonal_only = replace(model, kernel2=np.diag(np.diag(model.kernel2)), kernel3=None, order=2)
        shown.append(("and the second’s diagonal", np.sum(diagonal_only.contributions(u), axis=0)))
        shown.append(("and all of the second", sums[2]))
    if model.kernel3 is not None:
        shown.append(("and the third order", sums[3]))
    return shown
