"""Dry friction in the bearing: Coulomb, Stribeck and presliding."""

from __future__ import annotations

import math

from numba import njit

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter

STOPS = 6
"""Number of springs. Their states come first, followed by that of the bristle and the limits of the springs."""
_LIMITS = STOPS + 1


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def friction_share(s, velocity, give, spread, bristle_share, dt):  # type: ignore[no-untyped-def]
    """Return the mean friction over a step relative to sliding friction, from -1 to 1, and update the state ``s``."""
    if s[_LIMITS] == 0.0:
        for k in range(STOPS):
            s[_LIMITS + k] = math.exp(spread * (2.0 * k / (STOPS - 1.0) - 1.0))
    together = 0.0
    for k in range(STOPS):
        most = give * s[_LIMITS + k]
        stretch = min(max(s[k] + dt * velocity, -most), most)
        # The mean over the step; a spring that does not slip stretches linearly.
        together += 0.5 * (s[k] + stretch) / most
        s[k] = stretch
    # Exact for a velocity that is constant over the step.
    path = abs(velocity) * dt / give
    settled = 1.0 if velocity > 0.0 else -1.0
    deviation = s[STOPS] - settled
    mean = settled + deviation * (1.0 - 0.5 * path if path < 1e-6 else (1.0 - math.exp(-path)) / path)
    s[STOPS] = settled + deviation * math.exp(-path)
    return (1.0 - bristle_share) * together / STOPS + bristle_share * mean


SPREAD = Parameter(
    "spread",
    "1",
    None,
    0.0,
    2.5,
    prior=1.0,
    prior_std=0.5,
    meaning="spread of the log presliding displacements",
    default=1.0,
)
BRISTLE_SHARE = Parameter("bristle_share", "1", None, 0.0, 1.0, fixed=True, meaning="share of creeping loops")
"""Zero in a fit: the spread of the springs describes the same loops. Twins of earlier versions have other values."""
STRIBECK_SPEED_M_S = 0.008
"""Speed at which the additional friction at standstill has vanished, m/s; of little influence in fast tests."""


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Add the friction force, larger near standstill."""
    velocity = b[bus.VELOCITY] + 0.5 * dt * b[bus.ACCELERATION]
    ratio = velocity / STRIBECK_SPEED_M_S
    level = p[0] * (1.0 + p[2] * math.exp(-min(ratio * ratio, 50.0)))
    b[bus.FORCE] -= level * friction_share(s, velocity, p[1], p[4], p[3], dt)


EFFECT = Effect(
    name="dry_friction",
    stage="mechanics",
    title="Dry friction in the bearing",
    equation="F = -Fc g(v) ((1 - h) mean of z_k + h w), dz_k/dt = v / y_k within |z_k| <= 1, ln y_k spread evenly to s "
    "on either side of ln y, dw/dt = (v - |v| w) / y, g = 1 + a exp(-(v / 8 mm/s)^2); vanishes with Fc = 0",
    signature="position lags and flattens at reversals, more at smaller amplitude; loops in the slow ramp; in the "
    "spring test as well as on tissue; current unchanged except for back-EMF",
    source="Iwan, J. Applied Mechanics 33 (1966) 893-900 (parallel slip); Canudas de Wit et al., IEEE "
    "Trans. Automatic Control 40 (1995) 419-425; Armstrong-Helouvry et al. 1994",
    parameters=(
        Parameter("coulomb_n", "N", 0.0, 1e-3, 5.0, True, meaning="friction force at speed"),
        Parameter("presliding_m", "m", None, 1e-6, 3e-4, True, meaning="displacement before it slides"),
        Parameter("stribeck_ratio", "1", None, -0.5, 3.0, prior=0.2, prior_std=0.5, meaning="extra friction at rest"),
        BRISTLE_SHARE,
        SPREAD,
    ),
    starts=((0.1, 2e-5, 0.2, 0.0, 1.0), (0.5, 5e-5, 0.2, 0.0, 1.0)),
    mistaken_for=("directional_friction", "tissue_hysteresis", "sensor_backlash"),
    places=(bus.MECHANICS,),
    hook=hook,
    special_case_of="directional_friction",
    remedy="Clean and realign the bearing; measure again in free air.",
)
