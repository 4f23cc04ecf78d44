"""Linear models of tissue with relaxation: Kelvin-Voigt, Maxwell, standard linear solid and Burger (Chen 2010, 2.1).

The mass M of actuator and tissue and the damping B of the bearing and the tissue act in parallel with a tissue of
dynamic stiffness Z: H = 1 / (M s^2 + B s + Z). With A(K, B) = K B s / (K + B s) for a spring K in series with a damper
B (a Maxwell element of relaxation time B / K):

- Kelvin-Voigt: Z = K.
- Maxwell: Z = A(K1, B1).
- Standard linear solid: Z = K + A(K1, B1).
- Burger: 1 / Z = 1 / A(K1, B1) + 1 / (K2 + B2 s), a Maxwell and a Kelvin-Voigt element in series.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from scipy import fft

from tissueid.identification.base import Array
from tissueid.identification.second_order import Complex, Hold
from tissueid.language import marked

Structure = Literal["kelvin-voigt", "maxwell", "standard-linear-solid", "burger"]
STRUCTURES: tuple[Structure, ...] = ("kelvin-voigt", "maxwell", "standard-linear-solid", "burger")
NAMES = {
    "auto": marked("auto"),
    "kelvin-voigt": marked("Kelvin-Voigt"),
    "maxwell": marked("Maxwell"),
    "standard-linear-solid": marked("standard linear solid"),
    "burger": marked("Burger"),
}
"""Displayed names of the structures."""

ELEMENTS: dict[Structure, tuple[str, ...]] = {
    "kelvin-voigt": ("stiffness_n_per_m",),
    "maxwell": ("spring_1_n_per_m", "damper_1_n_s_per_m"),
    "standard-linear-solid": ("stiffness_n_per_m", "spring_1_n_per_m", "damper_1_n_s_per_m"),
    "burger": ("spring_1_n_per_m", "damper_1_n_s_per_m", "spring_2_n_per_m", "damper_2_n_s_per_m"),
}
"""Elements of each structure besides mass and parallel damping, in the order of the fitted parameters.
``stiffness_n_per_m`` carries a steady load; a spring in series with a damper does not."""
PARALLEL = ("mass_kg", "damping_n_s_per_m")
"""Fitted parameters of every structure, before its elements."""

DECAYED = 16.0
"""Time constants after which a response is forgotten: 1e-7."""
_ALIASES = 4
"""Images of the base band on each side that are summed for a held input."""


@dataclass(frozen=True)
class Viscoelastic:
    """A structure with the values of mass, parallel damping and its ``ELEMENTS``, SI."""

    structure: Structure
    values: tuple[float, ...]

    @property
    def creeps(self) -> bool:
        """Whether a steady load moves the tissue without end."""
        return self.structure in ("maxwell", "burger")

    @property
    def ratio(self) -> tuple[Polynomial, Polynomial]:
        """Numerator and denominator of H in powers of s."""
        m, b, *rest = self.values
        inertia, s = Polynomial([0.0, b, m]), Polynomial([0.0, 1.0])
        if self.structure == "kelvin-voigt":
            return Polynomial([1.0]), inertia + rest[0]
        if self.structure == "standard-linear-solid":
            k, k1, b1 = rest
            below = Polynomial([k1, b1])
            return below, (inertia + k) * below + k1 * b1 * s
        k1, b1 = rest[:2]
        above, below = Polynomial([k1, b1]), k1 * b1 * s  # of the Maxwell element: compliance
        if self.structure == "burger":
            solid = Polynomial([rest[2], rest[3]])
            above, below = above * solid + below, below * solid
        return above, below + inertia * above

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Poles other than the one at zero, 1/s."""
        below = self.ratio[1]
        if self.creeps:
            below = Polynomial(below.coef[1:])
        return np.asarray(below.roots(), dtype=np.complex128)

    @property
    def slowest_s(self) -> float:
        """Longest time constant of the poles other than zero, s."""
        return float(1.0 / max(1e-9, np.min(-self.poles.real)))

    @property
    def creep_rate(self) -> float:
        """Speed under a unit of steady load, m/(N s); 0 for a structure that does not creep."""
        return 1.0 / (self.values[1] + self.values[3]) if self.creeps else 0.0

    @property
    def static_compliance(self) -> float:
        """Displacement under a unit of steady load, m/N; 0 for a structure that creeps."""
        return 0.0 if self.creeps else 1.0 / self.values[2]

    def response(self, frequency_hz: Array) -> tuple[Complex, Complex]:
        """Return H (n,) and its derivatives (p, n) with respect to the logarithms of the values."""
        s = 2j * np.pi * np.where(frequency_hz == 0.0, 1e-9, frequency_hz)
        m, b, *rest = self.values
        z, dz = self._stiffness(s, rest)
        h = 1.0 / (m * s**2 + b * s + z)
        return h, np.asarray(-(h**2) * np.vstack([m * s**2, b * s, *dz]), dtype=np.complex128)

    def _stiffness(self, s: Complex, rest: list[float]) -> tuple[Complex, list[Complex]]:
        """Return Z (n,) and its derivatives with respect to the logarithms of the elements."""
        if self.structure == "kelvin-voigt":
            elastic = np.full_like(s, rest[0])
            return elastic, [elastic]
        k1, b1 = rest[1:] if self.structure == "standard-linear-solid" else rest[:2]
        arm = k1 * b1 * s / (k1 + b1 * s)
        arm_slopes = [arm**2 / k1, arm**2 / (b1 * s)]
        if self.structure == "maxwell":
            return arm, arm_slopes
        if self.structure == "standard-linear-solid":
            return rest[0] + arm, [np.full_like(s, rest[0]), *arm_slopes]
        k2, b2 = rest[2:]
        solid = k2 + b2 * s
        z = arm * solid / (arm + solid)
        return z, [slope * (z / arm) ** 2 for slope in arm_slopes] + [
            k2 * (z / solid) ** 2,
            b2 * s * (z / solid) ** 2,
        ]

    def sampled(self, frequency_hz: Array, rate: float, hold: Hold) -> tuple[Complex, Complex]:
        """Return H and its derivatives for samples, as :func:`second_order.sampled_response_at`. A creeping structure
        has no response at frequency zero.
        """
        if hold == "zero-order":
            share = frequency_hz / rate
            total: list[Complex] = []
            for image in range(-_ALIASES, _ALIASES + 1):
                weight = np.sinc(share) if image == 0 else np.sin(np.pi * share) / (np.pi * (share + image))
                h, slopes = self.response(frequency_hz + image * rate)
                total = (
                    [weight * h, weight * slopes] if not total else [total[0] + weight * h, total[1] + weight * slopes]
                )
            h, slopes = (part * np.exp(-1j * np.pi * share) for part in total)
        else:
            h, slopes = self.response(frequency_hz)
        if self.creeps:
            still = frequency_hz == 0.0
            h[still], slopes[:, still] = 0.0, 0.0
        return h, slopes

    def simulate(self, x: Array, rate: float, hold: Hold) -> Array:
        """Return the response (n,) to a deviation x (n,) without NaN, at rest before the first sample."""
        settle = min(x.size, math.ceil(DECAYED * rate * self.slowest_s))
        length = fft.next_fast_len(x.size + max(settle, 64), real=True)
        frequency = fft.rfftfreq(length, 1.0 / rate)
        spectrum = fft.rfft(x, length)
        h, _ = self.sampled(frequency, rate, hold)
        if not self.creeps:
            return np.asarray(fft.irfft(spectrum * h, length)[: x.size], dtype=np.float64)
        creep = self.creep_rate * float(spectrum[0].real) / length  # m/s under the mean of the extended input
        swing = fft.irfft(spectrum * h, length)
        before = swing[-1] - creep / rate  # at rest, at the end of the zeros of the previous period
        return np.asarray(swing[: x.size] + creep * np.arange(x.size) / rate - before, dtype=np.float64)
