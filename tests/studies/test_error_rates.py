"""False-positive rate of null studies and coverage of intervals of known effects, through the statistics of a study."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binomtest
from studies.generated_tables import generated_table

from tissueid.studies import repeatability
from tissueid.studies.multivariate import partial_least_squares
from tissueid.studies.study_statistics import study_statistics

NULL_TESTS = ("first_test", "sites", "groups", "general_linear", "regressions", "efficacy")
STATISTICS = "tissueid.studies.study_statistics"
EFFECTS = {"gender": 0.2, "bmi": 0.02, "lotion": -0.05, "first": 0.02, "site": 0.08}


@pytest.fixture(autouse=True)
def _only_what_is_counted(monkeypatch):
    # Bootstrap intervals and least squares of every site take most of the time and are not counted here.
    monkeypatch.setattr(repeatability, "RESAMPLES", 20)
    monkeypatch.setattr(f"{STATISTICS}.partial_least_squares", lambda *_: pd.DataFrame())


def p_values(seed, **options):
    """Return one p-value per test of a null study: rows of a study share subjects, studies do not."""
    found = study_statistics(generated_table(seed, lotion=0.0, **options))
    values = {}
    for key in NULL_TESTS:
        rows = found.tables[key]
        values[key] = float(rows["p_value"].iloc[0])
        if key == "groups":
            values["ethnicity"] = float(rows[rows["factor"] == "ethnicity"]["p_value"].iloc[0])
            values["weighted groups"] = float(rows["p_weighted"].iloc[0])
    return values


def covered(seed, **options):
    """Return whether the interval of each known effect covers it, and whether its sign is right."""
    found = study_statistics(generated_table(seed, **(EFFECTS | options))).tables
    groups, lines = found["groups"], found["regressions"]
    bmi = lines[(lines["factor"] == "bmi_kg_per_m2")].iloc[0]
    pairs = {
        # Gender also carries the effect of the body mass index of its subjects, which is drawn apart from it.
        "gender": (groups[groups["factor"] == "gender"].iloc[0], "difference", "low", "high"),
        "bmi": (bmi, "slope", "slope_low", "slope_high"),
        "lotion": (found["efficacy"].iloc[0], "difference", "low", "high"),
        "first": (found["first_test"].iloc[0], "difference", "low", "high"),
        "site": (found["sites"].iloc[0], "difference", "low", "high"),
    }
    answer = {}
    for key, (row, value, low, high) in pairs.items():
        true = 100.0 * EFFECTS[key]
        answer[key] = (row[low] <= true <= row[high], np.sign(row[value]) == np.sign(true))
    return answer


def rates(studies, **options):
    """Return the number of p-values below 0.05 of each test over null studies."""
    drawn = pd.DataFrame([p_values(seed, **options) for seed in range(studies)])
    return (drawn < 0.05).sum()


def coverage(studies, **options):
    """Return numbers of covered intervals and of right signs of each effect."""
    drawn = [covered(seed, **options) for seed in range(studies)]
    return {key: tuple(np.sum([one[key] for one in drawn], axis=0)) for key in EFFECTS}


def test_false_positives_of_a_few_null_studies():
    for name, count in rates(2, repeats=2).items():
        assert binomtest(int(count), 2, 0.05).pvalue > 0.001, name


def test_intervals_of_known_effects_cover_them_in_a_few_studies():
    for name, (inside, signs) in coverage(3, repeats=2).items():
        assert binomtest(int(inside), 3, 0.95).pvalue > 0.001, name
        assert signs >= 2, name


@pytest.mark.soak
def test_false_positives_of_200_null_studies():
    found = rates(200)
    print(found.to_string())
    for name, count in found.items():
        assert binomtest(int(count), 200, 0.05).pvalue > 0.005, name


@pytest.mark.soak
def test_coverage_over_200_studies():
    found = coverage(200)
    print(found)
    for name, (inside, signs) in found.items():
        assert binomtest(int(inside), 200, 0.95).pvalue > 0.005, name
        assert signs > 180, name


@pytest.mark.soak
def test_false_positives_of_partial_least_squares_over_200_studies():
    names = [f"p{k}" for k in range(6)]
    count = 0
    for seed in range(200):
        random = np.random.default_rng([seed, 4])
        means = pd.DataFrame(random.normal(size=(16, 6)), columns=names)
        means = means.assign(site="arm", value=random.normal(size=16))
        count += partial_least_squares(means, ["value"], names).iloc[0]["p_value"] <= 0.05
    print(count)
    assert binomtest(int(count), 200, 0.05).pvalue > 0.005
