"""Tissue whose mass, damping and stiffness depend on depth (Chen 2010, Eq. 3.33 and C.1.4), in a plain loop.

Integrated by Runge-Kutta at four steps to a sample of 2 kHz or sixteen to one of 500 Hz, from a force that is known at
every half step. Nothing here comes from the package but the record that is handed over.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from identification.simulated import Array, generator, noise
from scipy import signal

from tissueid.records import Record

RATE = 2000.0
SLOW_RATE = 500.0
SURFACE = 0.010
"""Position, m, where the depth is zero."""

_WARM_S = 0.5


@dataclass(frozen=True)
class Tissue:
    """Each curve is coefficient * (exp(growth * depth) + offset), and the force is stiffness(y) * depth.

    The ``thesis`` writes A1 to A3 for the growths (per millimetre) and D1 to D3 for the offsets. ``turn`` is the share
    by which damping is larger on the way in and smaller on the way out, for speeds well over ``turn_speed`` (m/s), and
    ``stiffness_turn`` that of the force of the spring, and so of its slope.
    """

    mass: float = 0.06
    damping: float = 20.0
    stiffness: float = 1000.0
    mass_growth: float = 0.0
    damping_growth: float = 300.0
    stiffness_growth: float = 300.0
    mass_offset: float = 0.0
    damping_offset: float = 0.0
    stiffness_offset: float = 0.5
    turn: float = 0.0
    turn_speed: float = 0.02
    stiffness_turn: float = 0.0

    def masses(self, position: Array) -> Array:
        """M(y), kg, shape of the position (m)."""
        return self.mass * (np.exp(self.mass_growth * (position - SURFACE)) + self.mass_offset)

    def dampings(self, position: Array) -> Array:
        """B(y), N s/m, shape of the position (m)."""
        return self.damping * (np.exp(self.damping_growth * (position - SURFACE)) + self.damping_offset)

    def secants(self, position: Array) -> Array:
        """K(y) of Eq. 3.33, N/m, shape of the position (m)."""
        return self.stiffness * (np.exp(self.stiffness_growth * (position - SURFACE)) + self.stiffness_offset)

    def forces(self, position: Array) -> Array:
        """K(y) y, N, shape of the position (m)."""
        return self.secants(position) * (position - SURFACE)

    def tangents(self, position: Array) -> Array:
        """Slope of the force, N/m, shape of the position (m)."""
        depth = position - SURFACE
        grown = np.exp(self.stiffness_growth * depth)
        return self.stiffness * (grown * (1.0 + self.stiffness_growth * depth) + self.stiffness_offset)


SKIN = Tissue(mass=0.09, damping=8.0, stiffness=1200.0, damping_growth=250.0, stiffness_growth=300.0)
"""Underdamped at work: growing damping and stiffness, and the mass of actuator and probe, which stays."""

GROWING = Tissue(
    mass=0.06, damping=10.0, stiffness=1400.0, mass_growth=150.0, damping_growth=200.0, stiffness_growth=250.0
)
"""The mass grows too."""

THESIS = Tissue()
"""The constants of C.1.4: M 0.06, B 20, K 1000, A1 = 0, A2 = A3 = 0.3 per mm, D3 = 0.5; overdamped."""

PLAIN = Tissue(mass=0.0912, damping=22.77, stiffness=4670.0 / 1.5, damping_growth=0.0, stiffness_growth=0.0)
"""A linear system: nothing depends on depth."""


def integrate(tissue: Tissue, force: Array, step: float, keep: int, held: bool = False) -> Array:
    """Position (m,) at every ``keep``-th step; ``force`` (2 m keep + 1,) is known at every half step of ``step`` s.

    A force that is ``held`` jumps at the end of a step, and that step does not yet feel it.
    """
    depth = speed = 0.0
    m, d1, a1 = tissue.mass, tissue.mass_offset, tissue.mass_growth
    b, d2, a2 = tissue.damping, tissue.damping_offset, tissue.damping_growth
    k, d3, a3 = tissue.stiffness, tissue.stiffness_offset, tissue.stiffness_growth
    turn, turn_speed, exp, tanh = tissue.turn, tissue.turn_speed, math.exp, math.tanh
    stiffness_turn = tissue.stiffness_turn

    def acceleration(push: float, x: float, v: float) -> float:
        damping = b * (exp(a2 * x) + d2)
        if turn:
            damping *= 1.0 + turn * tanh(v / turn_speed)
        spring = k * (exp(a3 * x) + d3) * x
        if stiffness_turn:
            spring *= 1.0 + stiffness_turn * tanh(v / turn_speed)
        return (push - damping * v - spring) / (m * (exp(a1 * x) + d1))

    pushes = force.tolist()
    kept = []
    for n in range((force.size - 1) // 2):
        if n % keep == 0:
            kept.append(depth)
        first, middle = pushes[2 * n], pushes[2 * n + 1]
        last = middle if held else pushes[2 * n + 2]
        v1, r1 = speed, acceleration(first, depth, speed)
        v2 = speed + 0.5 * step * r1
        r2 = acceleration(middle, depth + 0.5 * step * v1, v2)
        v3 = speed + 0.5 * step * r2
        r3 = acceleration(middle, depth + 0.5 * step * v2, v3)
        v4 = speed + step * r3
        r4 = acceleration(last, depth + step * v3, v4)
        depth += step / 6.0 * (v1 + 2.0 * v2 + 2.0 * v3 + v4)
        speed += step / 6.0 * (r1 + 2.0 * r2 + 2.0 * r3 + r4)
    return np.array(kept) + SURFACE


@lru_cache(maxsize=256)
def clean(
    tissue: Tissue, seed: tuple[int, ...], mean: float = 4.0, spread: float = 2.0, band: float = 200.0, n: int = 8000
) -> tuple[Array, Array]:
    """Gaussian force of that mean and spread (N), band-limited, and the position: each (n,) at 2 kHz, no noise."""
    steps = 4
    fine = RATE * 2 * steps
    warm = round(_WARM_S * RATE)
    white = generator(*seed).standard_normal((n + warm) * 2 * steps + 1)
    force = signal.sosfilt(signal.butter(8, band, fs=fine, output="sos"), white)
    force = mean + spread * force / np.std(force)
    position = integrate(tissue, force, 1.0 / (RATE * steps), steps)
    return force[: -1 : 2 * steps][warm:], position[warm:]


@lru_cache(maxsize=64)
def clean_held(
    tissue: Tissue, seed: tuple[int, ...], mean: float = 4.0, spread: float = 4.0, n: int = 8000
) -> tuple[Array, Array]:
    """White Gaussian force, held from sample to sample at 500 Hz as in C.1.4, and the position: each (n,)."""
    steps = 16
    warm = round(_WARM_S * SLOW_RATE)
    force = mean + spread * generator(*seed).standard_normal(n + warm)
    half_steps = np.append(np.repeat(force, 2 * steps), force[-1])
    position = integrate(tissue, half_steps, 1.0 / (SLOW_RATE * steps), steps, held=True)
    return force[warm:], position[warm:]


def record(
    tissue: Tissue, *seed: int, snr_db: float = 40.0, colour: float = 0.0, mean: float = 4.0, spread: float = 2.0
) -> Record:
    """A record of 4 s at 2 kHz with noise on the position."""
    force, position = clean(tissue, seed, mean, spread)
    return Record(force, position + noise(generator(*seed, 77), position, snr_db, colour), RATE)


def slow_record(tissue: Tissue, *seed: int, snr_db: float = 40.0, mean: float = 4.0, spread: float = 4.0) -> Record:
    """A record of 16 s at 500 Hz, the force held from sample to sample, with white noise on the position."""
    force, position = clean_held(tissue, seed, mean, spread)
    return Record(force, position + noise(generator(*seed, 77), position, snr_db), SLOW_RATE)
