"""A parameter of many fits as a distribution, or against subject, site, date, repeat or another parameter."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np
from scipy.stats import t as student

from tissueid.analysis.curves.comparison_plots import Centre, histogram_plot, points_plot
from tissueid.analysis.curves.plot import Axis, Plot
from tissueid.app.views.researcher.engine_outcome import Array, EngineOutcome
from tissueid.formatting import axis_label, clean, label_and_unit, subject_text
from tissueid.identification import engine_label
from tissueid.language import _, marked
from tissueid.messages import MISSING, Verbatim
from tissueid.records import Estimate
from tissueid.units import display_unit

DISTRIBUTION, SUBJECT, SITE, DATE, REPEAT = "distribution", "subject", "site", "date", "repeat"
ACROSS: Mapping[str, str] = {
    DISTRIBUTION: marked("Histogram"),
    SUBJECT: marked("Subject"),
    SITE: marked("Site"),
    DATE: marked("Date"),
    REPEAT: marked("Number of the repeat"),
}
"""What a parameter is drawn against, other than another parameter."""
GROUPS: Mapping[str, str] = {
    "": marked("One colour"),
    "engine": marked("Colour: engine"),
    SUBJECT: marked("Colour: subject"),
    SITE: marked("Colour: site"),
}
SCORES: Mapping[str, str] = {
    "vaf_validation_percent": marked("VAF held out (%)"),
    "vaf_percent": marked("VAF fitted (%)"),
}
_SPREAD = 0.32
"""Half width over which the points of one category are spread, where neighbours are 1 apart."""
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
_MOST_BINS = 60
_LONGEST = 40
_MOST_DATES = 6


@dataclass(frozen=True)
class Mean:
    """Mean of a group at one place: ``x`` there, standard deviation and half the 95 % confidence interval of the mean.

    The deviation and the interval are NaN for a single fit.
    """

    group: int
    x: float
    y: float
    std: float
    half_interval: float
    count: int


@dataclass(frozen=True, eq=False)
class Population:
    """Fits as points. Arrays have shape (n,), in display units.

    ``group`` numbers ``groups``; the last of them takes all that are too many for a colour of their own. ``places``
    names the whole numbers of ``x`` where that is a category. ``left_out`` counts the other fits by the reason.
    """

    outcomes: tuple[EngineOutcome, ...]
    x: Array
    y: Array
    group: np.ndarray
    groups: tuple[str, ...]
    means: tuple[Mean, ...]
    places: tuple[str, ...]
    left_out: Mapping[str, int]
    x_label: str
    title: str
    unit: str

    @property
    def tests(self) -> int:
        """Number of tests of the drawn fits."""
        return len({test for outcome in self.outcomes for test in _tests(outcome)})

    @property
    def counted(self) -> str:
        """Y label of the histogram: tests if no group has two fits of a test, otherwise fits."""
        fits = [(group, _tests(outcome)) for group, outcome in zip(self.group.tolist(), self.outcomes, strict=True)]
        return _("Number of tests") if len(set(fits)) == len(fits) else _("Number of fits")

    @property
    def edges(self) -> Array:
        """Edges of the bins of a histogram, (bins + 1,)."""
        if not self.y.size:
            return np.array([0.0, 1.0])
        edges = np.histogram_bin_edges(self.y, "auto")
        return edges if edges.size <= _MOST_BINS + 1 else np.histogram_bin_edges(self.y, _MOST_BINS)


def _tests(outcome: EngineOutcome) -> tuple[tuple[Path, int], ...]:
    return tuple((test.path, test.number) for test in outcome.tests)


def parameters_of(outcomes: Sequence[EngineOutcome]) -> dict[str, str]:
    """Return the parameters of the fits and their labels, most frequent first, then the scores."""
    reports = [outcome.report for outcome in outcomes if outcome.report is not None]
    counts = Counter(name for report in reports for name in report.reportable_parameters)
    named = {name: axis_label(name, display_unit(label_and_unit(name)[1])[0]) for name, _count in counts.most_common()}
    return named | ({name: _(label) for name, label in SCORES.items()} if reports else {})


def estimate_of(outcome: EngineOutcome, name: str) -> Estimate | None:
    """Return a parameter or score of a fit in SI; None if it is not reportable."""
    report = outcome.report
    if report is None:
        return None
    if name in SCORES:
        score = getattr(report, name)
        return None if score is None else Estimate(score, None)
    return report.reportable_parameters.get(name)


def population(
    outcomes: Sequence[EngineOutcome], parameter: str, across: str, by: str = "", most_groups: int = 7
) -> Population:
    """Arrange fits as points: ``parameter`` against ``across``, grouped by one of ``GROUPS``."""
    left_out: Counter[str] = Counter()
    repeats = _repeats(outcomes) if across == REPEAT else {}
    kept: list[EngineOutcome] = []
    ys: list[float] = []
    xs: list[float] = []
    names: list[str] = []
    for outcome in outcomes:
        y = _value(outcome, parameter)
        x, name = _place(outcome, across, repeats)
        why = _why_not(outcome, y, x)
        if why:
            left_out[why] += 1
            continue
        kept.append(outcome)
        ys.append(y)
        xs.append(x)
        names.append(name)
    models = [] if parameter in SCORES else _models(kept)
    members = [_member(outcome, by) for outcome in kept]
    members = [" ".join(filter(None, pair)) for pair in zip(members, models, strict=True)] if models else members
    groups, group = _groups(members, most_groups)
    y_values, x_values = np.array(ys), np.array(xs)
    places: tuple[str, ...] = ()
    if across in (SUBJECT, SITE):
        places = tuple(sorted(set(names)))
        rank = {name: index for index, name in enumerate(places)}
        x_values = np.array([rank[name] for name in names], dtype=np.float64)
    elif across == REPEAT:
        places = tuple(str(number) for number in range(1, int(max(xs, default=0)) + 1))
        x_values = x_values - 1.0
    categorical = across in (SUBJECT, SITE, REPEAT)
    means = _means(x_values, y_values, group, across)
    if categorical:
        x_values, means = _spread(x_values, group, means, len(groups))
    title, si_unit = _titled(parameter)
    return Population(
        tuple(kept),
        x_values,
        y_values,
        group,
        groups,
        means,
        places,
        dict(left_out),
        _(ACROSS[across]) if across in ACROSS else _labelled(across),
        title,
        display_unit(si_unit)[0],
    )


def population_plot(fits: Population, across: str, spread: str, colours: Sequence[str], names: Sequence[str]) -> Plot:
    """Return the points of a population and the means of its groups, or its histogram.

    Args:
        fits: the population.
        across: what it is drawn against.
        spread: the error bars: "std", "interval", or "" for no means.
        colours: colour of each group.
        names: name of each group in the key.
    """
    parameter = Axis(fits.title, fits.unit)
    masks = [fits.group == index for index in range(len(fits.groups))]
    if across == DISTRIBUTION:
        groups = [fits.y[mask] for mask in masks]
        return histogram_plot((parameter, Axis(fits.counted)), groups, fits.edges, colours, names)
    centres = [
        Centre(mean.group, mean.x, mean.y, mean.std if spread == "std" else mean.half_interval)
        for mean in (fits.means if spread else ())
    ]
    points = [(fits.x[mask], fits.y[mask]) for mask in masks]
    label, unit = label_and_unit(across) if across not in (*ACROSS, *SCORES) else (fits.x_label, "")
    x = Axis(label, display_unit(unit)[0], ticks=_ticks(fits, across))
    return points_plot((x, parameter), points, colours, names, centres)


def _ticks(fits: Population, across: str) -> tuple[tuple[float, str], ...]:
    """Return the names of categories, or some dates."""
    if across != DATE or not fits.x.size:
        return tuple((float(position), Verbatim(name)) for position, name in enumerate(fits.places))
    low, high = float(fits.x.min()), float(fits.x.max())
    times = np.linspace(low, high, _MOST_DATES) if high > low else np.array([low])
    named = {day(float(time)): float(time) for time in times}
    return tuple((time, name) for name, time in named.items())


def _titled(parameter: str) -> tuple[str, str]:
    return (_(SCORES[parameter]), "") if parameter in SCORES else label_and_unit(parameter)


def _labelled(parameter: str) -> str:
    if parameter in SCORES:
        return _(SCORES[parameter])
    return axis_label(parameter, display_unit(label_and_unit(parameter)[1])[0])


def _value(outcome: EngineOutcome, parameter: str) -> float:
    estimate = estimate_of(outcome, parameter)
    return math.nan if estimate is None else estimate.value * display_unit(_titled(parameter)[1])[1]


def _why_not(outcome: EngineOutcome, y: float, x: float) -> str:
    """Return why a fit is not drawn; "" if it is drawn."""
    if outcome.report is None:
        return _("refused")
    if outcome.report.predicts_nothing and not math.isfinite(y):
        return _("predict nothing")
    if not math.isfinite(y):
        return _("without this parameter")
    return "" if math.isfinite(x) else _("without a value across")


def _place(outcome: EngineOutcome, across: str, repeats: Mapping[tuple[object, int], int]) -> tuple[float, str]:
    first = outcome.tests[0]
    if across == DISTRIBUTION:
        return 0.0, ""
    if across in (SUBJECT, SITE):
        return 0.0, _member(outcome, across)
    if across == DATE:
        return (math.nan if first.when is None else first.when), ""
    if across == REPEAT:
        return float(repeats[first.path, first.number]), ""
    return _value(outcome, across), ""


def _member(outcome: EngineOutcome, by: str) -> str:
    first = outcome.tests[0]
    names: dict[str, Callable[[], str]] = {
        "": lambda: "",
        "engine": lambda: engine_label(outcome.engine),
        SUBJECT: lambda: subject_text(first.pseudonym),
        SITE: lambda: clean(first.site),
    }
    return names[by]()[:_LONGEST] or (MISSING if by else "")


def _models(outcomes: Sequence[EngineOutcome]) -> list[str]:
    """Return the model of each fit where one engine has several: their parameters are not comparable; else none."""
    models = [(outcome.engine, outcome.report.model) for outcome in outcomes if outcome.report is not None]
    return [model for _engine, model in models] if len(set(models)) > len({engine for engine, _ in models}) else []


def _groups(names: Sequence[str], most: int) -> tuple[tuple[str, ...], np.ndarray]:
    """Return the names of the groups and the group of each fit; the smallest beyond ``most`` share the last."""
    counts = Counter(names)
    every = sorted(counts)
    if len(every) > most:
        large = sorted(name for name, _count in counts.most_common(most - 1))
        rank = {name: index for index, name in enumerate(large)}
        groups = (*large, _("{count} others").format(count=len(every) - len(large)))
        return groups, np.array([rank.get(name, most - 1) for name in names], dtype=np.intp)
    rank = {name: index for index, name in enumerate(every)}
    return tuple(every), np.array([rank[name] for name in names], dtype=np.intp)


def _repeats(outcomes: Sequence[EngineOutcome]) -> dict[tuple[object, int], int]:
    """Number the tests of one subject, site and day from 1, in the order of time, file and number."""
    sittings: dict[tuple[str, str, object], set[tuple[float, str, int, object]]] = defaultdict(set)
    for outcome in outcomes:
        test = outcome.tests[0]
        when = test.when
        at: object = test.path.parent if when is None else _local_day(when)
        sittings[test.pseudonym, test.site, at].add((when or 0.0, str(test.path), test.number, test.path))
    return {
        (path, number): repeat
        for sitting in sittings.values()
        for repeat, (_when, _name, number, path) in enumerate(sorted(sitting, key=lambda entry: entry[:3]), 1)
    }


def _means(x: Array, y: Array, group: np.ndarray, across: str) -> tuple[Mean, ...]:
    """Return the mean of every group: at each category or day, or otherwise of all its fits at once."""
    if across == DATE:
        where = np.array([_local_day(float(when)) for when in x], dtype=np.float64)
    elif across in (SUBJECT, SITE, REPEAT):
        where = x
    else:
        where = np.zeros(x.size)
    if not y.size:
        return ()
    keys, number = np.unique(np.column_stack([group, where]), axis=0, return_inverse=True)
    number = number.reshape(-1)
    count = np.bincount(number)
    middle, mean = np.bincount(number, x) / count, np.bincount(number, y) / count
    squares = np.bincount(number, (y - mean[number]) ** 2)
    more = np.maximum(count - 1, 1)
    std = np.where(count > 1, np.sqrt(squares / more), np.nan)
    half = student.ppf(0.975, more) * std / np.sqrt(count)
    return tuple(
        Mean(int(keys[k, 0]), float(middle[k]), float(mean[k]), float(std[k]), float(half[k]), int(count[k]))
        for k in range(count.size)
    )


def _spread(x: Array, group: np.ndarray, means: Sequence[Mean], count: int) -> tuple[Array, tuple[Mean, ...]]:
    """Place the groups of a category side by side, and spread the points of each evenly and deterministically."""
    lane = 2.0 * _SPREAD / max(1, count)
    middle = -_SPREAD + lane * (np.arange(max(1, count)) + 0.5)
    within = (np.arange(x.size) * _GOLDEN % 1.0 - 0.5) * 0.8 * lane
    moved = tuple(Mean(m.group, m.x + float(middle[m.group]), m.y, m.std, m.half_interval, m.count) for m in means)
    return x + middle[group] + within if x.size else x, moved


def _local_day(when: float) -> int:
    try:
        return datetime.fromtimestamp(when).toordinal()
    except (ValueError, OverflowError, OSError):
        return 0


def day(when: float) -> str:
    """Return the local date of a time in seconds since 1970."""
    try:
        return datetime.fromtimestamp(when).strftime("%Y-%m-%d")
    except (ValueError, OverflowError, OSError):
        return MISSING
