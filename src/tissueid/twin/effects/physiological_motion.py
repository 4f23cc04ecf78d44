"""Breathing, pulse and tremor move the surface under the probe."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

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

_BANDS = [band for _, band, _, _ in KINDS]
_ORDERS = [harmonics for _, _, harmonics, _ in KINDS]
NEAR_HZ = (0.05, 0.15, 0.5)
"""So far a test's own rates may lie from those of the session."""
STEP_HZ = 0.04
"""Of the search for breathing and pulse: a fifth of what a test of 4.5 s tells apart."""
FEWEST = 40
"""Means over 5 ms without which there is nothing to see."""
TURNING = 12
"""State: whether the waves have begun."""


def _names(kind: str, harmonics: tuple[int, ...]) -> list[str]:
    return [f"{kind}_{part}_{h}_m" for h in harmonics for part in ("cosine", "sine")]


_HEIGHTS = [*(name for kind, _, harmonics, _ in KINDS for name in _names(kind, harmonics)), "mean_m"]
_MOST = np.array(
    [*(most for _, _, harmonics, most in KINDS for _ in range(2 * len(harmonics))), KINDS[0][3]], np.float64
)


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
    b[bus.SURFACE_POSITION] += moved + p[19]


def from_tests(tests: Sequence[Mapping[str, FloatArray]], sample_rate_hz: float) -> Sequence[Mapping[str, float]]:
    """Read off what is unexplained of the positions: a probe follows slow motion of the surface.

    Breathing and pulse overlap in a record of a few seconds, so both are looked for at once. Their rates are looked for
    in all tests together, of which a quiet one tells most, and then near there in each.
    """
    swaying = [_Sway.of(signals, sample_rate_hz) for signals in tests]
    seen = [sway for sway in swaying if sway.left.size >= FEWEST]
    middle: FloatArray = np.array(_BANDS, np.float64).mean(axis=1)
    shared = _refined(_roughly(seen), seen) if seen else middle
    return [sway.read(_refined(shared, [sway], NEAR_HZ) if sway.left.size >= FEWEST else shared) for sway in swaying]


def _roughly(seen: Sequence[_Sway]) -> FloatArray:
    # Rates of breathing and pulse on a grid, then that of tremor in what these leave.
    slow = [np.arange(low, high, STEP_HZ) for low, high in _BANDS[:2]]
    pairs = [(breathing, pulse) for breathing in slow[0] for pulse in slow[1]]
    breathing, pulse = pairs[int(np.argmax([sum(sway.told(pair) for sway in seen) for pair in pairs]))]
    fast = np.arange(*_BANDS[2], STEP_HZ)
    trembling = [sway.without((breathing, pulse)) for sway in seen]
    tremor = fast[int(np.argmax([sum(sway.trembles(hertz) for sway in trembling) for hertz in fast]))]
    return np.array([breathing, pulse, tremor], np.float64)


def _refined(about: FloatArray, seen: Sequence[_Sway], near_hz: Sequence[float] = (1.0, 1.0, 1.0)) -> FloatArray:
    bands = [
        (max(low, at - near), min(high, at + near))
        for (low, high), at, near in zip(_BANDS, about, near_hz, strict=True)
    ]
    found = optimize.minimize(
        lambda hertz: -sum(sway.told(hertz) for sway in seen),
        about,
        method="Nelder-Mead",
        bounds=bands,
        options={
            "initial_simplex": np.clip(
                about + STEP_HZ * np.vstack((np.zeros(3), np.diag((0.5, 0.5, 0.2)))), *np.transpose(bands)
            ),
            "maxfev": 120,
            "xatol": 1e-4,
            "fatol": 1e-4,
        },
    )
    return np.asarray(found.x, np.float64)


@dataclass(frozen=True)
class _Sway:
    """What is unexplained of a position, as means over 5 ms: shape (n,), m, about ``mean_m``, and their times, s."""

    left: FloatArray
    time: FloatArray
    mean_m: float = 0.0

    @classmethod
    def of(cls, signals: Mapping[str, FloatArray], sample_rate_hz: float) -> _Sway:
        left = _estimates.unexplained(signals, "position", sample_rate_hz)
        predicted = signals.get("predicted_position")
        apart = np.zeros(1) if predicted is None else (signals["position"] - predicted)[left != 0.0]
        every = max(1, round(sample_rate_hz / 200.0))
        blocks = left[: left.size // every * every].reshape(-1, every)
        known = (blocks != 0.0).any(axis=1)
        time = (np.flatnonzero(known) * every + 0.5 * (every + 1)) / sample_rate_hz
        mean = float(apart.mean()) if apart.size and np.isfinite(apart).all() else 0.0
        return cls(blocks.mean(axis=1)[known].astype(np.float64), time.astype(np.float64), mean)

    def read(self, hertz: FloatArray) -> Mapping[str, float]:
        """The parameters of the effect in this test, within their bounds; no heights where there is little to see."""
        values = np.zeros(_MOST.size)
        if self.left.size >= FEWEST:
            values = np.append(self.fitted(hertz)[1], self.mean_m + float(self.without(hertz).left.mean()))
        rates = {f"{kind}_hz": float(one) for (kind, *_), one in zip(KINDS, hertz, strict=True)}
        return rates | dict(zip(_HEIGHTS, np.clip(values, -_MOST, _MOST).tolist(), strict=True))

    def fitted(self, hertz: Sequence[float] | FloatArray) -> tuple[float, FloatArray]:
        """Squares that waves at the rates of the first kinds take away, and the waves' heights."""
        return _estimates.fitted(self.left, self.time, list(zip(hertz, _ORDERS, strict=False)))

    def told(self, hertz: Sequence[float] | FloatArray) -> float:
        """Likelihood of these rates, nats: a quiet test tells more than one in which much else is unexplained."""
        return self._likelihood(self.fitted(hertz)[0])

    def trembles(self, hertz: float) -> float:
        """The same of tremor alone."""
        return self._likelihood(_estimates.fitted(self.left, self.time, [(hertz, _ORDERS[2])])[0])

    def without(self, hertz: Sequence[float] | FloatArray) -> _Sway:
        """What waves at the rates of the first kinds leave."""
        waves = [_estimates.waves(self.time, one, orders) for one, orders in zip(hertz, _ORDERS, strict=False)]
        return _Sway(self.left - np.concatenate(waves, axis=1) @ self.fitted(hertz)[1], self.time)

    def _likelihood(self, taken: float) -> float:
        total = float(self.left @ self.left)
        return -0.5 * self.left.size * float(np.log(max(1.0 - taken / total, 1e-12))) if total > 0.0 else 0.0


EFFECT = Effect(
    name="physiological_motion",
    stage="environment",
    title="Breathing, pulse or tremor moves the surface",
    equation="surface + m + sum of a cos(h w t) + b sin(h w t) over breathing (h = 1, 2), pulse (1 to 5) and tremor "
    "(1); vanishes with m and every a = b = 0",
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
        Parameter(
            "mean_m",
            "m",
            0.0,
            -KINDS[0][3],
            KINDS[0][3],
            per_test=True,
            prior=0.0,
            prior_std=0.1 * KINDS[0][3],
            meaning="by which the surface stands higher than when it was found",
        ),
    ),
    starts=((0.25, 1.2, 10.0) + (0.0,) * 17,),
    mistaken_for=("preconditioning", "reflex", "mount_resonance", "mains_hum"),
    places=(bus.SURFACE,),
    hook=hook,
    needs=frozenset({"position"}),
    from_tests=from_tests,
    read_again=True,
    on_spring=False,
    jointly=True,
    remedy="Have the subject hold the breath; rest the limb; test longer or average over pulses.",
)
