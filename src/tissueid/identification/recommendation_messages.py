"""Texts of a recommendation: headline, reasons, doubts and proposed experiments, as messages."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy import special

from tissueid.formatting import fixed, number, with_unit
from tissueid.identification.base import Array, Family
from tissueid.identification.impulse_response import dependence_samples, long_run_covariance
from tissueid.identification.registry import label_of
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Record
from tissueid.units import display_unit

FEWEST = 50
"""Samples below which the spread of a difference is not estimated."""


@dataclass(frozen=True)
class VafDifference:
    """VAF of one model minus that of another on the same ``n_samples``, in percentage points.

    ``std_points`` accounts for autocorrelated errors; None with too few samples. ``p_value`` is the one-sided
    probability of such a lead if the two were equally accurate; None with too few samples. ``reduction`` is the lead as
    a share of the other's error variance.
    """

    points: float
    std_points: float | None
    p_value: float | None
    reduction: float
    n_samples: int


def difference(error: Array, other: Array, measured: Array, sample_rate_hz: float) -> VafDifference:
    """Compare two models by their squared errors, sample by sample (Diebold and Mariano 1995).

    ``error`` and ``other`` are measured minus simulated of the two, (n,); ``measured`` (n,) sets the scale. Samples
    with a NaN are left out. A constant offset does not count, as in Eq. 3.13. With fewer than two common samples, or a
    constant measurement, the result is NaN.
    """
    used = np.isfinite(error) & np.isfinite(other) & np.isfinite(measured)
    n = int(used.sum())
    variance = float(np.var(measured[used])) if n > 1 else 0.0
    if variance == 0.0:
        return VafDifference(float("nan"), None, None, float("nan"), n)
    ours, theirs = (np.square(e[used] - np.mean(e[used])) for e in (error, other))
    gain = 100.0 * (theirs - ours) / variance  # (n,) points of VAF
    points = float(np.mean(gain))
    other_mean = float(np.mean(theirs))
    reduction = 1.0 - float(np.mean(ours)) / other_mean if other_mean > 0.0 else 0.0
    terms = gain - points
    if n < FEWEST or not np.any(terms):
        return VafDifference(points, None, None, reduction, n)
    covariance = long_run_covariance(terms[:, None], dependence_samples(terms, sample_rate_hz))
    std = math.sqrt(float(covariance[0, 0])) / n
    return VafDifference(points, std, float(special.ndtr(-points / std)), reduction, n)


@dataclass(frozen=True, eq=False)
class ModelCandidate:
    """An engine fitted to the record.

    ``error`` (n,) is measured minus free-run simulated output on the held-out record, NaN where it is not scored.
    ``parameters`` is the effective number of parameters. ``vaf_percent`` and ``aicc`` are scores on the fitted
    samples, ``scheduled_percent`` is the held-out VAF with the measured output as the schedule. ``second_order`` marks
    a linear model reduced to mass, damping and stiffness. ``measured`` (n,) is the output that the error is relative
    to; None for that of the held-out record.
    """

    engine: str
    family: Family
    error: Array
    parameters: float
    vaf_percent: float
    aicc: float | None = None
    scheduled_percent: float | None = None
    second_order: bool = False
    measured: Array | None = None


@dataclass(frozen=True)
class ModelStanding:
    """Scores of a :class:`ModelCandidate`, and their differences from other candidates on held-out samples.

    ``behind`` is the lead of the best candidate over this one, ``below`` the lead of the recommended one; ``beaten`` is
    true if any candidate has a significant and relevant lead over it.
    """

    engine: str
    family: Family
    second_order: bool
    vaf_percent: float
    vaf_fitted_percent: float
    scheduled_percent: float | None
    aicc: float | None
    behind: VafDifference
    below: VafDifference
    beaten: bool


@dataclass(frozen=True)
class SufficientOption:
    """An option of the recommended engine: the smallest value that scores as well as any value tried."""

    option: str
    value: float
    tried: tuple[float, ...]
    vaf_percent: tuple[float, ...]


_SHORT_S = 1.0
"""Length of held-out data, s, below which there are too few independent stretches to compare models."""

_COARSE_POINTS = 2.0
"""Standard deviation of a difference, percentage points, above which the record hardly separates models."""

_NARROW, _BEYOND = 0.8, 0.05
"""Shares of the fitted range: held-out data cover little of it below the first, and leave it above the second."""

_DESCRIBES_PERCENT = 50.0
"""Held-out VAF, %, below which a model does not describe the record."""

_LARGE_LOSS_POINTS = 5.0
"""Difference between two VAFs of one model, percentage points, that is worth a doubt."""

_SMALL_LEAD_POINTS = 0.1
"""Lead, percentage points, below which it is irrelevant even if significant."""

_LEFT_TO_CEILING_POINTS = 3.0
"""Distance to the ceiling, percentage points, above which a part of the output remains unexplained."""

_LONGEST_FACTOR = 20.0
"""Largest factor by which a longer test is proposed."""

_QUANTILES = (0.01, 0.99)
"""Quantiles of the output that bound its range."""

_FAMILIES = {
    Family.LINEAR: marked("the linear models"),
    Family.STATIC: marked("the static nonlinearities"),
    Family.PARAMETRIC: marked("the models whose parameters follow depth"),
    Family.DEPTH: marked("the depth partitions"),
    Family.DIRECTION: marked("the depth and direction partitions"),
    Family.KERNELS: marked("the Volterra kernels"),
    Family.OTHER: marked("the other engines"),
}


@dataclass(frozen=True, eq=False)
class Basis:
    """Input of the texts: the recommended model, all models best first, and the fitted and held-out records."""

    chosen: ModelStanding
    standings: tuple[ModelStanding, ...]
    held_out: Record
    fitted: Record
    ceiling_percent: float | None

    @property
    def best(self) -> ModelStanding:
        """The model with the highest held-out VAF."""
        return self.standings[0]

    @property
    def lowest_aicc(self) -> ModelStanding | None:
        """The model with the lowest AICc; None if none has one."""
        scored = [s for s in self.standings if s.aicc is not None and np.isfinite(s.aicc)]
        return min(scored, key=lambda s: s.aicc or 0.0, default=None)

    @property
    def seconds(self) -> float:
        """Length of the held-out data, s."""
        return float(np.isfinite(self.held_out.output).sum()) / self.held_out.sample_rate_hz

    @property
    def output(self) -> str:
        """Name of the output: depth for a position."""
        return marked("depth") if self.held_out.output_name == "position" else self.held_out.output_name


def headline(basis: Basis) -> Message:
    """Return one sentence: the recommended model and what it implies for the tissue."""
    chosen = basis.chosen
    if basis.held_out.output_name == "position":
        score = Message("recommendation.score", "{percent:.1f} % of held-out motion", percent=chosen.vaf_percent)
    else:
        score = Message(
            "recommendation.score_of_signal", "{percent:.1f} % of held-out data", percent=chosen.vaf_percent
        )
    values = {"name": _name(chosen), "score": score, "output": basis.output}
    if chosen.vaf_percent < _DESCRIBES_PERCENT:
        return Message(
            "recommendation.none",
            "No model describes this record; the best is {name}: {score}. Check the signals.",
            **values,
        )
    if len({standing.family for standing in basis.standings}) == 1:
        return Message(
            "recommendation.one_family",
            "Only {family} were tried; the best is {name}: {score}.",
            family=_FAMILIES[chosen.family],
            **values,
        )
    code, template = _HEADLINES[chosen.family]
    return Message(code, template, **values)


_HEADLINES: Mapping[Family, tuple[str, str]] = {
    Family.LINEAR: (
        "recommendation.linear",
        marked("A linear model describes this record as well as any other that was tried ({name}: {score})."),
    ),
    Family.STATIC: (
        "recommendation.static",
        marked(
            "The response changes with {output} in the simplest way: linear dynamics and one static curve "
            "({name}: {score})."
        ),
    ),
    Family.PARAMETRIC: (
        "recommendation.parametric",
        marked("The response changes with {output}: mass, damping and stiffness each follow it ({name}: {score})."),
    ),
    Family.DEPTH: (
        "recommendation.depth",
        marked("The response changes with {output}: it differs from one range to the next ({name}: {score})."),
    ),
    Family.DIRECTION: (
        "recommendation.direction",
        marked(
            "The response changes with {output} and direction: it differs between inward and outward motion "
            "({name}: {score})."
        ),
    ),
    Family.KERNELS: (
        "recommendation.kernels",
        marked("The response is nonlinear in a way that only kernels of higher order describe ({name}: {score})."),
    ),
    Family.OTHER: (
        "recommendation.other",
        marked("No engine of the usual families describes this record as well as {name}: {score}."),
    ),
}
"""Code and template of the headline for the family of the recommended model."""


def choice(chosen: SufficientOption) -> Message:
    """Return one sentence on the smallest sufficient value of an option."""
    values = {"value": number(chosen.value, 3), "option": chosen.option}
    sized = chosen.value < max(chosen.tried)
    if chosen.option == "memory" and sized:
        return Message(
            "recommendation.memory", "A memory of {value} s is enough; a longer one gains nothing.", **values
        )
    if chosen.option == "memory":
        return Message(
            "recommendation.longest_memory", "A memory of {value} s is enough; a longer one was not tried.", **values
        )
    if chosen.option == "partitions" and sized:
        return Message(
            "recommendation.partitions",
            "{value} partitions are enough; more partitions do not improve the fit.",
            **values,
        )
    if chosen.option == "partitions":
        return Message(
            "recommendation.most_partitions", "{value} partitions are enough; more were not tried.", **values
        )
    if chosen.option == "order":
        return Message("recommendation.order", "Kernels up to order {value} are enough of those tried.", **values)
    return Message("recommendation.option", "A value of {value} is enough for the option {option}.", **values)


def reasons(basis: Basis) -> Iterator[Message]:
    """Yield the reasons: the lead over simpler models, and why a higher score was not preferred."""
    chosen, best = basis.chosen, basis.best
    simpler = [s for s in basis.standings if s.beaten and s.family.rank < chosen.family.rank]
    best_of = {s.family: s for s in reversed(simpler)}
    for standing in sorted(best_of.values(), key=lambda s: s.family.rank):
        yield _lead_over(chosen, standing)
    if best is not chosen:
        values = {"percent": best.vaf_percent, "name": _name(best), "why": _why_left(chosen)}
        if chosen.second_order or chosen.family.rank < best.family.rank:
            yield Message(
                "recommendation.simpler_preferred",
                "The highest score, {percent:.1f} % by {name}, {why}; the simpler model is preferred.",
                **values,
            )
        else:
            yield Message(
                "recommendation.aicc_decides",
                "The highest score, {percent:.1f} % by {name}, {why}; AICc decides.",
                **values,
            )
    if chosen.second_order:
        yield Message(
            "recommendation.second_order_suffices",
            "Mass, damping and stiffness alone do as well as the whole impulse response.",
        )
    lowest = basis.lowest_aicc
    if lowest is chosen:
        yield Message(
            "recommendation.aicc_agrees",
            "AICc on the fitted samples also prefers {name}.",
            name=_name(chosen),
        )


def _lead_over(chosen: ModelStanding, standing: ModelStanding) -> Message:
    below = standing.below
    values = {
        "name": _name(chosen),
        "points": below.points,
        "std": below.std_points,
        "other": _name(standing),
        "family": _FAMILIES[standing.family],
    }
    if below.p_value is None:
        return Message(
            "recommendation.lead",
            "On the same samples, {name} accounts for {points:.2f} points more than {other}, the best of {family}.",
            **values,
        )
    return Message(
        "recommendation.significant_lead",
        "On the same samples, {name} accounts for {points:.2f} ± {std:.2f} points more than {other}, the best of "
        "{family}, p {chance}.",
        chance=_chance(below.p_value),
        **values,
    )


def _why_left(chosen: ModelStanding) -> Message:
    lead = chosen.behind
    if lead.p_value is None:
        return Message("recommendation.by_chance", "is within chance ({points:.2f} points)", points=lead.points)
    if lead.p_value >= 0.05:
        return Message(
            "recommendation.within_chance",
            "is within chance ({points:.2f} ± {std:.2f} points, p {chance})",
            points=lead.points,
            std=lead.std_points,
            chance=_chance(lead.p_value),
        )
    if lead.points > _SMALL_LEAD_POINTS:
        return Message(
            "recommendation.small_reduction",
            "reduces the unexplained variance by only {percent:.1f} %",
            percent=100.0 * lead.reduction,
        )
    return Message(
        "recommendation.small_lead", "is {points:.2f} points higher, too little to matter", points=lead.points
    )


def doubts(basis: Basis) -> Iterator[Message]:
    """Yield limitations of the recommendation."""
    chosen = basis.chosen
    if basis.seconds < _SHORT_S:
        yield Message(
            "recommendation.short",
            "Only {seconds} s were held out: differences between models are hardly tested.",
            seconds=number(basis.seconds, 2),
        )
    elif (coarse := _coarsest(basis)) > _COARSE_POINTS:
        yield Message(
            "recommendation.coarse",
            (
                "The differences in VAF between models are uncertain by {points:.1f} percentage points: a"
                " longer test would separate more models."
            ),
            points=coarse,
        )
    yield from _ranges(basis)
    lost = chosen.vaf_fitted_percent - chosen.vaf_percent
    if lost > _LARGE_LOSS_POINTS:
        yield Message(
            "recommendation.overfit",
            "From fitted to held-out samples, {name} loses {points:.1f} points: it overfits, or the tissue changed.",
            name=_name(chosen),
            points=lost,
        )
    lowest = basis.lowest_aicc
    if lowest is not None and lowest is not chosen:
        yield Message(
            "recommendation.aicc_disagrees",
            "AICc on the fitted samples prefers {name}. AICc assumes independent errors, which these are not, so "
            "held-out samples decide.",
            name=_name(lowest),
        )
    scheduled = [s for s in basis.standings if s.scheduled_percent is not None]
    guided = max(scheduled, key=lambda s: s.scheduled_percent or 0.0, default=None)
    if guided is not None and (guided.scheduled_percent or 0.0) > basis.best.vaf_percent + _LARGE_LOSS_POINTS:
        yield Message(
            "recommendation.scheduled",
            "With the measured {output} as the schedule, {name} accounts for {percent:.1f} %, in free run for "
            "{free:.1f} %: the measured output already holds part of the answer.",
            output=basis.output,
            name=label_of(guided.engine),
            percent=guided.scheduled_percent,
            free=guided.vaf_percent,
        )
    headroom = _left_to_ceiling(basis)
    if headroom > _LEFT_TO_CEILING_POINTS:
        yield Message(
            "recommendation.below_ceiling",
            "Repeats agree to {percent:.1f} %: {points:.1f} points could be explained, and no model explains them.",
            percent=basis.ceiling_percent,
            points=headroom,
        )


def experiments(basis: Basis) -> Iterator[Message]:
    """Yield proposals for further measurements."""
    chosen, lead = basis.chosen, basis.chosen.behind
    if chosen is not basis.best and lead.std_points and lead.points > 0.0:
        # Length for a one-sided test at 5 % to detect a lead of this size with a power of 80 %.
        times = ((1.645 + 0.84) * lead.std_points / lead.points) ** 2
        if 1.0 < times < _LONGEST_FACTOR:
            yield Message(
                "recommendation.measure_longer",
                "{more} s of held-out data instead of {seconds} s would show whether {name} is really better.",
                more=number(times * basis.seconds, 2),
                seconds=number(basis.seconds, 2),
                name=_name(basis.best),
            )
    code, template = _EXPERIMENTS[chosen.family]
    yield Message(code, template, output=basis.output)
    if basis.ceiling_percent is None:
        yield Message(
            "recommendation.measure_repeat",
            "A repeat of the same test would show how much a model can explain at best.",
        )
    elif _left_to_ceiling(basis) > _LEFT_TO_CEILING_POINTS:
        yield Message(
            "recommendation.measure_creep",
            "A slow ramp and a hold would show creep and hysteresis, which none of these models contains.",
        )


_LEVELS = (
    "recommendation.measure_levels",
    marked("Small tests about two or more mean forces would check the parameters at each {output}."),
)
_EXPERIMENTS: Mapping[Family, tuple[str, str]] = {
    Family.LINEAR: (
        "recommendation.measure_range",
        marked("A test over a larger range of force would show whether the response changes with {output}."),
    ),
    Family.STATIC: (
        "recommendation.measure_stiffness",
        marked("Small tests about two or more mean forces would measure stiffness at each {output} directly."),
    ),
    Family.PARAMETRIC: _LEVELS,
    Family.DEPTH: _LEVELS,
    Family.DIRECTION: (
        "recommendation.measure_loop",
        marked("A slow ramp in and out would show the hysteresis that a difference between directions causes."),
    ),
    Family.KERNELS: (
        "recommendation.measure_cause",
        marked("Small tests about two or more mean forces would show whether {output} is the cause."),
    ),
    Family.OTHER: (
        "recommendation.measure_changes",
        marked("Small tests about two or more mean forces would show what changes between them."),
    ),
}
"""Code and template of the experiment proposed for the family of the recommended model."""


def _ranges(basis: Basis) -> Iterator[Message]:
    """Yield a message if held-out data leave the fitted range of the output, or cover little of it."""
    unit, scale = display_unit(basis.held_out.output_unit)
    fitted, unseen = (
        scale * np.quantile(part.output[np.isfinite(part.output)], _QUANTILES)
        for part in (basis.fitted, basis.held_out)
    )
    span = fitted[1] - fitted[0]
    ranges = {
        "low": number(fitted[0], 3),
        "high": with_unit(number(fitted[1], 3), unit),
        "least": number(unseen[0], 3),
        "most": with_unit(number(unseen[1], 3), unit),
    }
    if unseen[1] > fitted[1] + _BEYOND * span or unseen[0] < fitted[0] - _BEYOND * span:
        yield Message(
            "recommendation.extrapolation",
            "Held-out data ({least} to {most}) leave the fitted range ({low} to {high}): part of the error is "
            "extrapolation.",
            **ranges,
        )
    elif unseen[1] - unseen[0] < _NARROW * span:
        yield Message(
            "recommendation.narrow",
            "Held-out data ({least} to {most}) cover little of the fitted range ({low} to {high}): the rest is not "
            "tested.",
            **ranges,
        )


def _name(standing: ModelStanding) -> str:
    label = label_of(standing.engine)
    if not standing.second_order:
        return label
    return Message("recommendation.second_order", "mass, damping and stiffness by {engine}", engine=label)


def _chance(p_value: float) -> str:
    return "< 0.001" if p_value < 0.001 else f"= {fixed(p_value, 3 if p_value < 0.1 else 2)}"


def _left_to_ceiling(basis: Basis) -> float:
    return 0.0 if basis.ceiling_percent is None else basis.ceiling_percent - basis.best.vaf_percent


def _coarsest(basis: Basis) -> float:
    """Return the standard deviation of the best model's lead over the recommended one, percentage points."""
    return 0.0 if basis.chosen is basis.best else basis.chosen.behind.std_points or 0.0
