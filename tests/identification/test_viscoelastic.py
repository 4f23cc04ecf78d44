"""Relaxation times of known springs and dampers, and the choice of their arrangement."""

from __future__ import annotations

import numpy as np
import pytest
from coded import codes
from identification import simulated_viscoelastic as simulated
from identification.simulated import changed
from plant_support import VOLTS_PER_NEWTON
from scipy import signal

from firmware_sim.bench import Bench
from tissueid.identification import get_engine
from tissueid.identification.engines.viscoelastic import ViscoelasticEngine
from tissueid.identification.validation import vaf_percent
from tissueid.identification.viscoelastic_structures import ELEMENTS, PARALLEL, STRUCTURES, Viscoelastic
from tissueid.records import Record
from tissueid.stimuli.kinds.noise import Noise


def true_values(structure: str) -> dict[str, float]:
    values = dict(zip((*PARALLEL, *ELEMENTS[structure]), simulated.VALUES[structure], strict=True))
    if structure == "kelvin-voigt":
        values["retardation_time_s"] = values["damping_n_s_per_m"] / values["stiffness_n_per_m"]
    for name, number in (("relaxation_time_s", 1), ("retardation_time_s", 2)):
        if f"spring_{number}_n_per_m" in values:
            values[name] = values[f"damper_{number}_n_s_per_m"] / values[f"spring_{number}_n_per_m"]
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
        assert abs(found.value - true[name]) < 4.0 * found.std, name
    relaxes = structure != "kelvin-voigt"
    assert codes(model.report.findings) == ["viscoelastic.relaxation" if relaxes else "viscoelastic.no_relaxation"]
    held_out = slice(6000, None)
    apart_from_a_line = [signal.detrend(y[held_out]) for y in (record.output, model.simulate(record.input))]
    assert vaf_percent(*apart_from_a_line) > 99.9


def test_coloured_residuals_do_not_make_a_structure_larger():
    model = ViscoelasticEngine().fit(simulated.record("kelvin-voigt", 3, snr_db=25.0, colour=0.9, n=4000))
    assert model.system.structure == "kelvin-voigt"
    assert model.report.details["independent_samples"] < 0.4 * model.report.n_samples


def test_an_arm_faster_than_the_driven_band_is_not_determined():
    record = simulated.record("kelvin-voigt", 2, n=4000)
    model = get_engine("viscoelastic").from_options({"structure": "standard-linear-solid"}).fit(record)
    found = model.report.parameters
    assert found["relaxation_time_s"].std is None
    both = found["damping_n_s_per_m"].value + found["damper_1_n_s_per_m"].value
    assert both == pytest.approx(20.0, rel=0.02)
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
            1.0 / system.values[(*PARALLEL, *ELEMENTS[structure]).index("stiffness_n_per_m")], rel=1e-3
        )


def test_a_held_force_and_gaps():
    record = simulated.record("standard-linear-solid", 4)
    output = changed(record.output, (np.s_[1000:1050], np.nan))
    holed = Record(np.where(np.isnan(output), np.nan, record.input), output, record.sample_rate_hz)
    found = ViscoelasticEngine(structure="standard-linear-solid").fit(holed).report
    assert found.parameters["relaxation_time_s"].value == pytest.approx(0.01, rel=0.02)


def test_damping_parallel_to_relaxing_skin():
    bench = Bench("skin-anterior-relaxing", seed=2)
    noise = Noise(seed=1, force_min_n=5.0, force_max_n=6.0).build().values
    force = np.concatenate([np.full(1000, 5.5), noise])
    codes_of = bench.block(VOLTS_PER_NEWTON * force, energised=True).codes[1000:]
    current, position = (
        channel.decode(codes_of[:, k]) for k, channel in enumerate(bench.channels) if channel.name in _SIGNALS
    )
    found = ViscoelasticEngine().fit(Record(3.0 * current, position, 2000.0)).report.parameters
    depth = float(position.mean()) - bench.tissue.surface_m
    true = {
        "relaxation_time_s": 0.03,
        "stiffness_n_per_m": bench.tissue.tangent_stiffness(depth),
        "spring_1_n_per_m": 0.68 * bench.tissue.tangent_stiffness(depth),
    }
    for name, value in true.items():
        assert found[name].std < 0.15 * value, name
        assert found[name].value == pytest.approx(value, abs=2.5 * found[name].std), name


_SIGNALS = ("current", "position")


@pytest.mark.soak
@pytest.mark.parametrize("structure", STRUCTURES)
def test_ten_records_of_each_structure(structure: str):
    true = {name: value for name, value in true_values(structure).items() if name.endswith("time_s")}
    chosen = 0
    for seed in range(10):
        model = ViscoelasticEngine().fit(simulated.record(structure, 100 + seed))
        if model.report.model == structure:
            chosen += 1
            for name, value in true.items():
                assert model.report.parameters[name].value == pytest.approx(value, rel=0.01), (name, seed)
    assert chosen >= 8
