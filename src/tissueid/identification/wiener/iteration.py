"""The iteration of Hunter and Korenberg (1986): Chen 2010, Eqs. 3.18-3.25, and its feedback form for g that turns back.

Korenberg and Hunter (1999) replace the inverse of g, where there is none, by the old linear output plus a function of
the error of the output. Here the function is the slope of g: a step down the squared error, whose kernel is estimated
from the input as every other. Where g is straight that is the inverse itself.
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
from tissueid.identification.sample_masks import finite_runs
from tissueid.identification.static_nonlinearity import Form, StaticNonlinearity, fit_nonlinearity
from tissueid.messages import Message

_CERTAIN = 3.0
"""Threshold of the sum of a kernel as a divisor, in standard deviations from zero."""

_FOLDED_PERCENT = 5.0
"""Share of the output that may lie on a branch of g that cannot be inverted before the feedback form takes over."""

_LEADING = 1.5
"""Size of the leading eigenvalue of the second-order correlation in the next from which it is no chance."""


@dataclass(frozen=True, eq=False)
class Cascade:
    """A Wiener cascade: a kernel (lags,) that sums to one, and g. ``rss`` is over the fitted samples."""

    kernel: Array
    nonlinearity: StaticNonlinearity
    rss: float


@dataclass(frozen=True, eq=False)
class Pass:
    """One pass of the iteration.

    ``linear_vaf_percent`` is that of the impulse response against the output it was estimated from, the measured one
    at first and the inverted one after; ``nonlinear_vaf_percent`` that of the cascade against the measured output.
    ``clipped_percent`` of the output lies beyond what g reaches and is inverted to the end of its range, or answers
    to a branch of g that turns back. ``feedback`` says that the next pass does without the inverse.
    """

    cascade: Cascade
    linear_vaf_percent: float
    nonlinear_vaf_percent: float
    clipped_percent: float
    feedback: bool = False


def linear_output(kernel: Array, x: Array, input_mean: float) -> Array:
    """Return z, shape (n,): the mean input and what the kernel makes of the rest x (n,), in the input's unit."""
    return input_mean + convolve_at_rest(kernel, x)


class LinearStage:
    """The input of a cascade over its fitted stretch: one spectrum and one inverse for all kernels.

    ``x`` is the input of the stretch less its mean, zero where it is missing; ``output`` (n,) the measured one of the
    whole record, ``y`` (m,) its fitted samples; ``lags`` the length of a kernel.
    """

    def __init__(self, solved: ImpulseResponses) -> None:
        prepared = solved.prepared
        self.solved = solved
        self.lags = prepared.memory_samples
        self.input_mean = prepared.input_mean
        self._stretch = slice(max(0, prepared.part.start - self.lags + 1), prepared.part.stop)
        x = solved.input[self._stretch]
        # What stands in for missing inputs reaches no fitted output: the memory of those is complete.
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
        """Sums of values (m,) times the inputs of each lag before them, (lags,): the transpose of :meth:`response`."""
        scattered = np.zeros(self.x.size)
        scattered[self.used] = values
        return self._correlator.cross(scattered) * scattered.size

    def solve(self, right: Array) -> Array:
        """Return the solution h (lags,) of R h = right (lags,)."""
        return np.asarray(self.solved.inverse @ right)

    def kernel(self, target: Array) -> Array:
        """Return the impulse response per sample (lags,) to an output (n,) of the whole record."""
        return self.solve(self.solved.products(target))

    def inverted(self, nonlinearity: StaticNonlinearity) -> Array:
        """Return the measured output carried back through g, (n,), to fit a kernel to (Eqs. 3.21, 3.25)."""
        target = self.output.copy()
        target[self._stretch] = nonlinearity.inverse(self.output[self._stretch])
        return target

    def fed_back(self, cascade: Cascade, share: float) -> Array:
        """Return the linear output of a cascade and a share of the output error times the slope of g, (n,)."""
        linear = self._correlator.convolve(cascade.kernel)
        z = self.input_mean + linear[self.used]
        slope = cascade.nonlinearity.slope(z)
        linear[self.used] += share * slope * (self.y - cascade.nonlinearity(z)) / np.mean(slope**2)
        target = np.full(self.output.size, np.nan)
        target[self._stretch] = linear
        return target

    @cached_property
    def even_kernel(self) -> Array | None:
        """A kernel (lags,) up to its size, for a system whose output tells an input from its mirror image too little.

        The correlation of the output with pairs of inputs is, for a Gaussian input, twice the curvature of g times
        R h h' R: h leads its eigenvectors in the metric of R. None when no eigenvalue leads.
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
        if not np.abs(values[order[-1]]) > _LEADING * np.abs(values[order[-2]]):
            return None
        return np.asarray(vectors[:, order[-1]])


def hunter_korenberg(stage: LinearStage, form: Form, degree: int, passes: int) -> list[Pass]:
    """Estimate impulse response and nonlinearity in turn, the former to the output carried back through the latter.

    The kernel is divided by its sum, its steady-state gain, so that z is an absolute load and g carries the
    compliance. Fewer passes than asked for come back when the inverted output no longer answers the input. When a
    polynomial turns back, the feedback form takes over, and the iteration is also begun from the second-order
    correlation, which finds a system that has hardly a linear part; the better of the two comes back.

    Raises:
        UnusableInputError: the first impulse response has no steady-state gain.
    """
    done = _iterate(stage, form, degree, passes, None)
    if form == "polynomial" and (not done or any(one.feedback for one in done)) and stage.even_kernel is not None:
        other = _iterate(stage, form, degree, passes, stage.even_kernel)
        done = min([way for way in (done, other) if way], key=_best_rss, default=[])
    if not done:
        raise UnusableInputError(
            Message(
                "wiener.no_gain", "the linear stage has no steady-state gain for its normalisation: use lms or spectral"
            )
        )
    return done


def _variance(values: Array) -> float:
    mean = float(values.sum()) / values.size
    return max(0.0, float(np.dot(values, values)) / values.size - mean * mean)


def _best_rss(passes: list[Pass]) -> float:
    return min(one.cascade.rss for one in passes)


def _iterate(stage: LinearStage, form: Form, degree: int, passes: int, first: Array | None) -> list[Pass]:
    """Run ``passes`` iterations from the impulse response to the measured output, or from a ``first`` kernel (lags,).

    As long as the inverse is taken, z is scaled by the steady-state gain. A kernel on its way by feedback may have a
    sum that is far from what it will be, so there z keeps the spread of the input, and a pass is only reported once its
    gain is certain.
    """
    ones = np.ones(stage.lags)
    gain_std = math.sqrt(max(0.0, float(ones @ stage.solve(ones))) / stage.y.size)  # for a residual of one
    variance = _variance(stage.y)
    spread = math.sqrt(_variance(stage.x))
    target = stage.output
    nonlinearity: StaticNonlinearity | None = None
    best: Cascade | None = None
    feedback = first is not None
    share = 1.0
    done: list[Pass] = []
    for number in range(passes if first is None else passes + 1):  # a kernel that was given is no pass
        begun = first if number == 0 else None
        kernel = stage.kernel(target) if begun is None else begun  # Eqs. 3.18, 3.22
        linear = stage.response(kernel)  # Eqs. 3.20, 3.24
        aimed_at = stage.fitted(target)
        missed = _variance(aimed_at - linear)
        gain = float(kernel.sum())
        certain = begun is None and abs(gain) > _CERTAIN * math.sqrt(missed) * gain_std
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
        cascade = Cascade(kernel / scale, nonlinearity, float(np.dot(error, error)))
        low, high = nonlinearity.monotone_range
        folded = 0.0 if nonlinearity.invertible else 100.0 * float(np.mean((z < low) | (z > high)))
        inverted = stage.inverted(nonlinearity)
        reached = stage.fitted(inverted)
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
            share *= 0.5  # the step was too long: a shorter one from where it began
        target = stage.fed_back(best, share) if feedback else inverted
    return done


def shortened(longer: LinearStage, stage: LinearStage, cascade: Cascade) -> Cascade:
    """Return the cascade with as much of its kernel as ``stage`` has lags, of the more that ``longer`` has.

    What the kernel holds where the input has no power, which the refinement leaves to chance, goes first: a cut through
    it would excite what is in the band. What then goes with the cut hardly moves z, so g stays as it is.
    """
    kernel = longer.solved.without_unexcited(cascade.kernel)[: stage.lags]
    kernel = kernel / float(kernel.sum())
    z = stage.input_mean + stage.response(kernel)
    error = stage.y - cascade.nonlinearity(z)
    return Cascade(kernel, cascade.nonlinearity, float(np.dot(error, error)))


def _normalised(stage: LinearStage, cascade: Cascade) -> Cascade:
    """Return the same cascade with a kernel that sums to one; a polynomial knows no scale of z."""
    kernel = cascade.kernel / float(cascade.kernel.sum())
    return Cascade(kernel, cascade.nonlinearity.refit(stage.input_mean + stage.response(kernel), stage.y), cascade.rss)
