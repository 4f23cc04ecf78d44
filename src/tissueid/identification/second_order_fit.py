"""Mass, damping and stiffness from a record, with standard deviations valid for coloured residuals.

The thesis fits Eq. 3.6 to the estimated impulse response. The errors of that response are correlated and include edge
effects, so that its scatter does not give the uncertainty of the three parameters. Here such a fit only gives the
starting point. The simulation error over the record is then minimised (output-error method, Gauss-Newton) in the
frequency domain, where a band-limited input needs no discretisation. The offset and the initial state of every
uninterrupted run are nuisance parameters.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Mask
from tissueid.identification.impulse_response import Correlator, dependence_samples, long_run_covariance
from tissueid.identification.levenberg_marquardt import Bounds, ErrorPoint, ErrorProblem, Minimum, minimise
from tissueid.identification.preparation import finite_runs, part_length, scored_samples, typical_samples
from tissueid.identification.second_order import (
    HOLDS,
    Complex,
    Hold,
    SecondOrder,
    free_position,
    free_velocity,
    sampled_response,
)
from tissueid.identification.validation import vaf_percent
from tissueid.language import marked
from tissueid.messages import Listing, Message
from tissueid.records import Estimate, Record

_LARGEST_RELATIVE_STD = 0.5
"""Relative standard deviation above which a parameter is undetermined."""

_NEGLIGIBLE_SENSITIVITY = 1e-7
"""Effect on the output below which a parameter is undetermined, relative to the strongest."""

_ITERATIONS = 40
_GAIN_TOLERANCE = 1e-9
"""Relative decrease of the squared error below which the fit has converged: less than 0.01 standard deviations."""
_DAMPING = 1e-9
_STEPS, _STEPS_LATE = Bounds.of_steps(np.ones(3)), Bounds.of_steps(np.ones(4))
"""A step changes mass, damping and stiffness by at most a factor e, and a dead time by a sample."""
_WORTH_DEAD_TIME = 0.1
"""Share of the squared error that a dead time must be able to remove, to first order, to be fitted."""
_LEFT_BY_DEAD_TIME = 0.7
"""Largest share of the squared error that a dead time may leave: less can be the nonlinearity of tissue."""
_RELEVANT_GAIN = 1e-4
"""Least share of the output power that a dead time must explain."""
_LEAST_DEAD_TIME = 0.1
"""Shortest dead time, samples: less can be the integration of a simulated record."""
_DEAD_TIMES = (0, 1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)
"""Dead times, samples, of the starting points."""
_EXTENSION = 64
_CORRELATED_S = 0.25
"""Length of the correlations against which starting points are compared, s (``typical_samples``)."""

_HOLD_SAMPLES, _HOLD_LEAST_SAMPLES = 50_000, 500
"""Largest and smallest number of samples by which the hold is chosen."""
_ROUGH = 1.0
"""Mean squared change from sample to sample of an input, relative to its variance (white: 2), above which the hold
matters.
"""
_HOLD_GAIN = 50.0
"""Least gain in log likelihood by which an input counts as held."""

_FREE_RESPONSE_DECAY = 50.0
"""Time constants after which a free response is not evaluated any more: exp(-50) is 2e-22."""


@dataclass(frozen=True)
class SecondOrderFit:
    """A fitted second-order system.

    ``log_covariance`` (3, 3) is the covariance of log M, log B, log K; NaN for a parameter that the record does not
    determine, None if the fit did not converge. ``dead_time`` is that of the output (s), None unless the record shows
    one; the covariance then includes its uncertainty. ``sign`` is -1 if the output decreases with increasing input; the
    system then describes the negated output. ``vaf_percent`` is that of the free-run simulation on the fitted samples
    (the parametric VAF of the thesis).
    """

    system: SecondOrder
    sign: float
    log_covariance: Array | None
    vaf_percent: float
    mechanical: bool
    sample_rate_hz: float
    hold: Hold
    warnings: tuple[str, ...]
    dead_time: Estimate | None = None

    @property
    def left_out(self) -> tuple[str, ...]:
        """A warning for engines without a dead time, where the record shows one."""
        if self.dead_time is None:
            return ()
        return (
            Message(
                "second_order.dead_time_left_out",
                "the output is {milliseconds:.3g} ms late against the input, and this engine has no dead time: it "
                "appears as mass and damping; shift one channel, or use lms",
                milliseconds=1e3 * self.dead_time.value,
            ),
        )

    @property
    def parameters(self) -> dict[str, Estimate]:
        """Named estimates: mass, damping, stiffness for force (N) to position (m), else a gain."""
        system = self.system
        named = {
            "natural_frequency_rad_per_s": self.estimate(system.natural_frequency_rad_per_s, (-0.5, 0.0, 0.5)),
            "damping_ratio": self.estimate(system.damping_ratio, (-0.5, 1.0, -0.5)),
        }
        if self.dead_time is not None:
            named["dead_time_s"] = self.dead_time
        if not self.mechanical:
            return {"gain": self.estimate(self.sign / system.stiffness, (0.0, 0.0, -1.0))} | named
        return {
            "mass_kg": self.estimate(self.sign * system.mass, (1.0, 0.0, 0.0)),
            "damping_n_s_per_m": self.estimate(self.sign * system.damping, (0.0, 1.0, 0.0)),
            "stiffness_n_per_m": self.estimate(self.sign * system.stiffness, (0.0, 0.0, 1.0)),
        } | named

    @property
    def impulse_coefficients(self) -> dict[str, Estimate]:
        """A1, A2 and A3 of h(t) = A1 sin(A2 t) exp(A3 t) with h in output units per input unit and second (Eq. 3.6).

        Empty for an overdamped system, which has no such form.
        """
        decay, squared = self.system.decay_and_frequency
        coefficients = self.system.impulse_coefficients(1.0)
        if coefficients is None:
            return {}
        stiffness = self.system.stiffness / self.system.mass
        bend = (0.5 * (2.0 * decay**2 - stiffness) / squared, -(decay**2) / squared, 0.5 * stiffness / squared)
        unit = "_m_per_n_s" if self.mechanical else ""
        return {
            f"a1{unit}": self.estimate(self.sign * coefficients[0], (-1.0 - bend[0], -bend[1], -bend[2])),
            "a2_rad_per_s": self.estimate(coefficients[1], bend),
            "a3_per_s": self.estimate(coefficients[2], (-1.0, 1.0, 0.0)),
        }

    def behind_coil(self, resistance: Estimate, force_constant: Estimate) -> dict[str, Estimate]:
        """Return mass, damping and stiffness that a coil moves, for its voltage as the input (Chen 2010, C.2.3).

        A voltage V is a force V Bl / R, and the voltage that the motion induces a damping Bl^2 / R, which is
        subtracted. The inductance of the coil is neglected. A deviation that is not known makes that of all unknown.

        Args:
            resistance: R of the coil, ohm.
            force_constant: Bl of the coil, N/A.
        """
        r, bl = resistance.value, force_constant.value
        force_per_volt, induced = bl / r, bl**2 / r
        errors = [math.nan if error.std is None else error.std / error.value for error in (resistance, force_constant)]

        def value(row: int, volts: float, subtracted: float = 0.0) -> Estimate:
            variance = math.nan if self.log_covariance is None else float(self.log_covariance[row, row])
            quantity = force_per_volt * volts
            parts = (
                quantity * math.sqrt(variance),
                (quantity - subtracted) * errors[0],
                (quantity - 2 * subtracted) * errors[1],
            )
            std = math.hypot(*parts)
            return Estimate(self.sign * (quantity - subtracted), std if math.isfinite(std) else None)

        return {
            "mass_kg": value(0, self.system.mass),
            "damping_n_s_per_m": value(1, self.system.damping, induced),
            "stiffness_n_per_m": value(2, self.system.stiffness),
        }

    def estimate(self, value: float, log_slopes: tuple[float, float, float]) -> Estimate:
        """Return a positive function of M, B, K with its standard deviation, from its derivatives with respect to their
        logarithms.
        """
        if self.log_covariance is None:
            return Estimate(value)
        slopes = np.array(log_slopes)
        there = slopes != 0.0
        variance = float(slopes[there] @ self.log_covariance[np.ix_(there, there)] @ slopes[there])
        return Estimate(value, abs(value) * math.sqrt(variance) if math.isfinite(variance) else None)

    def simulate(self, u: Array) -> Array:
        """Return the response (n,) to a zero-mean input (n,) without NaN, at rest before the first sample."""
        late = 0.0 if self.dead_time is None else self.dead_time.value
        return self.sign * self.system.simulate(u, self.sample_rate_hz, self.hold, late)


def hold_of(record: Record, fit_part: slice | None) -> Hold:
    """Return the course of the input between samples that the record shows: band-limited unless a hold fits better.

    The two differ only for an input with power near the Nyquist frequency.

    Args:
        record: the data.
        fit_part: contiguous part of it; None for all.
    """
    if part_length(record, fit_part) < _HOLD_LEAST_SAMPLES:
        return "band-limited"
    used = scored_samples(record, typical_samples(_CORRELATED_S, record.sample_rate_hz), fit_part)
    used[np.flatnonzero(used)[_HOLD_SAMPLES:]] = False
    x = record.input[used]
    if x.size < _HOLD_LEAST_SAMPLES or float(np.mean(np.diff(x) ** 2)) <= _ROUGH * float(np.var(x)):
        return "band-limited"
    try:
        limited, held = (100.0 - fit_second_order(record, used, hold).vaf_percent for hold in HOLDS)
    except UnusableInputError:  # no second-order system responds to this input
        return "band-limited"
    return "zero-order" if x.size * math.log(max(limited, 1e-12) / max(held, 1e-12)) > _HOLD_GAIN else "band-limited"


@dataclass(frozen=True)
class InputRun:
    """An uninterrupted run of the input: its spectrum, and the indices of its fitted samples."""

    spectrum: Complex
    length: int
    local: slice | NDArray[np.intp]  # indices of the fitted samples within the run
    time_s: Array  # of the fitted samples, from the first one on
    fitted: slice  # their slice of all fitted samples


def fit_second_order(
    record: Record,
    used: Mask,
    hold: Hold = "band-limited",
    weights: Array | None = None,
    start: SecondOrderFit | None = None,
) -> SecondOrderFit:
    """Fit M, B, K to the samples of a mask by the output-error method, with their covariance.

    A dead time of the output, or of the input if negative, is fitted with them where it removes a good part of the
    error: a filter or a multiplexer in one channel, which would otherwise appear as mass.

    The covariance is the sandwich for a system that need not be of second order (White 1982), with autocorrelated
    residuals. It is therefore also valid if the residual is due to the nonlinearity of the tissue.

    Args:
        record: the data.
        used: mask (n,) of the outputs to fit; each input of their memory must have been received.
        hold: course of the input between samples. A measured force is band-limited; a command is held.
        weights: factors (n,) of the errors before they are squared; None for equal weights.
        start: starting point; None for the best of a grid against the correlations.

    Raises:
        UnusableInputError: no second-order system responds to this input.
    """
    rate = record.sample_rate_hz
    mean_u = float(np.mean(record.input[used]))
    mean_y = float(np.mean(record.output[used]))
    runs, y = input_runs(record, used, mean_u, mean_y)
    correlations = _Correlations.of(record, used, mean_u, mean_y)
    system, sign = correlations.start()[:2] if start is None else (start.system, start.sign)
    w = None if weights is None else weights[used]

    problem = _SimulationError(lambda trial: _evaluate(runs, sign * y, w, trial, rate, hold))

    def search(theta: list[float]) -> Minimum[ErrorPoint]:
        return minimise(
            problem,
            problem.point(np.array(theta)),
            most_steps=_ITERATIONS,
            tolerance=_GAIN_TOLERANCE,
            damping=_DAMPING,
            bounds=_STEPS if len(theta) == 3 else _STEPS_LATE,
        )

    minimum = search([math.log(system.mass), math.log(system.damping), math.log(system.stiffness)])
    late = problem.point(np.append(minimum.point.theta, 0.0))
    step = np.linalg.lstsq(late.slopes, late.error, rcond=1e-10)[0]  # which removes a share of the error to first order
    if float(late.error @ late.slopes @ step) / max(late.cost, 1e-300) > _WORTH_DEAD_TIME:
        other, other_sign, shift = correlations.start(_DEAD_TIMES)
        starts = [list(late.theta)]
        if other_sign == sign:
            starts.append([math.log(other.mass), math.log(other.damping), math.log(other.stiffness), float(shift)])
        with_dead_time = min((search(theta) for theta in starts), key=lambda trial: trial.point.cost)
        gained = minimum.point.cost - with_dead_time.point.cost
        power = float(y @ y) if w is None else float((w * y) @ (w * y))
        decisive = (
            with_dead_time.point.cost < _LEFT_BY_DEAD_TIME * minimum.point.cost and gained > _RELEVANT_GAIN * power
        )
        if decisive and abs(with_dead_time.point.theta[3]) > _LEAST_DEAD_TIME:
            minimum = with_dead_time
    mass, damping, stiffness = np.exp(minimum.point.theta[:3])
    fitted = SecondOrder(mass=float(mass), damping=float(damping), stiffness=float(stiffness))
    covariance = None
    if minimum.converged:
        error = minimum.point.error
        covariance = sandwich(minimum.point.slopes, error, dependence_samples(error, rate))
    dead_time = None
    if minimum.point.theta.size > 3:
        variance = math.nan if covariance is None else float(covariance[3, 3])
        std = math.sqrt(variance) / rate if math.isfinite(variance) else None
        dead_time = Estimate(float(minimum.point.theta[3]) / rate, std)
        covariance = None if covariance is None else covariance[:3, :3]
    warnings: list[str] = []
    if covariance is None:
        warnings.append(
            Message(
                "second_order.not_converged",
                "the second-order fit did not converge: mass, damping and stiffness have no uncertainty",
            )
        )
    else:
        determined = np.sqrt(np.diag(covariance)) < _LARGEST_RELATIVE_STD
        names = (marked("mass"), marked("damping"), marked("stiffness"))
        unknown = tuple(name for name, ok in zip(names, determined, strict=True) if not ok)
        if unknown:
            warnings.append(
                Message(
                    "second_order.undetermined",
                    "this record does not determine the second-order {names}",
                    names=Listing(unknown, marked(" and ")),
                )
            )
    if dead_time is not None:
        warnings.append(
            Message(
                "second_order.dead_time",
                "the output is {milliseconds:.3g} ms ({samples:.2g} samples) late against the input, as by a filter or "
                "a multiplexer in one channel: a dead time was fitted together with mass, damping and stiffness",
                milliseconds=1e3 * dead_time.value,
                samples=dead_time.value * rate,
            )
        )
    answer = SecondOrderFit(
        system=fitted,
        sign=sign,
        log_covariance=covariance,
        vaf_percent=math.nan,
        mechanical=(record.input_unit, record.output_unit) == ("N", "m"),
        sample_rate_hz=rate,
        hold=hold,
        warnings=tuple(warnings),
        dead_time=dead_time,
    )
    # From rest at the mean input; gaps contain no fitted samples.
    simulated = answer.simulate(np.where(np.isfinite(record.input), record.input - mean_u, 0.0))
    return replace(answer, vaf_percent=vaf_percent(record.output[used], simulated[used]))


class _SimulationError(ErrorProblem):
    """The squared error of the free run by log M, log B and log K, and by a dead time in samples if there is one."""

    def __init__(self, evaluate: Callable[[Array], tuple[Array, Array]]) -> None:
        self._evaluate = evaluate

    def point(self, theta: Array) -> ErrorPoint:
        """Evaluate logarithms of mass, damping and stiffness, and the dead time."""
        error, slopes = self._evaluate(theta)
        return ErrorPoint(theta, error, slopes, float(error @ error))

    def attempt(self, at: ErrorPoint, step: Array) -> ErrorPoint:
        return self.point(at.theta + step)


def sandwich(slopes: Array, error: Array, block: int) -> Array | None:
    """Return the covariance (p, p) of parameters with derivatives (m, p) of the errors (m,); NaN for one without
    effect, None on failure. The covariance is valid for autocorrelated errors.
    """
    size = np.linalg.norm(slopes, axis=0)
    effective = size > _NEGLIGIBLE_SENSITIVITY * np.max(size)
    if not effective.any():
        return None
    directions = slopes[:, effective] / size[effective]
    gram = directions.T @ directions
    if not np.all(np.isfinite(gram)) or np.linalg.cond(gram) > 1.0 / _NEGLIGIBLE_SENSITIVITY**2:
        return None
    influence = (directions @ np.linalg.inv(gram)) * error[:, None] / size[effective]
    n, p = influence.shape
    covariance = np.full((size.size, size.size), np.nan)
    covariance[np.ix_(effective, effective)] = long_run_covariance(influence, block) * n / (n - p)
    return covariance


def input_runs(record: Record, used: Mask, mean_u: float, mean_y: float) -> tuple[list[InputRun], Array]:
    """Cut the record into uninterrupted runs of input, each extended to a periodic signal by a smooth bridge.

    In the circular convolution, the bridge acts as input before the first sample. Its only effect is a free response,
    which is fitted.
    """
    runs = []
    done = 0
    for first, end in finite_runs(np.isfinite(record.input)):
        local = np.flatnonzero(used[first:end])
        if local.size == 0:
            continue
        values = record.input[first : first + local[-1] + 1] - mean_u
        length = fft.next_fast_len(values.size + _EXTENSION, real=True)
        blend = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, length - values.size + 1) / (length - values.size + 1))
        bridge = values[-1] + blend * (values[0] - values[-1])
        spectrum = fft.rfft(np.concatenate([values, bridge]))
        whole = local[-1] - local[0] + 1 == local.size
        runs.append(
            InputRun(
                spectrum,
                length,
                slice(int(local[0]), int(local[-1]) + 1) if whole else local,
                (local - local[0]) / record.sample_rate_hz,
                slice(done, done + local.size),
            )
        )
        done += local.size
    return runs, record.output[used] - mean_y


def _evaluate(
    runs: list[InputRun], y: Array, weights: Array | None, theta: Array, rate: float, hold: Hold
) -> tuple[Array, Array]:
    """Return the weighted error (m,) and its derivatives (m, p), with offset and free responses projected out."""
    mass, damping, stiffness = np.exp(theta[:3])
    system = SecondOrder(mass=float(mass), damping=float(damping), stiffness=float(stiffness))
    decay, squared = system.decay_and_frequency
    lasting_s = _free_response_s(system) if weights is None else math.inf
    count = 1 + theta.size
    rows = np.empty((count + 1, y.size))  # the error, its derivatives, and the offset
    rows[-1] = 1.0 if weights is None else weights
    for run in runs:
        response, slopes = sampled_response(system, run.length, rate, hold)
        here = rows[:, run.fitted]
        driven = run.spectrum
        answers = [response, *slopes]
        if theta.size > 3:
            turn = -2j * np.pi * np.arange(response.size) / run.length  # of the phase for each sample of dead time
            driven = driven * np.exp(theta[3] * turn)
            answers.append(response * turn)
        for row, answer in enumerate(answers):
            answer *= driven
            here[row] = fft.irfft(answer, run.length, overwrite_x=True)[run.local]
        np.subtract(y[run.fitted], here[0], out=here[0])
        t = run.time_s[: int(np.searchsorted(run.time_s, lasting_s))]
        free = np.column_stack(
            [free_position(t, decay, squared), free_velocity(t, decay, squared) * system.natural_frequency_rad_per_s]
        )
        if weights is not None:
            here[:-1] *= weights[run.fitted]
            free *= weights[run.fitted, None]
        q, _ = np.linalg.qr(free)  # a free response affects its own run only
        start = here[:, : t.size]
        start -= (start @ q) @ q.T
    offset = rows[-1]
    energy = float(offset @ offset)
    if energy > _NEGLIGIBLE_SENSITIVITY**2 * (y.size if weights is None else float(weights @ weights)):
        for row in rows[:-1]:
            row -= float(offset @ row) / energy * offset
    return rows[0], rows[1:count].T


def _free_response_s(system: SecondOrder) -> float:
    """Return the time (s) after which a free response is less than a rounding error of its start."""
    decay, squared = system.decay_and_frequency
    slowest = decay if squared >= 0.0 else system.stiffness / system.mass / (decay + math.sqrt(-squared))
    return _FREE_RESPONSE_DECAY / slowest if slowest > 0.0 else math.inf


@dataclass(frozen=True, eq=False)
class _Correlations:
    """Correlations (lags,) of the longest run of input with itself and with the output."""

    auto: Array
    cross: Array
    sample_rate_hz: float

    @classmethod
    def of(cls, record: Record, used: Mask, mean_u: float, mean_y: float) -> _Correlations:
        edges = finite_runs(np.isfinite(record.input))
        first, end = max(edges, key=lambda run: int(np.count_nonzero(used[run[0] : run[1]])))
        lags = int(min(end - first, typical_samples(_CORRELATED_S, record.sample_rate_hz)))
        correlator = Correlator(record.input[first:end] - mean_u, lags)
        answer = np.where(used, record.output - mean_y, 0.0)[first:end]
        return cls(correlator.auto(), correlator.cross(answer), record.sample_rate_hz)

    def start(self, dead_times: tuple[int, ...] = (0,)) -> tuple[SecondOrder, float, int]:
        """Return the best of a grid of systems and dead times (samples), its sign, and its dead time.

        The criterion is the output that a system explains at its best gain: the fit of Eq. 3.6 to the impulse response
        in the metric of that response's covariance. The grid avoids local minima.

        Raises:
            UnusableInputError: the output does not respond to the input.
        """
        lags = self.auto.size
        systems, kernels, products = _grid(lags, self.sample_rate_hz)
        energy = np.einsum("ij,j->i", products, self.auto)  # (systems,)
        shifts = [late for late in dead_times if late < lags]
        explained = np.array([kernels[:, : lags - late] @ self.cross[late:] for late in shifts])  # (shifts, systems)
        merit = np.where(energy > 0.0, explained**2 / np.maximum(energy, 1e-300), -1.0)
        shift, best = np.unravel_index(int(np.argmax(merit)), merit.shape)
        gain = explained[shift, best] / energy[best] if energy[best] > 0.0 else 0.0
        if gain == 0.0 or not np.isfinite(gain):
            raise UnusableInputError(
                "second_order.no_response",
                "the output does not respond to the input: no second-order system can be fitted",
            )
        unit, scale = systems[int(best)], 1.0 / abs(float(gain))
        system = SecondOrder(unit.mass * scale, unit.damping * scale, unit.stiffness * scale)
        return system, float(np.sign(gain)), shifts[int(shift)]


@lru_cache(maxsize=8)
def _grid(lags: int, rate: float) -> tuple[list[SecondOrder], Array, Array]:
    """Return systems of unit stiffness over natural frequency and damping ratio, with their kernels h (systems, lags).

    The last array (systems, lags) is the autocorrelation of each kernel; its product with the correlation of the input
    is h' R h.
    """
    t = np.arange(lags) / rate
    systems = [
        SecondOrder(mass=1.0 / w**2, damping=2.0 * zeta / w, stiffness=1.0)
        for w in 2.0 * np.pi * np.geomspace(2.0 * rate / lags / 4.0, rate / 8.0, 16)
        for zeta in (0.05, 0.15, 0.35, 0.6, 0.9, 1.4, 2.5, 5.0)
    ]
    kernels = np.array([system.impulse_response(t) / rate for system in systems])
    length = fft.next_fast_len(2 * lags, real=True)
    products = fft.irfft(np.abs(fft.rfft(kernels, length)) ** 2, length)[:, :lags]
    products[:, 1:] *= 2.0
    return systems, kernels, products
