"""The Wiener engine, on the thesis' own simulated system and on finer ones."""

from __future__ import annotations

import numpy as np
import pytest
from coded import codes, refused
from identification import simulated
from scipy import stats

from tissueid.identification import validated
from tissueid.identification.engines.lms import Lms
from tissueid.identification.engines.wiener import Wiener
from tissueid.identification.static_nonlinearity import ExponentialCurve
from tissueid.records import Record


@pytest.fixture(scope="module")
def record() -> Record:
    return simulated.wiener_record(50)


@pytest.mark.parametrize(
    ("gain", "offset", "steps"),
    [
        pytest.param(1.0, -0.1, 1, id="as the thesis has it"),
        pytest.param(1.0, -0.1, 20, id="finely integrated"),
        pytest.param(5.0, 2.0, 20, id="finely integrated, strongly bent"),
    ],
)
@pytest.mark.parametrize("refined", [False, True], ids=["iterated", "refined"])
def test_constants_of_the_thesis_system(gain: float, offset: float, steps: int, refined: bool):
    record = simulated.thesis_wiener(1, gain=gain, offset=offset, steps=steps)
    model = Wiener(hold="zero-order", refine=refined, scaling=1000.0).fit(record)
    parameters = model.report.parameters
    simulated.near(parameters, 0.003, c1_m=0.007, c2_per_n=0.2)
    assert parameters["offset_m"].value == pytest.approx(0.0, abs=1e-5)
    if steps > 1:  # one Euler step a sample is another linear system than the equations it stands for
        simulated.near(parameters, 0.01, scaled_mass_s2=0.06, scaled_damping_s=20.0)
        assert model.second_order.system.damping_ratio > 1.2
    assert model.report.vaf_percent > 99.999
    assert model.report.vaf_percent > Lms().fit(record).report.vaf_percent


@pytest.mark.parametrize("form", ["exponential", "polynomial", "spline"])
def test_every_form_beats_the_line_on_held_out_samples(record: Record, form: str):
    line = validated(Lms().fit(record, slice(0, 6000)), record, slice(6000, None)).report
    model = Wiener.from_options({"nonlinearity": form}).fit(record, slice(0, 6000))
    bent = validated(model, record, slice(6000, None)).report
    assert bent.vaf_validation_percent > line.vaf_validation_percent + 1.0
    assert bent.vaf_validation_percent > 99.5
    stiffness = np.exp(simulated.C2 * model.input_mean) / (simulated.C1 * simulated.C2)
    assert bent.parameters["stiffness_n_per_m"].value == pytest.approx(stiffness, rel=0.02)
    simulated.near(
        bent.parameters,
        0.03,
        mass_kg=simulated.SCALED_MASS * stiffness,
        damping_n_s_per_m=simulated.SCALED_DAMPING * stiffness,
    )


def test_constants_under_noise_and_what_the_refinement_is_for(record: Record):
    refined = Wiener().fit(record).report
    assert refined.parameters["c1_m"].value == pytest.approx(simulated.C1, rel=0.01)
    assert refined.parameters["c2_per_n"].value == pytest.approx(simulated.C2, rel=0.02)
    simulated.near(
        refined.parameters,
        0.01,
        offset_m=simulated.SURFACE,
        scaled_mass_s2=simulated.SCALED_MASS,
        scaled_damping_s=simulated.SCALED_DAMPING,
    )
    iterated = Wiener(refine=False).fit(record).report
    assert refined.vaf_percent > iterated.vaf_percent
    assert iterated.vaf_percent > refined.details["vaf_linear_percent"]


@pytest.mark.soak
def test_refinement_makes_the_constants_better():
    errors: dict[bool, list[float]] = {True: [], False: []}
    for run in range(16):  # short records: the longer the record, the less is left to refine
        record = simulated.wiener_record(51, run, snr_db=20.0, n=1600)
        for refine, found in errors.items():
            estimate = Wiener(refine=refine).fit(record).report.parameters["c2_per_n"]
            found.append(estimate.value / simulated.C2 - 1.0)
    assert np.mean(np.square(errors[True])) < np.mean(np.square(errors[False]))


def _coverage(runs: int) -> tuple[list[str], np.ndarray]:
    truth = {
        "c1_m": simulated.C1,
        "c2_per_n": simulated.C2,
        "offset_m": simulated.SURFACE,
        "scaled_mass_s2": simulated.SCALED_MASS,
        "scaled_damping_s": simulated.SCALED_DAMPING,
    }
    inside = np.zeros(len(truth) + 1)
    for run in range(runs):
        model = Wiener(iterations=2).fit(simulated.wiener_record(52, run))
        stiffness = np.exp(simulated.C2 * model.input_mean) / (simulated.C1 * simulated.C2)
        for place, (name, value) in enumerate((truth | {"stiffness_n_per_m": stiffness}).items()):
            estimate = model.report.parameters[name]
            inside[place] += abs(estimate.value - value) < 1.96 * estimate.std
    return [*truth, "stiffness_n_per_m"], inside / runs


@pytest.mark.soak
def test_intervals_hold_the_truth():
    runs = 40
    names, covered = _coverage(runs)
    low, _ = np.array(stats.binom.interval(0.999, runs, 0.93)) / runs
    assert np.all(covered >= low), dict(zip(names, covered, strict=True))


@pytest.mark.soak
@pytest.mark.timeout(900)
def test_coverage_over_300_runs():
    names, covered = _coverage(300)
    print("\n", dict(zip(names, covered, strict=True)))
    assert np.all((covered > 0.90) & (covered < 0.98))


def test_z_is_in_absolute_newtons_and_g_in_metres(record: Record):
    model = Wiener().fit(record)
    assert model.kernel.sum() == pytest.approx(1.0)
    load = model.linear_output(record.input)[500:]
    assert np.mean(load) == pytest.approx(4.0, abs=0.1)
    np.testing.assert_allclose(model.nonlinearity(load), model.simulate(record.input)[500:])


def test_history_tells_every_pass_and_the_best_is_kept(record: Record):
    model = Wiener(iterations=4, refine=False).fit(record)
    assert [entry.iteration for entry in model.history] == [1, 2, 3, 4]
    best = max(model.history, key=lambda entry: entry.nonlinear_vaf_percent)
    assert model.chosen == best.iteration == model.report.details["chosen_iteration"]
    assert model.report.vaf_percent == pytest.approx(best.nonlinear_vaf_percent)
    assert model.history[0].linear_vaf_percent < model.history[1].linear_vaf_percent
    assert set(best.parameters) == {"scaled_mass_s2", "scaled_damping_s", "c1", "c2", "c3", "offset"}


def test_history_holds_the_linear_stage_of_every_pass(record: Record):
    history = Wiener(scaling=1000.0).fit(record).history
    for entry in history[1:]:
        assert entry.parameters["scaled_mass_s2"] == pytest.approx(1000.0 * simulated.SCALED_MASS, rel=0.01)
        assert entry.parameters["scaled_damping_s"] == pytest.approx(1000.0 * simulated.SCALED_DAMPING, rel=0.01)
    step = simulated.thesis_wiener(1, gain=5.0, offset=2.0, steps=20)
    last = Wiener(hold="zero-order", scaling=1000.0).fit(step).history[-1].parameters
    assert last["scaled_mass_s2"] == pytest.approx(0.06, rel=0.01)
    assert last["scaled_damping_s"] == pytest.approx(20.0, rel=0.01)


def test_a_known_surface_gives_c3(record: Record):
    lifted = Record(record.input - 0.59, record.output, record.sample_rate_hz)  # a load that the coil does not feel
    parameters = Wiener(surface_position_m=simulated.SURFACE).fit(lifted).report.parameters
    assert parameters["c3_n"].value == pytest.approx(0.59, abs=0.06)
    assert parameters["c3_n"].std is not None
    assert parameters["c1_m"].value == pytest.approx(simulated.C1, rel=0.01)
    assert parameters["offset_m"].std is None
    known = Wiener(c3_n=0.59).fit(lifted).report.parameters
    assert known["offset_m"].value == pytest.approx(simulated.SURFACE, rel=0.01)
    assert known["c3_n"].std is None


def test_a_straight_system_says_that_its_constants_are_not_determined():
    report = Wiener().fit(simulated.linear_record(53)).report
    assert "wiener.straight" in codes(report.warnings)
    simulated.near(report.parameters, 0.01, stiffness_n_per_m=simulated.STIFFNESS, mass_kg=simulated.MASS)


def test_a_curve_that_is_not_monotone_gives_a_warning_and_a_fit():
    record = simulated.linear_record(54, snr_db=60.0)
    load = (record.output - 0.012) / np.std(record.output)
    folded = Record(record.input, 1e-3 * (load + 0.8 * load**2), record.sample_rate_hz)
    report = Wiener(nonlinearity="polynomial", degree=2).fit(folded).report
    assert {"wiener.not_monotone", "wiener.partly_monotone"} & set(codes(report.warnings))
    assert report.vaf_percent > Lms().fit(folded).report.vaf_percent + 10.0


FOLDS = {
    "square": (2, lambda z: z**2),
    "square and a little": (2, lambda z: z**2 + 0.1 * z),
    "square off its middle": (2, lambda z: (z + 0.3) ** 2),
    "cubic": (3, lambda z: z**3 - 2.0 * z),
    "cubic without a linear part": (3, lambda z: z**3 - 3.0 * z),
    "quartic": (4, lambda z: z**4 - 2.0 * z**2),
    "sine": (9, lambda z: np.sin(2.0 * z)),
}


@pytest.mark.parametrize("name", FOLDS)
def test_a_curve_without_an_inverse_is_found_by_feedback(name: str):
    """The linear stage is a forearm's; for a Gaussian input, some of these curves have no linear part at all."""
    degree, fold = FOLDS[name]
    rng = simulated.generator(57)
    force, load = simulated.second_order(rng, simulated.SCALED_MASS, simulated.SCALED_DAMPING, 1.0, n=6000)
    size = np.std(load)
    clean = 1e-3 * fold(load / size)
    model = Wiener(nonlinearity="polynomial", degree=degree).fit(
        Record(force, clean + simulated.noise(rng, clean, 20.0), simulated.RATE)
    )
    report = model.report
    z = model.linear_output(force)
    assert np.corrcoef(z[500:], load[500:])[0, 1] > 0.999
    assert model.kernel.sum() == pytest.approx(1.0)
    assert np.std(z[500:]) == pytest.approx(size, rel=0.1)
    modelled = model.simulate(force)
    assert 1.0 - np.var(clean[500:] - modelled[500:]) / np.var(clean[500:]) > 0.995
    simulated.near(
        report.parameters, 0.05, scaled_mass_s2=simulated.SCALED_MASS, scaled_damping_s=simulated.SCALED_DAMPING
    )
    assert "wiener.feedback" in codes(report.findings)
    assert {"wiener.not_monotone", "wiener.partly_monotone"} & set(codes(report.warnings))
    assert 1 <= len(model.history) <= 6
    assert report.vaf_percent >= max(entry.nonlinear_vaf_percent for entry in model.history) - 1e-6


def test_an_inverse_is_taken_wherever_there_is_one(record: Record):
    report = Wiener(nonlinearity="polynomial").fit(record).report
    assert report.findings == ()


def test_a_curve_without_an_inverse_across_a_gap():
    rng = simulated.generator(58)
    force, load = simulated.second_order(rng, simulated.SCALED_MASS, simulated.SCALED_DAMPING, 1.0, n=6000)
    u, y = force.copy(), (load / np.std(load)) ** 2
    u[3000:3005] = np.nan
    y[3005:3200] = 50.0  # what rests on a missing input may be anything
    model = Wiener(nonlinearity="polynomial", degree=2).fit(Record(u, y, simulated.RATE))
    assert model.report.vaf_percent > 99.9
    assert np.corrcoef(model.linear_output(force)[500:], load[500:])[0, 1] > 0.999


def test_divergence_gives_a_warning_and_the_best_pass_is_kept():
    rng = simulated.generator(55)
    u = rng.standard_normal(4000)
    even = Record(u, np.convolve(u, np.exp(-np.arange(60) / 10.0))[:4000] ** 2, 2000.0)
    model = Wiener(memory=0.05).fit(even)
    assert {"wiener.diverged", "wiener.not_monotone", "wiener.partly_monotone"} & set(codes(model.report.warnings))
    best = max(entry.nonlinear_vaf_percent for entry in model.history)
    assert model.report.vaf_percent >= best - 1e-9


def test_a_system_without_steady_gain_is_refused():
    rng = simulated.generator(56)
    u = rng.standard_normal(4000)
    y = np.convolve(u, [1.0, -1.0])[:4000] + 0.1 * rng.standard_normal(4000)
    refused(lambda: Wiener(memory=0.02).fit(Record(u, y, 2000.0)), "wiener.no_gain")


def test_gaps_are_skipped(record: Record):
    u = simulated.changed(record.input, (np.s_[3000:3007], np.nan))
    y = simulated.changed(record.output, (np.s_[3000:3007], np.nan), (np.s_[3007:3200], 0.0))
    report = Wiener().fit(Record(u, y, record.sample_rate_hz)).report
    assert report.n_samples == 8000 - 249 - 7 - 249
    assert report.vaf_percent > 99.5
    assert report.parameters["c1_m"].value == pytest.approx(simulated.C1, rel=0.01)


def test_other_units_get_plain_names(record: Record):
    volts = Record(record.input, record.output, record.sample_rate_hz, "command", "position", "V", "m")
    parameters = Wiener().fit(volts).report.parameters
    assert {"c1", "c2", "c3", "offset", "gain", "scaled_mass_s2"} <= set(parameters)
    assert "mass_kg" not in parameters
    assert isinstance(Wiener().fit(volts).nonlinearity, ExponentialCurve)


def test_the_last_lags_of_a_cascade_carry_nothing_of_their_own(record: Record):
    """With and without the refinement; what is left there without ridge and further lags is of the peak's size."""
    load = record.output - record.output.mean()
    harder = Record(record.input, record.output + 40.0 * load**2, record.sample_rate_hz)  # more than the curve can bend
    for refine in (False, True):
        for part in (slice(0, 6000), slice(0, 1500)):
            kernel = Wiener(refine=refine).fit(harder, part).kernel
            assert np.max(np.abs(kernel[-10:])) < 0.1 * np.max(np.abs(kernel))
