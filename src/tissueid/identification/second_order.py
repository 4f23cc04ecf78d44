"""Second-order system: mass, damping, stiffness, and the three impulse-response coefficients of the thesis.

Chen 2010, Eqs. 3.6-3.12. The thesis covers the underdamped case; natural frequency and damping ratio also describe
overdamped tissue.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy import fft, optimize

from tissueid.identification.base import Array
from tissueid.identification.depth_profile import DepthProfile
from tissueid.language import marked
from tissueid.records import Estimate

Name = TypeVar("Name", bound=str)

_STIFFNESS = "stiffness_n_per_m"
_BY_DIRECTION = ("stiffness_in_n_per_m", "stiffness_out_n_per_m")


def has_stiffness(parameters: Mapping[str, Estimate]) -> bool:
    """Return whether the parameters include a stiffness in N/m."""
    return any(name.endswith((_STIFFNESS, *_BY_DIRECTION)) for name in parameters)


def without_spring(parameters: Mapping[Name, Estimate], spring_n_per_m: float) -> dict[Name, Estimate]:
    """Return the parameters with the spring subtracted from every stiffness in N/m; standard deviations are unchanged.

    Natural frequency, damping ratio and relative growth of stiffness with depth still describe tissue and spring.
    """
    return {
        name: replace(estimate, value=estimate.value - spring_n_per_m) if _is_stiffness(name) else estimate
        for name, estimate in parameters.items()
    }


def profile_without_spring(profile: DepthProfile, spring_n_per_m: float) -> DepthProfile:
    """Return the depth profile with the spring subtracted from its stiffness."""
    return replace(profile, stiffness=profile.stiffness - spring_n_per_m)


def _is_stiffness(name: str) -> bool:
    return name in ("stiffness", *_BY_DIRECTION) or name.endswith(_STIFFNESS)


Complex = NDArray[np.complex128]
Hold = Literal["auto", "band-limited", "zero-order"]
_HOLDS = (marked("auto"), marked("band-limited"), marked("zero-order"))
"""Choices of the option as a form shows them, for translation."""
HOLDS: tuple[Hold, Hold] = ("band-limited", "zero-order")
"""Courses between which ``auto`` chooses."""
HOLD_TITLE = marked("Hold")
HOLD_DESCRIPTION = marked(
    "Course of the input between samples: a measured force is band-limited, a command is held; auto takes the one that "
    "the record shows"
)
"""Title and description of the option ``hold`` of engines."""
HOLD: Any = Field("auto", title=HOLD_TITLE, description=HOLD_DESCRIPTION)
"""The option itself."""

_ALIASES = 6
"""Images of the base band on each side that are summed for a held input; the rest is below one part in 1e5."""


@dataclass(frozen=True)
class SecondOrder:
    """H(s) = 1 / (M s^2 + B s + K), Eq. 3.7. SI for force to position, else input units over output units."""

    mass: float
    damping: float
    stiffness: float

    @property
    def natural_frequency_rad_per_s(self) -> float:
        """sqrt(K / M)."""
        return float(np.sqrt(self.stiffness / self.mass))

    @property
    def damping_ratio(self) -> float:
        """B / (2 sqrt(K M)); above 1 the system is overdamped."""
        return abs(self.damping) / (2.0 * float(np.sqrt(self.stiffness * self.mass)))

    @property
    def decay_and_frequency(self) -> tuple[float, float]:
        """Poles -a ± j b as (a, b^2) in 1/s and 1/s^2; b^2 is negative for an overdamped system."""
        decay = self.damping / (2.0 * self.mass)
        return decay, self.stiffness / self.mass - decay**2

    def impulse_coefficients(self, sample_rate_hz: float) -> tuple[float, float, float] | None:
        """Return A1, A2, A3 of Eq. 3.6 per sample; None for an overdamped system, which has no such form."""
        decay, squared = self.decay_and_frequency
        if squared <= 0.0:
            return None
        frequency = float(np.sqrt(squared))
        return 1.0 / (self.mass * frequency * sample_rate_hz), frequency, -decay

    def impulse_response(self, t: Array) -> Array:
        """Return h(t) in output units per input unit and second, shape of t (s); zero before t = 0."""
        decay, squared = self.decay_and_frequency
        return np.where(t >= 0.0, free_velocity(np.maximum(t, 0.0), decay, squared) / self.mass, 0.0)

    def settling_time_s(self, share: float = 0.05) -> float:
        """Return the time after which the impulse response stays below ``share`` of its peak (Chen 2010, Fig. 6.6).

        Exact: the peaks of an oscillation are in geometric proportion, and after the last one above the share the
        response falls steadily to its next zero; without oscillation it falls steadily from its only peak. Infinite for
        a system without damping.
        """
        decay, squared = self.decay_and_frequency
        if not decay > 0.0:
            return float("inf")
        peak_s, frequency = _peak_time_s(decay, squared), float(np.sqrt(max(0.0, squared)))
        peak = float(free_velocity(np.array(peak_s), decay, squared))

        def above(t: float) -> float:
            return abs(float(free_velocity(np.array(t), decay, squared))) / peak - share

        if frequency > 0.0:
            half_period = np.pi / frequency
            later = float(np.floor(-np.log(share) / (decay * half_period)))  # peaks after the first above the share
            return float(optimize.brentq(above, peak_s + later * half_period, (later + 1.0) * half_period))
        end = 2.0 * peak_s
        while above(end) > 0.0:
            end *= 2.0
        return float(optimize.brentq(above, peak_s, end))

    def frequency_response(self, frequency_hz: Array) -> Complex:
        """Return H at the given frequencies, shape of ``frequency_hz``."""
        s = 2j * np.pi * np.asarray(frequency_hz, dtype=np.complex128)
        return np.asarray(1.0 / (self.mass * s**2 + self.damping * s + self.stiffness))

    def simulate(self, u: Array, sample_rate_hz: float, hold: Hold = "band-limited", dead_time_s: float = 0.0) -> Array:
        """Return the response (n,) to an input (n,) without NaN, at rest before the first sample."""
        decay, squared = self.decay_and_frequency
        slowest = decay - float(np.sqrt(max(0.0, -squared)))
        settle = min(u.size, round(12.0 * sample_rate_hz / slowest)) if slowest > 0.0 else u.size
        length = fft.next_fast_len(u.size + max(settle, 64), real=True)
        response, _ = sampled_response(self, length, sample_rate_hz, hold)
        if dead_time_s:
            response *= np.exp(-2j * np.pi * dead_time_s * fft.rfftfreq(length, 1.0 / sample_rate_hz))
        return np.asarray(fft.irfft(fft.rfft(u, length) * response, length)[: u.size], dtype=np.float64)


def sampled_response(system: SecondOrder, length: int, sample_rate_hz: float, hold: Hold) -> tuple[Complex, Complex]:
    """Return the sampled frequency response (bins,) and its derivatives (3, bins) with respect to log M, log B, log K.

    ``length`` is that of the real FFT; see :func:`sampled_response_at`.
    """
    return sampled_response_at(system, fft.rfftfreq(length, 1.0 / sample_rate_hz), sample_rate_hz, hold)


def sampled_response_at(
    system: SecondOrder, frequency_hz: Array, sample_rate_hz: float, hold: Hold
) -> tuple[Complex, Complex]:
    """Return the sampled frequency response (n,) and its derivatives (3, n) at frequencies (n,) up to half the rate.

    A band-limited input is filtered by H(j w) itself, without discretisation error; an input that is held between
    samples also contributes through the images of the base band, weighted by the hold. The hold ``auto`` of an engine
    that has not seen a record counts as band-limited.
    """
    both = np.zeros((4, frequency_hz.size), dtype=np.complex128)
    if hold == "zero-order":
        # The hold has the gain sin(pi f / rate) / (pi (f / rate + k)) at image k, and the phase of the base band.
        share = frequency_hz / sample_rate_hz
        for image in range(-_ALIASES, _ALIASES + 1):
            if image:
                _add_response(both, system, frequency_hz + image * sample_rate_hz, 1.0 / (share + image))
        both *= np.sin(np.pi * share) / np.pi
        _add_response(both, system, frequency_hz, np.sinc(share))
        both *= np.exp(-1j * np.pi * share)
    else:
        _add_response(both, system, frequency_hz, None)
    both[1] *= system.mass
    both[2] *= -1j * system.damping
    both[3] *= -system.stiffness
    return both[0], both[1:]


def _add_response(both: Complex, system: SecondOrder, frequency_hz: Array, weight: Array | None) -> None:
    """Add weighted H, w^2 H^2, w H^2 and H^2 to the rows of ``both`` (4, n)."""
    w = 2.0 * np.pi * frequency_hz
    denominator = np.empty(w.size, dtype=np.complex128)
    denominator.real = system.stiffness - system.mass * w**2
    denominator.imag = system.damping * w
    h = 1.0 / denominator
    common = h * h
    if weight is not None:
        h *= weight
        common *= weight
    both[0] += h
    both[3] += common
    common *= w
    both[2] += common
    common *= w
    both[1] += common


def _peak_time_s(decay: float, squared: float) -> float:
    """Return the time of the first peak of the impulse response; arguments as :func:`free_velocity`."""
    b = float(np.sqrt(abs(squared)))
    if b < 1e-6 * decay:
        return 1.0 / decay
    return float(np.arctan2(b, decay) / b if squared > 0.0 else np.arctanh(b / decay) / b)


def free_velocity(t: Array, decay: float, squared: float) -> Array:
    """Return exp(-a t) sin(b t) / b for t >= 0, with b^2 = ``squared`` of either sign: the impulse response."""
    if squared > 0.0:
        b = np.sqrt(squared)
        return np.asarray(np.exp(-decay * t) * np.sin(b * t) / b, dtype=np.float64)
    b = np.sqrt(-squared)
    if b == 0.0:
        return np.asarray(t * np.exp(-decay * t), dtype=np.float64)
    return np.asarray(-np.exp((b - decay) * t) * np.expm1(-2.0 * b * t) / (2.0 * b), dtype=np.float64)


def free_position(t: Array, decay: float, squared: float) -> Array:
    """Return the free response from an initial position of 1; arguments as :func:`free_velocity`."""
    if squared > 0.0:
        even = np.exp(-decay * t) * np.cos(np.sqrt(squared) * t)
    else:
        b = np.sqrt(-squared)
        even = 0.5 * (np.exp((b - decay) * t) + np.exp(-(b + decay) * t))
    return np.asarray(even + decay * free_velocity(t, decay, squared), dtype=np.float64)
