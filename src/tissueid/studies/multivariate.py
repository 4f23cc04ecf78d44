"""Partial least squares of the parameters on a demographic value, and principal components of kernels."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.cross_decomposition import PLSRegression
from sklearn.decomposition import PCA
from sklearn.model_selection import KFold, cross_val_predict, permutation_test_score

FOLDS = 5
PERMUTATIONS = 200
LEAST_SUBJECTS = 8
_SEED = 0


def partial_least_squares(
    means: pd.DataFrame, responses: Sequence[str], parameters: Sequence[str], permutations: int = PERMUTATIONS
) -> pd.DataFrame:
    """Regress each demographic value on all parameters at each site by partial least squares (Table 7.4).

    The number of components is that of the least error in cross-validation; the p-value is that of permutations of the
    subjects (Ojala and Garriga 2010). Two groups are coded as 0 and 1 in alphabetical order.

    Args:
        means: one row per subject and site.
        responses: columns with demographic values: numbers, or two groups.
        parameters: columns of the parameters.
        permutations: number of permutations.

    Returns:
        columns ``site``, ``response``, ``subjects``, ``components``, ``q_squared`` (held-out share of the variance),
        ``p_value``.
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
            most = min(x.shape[1], len(data) - len(data) // FOLDS - 1)
            with warnings.catch_warnings():
                # Parameters that depend on each other have fewer components than their number.
                warnings.filterwarnings("ignore", "y residual is constant")
                errors = [_held_out_error(x, y, count, folds) for count in range(1, most + 1)]
                components = int(np.argmin(errors)) + 1
                _score, _drawn, p_value = permutation_test_score(
                    _model(components),
                    x,
                    y,
                    cv=folds,
                    n_permutations=permutations,
                    scoring="neg_mean_squared_error",
                    random_state=_SEED,
                )
            rows.append(
                {
                    "site": str(site),
                    "response": response,
                    "subjects": len(data),
                    "components": components,
                    "q_squared": 1.0 - errors[components - 1] / float(np.var(y)),
                    "p_value": float(p_value),
                }
            )
    return pd.DataFrame(rows)


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


def _model(components: int) -> PLSRegression:
    return PLSRegression(components)


def _held_out_error(x: NDArray[np.float64], y: NDArray[np.float64], components: int, folds: KFold) -> float:
    predicted = cross_val_predict(_model(components), x, y, cv=folds)
    return float(np.mean((np.ravel(predicted) - y) ** 2))


def _numbers(values: pd.Series) -> NDArray[np.float64] | None:
    if pd.api.types.is_numeric_dtype(values):
        return np.asarray(values, dtype=float)
    codes, names = pd.factorize(values, sort=True)
    return codes.astype(float) if len(names) == 2 else None
