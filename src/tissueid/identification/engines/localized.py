"""Localized linear tests: mass, damping and stiffness about each level of a stepped record."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from tissueid.formatting import number
from tissueid.identification.base import option
from tissueid.identification.depth_levels import find_levels, localized_levels
from tissueid.identification.localized import (
    LevelFit,
    LocalizedModel,
    curves_through,
    fit_levels,
    level_parameters,
)
from tissueid.identification.memory import MemoryEngine
from tissueid.identification.model_family import Family
from tissueid.identification.partitions.parameters import means_and_slopes
from tissueid.identification.preparation import prepare
from tissueid.identification.registry import engine
from tissueid.identification.second_order_fit import fit_second_order
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Estimate, Record

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
        found, short = fit_levels(record, prepared.used, levels, memory_samples, settle_samples, self.hold)
        curves = curves_through(found)
        model = LocalizedModel(
            report=self.unscored(sum(level.samples for level in found), _EACH * len(found)),
            sample_rate_hz=record.sample_rate_hz,
            memory_samples=memory_samples,
            levels=found,
            curves=curves,
            input_mean=prepared.input_mean,
            sign=found[0].fit.sign,
            hold=self.hold,
        )
        used = prepared.used
        ordered = sorted(found, key=lambda one: one.position)
        middle = float(np.median([one.position for one in ordered]))
        linear = fit_second_order(record, used, self.hold)
        parameters: dict[str, Estimate] = linear.parameters
        if linear.mechanical:
            parameters = means_and_slopes(level_parameters(ordered), middle)
        warnings = [*prepared.warnings, *_warnings(found, short)]
        return model.with_fit_scores(record, used).with_report(
            parameters=parameters,
            warnings=tuple(warnings),
            findings=_findings(ordered),
            details={
                "levels": float(len(found)),
                "vaf_within_levels_median_percent": float(np.median([one.fit.vaf_percent for one in found])),
                "vaf_within_levels_least_percent": float(min(one.fit.vaf_percent for one in found)),
            },
        )


def _warnings(found: tuple[LevelFit, ...], short: int) -> list[str]:
    doubts: list[str] = []
    if short:
        doubts.append(
            Message(
                "localized.left_out",
                "{count} levels are left out: too short, or without noise about their mean",
                count=short,
            )
        )
    for word in dict.fromkeys(warning for one in found for warning in one.fit.warnings):
        count = sum(word in one.fit.warnings for one in found)
        doubts.append(
            Message(
                "localized.at_levels",
                "{warning} (at {count} of {levels} levels)",
                warning=word,
                count=count,
                levels=len(found),
            )
        )
    return doubts


def _findings(ordered: list[LevelFit]) -> tuple[str, ...]:
    first, last = ordered[0], ordered[-1]
    ways = [one.level.direction for one in ordered]
    found: list[str] = [
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
        found.append(
            Message(
                "localized.stiffness",
                "stiffness is {start} N/m at the lowest level and {end} N/m at the highest",
                start=number(first.fit.system.stiffness, 3),
                end=number(last.fit.system.stiffness, 3),
            )
        )
    return tuple(found)
