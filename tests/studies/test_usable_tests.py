"""What does not count is stated with its reason; nothing crashes and nothing is dropped silently."""

import numpy as np
import pandas as pd
import pytest
from studies.generated_tables import SITES, generated_table

from tissueid.studies import multivariate, repeatability
from tissueid.studies.repeatability import absolute_agreement, reliability
from tissueid.studies.study_statistics import study_statistics
from tissueid.studies.study_table import as_json_rows, study_table
from tissueid.studies.usable_tests import usable_tests


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    monkeypatch.setattr(repeatability, "RESAMPLES", 20)
    monkeypatch.setattr(multivariate, "PERMUTATIONS", 3)


def codes(found):
    return {remark.code for remark in found.remarks}


def drawn(**options):
    return generated_table(3, **({"subjects": 6, "repeats": 2} | options))


def test_every_test_that_does_not_count_is_listed_with_its_reason():
    table = drawn().assign(findings="")
    table.loc[0, ["quality", "findings"]] = "repeat", "reference_moved"
    table.loc[1, ["status", "problem"]] = "not analysed", "too short"
    table.loc[2, "status"] = "aborted"
    table.loc[3, "configuration"] = "extension"
    found = usable_tests(table)
    assert [reason.code for reason in found.left_out["reason"]] == [
        "study.reason.quality",
        "study.reason.problem",
        "study.reason.status",
        "study.reason.configuration",
    ]
    assert len(found.used) + len(found.left_out) == len(table)
    assert codes(found) == {"study.tests_dropped", "study.not_comparable"}
    answer = study_statistics(table).as_answer()
    assert "reference_moved" in answer["left_out"][0]["reason"]


def test_values_in_another_unit_do_not_count():
    table = drawn()
    table["height_m"] *= 100.0
    table["bmi_kg_per_m2"] = table["weight_kg"] / table["height_m"] ** 2
    found = study_statistics(table)
    assert "study.implausible" in codes(found)
    factors = set(found.tables["regressions"]["factor"])
    assert "age_years" in factors
    assert factors.isdisjoint({"height_m", "bmi_kg_per_m2"})


def test_tests_without_a_value_are_counted():
    table = drawn()
    table.loc[:3, ["k", "k_sd"]] = np.nan
    found = study_statistics(table)
    remark = next(one for one in found.remarks if one.code == "study.no_value")
    assert remark.values["count"] == 4


def test_one_group_constant_parameter_and_single_tests_are_stated():
    table = drawn(names=("k", "c")).assign(gender="female", c=5.0)
    table = table[(table["repeat"] == 1) | (table["subject"] != "P-000")]
    found = study_statistics(table)
    assert codes(found) >= {"study.one_group", "study.constant", "study.single_tests"}
    assert found.parameters == ("k",)
    alone = study_statistics(table[table["repeat"] == 1])
    assert codes(alone) >= {"study.no_variation", "study.no_reliability"}
    assert "variation" not in alone.tables


def test_a_group_of_one_subject_and_anonymous_tests_are_stated():
    table = drawn()
    table.loc[table["subject"] == "P-001", "gender"] = "other"
    table.loc[table["subject"] == "P-002", "subject"] = "anonymous"
    assert codes(study_statistics(table)) >= {"study.small_group", "study.anonymous"}


def test_no_test_counts():
    table = drawn().assign(quality="repeat")
    found = study_statistics(table)
    assert not found.tables
    assert len(found.left_out) == len(table)


def test_samples_of_materials_are_compared_apart_from_subjects():
    table = drawn().assign(material=None, stiffness_n_per_m=1000.0, stiffness_n_per_m_sd=1.0)
    random = np.random.default_rng(0)
    gels = table.head(12).assign(
        subject=np.repeat(["M-1", "M-2"], 6), material=np.repeat(["soft", "hard"], 6), site="sample", gender=None
    )
    gels["stiffness_n_per_m"] = np.repeat([1000.0, 2000.0], 6) + random.normal(size=12)
    found = study_statistics(pd.concat([table, gels], ignore_index=True))
    rows = found.tables["materials"].set_index(["parameter", "level"])
    assert rows.loc["stiffness_n_per_m", "hard"]["unlike"] == 1
    assert rows.loc["stiffness_n_per_m", "hard"]["mean"] == pytest.approx(2000.0, abs=2.0)
    assert set(found.used["site"]) == set(SITES)
    only = study_statistics(gels)
    assert "materials" in only.tables


def test_all_conditions_are_compared_with_the_reference():
    found = study_statistics(drawn(lotion=-0.2, repeats=3), margin=0.05)
    rows = found.tables["efficacy"]
    assert set(rows["after"]) == {"lotion"}
    assert (rows["high"] < 0.0).all()
    assert (rows["equivalence_p_value"] > 0.5).all()
    assert (found.tables["site_means"]["between_std"] <= found.tables["site_means"]["std"]).all()


def test_statistics_that_need_more_subjects_say_how_many():
    found = study_statistics(drawn(subjects=3), regressors=["age_years"])
    remark = next(one for one in found.remarks if one.code == "study.few_for_regression")
    assert remark.values["name"] == "age_years"
    assert remark.values["least"] == 4
    assert "regressions" not in found.tables
    assert all(site in str(remark) for site in SITES)
    assert codes(found) >= {"study.few_for_groups", "study.few_for_linear", "study.few_for_least_squares"}
    two = codes(study_statistics(drawn(subjects=2)))
    assert two >= {"study.few_for_first_test", "study.few_for_means", "study.few_for_sites"}
    many = study_statistics(drawn(subjects=9), factors=["gender"])
    assert not {code for code in codes(many) if code.startswith("study.few")}
    assert "regressions" in many.tables


def test_a_site_with_few_subjects_is_named():
    table = drawn(subjects=6, repeats=3, lotion=-0.1)
    last = table["subject"].isin(["P-003", "P-004", "P-005"]) & (table["site"] == SITES[1])
    table = table[
        ~last & ~((table["condition"] == "lotion") & (table["site"] == SITES[1]) & (table["subject"] == "P-000"))
    ]
    found = study_statistics(table, regressors=["age_years"], factors=["gender"])
    named = {one.code: str(one) for one in found.remarks}
    for code in ("study.few_for_regression", "study.few_for_groups", "study.few_pairs"):
        assert SITES[1] in named[code]
        assert SITES[0] not in named[code]
    assert "efficacy" in found.tables


def test_a_constant_parameter_of_one_site_is_named():
    table = drawn(names=("k", "c"))
    table.loc[table["site"] == SITES[1], "c"] = 5.0
    remark = next(one for one in study_statistics(table).remarks if one.code == "study.parameters_missing")
    assert remark.values["names"].items == ("c",)


def test_a_model_without_variance_between_subjects_is_a_remark_and_no_warning(recwarn):
    found = study_statistics(drawn(subjects=3, between=0.0, names=("k", "c")))
    assert "study.singular" in codes(found)
    assert found.tables["sites"]["singular"].any()
    assert not recwarn.list
    assert "study.singular" not in codes(study_statistics(drawn(subjects=9)))


def test_remarks_show_labels_and_keep_the_columns():
    table = drawn(names=("stiffness_n_per_m",)).assign(gender="female")
    table.loc[:3, "stiffness_n_per_m"] = np.nan
    found = study_statistics(table)
    by_code = {remark.code: remark for remark in found.remarks}
    assert str(by_code["study.one_group"]) == "all subjects have the same 'Gender'"
    assert "no value of 'Stiffness'" in by_code["study.no_value"]
    assert by_code["study.no_value"].values["name"] == "stiffness_n_per_m"
    answer = found.as_answer()
    assert answer["warning_messages"][0]["code"] in by_code
    assert len(answer["warning_messages"]) == len(answer["warnings"])


def test_only_tests_that_count_are_numbered():
    made = [("completed", "repeat"), ("completed", "good"), ("aborted", "good"), ("completed", "look")]
    rows = [
        {"session": "a.h5", "created": "2026", "test": number, "subject": "A", "site": "arm", "condition": ""}
        | {
            "configuration": "indentation",
            "orientation_deg": None,
            "engine": "lms",
            "status": status,
            "quality": quality,
        }
        for number, (status, quality) in enumerate(made, 1)
    ]
    table = study_table(rows)
    assert table["repeat"].isna().tolist() == [True, False, True, False]
    assert table["repeat"].dropna().tolist() == [1, 2]
    assert len(usable_tests(table).used) == 2
    assert [row["repeat"] for row in as_json_rows(table)] == [None, 1, None, 2]


def test_reliability_pairs_the_tests_that_count():
    values = {"A": [1.0, 1.1], "B": [2.0, 2.1], "C": [3.0, 3.1]}
    rows = [
        {"session": f"{who}.h5", "created": "2026", "test": number, "subject": who, "site": "arm", "condition": ""}
        | {"configuration": "indentation", "orientation_deg": None, "engine": "lms", "status": "completed"}
        | {"quality": quality, "k": value, "k_sd": 0.1}
        for who, own in values.items()
        for number, (quality, value) in enumerate(
            [*([("repeat", 9.0)] if who == "B" else []), *(("good", one) for one in own)], 1
        )
    ]
    row = reliability(usable_tests(study_table(rows)).used, ["k"]).iloc[0]  # B's tests 2 and 3 are its repeats 1 and 2
    assert (row["subjects"], row["left_out"], row["repeats"]) == (3, 0, 2)
    assert row["icc"] == pytest.approx(absolute_agreement(np.array(list(values.values())))[0])
