"""Mean curves of groups, their intervals and changes, and principal components of kernels, against numbers by hand."""

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from scipy import stats

from tissueid.analysis.curves.plot import as_csv
from tissueid.analysis.curves.samples import GRIDS, KERNEL1, KERNEL2, LAGS, MAGNITUDE, PARTITIONS, STIFFNESS, trimmed
from tissueid.reports.study_page import study_html, study_plots, tables_of
from tissueid.studies.curve_groups import (
    chosen,
    curves_table,
    group_curves,
    group_labels,
    mean_and_interval,
    read_curves,
    write_curves,
)
from tissueid.studies.multivariate import component_table, kernel_components, score_table
from tissueid.studies.study_plots import curve_plot, kernel_panel, scores_plot, shared_limit
from tissueid.studies.study_statistics import study_statistics

T_3 = stats.t.ppf(0.975, 2)
"""Quantile of an interval of three subjects: 4.303."""


def made_tests(rows):
    """Return a table of tests from subject, site, condition and material."""
    columns = ["subject", "site", "condition", "material"]
    table = pd.DataFrame(rows, columns=columns)
    table["session"] = [f"{place}.h5" for place in range(len(table))]
    same = {"test": 1, "created": "2026-01-01", "status": "completed", "quality": "good", "problem": "", "repeat": 1}
    return table.assign(configuration="indentation", orientation_deg=np.nan, vaf_percent=90.0 + table.index, **same)


def flat(name, value, first=0, count=None):
    """Return a curve with one value from a point of its grid on."""
    values = np.full(GRIDS[name].x.size, np.nan)
    values[first : None if count is None else first + count] = value
    return trimmed(name, values)


def curves_for(table, name, values, **where):
    return curves_table(
        (row.session, 1, flat(name, v, **where)) for row, v in zip(table.itertuples(), values, strict=True)
    )


NO_SAMPLES = made_tests([]).astype({"site": str})


def test_tests_of_a_subject_are_averaged_before_the_subjects():
    table = made_tests([("A", "arm", "", None), ("A", "arm", "", None), ("B", "arm", "", None), ("C", "arm", "", None)])
    found = group_curves(table, NO_SAMPLES, curves_for(table, STIFFNESS, [1.0, 3.0, 5.0, 8.0], first=20, count=9))
    (one,) = found  # A: 2, B: 5, C: 8; mean 5, standard deviation 3
    assert (one.by, one.group, one.curve, one.count) == ("site", "arm", STIFFNESS, 3)
    assert np.flatnonzero(np.isfinite(one.mean)).tolist() == list(range(20, 29))
    half = T_3 * 3.0 / np.sqrt(3.0)
    assert (one.mean[20], one.low[20], one.high[20]) == pytest.approx((5.0, 5.0 - half, 5.0 + half))
    assert one.members.shape == (3, GRIDS[STIFFNESS].x.size)
    assert one.vaf_percent == pytest.approx(91.5)
    answer = one.as_answer()
    assert answer["depth_m"][0] == pytest.approx(GRIDS[STIFFNESS].x[20])
    assert answer["mean"] == pytest.approx([5.0] * 9)


def test_a_mean_needs_nine_tenths_of_the_rows_and_an_interval_three():
    rows = np.tile(np.arange(1.0, 11.0)[:, None], 3)
    rows[9, 1] = rows[8:, 2] = np.nan
    mean, low, high = mean_and_interval(rows)
    assert mean == pytest.approx([5.5, 5.0, np.nan], nan_ok=True)
    assert (low[0], high[0]) == pytest.approx(stats.t.interval(0.95, 9, 5.5, stats.sem(rows[:, 0])))
    assert (low[1], high[1]) == pytest.approx(stats.t.interval(0.95, 8, 5.0, stats.sem(rows[:9, 1])))
    assert np.isnan([low[2], high[2]]).all()
    two = mean_and_interval(rows[:2, :1])
    assert two[0] == pytest.approx([1.5])
    assert np.isnan(two[1]).all()
    assert mean_and_interval(rows, 0.5)[0][2] == pytest.approx(4.5)


def test_subjects_whose_depths_do_not_overlap_are_drawn_one_by_one():
    table = made_tests([("A", "arm", "", None), ("B", "arm", "", None)])
    curves = pd.concat(
        [
            curves_for(table[:1], STIFFNESS, [1.0], first=20, count=3),
            curves_for(table[1:], STIFFNESS, [2.0], first=50, count=3),
        ]
    )
    found = chosen(group_curves(table, NO_SAMPLES, curves), "site", STIFFNESS)
    assert [one.has_values for one in found] == [True]
    assert not np.isfinite(found[0].mean).any()
    thin, mean = curve_plot(found, ["arm"]).curves
    assert np.isfinite(thin.y).sum() == 6
    assert mean.y.size == 0
    assert str(mean.name) == "arm"


def test_groups_are_sites_orientations_conditions_and_materials():
    table = made_tests(
        [("A", "arm", "", None), ("A", "arm", "cream", None), ("A", "leg", "", None), ("S", "gel", "", "gel")]
    )
    people, samples = table[:3], table[3:]
    found = group_curves(people, samples, curves_for(table, MAGNITUDE, [1.0, 2.0, 3.0, 9.0]))
    means = {(one.by, one.group): one.mean[0] for one in found}
    assert means == {
        ("site", "arm"): 1.0,
        ("site", "leg"): 3.0,
        ("condition", "without"): 1.0,
        ("condition", "cream"): 2.0,
        ("material", "gel"): 9.0,
        ("material", ""): 2.0,  # subjects at all sites, without a product
    }
    turned = people.assign(orientation_deg=[0.0, 90.0, np.nan])
    assert group_labels(turned, "site").tolist() == ["arm, 0°", "arm, 90°", "leg"]
    both = pd.concat([people, people.assign(site="leg")])
    assert set(group_labels(both, "condition")) == {"arm; without", "arm; cream", "leg; without", "leg; cream"}
    plot = curve_plot(chosen(found, "material", MAGNITUDE), ["", "gel"])
    assert [str(curve.name) for curve in plot.curves] == ["subjects, all sites", "gel"]
    assert plot.curves[1].y[0] == pytest.approx(9e3)  # mm/N


def test_changes_of_a_condition_are_paired_by_subject_and_depth():
    table = made_tests(
        [(who, "arm", what, None) for who in "ABC" for what in ("", "cream")] + [("D", "arm", "cream", None)]
    )
    values = [10.0, 11.0, 20.0, 18.0, 40.0, 44.0, 99.0]  # +10 %, -10 %, +10 %; D has no reference
    found = group_curves(table, NO_SAMPLES, curves_for(table, STIFFNESS, values, first=30, count=4))
    (change,) = chosen(found, "change", STIFFNESS)
    assert (change.group, change.count) == ("cream", 3)
    half = T_3 * np.std([10.0, -10.0, 10.0], ddof=1) / np.sqrt(3.0)
    assert change.mean[31] == pytest.approx(10.0 / 3.0, abs=1e-4)
    assert change.high[31] - change.mean[31] == pytest.approx(half, rel=1e-4)
    plot = curve_plot([change], ["cream"])
    assert plot.y.unit == "%"
    assert "cream" in as_csv([plot])


def test_kernels_have_panels_on_one_scale_with_their_vaf():
    table = made_tests([("A", "arm", "", None), ("B", "leg", "", None)])
    found = group_curves(table, NO_SAMPLES, curves_for(table, KERNEL2, [0.5, -2.0]))
    curves = chosen(found, "site", KERNEL2)
    panels = [kernel_panel(one, shared_limit(curves)) for one in curves]
    assert [panel.title for panel in panels] == ["arm, VAF 90.0 %", "leg, VAF 91.0 %"]
    assert {panel.surface.limit for panel in panels} == {2e3}
    assert panels[1].surface.values == pytest.approx(np.full((LAGS, LAGS), -2e3))
    depths = group_curves(table, NO_SAMPLES, curves_for(table, PARTITIONS, [1.0, 2.0], first=30 * LAGS, count=5 * LAGS))
    surface = kernel_panel(chosen(depths, "site", PARTITIONS)[0], 1.0).surface
    assert surface.values.shape == (5, LAGS)
    assert surface.y == pytest.approx(1e3 * np.unique(GRIDS[PARTITIONS].y)[30:35])


def kernel_study(tests=8):
    """Return tests at two sites whose kernels differ along one shape, and a little along another one."""
    table = made_tests([(f"P{place // 2}", ("arm", "leg")[place % 2], "", None) for place in range(tests)])
    random = np.random.default_rng(4)
    shapes = [np.exp(-np.arange(40) / 8.0), np.sin(np.arange(40) / 3.0)]
    rows = []
    for place, row in enumerate(table.itertuples()):
        kernel = (1.0 + 0.5 * (place % 2) + 0.01 * random.normal()) * shapes[0] + 0.02 * random.normal() * shapes[1]
        rows += [(row.session, 1, trimmed(KERNEL1, kernel)), (row.session, 1, flat(KERNEL2, kernel[3]))]
    return table, curves_table(rows)


def test_components_of_kernels_tell_groups_and_their_scores_are_compared():
    table, curves = kernel_study()
    remarks = []
    components = kernel_components(table, NO_SAMPLES, curves, remarks)
    assert not remarks
    first, second = components
    assert first.curve == KERNEL1
    assert first.shares[0] > 0.98
    assert first.scores["score_1"].std(ddof=1) == pytest.approx(1.0)
    kernels = np.stack([v for name, v in zip(curves["curve"], curves["value"], strict=True) if name == KERNEL1])
    assert first.mean == pytest.approx(kernels.mean(axis=0), rel=1e-5)
    rebuilt = first.mean + first.scores[first.names].to_numpy() @ first.shapes
    assert rebuilt == pytest.approx(kernels, abs=1e-4)
    assert len(second.names) == 1  # flat kernels differ in one way only
    rows = component_table(components)
    assert rows["kernel"].tolist() == [KERNEL1] * len(first.names) + [KERNEL2]
    score = first.scores
    groups = [score.loc[score["group"] == site, "score_1"] for site in ("arm", "leg")]
    assert rows["statistic"].iloc[0] == pytest.approx(stats.f_oneway(*groups).statistic)
    assert rows["p_value"].iloc[0] < 1e-6
    means = score_table(components).set_index(["kernel", "level"])
    assert means.loc[(KERNEL1, "arm"), "score_1"] == pytest.approx(groups[0].mean())
    assert {str(curve.name) for curve in scores_plot(first).curves} == {"arm", "leg"}


def test_subjects_are_also_compared_without_the_materials():
    table, curves = kernel_study()
    samples = made_tests([("S", "gel", "", "gel"), ("S", "gel", "", "gel")]).assign(session=["g0.h5", "g1.h5"])
    more = curves_table(
        (session, 1, trimmed(KERNEL1, value * np.ones(40))) for session, value in (("g0.h5", 9.0), ("g1.h5", 9.1))
    )
    first, *_others = kernel_components(table, samples, pd.concat([curves, more]), [])
    rows = component_table([first]).set_index(["component", "among"])
    assert rows.loc[(1, "all"), ["groups", "means"]].tolist() == [3, 10]  # each test of a material counts
    assert rows.loc[(1, "subjects"), ["groups", "means"]].tolist() == [2, 8]
    people = first.scores[~first.scores["sample"]]
    groups = [people.loc[people["group"] == site, "score_1"] for site in ("arm", "leg")]
    assert rows.loc[(1, "subjects"), "statistic"] == pytest.approx(stats.f_oneway(*groups).statistic)


def test_too_few_kernels_are_stated():
    table, curves = kernel_study(2)
    remarks = []
    assert kernel_components(table, NO_SAMPLES, curves, remarks) == ()
    assert [remark.code for remark in remarks] == ["study.few_for_components"]


def test_the_report_has_the_figures_and_tables():
    table, curves = kernel_study()
    found = study_statistics(table.assign(k=np.arange(8.0), k_sd=1.0).drop(columns="material"), curves)
    keys = [key for key, _heading, _plots in study_plots(found)]
    assert keys[-5:] == ["kernel-site", "second-site", "components1-all", "scores-1", "components2-all"]
    captions = {one.caption for one in tables_of(found)}
    assert {"Principal components of the Volterra kernels", "Scores of the principal components"} <= captions
    page = study_html("s", "volterra", found, {})
    assert "leg, VAF" in page
    assert len(found.as_answer()["curves"]) == 4


def test_the_file_of_the_curves_has_abscissas_and_can_be_read_again(tmp_path):
    table = made_tests([("A", "arm", "", None), ("B", "arm", "", None)])
    curves = pd.concat(
        [curves_for(table, STIFFNESS, [1.0, 2.0], first=7, count=3), curves_for(table, KERNEL2, [3.0, 4.0])]
    )
    write_curves(curves, tmp_path / "curves.parquet")
    whole = pq.read_table(tmp_path / "curves.parquet").to_pandas()
    assert whole.columns.tolist() == ["session", "test", "curve", "direction", "first", "x", "y", "value"]
    assert whole["x"][0] == pytest.approx(GRIDS[STIFFNESS].x[7:10], rel=1e-6)
    assert whole["y"][0] is None
    assert len(whole["x"][2]) == len(whole["y"][2]) == len(whole["value"][2]) == 300
    again = read_curves(tmp_path / "curves.parquet")
    assert again["value"][1] == pytest.approx([2.0] * 3)
    assert again["first"].tolist() == [7, 7, 0, 0]
    assert read_curves(tmp_path / "missing.parquet").empty
