"""A study stores sampled curves of each test, and its report shows their means by group."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from reports.synthetic_sitting import make_session, make_test

from tissueid.analysis.curves.samples import GRIDS, KERNEL1, KERNEL2, PARTITIONS, STIFFNESS
from tissueid.procedures.control import Control
from tissueid.procedures.study_plans import CURVES_FILE, RESULTS, StudyPlan, StudyReportPlan
from tissueid.procedures.study_run import report_study, run_study
from tissueid.reports import study_page
from tissueid.sessions import Subject, write_session
from tissueid.studies import multivariate, repeatability
from tissueid.studies.curve_groups import chosen, curves_of


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    monkeypatch.setattr(study_page, "MOST_DRAWN", 1)
    monkeypatch.setattr(study_page, "MOST_COMPARED", 1)
    monkeypatch.setattr(repeatability, "RESAMPLES", 20)
    monkeypatch.setattr(multivariate, "PERMUTATIONS", 3)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A study of two subjects at two sites, one of them twice at the arm, and once more with a cream."""
    path = tmp_path_factory.mktemp("curves")
    for who, site, condition in (
        ("A", "arm", ""), ("A", "leg", ""), ("B", "arm", ""), ("B", "leg", ""), ("A", "arm", "cream"),
    ):  # fmt: skip
        tests = []
        for number in (1, 2) if (who, site, condition) == ("A", "arm", "") else (1,):
            test = make_test(number, seconds=1.5, seed=number)
            scale = {"arm": 1.0, "leg": 1.2}[site] * (1.1 if who == "B" else 1.0) * (0.9 if condition else 1.0)
            depth = (test.signals["position"] - test.surface_position_m) / scale
            signals = test.signals | {"position": test.surface_position_m + depth}
            tests.append(replace(test, site=site, signals=signals, notes={"condition": condition} if condition else {}))
        session = replace(make_session(*tests), subject=Subject(who), session_id=f"{who}-{site}-{condition}")
        write_session(path / f"{who}-{site}{condition}.h5", session)
    return path


def reported(folder, engine, **plan):
    return report_study(StudyReportPlan(folder=folder, engine=engine, workers=1, **plan), Control())


def test_kernels_of_a_study(folder):
    options = ("memory=0.03",)
    found = reported(folder, "volterra", options=options)
    curves = found.run.curves
    assert curves.groupby("curve").size()[KERNEL2] == 6
    arm = next(one for one in chosen(found.statistics.curves, "site", KERNEL1) if one.group == "arm")
    of_arm = {who: curves[(curves["session"] == f"{who}-arm.h5") & (curves["curve"] == KERNEL1)] for who in "AB"}
    means = [np.mean([one.on_grid for one in curves_of(rows)], axis=0) for rows in of_arm.values()]
    assert arm.mean[:12] == pytest.approx(np.mean(means, axis=0)[:12])  # the lags of some tests end earlier
    assert arm.count == 2
    tables = found.statistics.tables
    assert tables["kernel_components"]["share"].between(0.0, 1.0).all()
    assert set(tables["kernel_scores"]["level"]) == {"arm", "leg", "arm; cream"}
    page = found.page.read_text(encoding="utf-8")
    assert "Second-order kernels: sites" in page
    assert "Principal components, first-order kernel" in page
    assert "without, VAF" in page
    again = run_study(StudyPlan(folder=folder, engine="volterra", workers=1, options=options), Control())
    assert again.analysed == 0
    kept = [(one.name, one.first) for one in curves_of(again.curves)]
    assert kept == [(one.name, one.first) for one in curves_of(curves)]
    for new, old in zip(again.curves["value"], curves["value"], strict=True):
        assert np.array_equal(new, old, equal_nan=True)


def test_parameters_by_depth_and_the_files(folder, tmp_path):
    found = reported(folder, "depth", options=("partitions=3", "memory=0.03"), pdf=tmp_path / "report.pdf")
    stiffness = chosen(found.statistics.curves, "site", STIFFNESS)
    assert [one.group for one in stiffness] == ["arm", "leg"]
    (change,) = chosen(found.statistics.curves, "change", STIFFNESS)
    assert (change.group, change.count) == ("cream", 1)
    assert (tmp_path / "report.pdf").stat().st_size > 10_000
    page = found.page.read_text(encoding="utf-8")
    assert "Mass, damping and stiffness against depth: sites" in page
    assert "Kernels by depth: sites" in page
    written = pd.read_parquet(folder / RESULTS / CURVES_FILE)
    assert written.columns.tolist() == ["session", "test", "curve", "direction", "first", "x", "y", "value"]
    row = written[written["curve"] == STIFFNESS].iloc[0]
    table = pd.read_parquet(folder / RESULTS / "table.parquet")
    assert {row["session"], row["test"]} <= set(table["session"]) | set(table["test"])
    assert row["x"] == pytest.approx(GRIDS[STIFFNESS].x[row["first"] : row["first"] + len(row["value"])], rel=1e-5)
    answer = json.loads(json.dumps(found.as_answer()))
    names = {one["curve"] for one in answer["curves"]}
    assert {STIFFNESS, PARTITIONS} <= names
    shown = next(one for one in answer["curves"] if one["curve"] == PARTITIONS)
    assert len(shown["lag_s"]) == len(shown["depth_m"]) == len(shown["mean"])
    of_group = found.run.table.query("site == 'arm' and condition == ''")
    kernels = next(one for one in chosen(found.statistics.curves, "site", PARTITIONS) if one.group == "arm")
    assert kernels.vaf_percent == pytest.approx(of_group["vaf_scheduled_percent"].mean())
    assert of_group["vaf_scheduled_percent"].between(99.0, 100.0).all()


def test_a_damaged_curve_is_sampled_again(folder):
    plan = StudyPlan(folder=folder, engine="lms", workers=1)
    run_study(plan, Control())
    stored = next((folder / RESULTS).glob("lms-*/*.json"))
    content = json.loads(stored.read_text())
    content["curves"][0][1][0] = "another"
    stored.write_text(json.dumps(content))
    found = run_study(plan, Control())
    assert found.analysed == 1
    assert set(found.curves["curve"]) == {"magnitude_m_per_n", "phase_deg"}
