"""The iteration of Hunter and Korenberg (1986): Chen 2010, Eqs. 3.18-3.25."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array
from tissueid.identification.correlation import convolve_at_rest
from tissueid.identification.impulse_response import ImpulseResponses
from tissueid.identification.static_nonlinearity import Form, StaticNonlinearity, fit_nonlinearity
from tissueid.identification.validation import vaf_percent

_CERTAIN = 3.0
"""Standard deviations by which the sum of a kernel must differ from zero to be divided by."""


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
    ``clipped_percent`` of the output lies beyond what g reaches and is inverted to the end of its range.
    """

    cascade: Cascade
    linear_vaf_percent: float
    nonlinear_vaf_percent: float
    clipped_percent: float


def linear_output(kernel: Array, x: Array, input_mean: float) -> Array:
    """z, shape (n,): the mean input and what the kernel makes of the rest x (n,), in the input's unit."""
    return input_mean + convolve_at_rest(kernel, x)


def hunter_korenberg(solved: ImpulseResponses, form: Form, degree: int, passes: int) -> list[Pass]:
    """Estimate impulse response and nonlinearity in turn, the former to the output carried back through the latter.

    The kernel is divided by its sum, its steady-state gain, so that z is an absolute load and g carries the
    compliance. Fewer passes than asked for come back when the inverted output no longer answers the input.

    Raises:
        UnusableInputError: the first impulse response has no steady-state gain.
    """
    prepared = solved.prepared
    used = prepared.used
    y = prepared.record.output
    target = y
    ones = np.ones(prepared.memory_samples)
    gain_std = float(np.sqrt(max(0.0, ones @ solved.solve(ones)) / used.sum()))  # for a residual of one
    nonlinearity: StaticNonlinearity | None = None
    done: list[Pass] = []
    for _ in range(passes):
        kernel = solved.kernel(target)  # Eqs. 3.18, 3.22
        linear = convolve_at_rest(kernel, solved.input)  # Eqs. 3.20, 3.24
        gain = float(kernel.sum())
        if abs(gain) <= _CERTAIN * np.std((target - linear)[used]) * gain_std:
            break
        z = prepared.input_mean + linear / gain
        if nonlinearity is None:
            nonlinearity = fit_nonlinearity(form, z[used], y[used], degree)
        else:
            nonlinearity = nonlinearity.refit(z[used], y[used])
        modelled = nonlinearity(z[used])
        carried = nonlinearity.inverse(y)  # Eqs. 3.21, 3.25
        low, high = nonlinearity.monotone_range
        done.append(
            Pass(
                cascade=Cascade(kernel / gain, nonlinearity, float(np.sum((y[used] - modelled) ** 2))),
                linear_vaf_percent=vaf_percent(target[used], linear[used]),
                nonlinear_vaf_percent=vaf_percent(y[used], modelled),
                clipped_percent=100.0 * float(np.mean((carried[used] <= low) | (carried[used] >= high))),
            )
        )
        target = carried
    if not done:
        raise UnusableInputError("the linear stage has no steady-state gain to normalise it by: take lms or spectral")
    return done
