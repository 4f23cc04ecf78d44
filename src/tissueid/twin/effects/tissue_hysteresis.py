"""Rate-independent hysteresis of the tissue."""

from __future__ import annotations

import math

from tissueid.twin import bus
from tissueid.twin.effect import ActsOn, Effect, FloatArray, Parameter

STOPS = 8
REFERENCE_N = 3.0
"""Reference static force of the size of a loop, N, as in a stochastic test."""
_SMALL_N = 0.05
SHORTEST_YIELD_M = 4e-5
"""Displacement below which loops are those of a sliding contact: presliding takes micrometres, tissue does not."""
_LIMITS = STOPS + 1


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Add the force of slipping springs and a bristle; ``s[k]`` is each stretch, in m and relative to its limit."""
    if s[_LIMITS] == 0.0:
        for k in range(STOPS):
            s[_LIMITS + k] = math.exp(p[4] * (2.0 * k / (STOPS - 1.0) - 1.0))
    move = dt * (b[bus.VELOCITY] + 0.5 * dt * b[bus.ACCELERATION])
    held = 0.0
    for k in range(STOPS):
        most = p[1] * s[_LIMITS + k]
        stretch = min(max(s[k] + move, -most), most)
        held += 0.5 * (s[k] + stretch) / most
        s[k] = stretch
    # Bouc-Wen with exponent 2: linear in unloading, saturating in loading; both exact.
    way, before = move / p[1], s[STOPS]
    if way * before < 0.0:
        s[STOPS] = before + min(max(way, -1.0), 1.0)
    else:
        bend = math.tanh(way)
        s[STOPS] = (before + bend) / (1.0 + before * bend)
    bristle = 0.5 * (before + s[STOPS])
    force = b[bus.TISSUE_FORCE]
    pressed = (force * force + _SMALL_N * _SMALL_N) / (REFERENCE_N * REFERENCE_N)
    b[bus.TISSUE_FORCE] = force + p[0] * pressed ** (0.5 * p[2]) * ((1.0 - p[3]) * held / STOPS + p[3] * bristle)


EFFECT = Effect(
    name="tissue_hysteresis",
    stage="tissue",
    acts_on=ActsOn.ELASTIC_LOOPS,
    title="Rate-independent hysteresis of the tissue",
    equation="F = Fe + Fh (|Fe| / 3 N)^q ((1 - h) mean of z_k + h w), dz_k/dt = v / y_k within |z_k| <= 1, ln y_k "
    "spread evenly to s on either side of ln y, dw/dt = v (1 - w^2 if v w > 0) / y; vanishes with Fh = 0",
    signature="loops of force against depth that are as wide in the slow ramp as in the fast test and grow with depth; "
    "odd distortion and phase at low frequency; nothing on the spring",
    source="Visintin, Differential Models of Hysteresis (1994) (Prandtl-Ishlinskii); Iwan, J. Applied Mechanics 33 "
    "(1966) 893-900; Wen, J. Eng. Mech. 102 (1976) 249-263",
    parameters=(
        Parameter("force_n", "N", 0.0, 1e-3, 10.0, True, meaning="half width of a loop at a static force of 3 N"),
        Parameter(
            "yield_m", "m", None, SHORTEST_YIELD_M, 5e-3, True, meaning="displacement at which half of it yields"
        ),
        Parameter("growth", "1", None, 0.0, 2.0, prior=0.5, prior_std=0.5, meaning="power of the static force"),
        Parameter("bristle_share", "1", None, 0.0, 1.0, prior=0.3, prior_std=0.5, meaning="share of creeping loops"),
        Parameter("spread", "1", None, 0.0, 2.5, prior=1.0, prior_std=0.5, meaning="spread of the log yield lengths"),
    ),
    starts=((0.1, 5e-5, 0.5, 0.3, 1.0), (0.3, 4e-4, 0.5, 0.3, 1.0)),
    mistaken_for=("dry_friction", "viscoelasticity", "sensor_backlash", "directional_friction"),
    places=(bus.TISSUE,),
    hook=hook,
    on_spring=False,
    remedy="Report loading and unloading separately; precondition the tissue with a few slow cycles.",
)
