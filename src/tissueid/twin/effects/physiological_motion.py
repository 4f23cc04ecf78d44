"""Breathing, pulse and tremor move the surface under the probe."""

from __future__ import annotations

import math

from tissueid.twin import _body_motion, bus
from tissueid.twin.effect import Effect, FloatArray, Parameter

_BREATHING = len(_body_motion.RATES)
"""Index of the first height of each kind among the parameters, and of the mean after them."""
_PULSE = _BREATHING + len(_body_motion.HEIGHTS[_body_motion.BREATHING])
_TREMOR = _PULSE + len(_body_motion.HEIGHTS[_body_motion.PULSE])
_MEAN = _TREMOR + len(_body_motion.HEIGHTS[_body_motion.TREMOR])
_TURNING = 16
"""State: whether the waves are initialised."""
_UNITS = ("Hz", "Hz", "Hz", "rad", "rad", "Hz")


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Move the surface by thirteen waves at the middle of the step; harmonics follow from the fundamental.

    ``s`` holds cosine and sine of each rate and of its change in a step, so that only the first step evaluates them.
    The pulse, which breathing modulates, is evaluated at every step.
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
    # Lines of tremor: the first two below the middle one, the last two above.
    cosine, sine = s[12], s[13]
    real, imaginary = s[8], s[9]
    for _ in range(2):
        real, imaginary = real * cosine + imaginary * sine, imaginary * cosine - real * sine
    for k in range(_TREMOR, _MEAN, 2):
        moved += p[k] * real + p[k + 1] * imaginary
        real, imaginary = real * cosine - imaginary * sine, imaginary * cosine + real * sine
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
    signature="position oscillates at 0.1 to 0.5, 0.8 to 2 or 8 to 12 Hz, in quiet tests as well and independent of the"
    " command, with different phases in every test; not on the spring",
    source="Fung, Biomechanics: Circulation (1997), ch. 3 (pulse); Hirsch & Bishop, Am. J. Physiol. 241 (1981) "
    "H620-H629 (breathing sways the pulse); Elble & Koller, Tremor (1990), ch. 2",
    parameters=(
        *(
            Parameter(name, unit, None, *bounds, per_test=True, fixed=True, meaning="estimated from the record")
            for name, unit, bounds in zip(_body_motion.RATES, _UNITS, _body_motion.RATE_BOUNDS, strict=True)
        ),
        *(
            Parameter(name, "m", 0.0, -most, most, per_test=True, prior=0.0, prior_std=std, meaning="surface motion")
            for names, likely, most in zip(
                _body_motion.HEIGHTS, _body_motion.LIKELY_M, _body_motion.MOST_M, strict=True
            )
            for name, std in zip(names, likely, strict=True)
        ),
        Parameter(
            _body_motion.MEAN,
            "m",
            0.0,
            -_body_motion.MOST_M[0],
            _body_motion.MOST_M[0],
            per_test=True,
            prior=0.0,
            prior_std=0.1 * _body_motion.MOST_M[0],
            meaning="mean height above the found surface",
        ),
    ),
    starts=(_body_motion.BEGINNING + (0.0,) * (_MEAN + 1 - _BREATHING),),
    mistaken_for=("preconditioning", "reflex", "mount_resonance", "mains_hum"),
    places=(bus.SURFACE,),
    hook=hook,
    needs=frozenset({"position"}),
    estimate_from_records=_body_motion.read,
    re_estimate=True,
    on_spring=False,
    jointly=True,
    remedy="Ask the subject to hold the breath; support the limb; test longer or average over pulses.",
)
