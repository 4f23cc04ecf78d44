"""The recommendation as a clinician reads it: what was found, why, what to doubt, and what to measure next."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tissueid.identification.family import Family
from tissueid.records import Record
from tissueid.wording import engine_label, fixed, number, people_unit, with_unit

if TYPE_CHECKING:
    from tissueid.identification.recommendation import Choice, Standing

_SHORT_S = 1.0
"""Held-out parts shorter than this hold too few independent stretches for their differences to be trusted."""

_COARSE_POINTS = 2.0
"""A standard deviation of a difference from which the record can hardly tell descriptions apart."""

_NARROW, _BEYOND = 0.8, 0.05
"""Shares of the fitted range: a held-out range below the first is narrow; what exceeds it by the second is new."""

_DESCRIBES_PERCENT = 50.0
"""Held-out VAF below which a description is none."""

_POINTS_WORTH_TELLING = 5.0
_POINTS_SHOWN = 0.1
"""A lead of fewer points does not matter, however sure it is."""

_LEFT_TO_CEILING = 3.0
_LONGEST_WORTH_ASKING = 20.0
_QUANTILES = (0.01, 0.99)

_KINDS = {
    Family.LINEAR: "the linear models",
    Family.STATIC: "the static nonlinearities",
    Family.PARAMETRIC: "the models whose parameters follow depth",
    Family.DEPTH: "the depth partitions",
    Family.DIRECTION: "the depth and direction partitions",
    Family.KERNELS: "the Volterra kernels",
    Family.OTHER: "the others",
}


@dataclass(frozen=True, eq=False)
class Told:
    """What the words are made from: the chosen candidate, all of them best first, and the two parts of the record."""

    chosen: Standing
    standings: tuple[Standing, ...]
    held_out: Record
    fitted: Record
    ceiling_percent: float | None

    @property
    def best(self) -> Standing:
        """The candidate with the highest held-out VAF."""
        return self.standings[0]

    @property
    def lowest_aicc(self) -> Standing | None:
        """The engine that AICc prefers."""
        known = [s for s in self.standings if s.aicc is not None and np.isfinite(s.aicc) and not s.second_order]
        return min(known, key=lambda s: s.aicc or 0.0, default=None)

    @property
    def seconds(self) -> float:
        """Length of what was held out."""
        return float(np.isfinite(self.held_out.output).sum()) / self.held_out.sample_rate_hz

    @property
    def place(self) -> str:
        """What the output is called when one value of it is meant."""
        return "depth" if self.held_out.output_name == "position" else self.held_out.output_name


def headline(told: Told) -> str:
    """One sentence: which description, and what that says of the tissue."""
    chosen, place = told.chosen, told.place
    name, score = _name(chosen), f"{fixed(chosen.vaf_percent, 1)} % of motion that it had not seen"
    if told.held_out.output_name != "position":
        score = score.replace("motion", "what was measured")
    if chosen.vaf_percent < _DESCRIBES_PERCENT:
        return f"None of these descriptions holds; the least bad is {name}: {score}. Check the signals."
    if len({standing.family for standing in told.standings}) == 1:
        return f"Of {_KINDS[chosen.family]}, the only ones that were tried, {name} does best: {score}."
    first = {
        Family.LINEAR: "A linear model describes this record as well as any that was tried",
        Family.STATIC: f"{place.capitalize()} matters in the simplest way: linear dynamics and one curve",
        Family.PARAMETRIC: f"{place.capitalize()} matters: mass, damping and stiffness each follow it in their own way",
        Family.DEPTH: f"{place.capitalize()} matters: the response is another one in each range of it",
        Family.DIRECTION: f"{place.capitalize()} and direction matter: the response differs between going in and out",
        Family.KERNELS: "The response is nonlinear in a way that only kernels of higher order describe",
        Family.OTHER: "None of the usual families does as well as this engine",
    }[chosen.family]
    return f"{first} ({name}: {score})."


def choice(found: Choice) -> str:
    """What was found of an option."""
    value = number(found.value, 3)
    if found.option == "memory":
        more = "longer ones gain nothing" if found.value < max(found.tried) else "a still longer one was not tried"
        return f"A memory of {value} s is enough; {more}."
    if found.option == "partitions":
        more = "more gain nothing" if found.value < max(found.tried) else "more were not tried"
        return f"{value} partitions are enough; {more}."
    if found.option == "order":
        return f"Kernels up to order {value} are enough of those that were tried."
    return f"A value of {value} is enough for the option {found.option}."


def reasons(told: Told) -> Iterator[str]:
    """Why this one: what it gains on simpler ones, and why better ones were left."""
    chosen, best = told.chosen, told.best
    simpler = [s for s in told.standings if s.beaten and s.family.rank < chosen.family.rank]
    best_of = {s.family: s for s in reversed(simpler)}
    for standing in sorted(best_of.values(), key=lambda s: s.family.rank):
        below = standing.below
        yield (
            f"{_name(chosen)} accounts for {_plus_minus(below.points, below.std_points)} points more than "
            f"{_name(standing)} on the same samples, the best of {_KINDS[standing.family]}{_chance(below.p_value)}."
        )
    if best is not chosen:
        lead = chosen.behind
        why = (
            f"takes away only {fixed(100.0 * lead.reduction, 1)} % of what is left unexplained"
            if lead.p_value is not None and lead.p_value < 0.05 and lead.points > _POINTS_SHOWN
            else f"is {fixed(lead.points, 2)} points away, too little to matter"
            if lead.p_value is not None and lead.p_value < 0.05
            else f"is within chance ({_plus_minus(lead.points, lead.std_points)} points{_chance(lead.p_value)})"
        )
        score = f"The highest score, {fixed(best.vaf_percent, 1)} % by {_name(best)}"
        is_simpler = chosen.second_order or chosen.family.rank < best.family.rank
        yield f"{score}, {why}; {'the simpler one is preferred' if is_simpler else 'AICc decides'}."
    if chosen.second_order:
        yield "Mass, damping and stiffness alone do as well as the whole impulse response."
    lowest = told.lowest_aicc
    if lowest is not None and lowest.engine == chosen.engine:
        yield f"AICc on the fitted samples prefers {engine_label(lowest.engine)} too."


def doubts(told: Told) -> Iterator[str]:
    """What to know before relying on it."""
    chosen = told.chosen
    if told.seconds < _SHORT_S:
        yield f"Only {number(told.seconds, 2)} s were held out: differences between descriptions are hardly tested."
    elif (coarse := _coarsest(told)) > _COARSE_POINTS:
        yield f"Differences are known to {fixed(coarse, 1)} points only: a longer test would tell more apart."
    yield from _ranges(told)
    lost = chosen.vaf_fitted_percent - chosen.vaf_percent
    if lost > _POINTS_WORTH_TELLING:
        yield (
            f"{_name(chosen)} loses {fixed(lost, 1)} points from fitted to unseen samples: it learned the record "
            "rather than the tissue, or the tissue changed."
        )
    lowest = told.lowest_aicc
    if lowest is not None and lowest.engine != chosen.engine:
        yield (
            f"AICc on the fitted samples prefers {engine_label(lowest.engine)}; it takes errors for independent, "
            "which they are not, so unseen samples decide here."
        )
    told_depth = [s for s in told.standings if s.scheduled_percent is not None]
    guided = max(told_depth, key=lambda s: s.scheduled_percent or 0.0, default=None)
    if guided is not None and (guided.scheduled_percent or 0.0) > told.best.vaf_percent + _POINTS_WORTH_TELLING:
        yield (
            f"Given the measured {told.place}, {engine_label(guided.engine)} accounts for "
            f"{fixed(guided.scheduled_percent, 1)} %, free-running for {fixed(guided.vaf_percent, 1)} %: what it "
            "is told of the output already holds part of the answer."
        )
    if told.ceiling_percent is not None and told.ceiling_percent - told.best.vaf_percent > _LEFT_TO_CEILING:
        left = told.ceiling_percent - told.best.vaf_percent
        yield (
            f"Repeats agree to {fixed(told.ceiling_percent, 1)} %: {fixed(left, 1)} points are there to be explained "
            "and no description explains them."
        )


def experiments(told: Told) -> Iterator[str]:
    """What to measure to know more."""
    chosen, lead = told.chosen, told.chosen.behind
    if chosen is not told.best and lead.std_points and lead.points > 0.0:
        # one-sided test at 5 % that sees a lead of this size four times in five
        times = ((1.645 + 0.84) * lead.std_points / lead.points) ** 2
        if 1.0 < times < _LONGEST_WORTH_ASKING:
            yield (
                f"{number(times * told.seconds, 2)} s of unseen motion in place of {number(told.seconds, 2)} s would "
                f"tell whether {_name(told.best)} is really better."
            )
    small = "Small tests about two or more mean forces would"
    yield {
        Family.LINEAR: f"A test over a larger range of force would show whether {told.place} matters.",
        Family.STATIC: f"{small} measure stiffness at each {told.place} directly.",
        Family.PARAMETRIC: f"{small} check the parameters at each {told.place}.",
        Family.DEPTH: f"{small} check the parameters at each {told.place}.",
        Family.DIRECTION: "A slow ramp in and out would show the loop that a difference between directions leaves.",
        Family.KERNELS: f"{small} show whether {told.place} lies behind it.",
        Family.OTHER: f"{small} show what changes between them.",
    }[chosen.family]
    if told.ceiling_percent is None:
        yield "A repeat of the same test would show how much there is to be explained at all."
    elif told.ceiling_percent - told.best.vaf_percent > _LEFT_TO_CEILING:
        yield "A slow ramp and a hold would show creep and loops, which none of these descriptions holds."


def _ranges(told: Told) -> Iterator[str]:
    """Where the held-out part goes that the fitted one did not, and where it does not go."""
    unit, scale = people_unit(told.held_out.output_unit)
    fitted, unseen = (
        scale * np.quantile(part.output[np.isfinite(part.output)], _QUANTILES) for part in (told.fitted, told.held_out)
    )
    span = fitted[1] - fitted[0]
    both = (
        f"(fitted {number(fitted[0], 3)} to {with_unit(number(fitted[1], 3), unit)}, "
        f"unseen {number(unseen[0], 3)} to {with_unit(number(unseen[1], 3), unit)})"
    )
    if unseen[1] > fitted[1] + _BEYOND * span or unseen[0] < fitted[0] - _BEYOND * span:
        yield f"The unseen part leaves the range that was fitted {both}: part of the error is extrapolation."
    elif unseen[1] - unseen[0] < _NARROW * span:
        yield f"The unseen part covers little of the range that was fitted {both}: nothing tests the rest."


def _name(standing: Standing) -> str:
    label = engine_label(standing.engine)
    return f"{label}'s mass, damping and stiffness" if standing.second_order else label


def _chance(p_value: float | None) -> str:
    if p_value is None:
        return ""
    return ", p < 0.001" if p_value < 0.001 else f", p = {fixed(p_value, 3 if p_value < 0.1 else 2)}"


def _plus_minus(points: float, std: float | None) -> str:
    return fixed(points, 2) if std is None else f"{fixed(points, 2)} ± {fixed(std, 2)}"


def _coarsest(told: Told) -> float:
    """Standard deviation of the lead of the best on the recommended one where that lead was left aside, else zero."""
    return 0.0 if told.chosen is told.best else told.chosen.behind.std_points or 0.0
