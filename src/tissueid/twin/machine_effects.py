"""Effects in the coordinates of an equivalent machine, in place of those of the library with the same name.

An input-output record is scaled to the size of an indenter, but its swing, speed and mean differ from those of a probe
on tissue. Laws that refer to those of the probe have parameters in their place here, and their starting points follow
from the record.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter
from tissueid.twin.effects import (
    amplifier_clipping,
    amplifier_deadband,
    directional_friction,
    dry_friction,
    end_stop,
    reflex,
    sensor_backlash,
    tissue_hysteresis,
    tissue_stiffening,
)
from tissueid.twin.effects.dry_friction import friction_share

STOPS = 8
_LIMITS = STOPS + 1
_MOST_STRETCH = 30.0
"""Bound of the Bouc-Wen variable, which a hardening loop would exceed."""
_FRICTION_SPREAD = 1.0
"""Spread of the log presliding displacements."""
IWAN, BOUC_WEN = 0.0, 1.0
REFERENCE_M = 1e-3
_SWINGS = (1.0, 3.0)
"""Yield lengths of the starting points, in standard deviations of the motion."""
_ANGLES = (0.8, -0.8, 2.4, -2.4)
"""Directions of the two Bouc-Wen parameters: softening, hardening in unloading, hardening in loading, and both."""


def friction_hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Add the friction force, larger near standstill within a fitted speed."""
    velocity = b[bus.VELOCITY] + 0.5 * dt * b[bus.ACCELERATION]
    ratio = velocity / p[4]
    level = p[0] * (1.0 + p[2] * math.exp(-min(ratio * ratio, 50.0)))
    b[bus.FORCE] -= level * friction_share(s, velocity, p[1], _FRICTION_SPREAD, p[3], dt)


def directional_friction_hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Add dry friction and a force of one sign during sliding in either direction."""
    velocity = b[bus.VELOCITY] + 0.5 * dt * b[bus.ACCELERATION]
    ratio = velocity / p[5]
    level = p[0] * (1.0 + p[3] * math.exp(-min(ratio * ratio, 50.0)))
    share = friction_share(s, velocity, p[2], _FRICTION_SPREAD, p[4], dt)
    b[bus.FORCE] -= level * share * (1.0 + p[1] * share)


def hysteresis_hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Add the force of slipping springs, or of a Bouc-Wen element with either sign of its parameters."""
    move = dt * (b[bus.VELOCITY] + 0.5 * dt * b[bus.ACCELERATION])
    if p[2] < 0.5:
        if s[_LIMITS] == 0.0:
            for k in range(STOPS):
                s[_LIMITS + k] = math.exp(p[6] * (2.0 * k / (STOPS - 1.0) - 1.0))
        held = 0.0
        for k in range(STOPS):
            most = p[1] * s[_LIMITS + k]
            stretch = min(max(s[k] + move, -most), most)
            held += 0.5 * (s[k] + stretch) / most
            s[k] = stretch
        path = abs(move) / p[1]
        settled = 1.0 if move > 0.0 else -1.0
        before = s[STOPS]
        s[STOPS] = settled + (before - settled) * math.exp(-path)
        b[bus.TISSUE_FORCE] += p[0] * ((1.0 - p[5]) * held / STOPS + p[5] * 0.5 * (before + s[STOPS]))
        return
    way, by_path, by_way = move / p[1], math.cos(p[3]), math.sin(p[3])
    before = s[STOPS]
    size = abs(before)
    power = size ** p[4] if size > 0.0 else 0.0
    slope = way * (1.0 - by_way * power)
    slope -= abs(way) * by_path * (power if before > 0.0 else -power)
    middle = min(max(before + 0.5 * slope, -_MOST_STRETCH), _MOST_STRETCH)
    size = abs(middle)
    power = size ** p[4] if size > 0.0 else 0.0
    slope = way * (1.0 - by_way * power)
    slope -= abs(way) * by_path * (power if middle > 0.0 else -power)
    s[STOPS] = min(max(before + slope, -_MOST_STRETCH), _MOST_STRETCH)
    b[bus.TISSUE_FORCE] += p[0] * middle


def stiffening_hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Add a spring with play and a power law that differs between the two sides."""
    depth, play = b[bus.DEPTH], p[1]
    beyond, short = depth - play, depth + play
    square = p[3] * p[3]
    into = depth - 0.5 * (math.sqrt(short * short + square) - math.sqrt(beyond * beyond + square))
    size = min(abs(into) / REFERENCE_M, 50.0)
    force = p[0] * size ** p[2] if size > 0.0 else 0.0
    b[bus.TISSUE_FORCE] += force * ((1.0 if into > 0.0 else -1.0) + p[4])


def swing(tests: Sequence[Mapping[str, FloatArray]]) -> float:
    """Return the standard deviation of the positions of all tests, m."""
    positions = [test["position"][np.isfinite(test["position"])] for test in tests]
    squares = [float(np.var(values)) for values in positions if values.size]
    return max(float(np.sqrt(sum(squares) / max(len(squares), 1))), 1e-9)


def hysteresis_starts(
    tests: Sequence[Mapping[str, FloatArray]], sample_rate_hz: float
) -> tuple[tuple[float, ...], ...]:
    """Return starting points with yield lengths of the size of the motion."""
    there = swing(tests)
    starts = [(0.3, 0.5 * there, IWAN, 0.8, 1.0, 0.3, 1.0)]
    starts += [(0.3 * times, times * there, BOUC_WEN, angle, 1.0, 0.3, 1.0) for times in _SWINGS for angle in _ANGLES]
    return tuple(starts)


def stiffening_starts(
    tests: Sequence[Mapping[str, FloatArray]], sample_rate_hz: float
) -> tuple[tuple[float, ...], ...]:
    """Return cubic, one-sided and bilinear starting points of the size of the motion."""
    there = swing(tests)
    size = 0.1 * (REFERENCE_M / there)
    cubic = 0.05 * (REFERENCE_M / there) ** 3
    corner = min(max(0.1 * there, 1e-5), 1e-3)
    return (
        (cubic, 0.0, 3.0, corner, 0.0),
        (-cubic, 0.0, 3.0, corner, 0.0),
        (size, 0.0, 1.1, corner, 0.9),
        (size, 0.0, 1.1, corner, -0.9),
        (size, there, 1.1, corner, 0.0),
    )


def stop_starts(tests: Sequence[Mapping[str, FloatArray]], sample_rate_hz: float) -> tuple[tuple[float, ...], ...]:
    """Return starting points near either end of the travel and within it."""
    positions = np.concatenate([test["position"][np.isfinite(test["position"])] for test in tests])
    low, less, more, high = (float(value) for value in np.quantile(positions, [0.02, 0.3, 0.7, 0.98]))
    soft = 0.3 * 1e-4 / swing(tests)
    return (
        (high, 10.0 * soft, 1.25, 3.0, end_stop.INNER),
        (more, soft, 1.25, 3.0, end_stop.INNER),
        (low, 10.0 * soft, 1.25, 3.0, end_stop.OUTER),
        (less, soft, 1.25, 3.0, end_stop.OUTER),
    )


def friction_starts(tests: Sequence[Mapping[str, FloatArray]], sample_rate_hz: float) -> tuple[tuple[float, ...], ...]:
    """Return starting points of plain friction with presliding of a small share of the motion."""
    give = min(max(0.01 * swing(tests), 2e-6), 2e-3)
    return tuple((level, give, 0.1, 0.5, 0.01) for level in (0.05, 0.3))


def directional_friction_starts(
    tests: Sequence[Mapping[str, FloatArray]], sample_rate_hz: float
) -> tuple[tuple[float, ...], ...]:
    """Return the same with a difference between the directions."""
    return tuple(
        (start[0], difference, *start[1:])
        for start in friction_starts(tests, sample_rate_hz)
        for difference in (0.3, -0.3)
    )


def play_starts(tests: Sequence[Mapping[str, FloatArray]], sample_rate_hz: float) -> tuple[tuple[float, ...], ...]:
    """Return starting points with play of a share of the motion."""
    there = swing(tests)
    return tuple((share * there, 0.2, 0.0) for share in (0.03, 0.2))


_COULOMB = Parameter("coulomb_n", "N", 0.0, 1e-4, 20.0, True, meaning="friction force at speed")
_PRESLIDING = Parameter("presliding_m", "m", None, 1e-6, 5e-3, True, meaning="displacement before it slides")
_STRIBECK = Parameter(
    "stribeck_ratio", "1", None, -0.5, 3.0, prior=0.1, prior_std=0.4, meaning="extra friction at rest"
)
_STRIBECK_SPEED = Parameter(
    "stribeck_m_s", "m/s", None, 5e-4, 0.2, True, prior=0.01, prior_std=1.0, meaning="speed at which it has vanished"
)
_BRISTLE = Parameter("bristle_share", "1", None, 0.0, 1.0, prior=0.5, prior_std=0.5, meaning="share of creeping loops")


@lru_cache(maxsize=1)
def machine_effects() -> dict[str, Effect]:
    """Return the effects that replace those of the library for an input-output record, by name."""
    ours = (
        replace(
            dry_friction.EFFECT,
            parameters=(_COULOMB, _PRESLIDING, _STRIBECK, _BRISTLE, _STRIBECK_SPEED),
            starts=((0.1, 2e-5, 0.1, 0.5, 0.01),),
            hook=friction_hook,
            starts_from=friction_starts,
        ),
        replace(
            directional_friction.EFFECT,
            parameters=(
                _COULOMB,
                directional_friction.EFFECT.parameters[1],
                _PRESLIDING,
                _STRIBECK,
                _BRISTLE,
                _STRIBECK_SPEED,
            ),
            starts=((0.1, 0.3, 2e-5, 0.1, 0.5, 0.01),),
            hook=directional_friction_hook,
            starts_from=directional_friction_starts,
        ),
        replace(
            tissue_hysteresis.EFFECT,
            equation="F = Fe + Fh ((1 - h) mean of z_k + h w) of slipping springs and a bristle, or Fe + Fh z with "
            "dz/dt = (v - (cos(a) |v| z + sin(a) v |z|) |z|^(n - 1)) / y; vanishes with Fh = 0",
            source="Iwan, J. Applied Mechanics 33 (1966) 893-900; Wen, J. Eng. Mech. 102 (1976) 249-263; Ikhouane and "
            "Rodellar, Systems with Hysteresis (2007), ch. 3 (signs of the parameters)",
            parameters=(
                Parameter("force_n", "N", 0.0, 1e-4, 100.0, True, meaning="scale of the force of a loop"),
                Parameter("yield_m", "m", None, 1e-4, 0.1, True, meaning="displacement at which half of it yields"),
                Parameter("form", "1", None, -1.0, 2.0, fixed=True, meaning="0 slipping springs, 1 Bouc-Wen"),
                Parameter(
                    "angle", "rad", None, -3.2, 3.2, prior=0.0, prior_std=2.0, meaning="softening and hardening parts"
                ),
                Parameter(
                    "exponent", "1", None, 0.5, 3.0, True, prior=1.0, prior_std=0.3, meaning="sharpness of the yielding"
                ),
                _BRISTLE,
                Parameter(
                    "spread", "1", None, 0.0, 2.5, prior=1.0, prior_std=0.5, meaning="spread of the log yield lengths"
                ),
            ),
            starts=((0.3, 4e-4, IWAN, 0.8, 1.0, 0.3, 1.0),),
            hook=hysteresis_hook,
            starts_from=hysteresis_starts,
        ),
        replace(
            tissue_stiffening.EFFECT,
            equation="F = F1 (sgn(d) + a) (max(|d| - d1, 0) / 1 mm)^n in addition to the spring, its corner rounded; "
            "vanishes with F1 = 0",
            parameters=(
                Parameter("force_n", "N", 0.0, -60.0, 60.0, meaning="force at 1 mm beyond the play"),
                Parameter("depth_m", "m", None, 0.0, 0.03, meaning="depth at which it begins"),
                tissue_stiffening.EFFECT.parameters[2],
                tissue_stiffening.EFFECT.parameters[3],
                Parameter(
                    "difference", "1", None, -1.0, 1.0, prior=0.0, prior_std=0.7, meaning="(in − out) / (in + out)"
                ),
            ),
            starts=((0.02, 0.0, 3.0, 1e-4, 0.0),),
            hook=stiffening_hook,
            starts_from=stiffening_starts,
        ),
        replace(
            end_stop.EFFECT,
            parameters=(
                Parameter("stop_m", "m", None, -0.06, 0.06, meaning="position of the stop"),
                *end_stop.EFFECT.parameters[1:],
            ),
            starts=((1e-3, 0.1, 1.25, 3.0, end_stop.INNER),),
            starts_from=stop_starts,
        ),
        replace(
            reflex.EFFECT,
            parameters=tuple(
                replace(item, low=-60.0, high=60.0) if item.name == "threshold" else item
                for item in reflex.EFFECT.parameters
            ),
            starts=tuple(
                (0.05, delay, 0.5, 1.0, reflex.RISE_S, reflex.MOST_N, reflex.FELT_S) for delay in reflex.DELAYS_S
            ),
            starts_from=None,
        ),
        replace(
            sensor_backlash.EFFECT,
            parameters=(
                Parameter("half_width_m", "m", 0.0, 1e-7, 2e-2, True, meaning="half width of the play"),
                *sensor_backlash.EFFECT.parameters[1:],
            ),
            starts=((2e-5, 0.2, 0.0),),
            starts_from=play_starts,
            needs=frozenset({"position"}),
        ),
        replace(
            amplifier_clipping.EFFECT,
            starts=((20.0, 8.0, 0.02, 1.0, 0.0), (12.0, 1.5, 0.02, 1.0, 0.0), (8.0, 8.0, 0.02, 1.0, 0.0)),
            starts_from=None,
        ),
        amplifier_deadband.EFFECT,
    )
    return {item.name: item for item in ours}
