"""Localized linear tests: mass, damping and stiffness about each level of a stepped record."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tissueid.errors import UnusableInputError
from tissueid.formatting import number
from tissueid.identification.base import Array, Family, Mask, Model, option
from tissueid.identification.depth_levels import Level, find_levels, localized_levels
from tissueid.identification.depth_profile import DepthProfile
from tissueid.identification.dpn.simulation import Curves, simulate_dpn, tabulate_curves
from tissueid.identification.memory import MemoryEngine
from tissueid.identification.partitions.parameters import LocalParameters, means_and_slopes
from tissueid.identification.preparation import complete_after_rest, prepare
from tissueid.identification.registry import engine
from tissueid.identification.second_order import Hold
from tissueid.identification.second_order_fit import SecondOrderFit, fit_second_order
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Estimate, Record

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
        return np.where(complete_after_rest(np.isfinite(u), self.memory_samples), run.position, np.nan)

    def depth_profile(self) -> DepthProfile:
        """Return one row per level, in the order of position; ``direction`` is that of the step to the level."""
        ordered = sorted(self.levels, key=lambda level_fit: level_fit.position)
        local = level_parameters(ordered)
        values = np.exp(local.log_parameters) * self.sign
        std = np.abs(values) * np.sqrt(np.einsum("kim,kim->ki", local.root, local.root))
        std[~np.isfinite([np.ravel(_log_covariance(level_fit)) for level_fit in ordered]).all(axis=1)] = np.nan
        return DepthProfile(
            position=local.position,
            low=np.array([level_fit.low for level_fit in ordered]),
            high=np.array([level_fit.high for level_fit in ordered]),
            direction=np.array([level_fit.level.direction for level_fit in ordered], dtype=np.int_),
            mass=values[:, 0],
            mass_std=std[:, 0],
            damping=values[:, 1],
            damping_std=std[:, 1],
            stiffness=values[:, 2],
            stiffness_std=std[:, 2],
            support=np.array([level_fit.samples for level_fit in ordered], dtype=np.int_),
        )


def fit_levels(
    record: Record, used: Mask, levels: tuple[Level, ...], memory_samples: int, settle_samples: int, hold: Hold
) -> tuple[tuple[LevelFit, ...], int]:
    """Fit M, B, K within each level, without the response to its step. Also return the number of levels left out.

    Left out are one memory, and after a step ``settle_samples`` or half of a short level, in which the tissue creeps.

    Raises:
        UnusableInputError: fewer than two levels are long enough.
    """
    fits = []
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
        fits.append(
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
    if len(fits) < 2:
        raise UnusableInputError(
            "localized.too_few_levels",
            "{found} of {levels} levels are longer than two memories and vary enough: stay longer at each level, "
            "or shorten the memory",
            found=len(fits),
            levels=len(levels),
        )
    return tuple(fits), len(levels) - len(fits)


def level_parameters(fits: list[LevelFit]) -> LocalParameters:
    """Return the parameters of all levels, each with its covariance, which is zero if unknown."""
    root = np.zeros((len(fits), 3, 3 * len(fits)))
    logs = np.empty((len(fits), 3))
    for row, level_fit in enumerate(fits):
        system = level_fit.fit.system
        logs[row] = np.log([system.mass, system.damping, system.stiffness])
        covariance = _log_covariance(level_fit)
        if np.all(np.isfinite(covariance)):
            values, vectors = np.linalg.eigh(covariance)
            root[row, :, 3 * row : 3 * row + 3] = vectors * np.sqrt(np.maximum(values, 0.0))
    return LocalParameters(np.array([level_fit.position for level_fit in fits]), logs, root, fits[0].fit.sign)


def curves_through(fits: tuple[LevelFit, ...]) -> Curves:
    """Return curves with the mass and damping of the levels and a force through their mean forces.

    Levels at one depth are averaged, weighted by their samples. If the mean forces do not increase with depth, due to
    creep or adhesion, the force is the integral of the stiffness instead.

    Raises:
        UnusableInputError: all levels are at one depth.
    """
    ordered = sorted(fits, key=lambda level_fit: level_fit.position)
    span = ordered[-1].position - ordered[0].position
    groups: list[list[LevelFit]] = []
    for level_fit in ordered:
        if groups and level_fit.position - groups[-1][0].position <= _SAME_DEPTH * span:
            groups[-1].append(level_fit)
        else:
            groups.append([level_fit])
    if len(groups) < 2:
        raise UnusableInputError("localized.one_depth", "all levels are at one depth: use larger steps of force")
    sign = fits[0].fit.sign
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
        (
            level_fit.position,
            level_fit.force,
            *np.log([level_fit.fit.system.mass, level_fit.fit.system.damping, level_fit.fit.system.stiffness]),
        )
        for level_fit in group
    ]
    return float(np.average([value[index] for value in values], weights=[level_fit.samples for level_fit in group]))


def _log_covariance(level_fit: LevelFit) -> Array:
    return np.full((3, 3), np.nan) if level_fit.fit.log_covariance is None else level_fit.fit.log_covariance


_EACH = 4
"""Number of parameters per level: mass, damping, stiffness and mean output."""


@engine
class Localized(MemoryEngine):
    """Localized engine.

    Assumes noise so small that the tissue is linear about each level, and levels held for several memories. The
    response to the step itself is excluded.
    """

    name: ClassVar[str] = "localized"
    label: ClassVar[str] = marked("Localized")
    title: ClassVar[str] = marked(
        "Linear tests about several levels (Chen 2010, 3.4), from one stepped record or from several records joined."
    )
    family: ClassVar[Family] = Family.PARAMETRIC

    settle: float = option(
        0.25,
        marked("Settling time"),
        marked("Time after a step in which the tissue creeps, s; excluded, up to half of each level"),
        ge=0.0,
        le=10.0,
    )
    levels: tuple[float, ...] | None = option(
        None, marked("Levels"), marked("Levels of the input, in its unit; from its steps if not given")
    )

    @classmethod
    def in_report_of(cls, record: Record) -> bool:
        """Return whether the record is a localized test: small noise about several levels."""
        return bool(localized_levels(record))

    def fit(self, record: Record, fit_part: slice | None = None) -> LocalizedModel:
        """Fit M, B, K about every level of a record, or of a contiguous part of it.

        Raises:
            UnusableInputError: the input has no steps, the levels are too short or all at one depth, nothing varies, or
                the memory is longer than the part.
        """
        prepared = prepare(record, fit_part, self.memory_s, 2 * _EACH)
        memory_samples = prepared.memory_samples
        levels = find_levels(record.input, prepared.used, memory_samples, self.levels, record.joints)
        settle_samples = round(self.settle * record.sample_rate_hz)
        fits, short = fit_levels(record, prepared.used, levels, memory_samples, settle_samples, self.hold)
        curves = curves_through(fits)
        model = LocalizedModel(
            report=self.unscored(sum(level.samples for level in fits), _EACH * len(fits)),
            sample_rate_hz=record.sample_rate_hz,
            memory_samples=memory_samples,
            levels=fits,
            curves=curves,
            input_mean=prepared.input_mean,
            sign=fits[0].fit.sign,
            hold=self.hold,
        )
        used = prepared.used
        ordered = sorted(fits, key=lambda level_fit: level_fit.position)
        middle = float(np.median([level_fit.position for level_fit in ordered]))
        linear = fit_second_order(record, used, self.hold)
        parameters: dict[str, Estimate] = linear.parameters
        if linear.mechanical:
            parameters = means_and_slopes(level_parameters(ordered), middle)
        warnings = [*prepared.warnings, *_warnings(fits, short)]
        return model.with_fit_scores(record, used).with_report(
            parameters=parameters,
            warnings=tuple(warnings),
            findings=_findings(ordered),
            details={
                "levels": float(len(fits)),
                "vaf_within_levels_median_percent": float(np.median([level_fit.fit.vaf_percent for level_fit in fits])),
                "vaf_within_levels_least_percent": float(min(level_fit.fit.vaf_percent for level_fit in fits)),
            },
        )


def _warnings(fits: tuple[LevelFit, ...], short: int) -> list[str]:
    doubts: list[str] = []
    if short:
        doubts.append(
            Message(
                "localized.left_out",
                "{count} levels are left out: too short, or without noise about their mean",
                count=short,
            )
        )
    for word in dict.fromkeys(warning for level_fit in fits for warning in level_fit.fit.warnings):
        count = sum(word in level_fit.fit.warnings for level_fit in fits)
        doubts.append(
            Message(
                "localized.at_levels",
                "{warning} (at {count} of {levels} levels)",
                warning=word,
                count=count,
                levels=len(fits),
            )
        )
    return doubts


def _findings(ordered: list[LevelFit]) -> tuple[str, ...]:
    first, last = ordered[0], ordered[-1]
    ways = [level_fit.level.direction for level_fit in ordered]
    messages: list[str] = [
        Message(
            "localized.levels",
            "{levels} levels from {low:.2f} to {high:.2f} mm: {pushing} reached by increasing force, {pulling} by "
            "decreasing force, {neither} by neither",
            levels=len(ordered),
            low=1e3 * first.position,
            high=1e3 * last.position,
            pushing=ways.count(1),
            pulling=ways.count(-1),
            neither=ways.count(0),
        )
    ]
    if first.fit.mechanical:
        messages.append(
            Message(
                "localized.stiffness",
                "stiffness is {start} N/m at the lowest level and {end} N/m at the highest",
                start=number(first.fit.system.stiffness, 3),
                end=number(last.fit.system.stiffness, 3),
            )
        )
    return tuple(messages)
