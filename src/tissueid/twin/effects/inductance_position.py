"""The coil's inductance depends on where it stands in the magnet."""

from __future__ import annotations

import math

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter

MOST_EXPONENT = 4.0


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Inductance exponential along the stroke, with the voltage and the force of its change; ``s[0]`` is its slope."""
    slope, reference, share = p[0], p[1], p[2]
    if where == bus.COIL:
        # Bounded without a corner.
        bounded = math.tanh(slope * (b[bus.POSITION] - reference) / MOST_EXPONENT)
        b[bus.INDUCTANCE] *= math.exp(MOST_EXPONENT * bounded)
        s[0] = slope * (1.0 - bounded * bounded) * b[bus.INDUCTANCE]
        b[bus.OPPOSING_VOLTAGE] += s[0] * b[bus.VELOCITY] * b[bus.CURRENT]
    else:
        b[bus.FORCE] += 0.5 * share * s[0] * b[bus.CURRENT] * b[bus.CURRENT]


EFFECT = Effect(
    name="inductance_position",
    stage="coil",
    title="Inductance changes along the stroke",
    equation="v = R i + L i' + L' x' i, F = s L' i^2/2, L = L0 exp(a (x - x0)); vanishes with a = 0",
    signature="current against voltage at high frequencies, more at one end of the stroke than at the other: the lag "
    "of current follows position; resistance unchanged; a force with the square "
    "of current that energy demands, unless iron elsewhere makes up for it",
    source="Klippel, J. Audio Eng. Soc. 54 (2006) 907; Woodson and Melcher, Electromechanical Dynamics I (1968) ch. 3",
    parameters=(
        Parameter("slope_per_m", "1/m", 0.0, -400.0, 400.0, meaning="relative change of inductance per metre"),
        Parameter("reference_m", "m", None, -0.02, 0.05, prior=0.014, prior_std=0.015, meaning="where it is nominal"),
        Parameter("force_share", "1", None, 0.0, 1.0, meaning="of the force that the change of inductance makes"),
    ),
    starts=((40.0, 0.006, 0.02), (-40.0, 0.02, 0.02), (40.0, 0.014, 0.9), (-40.0, 0.014, 0.9)),
    mistaken_for=("eddy_currents", "force_constant_position", "reluctance_force"),
    places=(bus.COIL, bus.MECHANICS),
    hook=hook,
    needs=frozenset({"current"}),
    remedy="Measure the blocked coil's impedance at several places along the stroke.",
)
