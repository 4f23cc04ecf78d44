"""Inductance of the coil that changes along the stroke."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from tissueid.messages import Message
from tissueid.twin import bus
from tissueid.twin._interpolation import along, travelled_range
from tissueid.twin.effect import Effect, FloatArray, Parameter

KNOTS = 5
_FIRST = 3
_DISTANCE = 0.01
"""Share of the range over which the slope of the curve is taken."""
RISES = (-0.3, 0.3)
FORCE_SHARES = (0.02, 0.9)


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Apply the inductance along the stroke with its voltage and force; ``s[0]`` is its slope, H/m."""
    if where == bus.COIL:
        span = p[1] - p[0]
        share = (b[bus.POSITION] - p[0]) / span
        rise = along(p, _FIRST, KNOTS, share + _DISTANCE) - along(p, _FIRST, KNOTS, share - _DISTANCE)
        s[0] = b[bus.INDUCTANCE] * rise / (2.0 * _DISTANCE * span)
        b[bus.INDUCTANCE] *= along(p, _FIRST, KNOTS, share)
        b[bus.OPPOSING_VOLTAGE] += s[0] * b[bus.VELOCITY] * b[bus.CURRENT]
    else:
        b[bus.FORCE] += 0.5 * p[2] * s[0] * b[bus.CURRENT] * b[bus.CURRENT]


def _sloping(low_m: float, high_m: float) -> tuple[tuple[float, ...], ...]:
    middle = (KNOTS - 1) / 2.0
    return tuple(
        (low_m, high_m, share, *(1.0 + rise * (k - middle) / middle for k in range(KNOTS)))
        for rise in RISES
        for share in FORCE_SHARES
    )


def over_the_range(tests: Sequence[Mapping[str, FloatArray]], sample_rate_hz: float) -> tuple[tuple[float, ...], ...]:
    """Return starting points with knots over the range of the probe."""
    ends = travelled_range(tests)
    return () if ends is None else _sloping(*ends)


def _share_at(k: int) -> Message:
    return Message("effect.share_at", "share of nominal at {place} of the curve", place=f"{k}/{KNOTS - 1}")


EFFECT = Effect(
    name="inductance_position",
    stage="coil",
    title="Inductance changes along the stroke",
    equation="v = R i + L i' + L' x' i, F = s L' i^2/2, L = L0 c(x), c a smooth curve through five shares over the "
    "range that the probe reached; vanishes with all of them 1",
    signature="current against voltage at high frequencies, more at one end of the stroke than at the other: the lag of"
    " current follows position; resistance unchanged; a force with the square of current that follows from "
    "conservation of energy, unless iron elsewhere compensates it",
    source="Klippel, J. Audio Eng. Soc. 54 (2006) 907; Woodson and Melcher, Electromechanical Dynamics I (1968) ch. 3",
    parameters=(
        Parameter("low_m", "m", None, -0.05, 0.1, fixed=True, meaning="position where the curve begins"),
        Parameter("high_m", "m", None, -0.05, 0.1, fixed=True, meaning="position where the curve ends"),
        Parameter("force_share", "1", None, 0.0, 1.0, meaning="share of the reluctance force that acts"),
        *(
            Parameter(f"share_{k}", "1", 1.0, 0.05, 6.0, prior=1.0, prior_std=0.5, meaning=_share_at(k))
            for k in range(KNOTS)
        ),
    ),
    starts=(_sloping(0.0, 0.032)[0],),
    mistaken_for=("eddy_currents", "force_constant_position", "reluctance_force"),
    places=(bus.COIL, bus.MECHANICS),
    starts_from=over_the_range,
    jointly=True,
    hook=hook,
    needs=frozenset({"current"}),
    remedy="Measure the blocked coil's impedance at several places along the stroke.",
)
