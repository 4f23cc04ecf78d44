"""Effects on the moving part that do not depend on tissue."""

from __future__ import annotations

from math import cos, exp, pi
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from numba import njit

from firmware_sim.effects import base
from firmware_sim.effects.base import Array, DrawConditions, Effect, ParameterRange, Stage, bounds, log_uniform
from firmware_sim.effects.drive import phase

SLIPS = 6
_SLIP_SHARES = np.array([0.05, 0.10, 0.20, 0.30, 0.20, 0.15])
_SLIP_LENGTHS = np.array([0.2, 0.5, 1.0, 1.6, 2.5, 4.0])


class DryFriction(Effect):
    """LuGre friction (Canudas de Wit et al. 1995); ``level`` is the sliding force, N.

    ``breakaway_share`` is the relative excess of the static force, ``presliding_m`` the presliding displacement.
    """

    name: ClassVar[str] = "dry_friction"
    stage: ClassVar[Stage] = "mechanics"
    unit: ClassVar[str] = "N"
    typical: ClassVar[float] = 0.3

    level: Annotated[float, bounds(0.0, 5.0), log_uniform(0.03, 1.2)]
    breakaway_share: Annotated[float, bounds(0.0, 2.0), ParameterRange(0.0, 0.7)] = 0.3
    stribeck_m_per_s: Annotated[float, bounds(1e-4, 1.0), log_uniform(0.002, 0.02)] = 0.006
    presliding_m: Annotated[float, bounds(2e-6, 1e-3), log_uniform(3e-6, 3e-5)] = 8e-6


class DirectionalFriction(Effect):
    """Six stick-slip elements with different presliding lengths, and with different friction in the two directions.

    ``level`` is the total sliding force in indentation, N; ``outward_share`` that in retraction relative to it.
    """

    name: ClassVar[str] = "directional_friction"
    stage: ClassVar[Stage] = "mechanics"
    unit: ClassVar[str] = "N"
    typical: ClassVar[float] = 0.4

    level: Annotated[float, bounds(0.0, 5.0), log_uniform(0.06, 1.5)]
    outward_share: Annotated[float, bounds(0.0, 10.0)] = 0.3
    presliding_m: Annotated[float, bounds(2e-6, 1e-3), log_uniform(4e-6, 3e-5)] = 1e-5

    @classmethod
    def draw(cls, random: np.random.Generator, around: DrawConditions) -> Self:
        """Return random parameters; either direction can have the higher friction, by a factor of 1.6 to 10."""
        heavier = float(np.exp(random.uniform(np.log(1.6), np.log(10.0))))
        values = cls._drawn(random)
        level = float(str(values["level"]))
        if random.random() < 0.5:
            return cls.model_validate(values | {"outward_share": 1.0 / heavier})
        return cls.model_validate(values | {"level": level / heavier, "outward_share": heavier})


class QuadraticDrag(Effect):
    """Drag proportional to a power of speed; ``level`` is its force at 0.1 m/s, N."""

    name: ClassVar[str] = "quadratic_drag"
    stage: ClassVar[Stage] = "mechanics"
    unit: ClassVar[str] = "N"
    typical: ClassVar[float] = 0.4

    level: Annotated[float, bounds(0.0, 20.0), log_uniform(0.05, 2.0)]
    exponent: Annotated[float, bounds(1.2, 4.0), ParameterRange(1.7, 2.6)] = 2.0


class EndStop(Effect):
    """Hertzian contact of a ball with a plate at ``at_m``, with damping by Hunt and Crossley.

    ``level`` is the force at 0.1 mm, N; ``side`` is the direction of motion that it stops.
    """

    name: ClassVar[str] = "end_stop"
    stage: ClassVar[Stage] = "mechanics"
    unit: ClassVar[str] = "N"
    typical: ClassVar[float] = 4.0

    level: Annotated[float, bounds(0.0, 20.0), log_uniform(0.8, 12.0)]
    at_m: Annotated[float, bounds(-0.01, 0.05)] = 0.0145
    side: Literal["inward", "outward"] = "inward"
    loss_s_per_m: Annotated[float, bounds(0.0, 50.0), ParameterRange(0.5, 8.0)] = 3.0

    @classmethod
    def draw(cls, random: np.random.Generator, around: DrawConditions) -> Self:
        """Return a stop within the motion of a standard test, 0.3 to 2 standard deviations deeper than its mean."""
        at = around.surface_m + around.depth_m + around.swing_m * random.uniform(0.3, 2.0)
        return cls.model_validate(cls._drawn(random) | {"at_m": at, "side": "inward"})


class MountResonance(Effect):
    """Two vibration modes of the frame on its mount; positions are measured relative to the frame.

    ``level`` is the moving mass of the coil relative to that of the first mode: zero is a rigid frame.
    """

    name: ClassVar[str] = "mount_resonance"
    stage: ClassVar[Stage] = "mechanics"
    unit: ClassVar[str] = "1"
    typical: ClassVar[float] = 0.1

    level: Annotated[float, bounds(0.0, 1.0), log_uniform(0.01, 0.25)]
    frequency_hz: Annotated[float, bounds(3.0, 300.0), log_uniform(15.0, 90.0)] = 35.0
    damping_ratio: Annotated[float, bounds(0.001, 1.0), log_uniform(0.02, 0.2)] = 0.05
    second_frequency_ratio: Annotated[float, bounds(1.1, 10.0), ParameterRange(1.8, 4.0)] = 2.6
    second_share: Annotated[float, bounds(0.0, 1.0), ParameterRange(0.0, 0.3)] = 0.15


class Cogging(Effect):
    """Periodic force along the stroke with second and third harmonics; ``level`` is the amplitude of the first, N."""

    name: ClassVar[str] = "cogging"
    stage: ClassVar[Stage] = "mechanics"
    unit: ClassVar[str] = "N"
    typical: ClassVar[float] = 0.3

    level: Annotated[float, bounds(0.0, 10.0), log_uniform(0.02, 0.7)]
    pitch_m: Annotated[float, bounds(1e-4, 0.03), log_uniform(0.0005, 0.004)] = 0.0015
    second_share: Annotated[float, bounds(0.0, 1.0), ParameterRange(0.0, 0.4)] = 0.2
    third_share: Annotated[float, bounds(0.0, 1.0), ParameterRange(0.0, 0.2)] = 0.1
    pattern: Annotated[int, bounds(0, 10_000)] = 1


class MagneticSpring(Effect):
    """Magnetic attraction with two stable positions, ``apart_m`` to each side of the middle.

    ``level`` is the largest force between them, N.
    """

    name: ClassVar[str] = "magnetic_spring"
    stage: ClassVar[Stage] = "mechanics"
    unit: ClassVar[str] = "N"
    typical: ClassVar[float] = 0.5
    listed: ClassVar[bool] = False

    level: Annotated[float, bounds(0.0, 10.0), log_uniform(0.1, 1.2)]
    middle_m: Annotated[float, bounds(-0.01, 0.05)] = 0.014
    apart_m: Annotated[float, bounds(2e-4, 0.02), log_uniform(0.0004, 0.0012)] = 0.0008

    @classmethod
    def draw(cls, random: np.random.Generator, around: DrawConditions) -> Self:
        """Return parameters near the range of motion of a standard test."""
        middle = around.surface_m + around.depth_m + around.swing_m * random.uniform(-1.0, 1.0)
        return cls.model_validate(cls._drawn(random) | {"middle_m": middle})


class WarmingBearing(Effect):
    """Bearing damping that changes with work: it increases or decreases by ``level`` over ``work_j``."""

    name: ClassVar[str] = "warming_bearing"
    stage: ClassVar[Stage] = "mechanics"
    unit: ClassVar[str] = "1"
    typical: ClassVar[float] = -0.6
    listed: ClassVar[bool] = False

    level: Annotated[float, bounds(-0.95, 5.0), ParameterRange(0.4, 0.95, either_sign=True)]
    work_j: Annotated[float, bounds(1e-4, 10.0), log_uniform(0.003, 0.03)] = 0.015


@njit
def mechanics(position: float, velocity: float, bearing: float, step: float, figures: Array, memory: Array) -> float:
    """Return the additional force on the moving part, N, without the frame; ``bearing`` is the damping, N s/m."""
    force = 0.0
    if figures[base.DRY_FRICTION, 0] != 0.0:
        force -= bristles(velocity, step, figures[base.DRY_FRICTION], memory[base.DRY_FRICTION])
    if figures[base.DIRECTIONAL_FRICTION, 0] != 0.0:
        force -= slips(velocity * step, figures[base.DIRECTIONAL_FRICTION], memory[base.DIRECTIONAL_FRICTION])
    if figures[base.QUADRATIC_DRAG, 0] != 0.0:
        row = figures[base.QUADRATIC_DRAG]
        drag = row[0] * (abs(velocity) / 0.1) ** row[1]
        force -= drag if velocity > 0.0 else -drag
    if figures[base.END_STOP, 0] != 0.0:
        row = figures[base.END_STOP]
        sense = 1.0 if row[2] == 0.0 else -1.0
        over = sense * (position - row[1])
        if over > 0.0:
            force -= sense * row[0] * (over / 1e-4) ** 1.5 * max(0.0, 1.0 + row[3] * sense * velocity)
    if figures[base.COGGING, 0] != 0.0:
        row = figures[base.COGGING]
        turn = 2.0 * pi * position / row[1]
        force += row[0] * cos(turn + phase(row[4], 1))
        force += row[0] * row[2] * cos(2.0 * turn + phase(row[4], 2))
        force += row[0] * row[3] * cos(3.0 * turn + phase(row[4], 3))
    if figures[base.MAGNETIC_SPRING, 0] != 0.0:
        row = figures[base.MAGNETIC_SPRING]
        z = (position - row[1]) / row[2]
        # z - z^3, bounded: largest force 1 between the stable positions, and none far away.
        force += row[0] * 2.6 * z * (1.0 - z * z) / (1.0 + z * z * z * z)
    if figures[base.WARMING_BEARING, 0] != 0.0:
        row, kept = figures[base.WARMING_BEARING], memory[base.WARMING_BEARING]
        kept[0] += bearing * velocity * velocity * step
        force -= bearing * row[0] * (1.0 - exp(-kept[0] / row[1])) * velocity
    return force


@njit
def bristles(velocity: float, step: float, row: Array, kept: Array) -> float:
    """Return the dry friction force, N, at a velocity, m/s; ``kept`` is its state."""
    # Exact solution of the bristle deflection for a constant speed during the step.
    speed = abs(velocity)
    slip = row[0] * (1.0 + row[1] * exp(-((speed / row[2]) ** 2)))
    stiffness = row[0] / row[3]
    bend = slip / stiffness
    target = bend if velocity > 0.0 else -bend
    kept[0] = target + (kept[0] - target) * exp(-speed * step / bend)
    return float(stiffness * kept[0])


@njit
def slips(moved: float, row: Array, kept: Array) -> float:
    """Return the directional friction force, N, after a displacement, m; ``kept`` is its state."""
    # Each spring is stretched until its element slips (Maxwell, Prandtl, Ishlinskii).
    force = 0.0
    for k in range(SLIPS):
        most = row[0] * _SLIP_SHARES[k]
        pulled = kept[k] + most / (row[2] * _SLIP_LENGTHS[k]) * moved
        kept[k] = min(max(pulled, -most * row[1]), most)
        force += kept[k]
    return force


@njit
def frame(force: float, step: float, row: Array, kept: Array, moving_mass: float) -> tuple[float, float, float]:
    """Return displacement, speed and acceleration of the frame after a step under the reaction of the coil, N."""
    first_mass = moving_mass / row[0]
    shift, speed, acceleration = 0.0, 0.0, 0.0
    for k in range(2):
        share = 1.0 if k == 0 else row[4]
        omega = 2.0 * pi * row[1] * (1.0 if k == 0 else row[3])
        pushed = share * force / first_mass
        before = kept[2 * k + 1]
        # Symplectic Euler conserves the energy of free vibration; the damping is implicit.
        kept[2 * k + 1] = (before + step * (pushed - omega * omega * kept[2 * k])) / (1.0 + 2.0 * row[2] * omega * step)
        kept[2 * k] += step * kept[2 * k + 1]
        shift += kept[2 * k]
        speed += kept[2 * k + 1]
        acceleration += (kept[2 * k + 1] - before) / step
    return shift, speed, acceleration
