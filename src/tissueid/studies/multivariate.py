"""Partial least squares of the parameters on a demographic value, and principal components of kernels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import permutation_test
from sklearn.decomposition import PCA
from sklearn.model_selection import KFold

from tissueid.analysis.curves.plot import Array
from tissueid.analysis.curves.samples import GRIDS, KERNEL1, KERNEL2
from tissueid.messages import Message
from tissueid.studies.curve_groups import curves_of, group_labels
from tissueid.studies.group_comparison import corrected, one_way
from tissueid.studies.study_table import MATERIAL

FOLDS = 5
PERMUTATIONS = 99
LEAST_SUBJECTS = 8
MOST_COMPONENTS = 3
"""Largest number of components: 16 subjects do not determine more."""
_SEED = 0
_NO_COVARIANCE = 1e-10
"""Relative covariance of what is left of parameters and response that counts as 0."""


def partial_least_squares(
    means: pd.DataFrame, responses: Sequence[str], parameters: Sequence[str], permutations: int | None = None
) -> pd.DataFrame:
    """Regress each demographic value on all parameters at each site by partial least squares (Table 7.4).

    The number of components is that of the least error in cross-validation; the p-value is that of permutations of the
    subjects (Ojala and Garriga 2010), each with its own number of components. Two groups are coded as 0 and 1 in
    alphabetical order.

    Args:
        means: one row per subject and site.
        responses: columns with demographic values: numbers, or two groups.
        parameters: columns of the parameters.
        permutations: number of permutations; ``PERMUTATIONS`` by default.

    Returns:
        columns ``site``, ``response``, ``subjects``, ``components``, ``q_squared`` (held-out share of the variance),
        ``p_value``, ``p_corrected``.
    """
    rows = []
    for site, subjects in means.groupby("site", sort=True):
        for response in responses:
            data = subjects[[response, *parameters]].dropna()
            y = _numbers(data[response])
            if y is None or len(data) < LEAST_SUBJECTS or np.ptp(y) == 0.0:
                continue
            x = data[list(parameters)].to_numpy(float)
            x = x[:, np.ptp(x, axis=0) > 0.0]
            folds = KFold(min(FOLDS, len(data)), shuffle=True, random_state=_SEED)
            most = min(MOST_COMPONENTS, x.shape[1], len(data) - len(data) // FOLDS - 1)
            errors = _held_out_errors(x, y, most, folds)
            p_value = _p_value(x, y, folds, most, permutations or PERMUTATIONS)
            components = int(np.argmin(errors)) + 1
            rows.append(
                {
                    "site": str(site),
                    "response": response,
                    "subjects": len(data),
                    "components": components,
                    "q_squared": 1.0 - errors[components - 1] / float(np.var(y)),
                    "p_value": p_value,
                }
            )
    return corrected(pd.DataFrame(rows))


def _p_value(x: NDArray[np.float64], y: NDArray[np.float64], folds: KFold, most: int, permutations: int) -> float:
    # Least error over the numbers of components, of y and of permutations of it: with a number that was chosen for y
    # the p-values would be too small.
    def least(values: NDArray[np.float64]) -> float:
        return float(_held_out_errors(x, values, most, folds).min())

    result = permutation_test(
        (y,),
        least,
        permutation_type="pairings",
        vectorized=False,
        n_resamples=permutations,
        alternative="less",
        rng=np.random.default_rng(_SEED),
    )
    return float(result.pvalue)


def _held_out_errors(x: NDArray[np.float64], y: NDArray[np.float64], most: int, folds: KFold) -> NDArray[np.float64]:
    # Mean squared errors in cross-validation with 1 to ``most`` components, shape (most,): components are nested, and
    # one fit has all of them.
    errors = np.zeros(most)
    for train, test in folds.split(x):
        middle, spread = x[train].mean(axis=0), x[train].std(axis=0, ddof=1)
        scaled = (x - middle) / np.where(spread > 0.0, spread, 1.0)
        steps = component_steps(scaled[train], y[train], scaled[test], most)
        predicted = y[train].mean() + np.cumsum(steps, axis=1)
        errors += np.sum((predicted - y[test, None]) ** 2, axis=0)
    return np.asarray(errors / y.size)


def component_steps(
    x: NDArray[np.float64], y: NDArray[np.float64], new: NDArray[np.float64], count: int
) -> NDArray[np.float64]:
    """Return what each component of partial least squares adds to the prediction of new rows, shape (rows, count).

    NIPALS for one response (Wold et al. 2001). The permutations need thousands of small fits, for which
    ``sklearn.cross_decomposition.PLSRegression`` takes ten times as long. Dependent columns have fewer components; the
    others add 0.

    Args:
        x: parameters of the subjects, shape (n, parameters); the mean of each column is 0.
        y: response, shape (n,).
        new: parameters of the predicted subjects, shape (rows, parameters), centred and scaled as ``x``.
        count: number of components.
    """
    rest, residual = x, y - y.mean()
    steps = np.zeros((len(new), count))
    least = _NO_COVARIANCE * float(np.linalg.norm(x) * np.linalg.norm(residual))
    for index in range(count):
        weights = residual @ rest
        size = float(np.linalg.norm(weights))
        if size <= least:
            break
        weights = weights / size
        scores = rest @ weights
        power = float(scores @ scores)
        loadings, share = scores @ rest / power, float(residual @ scores) / power
        projected = new @ weights
        steps[:, index] = share * projected
        rest, residual = rest - np.outer(scores, loadings), residual - share * scores
        new = new - np.outer(projected, loadings)
    return steps


def _numbers(values: pd.Series) -> NDArray[np.float64] | None:
    if pd.api.types.is_numeric_dtype(values):
        return np.asarray(values, dtype=float)
    codes, names = pd.factorize(values, sort=True)
    return codes.astype(float) if len(names) == 2 else None


Mask = NDArray[np.bool_]
LEAST_TESTS = 3
"""Least number of tests of principal components."""
COMPONENTS = 3
"""Number of components that are reported."""
_SCORE = "score_{}"
ALL_GROUPS, SUBJECTS = "all", "subjects"
"""Groups that an analysis of variance compares: all, or those of subjects alone."""
_KEPT = ("groups", "subjects", "statistic", "p_value", "p_corrected", "effect_size", "method", "normal")


@dataclass(frozen=True, eq=False)
class KernelComponents:
    """Principal components of one kernel of all tests that count.

    ``mean`` (n,) is the mean kernel on the grid of ``curve``, ``shapes`` (components, n) is its change by one standard
    deviation of each score; both are NaN where a test has no value. ``shares`` (components,) are shares of the
    variance. ``scores`` has one row per test: ``session``, ``test``, ``subject``, ``group``, and ``score_1`` and so on
    in standard deviations.
    """

    curve: str
    mean: Array
    shapes: Array
    shares: Array
    scores: pd.DataFrame

    @property
    def names(self) -> list[str]:
        """Columns of the scores."""
        return [_SCORE.format(index + 1) for index in range(len(self.shares))]


def kernel_components(
    persons: pd.DataFrame, samples: pd.DataFrame, curves: pd.DataFrame, remarks: list[Message]
) -> tuple[KernelComponents, ...]:
    """Return the components of the first- and second-order kernels; adds a remark where there are too few tests.

    Args:
        persons: tests of subjects that count.
        samples: tests of materials that count.
        curves: sampled curves of the tests.
        remarks: is extended.
    """
    parts = [
        tests[["session", "test", "subject"]].assign(group=labels, sample=MATERIAL in tests and tests[MATERIAL].notna())
        for tests, labels in ((persons, _of_persons(persons)), (samples, _of_samples(samples)))
        if len(tests)
    ]
    if not parts or curves.empty:
        return ()
    kernel_rows = pd.concat(parts).merge(curves[curves["curve"].isin((KERNEL1, KERNEL2))], on=["session", "test"])
    components = []
    for name in (KERNEL1, KERNEL2):
        rows = kernel_rows[kernel_rows["curve"] == name]
        if rows.empty:
            continue
        kernels = np.stack([curve.on_grid for curve in curves_of(rows)])
        inside: Mask = np.asarray(np.isfinite(kernels).all(axis=0))
        if len(rows) < LEAST_TESTS or not inside.any() or not np.ptp(kernels[:, inside], axis=0).any():
            continue
        components.append(_components(name, rows, kernels, inside))
    if not kernel_rows.empty and not components:
        remarks.append(
            Message(
                "study.few_for_components",
                "no principal components of the Volterra kernels: they need {least} tests that differ",
                least=LEAST_TESTS,
            )
        )
    return tuple(components)


def component_table(components: Sequence[KernelComponents]) -> pd.DataFrame:
    """Return the share of each component and the one-way analysis of variance of its scores over the groups.

    The scores of the tests of a subject in a group are averaged first; each test of a material counts.

    Returns:
        columns ``kernel``, ``component``, ``share``, ``among`` (``ALL_GROUPS``; also ``SUBJECTS`` where there are
        materials), and ``groups``, ``means``, ``statistic``, ``p_value``, ``p_corrected``, ``effect_size``,
        ``method``, ``normal`` as ``group_comparison.one_way``.
    """
    rows: list[dict[str, Any]] = []
    for component in components:
        units = component.scores.assign(unit=np.where(component.scores["sample"], np.arange(len(component.scores)), -1))
        means = units.groupby(["group", "subject", "sample", "unit"], as_index=False)[component.names].mean()
        kinds = {ALL_GROUPS: means}
        if means["sample"].any() and means.loc[~means["sample"], "group"].nunique() > 1:
            kinds[SUBJECTS] = means[~means["sample"]]  # materials differ far more than sites
        for among, chosen in kinds.items():
            tested = one_way(chosen.assign(site=among), "group", component.names)
            statistics = {} if tested.empty else tested.set_index("parameter")[list(_KEPT)].to_dict("index")
            rows += [
                {
                    "kernel": component.curve,
                    "component": index + 1,
                    "share": float(component.shares[index]),
                    "among": among,
                }
                | statistics.get(name, {})
                for index, name in enumerate(component.names)
            ]
    return pd.DataFrame(rows).rename(columns={"subjects": "means"})


def score_table(components: Sequence[KernelComponents]) -> pd.DataFrame:
    """Return mean and standard deviation of the scores of the tests of each group.

    Returns:
        columns ``kernel``, ``level`` (the group), ``tests``, and for each component ``score_1``, ``score_1_std``.
    """
    rows = []
    for component in components:
        for group, tests in component.scores.groupby("group", sort=True):
            row = {"kernel": component.curve, "level": str(group), "tests": len(tests)}
            for name in component.names:
                row |= {name: float(tests[name].mean()), f"{name}_std": float(tests[name].std(ddof=1))}
            rows.append(row)
    return pd.DataFrame(rows)


def _components(name: str, rows: pd.DataFrame, kernels: Array, inside: Mask) -> KernelComponents:
    complete = kernels[:, inside]
    analysis = PCA(min(COMPONENTS, *complete.shape), svd_solver="full").fit(complete)
    scored = analysis.transform(complete)
    spread = scored.std(axis=0, ddof=1)
    kept = spread > 1e-9 * spread.max(initial=0.0)
    spread = spread[kept]
    size = GRIDS[name].x.size
    mean, shapes = np.full(size, np.nan), np.full((spread.size, size), np.nan)
    mean[inside] = analysis.mean_
    shapes[:, inside] = spread[:, None] * analysis.components_[kept]
    scores = rows[["session", "test", "subject", "group", "sample"]].reset_index(drop=True)
    for index, values in enumerate((scored[:, kept] / spread).T):
        scores[_SCORE.format(index + 1)] = values
    return KernelComponents(name, mean, shapes, analysis.explained_variance_ratio_[kept], scores)


def _of_persons(tests: pd.DataFrame) -> pd.Series:
    labels = group_labels(tests, "site")
    named = tests["condition"].astype(str)
    return labels.where(named == "", labels + "; " + named)


def _of_samples(tests: pd.DataFrame) -> pd.Series:
    return group_labels(tests, "material") if len(tests) else pd.Series(dtype=str)
