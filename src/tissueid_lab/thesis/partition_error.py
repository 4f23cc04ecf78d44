"""Error of depth partitions against the length of their data (Chen 2010, 5.2 and Fig. 5.2), on a simulated system."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tissueid.analysis.curves.plot import Axis, Curve, Plot, depth_roles
from tissueid.errors import UnusableInputError
from tissueid.identification.engines.partitions import Depth
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Record
from tissueid_lab.thesis.simulated_systems import WienerSystem

SAMPLE_RATE_HZ = 500.0
MEMORY_S = 0.12
"""60 samples, as in Fig. 5.2."""
LEVELS_N = (1.0, 2.0, 3.0, 4.0, 5.0)
"""Mean force of each partition."""
_NOISE_N = 0.5
_TARGET_PERCENT = 5.0
"""Error that the thesis reaches from 500 samples on."""
_SYSTEM = WienerSystem()
_SETTLING = 200
"""Samples before the record, in which the system forgets that it was at rest."""


@dataclass(frozen=True)
class PartitionError:
    """Mean relative error of mass, damping and stiffness over depths and seeds, percent; NaN where no fit was possible.

    ``continuous`` samples were recorded at a level at a time, ``repetitions`` times at each of the levels.
    """

    continuous: int
    repetitions: int
    mass_percent: float
    damping_percent: float
    stiffness_percent: float

    @property
    def points(self) -> int:
        """Number of samples of the record after the first memory."""
        return self.continuous * self.repetitions * len(LEVELS_N)

    @property
    def mean_percent(self) -> float:
        """Mean error of the three parameters."""
        return (self.mass_percent + self.damping_percent + self.stiffness_percent) / 3.0


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
    engine = Depth(memory=MEMORY_S, partitions=len(LEVELS_N), downsample=1, offset="partition", hold="zero-order")
    found = []
    for seed in seeds:
        try:
            profile = engine.fit(stepped_wiener(continuous, repetitions, seed)).depth_profile()
        except UnusableInputError:
            continue
        assert profile is not None
        truth = np.array([of(profile.position) for of in (_SYSTEM.mass, _SYSTEM.damping, _SYSTEM.stiffness)])
        values = np.array([profile.mass, profile.damping, profile.stiffness])
        found.append(100.0 * np.nanmean(np.abs(values / truth - 1.0), axis=1))
    mass, damping, stiffness = np.mean(found, axis=0) if found else np.full(3, np.nan)
    return PartitionError(continuous, repetitions, float(mass), float(damping), float(stiffness))


def stepped_wiener(continuous: int, repetitions: int, seed: int) -> Record:
    """Return force and position of a Wiener system whose force steps between levels with white noise about each.

    The levels come in a new order in each repetition. One memory at the first level stands before them.
    """
    random = np.random.Generator(np.random.PCG64(seed))
    levels = np.concatenate([random.permutation(LEVELS_N) for _ in range(repetitions)])
    before = _SETTLING + round(MEMORY_S * SAMPLE_RATE_HZ) - 1
    force = np.concatenate([np.full(before, levels[0]), np.repeat(levels, continuous)])
    force = force + _NOISE_N * random.standard_normal(force.size)
    position = _SYSTEM.position(force, SAMPLE_RATE_HZ)
    return Record(force[_SETTLING:], position[_SETTLING:], SAMPLE_RATE_HZ)


def partition_error_plots(errors: Sequence[PartitionError]) -> tuple[Plot, Plot]:
    """Return the error of partitions against the length of a stretch and against all samples (Chen 2010, Fig. 5.2).

    A line for each number of repetitions; the level is 5 %.
    """
    repetitions = sorted({one.repetitions for one in errors})
    by_length, by_points = list[Curve](), list[Curve]()
    for count, role in zip(repetitions, depth_roles(len(repetitions)), strict=True):
        rows = [one for one in errors if one.repetitions == count]
        name = Message("plot.repetitions", "repetitions: {count}", count=count)
        error = np.array([one.mean_percent for one in rows])
        for into, x in ((by_length, [one.continuous for one in rows]), (by_points, [one.points for one in rows])):
            into.append(Curve(np.array(x, np.float64), error, name, role, marker="o"))
    level = Curve(np.ones(1), np.array([_TARGET_PERCENT]), "", "muted", "level", width=0.8)
    y = Axis(marked("Error of M, B and K"), "%", log=True)
    ends = [float(min(one.continuous for one in errors)), float(max(one.continuous for one in errors))]
    whole = [float(min(one.points for one in errors)), float(max(one.points for one in errors))]
    length = Axis(marked("Continuous samples"), log=True, limits=(ends[0], ends[1]))
    points = Axis(marked("Samples"), log=True, limits=(whole[0], whole[1]))
    return Plot("", length, y, (*by_length, level)), Plot("", points, y, (*by_points, level))


__all__ = ["LEVELS_N", "PartitionError", "partition_error_plots", "partition_errors", "stepped_wiener"]
