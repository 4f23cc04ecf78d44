"""Repeatability: variation within and between subjects, reliability, and the first test against the others.

All functions take a table with one row per test and the columns ``subject``, ``site``, ``repeat`` and the parameters,
and return a table with one row per site and parameter (thesis 7.1.2, Tables 7.1 and 7.2, Figs. 7.2 to 7.4).
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import cache

import numpy as np
import pandas as pd
import statsmodels.formula.api as smf
from numpy.typing import NDArray
from scipy import stats
from scipy.optimize import brentq
from statsmodels.stats.anova import anova_lm
from statsmodels.stats.power import FTestAnovaPower, TTestIndPower
from statsmodels.tools.sm_exceptions import ConvergenceWarning

CONFIDENCE = 0.95
RESAMPLES = 2000
LEAST_COMPLETE = 3
"""Least number of subjects with the same repeats for an intraclass correlation."""
LEAST_FIRST = 3
"""Least number of series of two tests or more for a comparison of the first test with the later ones."""
_SEED = 0
ALL_SITES = "all"
"""Value of the column ``site`` where the sites are taken together."""


def variation(table: pd.DataFrame, parameters: Sequence[str]) -> pd.DataFrame:
    """Return coefficients of variation within and between subjects.

    The individual one is the standard deviation over the tests of a subject divided by their mean, averaged over the
    subjects; the population one is the standard deviation of the subjects' means divided by their mean. A subject
    counts with two tests or more.

    Returns:
        columns ``site``, ``parameter``, ``subjects``, ``tests``, ``mean``, ``std`` (between subjects),
        ``individual_cv``, ``population_cv`` and 95 % intervals ``..._low``, ``..._high`` by a bootstrap over subjects.
    """
    rows = []
    for site, name, tests in _by_site(table, parameters):
        groups = [values.to_numpy() for _subject, values in tests.groupby("subject")[name] if len(values) > 1]
        if not groups:
            continue
        own = np.array([values.std(ddof=1) / abs(values.mean()) for values in groups])
        means = np.array([values.mean() for values in groups])
        individual = _interval(own, np.mean)
        population = _interval(means, _relative_spread) if len(means) > 2 else (np.nan, np.nan)
        rows.append(
            {
                "site": site,
                "parameter": name,
                "subjects": len(groups),
                "tests": sum(map(len, groups)),
                "mean": means.mean(),
                "std": means.std(ddof=1) if len(means) > 1 else np.nan,
                "individual_cv": own.mean(),
                "individual_cv_low": individual[0],
                "individual_cv_high": individual[1],
                "population_cv": _relative_spread(means) if len(means) > 1 else np.nan,
                "population_cv_low": population[0],
                "population_cv_high": population[1],
            }
        )
    return pd.DataFrame(rows)


def variation_by_condition(table: pd.DataFrame, parameters: Sequence[str]) -> pd.DataFrame:
    """Return ``variation`` of the tests under each condition, with the column ``condition`` ("" without one)."""
    tables = []
    for condition, tests in table.groupby(table["condition"].fillna(""), sort=True):
        rows = variation(tests, parameters)
        if not rows.empty:
            rows.insert(1, "condition", str(condition))
            tables.append(rows)
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()


def reliability(table: pd.DataFrame, parameters: Sequence[str]) -> pd.DataFrame:
    """Return the intraclass correlation and the minimal detectable change.

    ICC(A,1) is the share of the variance that is between subjects, with absolute agreement of single tests (Shrout and
    Fleiss 1979; McGraw and Wong 1996). The minimal detectable change is 1.96 sqrt(2) times the standard error of
    measurement, s sqrt(1 - ICC), of the pooled tests. Subjects without every repeat are left out (``left_out``).

    Returns:
        columns ``site``, ``parameter``, ``subjects``, ``left_out``, ``repeats``, ``icc``, ``icc_low``, ``icc_high``,
        ``standard_error``, ``minimal_detectable_change`` (unit of the parameter).
    """
    rows = []
    for site, name, tests in _by_site(table, parameters):
        wide = tests.pivot_table(index="subject", columns="repeat", values=name)
        complete = wide.dropna()
        subjects, repeats = complete.shape
        if subjects < LEAST_COMPLETE or repeats < 2:
            continue
        icc, low, high = absolute_agreement(complete.to_numpy())
        error = float(complete.to_numpy().std(ddof=1)) * np.sqrt(max(1.0 - icc, 0.0))
        rows.append(
            {
                "site": site,
                "parameter": name,
                "subjects": subjects,
                "left_out": len(wide) - subjects,
                "repeats": repeats,
                "icc": icc,
                "icc_low": low,
                "icc_high": high,
                "standard_error": error,
                "minimal_detectable_change": stats.norm.ppf(0.975) * np.sqrt(2.0) * error,
            }
        )
    return pd.DataFrame(rows)


def absolute_agreement(values: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return ICC(A,1) of values (subjects, repeats) with its 95 % interval (McGraw and Wong 1996, Tables 4 and 7)."""
    n, k = values.shape
    subject, repeat = (index.ravel() for index in np.indices(values.shape))
    long = pd.DataFrame({"value": values.ravel(), "subject": subject, "repeat": repeat})
    anova = anova_lm(smf.ols("value ~ C(subject) + C(repeat)", long).fit())
    rows, columns, rest = (anova["sum_sq"] / anova["df"]).to_numpy()
    icc = (rows - rest) / (rows + (k - 1) * rest + k / n * (columns - rest))
    if icc >= 1.0:
        return 1.0, 1.0, 1.0
    a = k * icc / (n * (1.0 - icc))
    b = 1.0 + k * icc * (n - 1) / (n * (1.0 - icc))
    freedom = (a * columns + b * rest) ** 2 / ((a * columns) ** 2 / (k - 1) + (b * rest) ** 2 / ((n - 1) * (k - 1)))
    lower, upper = stats.f.ppf(0.975, n - 1, freedom), stats.f.ppf(0.975, freedom, n - 1)
    others = k * columns + (k * n - k - n) * rest
    low = n * (rows - lower * rest) / (lower * others + n * rows)
    high = n * (upper * rows - rest) / (others + n * upper * rows)
    return float(icc), float(low), float(high)


def first_test(table: pd.DataFrame, parameters: Sequence[str]) -> pd.DataFrame:
    """Return the mean of the later tests less the first test, by site and over all sites (Fig. 7.4).

    Returns:
        columns ``site``, ``parameter``, ``subjects``, ``difference``, ``std``, ``low``, ``high`` (95 % interval of the
        mean), ``effect_size`` (Cohen's d of paired values) and ``p_value`` of a paired t test.
    """
    rows = []
    sites = [*_by_site(table, parameters), *((ALL_SITES, name, _complete(table, name)) for name in parameters)]
    for site, name, tests in sites:
        pairs = [
            (values.iloc[0], values.iloc[1:].mean())
            for _who, group in tests.sort_values("repeat").groupby(["subject", "site"])
            if len(values := group[name]) > 1
        ]
        if len(pairs) < LEAST_FIRST:
            continue
        first, later = np.array(pairs).T
        row = paired_difference(first, later)
        rows.append({"site": site, "parameter": name, "subjects": len(pairs)} | row)
    return pd.DataFrame(rows)


def paired_difference(before: NDArray[np.float64], after: NDArray[np.float64]) -> dict[str, float]:
    """Return the mean difference ``after - before`` of paired values (n,), with interval, effect size and p-value."""
    t_test = stats.ttest_rel(after, before)
    low, high = t_test.confidence_interval(CONFIDENCE)
    change = after - before
    spread = float(change.std(ddof=1))
    return {
        "difference": float(change.mean()),
        "std": spread,
        "low": float(low),
        "high": float(high),
        "effect_size": float(change.mean()) / spread if spread else np.nan,
        "p_value": float(t_test.pvalue),
    }


def _relative_spread(values: NDArray[np.float64], axis: int = -1) -> NDArray[np.float64]:
    spread: NDArray[np.float64] = np.std(values, axis=axis, ddof=1) / np.abs(np.mean(values, axis=axis))
    return spread


def _interval(values: NDArray[np.float64], statistic: object) -> tuple[float, float]:
    if len(values) < 3 or np.ptp(values) == 0.0:
        return np.nan, np.nan
    result = stats.bootstrap(
        (values,), statistic, confidence_level=CONFIDENCE, n_resamples=RESAMPLES, rng=np.random.default_rng(_SEED)
    )
    return float(result.confidence_interval.low), float(result.confidence_interval.high)


def _complete(table: pd.DataFrame, name: str) -> pd.DataFrame:
    return table[np.isfinite(table[name].astype(float))]


def _by_site(table: pd.DataFrame, parameters: Sequence[str]) -> Iterator[tuple[str, str, pd.DataFrame]]:
    for site, tests in table.groupby("site", sort=True):
        for name in parameters:
            yield str(site), name, _complete(tests, name)


ALPHA = 0.05
POWERS = (0.8, 0.9)
LEAST = 2.0
"""Least number of participants of a group."""
_MOST = 1_000_000
_SMALLEST_EFFECT, _LARGEST_EFFECT = 0.01, 20.0


def participants(effect_size: float, power: float = 0.8, *, groups: int = 2, alpha: float = ALPHA) -> float:
    """Return the number of participants per group, as a whole number; infinity where no number is enough.

    Args:
        effect_size: difference of the means divided by the standard deviation (Cohen's d) for two groups, or Cohen's f
            for more groups.
        power: probability to find the difference.
        groups: number of groups.
        alpha: size of the test.
    """
    if not effect_size or not math.isfinite(effect_size):
        return math.inf
    if groups == 2:
        return _solved(lambda: TTestIndPower().solve_power(abs(effect_size), power=power, alpha=alpha))
    return _solved(
        lambda: FTestAnovaPower().solve_power(abs(effect_size), power=power, alpha=alpha, k_groups=groups) / groups
    )


@cache
def detectable_effect(groups: int, subjects: int, power: float = 0.8, alpha: float = ALPHA) -> float:
    """Return the effect (Cohen's f; half of Cohen's d for two groups) that a comparison of groups shows with a power.

    Args:
        groups: number of groups.
        subjects: of all groups together, taken as equally large groups.
        power: probability to find the effect.
        alpha: size of the test.
    """
    if subjects <= groups + 1:
        return math.inf
    reached = FTestAnovaPower().power  # its own solver looks up to 1 only

    def missing(size: float) -> float:
        return float(reached(size, subjects, alpha, groups)) - power

    most = _SMALLEST_EFFECT
    while missing(most) < 0.0 and most < _LARGEST_EFFECT:
        most *= 2.0
    # The power of very large effects of few subjects is not finite.
    return float(brentq(missing, 0.5 * most, most)) if missing(most) >= 0.0 else math.inf


def sample_sizes(comparison: pd.DataFrame, powers: Sequence[float] = POWERS) -> pd.DataFrame:
    """Return participants per group for each row of ``group_comparison.one_way``.

    The smallest difference between two means is related to the largest standard deviation of a group, as in the thesis.
    """
    rows = []
    for row in comparison.to_dict("records"):
        size = row["smallest_difference"] / row["largest_std"] if row["largest_std"] else math.nan
        needed = {f"participants_{round(100 * power)}": participants(size, power) for power in powers}
        rows.append({key: row[key] for key in ("site", "factor", "parameter")} | {"effect_size": size} | needed)
    return pd.DataFrame(rows)


def _solved(solve: Callable[[], object]) -> float:
    # The solver fails where the least number, two, is enough already.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        try:
            count = float(np.asarray(solve(), dtype=float).flat[0])
        except (TypeError, ValueError):
            return math.inf
    if math.isnan(count):
        return LEAST
    return max(float(math.ceil(count)), LEAST) if count < _MOST else math.inf
