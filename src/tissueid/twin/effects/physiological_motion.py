"""Breathing, pulse and tremor move the surface under the probe."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize

from tissueid.twin import _estimates, bus
from tissueid.twin.effect import Effect, FloatArray, Parameter

KINDS = (
    ("breathing", (0.1, 0.5), (1, 2, 3), 5e-3),
    ("pulse", (0.8, 2.0), (1, 2, 3, 4, 5), 1e-3),
    ("tremor", (7.0, 13.0), (1, 2, 3, 4, 5), 1e-3),
)
"""Name, frequencies, harmonics (of tremor: lines side by side) and the most that is looked for."""

_BANDS = [band for _, band, _, _ in KINDS]
MIDDLE_LINE = 3
"""Of tremor: its frequency, from which the other lines stand off by its spacing."""
MOST_SWAY_RAD = 1.5
"""By which breathing may hurry and slow the pulse: as far as a quarter of a beat."""
LIKELY_SWAY_RAD = 0.4
SPACING_HZ = (0.15, 0.8)
NEAR_HZ = (0.05, 0.15, 0.5)
"""So far a test's own rates may lie from those of the session."""
STEP_HZ = 0.04
"""Of the search for breathing and pulse: a fifth of what a test of 4.5 s tells apart."""
SLOW_BLOCKS = 5
"""Means over 5 ms that are taken together to look for breathing and pulse."""
FEWEST = 40
"""Means over 5 ms without which there is nothing to see."""
_TURNING = 16
"""State: whether the waves have begun."""


def _names(kind: str, harmonics: tuple[int, ...]) -> list[str]:
    return [f"{kind}_{part}_{h}_m" for h in harmonics for part in ("cosine", "sine")]


_RATES = ("breathing_hz", "pulse_hz", "tremor_hz", "pulse_sway_cosine_rad", "pulse_sway_sine_rad", "tremor_spacing_hz")
_HEIGHTS = [*(name for kind, _, harmonics, _ in KINDS for name in _names(kind, harmonics)), "mean_m"]
_MOST = np.array(
    [*(most for _, _, harmonics, most in KINDS for _ in range(2 * len(harmonics))), KINDS[0][3]], np.float64
)
_RATE_BOUNDS = (*_BANDS, *(2 * [(-MOST_SWAY_RAD, MOST_SWAY_RAD)]), SPACING_HZ)
_BEGINNING = (0.25, 1.2, 10.0, 0.0, 0.0, 0.4)
_ORDERS = [
    np.repeat(np.array(KINDS[0][2], np.float64), 2) ** 2,
    np.repeat(np.array(KINDS[1][2], np.float64), 2),
    np.repeat(1.0 + 2.0 * np.abs(np.array(KINDS[2][2], np.float64) - MIDDLE_LINE), 2),
]
"""By which the ridge of a reading grows, wave by wave: a rate is that of the waves which are high."""
_LIKELY = {"breathing": 5e-4 / _ORDERS[0], "pulse": 5e-5 / _ORDERS[1], "tremor": np.full(_ORDERS[2].size, 2e-5)}
"""Heights that are likely, wave by wave, m."""


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
    for kind, first, last in ((0, 6, 12), (1, 12, 22)):
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
    for k in range(22, 32, 2):
        moved += p[k] * real + p[k + 1] * imaginary
        real, imaginary = real * apart - imaginary * across, imaginary * apart + real * across
    for rate in range(4):
        cosine, sine, turned, aside = s[4 * rate], s[4 * rate + 1], s[4 * rate + 2], s[4 * rate + 3]
        s[4 * rate] = cosine * turned - sine * aside
        s[4 * rate + 1] = sine * turned + cosine * aside
    b[bus.SURFACE_POSITION] += moved + p[32]


def from_tests(tests: Sequence[Mapping[str, FloatArray]], sample_rate_hz: float) -> Sequence[Mapping[str, float]]:
    """Read off what is unexplained of the positions: a probe follows slow motion of the surface.

    Breathing and pulse overlap in a record of a few seconds, so both are looked for at once. Their rates are looked for
    in all tests together, of which a quiet one tells most, and then near there in each; and so how breathing sways the
    pulse and how far the lines of tremor stand apart.
    """
    swaying = [_Sway.of(signals, sample_rate_hz) for signals in tests]
    seen = [sway for sway in swaying if sway.left.size >= FEWEST]
    shared = _shared(seen) if seen else np.array(_BEGINNING)
    return [sway.read(sway.own(shared) if sway.left.size >= FEWEST else shared) for sway in swaying]


def _shared(seen: Sequence[_Sway]) -> FloatArray:
    # Rates on grids, one after the other: breathing beside whatever pulse, the pulse however breathing sways it, and
    # tremor in what these leave. Each is then refined.
    rates = np.array(_BEGINNING, np.float64)
    coarse = [sway.coarse() for sway in seen]
    breathing, pulse, tremor = (np.arange(low, high, STEP_HZ) for low, high in _BANDS)
    pairs = [np.r_[one, other, rates[2:]] for one in breathing for other in pulse]
    rates = max(pairs, key=lambda at: sum(sway.told(at, (0, 1)) for sway in coarse))
    beats = [np.r_[rates[0], one, rates[2:]] for one in pulse]
    rates = max(beats, key=lambda at: sum(sway.told(sway.swayed(at), (0, 1)) for sway in coarse))
    trembling = [sway.without(sway.swayed(rates), (0, 1)) for sway in coarse]
    fast = [np.r_[rates[:2], one, rates[3:]] for one in tremor]
    rates = max(fast, key=lambda at: sum(sway.told(at, (2,)) for sway in trembling))
    return rates


def _refined(
    about: FloatArray, places: Sequence[int], told: Callable[[FloatArray], float], near: Sequence[float] = ()
) -> FloatArray:
    # The numbers at some places moved to where they tell most; no farther than ``near`` where that is given.
    chosen = list(places)
    bounds = [_RATE_BOUNDS[k] for k in chosen]
    if near:
        bounds = [
            (max(low, about[k] - far), min(high, about[k] + far))
            for (low, high), k, far in zip(bounds, chosen, near, strict=True)
        ]
    steps = np.diag([_FIRST_STEPS[k] for k in chosen])

    def at(values: FloatArray) -> FloatArray:
        moved = about.copy()
        moved[chosen] = values
        return moved

    found = optimize.minimize(
        lambda values: -told(at(values)),
        about[chosen],
        method="Nelder-Mead",
        bounds=bounds,
        options={
            "initial_simplex": np.clip(
                about[chosen] + np.vstack((np.zeros(len(chosen)), steps)), *np.transpose(bounds)
            ),
            "maxfev": 60 * len(chosen),
            "xatol": 1e-4,
            "fatol": 1e-3,
        },
    )
    return at(found.x)


_FIRST_STEPS = (0.02, 0.02, 0.01, 0.3, 0.3, 0.1)


@dataclass(frozen=True)
class _Sway:
    """What is unexplained of a position, as means: shape (n,), m, about ``mean_m``, and their times, s."""

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

    def coarse(self) -> _Sway:
        """The same in fewer, longer means."""
        size = self.left.size // SLOW_BLOCKS * SLOW_BLOCKS
        left, time = (values[:size].reshape(-1, SLOW_BLOCKS).mean(axis=1) for values in (self.left, self.time))
        return replace(self, left=left, time=time)

    def own(self, shared: FloatArray) -> FloatArray:
        """This test's own numbers, near those of the session."""
        coarse = self.coarse()
        rates = coarse.swayed(shared)
        near = (*NEAR_HZ[:2], 2.0 * MOST_SWAY_RAD, 2.0 * MOST_SWAY_RAD)
        rates = _refined(rates, (0, 1, 3, 4), lambda at: coarse.told(at, (0, 1)), near)
        trembling = self.without(rates, (0, 1))
        spaced = [np.r_[rates[:5], spacing] for spacing in (0.25, 0.4, 0.55)]
        rates = max(spaced, key=lambda at: trembling.told(at, (2,)))
        return _refined(rates, (2, 5), lambda at: trembling.told(at, (2,)), (NEAR_HZ[2], SPACING_HZ[1]))

    def swayed(self, rates: FloatArray) -> FloatArray:
        """With the pulse swayed by breathing, of some ways the one that tells most."""
        turns = 0.25 * np.pi * np.arange(8)
        ways = [
            rates,
            *(
                np.r_[rates[:3], LIKELY_SWAY_RAD * np.cos(turns[k]), LIKELY_SWAY_RAD * np.sin(turns[k]), rates[5:]]
                for k in range(8)
            ),
        ]
        return max(ways, key=lambda at: self.told(at, (0, 1)))

    def read(self, rates: FloatArray) -> Mapping[str, float]:
        """The parameters of the effect in this test, within their bounds; no heights where there is little to see."""
        values = np.zeros(_MOST.size)
        if self.left.size >= FEWEST:
            kinds = range(len(KINDS))
            values = np.append(
                self.fitted(rates, kinds)[1], self.mean_m + float(self.without(rates, kinds).left.mean())
            )
        found = dict(zip(_RATES, rates.tolist(), strict=True))
        return found | dict(zip(_HEIGHTS, np.clip(values, -_MOST, _MOST).tolist(), strict=True))

    def fitted(self, rates: FloatArray, kinds: Sequence[int]) -> tuple[float, FloatArray]:
        """Squares that waves of some kinds take away, and the waves' heights."""
        return _estimates.fitted(
            self.left, self._columns(rates, kinds), np.concatenate([_ORDERS[kind] for kind in kinds])
        )

    def told(self, rates: FloatArray, kinds: Sequence[int]) -> float:
        """Likelihood of these rates, nats: a quiet test tells more than one in which much else is unexplained."""
        total = float(self.left @ self.left)
        taken = self.fitted(rates, kinds)[0]
        return -0.5 * self.left.size * float(np.log(max(1.0 - taken / total, 1e-12))) if total > 0.0 else 0.0

    def without(self, rates: FloatArray, kinds: Sequence[int]) -> _Sway:
        """What waves of some kinds leave."""
        return _Sway(self.left - self._columns(rates, kinds) @ self.fitted(rates, kinds)[1], self.time)

    def _columns(self, rates: FloatArray, kinds: Sequence[int]) -> FloatArray:
        breathing, pulse, tremor, cosine, sine, spacing = rates
        breath = 2.0 * np.pi * breathing * self.time
        columns = []
        for kind in kinds:
            if kind == 0:
                columns.append(_estimates.waves(breath, KINDS[0][2]))
            elif kind == 1:
                beat = 2.0 * np.pi * pulse * self.time + cosine * np.cos(breath) + sine * np.sin(breath)
                columns.append(_estimates.waves(beat, KINDS[1][2]))
            else:
                lines = (tremor + spacing * (line - MIDDLE_LINE) for line in KINDS[2][2])
                columns += [_estimates.waves(2.0 * np.pi * hertz * self.time, (1,)) for hertz in lines]
        return np.concatenate(columns, axis=1)


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
            Parameter(
                name,
                name.rpartition("_")[2].replace("hz", "Hz"),
                None,
                *bounds,
                per_test=True,
                fixed=True,
                meaning="read off the record",
            )
            for name, bounds in zip(_RATES, _RATE_BOUNDS, strict=True)
        ),
        *(
            Parameter(name, "m", 0.0, -most, most, per_test=True, prior=0.0, prior_std=std, meaning="of the surface")
            for kind, _, harmonics, most in KINDS
            for name, std in zip(_names(kind, harmonics), _LIKELY[kind], strict=True)
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
    starts=(_BEGINNING + (0.0,) * len(_HEIGHTS),),
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
