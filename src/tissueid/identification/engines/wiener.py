"""Wiener cascade: a linear system followed by a static nonlinearity, by the iteration of Hunter and Korenberg."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from pydantic import Field

from tissueid.identification.base import Array, Engine, FitReport, Model
from tissueid.identification.family import Family
from tissueid.identification.impulse_response import beyond_memory, doubt_memory, factor_input
from tissueid.identification.preparation import memory_in_samples, prepare
from tissueid.identification.registry import engine
from tissueid.identification.second_order import Hold, SecondOrder
from tissueid.identification.second_order_fit import SecondOrderFit
from tissueid.identification.static_nonlinearity import Exponential, Form, StaticNonlinearity, coefficient_count
from tissueid.identification.validation import aic, aicc, vaf_percent
from tissueid.identification.wiener.history import KernelSystems
from tissueid.identification.wiener.iteration import (
    Cascade,
    LinearStage,
    Pass,
    hunter_korenberg,
    linear_output,
    shortened,
)
from tissueid.identification.wiener.parameters import fit_linear_stage, straightness, wiener_parameters
from tissueid.identification.wiener.refinement import coefficient_covariance, refine
from tissueid.records import Record

_TAPER = 0.05
"""As the default of ``lms``: a record cut off in mid-motion must not leave its edge in the kernel."""

_LOST_POINTS = 1.0
"""Percentage points of VAF that the last iterate may lose on the best before it is called divergence."""

_FED_BACK = "the nonlinearity has no inverse: the linear stage was found by feedback of the output error"

_CLIPPED_PERCENT = 5.0
"""Share of the output that may lie beyond the reach of g before it is told."""


@dataclass(frozen=True)
class WienerIteration:
    """One pass of the iteration (Chen 2010, Fig. 3.9).

    ``linear_vaf_percent`` is that of the impulse response against the output it was estimated from: the measured
    one at first, the inverted one after. ``nonlinear_vaf_percent`` is that of the cascade against the measured
    output. ``parameters`` are those of g and of the second-order system of the linear stage.
    """

    iteration: int
    linear_vaf_percent: float
    nonlinear_vaf_percent: float
    parameters: dict[str, float]


@dataclass(frozen=True, eq=False)
class WienerModel(Model):
    """y = g(z), z = mean input + kernel * (input - mean input).

    ``kernel`` (lags,) sums to one, so z carries the input's unit (absolute newtons) and g the output's (metres).
    ``chosen`` is the iteration that was kept; ``refined`` says whether it was refined jointly afterwards.
    """

    kernel: Array
    input_mean: float
    nonlinearity: StaticNonlinearity
    history: tuple[WienerIteration, ...]
    chosen: int
    refined: bool
    second_order: SecondOrderFit

    def linear_output(self, u: Array) -> Array:
        """z, shape (n,), in the unit of the input u (n,), at rest at the mean input before the first sample."""
        return linear_output(self.kernel, np.asarray(u, dtype=np.float64) - self.input_mean, self.input_mean)

    def simulate(self, u: Array) -> Array:
        """Simulate free-run: input (n,) in, output (n,) out, at rest at the mean input before the first sample."""
        return self.nonlinearity(self.linear_output(u))


@engine
class Wiener(Engine):
    """Linear dynamics, then a static nonlinearity (Chen 2010, 3.2; Hunter and Korenberg 1986).

    Assumes that stiffness, damping and mass change with depth by one common factor, and noise on the output. A
    polynomial may turn back: then the feedback form of Korenberg and Hunter (1999) is taken. The best pass of the
    iteration is kept, judged by the in-sample simulation error, and then refined jointly unless ``refine`` is off: the
    iteration regresses on the inverse of noisy outputs, which biases it where g is flat; the refinement does not.
    """

    name: ClassVar[str] = "wiener"
    family: ClassVar[Family] = Family.STATIC

    memory: float = Field(0.125, gt=0.0, le=10.0, description="How long the impulse response lasts, s")
    nonlinearity: Form = Field(
        "exponential", description="C1 (1 - exp(-C2 z)) with an offset, a polynomial, or a monotone spline"
    )
    degree: int = Field(5, ge=1, le=20, description="Degree of the polynomial, or pieces of the spline")
    iterations: int = Field(6, ge=1, le=50, description="Passes of linear and nonlinear estimation")
    refine: bool = Field(True, description="Refine the best pass by the simulation error over both stages together")
    scaling: float = Field(
        1.0,
        gt=0.0,
        le=1e9,
        description="Stiffness ascribed to the linear stage; 1000 gives the thesis' figures",
    )
    c3_n: float = Field(0.0, ge=-100.0, le=100.0, description="Load beyond the measured one, such as gravity, N")
    surface_position_m: float | None = Field(
        None, ge=-1.0, le=1.0, description="Where the tissue begins, m; when given, it is held and C3 is estimated"
    )
    hold: Hold = Field(
        "band-limited",
        description="What the input does between samples: a measured force is band-limited, a command is held",
    )

    def fit(self, record: Record, fit_part: slice | None = None) -> WienerModel:
        """Fit the cascade to a record, or to a contiguous part of it.

        Raises:
            UnusableInputError: nothing varies, too few samples, a memory longer than the part, or a linear stage
                without a steady-state gain to normalise by.
        """
        lags = memory_in_samples(self.memory, record.sample_rate_hz)
        n_parameters = lags - 1 + coefficient_count(self.nonlinearity, self.degree)  # the kernel's sum is one
        prepared = prepare(record, fit_part, self.memory, n_parameters)
        longer = LinearStage(factor_input(beyond_memory(prepared), taper=_TAPER))
        solved = factor_input(prepared, taper=_TAPER)
        stage = LinearStage(solved)
        estimated = hunter_korenberg(longer, self.nonlinearity, self.degree, self.iterations)
        passes = [_shortened(longer, stage, done) for done in estimated]
        chosen = min(range(len(passes)), key=lambda k: passes[k].cascade.rss)
        cascade = passes[chosen].cascade
        if self.refine:
            refined = shortened(longer, stage, refine(longer, estimated[chosen].cascade))
            cascade = min(refined, cascade, key=lambda one: one.rss)
        warnings = [*prepared.warnings, *solved.warnings, *self._doubts(passes, chosen, cascade)]

        used = prepared.used
        z = linear_output(cascade.kernel, solved.input, prepared.input_mean)
        modelled = cascade.nonlinearity(z)
        residuals = np.where(used, record.output - modelled, np.nan)
        second_order = fit_linear_stage(record, used, z, cascade.nonlinearity, self.hold)
        warnings += second_order.warnings
        parameters = wiener_parameters(
            cascade.nonlinearity,
            coefficient_covariance(stage, cascade),
            second_order,
            prepared.input_mean,
            scaling=self.scaling,
            surface=self.surface_position_m,
            c3=self.c3_n,
            mechanical=(record.input_unit, record.output_unit) == ("N", "m"),
        )
        warnings += straightness(cascade.nonlinearity, parameters)
        parametric = prepared.input_mean + second_order.simulate(np.where(np.isfinite(solved.input), solved.input, 0.0))
        return WienerModel(
            report=FitReport(
                engine=self.name,
                options=self.options(),
                n_samples=int(used.sum()),
                n_parameters=n_parameters,
                vaf_percent=vaf_percent(record.output[used], modelled[used]),
                aic=aic(residuals, n_parameters),
                aicc=aicc(residuals, n_parameters),
                parameters=parameters,
                warnings=(*warnings, *doubt_memory(cascade.kernel)),
                findings=(_FED_BACK,) if passes[chosen].feedback else (),
                details={
                    "condition_number": solved.condition,
                    "vaf_linear_percent": passes[0].linear_vaf_percent,
                    "vaf_parametric_percent": vaf_percent(record.output[used], cascade.nonlinearity(parametric[used])),
                    "chosen_iteration": float(chosen + 1),
                },
            ),
            sample_rate_hz=record.sample_rate_hz,
            memory_samples=lags,
            kernel=cascade.kernel,
            input_mean=prepared.input_mean,
            nonlinearity=cascade.nonlinearity,
            history=self._history(stage, passes, second_order.system),
            chosen=chosen + 1,
            refined=self.refine,
            second_order=second_order,
        )

    def _doubts(self, passes: list[Pass], chosen: int, cascade: Cascade) -> list[str]:
        """What a reader should know before trusting the answer."""
        doubts = []
        turned = any(one.feedback for one in passes)
        if len(passes) < self.iterations and not turned:
            doubts.append(
                f"the iteration stopped after {len(passes)} of {self.iterations} passes: the inverted output "
                "no longer answers the input"
            )
        lost = passes[chosen].nonlinear_vaf_percent - passes[-1].nonlinear_vaf_percent
        if lost > _LOST_POINTS:
            doubts.append(
                f"the iteration diverged, losing {lost:.1f} points of VAF after pass {chosen + 1}, which was kept"
            )
        clipped = passes[chosen].clipped_percent
        if turned:
            doubts.append("the nonlinearity turns back: an output answers to several loads, and stiffness changes sign")
        elif not cascade.nonlinearity.invertible:
            low, high = cascade.nonlinearity.monotone_range
            doubts.append(f"the nonlinearity turns back: it was inverted only from {low:.3g} to {high:.3g}")
        elif clipped > _CLIPPED_PERCENT:
            doubts.append(f"{clipped:.0f} % of the output lies beyond what the nonlinearity can reach")
        return doubts

    def _history(self, stage: LinearStage, passes: list[Pass], final: SecondOrder) -> tuple[WienerIteration, ...]:
        """Each pass with the parameters of g and of the second-order system of its linear stage."""
        systems = KernelSystems(stage.x, stage.solved.prepared.record.sample_rate_hz, self.hold)
        history: list[WienerIteration] = []
        for number, done in enumerate(passes, start=1):
            system = systems.nearest(done.cascade.kernel, final)
            found = {
                "scaled_mass_s2": self.scaling * system.mass / system.stiffness,
                "scaled_damping_s": self.scaling * system.damping / system.stiffness,
            }
            if isinstance(done.cascade.nonlinearity, Exponential):
                constants = done.cascade.nonlinearity.thesis_constants(self.surface_position_m, self.c3_n)
                found |= zip(("c1", "c2", "c3", "offset"), constants, strict=True)
            history.append(
                WienerIteration(
                    iteration=number,
                    linear_vaf_percent=done.linear_vaf_percent,
                    nonlinear_vaf_percent=done.nonlinear_vaf_percent,
                    parameters=found,
                )
            )
        return tuple(history)


def _shortened(longer: LinearStage, stage: LinearStage, done: Pass) -> Pass:
    cascade = shortened(longer, stage, done.cascade)
    simulated = cascade.nonlinearity(stage.input_mean + stage.response(cascade.kernel))
    return replace(done, cascade=cascade, nonlinear_vaf_percent=vaf_percent(stage.y, simulated))
