"""The repeats of one sitting: tests, which of them count, and their mean. Independent of Qt."""

from __future__ import annotations

import math
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tissueid.formatting import fixed, label_and_unit, number, plus_minus
from tissueid.language import _, marked
from tissueid.messages import MISSING, Message, translated
from tissueid.procedures.study_sitting import SittingPlan
from tissueid.procedures.test_plan import TestPlan
from tissueid.records import Estimate
from tissueid.sessions import Test
from tissueid.sessions.accepted_result import AcceptedResult, AcceptedTest, AcceptedValue
from tissueid.sessions.quality import Verdict
from tissueid.units import display_unit

if TYPE_CHECKING:
    from tissueid.analysis import Analysis
    from tissueid.app.findings import Findings

NORM = 5
"""Usual number of repeats."""
QUANTITIES = ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m")
VERDICTS: dict[str, Verdict] = {"good": "good", "check": "look", "poor": "repeat"}
"""Verdict on a repeat by the level of the verdict that its page shows."""
HEADS = ("", marked("Mean ± standard deviation"), marked("Relative"), marked("Repeatability (95 %)"))
"""Heads of the columns of :meth:`Standing.rows`."""
VALUE_HEAD = marked("Value ± standard deviation")
"""Head of the second column where it is of one test."""
_COVERAGE = 0.95
"""Share of the differences between two tests that lie within the repeatability (Bland and Altman 1999)."""
_FEWEST_REPEATS = 3
"""Fewest repeats that give a repeatability."""
_ROUNDING = 1e-9
"""Share of a mean below which a deviation is that of the arithmetic."""


@dataclass(frozen=True, eq=False)
class Repeat:
    """One test of a sitting. ``values`` are by quantity, SI; empty where it could not be identified.

    ``findings`` are what the page shows of it. :func:`repeat_of` makes one of them.
    """

    path: Path
    test: Test
    verdict: Verdict | None
    values: Mapping[str, Estimate]
    findings: Findings | None = None

    @property
    def session_id(self) -> str:
        """The id of its session."""
        return self.findings.session.session_id if self.findings is not None else ""

    @property
    def counts(self) -> bool:
        """Whether it counts for the mean: it passed the quality gate, was completed, and has values."""
        return self.verdict in ("good", "look") and self.test.status == "completed" and bool(self.values)


@dataclass(frozen=True)
class Together:
    """Mean, standard deviation of one test and repeatability of one quantity over the repeats, SI.

    ``repeatability`` is what the difference of two tests stays below in 95 % of cases (Bland and Altman 1999); None
    for two repeats, whose deviation is not known well enough.
    """

    mean: float
    std: float
    repeatability: float | None
    count: int

    @property
    def relative(self) -> float:
        """The deviation over the mean; NaN where that is zero."""
        return self.std / abs(self.mean) if self.mean else math.nan


def together(values: Sequence[Estimate]) -> Together | None:
    """Return mean and repeatability of one quantity over its repeats; None for fewer than two.

    The deviation of two repeats is at least that of their estimates: two values are often close by chance.
    """
    finite = [value for value in values if math.isfinite(value.value)]
    if len(finite) < 2:
        return None
    each = np.asarray([value.value for value in finite], np.float64)
    mean, std = float(each.mean()), float(each.std(ddof=1))
    if std < _ROUNDING * abs(mean):
        std = 0.0  # a simulation that plays the same again: its last digits are no deviation
    if each.size < _FEWEST_REPEATS:
        own = math.sqrt(sum((value.std or 0.0) ** 2 for value in finite) / each.size)
        return Together(mean, max(std, own) if std else 0.0, None, each.size)
    return Together(mean, std, repeatability(std, each.size), each.size)


def repeatability(std: float, count: int) -> float:
    """Return what the difference of two tests stays below in 95 % of cases.

    √2 times the quantile of Student's t times the deviation: 1.96 √2 for many tests, and more for few, whose deviation
    is hardly known. ``std`` is the deviation of one test among ``count`` tests, or its own by the fit where ``count``
    is 1.
    """
    from scipy.special import ndtri, stdtrit  # takes half a second to import

    share = 0.5 * (1.0 + _COVERAGE)
    return float(ndtri(share) if count == 1 else stdtrit(count - 1, share)) * math.sqrt(2.0) * std


@dataclass
class Sitting:
    """Tests of one plan, one after another, until they are accepted or the plan changes.

    One that was opened again from its files has no plan: the next test begins another sitting.
    """

    plan: TestPlan | None
    key: str = field(default_factory=lambda: str(uuid.uuid4()))
    repeats: list[Repeat] = field(default_factory=list)
    result: AcceptedResult | None = None
    wanted: int = NORM
    """Number of repeats: the usual one, or that of the protocol of a study."""

    @property
    def accepted(self) -> bool:
        """Whether the sitting was accepted."""
        return self.result is not None

    def continues(self, plan: TestPlan) -> bool:
        """Whether a test by this plan is a repeat of those that are here."""
        if self.plan is None or self.accepted or self.counted >= self.wanted:
            return False
        return _without_place(plan) == _without_place(self.plan)

    def planned(self, plan: TestPlan) -> TestPlan:
        """The plan, marked as the next repeat of this sitting."""
        return plan.model_copy(update={"sitting": self.key, "repeat": self.counted + 1})

    @property
    def counting(self) -> list[Repeat]:
        """Return the repeats that count towards the result."""
        return [repeat for repeat in self.repeats if repeat.counts]

    @property
    def counted(self) -> int:
        """Number of repeats that count."""
        return len(self.counting)

    @property
    def places(self) -> list[int]:
        """Places from 1 of the repeats that count, among all of the sitting."""
        return [number for number, repeat in enumerate(self.repeats, 1) if repeat.counts]

    @property
    def folders(self) -> list[Path]:
        """Folders that hold a test of the sitting."""
        return list(dict.fromkeys(repeat.path.parent for repeat in self.repeats))

    @property
    def acceptance(self) -> SittingPlan:
        """The plan of its acceptance."""
        return SittingPlan(key=self.key, folders=tuple(self.folders), tests=len(self.repeats))

    @property
    def values(self) -> dict[str, AcceptedValue]:
        """Mean of the repeats that count, or the values of the only one, by quantity."""
        counting = self.counting
        if len(counting) == 1:
            return {
                name: AcceptedValue(mean=estimate.value, std=estimate.std)
                for name, estimate in counting[0].values.items()
                if math.isfinite(estimate.value)
            }
        return {
            name: AcceptedValue(mean=said.mean, std=said.std, repeatability=said.repeatability, count=said.count)
            for name, said in self.together.items()
        }

    def as_result(self) -> AcceptedResult:
        """Return the tests that count as the accepted result of the sitting."""
        tests = tuple(AcceptedTest.of(item.path, item.session_id, item.test.number) for item in self.counting)
        return AcceptedResult(sitting=self.key, tests=tests, values=self.values)

    @property
    def together(self) -> dict[str, Together]:
        """Mean and repeatability by quantity; empty for fewer than two repeats."""
        means = {
            name: together([repeat.values[name] for repeat in self.counting if name in repeat.values])
            for name in QUANTITIES
        }
        return {name: said for name, said in means.items() if said is not None}

    def holds(self, path: Path) -> bool:
        """Whether a file is one of its tests."""
        return any(repeat.path == path for repeat in self.repeats)


def values_of(analyses: Mapping[str, Analysis]) -> dict[str, Estimate]:
    """Mass, damping and stiffness of the linear engine that leads, SI, as far as the record determines them."""
    from tissueid.reports.verdict import linear_engine

    name = linear_engine(analyses)
    parameters = analyses[name].model.report.reportable_parameters if name is not None else {}
    estimates = {quantity: parameters[quantity] for quantity in QUANTITIES if quantity in parameters}
    return {quantity: value for quantity, value in estimates.items() if value.std is not None}


def repeat_of(findings: Findings) -> Repeat:
    """Return an analysed test as a repeat of its sitting."""
    verdict = VERDICTS[findings.verdict.level]
    return Repeat(findings.path, findings.test, verdict, values_of(findings.analyses), findings)


@dataclass(frozen=True)
class Standing:
    """What the tests of a sitting say together: so far, or as the accepted result. Page and paper show the same.

    ``values`` are SI, by quantity. ``tests`` names the tests that went into them; ``remark`` is empty, or says what
    to bear in mind. ``accepted`` is whether a person finished the sitting.
    """

    heading: str
    values: Mapping[str, AcceptedValue]
    tests: str = ""
    remark: str = ""
    accepted: bool = False

    def rows(self, unit_for: Callable[[str], tuple[str, float]] = display_unit) -> dict[str, tuple[str, str, str, str]]:
        """Return name, value with deviation, relative deviation and repeatability as people read them, by quantity.

        ``unit_for`` returns the unit in which a value of an SI unit is read, and how many of it make one of SI.
        """
        rows = {}
        for quantity in QUANTITIES:
            if (said := self.values.get(quantity)) is None:
                continue
            name, si_unit = label_and_unit(quantity)
            unit, scale = unit_for(si_unit)
            relative = 100.0 * said.std / abs(said.mean) if said.std and said.mean else None
            rows[quantity] = (
                _(name),
                f"{plus_minus(Estimate(said.mean, said.std), scale)} {unit}",
                MISSING if relative is None else f"{fixed(relative, 1)} %",
                f"{number(scale * said.repeatability, 2)} {unit}" if said.repeatability else MISSING,
            )
        return rows


def standing(sitting: Sitting | None, result: AcceptedResult | None, shown: Findings) -> Standing | None:
    """Return what the sitting of a shown test says; None before two repeats count and nothing is accepted.

    ``sitting`` is the one in progress, if the test is of it. ``result`` is the accepted result, if there is one.
    """
    if result is not None:
        inside = result.holds(shown.session.session_id, shown.test.number)
        if result.count > 1:
            heading = translated(
                Message("sitting.accepted_mean", "Accepted result: mean of {count} repeats", count=result.count)
            )
        else:
            this_test = Message("sitting.accepted_this", "Accepted result: this test")
            other_test = Message("sitting.accepted_other", "Accepted result: another test of this sitting")
            heading = translated(this_test if inside else other_test)
        remarks = [] if inside else [_("The test that is shown below does not belong to it.")]
        values = {name: value for name, value in result.values.items() if name in QUANTITIES}
        tests = _("Tests: {names}").format(names=", ".join(test.file for test in result.tests))
        return Standing(heading, values, tests, " ".join([*remarks, *_identical(values)]), accepted=True)
    if sitting is None or sitting.counted < 2:
        return None
    values = sitting.values
    heading = translated(Message("sitting.mean_so_far", "Mean so far of {count} repeats", count=sitting.counted))
    remarks = _identical(values)
    if sitting.counted < _FEWEST_REPEATS and not remarks:
        remarks = [_("Repeatability needs three repeats.")]
    return Standing(heading, values, "", " ".join(remarks))


def _identical(values: Mapping[str, AcceptedValue]) -> list[str]:
    repeated = [value for value in values.values() if value.count > 1]
    if not repeated or any(value.std for value in repeated):
        return []
    return [_("The repeats are identical: a simulation played the same again. Nothing can be said of their spread.")]


def _without_place(plan: TestPlan) -> TestPlan:
    """What makes a plan the same test: not its file, nor how far an instrument took the usual force down."""
    force_n = 0.0 if plan.lower_force else plan.max_force_n
    return plan.model_copy(update={"out": Path(), "sitting": "", "repeat": 0, "max_force_n": force_n})
