"""Direction partitions: Eqs. 5.3-5.4 exactly, and damping that differs between the way in and the way out."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from coded import refused
from identification import simulated_dpn, simulated_stepped
from identification.simulated import near
from scipy import linalg

from tissueid.identification.engines.partitions import Direction
from tissueid.identification.partitions.model import PartitionedModel
from tissueid.messages import code_of
from tissueid.records import Record

TURNING = replace(simulated_dpn.SKIN, turn=0.25)


@lru_cache(maxsize=8)
def fitted(tissue: simulated_dpn.Tissue, seed: int = 1) -> tuple[Record, PartitionedModel]:
    record = simulated_dpn.record(tissue, seed)
    return record, Direction().fit(record)


def test_kernels_are_the_least_squares_answer_of_eq_5_3():
    record = simulated_stepped.stochastic_wiener(1, n=2500)
    model = Direction(
        memory=0.04, partitions=2, downsample=1, filter_hz=None, offset="mean", correct=False, hold="zero-order"
    ).fit(record)
    middle = model.breakpoints_m[1]
    x, y, lags = record.input - record.input.mean(), record.output, 20
    rising = np.concatenate([[True], np.diff(y) > 0.0])
    matrix = [np.ones(len(record) - lags + 1)]
    for way in (rising, ~rising):
        for stretch in (y < middle, y >= middle):
            inside = np.where(way & stretch, x, 0.0)
            matrix += [inside[lags - 1 - lag : len(record) - lag] for lag in range(lags)]
    theta = linalg.lstsq(np.array(matrix).T, y[lags - 1 :])[0]
    np.testing.assert_allclose(np.ravel(model.kernels) / 500.0, theta[1:], rtol=0, atol=1e-8 * np.linalg.norm(theta))
    np.testing.assert_array_equal(model.direction, [1, 1, -1, -1])


def test_damping_in_and_out_is_recovered():
    record, model = fitted(TURNING)
    profile = model.depth_profile()
    np.testing.assert_array_equal(profile.direction, np.repeat([1, -1], 5))
    truth = TURNING.dampings(profile.position) * (1.0 + TURNING.turn * profile.direction)
    assert np.mean(np.abs(profile.damping / truth - 1.0)) < 0.07
    parameters = model.report.parameters
    middle = TURNING.dampings(np.array([np.median(record.output)]))[0]
    near(parameters, 0.07, damping_in_n_s_per_m=1.25 * middle, damping_out_n_s_per_m=0.75 * middle)
    finding = model.report.findings[-1]
    assert code_of(finding) == "direction.larger_inward"
    assert 19.5 < finding.values["percent"] < 29.5


@pytest.mark.parametrize("tissue", [simulated_dpn.SKIN, simulated_dpn.GROWING, simulated_dpn.PLAIN])
def test_a_symmetric_tissue_shows_no_difference(tissue: simulated_dpn.Tissue):
    _, model = fitted(tissue)
    parameters = model.report.parameters
    inwards, outwards = parameters["damping_in_n_s_per_m"], parameters["damping_out_n_s_per_m"]
    assert inwards.std is not None
    assert inwards.value == pytest.approx(outwards.value, rel=0.02)
    assert code_of(model.report.findings[-1]) == "direction.none"


def test_stiffness_in_and_out_is_recovered():
    """The spring pushes back 15 % harder on the way in and 15 % less on the way out; the damping differs by 20 %."""
    tissue = replace(simulated_dpn.SKIN, turn=0.2, stiffness_turn=0.15)
    record, model = fitted(tissue)
    parameters, place = model.report.parameters, np.array([np.median(record.output)])
    stiffness, damping = tissue.tangents(place)[0], tissue.dampings(place)[0]
    for name, true in (
        ("stiffness_in_n_per_m", 1.15 * stiffness),
        ("stiffness_out_n_per_m", 0.85 * stiffness),
        ("damping_in_n_s_per_m", 1.2 * damping),
        ("damping_out_n_s_per_m", 0.8 * damping),
    ):
        assert parameters[name].value == pytest.approx(true, rel=0.06), name
        assert parameters[name].std == pytest.approx(0.025 * true, rel=0.6), name
    assert [code_of(finding) for finding in model.report.findings[-2:]] == [
        "direction.stiffness_larger_inward",
        "direction.larger_inward",
    ]
    assert model.report.findings[-2].values["percent"] == pytest.approx(15.0, abs=0.5)
    profile = model.depth_profile()
    inward, outward = profile.stiffness[:5], profile.stiffness[5:]
    np.testing.assert_allclose((inward - outward) / (inward + outward), 0.15, atol=0.03)
    np.testing.assert_array_equal(profile.mass[:5], profile.mass[5:])


def test_a_damping_that_differs_is_not_taken_for_a_stiffness():
    _, model = fitted(TURNING)
    assert [code_of(finding) for finding in model.report.findings[-2:]] == [
        "direction.stiffness_none",
        "direction.larger_inward",
    ]


def test_kernels_alone_take_damping_for_stiffness():
    """Why the kernels of Eq. 5.3 are not read one by one: stiffness is the same both ways, and does not look so."""
    _, model = fitted(TURNING)
    steady = np.sum(model.kernels, axis=1)
    inwards, outwards = steady[:5], steady[5:]
    assert np.max(np.abs(np.log(inwards / outwards))) > 0.1


def test_the_free_run_chooses_direction_by_itself():
    record, model = fitted(TURNING)
    assert model.report.vaf_percent > 95.0
    assert model.report.details["vaf_scheduled_fitted_percent"] > 97.0
    output = model.simulate(record.input)
    np.testing.assert_array_equal(output, model.simulate(record.input.copy()))
    assert np.all(np.isfinite(output))


def test_without_the_correction_there_is_no_damping_by_direction():
    model = Direction(correct=False).fit(fitted(TURNING)[0])
    assert "damping_in_n_s_per_m" not in model.report.parameters
    profile = model.depth_profile()
    np.testing.assert_array_equal(profile.damping[:5], profile.damping[5:])


def test_a_way_that_was_hardly_gone_is_refused():
    t = np.arange(4000) / 2000.0
    rng = np.random.Generator(np.random.PCG64(1))
    force = rng.standard_normal(4000)
    record = Record(force, 0.01 + 1e-3 * t, 2000.0)
    refused(
        lambda: Direction(partitions=2, filter_hz=None).fit(record), "partitions.too_few_in_one", partitions=4, count=0
    )
