"""Exact solution of Eqs. 4.2-4.14, with a factor of the stimulus that can be reused for other responses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissueid.identification.base import Array, Mask
from tissueid.identification.effective_samples import dependence_samples
from tissueid.identification.least_squares import Factor, factor
from tissueid.identification.volterra.regressors import VolterraRegressors

_SHORTEST_BLOCK = 10
_OFFSETS = 4
"""Number of block offsets over which the result is averaged."""


@dataclass(frozen=True, eq=False)
class VolterraStimulus:
    """An input with its regressors factored; any number of responses to it can be solved for."""

    regressors: VolterraRegressors
    gram: Array
    factor: Factor

    def matches(self, x: Array, used: Mask, lags: int, spacing: int, order: int) -> bool:
        """Return whether this is the factor for that input (n,), those rows (n,) and those kernels."""
        mine = self.regressors
        return (
            (mine.lags, mine.spacing, mine.order) == (lags, spacing, order)
            and np.array_equal(mine.used, used)
            and np.array_equal(mine.x, x, equal_nan=True)
        )

    def solve(self, output: Array) -> Array:
        """Return the coefficients (M,) for an output (n,), of which only the rows are used."""
        return self.factor.solve(output[self.regressors.rows])

    def deviations(self, residuals: Array, sample_rate_hz: float) -> Array:
        """Return the standard deviations of the coefficients (M,), from the residuals at the rows (rows,).

        The residual of tissue is coloured and depends on the input. The covariance is the sandwich inv(P'P) S inv(P'P),
        with S from sums of P e over blocks of rows within which the residual is autocorrelated (White 1982), corrected
        for the degrees of freedom of the fit.
        """
        rows, columns = residuals.size, self.regressors.columns
        block = max(_SHORTEST_BLOCK, dependence_samples(residuals, sample_rate_hz))
        block = min(block, max(1, rows // 8))
        total = np.zeros(columns)
        for offset in range(_OFFSETS):
            edges = np.arange(offset * block // _OFFSETS, rows, block)
            if edges[0] > 0:
                edges = np.append(0, edges)
            influence = self.factor.gram_solve(self.regressors.block_sums(residuals, edges))  # (M, blocks)
            total += np.einsum("ij,ij->i", influence, influence) / _OFFSETS
        return np.asarray(np.sqrt(total * rows / max(1, rows - columns)), dtype=np.float64)


def factor_stimulus(x: Array, used: Mask, lags: int, spacing: int = 1, order: int = 2) -> VolterraStimulus:
    """Factor the regressors of an input x (n,) with its mean removed, at the rows of a mask (n,).

    Lags are ``spacing`` samples apart. Every input of a row's memory must have been received.
    """
    regressors = VolterraRegressors(x, used, lags, spacing, order)
    gram = regressors.gram()
    return VolterraStimulus(regressors, gram, factor(gram, regressors))
