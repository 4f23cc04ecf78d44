"""Wiener cascade: a linear system followed by a static nonlinearity, by the iteration of Hunter and Korenberg."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from scipy import fft

from tissueid.identification.base import Array, Family, Model, option
from tissueid.identification.impulse_response import factor_input, memory_warnings, with_extra_memory
from tissueid.identification.memory import MemoryEngine
from tissueid.identification.preparation import memory_in_samples, prepare
from tissueid.identification.registry import engine
from tissueid.identification.second_order import Hold, SecondOrder, sampled_response_at
from tissueid.identification.second_order_fit import SecondOrderFit
from tissueid.identification.static_nonlinearity import (
    DEGREE,
    REFINE,
    ExponentialCurve,
    Form,
    StaticNonlinearity,
    coefficient_count,
)
from tissueid.identification.validation import vaf_percent
from tissueid.identification.wiener_cascade import (
    LinearStage,
    Pass,
    WienerCascade,
    coefficient_covariance,
    cut_to_memory,
    fit_linear_stage,
    hunter_korenberg,
    linear_output,
    refine,
    straightness_warning,
    wiener_parameters,
)
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Record

_ITERATIONS = 30
_TOLERANCE = 1e-6
_NEGLIGIBLE_POWER = 1e-9
"""Power below which a frequency is not used, relative to the strongest frequency."""


class KernelSystems:
    """Second-order systems of kernels for one input x (n,) with its mean removed and zeros for missing samples."""

    def __init__(self, x: Array, sample_rate_hz: float, hold: Hold) -> None:
        self._length = fft.next_fast_len(x.size, real=True)
        power = np.abs(fft.rfft(x, self._length)) ** 2
        power[0] = 0.0  # an offset is free
        self._driven = power > _NEGLIGIBLE_POWER * float(power.max())
        self._weights = np.sqrt(power[self._driven])
        self._frequency_hz = fft.rfftfreq(self._length, 1.0 / sample_rate_hz)[self._driven]
        self._rate = sample_rate_hz
        self._hold: Hold = hold

    def nearest(self, kernel: Array, start: SecondOrder) -> SecondOrder:
        """Return the second-order system nearest to a kernel (lags,) per sample, by Gauss-Newton on log M, log B, log
        K.
        """
        wanted = fft.rfft(kernel, self._length)[self._driven]
        theta = np.log([start.mass, start.damping, start.stiffness])
        error, slopes = self._evaluate(theta, wanted)
        for _ in range(_ITERATIONS):
            step = np.linalg.lstsq(slopes @ slopes.T, slopes @ error, rcond=1e-12)[0]
            step /= max(1.0, float(np.max(np.abs(step))))
            while np.max(np.abs(step)) > _TOLERANCE:
                tried_error, tried_slopes = self._evaluate(theta + step, wanted)
                if np.dot(tried_error, tried_error) < np.dot(error, error):
                    theta, error, slopes = theta + step, tried_error, tried_slopes
                    break
                step *= 0.5
            if np.max(np.abs(step)) <= _TOLERANCE:
                break
        mass, damping, stiffness = np.exp(theta)
        return SecondOrder(float(mass), float(damping), float(stiffness))

    def _evaluate(self, theta: Array, wanted: Array) -> tuple[Array, Array]:
        """Return weighted errors (2 bins,) of the response, real parts then imaginary parts, and their derivatives (3,
        2 bins).
        """
        mass, damping, stiffness = np.exp(theta)
        system = SecondOrder(float(mass), float(damping), float(stiffness))
        response, slopes = sampled_response_at(system, self._frequency_hz, self._rate, self._hold)
        error = self._weights * (wanted - response)
        weighted = self._weights * slopes
        return np.concatenate([error.real, error.imag]), np.concatenate([weighted.real, weighted.imag], axis=1)


_TAPER = 0.05
"""Taper of both signals, as the default of ``lms``: prevents artefacts of the abrupt ends of a record."""

_LOST_POINTS = 1.0
"""Loss of VAF from the best to the last iterate, percentage points, above which the iteration has diverged."""

_FEEDBACK_USED = Message(
    "wiener.feedback", "the nonlinearity has no inverse: the linear stage was estimated by feedback of the output error"
)

_CLIPPED_PERCENT = 5.0
"""Share of the output, %, outside the range of g above which a warning is given."""


@dataclass(frozen=True)
class WienerIteration:
    """One pass of the iteration (Chen 2010, Fig. 3.9).

    ``linear_vaf_percent`` scores the impulse response against the output that it was estimated from: the measured
    output in the first pass, the inverted one in later passes. ``nonlinear_vaf_percent`` scores the cascade against the
    measured output. ``parameters`` are those of g and of the second-order system of the linear stage.
    """

    iteration: int
    linear_vaf_percent: float
    nonlinear_vaf_percent: float
    parameters: dict[str, float]


@dataclass(frozen=True, eq=False)
class WienerModel(Model):
    """y = g(z), z = mean input + kernel * (input - mean input).

    ``kernel`` (lags,) sums to 1, so that z has the unit of the input (newtons) and g that of the output (metres).
    ``chosen`` is the number of the pass that was used; ``refined`` tells whether it was refined jointly afterwards.
    """

    kernel: Array
    input_mean: float
    nonlinearity: StaticNonlinearity
    history: tuple[WienerIteration, ...]
    chosen: int
    refined: bool
    second_order: SecondOrderFit

    def linear_output(self, u: Array) -> Array:
        """Return z, shape (n,), in the unit of the input u (n,), at rest at the mean input before the first sample."""
        return linear_output(self.kernel, np.asarray(u, dtype=np.float64) - self.input_mean, self.input_mean)

    def simulate(self, u: Array) -> Array:
        """Simulate in free run: input (n,), output (n,), at rest at the mean input before the first sample."""
        return self.nonlinearity(self.linear_output(u))


@engine
class Wiener(MemoryEngine):
    """Wiener engine.

    Assumes that stiffness, damping and mass change with depth by one common factor, with output noise. If a polynomial
    is not monotone, the feedback form of Korenberg and Hunter (1999) is used. The pass with the smallest in-sample
    simulation error is used and refined jointly unless ``refine`` is off: the iteration regresses on the inverse of
    noisy outputs, which causes a bias where g is flat; the refinement has no such bias.
    """

    name: ClassVar[str] = "wiener"
    label: ClassVar[str] = marked("Wiener")
    title: ClassVar[str] = marked(
        "Linear dynamics, then a static nonlinearity (Chen 2010, 3.2; Hunter and Korenberg 1986)."
    )
    family: ClassVar[Family] = Family.STATIC
    in_report: ClassVar[bool] = True

    nonlinearity: Form = option(
        "exponential",
        marked("Nonlinearity"),
        marked("C1 (1 - exp(-C2 z)) with an offset, a polynomial, or a monotone spline"),
    )
    degree: int = DEGREE
    iterations: int = option(
        6, marked("Iterations"), marked("Number of passes of linear and nonlinear estimation"), ge=1, le=50
    )
    refine: bool = REFINE
    scaling: float = option(
        1.0,
        marked("Linear stiffness"),
        marked("Stiffness of the linear stage, by definition; 1000 N/m as in the thesis"),
        gt=0.0,
        le=1e9,
    )
    c3_n: float | None = option(
        None,
        marked("Load C3"),
        marked(
            "Load in addition to the measured one, N; if not given, it is estimated where the surface is known, and "
            "else the weight of the moving part where the test has it, or 0"
        ),
        ge=-100.0,
        le=100.0,
    )
    surface_position_m: float | None = option(
        None,
        marked("Surface"),
        marked(
            "Position of the tissue surface, m, which fixes the offset, so that C3 is estimated; if neither it nor C3 "
            "is given, that of the test"
        ),
        ge=-1.0,
        le=1.0,
    )

    def with_test_values(self, surface_position_m: float | None, weight_n: float | None) -> Self:
        """Return the specification with surface or weight of the test, unless one of the two options is given."""
        if self.c3_n is not None or self.surface_position_m is not None:
            return self
        c3 = weight_n if surface_position_m is None else None
        return self.model_copy(update={"surface_position_m": surface_position_m, "c3_n": c3})

    def fit(self, record: Record, fit_part: slice | None = None) -> WienerModel:
        """Fit the cascade to a record, or to a contiguous part of it.

        Raises:
            UnusableInputError: nothing varies, too few samples, a memory longer than the part, or a linear stage
                without a steady-state gain, which is needed for normalisation.
        """
        lags = memory_in_samples(self.memory_s, record.sample_rate_hz)
        n_parameters = lags - 1 + coefficient_count(self.nonlinearity, self.degree)  # the sum of the kernel is fixed
        prepared = prepare(record, fit_part, self.memory_s, n_parameters)
        longer = LinearStage(factor_input(with_extra_memory(prepared), taper=_TAPER))
        solved = factor_input(prepared, taper=_TAPER)
        stage = LinearStage(solved)
        estimated = hunter_korenberg(longer, self.nonlinearity, self.degree, self.iterations)
        passes = [_pass_cut_to_memory(longer, stage, done) for done in estimated]
        chosen = min(range(len(passes)), key=lambda k: passes[k].cascade.rss)
        cascade = passes[chosen].cascade
        if self.refine:
            refined = cut_to_memory(longer, stage, refine(longer, estimated[chosen].cascade))
            cascade = min(refined, cascade, key=lambda tried: tried.rss)
        warnings = [*prepared.warnings, *solved.warnings, *self._warnings(passes, chosen, cascade)]

        used = prepared.used
        z = linear_output(cascade.kernel, solved.input, prepared.input_mean)
        modelled = cascade.nonlinearity(z)
        second_order = fit_linear_stage(record, used, z, cascade.nonlinearity, self.hold)
        warnings += second_order.warnings
        parameters = wiener_parameters(
            cascade.nonlinearity,
            coefficient_covariance(stage, cascade),
            second_order,
            prepared.input_mean,
            scaling=self.scaling,
            surface=self.surface_position_m,
            c3=self.c3_n or 0.0,
            mechanical=(record.input_unit, record.output_unit) == ("N", "m"),
        )
        warnings += straightness_warning(cascade.nonlinearity, parameters)
        parametric = prepared.input_mean + second_order.simulate(np.where(np.isfinite(solved.input), solved.input, 0.0))
        return WienerModel(
            report=self.report(
                record,
                used,
                modelled,
                n_parameters,
                parameters=parameters,
                warnings=(*warnings, *memory_warnings(cascade.kernel)),
                findings=(_FEEDBACK_USED,) if passes[chosen].feedback else (),
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

    def _warnings(self, passes: list[Pass], chosen: int, cascade: WienerCascade) -> list[str]:
        """Return warnings about the iteration and the nonlinearity."""
        doubts: list[str] = []
        turned = any(done.feedback for done in passes)
        if len(passes) < self.iterations and not turned:
            doubts.append(
                Message(
                    "wiener.stopped",
                    "the iteration stopped after {done} of {passes} passes: the inverted output no longer depends on "
                    "the input",
                    done=len(passes),
                    passes=self.iterations,
                )
            )
        lost = passes[chosen].nonlinear_vaf_percent - passes[-1].nonlinear_vaf_percent
        if lost > _LOST_POINTS:
            doubts.append(
                Message(
                    "wiener.diverged",
                    "the iteration diverged and lost {points:.1f} points of VAF after pass {number}, which is used",
                    points=lost,
                    number=chosen + 1,
                )
            )
        clipped = passes[chosen].clipped_percent
        if turned:
            doubts.append(
                Message(
                    "wiener.not_monotone",
                    "the nonlinearity is not monotone: one output belongs to several loads, and the stiffness "
                    "changes sign",
                )
            )
        elif not cascade.nonlinearity.invertible:
            low, high = cascade.nonlinearity.monotone_range
            doubts.append(
                Message(
                    "wiener.partly_monotone",
                    "the nonlinearity is monotone only from {low:.3g} to {high:.3g}, and was inverted there",
                    low=low,
                    high=high,
                )
            )
        elif clipped > _CLIPPED_PERCENT:
            doubts.append(
                Message(
                    "wiener.out_of_range",
                    "{percent:.0f} % of the output is outside the range of the nonlinearity",
                    percent=clipped,
                )
            )
        return doubts

    def _history(self, stage: LinearStage, passes: list[Pass], final: SecondOrder) -> tuple[WienerIteration, ...]:
        """Return each pass with the parameters of g and of the second-order system of its linear stage."""
        systems = KernelSystems(stage.x, stage.solved.prepared.record.sample_rate_hz, self.hold)
        history: list[WienerIteration] = []
        for number, done in enumerate(passes, start=1):
            system = systems.nearest(done.cascade.kernel, final)
            parameters = {
                "scaled_mass_s2": self.scaling * system.mass / system.stiffness,
                "scaled_damping_s": self.scaling * system.damping / system.stiffness,
            }
            if isinstance(done.cascade.nonlinearity, ExponentialCurve):
                constants = done.cascade.nonlinearity.thesis_constants(self.surface_position_m, self.c3_n or 0.0)
                parameters |= zip(("c1", "c2", "c3", "offset"), constants, strict=True)
            history.append(
                WienerIteration(
                    iteration=number,
                    linear_vaf_percent=done.linear_vaf_percent,
                    nonlinear_vaf_percent=done.nonlinear_vaf_percent,
                    parameters=parameters,
                )
            )
        return tuple(history)


def _pass_cut_to_memory(longer: LinearStage, stage: LinearStage, done: Pass) -> Pass:
    cascade = cut_to_memory(longer, stage, done.cascade)
    simulated = cascade.nonlinearity(stage.input_mean + stage.response(cascade.kernel))
    return replace(done, cascade=cascade, nonlinear_vaf_percent=vaf_percent(stage.y, simulated))
