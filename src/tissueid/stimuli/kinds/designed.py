"""Noise about a load, with the amplitude at which a short test determines mass, damping and stiffness best.

Two errors disturb such a fit. The noise of the measured force matters less as the stimulus grows. Nonlinearity matters
more: stiffness that grows with depth and damping that differs by direction respond with the square of the motion. Both
act as noise of the force, so that with the power P of the stimulus the variance of each parameter is n / P + d P. The
design takes the best power between the two; the spectrum matters far less (docs/stimuli.md).
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
from tissueid.messages import Message
from tissueid.records import Estimate
from tissueid.stimuli.base import Array, OpenLoopKind, Stimulus, stimulus
from tissueid.stimuli.kinds.noise import Noise
from tissueid.stimuli.spectra import Butterworth

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


_GROWTH_PER_M = 1000.0
"""Growth of log K with depth without a test: e-fold in a millimetre, skin under some newtons."""

_MOST_OF_RANGE = 1.0 / math.sqrt(3.0)
"""Root-mean-square of an even distribution over its half range."""

_FIRST_TEST = ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m", "stiffness_growth_per_m")
"""Parameters of a fitted test that are options of the design under the same name."""

_SOFTEST = 0.1
"""Share of the first test's stiffness to which its growth is followed back at most."""


@stimulus
class Designed(OpenLoopKind):
    """Evenly distributed noise about one load, as large as the tissue's own bend and the noise of the force allow.

    For the question "mass, damping and stiffness under this load", and no other load: the swing is some half a newton
    either way. Smaller, it drowns in the noise of the measured force; larger, the line no longer holds and the answer
    is an average over depths that depends on the stimulus. The defaults are for skin that was not tested before;
    :meth:`after` takes what a first test has found.
    """

    name: ClassVar[str] = "designed"
    title: ClassVar[str] = marked("Noise about one load")

    load_n: float = Field(5.5, gt=0.0, le=100.0, description=marked("Load about which the tissue is to be known, N"))
    force_min_n: float = Field(0.5, ge=-100.0, le=100.0, description=marked("Force below which it never goes, N"))
    force_max_n: float = Field(10.5, ge=-100.0, le=100.0, description=marked("Force beyond which it never goes, N"))
    seconds: float = Field(2.0, gt=0.0, le=600.0, description=marked("Length, s"))
    sample_rate: float = Field(2000.0, gt=0.0, le=1e6, description=marked("Samples a second"))
    seed: int = Field(0, ge=0, le=2**63 - 1, description=marked("The same seed gives the same samples"))
    cutoff_hz: float = Field(
        100.0, gt=0.0, description=marked("Cut-off frequency, Hz: twice the natural frequency will do")
    )
    mass_kg: float = Field(0.09, gt=0.0, le=10.0, description=marked("Mass that is expected, kg, moving part included"))
    damping_n_s_per_m: float = Field(12.0, gt=0.0, le=1e4, description=marked("Damping that is expected, N s/m"))
    stiffness_n_per_m: float | None = Field(
        None, gt=0.0, le=1e7, description=marked("Stiffness under the load, N/m; growth times load when not given")
    )
    stiffness_growth_per_m: float = Field(
        _GROWTH_PER_M, ge=0.0, le=1e5, description=marked("Growth of the logarithm of the stiffness with depth, 1/m")
    )
    damping_turn_n_s2_per_m2: float = Field(
        70.0,
        ge=0.0,
        le=1e4,
        description=marked("Growth of the damping with speed, N s2/m2: more on the way in than out"),
    )
    force_noise_n_per_root_hz: float = Field(
        1.2e-3, gt=0.0, le=1.0, description=marked("Noise density of the measured force, N per root Hz")
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if not self.force_min_n < self.load_n < self.force_max_n:
            raise UnusableInputError(
                Message(
                    "designed.load",
                    "the load of {load_n:g} N must lie between the least and the greatest force, "
                    "{force_min_n:g} and {force_max_n:g} N",
                    load_n=self.load_n,
                    force_min_n=self.force_min_n,
                    force_max_n=self.force_max_n,
                )
            )
        Butterworth(self.cutoff_hz).check(self.sample_rate)
        self._noise()
        return self

    @classmethod
    def after(cls, parameters: Mapping[str, Estimate], first_load_n: float, load_n: float, **options: float) -> Self:
        """Design from what a first test has found.

        The stiffness is taken from one load to the other along its exponential growth, K = K0 + g (F - F0).

        Args:
            parameters: of a fit to the first test, as ``dpn`` reports them at its median, or ``lms``.
            first_load_n: mean load of the first test.
            load_n: the load that is asked about.
            options: further options of the kind, such as ``seconds``.

        Raises:
            UnusableInputError: an option does not hold.
        """
        found = {name: parameters[name].value for name in _FIRST_TEST if name in parameters}
        growth = max(0.0, found.get("stiffness_growth_per_m", _GROWTH_PER_M))
        found["stiffness_growth_per_m"] = growth
        if "stiffness_n_per_m" in found:
            first = found["stiffness_n_per_m"]
            found["stiffness_n_per_m"] = max(first + growth * (load_n - first_load_n), _SOFTEST * first)
        return cls.from_options(found | {"load_n": load_n} | options)

    @property
    def tissue(self) -> LocalTissue:
        """Return the mass, damping and stiffness expected under the load."""
        stiffness = self.stiffness_n_per_m
        if stiffness is None:  # what an exponential law has under this load
            stiffness = max(self.stiffness_growth_per_m, 1.0) * self.load_n
        return LocalTissue(
            self.mass_kg,
            self.damping_n_s_per_m,
            stiffness,
            self.stiffness_growth_per_m,
            self.damping_turn_n_s2_per_m2,
        )

    @property
    def precision(self) -> DesignPrecision:
        """What a fit will know of such a tissue."""
        return predicted_precision(self.tissue, self.cutoff_hz, self.force_noise_n_per_root_hz)

    @property
    def swing_n(self) -> float:
        """Force to either side of the load, N: the best, or what the range of force leaves of it."""
        room = min(self.load_n - self.force_min_n, self.force_max_n - self.load_n)
        return float(min(self.precision.best_rms_n / _MOST_OF_RANGE, room))

    @property
    def predicted_std(self) -> tuple[float, float, float]:
        """Relative standard deviations of mass, damping and stiffness after the whole length, as designed."""
        mass, damping, stiffness = self.precision.std(_MOST_OF_RANGE * self.swing_n, self.seconds)
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
        swing = self.swing_n
        return Noise(
            distribution="uniform",
            force_min_n=self.load_n - swing,
            force_max_n=self.load_n + swing,
            cutoff_hz=self.cutoff_hz,
            seconds=self.seconds,
            sample_rate=self.sample_rate,
            seed=self.seed,
        )
