"""Relaxation times of known springs and dampers, and the choice of their arrangement."""

from __future__ import annotations

import numpy as np
import pytest
from coded import codes
from identification import simulated_viscoelastic as simulated

from tissueid.identification import get_engine
from tissueid.identification.engines.viscoelastic import ViscoelasticEngine
from tissueid.identification.validation import validated
from tissueid.identification.viscoelastic_structures import ELEMENTS, STRUCTURES, Viscoelastic
from tissueid.records import Record


def true_values(structure: str) -> dict[str, float]:
    values = dict(zip(("mass_kg", *ELEMENTS[structure]), simulated.VALUES[structure], strict=True))
    for name, damper, spring in (
        ("relaxation_time_s", "damper_1_n_s_per_m", "spring_1_n_per_m"),
        ("retardation_time_s", "damper_2_n_s_per_m", "spring_2_n_per_m"),
        ("retardation_time_s", "damping_n_s_per_m", "stiffness_n_per_m"),
    ):
        if damper in values and spring in values:
            values[name] = values[damper] / values[spring]
    return values


@pytest.mark.parametrize("structure", STRUCTURES)
def test_structure_and_values_are_recovered(structure: str):
    record = simulated.record(structure, 1)
    model = ViscoelasticEngine().fit(record, slice(0, 6000))
    assert model.system.structure == structure
    true = true_values(structure)
    assert set(model.report.parameters) == set(true)
    for name, found in model.report.parameters.items():
        assert found.value == pytest.approx(true[name], rel=0.02), name
        assert found.std is not None
        assert abs(found.value - true[name]) < 4.0 * found.std, name
    relaxes = structure != "kelvin-voigt"
    assert codes(model.report.findings) == ["viscoelastic.relaxation" if relaxes else "viscoelastic.no_relaxation"]
    assert validated(model, record, slice(6000, None)).report.vaf_validation_percent > (95.0 if relaxes else 99.9)


def test_coloured_residuals_do_not_make_a_structure_larger():
    model = ViscoelasticEngine().fit(simulated.record("kelvin-voigt", 3, snr_db=25.0, colour=0.9, n=4000))
    assert model.system.structure == "kelvin-voigt"
    assert model.report.details["independent_samples"] < 0.4 * model.report.n_samples


def test_an_arm_faster_than_the_driven_band_is_not_determined():
    record = simulated.record("kelvin-voigt", 2, n=4000)
    model = get_engine("viscoelastic").from_options({"structure": "standard-linear-solid"}).fit(record)
    assert model.report.parameters["relaxation_time_s"].std is None
    assert model.report.parameters["damper_1_n_s_per_m"].value == pytest.approx(20.0, rel=0.02)
    assert "viscoelastic.undetermined" in codes(model.report.warnings)


@pytest.mark.parametrize("structure", STRUCTURES)
def test_derivatives_are_those_of_the_response(structure: str):
    values = np.array(simulated.VALUES[structure])
    frequency = np.geomspace(0.1, 300.0, 7)
    _, slopes = Viscoelastic(structure, tuple(values)).response(frequency)
    for k, step in enumerate(1e-6 * np.eye(values.size)):
        above, _ = Viscoelastic(structure, tuple(values * np.exp(step))).response(frequency)
        below, _ = Viscoelastic(structure, tuple(values * np.exp(-step))).response(frequency)
        np.testing.assert_allclose((above - below) / 2e-6, slopes[k], rtol=1e-5, atol=1e-9 * np.abs(above).max())


@pytest.mark.parametrize("structure", STRUCTURES)
def test_response_is_that_of_the_polynomials(structure: str):
    system = Viscoelastic(structure, simulated.VALUES[structure])
    frequency = np.geomspace(0.1, 300.0, 7)
    above, below = system.ratio
    s = 2j * np.pi * frequency
    np.testing.assert_allclose(system.response(frequency)[0], above(s) / below(s), rtol=1e-9)
    assert np.all(system.poles.real < 0.0)
    step = system.simulate(np.ones(4000), 2000.0, "zero-order")
    if system.creeps:
        assert (step[-1] - step[-101]) / 0.05 == pytest.approx(system.creep_rate, rel=1e-3)
    else:
        assert step[-1] == pytest.approx(
            1.0 / system.values[ELEMENTS[structure].index("stiffness_n_per_m") + 1], rel=1e-3
        )


def test_a_held_force_and_gaps():
    record = simulated.record("standard-linear-solid", 4)
    output = record.output.copy()
    output[1000:1050] = np.nan
    holed = Record(np.where(np.isnan(output), np.nan, record.input), output, record.sample_rate_hz)
    found = ViscoelasticEngine(structure="standard-linear-solid").fit(holed).report
    assert found.parameters["relaxation_time_s"].value == pytest.approx(0.01, rel=0.02)
