"""Power and sample size of a comparison of groups (thesis 7.1.2, Table 7.3c)."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
import pandas as pd
from scipy.optimize import brentq
from statsmodels.stats.power import FTestAnovaPower, TTestIndPower
from statsmodels.tools.sm_exceptions import ConvergenceWarning

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
