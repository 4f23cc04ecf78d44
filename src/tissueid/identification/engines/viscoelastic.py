"""Linear models of tissue with relaxation: Kelvin-Voigt, Maxwell, standard linear solid and Burger (Chen 2010, 2.1).

Output-error fit in the frequency domain, as for the second-order system; offset, initial state and a straight line of
drift are nuisance parameters. The line may be creep under the mean load or not come from the input at all: it is no
part of the model's simulation, so that no score credits it to the input.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Self

import numpy as np
from scipy import fft

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Engine, Family, FittedCurve, LineFigure, Mask, Model, option
from tissueid.identification.impulse_response import Correlator, dependence_samples
from tissueid.identification.levenberg_marquardt import Bounds, ErrorPoint, ErrorProblem, minimise
from tissueid.identification.preparation import complete_after_rest, finite_runs, prepare
from tissueid.identification.ramp_stiffness import is_slow, ramp_stiffness
from tissueid.identification.registry import engine
from tissueid.identification.second_order import HOLD_DESCRIPTION, HOLD_TITLE, Hold
from tissueid.identification.second_order_fit import InputRun, SecondOrderFit, fit_second_order, input_runs, sandwich
from tissueid.identification.validation import aic, aicc, vaf_percent
from tissueid.identification.validation.scores import NO_SAMPLE
from tissueid.identification.viscoelastic_structures import (
    DECAYED,
    ELEMENTS,
    NAMES,
    PARALLEL,
    STRUCTURES,
    Structure,
    Viscoelastic,
)
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Estimate, Record

Choice = Literal["auto", "kelvin-voigt", "maxwell", "standard-linear-solid", "burger"]

_LEAST_S = 0.125
"""Shortest record, s, as the memory of ``lms``; outputs before it are not fitted."""
_BLOCKS = 8
"""Stretches of a ramp and hold over which coloured residuals are taken as correlated."""
_FASTEST = 3.0
"""Decays of a free response per sample above which it is not fitted: it is gone after one sample."""
_FEWEST_HELD = 8
"""Fewest samples at the start of a record by which the input counts as held."""
_HELD = 0.1
"""Largest standard deviation of an input that is held at the start, relative to that of the whole input."""
_ITERATIONS = 60
_GAIN_TOLERANCE = 1e-7
_STARTS = 3
"""Number of starting points that are refined."""
_START_TIMES_S = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3)
_START_SHARES = (0.2, 1.0, 4.0)
_START_DAMPING = 0.2
_NO_DAMPING = 1e-6
"""Parallel damping of the starting points, and where it is not fitted, relative to that of the second-order system."""
_DAMPING = PARALLEL.index("damping_n_s_per_m")
_UNDETERMINED = 0.5
"""Relative standard deviation above which a parameter is undetermined."""
_LONGEST_SHARE = 0.5
"""Share of the fitted record that the memory of a model may have."""
_CLEAR = 4.0
"""Lead in AICc that a structure with more elements needs: structures within it cannot be distinguished (Burnham and
Anderson 2002)."""


@dataclass(frozen=True, eq=False)
class ViscoelasticModel(Model):
    """A viscoelastic tissue under a mass, about an operating point. ``sign`` is -1 for an output that falls with a
    rising input. ``settling_samples`` is the time after which a free response is forgotten; ``memory_samples`` is
    shorter where the fitted record starts at rest.
    """

    system: Viscoelastic
    sign: float
    input_mean: float
    output_mean: float
    hold: Hold
    settling_samples: int

    def simulate(self, u: Array) -> Array:
        """Simulate in free run: input (n,), output (n,), from the steady state of the first input if that is held.

        Otherwise the run starts from the steady state of the mean input. Creep in that state is left out.
        """
        u = np.asarray(u, dtype=np.float64)
        received = np.isfinite(u)
        if not received.any():
            return np.full(u.size, np.nan)
        bridged = np.interp(np.arange(u.size), np.flatnonzero(received), u[received])  # a jump would act before the gap
        start = _held_start(bridged, self.sample_rate_hz)
        start = self.input_mean if start is None else start
        run = self.system.simulate(bridged - start, self.sample_rate_hz, self.hold)
        run += self.system.static_compliance * (start - self.input_mean)
        complete = complete_after_rest(received, self.settling_samples)
        return np.where(complete, self.output_mean + self.sign * run, np.nan)


def _held_start(u: Array, rate: float) -> float | None:
    """Return the mean of the first samples of an input (n,) if it is held there; None if it varies as later."""
    first = u[: max(_FEWEST_HELD, math.ceil(_LEAST_S * rate))]
    return float(first.mean()) if np.std(first) < _HELD * np.std(u) else None


def _held_runs(record: Record, used: Mask) -> list[InputRun]:
    """Return the runs of slow tests that all start at rest, from that input on and followed by as many zeros.

    Empty if one does not, if the input is noise, or if samples of it were lost.
    """
    whole = finite_runs(np.isfinite(record.input))
    starts = [_held_start(record.input[first:end], record.sample_rate_hz) for first, end in whole]
    if None in starts or len(whole) != 1 + len(record.joints):
        return []
    if not all(is_slow(record.input[first:end]) for first, end in whole):
        return []
    runs, _y = input_runs(record, used, 0.0, 0.0)
    held_runs = []
    for run in runs:
        size = run.local.stop if isinstance(run.local, slice) else int(run.local[-1]) + 1
        values = fft.irfft(run.spectrum, run.length)[:size]
        length = fft.next_fast_len(2 * size, real=True)
        start = _held_start(values, record.sample_rate_hz) or 0.0
        held_runs.append(replace(run, spectrum=fft.rfft(values - start, length), length=length))
    return held_runs


@dataclass(frozen=True, eq=False)
class _Problem(ErrorProblem):
    """Squared error of the free run of a structure; ``y`` (m,) is the output about its mean.

    ``held`` marks runs that start at rest, such as a ramp and hold: each has an offset as its only nuisance, and no
    parallel damping, which noise of the input would bias, as a damper smooths it. Other runs have an unknown initial
    state and a straight line of drift.
    """

    structure: Structure
    runs: list[InputRun]
    y: Array
    rate: float
    hold: Hold
    held: bool

    @property
    def damped(self) -> bool:
        """Whether the parallel damping is fitted."""
        return not self.held or self.structure == "kelvin-voigt"

    def point(self, theta: Array) -> ErrorPoint:
        """Evaluate logarithms of the values, with offset, initial states and drift projected out."""
        system = Viscoelastic(self.structure, tuple(np.exp(theta)))
        poles = system.poles
        rows = np.empty((theta.size + 1, self.y.size))
        offset = np.ones(self.y.size)
        for run in self.runs:
            h, slopes = system.sampled(fft.rfftfreq(run.length, 1.0 / self.rate), self.rate, self.hold)
            here = rows[:, run.fitted]
            for row, transfer in enumerate((h, *slopes)):
                here[row] = fft.irfft(transfer * run.spectrum, run.length)[run.local]
            here[0] = self.y[run.fitted] - here[0]
            t = run.time_s
            free = [np.ones(t.size)]
            if self.held and system.creeps:
                creep = system.creep_rate * float(run.spectrum[0].real) / run.length
                here[0] -= creep * t
                for k, damper in ((1, system.values[1]), (3, system.values[3])):
                    here[k + 1] -= creep * system.creep_rate * damper * t
            if not self.held:
                free.append(t)
            unknown = (poles.imag >= 0.0) & (poles.real > -_FASTEST * self.rate) & (not self.held)
            for pole in poles[unknown]:
                decay = np.exp(np.clip(pole.real * t, -700.0, 0.0))
                free.append(decay * np.cos(pole.imag * t))
                free.append(decay * np.sin(pole.imag * t) if pole.imag > 0.0 else decay * pole.real * t)
            q, _ = np.linalg.qr(np.column_stack(free))
            here -= (here @ q) @ q.T
            offset[run.fitted] -= q @ (q.T @ offset[run.fitted])
        energy = float(offset @ offset)
        if energy > 1e-9 * self.y.size:
            rows -= np.outer(rows @ offset / energy, offset)
        if not self.damped:
            rows[1 + _DAMPING] = 0.0
        return ErrorPoint(theta, rows[0], rows[1:].T, float(rows[0] @ rows[0]))

    def attempt(self, at: ErrorPoint, step: Array) -> ErrorPoint | None:
        theta = at.theta + step
        return self.point(theta) if np.all(np.abs(theta) < 60.0) else None


@dataclass(frozen=True, eq=False)
class _Fitted:
    """A fitted structure: logarithms of its values, their covariance (None if the fit failed) and its errors (m,)."""

    system: Viscoelastic
    covariance: Array | None
    error: Array
    damped: bool

    def criterion(self, samples: float) -> float:
        """Return AICc for a number of independent samples (Eq. 3.16)."""
        k = len(self.system.values) + int(self.damped)
        loss = float(np.mean(self.error**2))
        return samples * math.log(loss) + 2.0 * k + 2.0 * k * (k + 1) / max(1.0, samples - k - 1)


def _starts(structure: Structure, linear: SecondOrderFit, damping: float) -> list[tuple[float, ...]]:
    """Return starting values around a second-order system, over a grid of relaxation times and stiffness ratios."""
    m, b, k = linear.system.mass, linear.system.damping, linear.system.stiffness
    if structure == "kelvin-voigt":
        return [(m, b, k)]
    starts: list[tuple[float, ...]] = []
    for time in _START_TIMES_S:
        if structure == "maxwell":
            starts.append((m, damping * b, k, k * time))
            continue
        for share in _START_SHARES:
            if structure == "standard-linear-solid":
                starts.append((m, damping * b, k, share * k, share * k * time))
            else:
                starts.append((m, damping * b, k, 100.0 * k * time, share * k, share * k * time))
    return starts


def _fit(problem: _Problem, linear: SecondOrderFit) -> _Fitted:
    """Fit one structure from the best of its starting points."""
    damping = _START_DAMPING if problem.damped else _NO_DAMPING
    values = _starts(problem.structure, linear, damping)
    if problem.held:  # a mass that moves at once: that of a second-order fit stands for the relaxation
        values = [(linear.system.stiffness / (math.pi * problem.rate) ** 2, *others) for _mass, *others in values]
    points = [problem.point(np.log(start)) for start in values]
    points = sorted((p for p in points if math.isfinite(p.cost)), key=lambda p: p.cost)[:_STARTS]
    ends = [
        minimise(
            problem,
            start,
            most_steps=_ITERATIONS,
            tolerance=_GAIN_TOLERANCE,
            idle_steps=2,
            bounds=Bounds.of_steps(np.ones(start.theta.size)),
        )
        for start in points
    ]
    best = min(ends, key=lambda end: end.point.cost).point
    system = Viscoelastic(problem.structure, tuple(float(v) for v in np.exp(best.theta)))
    block = dependence_samples(best.error, problem.rate)
    if problem.held and block > 1:  # slow dynamics are alike over much of a ramp and hold
        block = best.error.size // _BLOCKS
    covariance = sandwich(best.slopes, best.error, block)
    return _Fitted(system, covariance, best.error, problem.damped)


def _smallest(scores: Mapping[Structure, float]) -> Structure:
    """Return the structure with the fewest elements whose AICc is within 4 of the lowest."""
    close = [name for name in scores if scores[name] <= min(scores.values()) + _CLEAR]
    return min(close, key=lambda name: (len(ELEMENTS[name]), scores[name]))


def _criterion_name(structure: Structure) -> str:
    return f"aicc_{structure.replace('-', '_')}"


def independent_samples(error: Array) -> float:
    """Return the effective number of independent squared errors (m,) by their autocorrelation (Bartlett 1935).

    The autocorrelation is summed up to its first negative value (Geyer 1992).
    """
    correlation = Correlator(error - error.mean(), max(2, error.size // 8)).auto()
    related = (correlation[1:] / correlation[0]) ** 2
    end = int(np.argmax(correlation[1:] < 0.0)) if np.any(correlation[1:] < 0.0) else related.size
    return error.size / (1.0 + 2.0 * float(related[:end].sum()))


def _modulus(model: ViscoelasticModel) -> tuple[FittedCurve, ...]:
    """Return the dynamic stiffness of the tissue, without the mass, against frequency."""
    frequency = np.geomspace(0.2, 200.0, 120)
    system = model.system
    h, _ = system.response(frequency)
    z = 1.0 / h + system.values[0] * (2.0 * np.pi * frequency) ** 2
    return (
        FittedCurve(frequency, z.real, marked("in phase with the displacement")),
        FittedCurve(frequency, z.imag, marked("in phase with the speed")),
    )


@engine
class ViscoelasticEngine(Engine):
    """Viscoelastic engine.

    Assumes a linear tissue under a mass. A relaxation that is slower than the record, or faster than the driven band,
    is not determined: such values have no standard deviation. Of a slow ramp, it also gives the slope of force against
    position, for loading and unloading.
    """

    name: ClassVar[str] = "viscoelastic"
    label: ClassVar[str] = marked("Viscoelastic")
    title: ClassVar[str] = marked(
        "Springs and dampers with relaxation times: Kelvin-Voigt, Maxwell, standard linear solid or Burger (Chen 2010, "
        "2.1)."
    )
    family: ClassVar[Family] = Family.LINEAR
    figures: ClassVar[tuple[LineFigure, ...]] = (
        LineFigure(
            key="dynamic-stiffness",
            heading=marked("Dynamic stiffness of the tissue"),
            alt=marked("Stiffness in phase with displacement and with speed, against frequency"),
            caption=marked("The fitted tissue without the moving mass. A step in the first curve is a relaxation."),
            x_label=marked("Frequency (Hz)"),
            y_label=marked("Dynamic stiffness (N/m)"),
            curves=_modulus,
        ),
    )

    structure: Choice = option(
        "auto",
        marked("Structure"),
        marked(
            "Arrangement of springs and dampers (Fig. 2.1); auto takes the smallest one whose AICc is within 4 "
            "of the lowest"
        ),
    )
    hold: Hold = option("band-limited", HOLD_TITLE, HOLD_DESCRIPTION)

    def common(self, details: Sequence[Mapping[str, float]]) -> Self:
        """Return the specification with the structure whose mean AICc over tests is lowest, chosen as for one test."""
        complete = [detail for detail in details if all(_criterion_name(name) in detail for name in STRUCTURES)]
        if self.structure != "auto" or not complete:
            return self
        scores = {name: float(np.mean([detail[_criterion_name(name)] for detail in complete])) for name in STRUCTURES}
        return self.model_copy(update={"structure": _smallest(scores)})

    def fit(self, record: Record, fit_part: slice | None = None) -> ViscoelasticModel:
        """Fit one structure, or all and take the smallest one whose AICc is within 4 of the lowest.

        AICc counts the effective number of independent residuals of the best structure, as neighbouring residuals of
        tissue are similar; with the number of samples it would always prefer the largest structure.

        Raises:
            UnusableInputError: nothing varies, too few samples, or no system responds to this input.
        """
        rate = record.sample_rate_hz
        prepared = prepare(record, fit_part, _LEAST_S, 8)
        used = prepared.used
        linear = fit_second_order(record, used, self.hold)
        runs, y = input_runs(record, used, float(np.mean(record.input[used])), float(np.mean(record.output[used])))
        tried = STRUCTURES if self.structure == "auto" else (self.structure,)
        held = _held_runs(record, used)
        fits = [
            _fit(_Problem(structure, held or runs, linear.sign * y, rate, self.hold, bool(held)), linear)
            for structure in tried
        ]
        samples = independent_samples(min(fits, key=lambda fit: float(fit.error @ fit.error)).error)
        scores = {fit.system.structure: fit.criterion(samples) for fit in fits}
        chosen = _smallest(scores)
        best = next(fit for fit in fits if fit.system.structure == chosen)
        memory = min(math.ceil(DECAYED * rate * best.system.slowest_s), max(1, round(_LONGEST_SHARE * used.sum())))
        model = ViscoelasticModel(
            report=self.unscored(int(used.sum()), len(best.system.values) + int(best.damped)),
            sample_rate_hz=rate,
            memory_samples=max(1, memory if not held else min(memory, math.ceil(_LEAST_S * rate))),
            system=best.system,
            sign=linear.sign,
            input_mean=prepared.input_mean,
            output_mean=prepared.output_mean,
            hold=self.hold,
            settling_samples=max(1, memory),
        )
        residuals = np.where(used, model.residuals(record), np.nan)
        scored = np.isfinite(residuals)
        if int(scored.sum()) < 2:
            raise UnusableInputError(NO_SAMPLE)
        model = replace(model, output_mean=model.output_mean + float(np.mean(residuals[scored])))
        residuals = np.where(used, model.residuals(record), np.nan)
        k = model.report.n_parameters
        fitted = replace(record, output=np.where(used, record.output, np.nan))
        parameters = _parameters(best, linear) | ramp_stiffness(fitted)
        return model.with_report(
            vaf_percent=vaf_percent(record.output[scored], record.output[scored] - residuals[scored]),
            aic=aic(residuals, k),
            aicc=aicc(residuals, k),
            parameters=parameters,
            warnings=(*prepared.warnings, *_warnings(parameters)),
            findings=_findings(best.system.structure, scores),
            details={_criterion_name(name): score for name, score in scores.items()} | {"independent_samples": samples},
            model=best.system.structure,
        )


def _parameters(best: _Fitted, linear: SecondOrderFit) -> dict[str, Estimate]:
    """Return the mass, the elements and the times, with standard deviations; the times alone without N and m."""
    names = (*PARALLEL, *ELEMENTS[best.system.structure])
    value = dict(zip(names, best.system.values, strict=True))

    def estimate(number: float, **powers: float) -> Estimate:
        slopes = np.array([powers.get(name, 0.0) for name in names])
        there = slopes != 0.0
        if best.covariance is None:
            return Estimate(number)
        variance = float(slopes[there] @ best.covariance[np.ix_(there, there)] @ slopes[there])
        determined = math.isfinite(variance) and 0.0 <= variance < _UNDETERMINED**2
        return Estimate(number, abs(number) * math.sqrt(variance) if determined else None)

    if not best.damped:
        del value["damping_n_s_per_m"]
    estimates = {name: estimate(linear.sign * number, **{name: 1.0}) for name, number in value.items()}
    if not best.damped and estimates["mass_kg"].std is None:  # a ramp and hold has no inertia
        del estimates["mass_kg"]
    if not linear.mechanical:
        estimates = {}
    times = {
        "relaxation_time_s": ("spring_1_n_per_m", "damper_1_n_s_per_m"),
        "retardation_time_s": ("spring_2_n_per_m", "damper_2_n_s_per_m"),
    }
    if best.system.structure == "kelvin-voigt":
        times = {"retardation_time_s": ("stiffness_n_per_m", "damping_n_s_per_m")}
    for label, (spring, damper) in times.items():
        if spring in value:
            estimates[label] = estimate(value[damper] / value[spring], **{damper: 1.0, spring: -1.0})
    return estimates


def _warnings(parameters: dict[str, Estimate]) -> tuple[str, ...]:
    unknown = [name for name, estimate in parameters.items() if estimate.std is None]
    if not unknown:
        return ()
    return (
        Message(
            "viscoelastic.undetermined",
            "this record does not determine {count} of {all} values: they have no standard deviation",
            count=len(unknown),
            all=len(parameters),
        ),
    )


def _findings(chosen: Structure, scores: dict[Structure, float]) -> tuple[str, ...]:
    if len(scores) == 1:
        return ()
    lead = scores["kelvin-voigt"] - scores[chosen]
    if chosen == "kelvin-voigt":
        return (
            Message("viscoelastic.no_relaxation", "no structure with relaxation is clearly better than Kelvin-Voigt"),
        )
    return (
        Message(
            "viscoelastic.relaxation",
            "the tissue relaxes: {structure} is better than Kelvin-Voigt by {lead:.0f} in AICc",
            structure=NAMES[chosen],
            lead=lead,
        ),
    )
