"""Localized linear tests: mass, damping and stiffness about each level of a stepped record."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field

from tissueid.identification.base import Engine, FitReport
from tissueid.identification.family import Family
from tissueid.identification.localized.levels import find_levels
from tissueid.identification.localized.model import (
    LevelFit,
    LocalizedModel,
    curves_through,
    fit_levels,
    level_parameters,
)
from tissueid.identification.partitions.parameters import means_and_slopes
from tissueid.identification.preparation import prepare
from tissueid.identification.registry import engine
from tissueid.identification.second_order import Hold
from tissueid.identification.second_order_fit import fit_second_order
from tissueid.identification.validation import aic, aicc, vaf_percent
from tissueid.records import Estimate, Record
from tissueid.wording import number

_EACH = 4
"""Parameters of a level: mass, damping, stiffness and the output about which they hold."""


@engine
class Localized(Engine):
    """Linear tests about several levels (Chen 2010, 3.4), from one stepped record or from several records joined.

    Assumes noise so small that the tissue is linear about each level, and levels held for several memories. What the
    step itself moves is left out.
    """

    name: ClassVar[str] = "localized"
    family: ClassVar[Family] = Family.PARAMETRIC

    memory: float = Field(0.125, gt=0.0, le=10.0, description="How long a step is felt, s: left out at each level")
    levels: tuple[float, ...] | None = Field(
        None, description="The levels of the input, in its unit; found from its steps when not given"
    )
    hold: Hold = Field(
        "band-limited",
        description="What the input does between samples: a measured force is band-limited, a command is held",
    )

    def fit(self, record: Record, fit_part: slice | None = None) -> LocalizedModel:
        """Fit M, B, K about every level of a record, or of a contiguous part of it.

        Raises:
            UnusableInputError: the input has no steps, the levels are too short or all at one depth, nothing varies,
                or a memory longer than the part.
        """
        prepared = prepare(record, fit_part, self.memory, 2 * _EACH)
        memory_samples = prepared.memory_samples
        levels = find_levels(record.input, prepared.used, memory_samples, self.levels)
        found, short = fit_levels(record, prepared.used, levels, memory_samples, self.hold)
        curves = curves_through(found)
        model = LocalizedModel(
            report=FitReport(
                engine=self.name,
                options=self.options(),
                n_samples=sum(one.samples for one in found),
                n_parameters=_EACH * len(found),
                vaf_percent=float("nan"),
            ),
            sample_rate_hz=record.sample_rate_hz,
            memory_samples=memory_samples,
            levels=found,
            curves=curves,
            input_mean=prepared.input_mean,
            sign=found[0].fit.sign,
            hold=self.hold,
        )
        used = prepared.used
        simulated = model.simulate(record.input)
        residuals = np.where(used, record.output - simulated, np.nan)
        ordered = sorted(found, key=lambda one: one.position)
        middle = float(np.median([one.position for one in ordered]))
        linear = fit_second_order(record, used, self.hold)
        parameters: dict[str, Estimate] = linear.parameters
        if linear.mechanical:
            parameters = means_and_slopes(level_parameters(ordered), middle)
        count = _EACH * len(found)
        warnings = [*prepared.warnings, *_doubts(found, short)]
        return model.with_report(
            vaf_percent=vaf_percent(record.output[used], simulated[used]),
            aic=aic(residuals, count),
            aicc=aicc(residuals, count),
            parameters=parameters,
            warnings=tuple(warnings),
            findings=_findings(ordered),
            details={
                "levels": float(len(found)),
                "vaf_within_levels_median_percent": float(np.median([one.fit.vaf_percent for one in found])),
                "vaf_within_levels_least_percent": float(min(one.fit.vaf_percent for one in found)),
            },
        )


def _doubts(found: tuple[LevelFit, ...], short: int) -> list[str]:
    doubts = []
    if short:
        doubts.append(f"{short} levels were too short, or without noise about them, and are left out")
    for word in dict.fromkeys(warning for one in found for warning in one.fit.warnings):
        count = sum(word in one.fit.warnings for one in found)
        doubts.append(f"{word} (at {count} of {len(found)} levels)")
    return doubts


def _findings(ordered: list[LevelFit]) -> tuple[str, ...]:
    first, last = ordered[0], ordered[-1]
    ways = [one.level.direction for one in ordered]
    words = [
        f"{len(ordered)} levels from {1e3 * first.position:.2f} to {1e3 * last.position:.2f} mm: "
        f"{ways.count(1)} come to by pushing, {ways.count(-1)} by pulling, {ways.count(0)} by neither"
    ]
    if first.fit.mechanical:
        words.append(
            f"stiffness goes from {number(first.fit.system.stiffness, 3)} to {number(last.fit.system.stiffness, 3)} "
            f"N/m and damping from {number(first.fit.system.damping, 3)} to {number(last.fit.system.damping, 3)} N·s/m"
        )
    return tuple(words)
