"""Repeatability: variation within and between subjects, reliability, and the first test against the others.

All functions take a table with one row per test and the columns ``subject``, ``site``, ``repeat`` and the parameters,
and return a table with one row per site and parameter (thesis 7.1.2, Tables 7.1 and 7.2, Figs. 7.2 to 7.4).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd
import statsmodels.formula.api as smf
from numpy.typing import NDArray
from scipy import stats
from statsmodels.stats.anova import anova_lm

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
    found = []
    for condition, tests in table.groupby(table["condition"].fillna(""), sort=True):
        rows = variation(tests, parameters)
        if not rows.empty:
            rows.insert(1, "condition", str(condition))
            found.append(rows)
    return pd.concat(found, ignore_index=True) if found else pd.DataFrame()


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
    found = anova_lm(smf.ols("value ~ C(subject) + C(repeat)", long).fit())
    rows, columns, rest = (found["sum_sq"] / found["df"]).to_numpy()
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
    found = stats.ttest_rel(after, before)
    low, high = found.confidence_interval(CONFIDENCE)
    change = after - before
    spread = float(change.std(ddof=1))
    return {
        "difference": float(change.mean()),
        "std": spread,
        "low": float(low),
        "high": float(high),
        "effect_size": float(change.mean()) / spread if spread else np.nan,
        "p_value": float(found.pvalue),
    }


def _relative_spread(values: NDArray[np.float64], axis: int = -1) -> NDArray[np.float64]:
    spread: NDArray[np.float64] = np.std(values, axis=axis, ddof=1) / np.abs(np.mean(values, axis=axis))
    return spread


def _interval(values: NDArray[np.float64], statistic: object) -> tuple[float, float]:
    if len(values) < 3 or np.ptp(values) == 0.0:
        return np.nan, np.nan
    found = stats.bootstrap(
        (values,), statistic, confidence_level=CONFIDENCE, n_resamples=RESAMPLES, rng=np.random.default_rng(_SEED)
    )
    return float(found.confidence_interval.low), float(found.confidence_interval.high)


def _complete(table: pd.DataFrame, name: str) -> pd.DataFrame:
    return table[np.isfinite(table[name].astype(float))]


def _by_site(table: pd.DataFrame, parameters: Sequence[str]) -> Iterator[tuple[str, str, pd.DataFrame]]:
    for site, tests in table.groupby("site", sort=True):
        for name in parameters:
            yield str(site), name, _complete(tests, name)
