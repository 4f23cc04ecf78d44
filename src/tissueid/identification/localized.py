"""Mass, damping and stiffness fitted about each level of a stepped record, and curves of depth through them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Mask, Model
from tissueid.identification.depth_levels import Level
from tissueid.identification.depth_profile import DepthProfile
from tissueid.identification.dpn.simulation import Curves, simulate_dpn, tabulate_curves
from tissueid.identification.partitions.parameters import LocalParameters
from tissueid.identification.preparation import complete_windows
from tissueid.identification.second_order import Hold
from tissueid.identification.second_order_fit import SecondOrderFit, fit_second_order
from tissueid.records import Record

_SAME_DEPTH = 0.02
"""Distance of two levels that count as one depth, relative to the range of positions."""

_LEAST_SAMPLES = 12


@dataclass(frozen=True, eq=False)
class LevelFit:
    """A level with its second-order fit, mean input and output, and lowest and highest output."""

    level: Level
    fit: SecondOrderFit
    force: float
    position: float
    low: float
    high: float
    samples: int


@dataclass(frozen=True, eq=False)
class LocalizedModel(Model):
    """M(y) y'' + B(y) y' + F(y) = u with curves through the fits at all levels.

    ``levels`` holds the fit of each stretch; ``curves`` the mass, damping and force interpolated between them. A
    simulation starts at rest under ``input_mean``.
    """

    levels: tuple[LevelFit, ...]
    curves: Curves
    input_mean: float
    sign: float
    hold: Hold

    def simulate(self, u: Array) -> Array:
        """Simulate in free run: input (n,), output (n,), at rest at the mean input before the first sample.

        A motion that diverges stays at the bound.
        """
        u = np.asarray(u, dtype=np.float64)
        run = simulate_dpn(
            self.curves, self.sign * u, self.sample_rate_hz, rest_input=self.sign * self.input_mean, hold=self.hold
        )
        padded = np.concatenate([np.ones(self.memory_samples - 1, dtype=np.bool_), np.isfinite(u)])
        complete: Mask = complete_windows(padded, self.memory_samples)[self.memory_samples - 1 :]
        return np.where(complete, run.position, np.nan)

    def depth_profile(self) -> DepthProfile:
        """Return one row per level, in the order of position; ``direction`` is that of the step to the level."""
        found = sorted(self.levels, key=lambda one: one.position)
        local = level_parameters(found)
        values = np.exp(local.log_parameters) * self.sign
        std = np.abs(values) * np.sqrt(np.einsum("kim,kim->ki", local.root, local.root))
        std[~np.isfinite([np.ravel(_log_covariance(one)) for one in found]).all(axis=1)] = np.nan
        return DepthProfile(
            position=local.position,
            low=np.array([one.low for one in found]),
            high=np.array([one.high for one in found]),
            direction=np.array([one.level.direction for one in found], dtype=np.int_),
            mass=values[:, 0],
            mass_std=std[:, 0],
            damping=values[:, 1],
            damping_std=std[:, 1],
            stiffness=values[:, 2],
            stiffness_std=std[:, 2],
            support=np.array([one.samples for one in found], dtype=np.int_),
        )


def fit_levels(
    record: Record, used: Mask, levels: tuple[Level, ...], memory_samples: int, settle_samples: int, hold: Hold
) -> tuple[tuple[LevelFit, ...], int]:
    """Fit M, B, K within each level, without the response to its step. Also return the number of levels left out.

    Left out are one memory, and after a step ``settle_samples`` or half of a short level, in which the tissue creeps.

    Raises:
        UnusableInputError: fewer than two levels are long enough.
    """
    found = []
    start: SecondOrderFit | None = None
    for level in levels:
        mask = used[level.first : level.end].copy()
        mask[:memory_samples] = False
        if level.direction:
            mask[: min(settle_samples, mask.size // 2)] = False
        if int(mask.sum()) < max(memory_samples, _LEAST_SAMPLES):
            continue
        part = record[level.first : level.end]
        output = part.output[mask]
        if float(np.ptp(output)) == 0.0 or float(np.ptp(part.input[mask])) == 0.0:
            continue
        start = fit_second_order(part, mask, hold, start=start)
        found.append(
            LevelFit(
                level=level,
                fit=start,
                force=float(np.mean(part.input[mask])),
                position=float(np.mean(output)),
                low=float(output.min()),
                high=float(output.max()),
                samples=int(mask.sum()),
            )
        )
    if len(found) < 2:
        raise UnusableInputError(
            "localized.too_few_levels",
            "{found} of {levels} levels are longer than two memories and vary enough: stay longer at each level, "
            "or shorten the memory",
            found=len(found),
            levels=len(levels),
        )
    return tuple(found), len(levels) - len(found)


def level_parameters(found: list[LevelFit]) -> LocalParameters:
    """Return the parameters of all levels, each with its covariance, which is zero if unknown."""
    root = np.zeros((len(found), 3, 3 * len(found)))
    logs = np.empty((len(found), 3))
    for row, one in enumerate(found):
        system = one.fit.system
        logs[row] = np.log([system.mass, system.damping, system.stiffness])
        covariance = _log_covariance(one)
        if np.all(np.isfinite(covariance)):
            values, vectors = np.linalg.eigh(covariance)
            root[row, :, 3 * row : 3 * row + 3] = vectors * np.sqrt(np.maximum(values, 0.0))
    return LocalParameters(np.array([one.position for one in found]), logs, root, found[0].fit.sign)


def curves_through(found: tuple[LevelFit, ...]) -> Curves:
    """Return curves with the mass and damping of the levels and a force through their mean forces.

    Levels at one depth are averaged, weighted by their samples. If the mean forces do not increase with depth, due to
    creep or adhesion, the force is the integral of the stiffness instead.

    Raises:
        UnusableInputError: all levels are at one depth.
    """
    ordered = sorted(found, key=lambda one: one.position)
    span = ordered[-1].position - ordered[0].position
    groups: list[list[LevelFit]] = []
    for one in ordered:
        if groups and one.position - groups[-1][0].position <= _SAME_DEPTH * span:
            groups[-1].append(one)
        else:
            groups.append([one])
    if len(groups) < 2:
        raise UnusableInputError("localized.one_depth", "all levels are at one depth: use larger steps of force")
    sign = found[0].fit.sign
    position, force, *logs = (np.array([_mean_of(group, index) for group in groups]) for index in range(5))
    force = sign * force
    mass, damping, stiffness = np.exp(logs)
    if not np.all(np.diff(force) > 0.0):
        rise = 0.5 * (stiffness[1:] + stiffness[:-1]) * np.diff(position)
        integral = np.concatenate([[0.0], np.cumsum(rise)])
        force = integral + float(np.mean(force - integral))
    return tabulate_curves(position, mass, damping, force)


def _mean_of(group: list[LevelFit], index: int) -> float:
    """Return the weighted mean of position, force, log M, log B or log K (``index`` 0 to 4) over levels."""
    values = [
        (one.position, one.force, *np.log([one.fit.system.mass, one.fit.system.damping, one.fit.system.stiffness]))
        for one in group
    ]
    return float(np.average([value[index] for value in values], weights=[one.samples for one in group]))


def _log_covariance(one: LevelFit) -> Array:
    return np.full((3, 3), np.nan) if one.fit.log_covariance is None else one.fit.log_covariance
