"""Round probes: how diameter and corner radius scale the law of a tissue.

The laws of the presets hold for the 4.4 mm disk of the thesis, taken as sharp. With the radius ``rho`` of the contact
relative to that of this disk, stiffness and damping are multiplied by

    (1 - share) rho + share rho^2

A flat punch on an elastic half-space has a stiffness proportional to its radius (Sneddon, Int. J. Eng. Sci. 3, 1965),
one on an elastic foundation to its area (Johnson, Contact Mechanics, 1985, 4.3). Damping has the factor of stiffness
(correspondence principle), and the mass that a disk moves on a half-space goes with the cube of its radius (Lysmer,
1965).

Corners of radius ``R`` leave a flat of radius b = a - R: the contact begins there and grows until depth ``d``, where it
reaches the edge (Ciavarella, Int. J. Solids Struct. 36, 1999). The mean contact radius up to a depth ``y``, which is
what the secant stiffness needs, is approximated by a - R s / (y^1.5 + s^1.5)^(2/3). It is exact at the surface and far
beyond ``d``, where the exact one is a - R s / y.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import acos, sqrt

from numpy.polynomial.legendre import leggauss

REFERENCE_RADIUS_M = 2.2e-3
FOUNDATION_SHARE = 0.3
"""Share of the stiffness at the reference probe that goes with the area; chosen."""
_NODES = leggauss(40)


@dataclass(frozen=True)
class Probe:
    """A round probe, SI.

    Raises:
        ValueError: the diameter is not between 1 and 20 mm, or the corner radius is not below half of it.
    """

    diameter_m: float = 2.0 * REFERENCE_RADIUS_M
    corner_radius_m: float = 0.0

    def __post_init__(self) -> None:
        if not 1e-3 <= self.diameter_m <= 20e-3:
            raise ValueError(f"the diameter of a probe must be between 1 and 20 mm, not {1e3 * self.diameter_m:g} mm")
        if not 0.0 <= self.corner_radius_m <= 0.45 * self.diameter_m:
            raise ValueError(
                f"the corner radius of a probe must be between 0 and {450 * self.diameter_m:g} mm, "
                f"not {1e3 * self.corner_radius_m:g} mm"
            )

    @property
    def radius_ratio(self) -> float:
        """Radius relative to that of the reference probe."""
        return 0.5 * self.diameter_m / REFERENCE_RADIUS_M

    @property
    def corner_ratio(self) -> float:
        """Corner radius relative to the radius of the reference probe."""
        return self.corner_radius_m / REFERENCE_RADIUS_M

    @property
    def corner_depth_m(self) -> float:
        """Depth ``s`` in the law of the growing contact, m; 0 for a sharp probe."""
        if self.corner_radius_m == 0.0:
            return 0.0
        edge = 0.5 * self.diameter_m
        return (edge * self.full_contact_m - self.contact_integral(self.full_contact_m)) / self.corner_radius_m

    @property
    def full_contact_m(self) -> float:
        """Depth at which the contact reaches the edge, m, on an elastic half-space."""
        return self._depth(0.5 * self.diameter_m) if self.corner_radius_m else 0.0

    def _depth(self, contact_m: float) -> float:
        flat = 0.5 * self.diameter_m - self.corner_radius_m
        if contact_m <= flat:
            return 0.0
        return contact_m / self.corner_radius_m * (sqrt(contact_m**2 - flat**2) - flat * acos(flat / contact_m))

    def contact_integral(self, depth_m: float) -> float:
        """Return the integral of the exact contact radius from the surface to a depth, m^2.

        Times 2 E* it is the force on a half-space, whose tangent stiffness is 2 E* times the contact radius.
        """
        edge, flat = 0.5 * self.diameter_m, 0.5 * self.diameter_m - self.corner_radius_m
        full = self.full_contact_m
        if self.corner_radius_m == 0.0:
            return edge * depth_m
        within = min(depth_m, full)
        low, high = flat, edge
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self._depth(middle) < within else (low, middle)
        contact = 0.5 * (low + high)
        # Integral of c over depth = c depth - integral of depth over c, by Gauss-Legendre.
        half = 0.5 * (contact - flat)
        swept = sum(weight * self._depth(flat + half * (node + 1.0)) for node, weight in zip(*_NODES, strict=True))
        return contact * within - half * float(swept) + edge * (depth_m - within)

    def factor(self, depth_m: float) -> float:
        """Return the factor of stiffness and damping at a depth, m."""
        rho = self.radius_ratio
        if (s := self.corner_depth_m) > 0.0:
            rho -= self.corner_ratio * s / (max(depth_m, 0.0) ** 1.5 + s**1.5) ** (2.0 / 3.0)
        return (1.0 - FOUNDATION_SHARE) * rho + FOUNDATION_SHARE * rho * rho


REFERENCE = Probe()
PROBES = {
    "indenter-4.4mm": REFERENCE,
    "indenter-4.3mm": Probe(4.3e-3, 0.4e-3),
    "indenter-5mm": Probe(5.0e-3, 1.3e-3),
}
"""Round probes of the thesis (2.2.3, 7.2) by name."""


def read_probe(text: str) -> Probe:
    """Return a probe from its name, or from diameter and corner radius in mm, such as ``8:0.5`` or ``8``.

    Raises:
        ValueError: there is no such probe, or its dimensions are not possible.
    """
    if text in PROBES:
        return PROBES[text]
    diameter, _, corner = text.partition(":")
    try:
        return Probe(float(diameter) * 1e-3, float(corner or 0.0) * 1e-3)
    except ValueError as error:
        if "probe" in str(error):
            raise
        raise ValueError(
            f"the probe must be one of {', '.join(PROBES)}, or DIAMETER:CORNER in mm, not {text!r}"
        ) from None
