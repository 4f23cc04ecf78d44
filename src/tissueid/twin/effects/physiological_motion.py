"""Breathing, pulse and tremor move the surface under the probe."""

from __future__ import annotations

import math

from tissueid.twin import _sway, bus
from tissueid.twin.effect import Effect, FloatArray, Parameter

_BREATHING = len(_sway.RATES)
"""Place of the first height of each kind among the parameters, and of the mean after them."""
_PULSE = _BREATHING + len(_sway.HEIGHTS[_sway.BREATHING])
_TREMOR = _PULSE + len(_sway.HEIGHTS[_sway.PULSE])
_MEAN = _TREMOR + len(_sway.HEIGHTS[_sway.TREMOR])
_TURNING = 16
"""State: whether the waves have begun."""
_UNITS = ("Hz", "Hz", "Hz", "rad", "rad", "Hz")


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Thirteen waves; harmonics from their fundamental's by the sum of angles. In the middle of the step, as position.

    ``s`` holds cosine and sine of each rate, and of how far a step turns them, so that only the first step reckons
    any; but the pulse's, which breathing sways, are reckoned at every step.
    """
    if s[_TURNING] == 0.0:
        s[_TURNING] = 1.0
        for rate in range(4):
            hertz = p[rate] if rate < 3 else p[5]
            angle = 2.0 * math.pi * hertz * (b[bus.TIME] + 0.5 * dt)
            turn = 2.0 * math.pi * hertz * dt
            s[4 * rate], s[4 * rate + 1] = math.cos(angle), math.sin(angle)
            s[4 * rate + 2], s[4 * rate + 3] = math.cos(turn), math.sin(turn)
    moved = 0.0
    sway = p[3] * s[0] + p[4] * s[1]
    for kind, first, last in ((0, _BREATHING, _PULSE), (1, _PULSE, _TREMOR)):
        cosine, sine = s[4 * kind], s[4 * kind + 1]
        if kind == 1:
            forward, aside = math.cos(sway), math.sin(sway)
            cosine, sine = cosine * forward - sine * aside, sine * forward + cosine * aside
        real, imaginary = cosine, sine
        for k in range(first, last, 2):
            moved += p[k] * real + p[k + 1] * imaginary
            real, imaginary = real * cosine - imaginary * sine, imaginary * cosine + real * sine
    # Lines of tremor side by side: the first two spacings below the middle one, the last two above.
    apart, across = s[12], s[13]
    real, imaginary = s[8], s[9]
    for _ in range(2):
        real, imaginary = real * apart + imaginary * across, imaginary * apart - real * across
    for k in range(_TREMOR, _MEAN, 2):
        moved += p[k] * real + p[k + 1] * imaginary
        real, imaginary = real * apart - imaginary * across, imaginary * apart + real * across
    for rate in range(4):
        cosine, sine, turned, aside = s[4 * rate], s[4 * rate + 1], s[4 * rate + 2], s[4 * rate + 3]
        s[4 * rate] = cosine * turned - sine * aside
        s[4 * rate + 1] = sine * turned + cosine * aside
    b[bus.SURFACE_POSITION] += moved + p[_MEAN]


EFFECT = Effect(
    name="physiological_motion",
    stage="environment",
    title="Breathing, pulse or tremor moves the surface",
    equation="surface + m + sum of a cos(h x) + b sin(h x) over breathing (x = w t, h = 1 to 3), pulse (x = w t + "
    "c cos(breathing) + d sin(breathing), h = 1 to 5) and five lines of tremor side by side; vanishes with m and every "
    "a = b = 0",
    signature="position sways at 0.1 to 0.5, 0.8 to 2 or 8 to 12 Hz, in quiet tests as well and whatever the command, "
    "with other phases in every test; none of it on the spring",
    source="Fung, Biomechanics: Circulation (1997), ch. 3 (pulse); Hirsch & Bishop, Am. J. Physiol. 241 (1981) "
    "H620-H629 (breathing sways the pulse); Elble & Koller, Tremor (1990), ch. 2",
    parameters=(
        *(
            Parameter(name, unit, None, *bounds, per_test=True, fixed=True, meaning="read off the record")
            for name, unit, bounds in zip(_sway.RATES, _UNITS, _sway.RATE_BOUNDS, strict=True)
        ),
        *(
            Parameter(name, "m", 0.0, -most, most, per_test=True, prior=0.0, prior_std=std, meaning="of the surface")
            for names, likely, most in zip(_sway.HEIGHTS, _sway.LIKELY_M, _sway.MOST_M, strict=True)
            for name, std in zip(names, likely, strict=True)
        ),
        Parameter(
            _sway.MEAN,
            "m",
            0.0,
            -_sway.MOST_M[0],
            _sway.MOST_M[0],
            per_test=True,
            prior=0.0,
            prior_std=0.1 * _sway.MOST_M[0],
            meaning="by which the surface stands higher than when it was found",
        ),
    ),
    starts=(_sway.BEGINNING + (0.0,) * (_MEAN + 1 - _BREATHING),),
    mistaken_for=("preconditioning", "reflex", "mount_resonance", "mains_hum"),
    places=(bus.SURFACE,),
    hook=hook,
    needs=frozenset({"position"}),
    from_tests=_sway.read,
    read_again=True,
    on_spring=False,
    jointly=True,
    remedy="Have the subject hold the breath; rest the limb; test longer or average over pulses.",
)
