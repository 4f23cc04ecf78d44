"""Mechanical half of a sweep: force constant along the stroke, mass and damping, relative to the calibration spring.

M x'' + B x' + K (x - x_s) - m g = k(x) i holds in all tests with the same M, B and k(x); K is the stiffness of the
spring. Both sides are convolved with a smooth window, so that the window is differentiated instead of the recorded
position (modulating functions, Shinbrot 1957). The problem is linear in M, B, k(x) and an offset per test.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from tissueid.calibration.flux import FluxFit
from tissueid.calibration.spline_basis import Array, SplineBasis, solution_covariance, solve_least_squares
from tissueid.calibration.sweep_test import SweepTest
from tissueid.records import Estimate

WINDOW_S = 2.5e-3
"""Standard deviation of the window, s: it passes 60 Hz, three times the resonance of the spring."""
_REACH = 6.0
"""Half width of the window, in standard deviations."""


@dataclass(frozen=True, eq=False)
class BalanceFit:
    """Result of the force balance, for a spring of exactly the given stiffness.

    ``coefficients`` (p,) of the basis are the force constant, N/A, with ``covariance`` (p, p).
    """

    basis: SplineBasis
    coefficients: Array
    covariance: Array
    mass_kg: Estimate
    damping_n_s_per_m: Estimate
    residual_n: float


def fit_balance(tests: Sequence[SweepTest], flux: FluxFit, stiffness_n_per_m: float) -> BalanceFit:
    """Fit the balance to all tests, with the currents of the electrical half.

    The measured current is a noisy regressor; the modelled current of the electrical equation is its instrumental
    variable, so that the noise causes no bias.
    """
    basis, rate = flux.basis, tests[0].sample_rate_hz
    size, every = basis.size, max(1, round(WINDOW_S * rate))
    window, slope, bend, held = _windows(rate)
    rows: list[tuple[Array, Array, Array]] = []
    for test, read, modelled in zip(tests, flux.mean_currents, flux.modelled_currents, strict=True):
        about = test.position - np.nanmean(test.position)
        splines = basis.values(0.5 * (test.position + np.concatenate([[np.nan], test.position[:-1]])))
        motion = np.stack([-_convolved(about, bend), -_convolved(about, slope)], axis=1)
        design, clean = (
            np.concatenate([np.stack([_convolved(c, held) for c in (splines * i[:, None]).T], axis=1), motion], axis=1)
            for i in (read, modelled)
        )
        target = stiffness_n_per_m * _convolved(about, window)
        whole = np.isfinite(design).all(axis=1) & np.isfinite(target) & np.isfinite(clean).all(axis=1)
        part = np.flatnonzero(whole)[::every]
        # Remove means: rest position of the spring and weight are offsets of each test.
        rows.append(tuple(a[part] - a[part].mean(axis=0) for a in (design, clean, target)))
    design, clean, target = (np.concatenate(parts) for parts in zip(*rows, strict=True))
    scale = np.sqrt(np.mean(design**2, axis=0))
    scale[:size] = 1.0
    solution, inverse = solve_least_squares(design / scale, target, basis, clean / scale)
    residual = target - (design / scale) @ solution
    influence = (clean / scale) @ inverse * residual[:, None]
    covariance = solution_covariance(influence, residual, rate / every) / np.outer(scale, scale)
    solution, std = solution / scale, np.sqrt(np.diag(covariance))
    # A delay of the force by the error of L / R changes damping by K times, and mass by B times that error.
    std[size:] = np.hypot(std[size:], flux.lag.noise_s * np.array([abs(solution[size + 1]), stiffness_n_per_m]))
    return BalanceFit(
        basis=basis,
        coefficients=solution[:size],
        covariance=covariance[:size, :size],
        mass_kg=Estimate(float(solution[size]), float(std[size])),
        damping_n_s_per_m=Estimate(float(solution[size + 1]), float(std[size + 1])),
        residual_n=float(np.std(residual)),
    )


def _windows(rate: float) -> tuple[Array, Array, Array, Array]:
    """Return the window, its first two derivatives, and its mean over the interval before each sample."""
    reach = int(np.ceil(_REACH * WINDOW_S * rate))
    time = np.arange(-reach, reach + 1) / rate
    window = np.exp(-0.5 * (time / WINDOW_S) ** 2) / (np.sqrt(2.0 * np.pi) * WINDOW_S * rate)
    slope = -time / WINDOW_S**2 * window
    bend = ((time / WINDOW_S) ** 2 - 1.0) / WINDOW_S**2 * window
    # A force held over the interval before sample m acts at n with the window between n - m and one sample more.
    held = 0.5 * (
        special.erf((time + 1.0 / rate) / (np.sqrt(2.0) * WINDOW_S)) - special.erf(time / (np.sqrt(2.0) * WINDOW_S))
    )
    return window, slope, bend, np.asarray(held)


def _convolved(values: Array, window: Array) -> Array:
    """Return values (n,) convolved with the window, shape (n - window + 1,); NaN where a value is missing."""
    return np.convolve(values, window, mode="valid")
