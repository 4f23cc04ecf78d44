"""Block structures: recovered when asked for, named when the record speaks for one, and not named when it does not."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from coded import Refusal, codes, refused, says
from identification import simulated_blocks
from identification.simulated import changed

from tissueid.errors import UnusableInputError
from tissueid.identification import validated
from tissueid.identification.cascades.blocks import (
    Blocks,
    Structure,
    cascade_data,
    lag_basis,
    prepare_cascade,
    run,
    slopes,
)
from tissueid.identification.cascades.fit import fit_structures
from tissueid.identification.cascades.structure_selection import StructureCandidate, StructureChoice, structure_findings
from tissueid.identification.engines.cascade import Cascade, CascadeModel
from tissueid.messages import code_of
from tissueid.records import Record, joined

MEMORY = 0.06
LAGS = 120
N = 4000
FITTED, HELD_OUT = slice(0, 3000), slice(3000, None)


def _fit(system: str, *seed: int, n: int = N, **options: object) -> tuple[simulated_blocks.Simulated, CascadeModel]:
    simulated = simulated_blocks.simulate(system, *seed, n=n)
    return simulated, Cascade.from_options({"memory": MEMORY} | options).fit(simulated.record)


@pytest.mark.parametrize("system", simulated_blocks.BLOCKS)
def test_every_structure_is_recovered_and_simulates_held_out_samples_to_the_noise(system: str):
    name = simulated_blocks.true_name(system)
    simulated = simulated_blocks.simulate(system, 80, n=6000)
    engine = Cascade(memory=MEMORY, structure=name)
    model = validated(engine.fit(simulated.record, slice(0, 4500)), simulated.record, slice(4500, None))
    assert model.structure == name
    assert model.choice is None
    clean = simulated.clean[4500:]
    assert np.var(clean - model.simulate(simulated.record.input)[4500:]) / np.var(clean) < 5e-4
    assert model.report.vaf_validation_percent > 99.8  # the noise is 0.1 %
    dynamics = model.first_kernel if model.second_kernel is None else model.second_kernel
    assert simulated_blocks.apart(dynamics / dynamics.sum(), simulated_blocks.kernel(LAGS)) < (
        0.15 if name == "lnl" else 0.03
    )


@pytest.mark.parametrize("system", [*simulated_blocks.BLOCKS, "dpn"])
def test_the_record_names_its_own_structure_and_a_dpn_system_is_given_no_name(system: str):
    _, model = _fit(system, 81, n=3000)
    finding = model.report.findings[0]
    if system == "dpn":
        assert not model.choice.confident
        assert code_of(finding) == "cascade.none_complete"
        assert "cascade.incomplete" in codes(model.report.warnings)
    else:
        assert model.choice.confident, finding
        assert model.structure == simulated_blocks.true_name(system)
        named = "a linear system" if system == "linear" else f"system, {'a' if system[0] == 'h' else ''}"
        assert named in finding
    assert {one.structure for one in model.choice.candidates} == {"linear", "wiener", "hammerstein", "lnl", "nln"}


def test_noise_takes_names_away_and_gives_no_wrong_ones():
    said = []
    for seed in range(2):
        simulated = simulated_blocks.simulate("wiener exponential", 82, seed, n=1000, snr_db=-6.0)
        model = Cascade(memory=MEMORY).fit(simulated.record)
        said.append(model.structure if model.choice.confident else "no name")
    assert set(said) <= {"no name", "linear", "wiener"}
    assert "linear" in said


def test_what_is_not_told_apart_is_said_not_to_be():
    wiener = StructureCandidate(
        "wiener", 90.0, -100.0, 0.5, 0.1, alike=True, unexplained_percent=0.1, unexplained_p_value=0.4
    )
    level = replace(wiener, structure="hammerstein", vaf_held_out_percent=90.1, behind=0.0)
    choice = StructureChoice("hammerstein", (wiener, level), ("wiener", "hammerstein"), determined=False, complete=True)
    assert not choice.confident
    (finding,) = structure_findings(choice)
    assert says(finding, "cascade.undetermined")
    assert finding.values["names"].items == ("a Wiener system", "a Hammerstein system")
    linear = replace(wiener, structure="linear", vaf_held_out_percent=90.2, unexplained_p_value=1e-3)
    (finding,) = structure_findings(replace(choice, candidates=(linear, level), alike=("hammerstein",)))
    assert says(finding, "cascade.undetermined")
    assert finding.values["names"].items == ("a linear system", "a Hammerstein system")


def test_curves_and_kernels_are_told_with_their_gains_where_they_mean_something():
    simulated, model = _fit("nln", 83, structure="nln", n=6000)
    assert model.inner is not None
    assert model.outer is not None
    assert model.first_kernel.sum() == pytest.approx(1.0)
    x = simulated.record.input
    assert np.std(model.inner(x)) / np.std(x) == pytest.approx(1.0, abs=0.02)
    assert model.inner(np.array([model.input_mean]))[0] == pytest.approx(0.0, abs=1e-12)
    assert model.outer(np.zeros(1))[0] == pytest.approx(0.0, abs=1e-12)
    force = np.linspace(0.0, 6.0, 40)
    truth = np.tanh(0.5 * (force - simulated_blocks.MEAN_FORCE) / simulated_blocks.FORCE_SPREAD)
    ours = model.inner(force)
    fit = np.polyval(np.polyfit(truth, ours, 1), truth)
    assert np.max(np.abs(ours - fit)) < 0.03 * np.ptp(ours)


def test_mass_damping_and_stiffness_are_those_at_the_mean_input():
    for system in ("wiener exponential", "hammerstein exponential", "linear"):
        _, model = _fit(system, 84, structure=simulated_blocks.true_name(system))
        stiffness = 1000.0
        if system != "linear":
            stiffness = np.exp(simulated_blocks.C2 * model.input_mean) / (simulated_blocks.C1 * simulated_blocks.C2)
        truth = {
            "stiffness_n_per_m": stiffness,
            "mass_kg": simulated_blocks.SCALED_MASS * stiffness,
            "damping_n_s_per_m": simulated_blocks.SCALED_DAMPING * stiffness,
        }
        for name, value in truth.items():
            estimate = model.report.parameters[name]
            assert abs(estimate.value - value) < 3.5 * estimate.std, (system, name)
            assert estimate.value == pytest.approx(value, rel=0.02)


def test_a_curve_that_is_flat_at_rest_leaves_no_stiffness_to_trust():
    _, model = _fit("wiener square", 85, structure="wiener")
    assert "hammerstein.flat" in codes(model.report.warnings)
    assert model.report.parameters["stiffness_n_per_m"].std is None


@pytest.mark.parametrize("name", ["linear", "wiener", "hammerstein", "lnl", "nln"])
def test_slopes_are_those_of_the_simulation(name: Structure):
    record = simulated_blocks.simulate("nln", 86, n=1500).record
    prepared, spacing = prepare_cascade(record, None, 60, 119, lambda q: q)
    data = cascade_data(prepared, 60, spacing)
    blocks: Blocks = fit_structures(data, "polynomial", 3, (name,))[name].blocks
    ours = slopes(blocks, data, run(blocks, data))
    vector = blocks.vector
    for place in range(0, vector.size, 3):
        step = np.zeros(vector.size)
        step[place] = 1e-5 * max(np.abs(vector[place]), 1e-3 * np.max(np.abs(vector[1:])))
        above = run(blocks.with_vector(vector + step), data).output[data.rows]
        below = run(blocks.with_vector(vector - step), data).output[data.rows]
        numerical = (above - below) / (2.0 * step[place])
        np.testing.assert_allclose(
            ours[place], numerical, rtol=1e-5, atol=2e-5 * float(np.max(np.abs(ours[place]))) + 2e-9
        )


def test_richer_structures_are_never_worse_in_sample():
    record = simulated_blocks.simulate("dpn", 87, n=N).record
    prepared, spacing = prepare_cascade(record, None, LAGS, 2 * LAGS - 1, lambda q: q)
    data = cascade_data(prepared, LAGS, spacing)
    found = fit_structures(data, "polynomial", 5, ("linear", "wiener", "hammerstein", "nln"))
    assert found["nln"].rss <= min(found["wiener"].rss, found["hammerstein"].rss) * 1.001
    assert max(found["wiener"].rss, found["hammerstein"].rss) <= found["linear"].rss * 1.001


@pytest.mark.parametrize("structure", ["wiener", "lnl"])
def test_gaps_leave_their_memory_unknown_and_joined_records_stay_apart(structure: str):
    simulated = simulated_blocks.simulate("wiener exponential", 88, n=3000)
    # within the memory of what was not received: not looked at
    u = changed(simulated.record.input, (np.s_[1500:1503], np.nan))
    y = changed(simulated.record.output, (np.s_[1503:1600], 0.0))
    engine = Cascade.from_options({"memory": MEMORY, "structure": structure})
    model = engine.fit(Record(u, y, 2000.0))
    whole = 2 * LAGS - 1 if structure == "lnl" else LAGS
    assert model.memory_samples == whole
    assert model.report.n_samples == 3000 - 3 - 2 * (whole - 1)
    assert model.report.vaf_percent > 99.8
    unknown = np.flatnonzero(np.isnan(model.simulate(u)))
    np.testing.assert_array_equal(unknown, np.arange(1500, 1503 + whole - 1))
    other = simulated_blocks.simulate("wiener exponential", 89, n=1500).record
    both = engine.fit(joined([simulated.record[:1500], other]))
    assert both.report.n_samples == 2 * (1500 - whole + 1)
    assert both.report.vaf_percent > 99.8


def test_simulation_rests_at_the_operating_point_and_sees_the_input_alone():
    simulated, model = _fit("lnl", 90, structure="lnl")
    np.testing.assert_allclose(model.simulate(np.full(900, model.input_mean)), model.offset, atol=1e-12)
    forgotten = Record(simulated.record.input, np.zeros(N), 2000.0)
    np.testing.assert_array_equal(model.predict(forgotten, 1), model.simulate(simulated.record.input))


def test_the_report_can_be_written():
    _, model = _fit("hammerstein exponential", 91)
    report = model.report.as_dict()
    assert json.loads(json.dumps(report, allow_nan=False)) == report
    assert {"mass_kg", "damping_n_s_per_m", "stiffness_n_per_m"} <= set(report["parameters"])
    assert report["details"]["vaf_held_out_hammerstein_percent"] > report["details"]["vaf_held_out_wiener_percent"]


def test_the_basis_holds_smooth_responses_and_becomes_the_lags_themselves():
    kernel = simulated_blocks.kernel(250)
    basis = lag_basis(250, 3.5)
    assert basis.shape[1] < 40
    fitted = basis @ np.linalg.lstsq(basis, kernel, rcond=None)[0]
    assert simulated_blocks.apart(fitted, kernel) < 1e-3
    np.testing.assert_array_equal(lag_basis(6, 1.0), np.eye(6))


@pytest.mark.parametrize(
    ("record", "refusal"),
    [
        (Record(np.ones(4000), np.arange(4000.0), 2000.0), Refusal("record.constant", signal="the input (force)")),
        (Record(np.arange(4000.0), np.ones(4000), 2000.0), Refusal("record.constant", signal="the output (position)")),
        (
            Record(np.full(4000, np.nan), np.arange(4000.0), 2000.0),
            Refusal("record.no_sample", signal="the input (force)"),
        ),
        (Record(np.arange(100.0), np.arange(100.0), 2000.0), Refusal("record.shorter_than_memory", seconds=0.05)),
        (Record(np.arange(510.0) ** 2, np.arange(510.0), 2000.0), Refusal("record.too_few_samples", count=12)),
    ],
)
def test_records_that_carry_no_fit_are_refused(record: Record, refusal: Refusal):
    with pytest.raises(UnusableInputError, check=refusal.check):
        Cascade().fit(record)


def test_an_input_of_two_values_leaves_out_the_structures_that_begin_with_a_curve():
    rng = simulated_blocks.generator(93)
    u = np.sign(rng.standard_normal(3000))
    y = np.convolve(u, np.exp(-np.arange(40) / 8.0))[:3000]
    record = Record(u, y + 0.01 * rng.standard_normal(3000), 2000.0)
    model = Cascade(memory=0.03).fit(record)
    assert model.structure == "linear"
    assert "cascade.not_tried" in codes(model.report.warnings)
    refused(lambda: Cascade(memory=0.03, structure="nln").fit(record), "hammerstein.few_levels", levels=2)


def test_a_record_that_answers_nothing_is_given_no_name():
    rng = simulated_blocks.generator(94)
    record = Record(rng.standard_normal(1000), rng.standard_normal(1000), 2000.0)
    model = Cascade(memory=0.01).fit(record)
    assert not model.choice.confident
    assert code_of(model.report.findings[0]) == "cascade.nothing_explained"


def test_bad_options_are_told():
    refused(lambda: Cascade.from_options({"structure": "nlnl"}), "option.refused", option="structure")


@pytest.mark.soak
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("snr_db", "colour"), [(30.0, 0.0), (30.0, 0.9), (20.0, 0.0)])
def test_names_over_20_seeds(snr_db: float, colour: float):
    wrong = 0
    for system in (*simulated_blocks.BLOCKS, "dpn"):
        said: Counter[str] = Counter()
        for run_number in range(20):
            record = simulated_blocks.simulate(system, 92, run_number, snr_db=snr_db, colour=colour, n=N).record
            model = Cascade(memory=MEMORY).fit(record)
            said[model.structure if model.choice.confident else "no name"] += 1
        right = "no name" if system == "dpn" else simulated_blocks.true_name(system)
        print(system, snr_db, colour, dict(said))
        wrong += 20 - said[right]
        assert said[right] >= 17, (system, said)
    assert wrong <= 8
