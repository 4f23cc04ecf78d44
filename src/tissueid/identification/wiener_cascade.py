"""Iteration of Hunter and Korenberg (1986): Chen 2010, Eqs. 3.18-3.25, and its feedback form for g that is not
monotone.

Korenberg and Hunter (1999) replace the inverse of g, if there is none, by the previous linear output plus a function of
the output error. Here the function is the slope of g: a gradient step of the squared error, whose kernel is estimated
from the input like any other. For a straight g it equals the inverse.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Mask
from tissueid.identification.impulse_response import (
    ROWS_AT_ONCE,
    Correlator,
    ImpulseResponses,
    convolve_at_rest,
    dependence_samples,
    long_run_covariance,
)
from tissueid.identification.preparation import finite_runs
from tissueid.identification.second_order import Hold
from tissueid.identification.second_order_fit import SecondOrderFit, fit_second_order
from tissueid.identification.static_nonlinearity import ExponentialCurve, Form, StaticNonlinearity, fit_nonlinearity
from tissueid.messages import Message
from tissueid.records import Estimate, Record

_FLAT = 1e-3
"""Slope of g, relative to its largest, below which an output does not determine z."""

_STRAIGHT_STD = 2.0
"""Significance threshold of C2, in standard deviations, for a curved nonlinearity."""


def fit_linear_stage(
    record: Record, used: Mask, z: Array, nonlinearity: StaticNonlinearity, hold: Hold
) -> SecondOrderFit:
    """Fit a second-order system to the linear stage by the error of the measured output.

    The output error is divided by the slope of g to give an error of z, and weighted by that slope, so that the fit
    minimises the error of the measured output to first order and its covariance is that of the measurement.
    """
    stage = replace(record, output=z, output_unit=record.input_unit)
    start = fit_second_order(stage, used, hold)
    slope = np.zeros(z.size)
    slope[used] = np.abs(nonlinearity.slope(z[used]))
    steep = slope > _FLAT * float(np.max(slope))
    carried = z.copy()
    carried[steep] += (record.output[steep] - nonlinearity(z[steep])) / nonlinearity.slope(z[steep])
    weights = np.where(steep, slope, 0.0) / float(np.mean(slope[used]))
    return fit_second_order(replace(stage, output=carried), used, hold, weights, start)


def wiener_parameters(
    nonlinearity: StaticNonlinearity,
    covariance: Array,
    stage: SecondOrderFit,
    mean_input: float,
    *,
    scaling: float,
    surface: float | None,
    c3: float,
    mechanical: bool,
) -> dict[str, Estimate]:
    """Return the named estimates of a cascade.

    ``scaled_mass_s2`` and ``scaled_damping_s`` are M/K and B/K of the linear stage times ``scaling``. Mass, damping and
    stiffness are those at the mean input (Eqs. 3.27-3.29); for signals other than N and m, a gain instead.

    Args:
        nonlinearity: g.
        covariance: of its coefficients, shape (p, p).
        stage: the second-order system of the linear stage.
        mean_input: input at which mass, damping and stiffness are reported.
        scaling: assigned stiffness of the linear stage.
        surface: known offset of g, or None.
        c3: known C3, if the offset is unknown.
        mechanical: the record is of N and m.
    """
    estimates: dict[str, Estimate] = {}
    if isinstance(nonlinearity, ExponentialCurve):
        in_m, per_n, in_n = ("_m", "_per_n", "_n") if mechanical else ("", "", "")
        for index, name in enumerate((f"c1{in_m}", f"c2{per_n}", f"c3{in_n}", f"offset{in_m}")):
            estimates[name] = derived(
                nonlinearity,
                covariance,
                lambda g, index=index: g.thesis_constants(surface, c3)[index],  # type: ignore[misc]
            )
    mass = stage.estimate(scaling * stage.system.mass / stage.system.stiffness, (1.0, 0.0, -1.0))
    damping = stage.estimate(scaling * stage.system.damping / stage.system.stiffness, (0.0, 1.0, -1.0))
    estimates |= {"scaled_mass_s2": mass, "scaled_damping_s": damping}
    here = np.array([mean_input])
    if mechanical:
        stiffness = derived(nonlinearity, covariance, lambda g: 1.0 / float(g.slope(here)[0]))
        estimates |= {
            "mass_kg": _product(mass, stiffness, 1.0 / scaling),
            "damping_n_s_per_m": _product(damping, stiffness, 1.0 / scaling),
            "stiffness_n_per_m": stiffness,
        }
    else:
        estimates["gain"] = derived(nonlinearity, covariance, lambda g: float(g.slope(here)[0]))
    return estimates | {name: stage.parameters[name] for name in ("natural_frequency_rad_per_s", "damping_ratio")}


def straightness_warning(nonlinearity: StaticNonlinearity, parameters: dict[str, Estimate]) -> list[str]:
    """Return a warning if the curvature of an exponential is not significant."""
    if not isinstance(nonlinearity, ExponentialCurve):
        return []
    bend = next(estimate for name, estimate in parameters.items() if name.startswith("c2"))
    if bend.std is not None and abs(bend.value) > _STRAIGHT_STD * bend.std:
        return []
    return [
        Message(
            "wiener.straight",
            "the nonlinearity is straight within its uncertainty: only the product of C1 and C2 is determined",
        )
    ]


def derived(
    nonlinearity: StaticNonlinearity, covariance: Array, figure: Callable[[StaticNonlinearity], float]
) -> Estimate:
    """Return a function of g with its standard deviation to first order; None for a deviation that is not finite."""
    value = figure(nonlinearity)
    slopes = np.zeros(nonlinearity.coefficients.size)
    for k, spread in enumerate(np.sqrt(np.maximum(np.diag(covariance), 0.0))):
        if spread > 0.0:
            step = np.zeros(slopes.size)
            step[k] = 0.01 * spread
            above = figure(nonlinearity.with_coefficients(nonlinearity.coefficients + step))
            below = figure(nonlinearity.with_coefficients(nonlinearity.coefficients - step))
            slopes[k] = (above - below) / (2.0 * step[k])
    variance = float(slopes @ covariance @ slopes)
    return Estimate(value, float(np.sqrt(variance)) if np.isfinite(variance) and variance > 0.0 else None)


def _product(first: Estimate, second: Estimate, factor: float) -> Estimate:
    """Return the product of two estimates with independent errors."""
    value = first.value * second.value * factor
    if first.std is None or second.std is None:
        return Estimate(value)
    relative = np.hypot(first.std / first.value, second.std / second.value)
    return Estimate(value, abs(value) * float(relative))


_STEPS = 10
_TOLERANCE = 1e-3
"""Relative decrease of the squared error below which the iteration ends."""

_STEP_TOLERANCE, _STEP_PRODUCTS = 1e-2, 20
_COVARIANCE_TOLERANCE, _COVARIANCE_PRODUCTS = 1e-6, 100


class _Slopes:
    """Derivatives J (m, lags) of the simulated output with respect to the kernel of a cascade, as products.

    A change of the kernel's sum can be compensated by g, so only changes that keep the sum are considered.
    """

    def __init__(self, stage: LinearStage, cascade: WienerCascade) -> None:
        z = stage.input_mean + stage.response(cascade.kernel)
        self.stage = stage
        self.by_g = cascade.nonlinearity.jacobian(z)  # (m, p)
        self.error = stage.y - cascade.nonlinearity(z)
        self._slope = cascade.nonlinearity.slope(z)

    def forward(self, kernel: Array) -> Array:
        """Return J kernel, shape (m,)."""
        return np.asarray(self._slope * self.stage.response(kernel - kernel.mean()))

    def backward(self, values: Array) -> Array:
        """Return J' values, shape (lags,), for values (m,)."""
        products = self.stage.products(self._slope * values)
        return np.asarray(products - products.mean())

    def solve(self, right: Array, project: Callable[[Array], Array], tolerance: float, products: int) -> Array:
        """Solve J' P J kernel = right for the kernel (lags,); ``project`` applies the projection P to a vector (m,).

        Preconditioned conjugate gradients with at most ``products`` products, ended when a product gains less than
        ``tolerance`` of the total gain, so that directions that are not excited are never entered.
        """
        kernel = np.zeros(self.stage.lags)
        residual = right
        conditioned = self._precondition(residual)
        direction = conditioned
        size = float(np.dot(residual, conditioned))
        gained = 0.0
        for _ in range(products):
            product = self.backward(project(self.forward(direction)))
            curvature = float(np.dot(direction, product))
            if curvature <= 0.0:
                break
            length = size / curvature
            kernel = kernel + length * direction
            gained += length * size
            if length * size <= tolerance * gained:
                break
            residual = residual - length * product
            conditioned = self._precondition(residual)
            before, size = size, float(np.dot(residual, conditioned))
            direction = conditioned + (size / before) * direction
        return kernel

    def _precondition(self, values: Array) -> Array:
        answer = self.stage.solve(values)
        return np.asarray(answer - answer.mean(), dtype=np.float64)


def refine(stage: LinearStage, cascade: WienerCascade) -> WienerCascade:
    """Minimise the simulation error over kernel and g together. The result is never worse than the start."""
    for _ in range(_STEPS):
        slopes = _Slopes(stage, cascade)
        q, _ = np.linalg.qr(slopes.by_g)  # (m, p)

        def off_g(values: Array, q: Array = q) -> Array:
            return np.asarray(values - q @ (values @ q))

        step = slopes.solve(slopes.backward(off_g(slopes.error)), off_g, _STEP_TOLERANCE, _STEP_PRODUCTS)
        better = None
        for share in (1.0, 0.5, 0.25, 0.125):
            kernel = cascade.kernel + share * step
            kernel = kernel / kernel.sum()
            z = stage.input_mean + stage.response(kernel)
            nonlinearity = cascade.nonlinearity.refit(z, stage.y)
            error = stage.y - nonlinearity(z)
            rss = float(np.dot(error, error))
            if rss < cascade.rss:
                better = WienerCascade(kernel, nonlinearity, rss)
                break
        if better is None:
            break
        gained = cascade.rss - better.rss
        cascade = better
        if gained <= _TOLERANCE * cascade.rss:
            break
    return cascade


def coefficient_covariance(stage: LinearStage, cascade: WienerCascade) -> Array:
    """Return the covariance (p, p) of the coefficients of g, for an unknown kernel and coloured residuals.

    The component of each coefficient's effect that the kernel can explain is projected out.
    """
    slopes = _Slopes(stage, cascade)
    own = np.empty_like(slopes.by_g)  # (m, p)
    for k, column in enumerate(slopes.by_g.T):
        share = slopes.solve(
            slopes.backward(column), lambda values: values, _COVARIANCE_TOLERANCE, _COVARIANCE_PRODUCTS
        )
        own[:, k] = column - slopes.forward(share)
    influence = own @ np.linalg.pinv(own.T @ own) * slopes.error[:, None]
    n, p = own.shape
    block = dependence_samples(slopes.error, stage.solved.prepared.record.sample_rate_hz)
    return np.asarray(long_run_covariance(influence, block) * n / max(1, n - stage.lags - p))


_SIGNIFICANT_STD = 3.0
"""Significance threshold of a kernel's sum, in standard deviations; a smaller sum is not used as a divisor."""

_FOLDED_PERCENT = 5.0
"""Share of the output, %, on branches of g that cannot be inverted, above which the feedback form is used."""

_LEADING_RATIO = 1.5
"""Minimum ratio of the leading eigenvalue of the second-order correlation to the next."""


@dataclass(frozen=True, eq=False)
class WienerCascade:
    """A Wiener cascade: a kernel (lags,) that sums to 1, and g. ``rss`` is over the fitted samples."""

    kernel: Array
    nonlinearity: StaticNonlinearity
    rss: float


@dataclass(frozen=True, eq=False)
class Pass:
    """One pass of the iteration.

    ``linear_vaf_percent`` scores the impulse response against the output that it was estimated from: the measured
    output in the first pass, the inverted one in later passes. ``nonlinear_vaf_percent`` scores the cascade against the
    measured output. ``clipped_percent`` of the output is outside the range of g and inverted to its end, or on a branch
    of g that is not monotone. ``feedback``: the next pass uses the feedback form.
    """

    cascade: WienerCascade
    linear_vaf_percent: float
    nonlinear_vaf_percent: float
    clipped_percent: float
    feedback: bool = False


def linear_output(kernel: Array, x: Array, input_mean: float) -> Array:
    """Return z, shape (n,): the mean input plus the response of the kernel to the rest x (n,), in the unit of the
    input.
    """
    return input_mean + convolve_at_rest(kernel, x)


class LinearStage:
    """Input of a cascade over its fitted stretch: one spectrum and one inverse for all kernels.

    ``x`` is the input of the stretch minus its mean, with zeros for missing samples; ``output`` (n,) the measured
    output of the whole record, ``y`` (m,) its fitted samples; ``lags`` the length of a kernel.
    """

    def __init__(self, solved: ImpulseResponses) -> None:
        prepared = solved.prepared
        self.solved = solved
        self.lags = prepared.memory_samples
        self.input_mean = prepared.input_mean
        self._stretch = slice(max(0, prepared.part.start - self.lags + 1), prepared.part.stop)
        x = solved.input[self._stretch]
        # The zeros for missing inputs affect no fitted output, because the memory of those is complete.
        self.x = np.where(np.isfinite(x), x, 0.0)
        self._correlator = Correlator(self.x, self.lags)
        used = prepared.used[self._stretch]
        runs = finite_runs(used)
        self.used: slice | NDArray[np.intp] = (
            slice(*(int(end) for end in runs[0])) if len(runs) == 1 else np.flatnonzero(used)
        )
        self.output = prepared.record.output
        self.y = self.fitted(self.output)

    def fitted(self, values: Array) -> Array:
        """Return the fitted samples (m,) of a signal (n,) of the whole record."""
        return values[self._stretch][self.used]

    def response(self, kernel: Array) -> Array:
        """Return the response of a kernel (lags,) at the fitted samples, (m,), at rest before the record."""
        return self._correlator.convolve(kernel)[self.used]

    def products(self, values: Array) -> Array:
        """Return sums of values (m,) times the inputs of each lag before them, (lags,): the adjoint of
        :meth:`response`.
        """
        scattered = np.zeros(self.x.size)
        scattered[self.used] = values
        return self._correlator.cross(scattered) * scattered.size

    def solve(self, right: Array) -> Array:
        """Return the solution h (lags,) of R h = right (lags,)."""
        return np.asarray(self.solved.inverse @ right)

    def kernel(self, target: Array) -> Array:
        """Return the impulse response per sample (lags,) for an output (n,) of the whole record."""
        return self.solve(self.solved.products(target))

    def inverted_output(self, nonlinearity: StaticNonlinearity) -> Array:
        """Return the measured output transformed by the inverse of g, (n,), as target of a kernel fit (Eqs. 3.21,
        3.25).
        """
        target = self.output.copy()
        target[self._stretch] = nonlinearity.inverse(self.output[self._stretch])
        return target

    def feedback_target(self, cascade: WienerCascade, share: float) -> Array:
        """Return the linear output of a cascade plus a share of the output error times the slope of g, (n,)."""
        linear = self._correlator.convolve(cascade.kernel)
        z = self.input_mean + linear[self.used]
        slope = cascade.nonlinearity.slope(z)
        linear[self.used] += share * slope * (self.y - cascade.nonlinearity(z)) / np.mean(slope**2)
        target = np.full(self.output.size, np.nan)
        target[self._stretch] = linear
        return target

    @cached_property
    def second_order_kernel_estimate(self) -> Array | None:
        """Kernel (lags,), up to its scale, of a system that is mostly even; None if no eigenvalue dominates.

        For a Gaussian input, the correlation of the output with pairs of inputs is twice the curvature of g times R h
        h' R: h is its leading eigenvector in the metric of R.
        """
        padded = np.concatenate([np.zeros(self.lags - 1), self.x])
        windows = np.lib.stride_tricks.sliding_window_view(padded, self.lags)
        linear = self.response(self.kernel(self.output))
        error = np.zeros(self.x.size)
        error[self.used] = self.y - linear - np.mean(self.y - linear)
        pairs = np.zeros((self.lags, self.lags))
        gram = np.zeros((self.lags, self.lags))
        weight = np.zeros(self.x.size)
        weight[self.used] = 1.0
        for first in range(0, self.x.size, ROWS_AT_ONCE):
            some = slice(first, first + ROWS_AT_ONCE)
            rows = windows[some][:, ::-1]
            pairs += rows.T @ (error[some, None] * rows)
            gram += rows.T @ (weight[some, None] * rows)
        gram += 1e-5 * np.trace(gram) / self.lags * np.eye(self.lags)
        values, vectors = linalg.eigh(pairs, gram)
        order = np.argsort(np.abs(values))
        if not np.abs(values[order[-1]]) > _LEADING_RATIO * np.abs(values[order[-2]]):
            return None
        return np.asarray(vectors[:, order[-1]])


def hunter_korenberg(stage: LinearStage, form: Form, degree: int, passes: int) -> list[Pass]:
    """Estimate impulse response and nonlinearity alternately; the response is fitted to the output inverted through g.

    The kernel is divided by its sum, the steady-state gain, so that z is an absolute load and g is the compliance. The
    result has fewer passes if the inverted output no longer depends on the input. If a polynomial is not monotone, the
    feedback form is used, and the iteration is also started from the second-order correlation, for systems with a weak
    linear part; the better of the two is returned.

    Raises:
        UnusableInputError: the first impulse response has no steady-state gain.
    """
    done = _iterate(stage, form, degree, passes, None)
    if (
        form == "polynomial"
        and (not done or any(iteration.feedback for iteration in done))
        and stage.second_order_kernel_estimate is not None
    ):
        other = _iterate(stage, form, degree, passes, stage.second_order_kernel_estimate)
        done = min(
            [way for way in (done, other) if way],
            key=lambda way: min(iteration.cascade.rss for iteration in way),
            default=[],
        )
    if not done:
        raise UnusableInputError(
            "wiener.no_gain", "the linear stage has no steady-state gain for its normalisation: use lms or spectral"
        )
    return done


def _variance(values: Array) -> float:
    mean = float(values.sum()) / values.size
    return max(0.0, float(np.dot(values, values)) / values.size - mean * mean)


def _iterate(stage: LinearStage, form: Form, degree: int, passes: int, first: Array | None) -> list[Pass]:
    """Run ``passes`` iterations from the impulse response to the measured output, or from a ``first`` kernel (lags,).

    With the inverse, z is scaled by the steady-state gain. With feedback, the sum of a kernel may be far from its final
    value before convergence; z then keeps the spread of the input, and a pass is only reported once its gain is
    significant.
    """
    ones = np.ones(stage.lags)
    gain_std = math.sqrt(max(0.0, float(ones @ stage.solve(ones))) / stage.y.size)  # for a residual of unit variance
    variance = _variance(stage.y)
    spread = math.sqrt(_variance(stage.x))
    target = stage.output
    nonlinearity: StaticNonlinearity | None = None
    best: WienerCascade | None = None
    feedback = first is not None
    share = 1.0
    done: list[Pass] = []
    for number in range(passes if first is None else passes + 1):  # a given kernel does not count as a pass
        begun = first if number == 0 else None
        kernel = stage.kernel(target) if begun is None else begun  # Eqs. 3.18, 3.22
        linear = stage.response(kernel)  # Eqs. 3.20, 3.24
        aimed_at = stage.fitted(target)
        missed = _variance(aimed_at - linear)
        gain = float(kernel.sum())
        certain = begun is None and abs(gain) > _SIGNIFICANT_STD * math.sqrt(missed) * gain_std
        scale = gain
        if feedback:
            scale = math.copysign(math.sqrt(_variance(linear)) / spread, gain)
        if scale == 0.0 or not (certain or feedback):
            break
        z = stage.input_mean + linear / scale
        if nonlinearity is None:
            nonlinearity = fit_nonlinearity(form, z, stage.y, degree)
        else:
            nonlinearity = nonlinearity.refit(z, stage.y)
        error = stage.y - nonlinearity(z)
        cascade = WienerCascade(kernel / scale, nonlinearity, float(np.dot(error, error)))
        low, high = nonlinearity.monotone_range
        folded = 0.0 if nonlinearity.invertible else 100.0 * float(np.mean((z < low) | (z > high)))
        inverted_output = stage.inverted_output(nonlinearity)
        reached = stage.fitted(inverted_output)
        clipped = np.count_nonzero((reached <= low) | (reached >= high)) / reached.size
        was_feedback, feedback = feedback, folded > _FOLDED_PERCENT
        if certain:
            done.append(
                Pass(
                    cascade=_normalised(stage, cascade) if was_feedback else cascade,
                    linear_vaf_percent=100.0 * (1.0 - missed / _variance(aimed_at)),
                    nonlinear_vaf_percent=100.0 * (1.0 - _variance(error) / variance),
                    clipped_percent=100.0 * clipped,
                    feedback=feedback,
                )
            )
        if best is None or cascade.rss < best.rss:
            best = cascade
        elif feedback:
            share *= 0.5  # the step was too long: repeat from the same point with a shorter one
        target = stage.feedback_target(best, share) if feedback else inverted_output
    return done


def cut_to_memory(longer: LinearStage, stage: LinearStage, cascade: WienerCascade) -> WienerCascade:
    """Return the cascade with its kernel cut from the lags of ``longer`` to those of ``stage``.

    Components in directions that the input does not excite, which the refinement does not determine, are removed first,
    because a cut through them would affect the excited band. The cut itself hardly changes z, so that g is kept.
    """
    kernel = longer.solved.without_unexcited(cascade.kernel)[: stage.lags]
    kernel = kernel / float(kernel.sum())
    z = stage.input_mean + stage.response(kernel)
    error = stage.y - cascade.nonlinearity(z)
    return WienerCascade(kernel, cascade.nonlinearity, float(np.dot(error, error)))


def _normalised(stage: LinearStage, cascade: WienerCascade) -> WienerCascade:
    """Return the same cascade with a kernel that sums to 1, and g refitted to the scaled z."""
    kernel = cascade.kernel / float(cascade.kernel.sum())
    return WienerCascade(
        kernel, cascade.nonlinearity.refit(stage.input_mean + stage.response(kernel), stage.y), cascade.rss
    )
