"""Effects of living tissue. All depend on depth below the surface and are added to the plant's own law."""

from __future__ import annotations

from math import atan, erf, exp, log, pi, sqrt
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from numba import njit

from firmware_sim import kernel
from firmware_sim.effects import base
from firmware_sim.effects.base import Array, DrawConditions, Effect, ParameterRange, Stage, bounds, log_uniform
from firmware_sim.effects.drive import delayed
from firmware_sim.kernel import _exponential, elastic_force, tissue_mass

BRANCHES = 9
_BRANCH_TIMES = 2e-3 * np.sqrt(10.0) ** np.arange(BRANCHES)  # 2 ms to 20 s
STOPS = 8
_STOP_SPREAD = np.exp(np.linspace(-1.4, 1.4, STOPS))
_STOP_WEIGHTS = (
    np.exp(-0.5 * np.linspace(-1.8, 1.8, STOPS) ** 2) / np.exp(-0.5 * np.linspace(-1.8, 1.8, STOPS) ** 2).sum()
)
_STRETCH_FILTER_S = 5e-3
_SLOWING_GAP_M = 2e-3
_ADHESION_REACH_M = 5e-5


class TissueStiffening(Effect):
    """Fibres recruited at lognormally distributed depths (Lanir 1983), or a layer with a sharp top.

    ``level`` is the stiffness of all recruited fibres, N/m; ``spread`` is the standard deviation of the logarithm
    (``fibres``) or, times ``at_m``, the transition width of the layer (``layer``).
    """

    name: ClassVar[str] = "tissue_stiffening"
    stage: ClassVar[Stage] = "tissue"
    unit: ClassVar[str] = "N/m"
    typical: ClassVar[float] = 1500.0

    level: Annotated[float, bounds(0.0, 50_000.0), log_uniform(150.0, 8000.0)]
    at_m: Annotated[float, bounds(1e-4, 0.03)] = 0.004
    spread: Annotated[float, bounds(0.005, 2.0), log_uniform(0.02, 0.2)] = 0.06
    kind: Literal["fibres", "layer"] = "fibres"

    @classmethod
    def draw(cls, random: np.random.Generator, around: DrawConditions) -> Self:
        """Return parameters with recruitment within the range of motion of a standard test."""
        at = around.depth_m + around.swing_m * random.uniform(-1.0, 1.5)
        return cls.model_validate(cls._drawn(random) | {"at_m": max(at, 5e-4)})


class Viscoelasticity(Effect):
    """Power-law relaxation: nine branches from 2 ms to 20 s with weights proportional to time^-exponent.

    ``level`` is the total instantaneous addition to the elastic force, as a share of it.
    """

    name: ClassVar[str] = "viscoelasticity"
    stage: ClassVar[Stage] = "tissue"
    unit: ClassVar[str] = "1"
    typical: ClassVar[float] = 0.4

    level: Annotated[float, bounds(0.0, 10.0), log_uniform(0.08, 2.0)]
    exponent: Annotated[float, bounds(-0.5, 1.5), ParameterRange(0.0, 0.35)] = 0.15


class TissueHysteresis(Effect):
    """Rate-independent hysteresis: eight Prandtl-Ishlinskii elements with lengths about ``length_m``.

    ``level`` is the stiffness that all of them add at a reversal, N/m.
    """

    name: ClassVar[str] = "tissue_hysteresis"
    stage: ClassVar[Stage] = "tissue"
    unit: ClassVar[str] = "N/m"
    typical: ClassVar[float] = 500.0

    level: Annotated[float, bounds(0.0, 20_000.0), log_uniform(80.0, 3000.0)]
    length_m: Annotated[float, bounds(1e-5, 0.01), log_uniform(8e-5, 6e-4)] = 2e-4


class Preconditioning(Effect):
    """Softening with work and recovery at rest: the share ``level`` of the elasticity is lost with the work."""

    name: ClassVar[str] = "preconditioning"
    stage: ClassVar[Stage] = "tissue"
    unit: ClassVar[str] = "1"
    typical: ClassVar[float] = 0.2

    level: Annotated[float, bounds(-0.9, 0.9), log_uniform(0.005, 0.35)]
    work_j: Annotated[float, bounds(1e-4, 100.0), log_uniform(0.02, 0.3)] = 0.1
    recovery_s: Annotated[float, bounds(0.1, 1e4), log_uniform(5.0, 60.0)] = 20.0


class AddedMass(Effect):
    """Tissue mass that increases with depth by a Hill function; ``level`` is its limit, kg."""

    name: ClassVar[str] = "added_mass"
    stage: ClassVar[Stage] = "tissue"
    unit: ClassVar[str] = "kg"
    typical: ClassVar[float] = 0.06

    level: Annotated[float, bounds(0.0, 1.0), log_uniform(0.01, 0.25)]
    half_m: Annotated[float, bounds(1e-4, 0.03)] = 0.004
    exponent: Annotated[float, bounds(1.0, 8.0), ParameterRange(1.5, 5.0)] = 3.0

    @classmethod
    def draw(cls, random: np.random.Generator, around: DrawConditions) -> Self:
        """Return parameters with half of the mass at the range of motion of a standard test."""
        half = around.depth_m + around.swing_m * random.uniform(-1.0, 1.5)
        return cls.model_validate(cls._drawn(random) | {"half_m": max(half, 5e-4)})


class ContactLoss(Effect):
    """Tissue that does not follow a probe pulling with more than ``adhesion_n``; it recovers and makes contact again.

    ``level`` is the relative increase of its damping per 2 mm of gap, which slows the recovery.
    """

    name: ClassVar[str] = "contact_loss"
    stage: ClassVar[Stage] = "tissue"
    unit: ClassVar[str] = "1"
    typical: ClassVar[float] = 1.0

    level: Annotated[float, bounds(0.0, 100.0), log_uniform(0.4, 8.0)]
    adhesion_n: Annotated[float, bounds(0.0, 5.0)] = 0.0

    @classmethod
    def draw(cls, random: np.random.Generator, around: DrawConditions) -> Self:
        """Return random parameters with or without adhesion."""
        adhesion = 0.0 if random.random() < 0.5 else random.uniform(0.02, 0.3)
        return cls.model_validate(cls._drawn(random) | {"adhesion_n": adhesion})


class DirectionalDamping(Effect):
    """Damping that differs between indentation and retraction: factor 1 + level (2/pi) atan(v / speed)."""

    name: ClassVar[str] = "directional_damping"
    stage: ClassVar[Stage] = "tissue"
    unit: ClassVar[str] = "1"
    typical: ClassVar[float] = 0.5

    level: Annotated[float, bounds(-0.99, 0.99), log_uniform(0.05, 0.9, either_sign=True)]
    speed_m_per_s: Annotated[float, bounds(1e-4, 1.0), log_uniform(0.001, 0.02)] = 0.005


class Reflex(Effect):
    """Muscle reflex: delayed twitches after indentation faster than a threshold, up to a force of ``level``, N."""

    name: ClassVar[str] = "reflex"
    stage: ClassVar[Stage] = "tissue"
    unit: ClassVar[str] = "N"
    typical: ClassVar[float] = 0.6

    level: Annotated[float, bounds(0.0, 10.0), log_uniform(0.1, 1.5)]
    delay_s: Annotated[float, bounds(0.005, 0.2), ParameterRange(0.025, 0.12)] = 0.05
    threshold_m_per_s: Annotated[float, bounds(0.0, 1.0), ParameterRange(0.0, 0.03)] = 0.01
    sensitivity_s_per_m: Annotated[float, bounds(0.1, 1e4), log_uniform(15.0, 80.0)] = 40.0
    twitch_s: Annotated[float, bounds(0.002, 1.0), log_uniform(0.008, 0.03)] = 0.015


@njit
def fibres(row: Array, depth: float) -> float:
    """Return the force of the stiffening fibres or layer, N, at a depth in metres."""
    if row[3] == 1.0:
        soft = row[1] * row[2]
        along = (depth - row[1]) / soft
        return float(row[0] * soft * 0.5 * (along + sqrt(along * along + 0.25)))
    if depth <= 0.0:
        return 0.0
    z = log(depth / row[1]) / row[2]
    taken_up = 0.5 * (1.0 + erf(z / sqrt(2.0)))
    lengths = 0.5 * (1.0 + erf((z - row[2]) / sqrt(2.0)))
    return float(row[0] * (depth * taken_up - row[1] * exp(0.5 * row[2] * row[2]) * lengths))


@njit
def soften(step: float, force: float, velocity: float, law: Array, figures: Array, memory: Array) -> None:
    """Update preconditioning: the tissue's parameters ``law``, and the state by the power at the surface."""
    row, kept = figures[base.PRECONDITIONING], memory[base.PRECONDITIONING]
    law[kernel.STIFFNESS] *= 1.0 - row[0] * kept[0]
    kept[0] += step * (abs(force * velocity) / row[1] * (1.0 - kept[0]) - kept[0] / row[2])


@njit
def recruit(depth: float, velocity: float, row: Array, law: Array) -> float:
    """Add the recruited mass to ``law``; return half its slope times speed squared, N (conserves energy)."""
    if depth <= 0.0:
        return 0.0
    ratio = (depth / row[1]) ** row[2]
    share = ratio / (1.0 + ratio)
    law[kernel.MASS] += row[0] * share / (exp(law[kernel.MASS + 1] * depth) + law[kernel.MASS + 2])
    slope = row[0] * row[2] * share * (1.0 - share) / depth
    return float(-0.5 * slope * velocity * velocity)


@njit
def tissue(
    depth: float,
    velocity: float,
    elastic: float,
    damping: float,
    step: float,
    first: bool,
    figures: Array,
    memory: Array,
    rings: Array,
) -> float:
    """Return the additional force of tissue on the probe, N; ``elastic`` (N) and ``damping`` (N s/m) are those of the
    plant's law.
    """
    force = 0.0
    if figures[base.TISSUE_STIFFENING, 0] != 0.0:
        row = figures[base.TISSUE_STIFFENING]
        force -= fibres(row, depth) - fibres(row, 0.0)
    if figures[base.VISCOELASTICITY, 0] != 0.0:
        row, kept = figures[base.VISCOELASTICITY], memory[base.VISCOELASTICITY]
        whole, lagging = 0.0, 0.0
        for k in range(BRANCHES):
            weight = (_BRANCH_TIMES[k] / 2e-3) ** -row[1]
            kept[k] += (elastic - kept[k]) * (1.0 - exp(-step / _BRANCH_TIMES[k]))
            whole += weight
            lagging += weight * (elastic - kept[k])
        force -= row[0] * lagging / whole
    if figures[base.TISSUE_HYSTERESIS, 0] != 0.0:
        row, kept = figures[base.TISSUE_HYSTERESIS], memory[base.TISSUE_HYSTERESIS]
        for k in range(STOPS):
            most = row[1] * _STOP_SPREAD[k]
            kept[k] = min(max(kept[k] + velocity * step, -most), most)
            force -= row[0] * _STOP_WEIGHTS[k] * kept[k]
    if figures[base.DIRECTIONAL_DAMPING, 0] != 0.0:
        row = figures[base.DIRECTIONAL_DAMPING]
        force -= damping * row[0] * (2.0 / pi) * atan(velocity / row[1]) * velocity
    if figures[base.REFLEX, 0] != 0.0:
        force -= _twitches(depth, velocity, step, first, figures[base.REFLEX], memory[base.REFLEX], rings[1])
    return force


@njit
def _twitches(depth: float, velocity: float, step: float, first: bool, row: Array, kept: Array, ring: Array) -> float:
    stretching = velocity if depth > 0.0 else 0.0
    kept[1] += (stretching - kept[1]) * (1.0 - exp(-step / _STRETCH_FILTER_S))
    felt = max(0.0, kept[1] - row[2])
    late = delayed(ring, kept, felt, row[1] / step, first)
    # Two equal lags give a twitch t exp(-t / time); twitches saturate at the largest force.
    share = 1.0 - exp(-step / row[4])
    kept[2] += (late - kept[2]) * share
    kept[3] += (kept[2] - kept[3]) * share
    return float(row[0] * (1.0 - exp(-row[3] * kept[3])))


@njit
def lifts(depth: float, velocity: float, push: float, step: float, law: Array, row: Array, kept: Array) -> float:
    """Return the jump of the probe's speed when it meets the tissue again, m/s; 0 otherwise.

    ``depth`` and ``velocity`` are those of the probe, ``push`` is the force of the tissue on it while in contact, N,
    and ``kept`` holds whether it is off, the depth of the surface, the speed of the surface, the adhesion force, N, and
    the mass of the probe, kg. The free surface moves by its own mass, damping and stiffness, from its position and
    speed at separation, with an adhesion that decreases with the gap: the force is continuous at separation, so that
    the motion does not depend sensitively on it.
    """
    jump = 0.0
    if kept[0] != 0.0:
        gap = max(kept[1] - depth, 0.0)
        damping = (1.0 + row[0] * gap / _SLOWING_GAP_M) * max(_exponential(law, kernel.DAMPING, kept[1]), 1e-3)
        mass = tissue_mass(law, kept[1])
        creeping = -(elastic_force(law, kept[1]) + kept[3]) / damping
        entering = kept[2]
        kept[2] += (creeping - entering) * (1.0 - exp(-step * damping / mass) if mass > 0.0 else 1.0)
        kept[1] += 0.5 * step * (entering + kept[2])
        if depth < kept[1] or velocity < kept[2]:
            kept[3] = row[1] * exp(-max(kept[1] - depth, 0.0) / _ADHESION_REACH_M)
            return jump
        # Inelastic collision: momentum is conserved.
        jump = mass / (kept[4] + mass) * (kept[2] - velocity)
    kept[0] = 0.0 if push >= -row[1] else 1.0
    kept[1], kept[2], kept[3] = depth, velocity + jump, row[1]
    return jump
