"""Force constant, and back-EMF, that change along the stroke."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from tissueid.messages import Message
from tissueid.twin import bus
from tissueid.twin._interpolation import along, travelled_range
from tissueid.twin.effect import Effect, FloatArray, Parameter

KNOTS = 7
_FIRST = 2
SLOPES = (-0.1, 0.1)
"""Slopes of the starting points, relative to the constant over half the range."""


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Apply a smooth curve of shares of the nominal constant over the range of the probe."""
    b[bus.FORCE_CONSTANT] *= along(p, _FIRST, KNOTS, (b[bus.POSITION] - p[0]) / (p[1] - p[0]))


def _sloping(low_m: float, high_m: float) -> tuple[tuple[float, ...], ...]:
    middle = (KNOTS - 1) / 2.0
    return tuple((low_m, high_m, *(1.0 + slope * (k - middle) / middle for k in range(KNOTS))) for slope in SLOPES)


def over_the_range(tests: Sequence[Mapping[str, FloatArray]], sample_rate_hz: float) -> tuple[tuple[float, ...], ...]:
    """Return starting points with knots over the range of the probe."""
    ends = travelled_range(tests)
    return () if ends is None else _sloping(*ends)


def _share_at(k: int) -> Message:
    return Message("effect.share_at", "share of nominal at {place} of the curve", place=f"{k}/{KNOTS - 1}")


EFFECT = Effect(
    name="force_constant_position",
    stage="coil",
    title="The force constant changes along the stroke",
    equation="kf = kf0 c(x), in force and back-EMF alike, c a smooth curve through seven shares over the range that "
    "the probe reached; vanishes with all of them 1",
    signature="force per ampere and back-EMF fall together with position, static force curve bent in the ramp; current "
    "rises where the probe moves fast far from the plateau; on the spring as well",
    source="Chen, MIT thesis (2010) 2.3; Klippel, J. Audio Eng. Soc. 54 (2006) 907-939 (force factor)",
    parameters=(
        Parameter("low_m", "m", None, -0.05, 0.1, fixed=True, meaning="position where the curve begins"),
        Parameter("high_m", "m", None, -0.05, 0.1, fixed=True, meaning="position where the curve ends"),
        *(
            Parameter(f"share_{k}", "1", 1.0, 0.05, 3.0, prior=1.0, prior_std=0.3, meaning=_share_at(k))
            for k in range(KNOTS)
        ),
    ),
    starts=(_sloping(0.0, 0.032)[0],),
    mistaken_for=("tissue_stiffening", "flux_saturation", "sensor_nonlinearity"),
    places=(bus.COIL,),
    starts_from=over_the_range,
    jointly=True,
    hook=hook,
    remedy="Run the dynamic sweep along the stroke and activate its force-constant table.",
)
