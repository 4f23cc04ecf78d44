"""Localized linear tests: levels found or given, M, B, K about each, and the tissue that they make together."""

from __future__ import annotations

import numpy as np
import pytest
from coded import refused, says
from identification import simulated, simulated_dpn, simulated_stepped

from tissueid.identification import vaf_percent
from tissueid.identification.engines.localized import Localized, LocalizedModel
from tissueid.records import Record, joined

TISSUE = simulated_dpn.GROWING


def moved(force: np.ndarray) -> np.ndarray:
    """Position (n,) of the tissue under a force (n,) at 2 kHz, straight between its samples, from the surface on."""
    steps = 4
    fine = np.interp(np.arange(2 * steps * force.size + 1) / (2 * steps), np.arange(force.size), force)
    return simulated_dpn.integrate(TISSUE, fine, 1.0 / (2000.0 * steps), steps)


@pytest.fixture(scope="module")
def staircase() -> Record:
    force = simulated_stepped.staircase(1)
    position = moved(force)
    rng = simulated.generator(8)
    return Record(force, position + 5e-8 * rng.standard_normal(force.size), 2000.0)


@pytest.fixture(scope="module")
def model(staircase: Record) -> LocalizedModel:
    return Localized(memory=0.1).fit(staircase)


def test_levels_and_how_they_were_come_to_are_found(model: LocalizedModel):
    assert len(model.levels) == 11
    begins = np.array([one.level.first for one in model.levels])
    assert np.max(np.abs(begins - 1200 * np.arange(11))) < 100
    assert [one.level.direction for one in model.levels] == [0, 1, 1, 1, 1, 1, -1, -1, -1, -1, -1]
    assert says(model.report.findings[0], "localized.levels", pushing=5, pulling=5, neither=1)


def test_parameters_at_each_level_are_those_of_the_tissue(model: LocalizedModel):
    profile = model.depth_profile()
    y = profile.position
    assert np.all(np.diff(y) > 0.0)
    np.testing.assert_allclose(profile.mass, TISSUE.masses(y), rtol=0.02)
    np.testing.assert_allclose(profile.damping, TISSUE.dampings(y), rtol=0.02)
    np.testing.assert_allclose(profile.stiffness, TISSUE.tangents(y), rtol=0.02)
    off = np.abs(profile.stiffness - TISSUE.tangents(y)) / profile.stiffness_std
    assert np.mean(off < 3.0) > 0.8
    parameters = model.report.parameters
    assert parameters["stiffness_slope_n_per_m2"].value > 5.0 * parameters["stiffness_slope_n_per_m2"].std
    assert model.report.details["vaf_within_levels_median_percent"] > 95.0


def test_the_free_run_goes_from_level_to_level(model: LocalizedModel, staircase: Record):
    assert model.report.vaf_percent > 99.5
    output = model.simulate(np.full(1000, model.input_mean))
    np.testing.assert_allclose(output, output[0], rtol=0, atol=1e-9)
    u = simulated.changed(staircase.input, (3000, np.nan))
    unknown = np.flatnonzero(np.isnan(model.simulate(u)))
    np.testing.assert_array_equal(unknown, np.arange(3000, 3000 + model.memory_samples))
    larger = simulated_stepped.staircase(2, noise=0.6)
    assert vaf_percent(moved(larger)[400:], model.simulate(larger)[400:]) > 99.0


def test_given_levels_are_taken(staircase: Record, model: LocalizedModel):
    given = Localized(memory=0.1, levels=(2.0, 3.0, 4.0, 5.0, 6.0, 7.0)).fit(staircase)
    assert len(given.levels) == 11
    np.testing.assert_allclose(given.depth_profile().stiffness, model.depth_profile().stiffness, rtol=0.01)


def test_records_joined_are_levels_of_their_own():
    parts = []
    for level in (3.0, 5.0):
        rng = simulated.generator(9, round(level))
        small, _ = simulated.second_order(rng, n=3000)
        force = level + 0.15 * small
        parts.append(Record(force[1000:], moved(force)[1000:], 2000.0))
    found = Localized(memory=0.1).fit(joined(parts))
    profile = found.depth_profile()
    assert len(profile) == 2
    np.testing.assert_array_equal(profile.direction, 0)
    np.testing.assert_allclose(profile.stiffness, TISSUE.tangents(profile.position), rtol=0.02)


def test_a_record_without_steps_is_refused():
    refused(lambda: Localized().fit(simulated_dpn.record(simulated_dpn.SKIN, 1)), "localized.no_levels")


def test_levels_too_short_for_the_memory_are_refused(staircase: Record):
    refused(
        lambda: Localized(memory=0.32, levels=(2.0, 3.0, 4.0, 5.0, 6.0, 7.0)).fit(staircase), "localized.too_few_levels"
    )
