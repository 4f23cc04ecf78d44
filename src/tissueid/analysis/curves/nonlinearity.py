"""Plots of static nonlinearities."""

from __future__ import annotations

import numpy as np

from tissueid.analysis import Analysis
from tissueid.analysis.curves.plot import CONFIDENCE, Array, Axis, Curve, Plot
from tissueid.analysis.curves.units import signal_axis
from tissueid.errors import UnusableInputError
from tissueid.identification.cascades.curves import curve_slopes
from tissueid.identification.engines.cascade import CascadeModel
from tissueid.identification.engines.hammerstein import HammersteinModel
from tissueid.identification.engines.wiener import WienerModel
from tissueid.identification.static_nonlinearity import StaticNonlinearity
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Record
from tissueid.units import display_unit

_FINE = 200
_MOST_POINTS = 4000
_STRETCHES = 40
_FEWEST = 8


def wiener_nonlinearity(model: WienerModel, record: Record, part: slice | None = None) -> Plot:
    """Return the static nonlinearity of a Wiener cascade and the samples about it (Chen 2010, Fig. 3.8, Eq. 3.26).

    Args:
        model: the cascade.
        record: input and output; the points are its received samples.
        part: which of them were fitted.

    Raises:
        UnusableInputError: no sample lies where the model can be run.
    """
    z, measured = linear_output(model, record, part)
    in_scale, out_scale = display_unit(record.input_unit)[1], display_unit(record.output_unit)[1]
    some = slice(None, None, max(1, -(-z.size // _MOST_POINTS)))
    fine = np.linspace(z.min(), z.max(), _FINE)
    return Plot(
        marked("Static nonlinearity"),
        signal_axis("predicted_linear_output", record.input_unit),
        signal_axis(f"measured_{record.output_name}", record.output_unit),
        (
            Curve(in_scale * z[some], out_scale * measured[some], marked("measured"), kind="points", opacity=0.55),
            Curve(
                in_scale * fine,
                out_scale * model.nonlinearity(fine),
                marked("fitted nonlinearity"),
                "model",
                width=1.5,
            ),
        ),
    )


def linear_output(model: WienerModel, record: Record, part: slice | None = None) -> tuple[Array, Array]:
    """Return output of the linear stage and measured output (k,) where both are known.

    Raises:
        UnusableInputError: they are known at fewer than two samples.
    """
    z, measured = model.linear_output(record.input)[part or slice(None)], record.output[part or slice(None)]
    known = np.isfinite(z) & np.isfinite(measured)
    if known.sum() < 2:
        raise UnusableInputError(
            Message(
                "report.wiener_not_run",
                "the Wiener model cannot be simulated: no sample has an uninterrupted input over the memory",
            )
        )
    return z[known], measured[known]


def nonlinearity_plot(analysis: Analysis) -> Plot:
    """Return the static nonlinearity: after the linear stage for a Wiener cascade, before it otherwise.

    The band is the standard deviation of the samples about the curve for a Wiener cascade, and 95 % confidence for a
    Hammerstein cascade.

    Raises:
        UnusableInputError: the engine has none.
    """
    model, record = analysis.model, analysis.record[analysis.fit_part]
    half: Array | None = None
    if isinstance(model, WienerModel):
        z = model.linear_output(record.input)
        x = central_span(z)
        y = model.nonlinearity(x)
        half = _scatter(x, z, record.output - model.nonlinearity(z))
    elif isinstance(model, HammersteinModel):
        x = central_span(record.input)
        y = model.nonlinearity(x) + model.offset
        std = curve_std(model.nonlinearity, x, model.nonlinearity_covariance)
        if std is not None and model.steady_gain:
            half = CONFIDENCE * std
    elif isinstance(model, CascadeModel) and model.structure == "hammerstein" and model.inner is not None:
        x = central_span(record.input)
        y = model.inner(x) + model.offset
    else:
        raise UnusableInputError(
            Message(
                "research.no_nonlinearity",
                "only engines with a static nonlinearity have this curve: Wiener, Hammerstein",
            )
        )
    (in_unit, into), (out_unit, out) = display_unit(record.input_unit), display_unit(record.output_unit)
    low, high = (None, None) if half is None else (out * (y - half), out * (y + half))
    title = marked("Static nonlinearity")
    curve = Curve(into * x, out * y, colour="model", low=low, high=high)
    return Plot(title, Axis(marked("Input of the curve"), in_unit), Axis(title, out_unit), (curve,))


def curve_std(curve: StaticNonlinearity, x: Array, covariance: Array) -> Array | None:
    """Return the standard deviation of a curve at x (k,), (k,); None where the covariance is not known."""
    if not np.isfinite(covariance).all():
        return None
    slopes = curve_slopes(curve, x)  # (p, k)
    return np.asarray(np.sqrt(np.maximum(np.einsum("pk,pq,qk->k", slopes, covariance, slopes), 0.0)))


def central_span(values: Array) -> Array:
    """Return even steps over the central 99 % of the received values.

    Raises:
        UnusableInputError: fewer than two values were received.
    """
    known = values[np.isfinite(values)]
    if known.size < 2:
        raise UnusableInputError(Message("research.no_cascade_sample", "no sample lies in the range of the cascade"))
    low, high = np.quantile(known, (0.005, 0.995))
    return np.linspace(float(low), float(high), _FINE)


def _scatter(x: Array, z: Array, error: Array) -> Array:
    """Return the standard deviation of the error near each of x (k,), from samples z (n,)."""
    known = np.isfinite(z) & np.isfinite(error)
    edges = np.linspace(x[0], x[-1], _STRETCHES + 1)
    place = np.clip(np.digitize(z[known], edges) - 1, 0, _STRETCHES - 1)
    count = np.bincount(place, minlength=_STRETCHES)
    squares = np.bincount(place, error[known] ** 2, _STRETCHES)
    held = count >= _FEWEST
    if not held.any():
        return np.full(x.size, float(np.std(error[known])))
    middle = 0.5 * (edges[1:] + edges[:-1])
    return np.interp(x, middle[held], np.sqrt(squares[held] / count[held]))
