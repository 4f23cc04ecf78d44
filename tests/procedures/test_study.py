"""A folder of sessions becomes a table, statistics and a report; what cannot be used is stated and nothing is lost."""

import csv
import functools
import json
import os
import shutil
import zipfile
from dataclasses import replace
from importlib import util

import numpy as np
import pandas as pd
import pytest
from coded import coded
from reports.synthetic_sitting import make_session, make_test

from tissueid.app.views.studies.study_data import load_study
from tissueid.cli import main
from tissueid.errors import CancelledError, UnusableInputError
from tissueid.procedures import study_demo
from tissueid.procedures.control import Control
from tissueid.procedures.study_demo import (
    MATERIALS,
    PopulationPlan,
    Series,
    measure_series,
    population,
    run_population,
    sample_name,
    subjects_file,
)
from tissueid.procedures.study_plans import NOT_ANALYSED_FILE, RESULTS, SUBJECTS_FILE, StudyPlan, StudyReportPlan
from tissueid.procedures.study_run import report_study, run_study
from tissueid.procedures.test_run import TestControl
from tissueid.reports import study_page
from tissueid.reports.study_page import study_html, write_study_pdf
from tissueid.sessions import Subject, write_session
from tissueid.studies import multivariate, repeatability
from tissueid.studies.study_statistics import study_statistics
from tissueid.studies.study_table import parameters_of, read_subjects, study_table


def quicken(monkeypatch):
    # Figures, resamples and permutations take most of the time.
    monkeypatch.setattr(study_page, "MOST_DRAWN", 1)
    monkeypatch.setattr(study_page, "MOST_COMPARED", 1)
    monkeypatch.setattr(repeatability, "RESAMPLES", 20)
    monkeypatch.setattr(multivariate, "PERMUTATIONS", 3)


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    quicken(monkeypatch)


SUBJECTS, SITES, REPEATS = 4, ("arm", "leg"), 2


@functools.cache
def recorded(who, number):
    return make_test(number, seconds=1.0, seed=10 * who + number)


def write(path, who, repeats, softer, **values):
    """Write a session; a position is divided by its stiffness, which rises with the subject and from test to test."""
    tests = []
    for number in range(1, repeats + 1):
        test = recorded(who, number)
        position = test.signals["position"] / softer(0.05 * who, 0.005 * number)
        tests.append(replace(test, signals=test.signals | {"position": position}, **values))
    write_session(path, replace(make_session(*tests), subject=Subject(f"P-{who}"), session_id=path.stem))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """One session per subject and site; the leg is stiffer."""
    path = tmp_path_factory.mktemp("study") / "study"
    path.mkdir()
    for who in range(SUBJECTS):
        for place, site in enumerate(SITES):
            stiffer = functools.partial(lambda rise, own, later: 1.0 + rise + own + later, 0.1 * place)
            write(path / f"P{who}-{site}.h5", who, REPEATS, stiffer, site=site)
    lines = [f"P-{who},{20 + who},{60 + 5 * who},1.7,{'female' if who % 2 else 'male'}" for who in range(SUBJECTS)]
    (path / SUBJECTS_FILE).write_text("\n".join(["subject,age_years,weight_kg,height_m,gender", *lines]))
    return path


def copy_sessions(folder, target, subjects=SUBJECTS):
    target.mkdir(exist_ok=True)
    for who in range(subjects):
        for path in folder.glob(f"P{who}-*.h5"):
            shutil.copy2(path, target)


@pytest.fixture
def fill(folder, run):
    """A function that copies the sessions of the first subjects, with their results, which stay valid."""

    def copied(target, subjects=SUBJECTS, results=True):
        copy_sessions(folder, target, subjects)
        if results:
            shutil.copytree(folder / RESULTS, target / RESULTS)

    return copied


def apply_lotion(folder, subjects, repeats=1):
    """Write a second session per subject at the arm, under a lotion that softens the skin by a tenth."""
    for who in range(subjects):
        path = folder / f"P{who}-lotion.h5"
        write(path, who, repeats, lambda own, _later: 0.9 * (1.0 + own), site="arm", notes={"condition": "lotion"})


def plan_of(folder, **values):
    return StudyPlan(folder=folder, engine="lms", workers=1, **values)


@pytest.fixture(scope="module")
def run(folder):
    return run_study(plan_of(folder), Control())


def test_the_table_has_a_row_per_test(run, folder):
    table = run.table
    assert len(table) == SUBJECTS * len(SITES) * REPEATS
    assert run.analysed == run.sessions == SUBJECTS * len(SITES)
    assert sorted(table["repeat"].unique()) == [1, 2]
    assert table["bmi_kg_per_m2"].iloc[0] == pytest.approx(60 / 1.7**2)
    assert {"mass_kg", "stiffness_n_per_m"} <= set(parameters_of(table))
    assert (table["stiffness_n_per_m_sd"] > 0.0).all()
    for suffix, read_file in (("csv", pd.read_csv), ("parquet", pd.read_parquet)):
        read = read_file(folder / RESULTS / f"table.{suffix}")
        assert read["stiffness_n_per_m"].to_numpy() == pytest.approx(table["stiffness_n_per_m"].to_numpy())


def test_what_has_not_changed_is_not_analysed_again(run, folder):
    assert run_study(plan_of(folder), Control()).analysed == 0
    changed = folder / "P0-arm.h5"
    content = changed.read_bytes()
    changed.write_bytes(b"rubbish" * 99)
    found = run_study(plan_of(folder), Control())
    assert found.analysed == 1
    assert found.failures == {"P0-arm.h5": "is damaged, or not an HDF5 session"}
    written = pd.read_csv(folder / RESULTS / NOT_ANALYSED_FILE)
    assert written[["session", "reason"]].to_numpy().tolist() == [list(item) for item in found.failures.items()]
    assert len(found.table) == len(run.table) - REPEATS
    changed.write_bytes(content)
    again = run_study(plan_of(folder), Control())
    assert again.analysed == 1
    assert not again.failures
    pd.testing.assert_frame_equal(again.table, run.table)


def test_damaged_results_are_computed_again(tmp_path):
    folder = tmp_path / "s"
    folder.mkdir()
    for site in SITES:
        write(folder / f"P0-{site}.h5", 0, 1, lambda own, _later: 1.0 + own, site=site)
    run_study(plan_of(folder), Control())
    stored = next((folder / RESULTS).glob("lms-*/*.json"))
    whole = json.loads(stored.read_text())
    row, curve = whole["rows"][0], whole["curves"][0]
    damaged = [
        *("", "{", "[]", "null", "5", "[" * 100_000, '{"rows":' + "[" * 100_000),
        {"rows": 5},
        {"rows": []},
        {"rows": [5]},
        {"rows": [{}]},
        {"failed": 5},
        {"failed": []},
        *({"rows": [row | changed]} for changed in ({"created": 5}, {"site": []}, {"test": "one"}, {"mass_kg": [1.0]})),
        *({"rows": [row | {"test": number}]} for number in (-1, 10**30, 1.5)),
        *(
            whole | {"curves": other}
            for other in (5, [5], [[1]], [[1, []]], [[1, ["none", 0, 0, []]]], [["1", curve[1]]])
        ),
        *(whole | {"curves": [[1, [curve[1][0], 0, 0, other]]]} for other in ("text", [[1.0]], [1e300], [10**400], 5)),
        *(whole | {"curves": [[1, [curve[1][0], 0, first, [1.0]]]]} for first in (-1, 10**6, 0.5, "0")),
    ]
    odd = ({"mass_kg": "heavy"}, {"mass_kg": 1e300}, {"vaf_percent": float("nan")}, {"gender": 5})
    usable = [whole | {"rows": [item | values for item in whole["rows"]]} for values in odd]
    for number in range(len(damaged) + len(usable) - 1):
        (folder / f"{number}.h5").write_bytes((folder / "P0-arm.h5").read_bytes())
    (folder / "P0-leg.h5").unlink()
    known = run_study(plan_of(folder), Control())
    for path, content in zip((folder / RESULTS).glob("lms-*/*.json"), damaged + usable, strict=True):
        path.write_text(content if isinstance(content, str) else json.dumps(content))
    run = report_study(StudyReportPlan(folder=folder, engine="lms", workers=1), Control()).run
    assert run.analysed == len(damaged)
    assert len(run.table) == len(known.table)
    assert run.table["mass_kg"].max() < 1.0


HOSTILE = (
    ({}, {}),
    ({"coupling": 3.0, "orientation_deg": "abc", "condition": 5.0, "minutes_since_application": "x"}, {"gender": "m"}),
    ({}, {"age_years": "old", "status": "x", "mass_kg": "a", "mass_kg_sd": "b", "height_m": float("inf"), "x": "=1+1"}),
    ({"orientation_deg": 1e308}, {"age_years": 30.0, "gender": 3.0, "height_m": 0.0, "weight_kg": 1e308, "x": -1.0}),
)


def test_any_notes_and_demographic_values_of_sessions_make_a_table(tmp_path):
    for who, (notes, values) in enumerate(HOSTILE):
        test = replace(make_test(1, seconds=0.5, seed=who), site="=HYPERLINK(1)", notes=notes)
        made = replace(make_session(test), subject=Subject(f"P-{who}", values), session_id="@SUM(1)")
        write_session(tmp_path / (f"-{who}.h5" if who else "\udce9.h5"), made)
    plan = StudyReportPlan(folder=tmp_path, engine="lms", workers=1, pdf=tmp_path / "report.pdf")
    run = report_study(plan, Control()).run
    table = run.table.set_index("subject")
    assert sorted(table["session"]) == ["-1.h5", "-2.h5", "-3.h5", "\\xe9.h5"]
    assert (table["status"] == "completed").all()
    assert (table["mass_kg"] > 0.0).all()
    assert np.isfinite(table.select_dtypes("number").fillna(0.0)).all(axis=None)
    assert table.loc["P-2", ["age_years", "height_m"]].isna().all()
    assert list(table["gender"].dropna()) == ["m", "3.0"]
    lines = (tmp_path / RESULTS / "table.csv").read_text(encoding="utf-8").splitlines()
    cells = [cell for line in csv.reader(lines) for cell in line]
    assert {"'=HYPERLINK(1)", "'@SUM(1)", "'-1.h5", "'=1+1", "-1.0"} <= set(cells)
    assert {row.session for row in load_study(tmp_path).rows} == set(table["session"])
    assert load_study(tmp_path).without_row == 0
    assert run_study(plan_of(tmp_path), Control()).analysed == 0


@pytest.mark.parametrize("column", ["status", "site", "mass_kg", "x_sd"])
def test_a_file_of_subjects_does_not_replace_what_was_measured(run, column):
    with pytest.raises(UnusableInputError, check=coded("study.subjects_taken", name=column)):
        study_table(run.table.to_dict("records"), pd.DataFrame({"subject": ["P-0"], column: [1.0]}))


@pytest.mark.parametrize(
    "address",
    [
        *("zip:///FILE", "zip://::/FILE", "tar://::/FILE", "file:///FILE", "memory://nothing", "none://x", "://"),
        *("reference://::/FILE", "dask://", "generic://", "jupyter://127.0.0.1:1/", "dir://x", "dbfs://x/y"),
    ],
)
def test_addresses_that_cannot_be_read_are_one_line(tmp_path, capsys, address):
    pytest.importorskip("fsspec")
    (tmp_path / "file").write_bytes(b"rubbish")
    address = address.replace("/FILE", str(tmp_path / "file"))
    assert main(["study", "run", str(tmp_path / "study"), "--sessions", address, "--engine", "lms"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("tissueid: ")
    assert not (tmp_path / "study").exists()


def test_sessions_of_an_archive_are_read_and_a_member_that_unpacks_to_more_is_refused(tmp_path, folder, run):
    pytest.importorskip("fsspec")
    archive = tmp_path / "sessions.zip"
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as packed:
        packed.write(folder / "P0-arm.h5", "sub/P0-arm.h5")
        packed.writestr("text.h5", b"rubbish")
        with packed.open("bomb.h5", "w") as member:
            member.write((folder / "P0-arm.h5").read_bytes())
            for _ in range(101):
                member.write(bytes(1_000_000))
    content = archive.read_bytes()
    found = run_study(plan_of(tmp_path / "study", sessions=f"zip://::{archive}"), Control())
    assert found.failures["bomb.h5"].startswith("has ")
    assert found.failures["text.h5"] == "is not an HDF5 session"
    assert set(found.table["session"]) == {"sub/P0-arm.h5"}
    assert archive.read_bytes() == content


def test_other_options_are_another_analysis(run, folder):
    assert run_study(plan_of(folder, options=("memory=0.05",)), Control()).analysed == run.sessions
    assert run_study(plan_of(folder), Control()).analysed == 0


def test_a_cancelled_run_keeps_what_is_done(tmp_path, fill):
    fill(tmp_path / "s", subjects=2, results=False)

    class Impatient(Control):
        def __init__(self):
            self.looks = 0

        def cancelled(self):
            self.looks += 1
            return self.looks > 2

    with pytest.raises(CancelledError):
        run_study(plan_of(tmp_path / "s"), Impatient())
    assert len(list((tmp_path / "s" / RESULTS).glob("lms-*/*.json"))) == 2
    assert run_study(plan_of(tmp_path / "s"), Control()).analysed == 2


@pytest.fixture(scope="module")
def reported(folder):
    with pytest.MonkeyPatch.context() as patch:
        quicken(patch)
        return report_study(StudyReportPlan(folder=folder, engine="lms", workers=1), Control())


def test_the_report_has_the_statistics(reported):
    found = reported
    page = found.page.read_text(encoding="utf-8")
    assert page.startswith("<!DOCTYPE html")
    assert "Research use only" in page
    tables = found.statistics.tables
    assert set(tables) >= {"variation", "reliability", "first_test", "sites", "groups", "regressions"}
    sites = tables["sites"].set_index("parameter").loc["stiffness_n_per_m"]
    assert (sites["reference"], sites["level"]) == ("arm", "leg")
    assert sites["difference"] > 0.0
    assert sites["p_value"] < 0.01


PARAMETER_KEYS = {"cv_individual", "cv_population", "icc", "minimal_detectable_change"}
COMPARISON_KEYS = {"kind", "parameter", "groups", "estimate", "ci", "effect_size", "p", "p_corrected", "test", "n"}


def test_the_json_of_a_study_has_the_keys_that_scripts_rely_on(reported, folder, run, capsys):
    """The commands ``run`` and ``table`` print the same statistics as the report, by one function."""
    assert main(["study", "table", str(folder), "--engine", "lms", "--workers", "1", "--json", "-"]) == 0
    printed, answer = json.loads(capsys.readouterr().out), json.loads(json.dumps(reported.as_answer()))
    assert {row["site"] for row in printed.pop("rows")} == set(SITES)
    assert printed | {"curves": [], "subgroup": []} == answer | {"curves": [], "statistics": printed["statistics"]}
    assert (answer["tests"], answer["subjects"]) == (len(run.table), SUBJECTS)
    assert answer["statistics"]["variation"][0]["site"] == "arm"
    found = reported.statistics.tables
    assert len(answer["parameters"]) > 3
    for name, values in answer["parameters"].items():
        assert set(values) == PARAMETER_KEYS
        expected = found["variation"].set_index("parameter").loc[name, "individual_cv"].mean()
        assert values["cv_individual"] == pytest.approx(expected)
    assert 0.0 < answer["parameters"]["stiffness_n_per_m"]["icc"] <= 1.0
    assert all(set(one) >= COMPARISON_KEYS for one in answer["comparisons"])
    assert {one["kind"] for one in answer["comparisons"]} == {"first_test", "site", "group", "regression"}
    (sites,) = (
        one for one in answer["comparisons"] if (one["kind"], one["parameter"]) == ("site", "stiffness_n_per_m")
    )
    row = found["sites"].set_index("parameter").loc["stiffness_n_per_m"]
    assert (sites["groups"], sites["test"], sites["n"]) == (["arm", "leg"], "mixed_model", SUBJECTS)
    assert sites["ci"] == pytest.approx([row["low"], row["high"]])
    assert sites["ci"][0] < sites["estimate"] < sites["ci"][1]
    gender = [one for one in answer["comparisons"] if (one["kind"], one["factor"]) == ("group", "gender")]
    assert all(one["groups"] == ["female", "male"] and 0.0 <= one["p"] <= one["p_corrected"] for one in gender)
    assert len(answer["warnings"]) == len(answer["warning_messages"])
    assert all(set(message) >= {"code", "values"} for message in answer["warning_messages"])


def test_a_report_on_paper_of_a_study_without_a_parameter_that_counts(run, tmp_path):
    few = study_statistics(run.table[run.table["subject"] == "P-0"].groupby("site").head(1))
    write_study_pdf(tmp_path / "report.pdf", "few", "lms", replace(few, parameters=()), {})
    assert (tmp_path / "report.pdf").read_bytes().startswith(b"%PDF")


def test_a_subgroup_of_the_subjects_is_reported(folder, run, tmp_path):
    plan = StudyReportPlan(folder=folder, engine="lms", workers=1, report=tmp_path / "a.html")
    found = report_study(plan.model_copy(update={"only": ("gender=female", "age_years=20:22")}), Control())
    assert set(found.run.table["subject"]) == {"P-1"}
    assert found.statistics.as_answer()["subjects"] == 1
    assert "age_years=20:22" in found.page.read_text(encoding="utf-8")
    assert found.as_answer()["subgroup"] == ("gender=female", "age_years=20:22")
    at_leg = report_study(plan.model_copy(update={"only": ("gender=male", "site=leg")}), Control())
    assert set(at_leg.run.table["site"]) == {"leg"}
    tables = [rows for rows in at_leg.statistics.tables.values() if "site" in rows and len(rows)]
    assert tables
    assert all(set(rows["site"]) == {"leg"} for rows in tables)
    assert at_leg.statistics.as_answer()["subjects"] == SUBJECTS / 2
    for condition, code in (
        ("gender", "study.subgroup"),
        ("shoe=38", "study.subgroup"),
        ("gender=none", "study.empty_subgroup"),
        ("age_years=90:99", "study.empty_subgroup"),
    ):
        with pytest.raises(UnusableInputError, check=coded(code)):
            report_study(plan.model_copy(update={"only": (condition,)}), Control())


def test_a_condition_is_compared_within_subjects(tmp_path, fill):
    fill(tmp_path / "s")
    apply_lotion(tmp_path / "s", SUBJECTS)
    plan = StudyReportPlan(folder=tmp_path / "s", engine="lms", workers=1, after="lotion", margin=0.5)
    found = report_study(plan, Control()).statistics
    row = found.tables["efficacy"].set_index("parameter").loc["stiffness_n_per_m"]
    assert row["subjects"] == SUBJECTS
    assert row["difference"] < 0.0
    assert row["p_value"] < 0.01
    assert row["equivalence_p_value"] < 0.05
    assert found.tables["variation"].set_index("site").loc["arm", "tests"].iloc[0] == SUBJECTS * REPEATS


def test_the_table_of_the_shell_has_each_condition_apart(tmp_path, fill, capsys):
    fill(tmp_path / "s", subjects=2)
    apply_lotion(tmp_path / "s", 2, repeats=2)
    assert main(["study", "table", str(tmp_path / "s"), "--engine", "lms", "--workers", "1", "--json", "-"]) == 0
    printed = capsys.readouterr()
    rows = json.loads(printed.out)["rows"]
    tests = {(row["site"], row["condition"]): row["tests"] for row in rows}
    assert tests == {("arm", ""): 4, ("leg", ""): 4, ("arm", "lotion"): 4}
    assert "lotion" in printed.err  # what people read


@pytest.mark.parametrize(
    ("content", "code"),
    [
        (b"name,age\nA,1\n", "study.subjects_column"),
        (b"subject,age\nA,1\nA,2\n", "study.subjects_twice"),
        (b"subject,age\n,1\n", "study.subjects_twice"),
        (b"\xff\xfe\x00", "study.subjects_unreadable"),
        (b"", "study.subjects_unreadable"),
    ],
)
def test_a_file_of_subjects_that_cannot_be_used(tmp_path, content, code):
    (tmp_path / SUBJECTS_FILE).write_bytes(content)
    with pytest.raises(UnusableInputError, check=coded(code)):
        read_subjects(tmp_path / SUBJECTS_FILE)


def test_folders_that_cannot_be_used(tmp_path):
    with pytest.raises(UnusableInputError, check=coded("file.no_folder")):
        run_study(plan_of(tmp_path / "none"), Control())
    with pytest.raises(UnusableInputError, check=coded("study.no_sessions")):
        run_study(plan_of(tmp_path), Control())
    (tmp_path / "a.h5").write_bytes(b"rubbish")
    with pytest.raises(UnusableInputError, check=coded("study.nothing")):
        run_study(plan_of(tmp_path), Control())


def test_from_the_shell(folder, run, capsys):
    assert main(["study", "run", str(folder), "--engine", "lms", "--workers", "1"]) == 0
    assert f"{len(run.table)} tests of {run.sessions} sessions, 0 analysed now" in capsys.readouterr().out
    assert main(["study", "run", str(folder), "--engine", "none"]) == 2
    assert capsys.readouterr().err.startswith("tissueid: ")


def test_missing_demographics_and_one_group_are_stated(tmp_path, fill):
    fill(tmp_path / "s", subjects=3)
    apply_lotion(tmp_path / "s", subjects=1)
    (tmp_path / "s" / SUBJECTS_FILE).write_text("subject,gender,age_years,shoe\nP-0,female,30,\nP-1,female,,\n")
    plan = StudyReportPlan(folder=tmp_path / "s", engine="lms", workers=1, factors=("gender", "shoe"), after="lotion")
    found = report_study(plan, Control())
    codes = {remark.code for remark in found.statistics.remarks}
    assert codes >= {"study.one_group", "study.no_column", "study.too_few_values", "study.no_pairs"}
    assert not found.statistics.tables.get("groups", pd.DataFrame()).size
    assert np.isfinite(found.statistics.tables["variation"]["individual_cv"]).all()


@pytest.mark.parametrize(
    ("option", "code", "known"),
    [
        (("--factor", "shoe"), "study.unknown_column", "gender"),
        (("--regress", "shoe"), "study.unknown_column", "age_years"),
        (("--after", "cream"), "study.unknown_condition", ""),
        (("--before", "cream"), "study.unknown_condition", ""),
    ],
)
def test_an_unknown_column_or_condition_is_refused_with_the_known_ones(folder, run, capsys, option, code, known):
    before = {path: path.stat().st_mtime_ns for path in (folder / RESULTS).glob("report.html")}
    assert main(["study", "report", str(folder), "--engine", "lms", "--workers", "1", *option]) == 2
    said = capsys.readouterr().err
    assert option[1] in said
    assert known in said
    assert len(said.splitlines()) == 1
    assert {path: path.stat().st_mtime_ns for path in (folder / RESULTS).glob("report.html")} == before
    plan = {"--factor": "factors", "--regress": "regressors", "--after": "after", "--before": "before"}[option[0]]
    value = (option[1],) if plan in ("factors", "regressors") else option[1]
    with pytest.raises(UnusableInputError, check=coded(code)):
        report_study(StudyReportPlan(folder=folder, engine="lms", workers=1, **{plan: value}), Control())


def test_sessions_by_an_address_of_fsspec(folder, run, tmp_path):
    fsspec = pytest.importorskip("fsspec")
    files = fsspec.filesystem("memory")
    for path in folder.glob("*.h5"):
        files.put_file(str(path), f"/store/{path.name}")
    plan = plan_of(tmp_path / "here", sessions="memory://store")
    found = run_study(plan, Control())
    assert found.analysed == run.sessions
    assert found.table["stiffness_n_per_m"].tolist() == run.table["stiffness_n_per_m"].tolist()
    assert run_study(plan, Control()).analysed == 0
    files.pipe_file("/store/P0-arm.h5", b"rubbish" * 99)
    again = run_study(plan, Control())
    assert (again.analysed, list(again.failures)) == (1, ["P0-arm.h5"])
    assert not [name for name in files.find("/store") if name.endswith(".partial")]


def test_addresses_that_cannot_be_used(tmp_path, monkeypatch):
    pytest.importorskip("fsspec")
    for url in ("memory://nothing", "nonsense://a"):
        with pytest.raises(UnusableInputError, check=coded("study.no_address")):
            run_study(plan_of(tmp_path / "s", sessions=url), Control())
    monkeypatch.setattr(util, "find_spec", lambda name: None if name == "fsspec" else True)
    with pytest.raises(UnusableInputError, check=coded("extra.missing")) as caught:
        run_study(plan_of(tmp_path / "s", sessions="memory://nothing"), Control())
    assert "tissueid[cluster]" in str(caught.value)


def test_the_simulated_population_has_its_effects_and_one_stimulus(tmp_path):
    people = population(16, 0)
    assert {person.gender for person in people} == {"male", "female"}
    person = next(person for person in people if person.gender == "male")
    heavy, plain = (person.tissue(site) for site in ("left anterior forearm", "left posterior forearm"))
    assert heavy.tissue.mass_kg / plain.tissue.mass_kg == pytest.approx(person.mass_factor("left anterior forearm"))
    treated = person.tissue("left anterior forearm", "moisturising lotion")
    assert treated.tissue.stiffness_n_per_m == pytest.approx(0.9 * heavy.tissue.stiffness_n_per_m)
    path = tmp_path / SUBJECTS_FILE
    path.write_text(subjects_file(people, MATERIALS))
    read = read_subjects(path).set_index("subject")
    assert read["material"].dropna().tolist() == list(MATERIALS)
    assert read.loc[person.pseudonym, "gender"] == "male"


def test_an_interrupted_population_continues_in_its_own_folder(tmp_path, monkeypatch):
    planned = []
    monkeypatch.setattr(study_demo, "report_study", lambda plan, _control: planned.append(plan))
    monkeypatch.setattr(study_demo, "SITES", dict(list(study_demo.SITES.items())[:2]))
    plan = PopulationPlan(out=tmp_path / "p", subjects=2, repeats=2, seconds=1.0, products=False, workers=1)

    class Impatient(Control):
        looks = 0

        def cancelled(self):
            self.looks += 1
            return self.looks > 3

    with pytest.raises(CancelledError):
        run_population(plan, Impatient())
    first = {path: path.stat().st_mtime_ns for path in plan.out.glob("*.h5")}
    assert len(first) == 3
    assert not planned
    with pytest.raises(UnusableInputError, check=coded("study.other_population")):
        run_population(plan.model_copy(update={"seed": 1}), Control())
    missing = plan.out / "P-002 right anterior forearm.h5"
    missing.with_name(missing.name + ".journal").write_bytes(b"of a process that was ended")
    run_population(plan, Control())
    assert len(list(plan.out.glob("*.h5"))) == 4
    assert missing.is_file()
    assert not list(plan.out.glob("*.journal"))
    assert {path: path.stat().st_mtime_ns for path in first} == first
    table = run_study(planned[0], Control()).table
    assert table["scaled_mass_s2"].to_numpy() == pytest.approx(
        (table["mass_kg"] / table["stiffness_n_per_m"]).to_numpy(), rel=1e-6
    )


def test_other_folders_are_no_population(tmp_path):
    for content in ("{", "[]", '{"made_by": "somebody"}'):
        (tmp_path / "population.json").write_text(content)
        with pytest.raises(UnusableInputError, check=coded("study.folder_used")):
            run_population(PopulationPlan(out=tmp_path), Control())
        assert [path.name for path in tmp_path.iterdir()] == ["population.json"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes with names")
def test_marks_of_an_earlier_run_that_never_end_are_not_read(tmp_path, capsys):
    for command, name in (("study demo", "population.json"), ("demo", "results.json"), ("reproduce", "results.json")):
        folder = tmp_path / command
        folder.mkdir()
        os.mkfifo(folder / name)
        assert main([*command.split(), "--out", str(folder)]) == 2
        assert len(capsys.readouterr().err.splitlines()) == 1
        (folder / name).unlink()
        (folder / name).write_text("[" * 100_000)
        assert main([*command.split(), "--out", str(folder)]) == 2
        assert len(capsys.readouterr().err.splitlines()) == 1


def test_an_interrupted_series_leaves_no_session(tmp_path, monkeypatch):
    plan = PopulationPlan(out=tmp_path, subjects=2, repeats=2, seconds=1.0, workers=1)
    calls = []

    def interrupted(_control):
        calls.append(1)
        if len(calls) > 600:
            raise KeyboardInterrupt

    monkeypatch.setattr(TestControl, "check", interrupted)
    with pytest.raises(KeyboardInterrupt):
        measure_series(plan, Series(sample_name("latex"), "latex", 1))
    assert not list(tmp_path.iterdir())


def test_a_material_is_measured_and_reported(tmp_path, monkeypatch):
    monkeypatch.setattr(study_demo, "MATERIAL_TESTS", 3)
    plan = PopulationPlan(out=tmp_path, subjects=2, seconds=1.0, workers=1)
    for name in ("acrylamide 10 %", "acrylamide 30 %"):
        measure_series(plan, Series(sample_name(name), name, 1))
    (tmp_path / SUBJECTS_FILE).write_text(subjects_file((), MATERIALS))
    found = study_statistics(run_study(plan_of(tmp_path), Control()).table)
    rows = found.tables["materials"].set_index(["parameter", "level"])["mean"]
    assert rows["stiffness_n_per_m", "acrylamide 30 %"] > 1.5 * rows["stiffness_n_per_m", "acrylamide 10 %"]
    few = found.tables["materials"]
    few = replace(found, tables={"materials": few[few["parameter"] == "stiffness_n_per_m"]})
    page = study_html("gels", "lms", few, {"bad.h5": "cannot be read"})
    assert "acrylamide 30 %" in page
    assert "bad.h5" in page
    write_study_pdf(tmp_path / "report.pdf", "gels", "lms", few, {"bad.h5": "cannot be read"})
    assert (tmp_path / "report.pdf").read_bytes().startswith(b"%PDF")
