"""Hammerstein cascade: a static nonlinearity followed by a linear system, by alternating and joint least squares."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Family, Mask, Model, option
from tissueid.identification.cascades.blocks import (
    Blocks,
    CascadeData,
    cascade_data,
    input_levels,
    prepare_cascade,
    with_offset,
)
from tissueid.identification.cascades.fit import FittedCascade, fit_linear, hammerstein_passes, refine
from tissueid.identification.cascades.normalisation import FLAT, has_steady_gains, normalise_gains, uncertainty
from tissueid.identification.impulse_response import convolve_at_rest, memory_warnings
from tissueid.identification.memory import MemoryEngine
from tissueid.identification.preparation import memory_in_samples
from tissueid.identification.registry import engine
from tissueid.identification.second_order import Hold
from tissueid.identification.second_order_fit import SecondOrderFit, fit_second_order
from tissueid.identification.static_nonlinearity import (
    CURVE,
    DEGREE,
    REFINE,
    Form,
    StaticNonlinearity,
    coefficient_count,
)
from tissueid.identification.validation import vaf_percent
from tissueid.identification.wiener_cascade import derived, wiener_parameters
from tissueid.language import marked
from tissueid.messages import Listing, Message
from tissueid.records import Record

_SIGNIFICANT_STD = 2.0
"""Threshold of a difference between slopes, or of a slope from zero, in standard deviations."""

_FLAT = 0.05
"""Share of the steepest slope below which a curve is flat."""

_STRAIGHT_TOLERANCE = 1e-9
"""Relative difference of slopes below which a curve counts as a straight line."""

_QUANTILES = (0.05, 0.5, 0.95)


def fit_driven_stage(
    record: Record, used: Mask, nonlinearity: StaticNonlinearity, hold: Hold, start: SecondOrderFit | None = None
) -> SecondOrderFit:
    """Fit a second-order system to the linear stage: from the output of the static curve to the measured output.

    ``used`` (n,) is the mask of the outputs to fit.
    """
    driven = replace(record, input=nonlinearity(record.input), input_unit=record.output_unit)
    return fit_second_order(driven, used, hold, start=start)


def curve_messages(
    nonlinearity: StaticNonlinearity, covariance: Array, x: Array, mean_input: float, unit: str
) -> tuple[list[str], list[str]]:
    """Return findings and warnings about a curve with coefficient covariance (p, p), over inputs x (k,)."""
    places = np.quantile(x, _QUANTILES)
    estimates = [derived(nonlinearity, covariance, lambda f, p=p: float(f.slope(np.array([p]))[0])) for p in places]  # type: ignore[misc]
    changes = [
        derived(nonlinearity, covariance, lambda f, a=a, b=b: float(np.diff(f.slope(np.array([a, b])))[0]))  # type: ignore[misc]
        for a, b in ((places[0], places[1]), (places[1], places[2]))
    ]
    steepest = max(abs(estimate.value) for estimate in estimates)
    findings: list[str] = []
    warnings: list[str] = []
    if all(
        abs(change.value) <= max(_SIGNIFICANT_STD * (change.std or 0.0), _STRAIGHT_TOLERANCE * steepest)
        for change in changes
    ):
        findings.append(
            Message(
                "hammerstein.straight",
                "the curve is straight within its uncertainty: a linear system describes it as well",
            )
        )
    else:
        shares = tuple(
            Message(
                "hammerstein.slope",
                "{percent:.0f} % at {input:.3g} {unit}",
                percent=100.0 * estimate.value / steepest,
                input=float(level),
                unit=unit,
            )
            for estimate, level in zip(estimates, places, strict=True)
        )
        findings.append(
            Message(
                "hammerstein.slopes",
                "slope of the curve as a share of its steepest: {shares}",
                shares=Listing(shares),
            )
        )
    if not nonlinearity.invertible:
        low, high = nonlinearity.monotone_range
        findings.append(
            Message(
                "hammerstein.not_monotone",
                "the curve is monotone only from {low:.3g} to {high:.3g} {unit}",
                low=low,
                high=high,
                unit=unit,
            )
        )
    here = derived(nonlinearity, covariance, lambda f: float(f.slope(np.array([mean_input]))[0]))
    if here.std is None or abs(here.value) <= max(_SIGNIFICANT_STD * here.std, _FLAT * steepest):
        warnings.append(FLAT)
    return findings, warnings


@dataclass(frozen=True)
class HammersteinPass:
    """One pass of alternating least squares: VAF of the free run, and the second-order system of the linear stage."""

    iteration: int
    nonlinear_vaf_percent: float
    parameters: dict[str, float]


@dataclass(frozen=True, eq=False)
class HammersteinModel(Model):
    """y = offset + kernel * f(input), with f(mean input) = 0.

    ``kernel`` (lags,) at ``lag_s`` (lags,) is per sample and sums to 1, so that f, the ``nonlinearity``, carries the
    unit of the output and offset + f is the static curve of the system. A kernel without a steady-state gain has a
    root-sum-square of 1 instead (``steady_gain`` is False). ``kernel_std`` (lags,) and ``nonlinearity_covariance`` (p,
    p), of f's coefficients, include the uncertainty of the other stage. ``history`` holds the passes of alternating
    least squares, ``chosen`` is the number of the pass that was used, and ``refined`` tells whether it was refined
    jointly afterwards.
    """

    kernel: Array
    kernel_std: Array
    lag_s: Array
    input_mean: float
    offset: float
    nonlinearity: StaticNonlinearity
    nonlinearity_covariance: Array
    steady_gain: bool
    history: tuple[HammersteinPass, ...]
    chosen: int
    refined: bool
    second_order: SecondOrderFit

    def simulate(self, u: Array) -> Array:
        """Simulate in free run: input (n,), output (n,), at rest at the mean input before the first sample."""
        driven = self.nonlinearity(np.asarray(u, dtype=np.float64))
        return self.offset + convolve_at_rest(self.kernel, driven)


@engine
class Hammerstein(MemoryEngine):
    """Hammerstein engine.

    Assumes a static nonlinearity of the input, followed by linear dynamics, with output noise. The nonlinearity need
    not be monotone. The passes start from the rank-one approximation of free weights for every power of the input and
    every lag; the best pass is refined by the simulation error over both stages.
    """

    name: ClassVar[str] = "hammerstein"
    label: ClassVar[str] = marked("Hammerstein")
    title: ClassVar[str] = marked(
        "A static nonlinearity, then linear dynamics (Chen 2010, 3.2 and 4.2; Bai 1998; Narendra and Gallman 1966)."
    )
    family: ClassVar[Family] = Family.STATIC

    nonlinearity: Form = CURVE
    degree: int = DEGREE
    iterations: int = option(
        6, marked("Iterations"), marked("Number of passes of alternating least squares"), ge=1, le=50
    )
    refine: bool = REFINE

    def fit(self, record: Record, fit_part: slice | None = None) -> HammersteinModel:
        """Fit the cascade to a record, or to a contiguous part of it.

        Raises:
            UnusableInputError: nothing varies, too few samples, a memory longer than the part, or an input with fewer
                distinct values than the curve has coefficients.
        """
        lags = memory_in_samples(self.memory_s, record.sample_rate_hz)
        curve = coefficient_count(self.nonlinearity, self.degree)
        prepared, spacing = prepare_cascade(record, fit_part, lags, lags, lambda q: q + curve - 1)
        used = prepared.used
        levels = input_levels(prepared)
        if levels < curve:
            raise UnusableInputError(
                "hammerstein.few_levels",
                "an input of {levels} different values does not determine a curve of {coefficients} "
                "coefficients: lower the degree, or use lms",
                levels=levels,
                coefficients=curve,
            )
        data = cascade_data(prepared, lags, spacing)
        passes = hammerstein_passes(data, self.nonlinearity, self.degree, self.iterations)
        chosen = min(range(len(passes)), key=lambda k: passes[k].rss)
        blocks = passes[chosen].blocks
        if self.refine:
            blocks = refine(blocks, data).blocks
        vector_covariance = uncertainty(blocks, data)
        gains = has_steady_gains(blocks, data, vector_covariance)
        normal = normalise_gains(blocks, data, gains)
        nonlinearity = normal.inner
        assert nonlinearity is not None

        def curve_of(some: Blocks) -> Array:
            inner = normalise_gains(some, data, gains).inner
            assert inner is not None
            return inner.coefficients

        def static_curve_of(some: Blocks) -> Array:
            shape = normalise_gains(some, data, gains)
            assert shape.inner is not None
            return with_offset(shape.inner, shape.offset).coefficients

        modelled = normal.simulate(np.where(np.isfinite(record.input), record.input, prepared.input_mean))
        stage = fit_driven_stage(record, used, nonlinearity, self.hold)
        parameters = wiener_parameters(
            with_offset(nonlinearity, normal.offset),
            vector_covariance.of(static_curve_of),
            stage,
            prepared.input_mean,
            scaling=1.0,
            surface=None,
            c3=0.0,
            mechanical=(record.input_unit, record.output_unit) == ("N", "m"),
        )
        covariance = vector_covariance.of(curve_of)
        x = record.input[prepared.part]
        findings, doubts = curve_messages(
            nonlinearity, covariance, x[np.isfinite(x)], prepared.input_mean, record.input_unit
        )
        driven = nonlinearity(np.where(np.isfinite(record.input), record.input, prepared.input_mean))
        parametric = stage.simulate(driven - float(np.mean(driven[used])))
        rate = record.sample_rate_hz
        return HammersteinModel(
            report=self.report(
                record,
                used,
                modelled,
                blocks.n_parameters,
                parameters=parameters,
                findings=tuple(findings),
                warnings=(*prepared.warnings, *stage.warnings, *doubts, *memory_warnings(normal.first)),
                details={
                    "vaf_linear_percent": _vaf(fit_linear(data), data),
                    "vaf_parametric_percent": vaf_percent(record.output[used], parametric[used]),
                    "chosen_iteration": float(chosen + 1),
                    "kernel_functions": float(data.bank.size),
                    "input_edge_hz": data.edge_hz,
                },
            ),
            sample_rate_hz=rate,
            memory_samples=lags,
            kernel=normal.first,
            kernel_std=np.sqrt(
                np.maximum(np.diag(vector_covariance.of(lambda some: normalise_gains(some, data, gains).first)), 0.0)
            ),
            lag_s=np.arange(lags) / rate,
            input_mean=prepared.input_mean,
            offset=normal.offset,
            nonlinearity=nonlinearity,
            nonlinearity_covariance=covariance,
            steady_gain=gains[0],
            history=self._history(record, data, passes, gains),
            chosen=chosen + 1,
            refined=self.refine,
            second_order=stage,
        )

    def _history(
        self, record: Record, data: CascadeData, passes: list[FittedCascade], gains: tuple[bool, bool]
    ) -> tuple[HammersteinPass, ...]:
        """Return each pass with the second-order system of its linear stage."""
        history: list[HammersteinPass] = []
        stage: SecondOrderFit | None = None
        for number, done in enumerate(passes, start=1):
            inner = normalise_gains(done.blocks, data, gains).inner
            assert inner is not None
            stage = fit_driven_stage(record, data.prepared.used, inner, self.hold, stage)
            history.append(
                HammersteinPass(
                    iteration=number,
                    nonlinear_vaf_percent=_vaf(done, data),
                    parameters={
                        "scaled_mass_s2": stage.system.mass / stage.system.stiffness,
                        "scaled_damping_s": stage.system.damping / stage.system.stiffness,
                    },
                )
            )
        return tuple(history)


def _vaf(fitted: FittedCascade, data: CascadeData) -> float:
    """Return the VAF of fitted blocks over the rows, in percent."""
    return 100.0 * (1.0 - fitted.rss / data.rows.size / float(np.var(data.measured)))
