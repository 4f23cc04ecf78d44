"""Iteration of Hunter and Korenberg (1986): Chen 2010, Eqs. 3.18-3.25, and its feedback form for g that is not
monotone.

Korenberg and Hunter (1999) replace the inverse of g, if there is none, by the previous linear output plus a function of
the output error. Here the function is the slope of g: a gradient step of the squared error, whose kernel is estimated
from the input like any other. For a straight g it equals the inverse.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array
from tissueid.identification.correlation import ROWS_AT_ONCE, Correlator, convolve_at_rest
from tissueid.identification.impulse_response import ImpulseResponses
from tissueid.identification.preparation import finite_runs
from tissueid.identification.static_nonlinearity import Form, StaticNonlinearity, fit_nonlinearity

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
        and (not done or any(one.feedback for one in done))
        and stage.second_order_kernel_estimate is not None
    ):
        other = _iterate(stage, form, degree, passes, stage.second_order_kernel_estimate)
        done = min([way for way in (done, other) if way], key=_best_rss, default=[])
    if not done:
        raise UnusableInputError(
            "wiener.no_gain", "the linear stage has no steady-state gain for its normalisation: use lms or spectral"
        )
    return done


def _variance(values: Array) -> float:
    mean = float(values.sum()) / values.size
    return max(0.0, float(np.dot(values, values)) / values.size - mean * mean)


def _best_rss(passes: list[Pass]) -> float:
    return min(one.cascade.rss for one in passes)


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
