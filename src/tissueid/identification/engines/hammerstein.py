"""Hammerstein cascade: a static nonlinearity followed by a linear system, by alternating and joint least squares."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pydantic import Field

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Engine, FitReport, Model
from tissueid.identification.cascades.blocks import Blocks, CascadeData, cascade_data, input_levels, prepare_cascade
from tissueid.identification.cascades.curves import lifted
from tissueid.identification.cascades.fit import fit_linear, hammerstein_passes
from tissueid.identification.cascades.hammerstein_parameters import fit_driven_stage, told_of_curve
from tissueid.identification.cascades.normal import normalised, steady, uncertainty
from tissueid.identification.cascades.refinement import Fitted, refine
from tissueid.identification.correlation import convolve_at_rest
from tissueid.identification.family import Family
from tissueid.identification.impulse_response import doubt_memory
from tissueid.identification.preparation import memory_in_samples
from tissueid.identification.registry import engine
from tissueid.identification.second_order import Hold
from tissueid.identification.second_order_fit import SecondOrderFit
from tissueid.identification.static_nonlinearity import Form, StaticNonlinearity, coefficient_count
from tissueid.identification.validation import aic, aicc, vaf_percent
from tissueid.identification.wiener.parameters import wiener_parameters
from tissueid.records import Record


@dataclass(frozen=True)
class HammersteinPass:
    """One pass of alternating least squares: VAF of the free run, and the second-order system of the linear stage."""

    iteration: int
    nonlinear_vaf_percent: float
    parameters: dict[str, float]


@dataclass(frozen=True, eq=False)
class HammersteinModel(Model):
    """y = offset + kernel * f(input), with f(mean input) = 0.

    ``kernel`` (lags,) at ``lag_s`` (lags,) is per sample and sums to one, so that f, the ``nonlinearity``, carries the
    output's unit and offset + f is the static curve of the system. A kernel without a steady-state gain has a
    root-sum-square of one instead (``steady_gain`` is False). ``kernel_std`` (lags,) and
    ``nonlinearity_covariance`` (p, p), of f's coefficients, count the other stage as unknown too. ``history`` holds
    the passes of alternating least squares, ``chosen`` is the one that was kept, and ``refined`` says whether it was
    refined jointly afterwards.
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
        """Simulate free-run: input (n,) in, output (n,) out, at rest at the mean input before the first sample."""
        driven = self.nonlinearity(np.asarray(u, dtype=np.float64))
        return self.offset + convolve_at_rest(self.kernel, driven)


@engine
class Hammerstein(Engine):
    """A static nonlinearity, then linear dynamics (Chen 2010, 3.2 and 4.2; Bai 1998; Narendra and Gallman 1966).

    Assumes that the nonlinearity acts on the input before any dynamics, and noise on the output. It need not keep
    its direction: a square is found. The passes start from free weights for every power of the input and every lag,
    of which the rank-one part is kept; the best pass is refined by the simulation error over both stages together.
    """

    name: ClassVar[str] = "hammerstein"
    family: ClassVar[Family] = Family.STATIC

    memory: float = Field(0.125, gt=0.0, le=10.0, description="How long the impulse response lasts, s")
    nonlinearity: Form = Field(
        "polynomial", description="A polynomial, a spline, or C1 (1 - exp(-C2 x)) with an offset"
    )
    degree: int = Field(5, ge=1, le=20, description="Degree of the polynomial, or pieces of the spline")
    iterations: int = Field(6, ge=1, le=50, description="Passes of alternating least squares")
    refine: bool = Field(True, description="Refine the best pass by the simulation error over both stages together")
    hold: Hold = Field(
        "band-limited",
        description="What the input does between samples: a measured force is band-limited, a command is held",
    )

    def fit(self, record: Record, fit_part: slice | None = None) -> HammersteinModel:
        """Fit the cascade to a record, or to a contiguous part of it.

        Raises:
            UnusableInputError: nothing varies, too few samples, a memory longer than the part, or an input of fewer
                different values than the curve has coefficients.
        """
        lags = memory_in_samples(self.memory, record.sample_rate_hz)
        curve = coefficient_count(self.nonlinearity, self.degree)
        prepared, spacing = prepare_cascade(record, fit_part, lags, lags, lambda q: q + curve - 1)
        used = prepared.used
        levels = input_levels(prepared)
        if levels < curve:
            raise UnusableInputError(
                f"an input of {levels} different values does not determine a curve of {curve} coefficients: "
                "lower the degree, or take lms"
            )
        data = cascade_data(prepared, lags, spacing)
        passes = hammerstein_passes(data, self.nonlinearity, self.degree, self.iterations)
        chosen = min(range(len(passes)), key=lambda k: passes[k].rss)
        blocks = passes[chosen].blocks
        if self.refine:
            blocks = refine(blocks, data).blocks
        known = uncertainty(blocks, data)
        gains = steady(blocks, data, known)
        told = normalised(blocks, data, gains)
        nonlinearity = told.inner
        assert nonlinearity is not None

        def kernel_of(some: Blocks) -> Array:
            return normalised(some, data, gains).first

        def curve_of(some: Blocks) -> Array:
            inner = normalised(some, data, gains).inner
            assert inner is not None
            return inner.coefficients

        def static_curve_of(some: Blocks) -> Array:
            shape = normalised(some, data, gains)
            assert shape.inner is not None
            return lifted(shape.inner, shape.offset).coefficients

        modelled = told.simulate(np.where(np.isfinite(record.input), record.input, prepared.input_mean))
        residuals = np.where(used, record.output - modelled, np.nan)
        stage = fit_driven_stage(record, used, nonlinearity, self.hold)
        parameters = wiener_parameters(
            lifted(nonlinearity, told.offset),
            known.of(static_curve_of),
            stage,
            prepared.input_mean,
            scaling=1.0,
            surface=None,
            c3=0.0,
            mechanical=(record.input_unit, record.output_unit) == ("N", "m"),
        )
        covariance = known.of(curve_of)
        x = record.input[prepared.part]
        findings, doubts = told_of_curve(
            nonlinearity, covariance, x[np.isfinite(x)], prepared.input_mean, record.input_unit
        )
        driven = nonlinearity(np.where(np.isfinite(record.input), record.input, prepared.input_mean))
        parametric = stage.simulate(driven - float(np.mean(driven[used])))
        rate = record.sample_rate_hz
        return HammersteinModel(
            report=FitReport(
                engine=self.name,
                options=self.options(),
                n_samples=int(used.sum()),
                n_parameters=blocks.n_parameters,
                vaf_percent=vaf_percent(record.output[used], modelled[used]),
                aic=aic(residuals, blocks.n_parameters),
                aicc=aicc(residuals, blocks.n_parameters),
                parameters=parameters,
                findings=tuple(findings),
                warnings=(*prepared.warnings, *stage.warnings, *doubts, *doubt_memory(told.first)),
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
            kernel=told.first,
            kernel_std=np.sqrt(np.maximum(np.diag(known.of(kernel_of)), 0.0)),
            lag_s=np.arange(lags) / rate,
            input_mean=prepared.input_mean,
            offset=told.offset,
            nonlinearity=nonlinearity,
            nonlinearity_covariance=covariance,
            steady_gain=gains[0],
            history=self._history(record, data, passes, gains),
            chosen=chosen + 1,
            refined=self.refine,
            second_order=stage,
        )

    def _history(
        self, record: Record, data: CascadeData, passes: list[Fitted], gains: tuple[bool, bool]
    ) -> tuple[HammersteinPass, ...]:
        """Each pass with the second-order system of its linear stage."""
        history: list[HammersteinPass] = []
        stage: SecondOrderFit | None = None
        for number, done in enumerate(passes, start=1):
            inner = normalised(done.blocks, data, gains).inner
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


def _vaf(fitted: Fitted, data: CascadeData) -> float:
    """VAF of fitted blocks over the rows, in percent."""
    return 100.0 * (1.0 - fitted.rss / data.rows.size / float(np.var(data.measured)))
