"""The Hammerstein engine on systems whose curve and dynamics are known."""

from __future__ import annotations

import numpy as np
import pytest
from coded import Refusal, codes, refused
from identification import simulated_blocks
from identification.simulated import changed
from scipy import stats

from tissueid.errors import UnusableInputError
from tissueid.identification import get_engine, validated
from tissueid.identification.engines.hammerstein import Hammerstein, HammersteinModel
from tissueid.identification.engines.lms import Lms
from tissueid.identification.engines.wiener import Wiener
from tissueid.records import Record, joined

LAGS = 250
FITTED, HELD_OUT = slice(0, 6000), slice(6000, None)


@pytest.fixture(scope="module")
def bent() -> simulated_blocks.Simulated:
    return simulated_blocks.simulate("hammerstein exponential", 1)


@pytest.fixture(scope="module")
def square() -> simulated_blocks.Simulated:
    return simulated_blocks.simulate("hammerstein square", 2)


@pytest.fixture(scope="module")
def model(bent: simulated_blocks.Simulated) -> HammersteinModel:
    return Hammerstein().fit(bent.record, FITTED)


@pytest.mark.parametrize("form", ["polynomial", "spline", "exponential"])
def test_an_exponential_before_the_dynamics_is_recovered(bent: simulated_blocks.Simulated, form: str):
    model = validated(Hammerstein.from_options({"nonlinearity": form}).fit(bent.record, FITTED), bent.record, HELD_OUT)
    assert model.kernel.sum() == pytest.approx(1.0)
    assert simulated_blocks.apart(model.kernel, simulated_blocks.kernel(LAGS)) < 0.02
    force = np.linspace(-1.0, 7.0, 50)
    truth = simulated_blocks.exponential(force) - simulated_blocks.exponential(np.array([model.input_mean]))
    np.testing.assert_allclose(model.nonlinearity(force), truth, atol=0.01 * np.ptp(truth))
    assert model.nonlinearity(np.array([model.input_mean]))[0] == pytest.approx(0.0, abs=1e-12)
    clean = bent.clean[HELD_OUT]
    missed = np.var(clean - model.simulate(bent.record.input)[HELD_OUT]) / np.var(clean)
    assert missed < 1e-4
    assert model.report.vaf_validation_percent > 99.8  # the noise is 0.1 %


def test_constants_mass_damping_and_stiffness_at_the_mean_load(bent: simulated_blocks.Simulated):
    model = Hammerstein(nonlinearity="exponential").fit(bent.record)
    parameters = model.report.parameters
    stiffness = np.exp(simulated_blocks.C2 * model.input_mean) / (simulated_blocks.C1 * simulated_blocks.C2)
    truth = {
        "c1_m": simulated_blocks.C1,
        "c2_per_n": simulated_blocks.C2,
        "offset_m": 0.01,
        "stiffness_n_per_m": stiffness,
        "mass_kg": simulated_blocks.SCALED_MASS * stiffness,
        "damping_n_s_per_m": simulated_blocks.SCALED_DAMPING * stiffness,
    }
    for name, value in truth.items():
        assert parameters[name].value == pytest.approx(value, rel=0.01), name
        assert parameters[name].std is not None, name


@pytest.mark.parametrize("form", ["polynomial", "spline"])
def test_a_square_is_found_though_it_turns_back_and_hides_its_linear_part(
    square: simulated_blocks.Simulated, form: str
):
    model = validated(
        Hammerstein.from_options({"nonlinearity": form}).fit(square.record, FITTED), square.record, HELD_OUT
    )
    assert simulated_blocks.apart(model.kernel, simulated_blocks.kernel(LAGS)) < 0.02
    force = np.linspace(-5.0, 5.0, 50)
    truth = 1e-3 * (force**2 - model.input_mean**2)
    np.testing.assert_allclose(model.nonlinearity(force), truth, atol=0.01 * np.ptp(truth))
    assert model.report.vaf_validation_percent > 99.8
    assert "hammerstein.not_monotone" in codes(model.report.findings)
    assert "hammerstein.flat" in codes(model.report.warnings)
    assert Lms().fit(square.record).report.vaf_percent < 20.0


def test_a_straight_system_is_said_to_be_straight():
    record = simulated_blocks.simulate("linear", 3).record
    report = Hammerstein(nonlinearity="exponential").fit(record).report
    assert "hammerstein.straight" in codes(report.findings)
    assert report.parameters["stiffness_n_per_m"].value == pytest.approx(1000.0, rel=0.01)


def test_it_beats_the_wiener_engine_on_its_own_kind_and_not_on_the_other(bent: simulated_blocks.Simulated):
    other = simulated_blocks.simulate("wiener exponential", 4).record
    assert Hammerstein().fit(bent.record).report.vaf_percent > Wiener().fit(bent.record).report.vaf_percent + 3.0
    assert Hammerstein().fit(other).report.vaf_percent < Wiener().fit(other).report.vaf_percent - 1.0


def test_history_tells_every_pass_and_the_refinement_is_never_worse(bent: simulated_blocks.Simulated):
    passed = Hammerstein(refine=False, iterations=4).fit(bent.record)
    assert [entry.iteration for entry in passed.history] == [1, 2, 3, 4]
    assert not passed.refined
    best = max(passed.history, key=lambda entry: entry.nonlinear_vaf_percent)
    assert passed.chosen == best.iteration == passed.report.details["chosen_iteration"]
    assert passed.report.vaf_percent == pytest.approx(best.nonlinear_vaf_percent, abs=1e-3)
    assert set(best.parameters) == {"scaled_mass_s2", "scaled_damping_s"}
    assert Hammerstein(iterations=4).fit(bent.record).report.vaf_percent >= passed.report.vaf_percent


def test_a_kernel_without_steady_gain_is_normalised_by_its_size():
    rng = simulated_blocks.generator(5)
    u = rng.standard_normal(4000)
    driven = u + 0.5 * u**2
    y = np.convolve(driven, [1.0, -1.0])[:4000]
    model = Hammerstein(memory=0.01, degree=2).fit(Record(u, y + 0.01 * rng.standard_normal(4000), 2000.0))
    assert not model.steady_gain
    assert np.linalg.norm(model.kernel) == pytest.approx(1.0)
    np.testing.assert_allclose(model.kernel[:3], np.array([1.0, -1.0, 0.0]) / np.sqrt(2.0), atol=0.01)
    assert model.report.vaf_percent > 99.9


def test_gaps_are_skipped_and_joined_records_stay_apart(bent: simulated_blocks.Simulated):
    record = bent.record
    # within the memory of what was not received: not looked at
    u = changed(record.input, (np.s_[3000:3007], np.nan))
    y = changed(record.output, (np.s_[3007:3200], 0.0))
    holed = Hammerstein().fit(Record(u, y, record.sample_rate_hz))
    assert holed.report.n_samples == 8000 - 249 - 7 - 249
    assert simulated_blocks.apart(holed.kernel, simulated_blocks.kernel(LAGS)) < 0.02
    simulated = holed.simulate(u)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(simulated)), np.arange(3000, 3007 + 249))
    second = simulated_blocks.simulate("hammerstein exponential", 6, n=3000).record
    both = joined([record[:3000], second])
    model = Hammerstein().fit(both)
    assert model.report.n_samples == 2 * (3000 - 249)
    assert simulated_blocks.apart(model.kernel, simulated_blocks.kernel(LAGS)) < 0.03


def test_simulation_rests_at_the_operating_point_before_the_record(model: HammersteinModel):
    output = model.simulate(np.full(1000, model.input_mean))
    np.testing.assert_allclose(output, model.offset, atol=1e-12)


def test_parameters_are_counted_and_options_come_back(model: HammersteinModel):
    assert model.report.n_parameters == int(model.report.details["kernel_functions"]) + 5
    options = model.report.as_dict()["options"]
    assert get_engine("hammerstein").from_options(options) == Hammerstein(memory=0.125, hold="band-limited")


def test_other_units_get_plain_names(bent: simulated_blocks.Simulated):
    volts = Record(bent.record.input, bent.record.output, 2000.0, "command", "position", "V", "m")
    parameters = Hammerstein(nonlinearity="exponential").fit(volts).report.parameters
    assert {"c1", "c2", "c3", "offset", "gain"} <= set(parameters)
    assert "mass_kg" not in parameters


@pytest.mark.parametrize(
    ("record", "refusal"),
    [
        (Record(np.ones(4000), np.arange(4000.0), 2000.0), Refusal("record.constant", signal="the input (force)")),
        (Record(np.arange(4000.0), np.ones(4000), 2000.0), Refusal("record.constant", signal="the output (position)")),
        (
            Record(np.full(4000, np.nan), np.arange(4000.0), 2000.0),
            Refusal("record.no_sample", signal="the input (force)"),
        ),
        (
            Record(np.arange(100.0), np.arange(100.0), 2000.0),
            Refusal("record.shorter_than_memory", memory=0.125, seconds=0.05),
        ),
        (Record(np.arange(260.0) ** 2, np.arange(260.0), 2000.0), Refusal("record.too_few_samples", count=11)),
    ],
)
def test_records_that_carry_no_fit_are_refused(record: Record, refusal: Refusal):
    with pytest.raises(UnusableInputError, check=refusal.check):
        Hammerstein().fit(record)


def test_an_input_of_two_values_determines_no_curve():
    rng = simulated_blocks.generator(8)
    u = np.sign(rng.standard_normal(3000))
    record = Record(u, np.convolve(u, np.exp(-np.arange(40) / 8.0))[:3000], 2000.0)
    refused(lambda: Hammerstein(memory=0.03).fit(record), "hammerstein.few_levels", levels=2, coefficients=6)
    straight = Hammerstein(memory=0.03, degree=1).fit(record).report
    assert straight.vaf_percent > 99.9
    assert "hammerstein.straight" in codes(straight.findings)


def test_few_samples_warn(bent: simulated_blocks.Simulated):
    report = Hammerstein().fit(bent.record[:330]).report
    assert "record.few_samples" in codes(report.warnings)


def _coverage(runs: int, form: str, colour: float) -> dict[str, float]:
    inside: dict[str, list[float]] = {}
    truth_kernel = simulated_blocks.kernel(LAGS)
    places = np.array([-0.5, 1.0, 5.0])
    for run in range(runs):
        record = simulated_blocks.simulate("hammerstein exponential", 7, run, colour=colour).record
        model = Hammerstein.from_options({"nonlinearity": form, "iterations": 2}).fit(record)
        stiffness = np.exp(simulated_blocks.C2 * model.input_mean) / (simulated_blocks.C1 * simulated_blocks.C2)
        truth = {
            "stiffness_n_per_m": stiffness,
            "scaled_mass_s2": simulated_blocks.SCALED_MASS,
            "scaled_damping_s": simulated_blocks.SCALED_DAMPING,
            "mass_kg": simulated_blocks.SCALED_MASS * stiffness,
        }
        if form == "exponential":
            truth |= {"c1_m": simulated_blocks.C1, "c2_per_n": simulated_blocks.C2, "offset_m": 0.01}
        for name, value in truth.items():
            estimate = model.report.parameters[name]
            inside.setdefault(name, []).append(abs(estimate.value - value) < 1.96 * estimate.std)
        near = np.abs(model.kernel - truth_kernel) < 1.96 * model.kernel_std
        inside.setdefault("kernel, first 60 lags", []).append(float(np.mean(near[:60])))
        inside.setdefault("kernel, all lags", []).append(float(np.mean(near)))
        curve = model.nonlinearity
        spread = curve.jacobian(places)
        std = np.sqrt(np.einsum("ij,jk,ik->i", spread, model.nonlinearity_covariance, spread))
        off = curve(places) - simulated_blocks.exponential(places)
        off += simulated_blocks.exponential(np.array([model.input_mean]))
        inside.setdefault("curve", []).append(float(np.mean(np.abs(off) < 1.96 * std)))
    return {name: float(np.mean(values)) for name, values in inside.items()}


@pytest.mark.soak
def test_intervals_hold_the_truth():
    runs = 16
    covered = _coverage(runs, "exponential", 0.0)
    low = stats.binom.ppf(0.0005, runs, 0.93) / runs
    assert all(share >= low for share in covered.values()), covered


@pytest.mark.soak
@pytest.mark.timeout(900)
@pytest.mark.parametrize("colour", [0.0, 0.9])
@pytest.mark.parametrize("form", ["exponential", "polynomial"])
def test_coverage_over_200_runs(form: str, colour: float):
    covered = _coverage(200, form, colour)
    print("\n", form, colour, {name: round(share, 3) for name, share in covered.items()})
    assert all(0.89 <= share <= 0.99 for share in covered.values())
