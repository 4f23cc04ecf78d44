"""Noise about one load with the amplitude that gives the most precise mass, damping and stiffness from a short test.

Two errors limit such a fit. Sensor noise of the force matters less as the stimulus grows. Nonlinear distortion matters
more: depth-dependent stiffness and direction-dependent damping respond with the square of the motion. Both act as noise
of the force, so that with stimulus power P the variance of each parameter is n / P + d P. The design minimises it over
P; the spectrum matters far less (docs/stimuli.md).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from scipy import fft, optimize

from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.records import Estimate
from tissueid.stimuli.base import Array, OpenLoopKind, Stimulus, stimulus
from tissueid.stimuli.kinds.noise import Noise
from tissueid.stimuli.spectra import Butterworth

Complex = NDArray[np.complex128]

_BINS = 2048
"""Frequency bins of the design."""
_FREQUENCY_RANGE = 4.0
"""Highest frequency of the design relative to the cutoff: the squared motion extends to twice the cutoff and must not
alias.
"""

_MIN_VARIANCE, _MAX_VARIANCE = 1e-100, 1e100
"""Variances beyond which they are no numbers to reckon with."""


@dataclass(frozen=True)
class LocalTissue:
    """Parameters of the tissue about a load, including the moving mass: F = M y" + B y' + K y + K g y^2 / 2 + c y'^2.

    ``stiffness_growth_per_m`` is g, the derivative of log K with depth. ``damping_asymmetry_n_s2_per_m2`` is c, the
    asymmetry of the damping between indentation and retraction: force per squared velocity, N s^2/m^2.
    """

    mass_kg: float
    damping_n_s_per_m: float
    stiffness_n_per_m: float
    stiffness_growth_per_m: float = 0.0
    damping_asymmetry_n_s2_per_m2: float = 0.0


@dataclass(frozen=True, eq=False)
class DesignPrecision:
    """Predicted relative variances of mass, damping and stiffness, in this order, normalised to 1 s and 1 N RMS.

    ``noise`` (3,), the part from sensor noise, falls as 1 / power; ``distortion`` (3,), the part from nonlinearity,
    grows with the power.
    """

    noise: Array
    distortion: Array

    def std(self, rms_n: float, seconds: float) -> Array:
        """Return relative standard deviations (3,) of a fit to ``seconds`` s under a force of ``rms_n`` N RMS."""
        power = rms_n**2
        return np.asarray(np.sqrt((self.noise / power + self.distortion * power) / seconds), dtype=np.float64)

    @property
    def optimal_rms_n(self) -> float:
        """Force RMS, N, that minimises the largest of the three relative standard deviations; infinite for linear
        tissue.
        """
        if not np.all(self.distortion > _MIN_VARIANCE):
            return float("inf")
        each = 0.5 * np.log(self.noise / self.distortion)  # log of the best power of each parameter
        if np.ptp(each) < 1e-9:
            return float(np.exp(0.5 * each[0]))
        optimum = optimize.minimize_scalar(
            lambda log_power: float(np.max(self.std(np.exp(0.5 * log_power), 1.0))),
            bounds=(float(each.min()), float(each.max())),
            method="bounded",
        )
        return float(np.exp(0.5 * optimum.x))


def predicted_precision(tissue: LocalTissue, cutoff_hz: float, force_noise_n_per_root_hz: float) -> DesignPrecision:
    """Predict the precision of an output-error fit to a stimulus with a flat spectrum up to a cutoff.

    Covariance of an unweighted least-squares fit with a coloured residual: J^-1 V J^-1, with J the energy of the output
    sensitivities and V their energy weighted by the residual spectrum. The square of a Gaussian motion has twice its
    squared correlation and is uncorrelated with the motion itself (Isserlis 1918).

    Args:
        tissue: parameters about the load.
        cutoff_hz: upper end of the flat force spectrum, Hz.
        force_noise_n_per_root_hz: one-sided noise density of the measured force.

    Raises:
        UnusableInputError: the predicted variances are outside the range of valid numbers.
    """
    with np.errstate(all="ignore"):
        predicted = _predicted(tissue, cutoff_hz, force_noise_n_per_root_hz)
    if not (
        np.all((predicted.noise > _MIN_VARIANCE) & (predicted.noise < _MAX_VARIANCE))
        and np.all(predicted.distortion < _MAX_VARIANCE)
    ):
        raise UnusableInputError(
            "design.unanswerable",
            "no test can be designed for {mass_kg:g} kg, {damping_n_s_per_m:g} N·s/m and "
            "{stiffness_n_per_m:g} N/m with force noise of {force_noise_n_per_root_hz:g} N/√Hz and a "
            "cutoff of {cutoff_hz:g} Hz: the three cannot be separated; check these values",
            mass_kg=tissue.mass_kg,
            damping_n_s_per_m=tissue.damping_n_s_per_m,
            stiffness_n_per_m=tissue.stiffness_n_per_m,
            force_noise_n_per_root_hz=force_noise_n_per_root_hz,
            cutoff_hz=cutoff_hz,
        )
    return predicted


def _predicted(tissue: LocalTissue, cutoff_hz: float, force_noise_n_per_root_hz: float) -> DesignPrecision:
    step = _FREQUENCY_RANGE * cutoff_hz / _BINS
    frequency = step * np.arange(_BINS + 1)
    s: Complex = np.asarray(2j * np.pi * frequency, dtype=np.complex128)
    m, b, k = tissue.mass_kg, tissue.damping_n_s_per_m, tissue.stiffness_n_per_m
    response: Complex = np.asarray(1.0 / (m * s**2 + b * s + k), dtype=np.complex128)
    force = np.where((frequency > 0.0) & (frequency <= cutoff_hz), 1.0 / cutoff_hz, 0.0)  # N^2 / Hz, 1 N rms in all
    sensitivities = -(response**2) * np.stack(
        [m * s**2, b * s, np.full(s.size, k)]
    )  # (3, bins), by log M, log B, log K
    noise = np.full(s.size, force_noise_n_per_root_hz**2)
    distortion = _density(_square_correlation(tissue, response, s, force, step), step)

    energy = step * np.einsum("if,jf,f->ij", sensitivities, sensitivities.conj(), force).real
    try:
        inverse = np.linalg.inv(energy)
    except np.linalg.LinAlgError:
        inverse = np.full((3, 3), np.nan)

    def variances(residual: Array) -> Array:
        spread = np.einsum(
            "if,jf,f->ij", sensitivities, sensitivities.conj(), force * np.abs(response) ** 2 * residual
        ).real
        return np.asarray(np.diag(inverse @ (0.5 * step * spread) @ inverse), dtype=np.float64)

    return DesignPrecision(noise=variances(noise), distortion=variances(distortion))


def _square_correlation(tissue: LocalTissue, response: Complex, s: Complex, force: Array, step: float) -> Array:
    """Return the autocorrelation (2 * _BINS,), N^2, of the zero-mean part of K g y^2 / 2 + c y'^2 under a force
    density.
    """
    motion = np.abs(response) ** 2 * force  # m^2 / Hz
    depth = _correlation(motion, step)
    across = _correlation(s * motion, step)  # cross-correlation of speed and depth
    speed = _correlation(np.abs(s) ** 2 * motion, step)
    stiff = 0.5 * tissue.stiffness_n_per_m * tissue.stiffness_growth_per_m
    turn = tissue.damping_asymmetry_n_s2_per_m2
    return np.asarray(
        2.0 * (stiff**2 * depth**2 + 2.0 * stiff * turn * across**2 + turn**2 * speed**2), dtype=np.float64
    )


def _correlation(density: Array | Complex, step: float) -> Array:
    """Return the correlation (2 * _BINS,) of a one-sided density (_BINS + 1,)."""
    return np.asarray(fft.irfft(density, 2 * _BINS) * _BINS * step, dtype=np.float64)


def _density(correlation: Array, step: float) -> Array:
    """Return the one-sided density (_BINS + 1,) of a correlation (2 * _BINS,), clipped at zero."""
    return np.asarray(np.maximum(fft.rfft(correlation).real, 0.0) / (_BINS * step), dtype=np.float64)


_GROWTH_PER_M = 1000.0
"""Default growth of log K with depth, 1/m: a factor e per millimetre, skin under a few newtons."""

_UNIFORM_RMS = 1.0 / math.sqrt(3.0)
"""RMS of a uniform distribution relative to half its range."""

_FITTED_OPTIONS = ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m", "stiffness_growth_per_m")
"""Parameters of a fitted first test that are options of the design under the same name."""

_MIN_STIFFNESS_SHARE = 0.1
"""Minimum extrapolated stiffness, relative to that of the first test."""


@stimulus
class Designed(OpenLoopKind):
    """Uniform noise about one load, with the amplitude at which noise and nonlinearity of the tissue balance.

    For mass, damping and stiffness at one load. The amplitude is about half a newton. A smaller one is lost in the
    noise of the measured force; a larger one leaves the linear range, and the result becomes an average over depth that
    depends on the stimulus. The defaults suit skin that was not tested before; :meth:`after` uses the results of a
    first test.
    """

    name: ClassVar[str] = "designed"
    title: ClassVar[str] = marked("Noise about one load")

    load_n: float = Field(5.5, gt=0.0, le=100.0, description=marked("Load about which the tissue is identified, N"))
    force_min_n: float = Field(0.5, ge=-100.0, le=100.0, description=marked("Lower limit of the force, N"))
    force_max_n: float = Field(10.5, ge=-100.0, le=100.0, description=marked("Upper limit of the force, N"))
    seconds: float = Field(2.0, gt=0.0, le=600.0, description=marked("Length, s"))
    sample_rate: float = Field(2000.0, gt=0.0, le=1e6, description=marked("Sample rate, Hz"))
    seed: int = Field(0, ge=0, le=2**63 - 1, description=marked("Random seed: the same seed gives the same samples"))
    cutoff_hz: float = Field(
        100.0, gt=0.0, description=marked("Cutoff frequency, Hz: twice the natural frequency is enough")
    )
    mass_kg: float = Field(0.09, gt=0.0, le=10.0, description=marked("Expected mass including the moving part, kg"))
    damping_n_s_per_m: float = Field(12.0, gt=0.0, le=1e4, description=marked("Expected damping, N s/m"))
    stiffness_n_per_m: float | None = Field(
        None, gt=0.0, le=1e7, description=marked("Expected stiffness at the load, N/m; by default growth times load")
    )
    stiffness_growth_per_m: float = Field(
        _GROWTH_PER_M, ge=0.0, le=1e5, description=marked("Growth of the logarithm of the stiffness with depth, 1/m")
    )
    damping_asymmetry_n_s2_per_m2: float = Field(
        70.0,
        ge=0.0,
        le=1e4,
        description=marked("Asymmetry of the damping between indentation and retraction, N s2/m2"),
    )
    force_noise_n_per_root_hz: float = Field(
        1.2e-3, gt=0.0, le=1.0, description=marked("Noise density of the measured force, N per root Hz")
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if not self.force_min_n < self.load_n < self.force_max_n:
            raise UnusableInputError(
                "designed.load",
                "the load must be between the force limits, {force_min_n:g} and {force_max_n:g} N, not {load_n:g} N",
                load_n=self.load_n,
                force_min_n=self.force_min_n,
                force_max_n=self.force_max_n,
            )
        Butterworth(self.cutoff_hz).check(self.sample_rate)
        self._noise()
        return self

    @classmethod
    def after(cls, parameters: Mapping[str, Estimate], first_load_n: float, load_n: float, **options: float) -> Self:
        """Design the stimulus from the results of a first test.

        The stiffness is extrapolated along its exponential growth, K = K0 + g (F - F0).

        Args:
            parameters: of a fit to the first test, as ``dpn`` reports them at its median, or ``lms``.
            first_load_n: mean load of the first test, N.
            load_n: load of the new test, N.
            options: further options of the kind, such as ``seconds``.

        Raises:
            UnusableInputError: an option is invalid.
        """
        fitted = {name: parameters[name].value for name in _FITTED_OPTIONS if name in parameters}
        growth = max(0.0, fitted.get("stiffness_growth_per_m", _GROWTH_PER_M))
        fitted["stiffness_growth_per_m"] = growth
        if "stiffness_n_per_m" in fitted:
            first = fitted["stiffness_n_per_m"]
            fitted["stiffness_n_per_m"] = max(first + growth * (load_n - first_load_n), _MIN_STIFFNESS_SHARE * first)
        return cls.from_options(fitted | {"load_n": load_n} | options)

    @property
    def tissue(self) -> LocalTissue:
        """Parameters of the tissue expected at the load."""
        stiffness = self.stiffness_n_per_m
        if stiffness is None:  # tangent stiffness of an exponential force law at this load
            stiffness = max(self.stiffness_growth_per_m, 1.0) * self.load_n
        return LocalTissue(
            self.mass_kg,
            self.damping_n_s_per_m,
            stiffness,
            self.stiffness_growth_per_m,
            self.damping_asymmetry_n_s2_per_m2,
        )

    @property
    def precision(self) -> DesignPrecision:
        """Predicted precision of a fit to such a tissue."""
        return predicted_precision(self.tissue, self.cutoff_hz, self.force_noise_n_per_root_hz)

    @property
    def amplitude_n(self) -> float:
        """Half range of the force about the load, N: the optimum, limited by the force range."""
        room = min(self.load_n - self.force_min_n, self.force_max_n - self.load_n)
        return float(min(self.precision.optimal_rms_n / _UNIFORM_RMS, room))

    @property
    def predicted_std(self) -> tuple[float, float, float]:
        """Predicted relative standard deviations of mass, damping and stiffness after the whole length."""
        mass, damping, stiffness = self.precision.std(_UNIFORM_RMS * self.amplitude_n, self.seconds)
        return float(mass), float(damping), float(stiffness)

    def build(self) -> Stimulus:
        """Build the force history, shape (seconds * sample_rate,), N."""
        played = self._noise().build()
        return Stimulus(
            values=played.values,
            sample_rate_hz=self.sample_rate,
            description=self.describe(),
            seed=self.seed,
            crest_factor=played.crest_factor,
        )

    def _noise(self) -> Noise:
        swing = self.amplitude_n
        return Noise(
            distribution="uniform",
            force_min_n=self.load_n - swing,
            force_max_n=self.load_n + swing,
            cutoff_hz=self.cutoff_hz,
            seconds=self.seconds,
            sample_rate=self.sample_rate,
            seed=self.seed,
        )
