"""How large a stimulus about a load should be: between the noise of the force and the tissue's own bend.

A fit of mass, damping and stiffness is disturbed by two things. Noise of the measured force loses weight as the
stimulus grows. What the tissue does beyond the line gains: stiffness that grows with depth and damping that differs
between the way in and the way out answer with the square of the motion. Both are noise on the force, in effect, and
with the power P of the stimulus the variance of each parameter is n / P + d P. Between the two lies the best power,
which is what is designed here; the spectrum matters far less (docs/stimuli.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, optimize

from tissueid.errors import UnusableInputError
from tissueid.messages import Message
from tissueid.stimuli.base import Array

Complex = NDArray[np.complex128]

_BINS = 2048
_REACH = 4.0
"""Highest frequency of the design, in cut-offs: the square of the motion reaches to two, and must not alias."""

_LEAST, _MOST = 1e-100, 1e100
"""Variances beyond which they are no numbers to reckon with."""


@dataclass(frozen=True)
class LocalTissue:
    """Tissue about a load, moving part included: F = M y" + B y' + K y + K g y^2 / 2 + c y'^2 for small y.

    ``stiffness_growth_per_m`` is g, the growth of log K with depth; ``damping_turn_n_s2_per_m2`` is c, by which the
    damping of the way in exceeds that of the way out, for every m/s.
    """

    mass_kg: float
    damping_n_s_per_m: float
    stiffness_n_per_m: float
    stiffness_growth_per_m: float = 0.0
    damping_turn_n_s2_per_m2: float = 0.0


@dataclass(frozen=True, eq=False)
class DesignPrecision:
    """What a second of test makes of mass, damping and stiffness, in this order.

    ``noise`` (3,) and ``distortion`` (3,) are relative variances after 1 s under 1 N rms: the first falls as the
    power, the second grows with it.
    """

    noise: Array
    distortion: Array

    def std(self, rms_n: float, seconds: float) -> Array:
        """Relative standard deviations (3,) of a fit to ``seconds`` s under a force of ``rms_n`` N rms."""
        power = rms_n**2
        return np.asarray(np.sqrt((self.noise / power + self.distortion * power) / seconds), dtype=np.float64)

    @property
    def best_rms_n(self) -> float:
        """The rms, N, at which the worst known of the three is known best; infinite for a tissue that does not bend."""
        if not np.all(self.distortion > _LEAST):
            return float("inf")
        each = 0.5 * np.log(self.noise / self.distortion)  # log of the best power of each parameter
        if np.ptp(each) < 1e-9:
            return float(np.exp(0.5 * each[0]))
        found = optimize.minimize_scalar(
            lambda log_power: float(np.max(self.std(np.exp(0.5 * log_power), 1.0))),
            bounds=(float(each.min()), float(each.max())),
            method="bounded",
        )
        return float(np.exp(0.5 * found.x))


def predicted_precision(tissue: LocalTissue, cutoff_hz: float, force_noise_n_per_root_hz: float) -> DesignPrecision:
    """How well a fit by output error will know the tissue, for noise that is flat up to a cut-off.

    The covariance of an unweighted least-squares fit under a residual that is not white, by its spectrum:
    J^-1 V J^-1 with J the energy of the output's slopes and V that of the slopes in the residual. The square of a
    Gaussian motion has twice its squared correlation and none with the motion itself (Isserlis 1918).

    Args:
        tissue: about the load.
        cutoff_hz: where the flat spectrum of the force ends.
        force_noise_n_per_root_hz: one-sided density of the noise of the measured force.

    Raises:
        UnusableInputError: the numbers are so far apart that nothing can be predicted.
    """
    with np.errstate(all="ignore"):
        predicted = _predicted(tissue, cutoff_hz, force_noise_n_per_root_hz)
    if not (np.all((predicted.noise > _LEAST) & (predicted.noise < _MOST)) and np.all(predicted.distortion < _MOST)):
        raise UnusableInputError(
            Message(
                "design.unanswerable",
                "no test can be designed for a tissue of {mass_kg:g} kg, {damping_n_s_per_m:g} N·s/m and "
                "{stiffness_n_per_m:g} N/m with {force_noise_n_per_root_hz:g} N of noise per root Hz and "
                "a cut-off of {cutoff_hz:g} Hz: it would answer to none, or to one of the three alone",
                mass_kg=tissue.mass_kg,
                damping_n_s_per_m=tissue.damping_n_s_per_m,
                stiffness_n_per_m=tissue.stiffness_n_per_m,
                force_noise_n_per_root_hz=force_noise_n_per_root_hz,
                cutoff_hz=cutoff_hz,
            )
        )
    return predicted


def _predicted(tissue: LocalTissue, cutoff_hz: float, force_noise_n_per_root_hz: float) -> DesignPrecision:
    step = _REACH * cutoff_hz / _BINS
    frequency = step * np.arange(_BINS + 1)
    s: Complex = np.asarray(2j * np.pi * frequency, dtype=np.complex128)
    m, b, k = tissue.mass_kg, tissue.damping_n_s_per_m, tissue.stiffness_n_per_m
    response: Complex = np.asarray(1.0 / (m * s**2 + b * s + k), dtype=np.complex128)
    force = np.where((frequency > 0.0) & (frequency <= cutoff_hz), 1.0 / cutoff_hz, 0.0)  # N^2 / Hz, 1 N rms in all
    slopes = -(response**2) * np.stack([m * s**2, b * s, np.full(s.size, k)])  # (3, bins), by log M, log B, log K
    noise = np.full(s.size, force_noise_n_per_root_hz**2)
    bend = _density(_square_correlation(tissue, response, s, force, step), step)

    energy = step * np.einsum("if,jf,f->ij", slopes, slopes.conj(), force).real
    try:
        inverse = np.linalg.inv(energy)
    except np.linalg.LinAlgError:
        inverse = np.full((3, 3), np.nan)

    def variances(residual: Array) -> Array:
        spread = np.einsum("if,jf,f->ij", slopes, slopes.conj(), force * np.abs(response) ** 2 * residual).real
        return np.asarray(np.diag(inverse @ (0.5 * step * spread) @ inverse), dtype=np.float64)

    return DesignPrecision(noise=variances(noise), distortion=variances(bend))


def _square_correlation(tissue: LocalTissue, response: Complex, s: Complex, force: Array, step: float) -> Array:
    """Autocorrelation (2 * _BINS,) of K g y^2 / 2 + c y'^2 about its mean, N^2, under a force of this density."""
    motion = np.abs(response) ** 2 * force  # m^2 / Hz
    depth = _correlation(motion, step)
    across = _correlation(s * motion, step)  # of the speed with the depth
    speed = _correlation(np.abs(s) ** 2 * motion, step)
    stiff = 0.5 * tissue.stiffness_n_per_m * tissue.stiffness_growth_per_m
    turn = tissue.damping_turn_n_s2_per_m2
    return np.asarray(
        2.0 * (stiff**2 * depth**2 + 2.0 * stiff * turn * across**2 + turn**2 * speed**2), dtype=np.float64
    )


def _correlation(density: Array | Complex, step: float) -> Array:
    """Correlation (2 * _BINS,) of a one-sided density (_BINS + 1,)."""
    return np.asarray(fft.irfft(density, 2 * _BINS) * _BINS * step, dtype=np.float64)


def _density(correlation: Array, step: float) -> Array:
    """One-sided density (_BINS + 1,) of a correlation (2 * _BINS,); rounding leaves nothing below zero."""
    return np.asarray(np.maximum(fft.rfft(correlation).real, 0.0) / (_BINS * step), dtype=np.float64)
