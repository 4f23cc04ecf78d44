"""Statistics of studies against published values and R (packages datasets, psych, pwr)."""

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from sklearn.cross_decomposition import PLSRegression

from tissueid.studies.group_comparison import (
    corrected,
    efficacy,
    general_linear,
    materials,
    mixed_model,
    one_way,
    pooled_mean,
    regressions,
    site_means,
    subject_means,
)
from tissueid.studies.multivariate import component_steps, partial_least_squares
from tissueid.studies.repeatability import (
    ALL_SITES,
    detectable_effect,
    first_test,
    paired_difference,
    participants,
    reliability,
    sample_sizes,
    variation,
)

PLANTS = {
    "ctrl": [4.17, 5.58, 5.18, 6.11, 4.50, 4.61, 5.17, 4.53, 5.33, 5.14],
    "trt1": [4.81, 4.17, 4.41, 3.59, 5.87, 3.83, 6.03, 4.89, 4.32, 4.69],
    "trt2": [6.31, 5.12, 5.54, 5.50, 5.37, 5.29, 4.92, 6.15, 5.80, 5.26],
}
"""R's ``PlantGrowth``."""
SLEEP = ([0.7, -1.6, -0.2, -1.2, -0.1, 3.4, 3.7, 0.8, 0.0, 2.0], [1.9, 0.8, 1.1, 0.1, -0.1, 4.4, 5.5, 1.6, 4.6, 3.4])
"""R's ``sleep``."""
JUDGES = [[9, 2, 5, 8], [6, 1, 3, 2], [8, 4, 6, 8], [7, 1, 2, 6], [10, 5, 6, 9], [6, 2, 4, 7]]
"""Shrout and Fleiss (1979), Table 2: six targets, four judges."""
WOMEN = np.array(
    [range(58, 73), [115, 117, 120, 123, 126, 129, 132, 135, 139, 142, 146, 150, 154, 159, 164]],
)
"""R's ``women``: height and weight."""


def plants():
    return pd.DataFrame(
        [
            {"subject": f"{group}{k}", "site": "a", "group": group, "weight": value}
            for group, values in PLANTS.items()
            for k, value in enumerate(values)
        ]
    )


def test_one_way_analysis_of_variance():
    row = one_way(plants(), "group", ["weight"]).iloc[0]
    assert row["statistic"] == pytest.approx(4.846087862380136, rel=1e-6)
    assert row["p_value"] == pytest.approx(0.01590995832562, rel=1e-6)
    assert row["p_corrected"] == row["p_value"]
    assert row["effect_size"] == pytest.approx(3.76634 / (3.76634 + 10.49209), rel=1e-6)
    assert row["method"] == "anova"
    assert row["normal"]


def test_general_linear_model_of_one_factor_is_the_analysis_of_variance():
    row = general_linear(plants(), ["group"], ["weight"]).iloc[0]
    assert row["statistic"] == pytest.approx(4.846087862380136, rel=1e-6)
    assert row["r_squared"] == pytest.approx(0.26414830, rel=1e-6)


def test_paired_comparison():
    found = paired_difference(*map(np.array, SLEEP))
    assert found["difference"] == pytest.approx(1.58)
    assert found["p_value"] == pytest.approx(0.00283289019738427, rel=1e-6)
    assert (found["low"], found["high"]) == pytest.approx((0.7001142, 2.4598858), rel=1e-6)
    assert found["effect_size"] == pytest.approx(4.0621277 / np.sqrt(10), rel=1e-6)


def test_intraclass_correlation():
    table = pd.DataFrame(
        [
            {"subject": str(i), "site": "a", "repeat": j, "value": float(value)}
            for i, row in enumerate(JUDGES)
            for j, value in enumerate(row)
        ]
    )
    found = reliability(table, ["value"]).iloc[0]
    assert found["icc"] == pytest.approx(0.2897638, rel=1e-6)  # ICC(A,1), psych::ICC
    assert (found["icc_low"], found["icc_high"]) == pytest.approx((0.01878, 0.76108), abs=1e-4)
    assert found["left_out"] == 0
    without_one = reliability(table.iloc[1:], ["value"]).iloc[0]
    assert (without_one["subjects"], without_one["left_out"]) == (5, 1)


def test_regression():
    heights, weights = WOMEN
    data = pd.DataFrame({"subject": range(15), "site": "a", "height": heights, "weight": weights})
    row = regressions(data, "height", ["weight"]).iloc[0]
    assert (row["slope"], row["intercept"]) == pytest.approx((3.45, -87.51667), rel=1e-6)
    assert row["r_squared"] == pytest.approx(0.991009830, rel=1e-6)
    assert row["p_value"] == pytest.approx(1.0910e-14, rel=1e-3)
    assert not row["weighted"]


def test_weights_follow_the_uncertainty_of_each_subject():
    x = np.linspace(0.0, 1.0, 40)
    u = np.where(np.arange(40) % 2, 0.05, 1.0)
    errors = []
    for seed in range(8):
        k = 2.0 * x + u * np.random.default_rng(seed).normal(size=40)
        data = pd.DataFrame({"subject": range(40), "site": "a", "x": x, "k": k, "k_sd": u})
        weighted, plain = (regressions(table, "x", ["k"]).iloc[0] for table in (data, data.drop(columns="k_sd")))
        assert weighted["weighted"]
        errors.append((weighted["slope"] - 2.0, plain["slope"] - 2.0))
    ours, theirs = np.sqrt(np.mean(np.square(errors), axis=0))
    assert ours < 0.7 * theirs


@pytest.mark.parametrize(("size", "power", "expected"), [(0.5, 0.8, 64), (0.5, 0.9, 86), (1.2, 0.8, 12)])
def test_sample_size_of_two_groups(size, power, expected):
    assert participants(size, power) == expected  # pwr.t.test


def test_sample_size_of_more_groups():
    assert participants(0.25, 0.8, groups=4) == 45  # pwr.anova.test
    assert participants(0.0) == np.inf
    rows = sample_sizes(one_way(plants(), "group", ["weight"]))
    assert rows.loc[0, "participants_80"] <= rows.loc[0, "participants_90"]


def test_correction_by_holm():
    found = corrected(pd.DataFrame({"p_value": [0.01, 0.04, 0.03, np.nan]}))
    assert found["p_corrected"].tolist()[:3] == pytest.approx([0.03, 0.06, 0.06])
    assert np.isnan(found["p_corrected"].iloc[3])


def study(subjects=16, repeats=5, sites=("arm", "leg"), seed=3, within=0.04, between=0.15, gap=0.0):
    """A table with known variation: ``gap`` is the relative difference of the second site."""
    random = np.random.default_rng(seed)
    rows = []
    for who in range(subjects):
        own = 1.0 + between * random.normal()
        for number, site in enumerate(sites):
            for repeat in range(1, repeats + 1):
                value = 100.0 * own * (1.0 + gap * number) * (1.0 + within * random.normal())
                rows.append({"subject": f"S{who:02d}", "site": site, "repeat": repeat, "k": value, "k_sd": 1.0})
    return pd.DataFrame(rows)


def test_variation_within_and_between_subjects():
    found = variation(study(subjects=40), ["k"]).iloc[0]
    assert found["individual_cv_low"] < 0.04 * 0.94 < found["individual_cv_high"]  # c4(5) = 0.940 biases a deviation
    assert found["population_cv_low"] < 0.15 < found["population_cv_high"]
    assert found["tests"] == 200


def test_first_test_against_the_others():
    table = study()
    table.loc[table["repeat"] == 1, "k"] -= 20.0
    found = first_test(table, ["k"]).set_index("site")
    assert found.loc["arm", "low"] < 20.0 < found.loc["arm", "high"]
    assert found.loc[ALL_SITES, "p_value"] < 1e-6


def test_mixed_model_finds_the_difference_between_sites_of_the_same_subjects():
    row = mixed_model(study(gap=0.1), "site", ["k"]).iloc[0]
    assert (row["reference"], row["level"]) == ("arm", "leg")
    assert row["low"] < 10.0 < row["high"]
    assert row["between_std"] == pytest.approx(15.0, rel=0.4)


def test_efficacy_and_equivalence():
    table = study(sites=("arm",), repeats=3).assign(condition="before")
    after = table.assign(condition="after", k=table["k"] * 0.9)
    means = subject_means(pd.concat([table, after]), ["k"], ("subject", "site", "condition"))
    row = efficacy(means, "before", "after", ["k"], margin=0.2).iloc[0]
    assert row["difference"] == pytest.approx(-10.0, rel=0.1)
    assert row["p_value"] < 1e-6
    assert row["equivalence_p_value"] < 0.05
    assert efficacy(means, "before", "after", ["k"], margin=0.05).iloc[0]["equivalence_p_value"] > 0.5


def test_one_group_constant_values_and_missing_values_give_no_row():
    means = subject_means(study(sites=("arm",)), ["k"]).assign(gender="female", k0=1.0, bmi=np.nan)
    assert one_way(means, "gender", ["k"]).empty
    assert one_way(means.assign(gender=["a", "b"] * 8), "gender", ["k0"]).empty
    assert regressions(means, "bmi", ["k"]).empty
    assert regressions(means.assign(bmi=range(16)), "bmi", ["k0"]).empty
    assert general_linear(means, ["gender"], ["k"]).empty
    assert partial_least_squares(means, ["bmi", "gender"], ["k"]).empty


@pytest.mark.soak
def test_false_positives_are_rare():
    found = [
        one_way(subject_means(study(seed=seed, sites=("arm",), repeats=2), ["k"]).assign(g=["a", "b"] * 8), "g", ["k"])
        for seed in range(60)
    ]
    share = np.mean([rows.iloc[0]["p_value"] < 0.05 for rows in found])
    assert share <= 0.15


def test_partial_least_squares():
    random = np.random.default_rng(0)
    x = random.normal(size=(30, 3))
    means = pd.DataFrame(x, columns=["a", "b", "c"]).assign(
        site="arm", bmi=x[:, 0] - x[:, 1] + 0.3 * random.normal(size=30), age=random.normal(size=30)
    )
    found = partial_least_squares(means, ["bmi", "age"], ["a", "b", "c"], permutations=40).set_index("response")
    assert found.loc["bmi", "p_value"] == pytest.approx(1 / 41)
    assert found.loc["age", "q_squared"] < 0.2
    assert found.loc["bmi", "q_squared"] > 0.8


def test_components_of_partial_least_squares_are_those_of_scikit_learn():
    random = np.random.default_rng(0)
    x, y, new = random.normal(size=(13, 6)), random.normal(size=13), random.normal(size=(4, 6))
    x -= x.mean(axis=0)
    steps = component_steps(x, y, new, 3)
    for count in (1, 2, 3):
        reference = PLSRegression(count, scale=False).fit(x, y).predict(new)
        assert y.mean() + steps[:, :count].sum(axis=1) == pytest.approx(reference, rel=1e-10)
    dependent = component_steps(x[:, :1] * [1.0, 2.0], y, new[:, :1] * [1.0, 2.0], 3)
    assert np.abs(dependent[:, 0]).min() > 0.0
    assert not dependent[:, 1:].any()


def test_pooled_mean_weights_by_uncertainty():
    mean, error, between = pooled_mean([1.0, 1.1, 3.0], [0.01, 0.01, 100.0])
    assert mean == pytest.approx(1.05, abs=0.01)
    assert 0.0 < between < 0.2
    assert error < 0.1


def test_effect_that_groups_can_show():
    size = detectable_effect(2, 16)
    assert participants(2.001 * size, 0.8) == 8
    assert detectable_effect(2, 5) > 1.0
    assert detectable_effect(2, 3) == np.inf


def test_weighted_mean_of_a_site_is_that_of_equal_uncertainties():
    means = subject_means(study(sites=("arm",)), ["k"]).assign(k_sd=2.0)
    row = site_means(means, ["k"]).iloc[0]
    assert row["mean"] == pytest.approx(means["k"].mean(), rel=1e-6)
    assert row["between_std"] == pytest.approx(np.sqrt(means["k"].var() - 4.0), rel=1e-6)
    reach = stats.t.ppf(0.975, 15) * means["k"].std() / 4.0
    assert row["high"] - row["mean"] == pytest.approx(reach, rel=1e-6)


def test_materials_by_tukey():
    found = materials(plants().rename(columns={"group": "material"}), ["weight"]).set_index("level")
    assert found.loc["ctrl", "p_value"] == pytest.approx(0.01590995832562, rel=1e-6)
    assert found["unlike"].to_dict() == {"ctrl": 0, "trt1": 1, "trt2": 1}  # R: TukeyHSD, trt2-trt1 p = 0.0120064


def test_difference_of_two_groups():
    two = plants()[lambda table: table["group"] != "ctrl"]
    row = one_way(two, "group", ["weight"]).iloc[0]
    assert row["difference"] == pytest.approx(0.865, rel=1e-6)
    known = stats.ttest_ind(PLANTS["trt2"], PLANTS["trt1"]).confidence_interval()
    assert (row["low"], row["high"]) == pytest.approx((known.low, known.high), rel=1e-6)
