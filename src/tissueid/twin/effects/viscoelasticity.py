"""Relaxation of the tissue: branches of springs and dashpots, up to a power law."""

from __future__ import annotations

import math

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter

BRANCHES = 7
REFERENCE_M = 4e-3
_FORCE = BRANCHES
_KEPT = BRANCHES + 1
_MEAN = _KEPT + BRANCHES
_WEIGHT = _MEAN + BRANCHES
_WHOLE = _WEIGHT + BRANCHES
_BEGUN = _WHOLE + 1


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Add relaxation branches, driven by changes of a depth-dependent force, each with its own time constant."""
    depth = b[bus.DEPTH]
    # In proportion to the static force (exponent 1, quasi-linear) or to depth (0), equal at the reference depth.
    exponent = b[bus.STIFFNESS_GROWTH] * (REFERENCE_M + p[3] * (depth - REFERENCE_M))
    force = b[bus.STIFFNESS] * math.exp(min(max(exponent, -12.0), 12.0)) * depth
    if s[_BEGUN] == 0.0:
        # Relaxed at the start of a test.
        s[_BEGUN] = 1.0
        s[_FORCE] = force
        for k in range(BRANCHES):
            longer = 10.0 ** (p[2] * (k / (BRANCHES - 1.0) - 0.5))
            ratio = dt / (p[1] * longer)
            s[_KEPT + k] = math.exp(-ratio)
            s[_MEAN + k] = (1.0 - math.exp(-ratio)) / ratio
            s[_WEIGHT + k] = longer ** -p[4]
            s[_WHOLE] += s[_WEIGHT + k]
    change = force - s[_FORCE]
    s[_FORCE] = force
    total = 0.0
    for k in range(BRANCHES):
        s[k] = s[k] * s[_KEPT + k] + change * s[_MEAN + k]
        total += s[_WEIGHT + k] * s[k]
    b[bus.TISSUE_FORCE] += p[0] * total / s[_WHOLE]


EFFECT = Effect(
    name="viscoelasticity",
    stage="tissue",
    title="Relaxation of the tissue",
    equation="F = Fe + r mean of q_k, dq_k/dt = df/dt - q_k / T_k, f = K exp(g (4 mm + h (d - 4 mm))) d, seven T_k "
    "spread evenly over D decades round T, weighed by T_k^-a; vanishes with r = 0",
    signature="stiffness rises with frequency more than damping alone explains, with phase over a wide band; creep "
    "after the mean is switched on; linear in small motion; nothing on the spring",
    source="Fung, Biomechanics (1993), ch. 7 (quasi-linear viscoelasticity, continuous spectrum); thesis 3.3",
    parameters=(
        Parameter("ratio", "1", 0.0, 3e-4, 20.0, True, meaning="stiffness of all branches relative to the static one"),
        Parameter("time_s", "s", None, 2e-3, 5.0, True, meaning="middle of the relaxation times"),
        Parameter("decades", "1", None, 0.0, 5.0, prior=2.0, prior_std=1.5, meaning="spread of the relaxation times"),
        Parameter("growth", "1", None, 0.0, 1.5, prior=0.7, prior_std=0.5, meaning="growth, 1 as the static force"),
        Parameter(
            "tilt", "1", None, -0.5, 1.0, prior=0.1, prior_std=0.3, meaning="exponent that weakens slow branches"
        ),
    ),
    starts=((0.3, 0.02, 0.5, 0.7, 0.1), (0.3, 0.1, 2.0, 0.7, 0.1), (0.3, 0.5, 0.5, 0.7, 0.1)),
    mistaken_for=("preconditioning", "tissue_hysteresis", "mount_resonance", "added_mass"),
    places=(bus.TISSUE,),
    hook=hook,
    on_spring=False,
    in_living_tissue=True,
    remedy="Report the relaxation times with the stiffness; let the tissue rest under the mean before the test.",
)
