"""Breathing, pulse and tremor move the surface under the probe."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from scipy import optimize

from tissueid.twin import _estimates, bus
from tissueid.twin.effect import Effect, FloatArray, Parameter

KINDS = (
    ("breathing", (0.1, 0.5), (1, 2), 5e-3),
    ("pulse", (0.8, 2.0), (1, 2, 3, 4, 5), 1e-3),
    ("tremor", (7.0, 13.0), (1,), 1e-3),
)
"""Name, frequencies, harmonics and the most that is looked for."""

STEP_HZ = 0.04
"""Of the search for breathing and pulse: a fifth of what a test of 4.5 s tells apart."""
FEWEST = 40
"""Means over 5 ms without which there is nothing to see."""
TURNING = 12
"""State: whether the waves have begun."""


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Eight waves; harmonics from their fundamental's by the sum of angles. In the middle of the step, as position.

    ``s`` holds cosine and sine of each kind, and of how far a step turns them, so that only the first step reckons any.
    """
    if s[TURNING] == 0.0:
        s[TURNING] = 1.0
        for kind in range(3):
            angle = 2.0 * math.pi * p[kind] * (b[bus.TIME] + 0.5 * dt)
            turn = 2.0 * math.pi * p[kind] * dt
            s[4 * kind], s[4 * kind + 1] = math.cos(angle), math.sin(angle)
            s[4 * kind + 2], s[4 * kind + 3] = math.cos(turn), math.sin(turn)
    moved = 0.0
    for kind, first, last in ((0, 3, 7), (1, 7, 17), (2, 17, 19)):
        cosine, sine, turned, across = s[4 * kind], s[4 * kind + 1], s[4 * kind + 2], s[4 * kind + 3]
        real, imaginary = cosine, sine
        for k in range(first, last, 2):
            moved += p[k] * real + p[k + 1] * imaginary
            real, imaginary = real * cosine - imaginary * sine, imaginary * cosine + real * sine
        s[4 * kind] = cosine * turned - sine * across
        s[4 * kind + 1] = sine * turned + cosine * across
    b[bus.SURFACE_POSITION] += moved


def from_test(signals: Mapping[str, FloatArray], sample_rate_hz: float) -> Mapping[str, float]:
    """Read off what is unexplained of the position: a probe follows slow motion of the surface.

    Breathing and pulse overlap in a record of a few seconds, so both are looked for at once.
    """
    left = _estimates.unexplained(signals, "position", sample_rate_hz)
    every = max(1, round(sample_rate_hz / 200.0))
    blocks = left[: left.size // every * every].reshape(-1, every)
    known = (blocks != 0.0).any(axis=1)
    left = blocks.mean(axis=1)[known].astype(np.float64)
    time = ((np.flatnonzero(known) * every + 0.5 * (every + 1)) / sample_rate_hz).astype(np.float64)
    orders = [harmonics for _, _, harmonics, _ in KINDS]
    bands = [band for _, band, _, _ in KINDS]

    def fitted(hertz: Sequence[float] | FloatArray) -> tuple[float, FloatArray]:
        return _estimates.fitted(left, time, list(zip(hertz, orders, strict=False)))

    best: FloatArray = np.array(bands, np.float64).mean(axis=1)
    heights = np.zeros(2 * sum(len(harmonics) for harmonics in orders))
    if left.size >= FEWEST:
        slow = [np.arange(low, high, STEP_HZ) for low, high in bands[:2]]
        pairs = [(breathing, pulse) for breathing in slow[0] for pulse in slow[1]]
        best[:2] = pairs[int(np.argmax([fitted(pair)[0] for pair in pairs]))]
        swaying = [_estimates.waves(time, one, harmonics) for one, harmonics in zip(best, orders[:2], strict=False)]
        trembling = left - np.concatenate(swaying, axis=1) @ fitted(best[:2])[1]
        best[2] = _estimates.line(trembling, time, orders[2], *bands[2])[0]
        around = np.clip(best + STEP_HZ * np.vstack((np.zeros(3), np.diag((0.5, 0.5, 0.2)))), *np.transpose(bands))
        found = optimize.minimize(
            lambda hertz: -fitted(hertz)[0] / float(left @ left),
            best,
            method="Nelder-Mead",
            bounds=bands,
            options={"initial_simplex": around, "maxfev": 120, "xatol": 1e-4, "fatol": 1e-7},
        )
        best = np.asarray(found.x, np.float64)
        heights = fitted(best)[1]
    most = np.concatenate([np.full(2 * len(harmonics), limit) for _, _, harmonics, limit in KINDS])
    names = [name for kind, _, harmonics, _ in KINDS for name in _names(kind, harmonics)]
    start = {f"{kind}_hz": float(hertz) for (kind, *_), hertz in zip(KINDS, best, strict=True)}
    return start | dict(zip(names, np.clip(heights, -most, most).tolist(), strict=True))


def _names(kind: str, harmonics: tuple[int, ...]) -> list[str]:
    return [f"{kind}_{part}_{h}_m" for h in harmonics for part in ("cosine", "sine")]


EFFECT = Effect(
    name="physiological_motion",
    stage="environment",
    title="Breathing, pulse or tremor moves the surface",
    equation="surface + sum of a cos(h w t) + b sin(h w t) over breathing (h = 1, 2), pulse (1 to 5) and tremor (1); "
    "vanishes with every a = b = 0",
    signature="position sways at 0.1 to 0.5, 0.8 to 2 or 8 to 12 Hz, in quiet tests as well and whatever the command, "
    "with other phases in every test; none of it on the spring",
    source="Fung, Biomechanics: Circulation (1997), ch. 3 (pulse); Elble & Koller, Tremor (1990), ch. 2",
    parameters=(
        *(
            Parameter(f"{kind}_hz", "Hz", None, low, high, per_test=True, fixed=True, meaning="read off the record")
            for kind, (low, high), _, _ in KINDS
        ),
        *(
            Parameter(
                name, "m", 0.0, -most, most, per_test=True, prior=0.0, prior_std=0.1 * most, meaning="of the surface"
            )
            for kind, _, harmonics, most in KINDS
            for name in _names(kind, harmonics)
        ),
    ),
    starts=((0.25, 1.2, 10.0) + (0.0,) * 16,),
    mistaken_for=("preconditioning", "reflex", "mount_resonance", "mains_hum"),
    places=(bus.SURFACE,),
    hook=hook,
    needs=frozenset({"position"}),
    from_test=from_test,
    on_spring=False,
    jointly=True,
    remedy="Have the subject hold the breath; rest the limb; test longer or average over pulses.",
)
