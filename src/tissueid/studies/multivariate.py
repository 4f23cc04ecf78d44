"""Partial least squares of the parameters on a demographic value, and principal components of kernels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import permutation_test
from sklearn.decomposition import PCA
from sklearn.model_selection import KFold

from tissueid.studies.group_comparison import corrected

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


@dataclass(frozen=True, eq=False)
class PrincipalComponents:
    """Principal components of kernels.

    ``scores`` has shape (tests, components), ``shares`` (components,) the share of the variance of each, ``shapes``
    (components, values) the components as kernels, ``mean`` (values,) the mean kernel.
    """

    scores: NDArray[np.float64]
    shares: NDArray[np.float64]
    shapes: NDArray[np.float64]
    mean: NDArray[np.float64]


def principal_components(kernels: NDArray[np.float64], count: int = 3) -> PrincipalComponents:
    """Return the principal components of kernels, one flattened kernel per test, shape (tests, values)."""
    model = PCA(min(count, *kernels.shape), svd_solver="full").fit(kernels)
    return PrincipalComponents(
        model.transform(kernels), model.explained_variance_ratio_, model.components_, model.mean_
    )


def _p_value(x: NDArray[np.float64], y: NDArray[np.float64], folds: KFold, most: int, permutations: int) -> float:
    # Least error over the numbers of components, of y and of permutations of it: with a number that was chosen for y
    # the p-values would be too small.
    def least(values: NDArray[np.float64]) -> float:
        return float(_held_out_errors(x, values, most, folds).min())

    found = permutation_test(
        (y,),
        least,
        permutation_type="pairings",
        vectorized=False,
        n_resamples=permutations,
        alternative="less",
        rng=np.random.default_rng(_SEED),
    )
    return float(found.pvalue)


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
    rest, left = x, y - y.mean()
    steps = np.zeros((len(new), count))
    least = _NO_COVARIANCE * float(np.linalg.norm(x) * np.linalg.norm(left))
    for place in range(count):
        weights = left @ rest
        size = float(np.linalg.norm(weights))
        if size <= least:
            break
        weights = weights / size
        scores = rest @ weights
        power = float(scores @ scores)
        loadings, share = scores @ rest / power, float(left @ scores) / power
        found = new @ weights
        steps[:, place] = share * found
        rest, left = rest - np.outer(scores, loadings), left - share * scores
        new = new - np.outer(found, loadings)
    return steps


def _numbers(values: pd.Series) -> NDArray[np.float64] | None:
    if pd.api.types.is_numeric_dtype(values):
        return np.asarray(values, dtype=float)
    codes, names = pd.factorize(values, sort=True)
    return codes.astype(float) if len(names) == 2 else None
