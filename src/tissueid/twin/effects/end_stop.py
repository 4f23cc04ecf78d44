"""Contact with an end of the stroke."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter

CORNER_M = 1e-5
"""Half the width of the onset of contact, m, as of rubber or a burr; it keeps the fit smooth."""
REFERENCE_M = 1e-4
INNER, OUTER = 1.0, -1.0


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Add the force of a dissipative one-sided stop."""
    stop, force, exponent, loss = p[0], p[1], p[2], p[3]
    side = 1.0 if p[4] > 0.0 else -1.0
    past = (b[bus.POSITION] - stop) * side
    if past <= -CORNER_M:
        return
    # The onset is a parabola.
    into = past if past > CORNER_M else (past + CORNER_M) ** 2 / (4.0 * CORNER_M)
    into = min(into / REFERENCE_M, 50.0)
    velocity = side * (b[bus.VELOCITY] + 0.5 * dt * b[bus.ACCELERATION])
    b[bus.FORCE] -= side * force * into**exponent * min(max(1.0 + loss * velocity, 0.0), 20.0)


def starts_at_travel_ends(
    tests: Sequence[Mapping[str, FloatArray]], sample_rate_hz: float
) -> tuple[tuple[float, ...], ...]:
    """Return starting points at both ends of the travel, for a hard stop and for a soft one further in."""
    starts: list[tuple[float, ...]] = []
    travelled = [test["position"][np.isfinite(test["position"])] for test in tests if "position" in test]
    travelled = [position for position in travelled if position.size]
    if not travelled:
        return ()
    everything = np.concatenate(travelled)
    begun = float(np.max([position[0] for position in travelled]))
    deepest = float(np.max(everything))
    if deepest > begun:
        inner = float(np.percentile(everything[everything > begun], 97.0))
        starts += [(deepest - 5e-5, 5.0, 1.25, 10.0, INNER), (inner, 0.3, 1.25, 3.0, INNER)]
    least = float(np.min(everything))
    if least < begun:
        starts.append((least + 5e-5, 5.0, 1.25, 10.0, OUTER))
    return tuple(starts)


EFFECT = Effect(
    name="end_stop",
    stage="mechanics",
    title="Contact with the end of the stroke",
    equation="F = -F1 (u / 0.1 mm)^n (1 + c du/dt), not below 0, u = how far x is past the stop, towards "
    "greater depth (side 1) or outward (side -1); vanishes with F1 = 0 and with the stop out of reach",
    signature="position cut off at one value, the same in every test, with short impacts; nothing away from it; "
    "current shows the impacts by back-EMF",
    source="Hunt & Crossley, J. Applied Mechanics 42 (1975) 440-445",
    parameters=(
        Parameter("stop_m", "m", None, -0.004, 0.034, meaning="position of the stop", scales_with=("stroke_m", 1)),
        Parameter("force_n", "N", 0.0, 1e-4, 100.0, True, meaning="static force 0.1 mm past the stop"),
        Parameter(
            "exponent",
            "1",
            None,
            1.0,
            2.0,
            prior=1.25,
            prior_std=0.25,
            meaning="exponent: 1 a spring, 1.5 a round contact",
        ),
        Parameter(
            "loss_s_per_m", "s/m", None, 0.1, 300.0, True, meaning="relative increase of force with penetration speed"
        ),
        Parameter("side", "1", None, -2.0, 2.0, fixed=True, meaning="end of the stroke: 1 the inner, −1 the outer"),
    ),
    starts=(
        (0.0115, 2.0, 1.2, 5.0, INNER),
        (0.0130, 2.0, 1.2, 5.0, INNER),
        (0.0143, 2.0, 1.2, 5.0, INNER),
        (0.0085, 2.0, 1.2, 5.0, OUTER),
    ),
    mistaken_for=("tissue_stiffening", "sensor_nonlinearity", "amplifier_clipping"),
    places=(bus.MECHANICS,),
    hook=hook,
    starts_from=starts_at_travel_ends,
    remedy="Bring the device nearer to the surface, or press less deep, so that the probe does not reach the end of "
    "the stroke.",
)
