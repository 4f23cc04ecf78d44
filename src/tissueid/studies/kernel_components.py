"""Principal components of the Volterra kernels of the tests of a study, and their scores by group (thesis 7.2, 8)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tissueid.analysis.curves.plot import Array
from tissueid.analysis.curves.samples import GRIDS, KERNEL1, KERNEL2
from tissueid.messages import Message
from tissueid.studies.curve_groups import group_labels
from tissueid.studies.group_comparison import one_way
from tissueid.studies.multivariate import PrincipalComponents, principal_components
from tissueid.studies.sampled_curves import curves_of
from tissueid.studies.study_table import MATERIAL

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
        return [_SCORE.format(place + 1) for place in range(len(self.shares))]


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
    known = pd.concat(parts).merge(curves[curves["curve"].isin((KERNEL1, KERNEL2))], on=["session", "test"])
    found = []
    for name in (KERNEL1, KERNEL2):
        rows = known[known["curve"] == name]
        if rows.empty:
            continue
        kernels = np.stack([curve.on_grid for curve in curves_of(rows)])
        inside: Mask = np.asarray(np.isfinite(kernels).all(axis=0))
        if len(rows) < LEAST_TESTS or not inside.any() or not np.ptp(kernels[:, inside], axis=0).any():
            continue
        found.append(_components(name, rows, inside, principal_components(kernels[:, inside], COMPONENTS)))
    if not known.empty and not found:
        remarks.append(
            Message(
                "study.few_for_components",
                "no principal components of the Volterra kernels: they need {least} tests that differ",
                least=LEAST_TESTS,
            )
        )
    return tuple(found)


def component_table(components: Sequence[KernelComponents]) -> pd.DataFrame:
    """Return the share of each component and the one-way analysis of variance of its scores over the groups.

    The scores of the tests of a subject in a group are averaged first; each test of a material counts.

    Returns:
        columns ``kernel``, ``component``, ``share``, ``among`` (``ALL_GROUPS``; also ``SUBJECTS`` where there are
        materials), and ``groups``, ``means``, ``statistic``, ``p_value``, ``p_corrected``, ``effect_size``,
        ``method``, ``normal`` as ``group_comparison.one_way``.
    """
    rows: list[dict[str, Any]] = []
    for one in components:
        units = one.scores.assign(unit=np.where(one.scores["sample"], np.arange(len(one.scores)), -1))
        means = units.groupby(["group", "subject", "sample", "unit"], as_index=False)[one.names].mean()
        kinds = {ALL_GROUPS: means}
        if means["sample"].any() and means.loc[~means["sample"], "group"].nunique() > 1:
            kinds[SUBJECTS] = means[~means["sample"]]  # materials differ far more than sites
        for among, chosen in kinds.items():
            tested = one_way(chosen.assign(site=among), "group", one.names)
            found = {} if tested.empty else tested.set_index("parameter")[list(_KEPT)].to_dict("index")
            rows += [
                {"kernel": one.curve, "component": place + 1, "share": float(one.shares[place]), "among": among}
                | found.get(name, {})
                for place, name in enumerate(one.names)
            ]
    return pd.DataFrame(rows).rename(columns={"subjects": "means"})


def score_table(components: Sequence[KernelComponents]) -> pd.DataFrame:
    """Return mean and standard deviation of the scores of the tests of each group.

    Returns:
        columns ``kernel``, ``level`` (the group), ``tests``, and for each component ``score_1``, ``score_1_std``.
    """
    rows = []
    for one in components:
        for group, tests in one.scores.groupby("group", sort=True):
            row = {"kernel": one.curve, "level": str(group), "tests": len(tests)}
            for name in one.names:
                row |= {name: float(tests[name].mean()), f"{name}_std": float(tests[name].std(ddof=1))}
            rows.append(row)
    return pd.DataFrame(rows)


def _components(name: str, rows: pd.DataFrame, inside: Mask, found: PrincipalComponents) -> KernelComponents:
    spread = found.scores.std(axis=0, ddof=1)
    kept = spread > 1e-9 * spread.max(initial=0.0)
    spread = spread[kept]
    size = GRIDS[name].x.size
    mean, shapes = np.full(size, np.nan), np.full((spread.size, size), np.nan)
    mean[inside] = found.mean
    shapes[:, inside] = spread[:, None] * found.shapes[kept]
    scores = rows[["session", "test", "subject", "group", "sample"]].reset_index(drop=True)
    for place, values in enumerate((found.scores[:, kept] / spread).T):
        scores[_SCORE.format(place + 1)] = values
    return KernelComponents(name, mean, shapes, found.shares[kept], scores)


def _of_persons(tests: pd.DataFrame) -> pd.Series:
    labels = group_labels(tests, "site")
    named = tests["condition"].astype(str)
    return labels.where(named == "", labels + "; " + named)


def _of_samples(tests: pd.DataFrame) -> pd.Series:
    return group_labels(tests, "material") if len(tests) else pd.Series(dtype=str)
