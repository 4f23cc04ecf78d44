"""Tables of the thesis: its own numbers, and the tables of a study next to them."""

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from studies.generated_tables import generated_table

from tissueid.studies import multivariate, repeatability
from tissueid.studies.group_comparison import one_way
from tissueid.studies.repeatability import participants
from tissueid.studies.study_statistics import study_statistics
from tissueid.studies.thesis_tables import (
    INDIVIDUAL,
    PARTICIPANTS,
    POPULATION,
    PRINTED_MEANS,
    SUBGROUP,
    SUBGROUP_SUBJECTS,
    thesis_tables,
)
from tissueid.studies.usable_tests import THESIS_SIX

PRINTED = {"scaled_mass_s2": 0.0005, "scaled_damping_s": 0.002, "c1_m": 0.0005, "c2_per_n": 0.001}


def with_moments(mean, std):
    """Return ``SUBGROUP_SUBJECTS`` values with exactly this mean and standard deviation."""
    shape = stats.zscore(np.linspace(-1.0, 1.0, SUBGROUP_SUBJECTS), ddof=1)
    return mean + std * shape


@pytest.mark.parametrize("name", SUBGROUP)
def test_p_values_of_table_7_5_follow_from_its_means_and_seven_subjects(name):
    (anterior, spread), (posterior, other), text = SUBGROUP[name]
    values = {"anterior": with_moments(anterior, spread), "posterior": with_moments(posterior, other)}
    means = pd.DataFrame(
        [
            {"subject": k, "site": "left", "side": side, name: v}
            for side, own in values.items()
            for k, v in enumerate(own)
        ]
    )
    row = one_way(means, "side", [name]).iloc[0]
    f = SUBGROUP_SUBJECTS * (anterior - posterior) ** 2 / (spread**2 + other**2)
    assert row["statistic"] == pytest.approx(f, rel=1e-6)
    p_value = stats.f.sf(f, 1, 2 * SUBGROUP_SUBJECTS - 2)
    assert p_value < PRINTED[name] if text.startswith("<") else round(p_value, 3) == PRINTED[name]
    if row["method"] == "anova":
        assert row["p_value"] == pytest.approx(p_value, rel=1e-6)


def test_table_7_5_is_in_si():
    # Mass over stiffness is the reciprocal square of the natural frequency, which skin has near 200 rad/s.
    for mean, _std in SUBGROUP["scaled_mass_s2"][:2]:
        assert 100.0 < mean**-0.5 < 250.0
    for place in (0, 1):
        mass, damping = SUBGROUP["scaled_mass_s2"][place][0], SUBGROUP["scaled_damping_s"][place][0]
        assert 0.3 < damping / (2.0 * mass**0.5) < 1.0  # damping ratio


def test_last_rows_of_tables_7_1_and_7_2_are_the_means_of_the_sites():
    for table, printed in zip((INDIVIDUAL, POPULATION), PRINTED_MEANS, strict=True):
        assert np.mean(list(table.values()), axis=0) == pytest.approx(printed, abs=6e-4)


def test_participants_of_table_7_3c_are_standardised_differences():
    for (least, most), (large, small) in zip(
        (PARTICIPANTS["gender", "LA"], PARTICIPANTS["gender", "RA"]), ((1.6, 1.2), (1.0, 0.74)), strict=True
    ):
        assert participants(large, 0.8) == pytest.approx(least, abs=1)
        assert participants(small, 0.9) == pytest.approx(most, abs=1)


def test_a_study_of_the_same_sites_and_parameters_stands_beside_the_thesis(monkeypatch):
    monkeypatch.setattr(repeatability, "RESAMPLES", 20)
    monkeypatch.setattr(multivariate, "PERMUTATIONS", 3)
    table = generated_table(1, names=THESIS_SIX, repeats=2, subjects=10).assign(handedness="right")
    found = study_statistics(table)
    assert set(found.thesis) >= {"7.1", "7.2", "7.3a", "7.3c", "7.4"}
    row = found.thesis["7.1"].set_index(["site", "parameter"]).loc["LP", "c2_per_n"]
    assert row["thesis"] == 0.083
    assert row["ratio"] == pytest.approx(row["study"] / 0.083)
    assert row["study_low"] < row["study"] < row["study_high"]
    assert {"LA", "LP", "mean"} == set(found.thesis["7.2"]["site"])


def test_other_sites_or_parameters_have_no_table_of_the_thesis():
    assert thesis_tables(pd.DataFrame({"site": ["leg"]}), {}, THESIS_SIX) == {}
    assert thesis_tables(pd.DataFrame({"site": ["left anterior forearm"]}), {}, ["k"]) == {}
