"""The repeats of one sitting: what was run, what counts, and what they say together. Nothing here knows Qt."""

from __future__ import annotations

import math
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tissueid.app.plan import Plan
from tissueid.records import Estimate
from tissueid.sessions import Test
from tissueid.sessions.quality import Verdict
from tissueid.wording import fixed, named_unit, number, people_unit, plus_minus

if TYPE_CHECKING:
    from tissueid.analysis import Analysis

NORM = 5
"""Repeats that are usual."""
QUANTITIES = ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m")
_TWO_TESTS = 1.96 * math.sqrt(2.0)
"""Deviations of one test within which 95 % of the differences between two of them lie (Bland and Altman 1999)."""
_ROUNDING = 1e-9
"""Share of a mean below which a deviation is that of the arithmetic."""


@dataclass(frozen=True, eq=False)
class Repeat:
    """One test of a sitting. ``values`` are by quantity, SI; empty where it could not be identified."""

    path: Path
    test: Test
    verdict: Verdict | None
    values: Mapping[str, Estimate]

    @property
    def counts(self) -> bool:
        """Whether it goes into the mean: the gate let it pass, it came to its end, and there are numbers."""
        return self.verdict in ("good", "look") and self.test.status == "completed" and bool(self.values)


@dataclass(frozen=True)
class Together:
    """What repeats say of one quantity, SI: their mean, the deviation of one, and their repeatability.

    ``repeatability`` is what the difference of two tests stays below in 95 % of cases (Bland and Altman 1999).
    """

    mean: float
    std: float
    repeatability: float
    count: int

    @property
    def relative(self) -> float:
        """The deviation over the mean; NaN where that is zero."""
        return self.std / abs(self.mean) if self.mean else math.nan


def together(values: Sequence[float]) -> Together | None:
    """Mean and repeatability of one quantity over its repeats, shape (n,); None for fewer than two."""
    known = np.asarray([value for value in values if math.isfinite(value)], np.float64)
    if known.size < 2:
        return None
    mean, std = float(known.mean()), float(known.std(ddof=1))
    if std < _ROUNDING * abs(mean):
        std = 0.0  # a simulation that plays the same again: its last digits are no deviation
    return Together(mean, std, _TWO_TESTS * std, int(known.size))


@dataclass
class Sitting:
    """Tests of one plan, one after another, until somebody accepts them or the plan changes."""

    plan: Plan
    key: str = field(default_factory=lambda: str(uuid.uuid4()))
    repeats: list[Repeat] = field(default_factory=list)
    accepted: bool = False

    def continues(self, plan: Plan) -> bool:
        """Whether a test by this plan is a repeat of those that are here."""
        return not self.accepted and self.counted < NORM and _without_place(plan) == _without_place(self.plan)

    def planned(self, plan: Plan) -> Plan:
        """The plan, marked as the next repeat of this sitting."""
        return replace(plan, sitting=self.key, repeat=self.counted + 1)

    @property
    def counting(self) -> list[Repeat]:
        """The repeats that count."""
        return [repeat for repeat in self.repeats if repeat.counts]

    @property
    def counted(self) -> int:
        """How many they are."""
        return len(self.counting)

    @property
    def together(self) -> dict[str, Together]:
        """What they say, by quantity; nothing for fewer than two."""
        found = {
            name: together([repeat.values[name].value for repeat in self.counting if name in repeat.values])
            for name in QUANTITIES
        }
        return {name: said for name, said in found.items() if said is not None}

    def holds(self, path: Path) -> bool:
        """Whether a file is one of its tests."""
        return any(repeat.path == path for repeat in self.repeats)


def values_of(analyses: Mapping[str, Analysis]) -> dict[str, Estimate]:
    """Mass, damping and stiffness of the linear engine that leads, SI, where there are any."""
    from tissueid.reports.verdict import linear_engine

    name = linear_engine(analyses)
    parameters = analyses[name].model.report.reportable_parameters if name is not None else {}
    return {quantity: parameters[quantity] for quantity in QUANTITIES if quantity in parameters}


def rows_of(
    sitting: Sitting | None, unit_for: Callable[[str], tuple[str, float]] = people_unit
) -> dict[str, tuple[str, str, str, str]]:
    """Name, mean with deviation, relative deviation and repeatability as people read them, by quantity.

    ``unit_for`` says in which unit what is of an SI unit is read, and how many of it make one of SI.
    """
    rows = {}
    for quantity, said in (sitting.together if sitting is not None else {}).items():
        name, si_unit = named_unit(quantity)
        unit, scale = unit_for(si_unit)
        rows[quantity] = (
            name,
            f"{plus_minus(Estimate(said.mean, said.std), scale)} {unit}",
            f"{fixed(100.0 * said.relative, 1)} %",
            f"{number(scale * said.repeatability, 2)} {unit}",
        )
    return rows


def _without_place(plan: Plan) -> Plan:
    """What makes a plan the same test: not its file, nor how far an instrument took the usual force down."""
    force_n = 0.0 if plan.lower_force else plan.max_force_n
    return replace(plan, path=Path(), sitting="", repeat=0, max_force_n=force_n)
