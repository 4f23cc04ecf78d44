"""Effects between the coil's terminals and the force on the moving part."""

from __future__ import annotations

from math import exp, tanh
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from numba import njit

from firmware_sim import kernel
from firmware_sim.effects import base
from firmware_sim.effects.base import Array, DrawConditions, Effect, ParameterRange, Stage, bounds, log_uniform
from firmware_sim.effects.drive import smooth_size

COPPER_PER_K = 3.93e-3
TABLE_NODES = 33
TABLE_FIRST_M, TABLE_SPACING_M = 0.0, 1e-3


class EddyCurrents(Effect):
    """Iron and bobbin as a ladder of two shorted turns in series with the coil; ``level`` is their inductance, H.

    ``first_ohm`` is parallel to all of it, ``second_share`` of that is parallel to the inner two fifths.
    """

    name: ClassVar[str] = "eddy_currents"
    stage: ClassVar[Stage] = "coil"
    unit: ClassVar[str] = "H"
    typical: ClassVar[float] = 2e-3

    level: Annotated[float, bounds(0.0, 0.05), log_uniform(3e-4, 8e-3)]
    first_ohm: Annotated[float, bounds(0.1, 100.0), log_uniform(1.0, 10.0)] = 4.0
    second_share: Annotated[float, bounds(0.05, 5.0), log_uniform(0.15, 1.0)] = 0.4


class CoilHeating(Effect):
    """Resistance of copper that heats up: a winding on a body; ``level`` is the thermal resistance of the winding, K/W.

    The body does not cool; each second it takes up ``body_per_s`` of the final temperature rise of the winding.
    """

    name: ClassVar[str] = "coil_heating"
    stage: ClassVar[Stage] = "coil"
    unit: ClassVar[str] = "K/W"
    typical: ClassVar[float] = 2.0

    level: Annotated[float, bounds(0.0, 50.0), log_uniform(0.15, 8.0)]
    time_s: Annotated[float, bounds(0.02, 100.0), log_uniform(0.4, 4.0)] = 1.5
    body_per_s: Annotated[float, bounds(0.0, 1.0), ParameterRange(0.0, 0.03)] = 0.01


class InductancePosition(Effect):
    """Inductance that depends on position; ``level`` is its total relative increase.

    The increase is a sigmoid of width ``width_m`` about the middle, with increasing or decreasing position.
    """

    name: ClassVar[str] = "inductance_position"
    stage: ClassVar[Stage] = "coil"
    unit: ClassVar[str] = "1"
    typical: ClassVar[float] = 2.0

    level: Annotated[float, bounds(0.0, 10.0), log_uniform(0.5, 5.0)]
    sense: Literal["inward", "outward"] = "inward"
    middle_m: Annotated[float, bounds(-0.01, 0.05)] = 0.0135
    width_m: Annotated[float, bounds(0.0005, 0.1), log_uniform(0.001, 0.005)] = 0.002

    @classmethod
    def draw(cls, random: np.random.Generator, around: DrawConditions) -> Self:
        """Return parameters with the middle near the range of motion of a standard test."""
        middle = around.surface_m + around.depth_m + random.uniform(-0.0015, 0.0015)
        return cls.model_validate(cls._drawn(random) | {"middle_m": middle})


class ForceConstantPosition(Effect):
    """Force constant along the stroke as a table of 33 values; force and back-EMF alike.

    ``level`` is the relative loss at the far end (``fall``), one width away from the middle (``bell``), or over 10 mm
    (``slope``).
    """

    name: ClassVar[str] = "force_constant_position"
    stage: ClassVar[Stage] = "coil"
    unit: ClassVar[str] = "1"
    typical: ClassVar[float] = 0.3

    level: Annotated[float, bounds(0.0, 0.9), log_uniform(0.12, 0.8)]
    course: Literal["fall", "bell", "slope"] = "fall"
    middle_m: Annotated[float, bounds(-0.01, 0.05)] = 0.013
    width_m: Annotated[float, bounds(0.001, 0.1), log_uniform(0.002, 0.008)] = 0.004

    @classmethod
    def draw(cls, random: np.random.Generator, around: DrawConditions) -> Self:
        """Return parameters with the decrease near the range of motion of a standard test."""
        middle = around.surface_m + around.depth_m + random.uniform(-0.003, 0.003)
        return cls.model_validate(cls._drawn(random) | {"middle_m": middle})

    def row(self) -> Array:
        """Return the level and the table."""
        at = TABLE_FIRST_M + TABLE_SPACING_M * np.arange(TABLE_NODES)
        along = (at - self.middle_m) / self.width_m
        if self.course == "fall":
            from scipy.special import erf  # slow to import and rarely needed

            lost = 0.5 * self.level * (1.0 + erf(along))
        elif self.course == "bell":
            lost = self.level * np.tanh(along**2)
        else:
            lost = self.level * np.clip((at - self.middle_m) / 0.010, -1.0, 1.0)
        return np.concatenate([[self.level], np.maximum(1.0 - lost, 0.05)])


class FluxSaturation(Effect):
    """Iron near saturation: the force constant decreases with |current + bias| (Froehlich), level in 1/A."""

    name: ClassVar[str] = "flux_saturation"
    stage: ClassVar[Stage] = "coil"
    unit: ClassVar[str] = "1/A"
    typical: ClassVar[float] = 0.15

    level: Annotated[float, bounds(0.0, 5.0), log_uniform(0.008, 0.4)]
    bias_a: Annotated[float, bounds(-10.0, 10.0), ParameterRange(-1.5, 1.5)] = 0.4


class ReluctanceForce(Effect):
    """Attraction of the core to the iron, proportional to the square of the current; ``level`` in N/A^2 at
    ``middle_m``.

    The force follows the law of an air gap that closes over ``gap_m``: it increases with position.
    """

    name: ClassVar[str] = "reluctance_force"
    stage: ClassVar[Stage] = "coil"
    unit: ClassVar[str] = "N/A^2"
    typical: ClassVar[float] = 0.15

    level: Annotated[float, bounds(-3.0, 3.0), log_uniform(0.01, 0.4, either_sign=True)]
    gap_m: Annotated[float, bounds(0.002, 1.0), log_uniform(0.01, 0.06)] = 0.02
    middle_m: Annotated[float, bounds(-0.01, 0.05), ParameterRange(0.010, 0.016)] = 0.013


class Demagnetisation(Effect):
    """The magnet weakens with use: the share ``level`` of the force constant is lost with the heat, J."""

    name: ClassVar[str] = "demagnetisation"
    stage: ClassVar[Stage] = "coil"
    unit: ClassVar[str] = "1"
    typical: ClassVar[float] = 0.15
    listed: ClassVar[bool] = False

    level: Annotated[float, bounds(0.0, 0.9), log_uniform(0.01, 0.3)]
    work_j: Annotated[float, bounds(0.1, 1e4), log_uniform(20.0, 120.0)] = 60.0


@njit
def table_at(table: Array, position: float) -> float:
    """Return the value of a table at a position, interpolated linearly and constant beyond its ends."""
    along = min(max((position - TABLE_FIRST_M) / TABLE_SPACING_M, 0.0), TABLE_NODES - 1.0)
    k = min(int(along), TABLE_NODES - 2)
    return float(table[k] + (along - k) * (table[k + 1] - table[k]))


@njit
def coil(
    volts: float,
    current: float,
    position: float,
    velocity: float,
    step: float,
    plant: Array,
    figures: Array,
    memory: Array,
) -> float:
    """Update the coil's parameters in ``plant`` for one sub-step; return the voltage across R, L and back-EMF, V."""
    heat = plant[kernel.RESISTANCE] * current * current
    if figures[base.COIL_HEATING, 0] != 0.0:
        row, kept = figures[base.COIL_HEATING], memory[base.COIL_HEATING]
        plant[kernel.RESISTANCE] *= 1.0 + COPPER_PER_K * (kept[0] + kept[1])
        heat = plant[kernel.RESISTANCE] * current * current
        kept[0] += (row[0] * heat - kept[0]) * (1.0 - exp(-step / row[1]))
        kept[1] += row[0] * row[2] * heat * step
    if figures[base.FORCE_CONSTANT_POSITION, 0] != 0.0:
        plant[kernel.FORCE_CONSTANT] *= table_at(figures[base.FORCE_CONSTANT_POSITION, 1:], position)
    if figures[base.FLUX_SATURATION, 0] != 0.0:
        row = figures[base.FLUX_SATURATION]
        rest = 1.0 + row[0] * smooth_size(row[1], 0.1)
        plant[kernel.FORCE_CONSTANT] *= rest / (1.0 + row[0] * smooth_size(current + row[1], 0.1))
    if figures[base.DEMAGNETISATION, 0] != 0.0:
        row, kept = figures[base.DEMAGNETISATION], memory[base.DEMAGNETISATION]
        plant[kernel.FORCE_CONSTANT] *= 1.0 - row[0] * (1.0 - exp(-kept[0] / row[1]))
        kept[0] += heat * step
    if figures[base.RELUCTANCE_FORCE, 0] != 0.0:
        row = figures[base.RELUCTANCE_FORCE]
        closing = max(1.0 - (position - row[2]) / row[1], 0.2)
        plant[kernel.GRAVITY_FORCE] += row[0] * current * current / (closing * closing)
    if figures[base.INDUCTANCE_POSITION, 0] != 0.0:
        row = figures[base.INDUCTANCE_POSITION]
        sense = 1.0 if row[1] == 0.0 else -1.0
        share = 0.5 * (1.0 + tanh(sense * (position - row[2]) / row[3]))
        slope = sense * 2.0 * share * (1.0 - share) / row[3]
        # The rate of the flux through a moving inductance acts like a resistance.
        plant[kernel.RESISTANCE] += plant[kernel.INDUCTANCE] * row[0] * slope * velocity
        plant[kernel.INDUCTANCE] *= 1.0 + row[0] * share
    if figures[base.EDDY_CURRENTS, 0] != 0.0:
        row, kept = figures[base.EDDY_CURRENTS], memory[base.EDDY_CURRENTS]
        # 3/5 of the inductance are behind the first resistor and the rest behind the second; implicit integration.
        first, second = step * row[1] / (0.6 * row[0]), step * row[1] * row[2] / (0.6 * row[0])
        inner = 1.5 * second
        before = kept[0]
        plant[kernel.RESISTANCE] += row[1]
        kept[0] += first * current + second * kept[1] / (1.0 + inner)
        kept[0] /= 1.0 + first + second / (1.0 + inner)
        kept[1] = (kept[1] + inner * kept[0]) / (1.0 + inner)
        # Evaluated at mid-step if slow relative to the step, at its end if fast.
        volts += row[1] * (before + (0.5 + first) / (1.0 + first) * (kept[0] - before))
    return volts
