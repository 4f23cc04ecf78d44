"""Simulated systems of the thesis without an instrument: cascades, a DPN system, and what partitions find of one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tissueid.analysis.curves.plot import Axis, Curve, Plot, depth_roles
from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array
from tissueid.identification.engines.partitions import Depth
from tissueid.identification.second_order import SecondOrder
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Record

RATE_HZ = 500.0
LAGS = 40
"""Length of the impulse response of the cascades, samples."""
_GAIN, _DAMPING_RATIO, _NATURAL_RAD_PER_S = 5.0, 0.5, 220.0
_INPUT_STD = 1.2
_REST = 20.0
"""Added to every output (C.3.1), and seen as the offset in Fig. 4.3."""
_C1, _C2 = 10.257, 0.2112
_SAMPLES, _WARM = 2740, 400
_STEPS = 8
"""Steps of integration to a sample of a DPN system."""
_MEMORY_S = 0.12
"""60 samples, as in Fig. 5.2."""
_LEVELS_N = (1.0, 2.0, 3.0, 4.0, 5.0)
"""Mean force of each partition of Fig. 5.2."""
_NOISE_N = 0.5
_SETTLING = 200
"""Samples before the record, in which the system forgets that it was at rest."""
_TARGET_PERCENT = 5.0
"""Error that the thesis reaches from 500 samples on."""

CurveName = Literal["exponential", "square"]


def simulated_cascade(structure: str, curve: CurveName, seed: int = 1) -> tuple[Record, Array]:
    """Return a record of a cascade and the per-sample impulse response (lags,) of its linear stage.

    The structure is Wiener or Hammerstein. The constants are those of Chen 2010, C.3.1, and the input is white Gaussian
    noise (Figs. 4.3 and 4.4). The response ends at 40 samples, so that a model of that memory can hold all of it.
    """
    t = np.arange(LAGS) / RATE_HZ
    damped = _NATURAL_RAD_PER_S * np.sqrt(1.0 - _DAMPING_RATIO**2)
    h = np.exp(-_DAMPING_RATIO * _NATURAL_RAD_PER_S * t) * np.sin(damped * t)
    h *= _GAIN / h.sum()
    u = _INPUT_STD * np.random.Generator(np.random.PCG64(seed)).standard_normal(_SAMPLES + _WARM)

    def bent(v: Array) -> Array:
        return np.asarray(v**2 if curve == "square" else _C1 * (1.0 - np.exp(-_C2 * v)))

    def filtered(v: Array) -> Array:
        return np.convolve(v, h)[: v.size]

    y = bent(filtered(u)) if structure == "Wiener" else filtered(bent(u))
    return Record(u[_WARM:], y[_WARM:] + _REST, RATE_HZ, "input", "output", "", ""), h


@dataclass(frozen=True)
class DpnSystem:
    """M y'' + B exp(a y) y' + K (exp(b y) + d) y = force (Chen 2010, Eq. 3.33 and C.1.4), SI.

    ``mass``, ``damping`` and ``stiffness`` are its values for small motion about a position.
    """

    mass_kg: float = 0.06
    damping_n_s_per_m: float = 20.0
    stiffness_n_per_m: float = 1000.0
    damping_growth_per_m: float = 150.0
    stiffness_growth_per_m: float = 200.0
    stiffness_offset: float = 0.1

    def mass(self, position: Array) -> Array:
        """Return the mass at positions, kg."""
        return np.full_like(position, self.mass_kg)

    def damping(self, position: Array) -> Array:
        """Return the damping at positions, N s/m."""
        return np.asarray(self.damping_n_s_per_m * np.exp(self.damping_growth_per_m * position))

    def stiffness(self, position: Array) -> Array:
        """Return the slope of the static force at positions, N/m."""
        growth = self.stiffness_growth_per_m * position
        return np.asarray(self.stiffness_n_per_m * (np.exp(growth) * (1.0 + growth) + self.stiffness_offset))

    def position(self, force: Array, sample_rate_hz: float) -> Array:
        """Return positions (n,), m, under a force (n,), N, that is held between samples; at rest before the first."""
        step = 1.0 / (_STEPS * sample_rate_hz)
        y = v = 0.0
        positions = np.empty(force.size)
        for n, push in enumerate(force.tolist()):
            positions[n] = y
            for _ in range(_STEPS):  # semi-implicit: stable for a damped system at this step
                grown = np.exp(self.stiffness_growth_per_m * y)
                spring = self.stiffness_n_per_m * (grown + self.stiffness_offset) * y
                damping = self.damping_n_s_per_m * np.exp(self.damping_growth_per_m * y)
                v = (v + step * (push - spring) / self.mass_kg) / (1.0 + step * damping / self.mass_kg)
                y += step * v
        return positions


_LINEAR = SecondOrder(0.06, 20.0, 1000.0)
"""Mass, damping and stiffness of C.1.4."""


@dataclass(frozen=True)
class WienerSystem:
    """A second-order system and the curve C1 (1 - exp(-C2 K z)) (Chen 2010, Eq. 3.26 and C.1.4), SI."""

    system: SecondOrder = _LINEAR
    c1_m: float = 0.007
    c2_per_n: float = 0.2

    def mass(self, position: Array) -> Array:
        """Return the mass at positions, kg."""
        return self.system.mass * self._inverse_slope(position)

    def damping(self, position: Array) -> Array:
        """Return the damping at positions, N s/m."""
        return self.system.damping * self._inverse_slope(position)

    def stiffness(self, position: Array) -> Array:
        """Return the inverse slope of the curve at positions, N/m."""
        return self.system.stiffness * self._inverse_slope(position)

    def _inverse_slope(self, position: Array) -> Array:
        return np.asarray(1.0 / (self.c2_per_n * (self.c1_m - position) * self.system.stiffness))

    def position(self, force: Array, sample_rate_hz: float) -> Array:
        """Return positions (n,), m, under a force (n,), N, that is held between samples; at rest before the first."""
        load = self.system.stiffness * self.system.simulate(force, sample_rate_hz, "zero-order")
        return np.asarray(self.c1_m * (1.0 - np.exp(-self.c2_per_n * load)))


# -- error of depth partitions against the length of their data (Chen 2010, 5.2 and Fig. 5.2) -------------------------


@dataclass(frozen=True)
class PartitionError:
    """Mean relative error of mass, damping and stiffness over depths and seeds, percent; NaN where no fit was possible.

    ``continuous`` samples were recorded at a level at a time, ``repetitions`` times at each of the levels.
    """

    continuous: int
    repetitions: int
    mean_percent: float

    @property
    def points(self) -> int:
        """Number of samples of the record after the first memory."""
        return self.continuous * self.repetitions * len(_LEVELS_N)


def partition_errors(
    continuous: Sequence[int], repetitions: Sequence[int], seeds: Sequence[int]
) -> tuple[PartitionError, ...]:
    """Fit depth partitions to a stepped Wiener system for every length and number of repetitions.

    Args:
        continuous: lengths of a stretch at one level, samples.
        repetitions: numbers of stretches at each level.
        seeds: of the levels' order and the noise; errors are averaged over them.
    """
    return tuple(_error(length, count, seeds) for count in repetitions for length in continuous)


def _error(continuous: int, repetitions: int, seeds: Sequence[int]) -> PartitionError:
    engine = Depth(memory=_MEMORY_S, partitions=len(_LEVELS_N), downsample=1, offset="partition", hold="zero-order")
    system, percents = WienerSystem(), []
    for seed in seeds:
        try:
            profile = engine.fit(_stepped(system, continuous, repetitions, seed)).depth_profile()
        except UnusableInputError:
            continue
        assert profile is not None
        truth = np.array([of(profile.position) for of in (system.mass, system.damping, system.stiffness)])
        values = np.array([profile.mass, profile.damping, profile.stiffness])
        percents.append(100.0 * float(np.nanmean(np.abs(values / truth - 1.0), axis=1).mean()))
    return PartitionError(continuous, repetitions, float(np.mean(percents)) if percents else float("nan"))


def _stepped(system: WienerSystem, continuous: int, repetitions: int, seed: int) -> Record:
    """Return force and position of a system whose force steps between levels with white noise about each.

    The levels come in a new order in each repetition. One memory at the first level stands before them.
    """
    random = np.random.Generator(np.random.PCG64(seed))
    levels = np.concatenate([random.permutation(_LEVELS_N) for _ in range(repetitions)])
    before = _SETTLING + round(_MEMORY_S * RATE_HZ) - 1
    force = np.concatenate([np.full(before, levels[0]), np.repeat(levels, continuous)])
    force = force + _NOISE_N * random.standard_normal(force.size)
    position = system.position(force, RATE_HZ)
    return Record(force[_SETTLING:], position[_SETTLING:], RATE_HZ)


def partition_error_plots(errors: Sequence[PartitionError]) -> tuple[Plot, Plot]:
    """Return the error of partitions against the length of a stretch and against all samples (Chen 2010, Fig. 5.2).

    A line for each number of repetitions; the level is 5 %.
    """
    repetitions = sorted({case.repetitions for case in errors})
    level = Curve(np.ones(1), np.array([_TARGET_PERCENT]), "", "muted", "level", width=0.8)

    def against(label: str, size: Callable[[PartitionError], int]) -> Plot:
        curves = []
        for count, role in zip(repetitions, depth_roles(len(repetitions)), strict=True):
            rows = [item for item in errors if item.repetitions == count]
            name = Message("plot.repetitions", "repetitions: {count}", count=count)
            error = np.array([item.mean_percent for item in rows])
            curves.append(Curve(np.array([float(size(item)) for item in rows]), error, name, role, marker="o"))
        limits = float(min(map(size, errors))), float(max(map(size, errors)))
        y = Axis(marked("Error of M, B and K"), "%", log=True)
        return Plot("", Axis(label, log=True, limits=limits), y, (*curves, level))

    return (
        against(marked("Continuous samples"), lambda error: error.continuous),
        against(marked("Samples"), lambda error: error.points),
    )
