"""Comparisons of groups of subjects, sites or conditions, and regressions on demographic values (thesis 7.1.2, 7.1.3).

Tables have one row per test. Repeats of a subject are not independent: they are averaged first (``subject_means``), or
a mixed model has the subject as a random effect. P-values are stated raw and corrected by Holm's method over the
parameters of a comparison.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
import statsmodels.formula.api as smf
from scipy import stats
from statsmodels.regression.linear_model import OLS, WLS
from statsmodels.stats.anova import anova_lm
from statsmodels.stats.diagnostic import het_breuschpagan
from statsmodels.stats.meta_analysis import combine_effects
from statsmodels.stats.multicomp import pairwise_tukeyhsd
from statsmodels.stats.multitest import multipletests
from statsmodels.stats.oneway import anova_oneway
from statsmodels.stats.weightstats import CompareMeans, DescrStatsW, ttost_paired
from statsmodels.tools.sm_exceptions import ConvergenceWarning, SingularMatrixWarning

from tissueid.studies.repeatability import CONFIDENCE, detectable_effect, paired_difference
from tissueid.studies.study_table import STD_SUFFIX

LEAST_PER_GROUP = 2
"""Least number of subjects of a group, or of tests of a material."""
LEAST_REGRESSION = 4
"""Least number of subjects of a regression."""
LEAST_MIXED = 3
"""Least number of subjects of a mixed model."""
LEAST_PAIRS = 3
"""Least number of subjects that were tested under both conditions."""
LEAST_POOLED = 3
"""Least number of subjects of a weighted mean."""
ASSUMPTION_ALPHA = 0.05
"""Size of the tests of equal variances and of normal residuals."""
CORRECTION = "holm"


def subject_means(
    table: pd.DataFrame, parameters: Sequence[str], keys: Sequence[str] = ("subject", "site")
) -> pd.DataFrame:
    """Return one row per subject and site: means of the parameters, their standard errors, first values of the rest.

    The standard error of a mean (column ``..._sd``) combines the spread of the repeats with the uncertainty of each
    test: the larger of both.
    """
    rows = []
    for _who, tests in table.groupby(list(keys), sort=True, dropna=False):
        row = tests.iloc[0].to_dict()
        for name in parameters:
            values = tests[name].astype(float).dropna()
            row[name] = values.mean() if len(values) else np.nan
            own = tests.get(name + STD_SUFFIX, pd.Series(np.nan, tests.index)).astype(float)[values.index]
            spread = values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else np.nan
            within = np.sqrt(np.mean(own**2) / len(values)) if len(values) and own.notna().all() else np.nan
            errors = [item for item in (spread, within) if np.isfinite(item)]
            row[name + STD_SUFFIX] = max(errors) if errors else np.nan
        rows.append(row)
    return pd.DataFrame(rows)


def one_way(means: pd.DataFrame, factor: str, parameters: Sequence[str]) -> pd.DataFrame:
    """Compare the groups of a factor at each site by a one-way analysis of variance.

    Where the variances differ (Levene), Welch's form is used. Groups with fewer than two subjects are left out.

    Args:
        means: one row per subject and site (``subject_means``).
        factor: column with the groups, such as ``gender``.
        parameters: columns to compare.

    Returns:
        columns ``site``, ``factor``, ``parameter``, ``levels``, ``groups`` (their number), ``subjects``, ``statistic``
        (F), ``p_value``, ``p_corrected``, ``p_weighted`` (weights as in ``regressions``), ``effect_size`` (partial eta
        squared), ``method`` ("anova" or "welch"), ``normal`` (residuals, by Shapiro and Wilk), ``equal_variances``,
        ``smallest_difference``, ``largest_std``, ``detectable`` (Cohen's f that these groups show with a power of 80
        %), and for two groups the ``difference`` of the second from the first with its 95 % interval ``low``, ``high``.
    """
    rows = []
    for site, subjects in means.groupby("site", sort=True):
        for name in parameters:
            groups = _groups(subjects, factor, name)
            if len(groups) < 2:
                continue
            values = list(groups.values())
            if np.ptp(np.concatenate(values)) == 0.0:
                continue
            equal = _equal_variances(values)
            f_test = anova_oneway(values, use_var="equal" if equal else "unequal", welch_correction=True)
            between = float(f_test.statistic) * f_test.df_num
            centres = np.array([group.mean() for group in values])
            gaps = np.abs(np.subtract.outer(centres, centres))[np.triu_indices(len(centres), 1)]
            rows.append(
                {
                    "site": str(site),
                    "factor": factor,
                    "parameter": name,
                    "levels": list(groups),
                    "groups": len(groups),
                    "subjects": sum(map(len, values)),
                    "statistic": float(f_test.statistic),
                    "p_value": float(f_test.pvalue),
                    "p_weighted": _weighted_p(subjects, factor, name),
                    "effect_size": between / (between + f_test.df_denom),
                    "method": "anova" if equal else "welch",
                    "normal": _normal(np.concatenate([group - group.mean() for group in values])),
                    "equal_variances": equal,
                    "smallest_difference": float(gaps.min()),
                    "largest_std": max(float(group.std(ddof=1)) for group in values),
                    "detectable": detectable_effect(len(values), sum(map(len, values))),
                }
                | _difference(values, equal=equal)
            )
    return corrected(pd.DataFrame(rows))


def general_linear(means: pd.DataFrame, factors: Sequence[str], parameters: Sequence[str]) -> pd.DataFrame:
    """Compare the groups of several factors at once, each adjusted for the others (type II sums of squares).

    Returns:
        columns ``site``, ``factor``, ``parameter``, ``subjects``, ``statistic`` (F), ``p_value``, ``p_corrected``,
        ``r_squared`` (of the whole model).
    """
    rows = []
    for site, subjects in means.groupby("site", sort=True):
        for name in parameters:
            data = subjects[[name, *factors]].dropna().rename(columns={name: "value"})
            usable = [factor for factor in factors if data[factor].nunique() > 1]
            if not usable or len(data) <= sum(_levels(data[factor]) for factor in usable) + 1:
                continue
            fit = smf.ols("value ~ " + " + ".join(_term(data, factor) for factor in usable), data).fit()
            anova = anova_lm(fit, typ=2)
            rows += [
                {
                    "site": str(site),
                    "factor": factor,
                    "parameter": name,
                    "subjects": len(data),
                    "statistic": float(anova.loc[_term(data, factor), "F"]),
                    "p_value": float(anova.loc[_term(data, factor), "PR(>F)"]),
                    "r_squared": float(fit.rsquared),
                }
                for factor in usable
            ]
    return corrected(pd.DataFrame(rows))


def least_adjusted(means: pd.DataFrame, factors: Sequence[str]) -> int:
    """Return the least number of subjects of ``general_linear`` with all levels of these factors."""
    return sum(_levels(means[factor].dropna()) for factor in factors) + 2


def regressions(means: pd.DataFrame, regressor: str, parameters: Sequence[str]) -> pd.DataFrame:
    """Regress each parameter on one value of the subjects at each site, such as ``bmi`` (Fig. 7.6, Table 7.3b).

    The weights are 1 / (s^2 + u^2): s the spread about the line, u the uncertainty of the subject's mean, where every
    subject has one; otherwise ordinary least squares.

    Returns:
        columns ``site``, ``factor``, ``parameter``, ``subjects``, ``slope``, ``slope_low``, ``slope_high``,
        ``intercept``, ``r_squared``, ``p_value``, ``p_corrected``, ``weighted``, ``normal`` (residuals), and
        ``equal_variances`` (Breusch and Pagan 1979).
    """
    rows = []
    for site, subjects in means.groupby("site", sort=True):
        for name in parameters:
            uncertain = subjects.get(name + STD_SUFFIX, pd.Series(np.nan, subjects.index))
            data = pd.DataFrame(
                {
                    "value": subjects[name].astype(float),
                    "x": subjects[regressor].astype(float),
                    "u": uncertain.astype(float),
                }
            ).dropna(subset=["value", "x"])
            if len(data) < LEAST_REGRESSION or np.ptp(data["x"]) == 0.0 or np.ptp(data["value"]) == 0.0:
                continue
            fit = smf.ols("value ~ x", data).fit()
            weighted = bool(data["u"].notna().all())
            if weighted:
                fit = smf.wls("value ~ x", data, weights=_weights(fit, data["u"])).fit()
            residuals = np.asarray(fit.wresid)
            low, high = fit.conf_int().loc["x"]
            rows.append(
                {
                    "site": str(site),
                    "factor": regressor,
                    "parameter": name,
                    "subjects": len(data),
                    "slope": float(fit.params["x"]),
                    "slope_low": float(low),
                    "slope_high": float(high),
                    "intercept": float(fit.params["Intercept"]),
                    "r_squared": float(fit.rsquared),
                    "p_value": float(fit.pvalues["x"]),
                    "weighted": weighted,
                    "normal": _normal(residuals),
                    "equal_variances": bool(het_breuschpagan(residuals, fit.model.exog)[1] >= ASSUMPTION_ALPHA),
                }
            )
    return corrected(pd.DataFrame(rows))


def mixed_model(table: pd.DataFrame, factor: str, parameters: Sequence[str]) -> pd.DataFrame:
    """Compare the levels of a factor that varies within subjects, such as ``site``, with the subject as random effect.

    The first level in alphabetical order is the reference.

    Returns:
        columns ``factor``, ``parameter``, ``level``, ``reference``, ``subjects``, ``tests``, ``difference``, ``low``,
        ``high``, ``p_value``, ``p_corrected``, ``effect_size`` (difference over the total standard deviation),
        ``between_std`` (between subjects), ``within_std``, ``normal`` (residuals), ``converged``,
        ``singular`` (no variance between subjects is found).
    """
    rows = []
    for name in parameters:
        data = table[["subject", factor, name]].dropna().rename(columns={name: "value"})
        levels = sorted(data[factor].astype(str).unique())
        if len(levels) < 2 or data["subject"].nunique() < LEAST_MIXED or np.ptp(data["value"]) == 0.0:
            continue
        scale = float(data["value"].std())  # the optimiser needs values near one
        data = data.assign(value=data["value"] / scale, level=data[factor].astype(str))
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("ignore", ConvergenceWarning)
            warnings.simplefilter("always", SingularMatrixWarning)
            fit = smf.mixedlm("value ~ C(level)", data, groups=data["subject"]).fit(reml=True)
            bounds = fit.conf_int()
        singular = any(issubclass(warning.category, SingularMatrixWarning) for warning in caught)
        total = float(np.sqrt(max(fit.cov_re.iloc[0, 0], 0.0) + fit.scale))
        normal = _normal(np.asarray(fit.resid))
        for level in levels[1:]:
            key = f"C(level)[T.{level}]"
            rows.append(
                {
                    "factor": factor,
                    "parameter": name,
                    "level": level,
                    "reference": levels[0],
                    "subjects": int(data["subject"].nunique()),
                    "tests": len(data),
                    "difference": float(fit.params[key]) * scale,
                    "low": float(bounds.loc[key, 0]) * scale,
                    "high": float(bounds.loc[key, 1]) * scale,
                    "p_value": float(fit.pvalues[key]),
                    "effect_size": float(fit.params[key]) / total,
                    "between_std": float(np.sqrt(max(fit.cov_re.iloc[0, 0], 0.0))) * scale,
                    "within_std": float(np.sqrt(fit.scale)) * scale,
                    "normal": normal,
                    "converged": bool(fit.converged),
                    "singular": singular,
                }
            )
    return corrected(pd.DataFrame(rows))


def efficacy(
    means: pd.DataFrame, before: str, after: str, parameters: Sequence[str], margin: float | None = None
) -> pd.DataFrame:
    """Compare two conditions of the same subjects and sites by paired differences ``after - before``.

    Args:
        means: one row per subject, site and condition.
        before: value of the column ``condition`` of the reference.
        after: value of the column ``condition`` of the product.
        parameters: columns to compare.
        margin: relative difference below which both conditions count as equivalent; None for no test of equivalence.

    Returns:
        columns ``site``, ``parameter``, ``before``, ``after``, ``subjects``, ``difference``, ``std``, ``low``,
        ``high``, ``effect_size``, ``p_value``, ``p_corrected``, ``normal`` (differences) and, with a margin,
        ``margin`` and ``equivalence_p_value`` of two one-sided tests (Schuirmann 1987).
    """
    rows = []
    for site, tests in means.groupby("site", sort=True):
        for name in parameters:
            wide = tests.pivot_table(index="subject", columns="condition", values=name)
            if not {before, after} <= set(wide.columns):
                continue
            pairs = wide[[before, after]].dropna()
            if len(pairs) < LEAST_PAIRS:
                continue
            first, second = pairs[before].to_numpy(), pairs[after].to_numpy()
            row: dict[str, object] = {"site": str(site), "parameter": name, "before": before, "after": after}
            row["subjects"] = len(pairs)
            row |= paired_difference(first, second)
            row["normal"] = _normal(second - first)
            if margin is not None:
                row["margin"] = margin
                bound = abs(margin * first.mean())
                row["equivalence_p_value"] = float(ttost_paired(second, first, -bound, bound)[0])
            rows.append(row)
    return corrected(pd.DataFrame(rows))


def site_means(means: pd.DataFrame, parameters: Sequence[str]) -> pd.DataFrame:
    """Return the mean of the subjects at each site, weighted by their uncertainties (``pooled_mean``; Fig. 7.3).

    Returns:
        columns ``site``, ``parameter``, ``subjects``, ``mean``, ``low``, ``high`` (95 % interval), ``std`` (between
        subjects, all that is seen) and ``between_std`` (without the uncertainty of each subject's mean).
    """
    rows = []
    for site, subjects in means.groupby("site", sort=True):
        for name in parameters:
            data = subjects[[name, name + STD_SUFFIX]].astype(float).dropna()
            if len(data) < LEAST_POOLED or np.ptp(data[name]) == 0.0 or (data[name + STD_SUFFIX] <= 0.0).any():
                continue
            mean, error, between = pooled_mean(data[name].to_numpy(), data[name + STD_SUFFIX].to_numpy())
            reach = float(stats.t.ppf(0.5 + 0.5 * CONFIDENCE, len(data) - 1)) * error
            rows.append(
                {
                    "site": str(site),
                    "parameter": name,
                    "subjects": len(data),
                    "mean": mean,
                    "low": mean - reach,
                    "high": mean + reach,
                    "std": float(data[name].std(ddof=1)),
                    "between_std": between,
                }
            )
    return pd.DataFrame(rows)


def materials(tests: pd.DataFrame, parameters: Sequence[str], factor: str = "material") -> pd.DataFrame:
    """Compare materials by their tests, each pair by Tukey's honestly significant difference (Fig. 7.10).

    Args:
        tests: one row per test of a sample, with the column ``factor``.
        parameters: columns to compare.
        factor: column with the material.

    Returns:
        columns ``parameter``, ``level``, ``tests``, ``mean``, ``std``, ``statistic`` (F of all materials),
        ``p_value``, ``p_corrected``, ``unlike`` (number of other materials from which it differs, 5 % for all pairs
        together).
    """
    rows = []
    for name in parameters:
        groups = _groups(tests, factor, name)
        values = list(groups.values())
        if len(groups) < 2 or all(np.ptp(group) == 0.0 for group in values):
            continue
        f_test = anova_oneway(values, use_var="equal" if _equal_variances(values) else "unequal", welch_correction=True)
        labels = np.repeat(list(groups), [len(group) for group in values])
        scale = float(np.concatenate(values).std())
        pairs = pairwise_tukeyhsd(np.concatenate(values) / scale, labels)
        first, second = np.triu_indices(len(groups), 1)
        for index, (level, group) in enumerate(groups.items()):
            unlike = pairs.reject[(first == index) | (second == index)]
            rows.append(
                {
                    "parameter": name,
                    "level": level,
                    "tests": len(group),
                    "mean": float(group.mean()),
                    "std": float(group.std(ddof=1)),
                    "statistic": float(f_test.statistic),
                    "p_value": float(f_test.pvalue),
                    "unlike": int(unlike.sum()),
                }
            )
    if not rows:
        return pd.DataFrame()
    table = pd.DataFrame(rows)
    once = corrected(table.drop_duplicates("parameter")[["parameter", "p_value"]].copy())
    table.insert(
        table.columns.get_loc("p_value") + 1,
        "p_corrected",
        table["parameter"].map(once.set_index("parameter")["p_corrected"]),
    )
    return table


def pooled_mean(values: Sequence[float], stds: Sequence[float]) -> tuple[float, float, float]:
    """Return mean, standard error and standard deviation between subjects of values with known uncertainties (n,).

    A random-effects model with the estimate of Paule and Mandel (1982).
    """
    combined = combine_effects(np.asarray(values), np.asarray(stds) ** 2, method_re="iterated")
    return float(combined.mean_effect_re), float(combined.sd_eff_w_re), float(np.sqrt(combined.tau2))


def corrected(rows: pd.DataFrame) -> pd.DataFrame:
    """Return rows with the column ``p_corrected``: Holm's correction over all rows with a p-value."""
    if rows.empty:
        return rows
    tested = rows["p_value"].notna()
    values = pd.Series(np.nan, rows.index)
    if tested.any():
        values[tested] = multipletests(rows.loc[tested, "p_value"], method=CORRECTION)[1]
    rows.insert(rows.columns.get_loc("p_value") + 1, "p_corrected", values)
    return rows


def _groups(subjects: pd.DataFrame, factor: str, name: str) -> dict[str, np.ndarray]:
    complete = subjects[[factor, name]].dropna()
    groups = {str(key): values[name].to_numpy(float) for key, values in complete.groupby(factor, sort=True)}
    return {key: values for key, values in groups.items() if len(values) >= LEAST_PER_GROUP}


def _equal_variances(groups: Sequence[np.ndarray]) -> bool:
    # Levene's test about the medians (Brown and Forsythe 1974); too few values cannot show a difference.
    if any(len(values) < 3 for values in groups) or all(np.ptp(values) == 0.0 for values in groups):
        return True
    return bool(stats.levene(*groups).pvalue >= ASSUMPTION_ALPHA)


def _normal(residuals: np.ndarray) -> bool | None:
    if len(residuals) < 4 or np.ptp(residuals) == 0.0:
        return None
    return bool(stats.shapiro(residuals).pvalue >= ASSUMPTION_ALPHA)


def _weights(fit: Any, uncertain: Any) -> Any:
    # 1 / (s^2 + u^2): s is the spread of an unweighted fit without the uncertainty of the values.
    rest = max(float(fit.mse_resid) - float((uncertain**2).mean()), 0.0)
    return 1.0 / np.maximum(rest + uncertain**2, 1e-300)


def _weighted_p(subjects: pd.DataFrame, factor: str, name: str) -> float:
    if name + STD_SUFFIX not in subjects:
        return float("nan")
    data = subjects[[factor, name, name + STD_SUFFIX]].rename(columns={factor: "group", name: "value"}).dropna()
    counts = data["group"].value_counts()
    data = data[data["group"].isin(counts.index[counts >= LEAST_PER_GROUP])]
    if data["group"].nunique() < 2 or len(data) <= data["group"].nunique() or np.ptp(data["value"]) == 0.0:
        return float("nan")
    value = data["value"].to_numpy(float)
    groups = pd.get_dummies(data["group"], drop_first=True, dtype=float).to_numpy()
    design = np.column_stack([np.ones(len(data)), groups])  # arrays: a formula takes ten times as long
    weights = _weights(OLS(value, design).fit(), data[name + STD_SUFFIX].to_numpy(float))
    return float(WLS(value, design, weights=weights).fit().f_pvalue)


def _difference(values: Sequence[np.ndarray], *, equal: bool) -> dict[str, float]:
    if len(values) != 2:
        return {"difference": float("nan"), "low": float("nan"), "high": float("nan")}
    compared = CompareMeans(DescrStatsW(values[1]), DescrStatsW(values[0]))
    low, high = compared.tconfint_diff(1.0 - CONFIDENCE, usevar="pooled" if equal else "unequal")
    return {"difference": float(values[1].mean() - values[0].mean()), "low": float(low), "high": float(high)}


def _levels(values: pd.Series) -> int:
    return 1 if pd.api.types.is_numeric_dtype(values) else values.nunique() - 1


def _term(data: pd.DataFrame, factor: str) -> str:
    return factor if pd.api.types.is_numeric_dtype(data[factor]) else f"C({factor})"
