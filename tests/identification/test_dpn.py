"""The engine of Eq. 3.33 on tissue that follows it, on tissue that does not, and on records that hold too little."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from coded import Refusal, codes, refused
from identification import simulated, simulated_dpn
from outside_data import RIG
from scipy import interpolate, stats

from tissueid.errors import UnusableInputError
from tissueid.identification import validated
from tissueid.identification.dpn.curves import LogCurves
from tissueid.identification.dpn.fit import DpnData
from tissueid.identification.dpn.simulation import simulate_dpn, tabulate_curves
from tissueid.identification.engines.dpn import Dpn, DpnModel
from tissueid.identification.engines.wiener import Wiener
from tissueid.messages import code_of
from tissueid.records import Record, joined

TISSUES = {
    "skin": simulated_dpn.SKIN,
    "growing mass": simulated_dpn.GROWING,
    "the thesis' constants": simulated_dpn.THESIS,
}
DEPTHS = np.linspace(0.05, 0.95, 19)


def _errors(model: DpnModel, record: Record, tissue: simulated_dpn.Tissue) -> np.ndarray:
    """Largest relative error of M, B and K over the central 90 % of the depths, shape (3,)."""
    y = np.nanquantile(record.output, DEPTHS)
    known = model.estimated
    found = known.mass(y).value, known.damping(y).value, known.stiffness(y).value
    truth = tissue.masses(y), tissue.dampings(y), tissue.tangents(y)
    return np.array([np.max(np.abs(f / t - 1.0)) for f, t in zip(found, truth, strict=True)])


@lru_cache(maxsize=16)
def _fitted(name: str) -> tuple[Record, DpnModel]:
    record = simulated_dpn.record(TISSUES[name], 1)
    return record, Dpn().fit(record)


# --- simulation ------------------------------------------------------------------------------------------------------


def _table(tissue: simulated_dpn.Tissue, low: float = 0.009, high: float = 0.014) -> tuple[np.ndarray, ...]:
    y = np.linspace(low, high, 101)
    return y, tissue.masses(y), tissue.dampings(y), tissue.forces(y)


@pytest.mark.parametrize("name", list(TISSUES))
def test_tabulated_curves_move_as_the_plain_loop_does(name: str):
    force, position = simulated_dpn.clean(TISSUES[name], (1,))
    run = simulate_dpn(tabulate_curves(*_table(TISSUES[name])), force, simulated_dpn.RATE, rest_input=4.0)
    assert run.diverged_at is None
    error = (run.position - position)[1000:-20]
    assert np.max(np.abs(error)) < 2e-4 * np.std(position)
    speed = interpolate.CubicSpline(np.arange(position.size) / simulated_dpn.RATE, position)(
        np.arange(position.size) / simulated_dpn.RATE, 1
    )
    assert np.max(np.abs((run.speed - speed)[1000:-20])) < 0.01 * np.std(speed)


def test_a_held_force_at_500_hz_moves_as_the_plain_loop_does():
    force, position = simulated_dpn.clean_held(simulated_dpn.THESIS, (1,))
    curves = tabulate_curves(*_table(simulated_dpn.THESIS))
    run = simulate_dpn(curves, force, simulated_dpn.SLOW_RATE, rest_input=4.0, hold="zero-order")
    assert np.max(np.abs((run.position - position)[500:])) < 2e-4 * np.std(position)


def test_every_run_of_input_begins_at_rest():
    curves = tabulate_curves(*_table(simulated_dpn.SKIN))
    u = np.full(300, 4.0)
    u[100:110] = np.nan
    run = simulate_dpn(curves, u, 2000.0)
    assert np.array_equal(np.isnan(run.position), np.isnan(u))
    depth = run.position[0] - simulated_dpn.SURFACE
    assert simulated_dpn.SKIN.forces(np.array([run.position[0]]))[0] == pytest.approx(4.0, abs=1e-4)
    assert 0.001 < depth < 0.003
    np.testing.assert_allclose(run.position[np.isfinite(u)], run.position[0], atol=1e-12)


def test_a_steady_force_beyond_the_table_is_borne_on_its_straight_end():
    y = np.array([0.0, 0.001, 0.002])
    curves = tabulate_curves(y, np.full(3, 0.05), np.full(3, 10.0), 2000.0 * y)
    for force in (-3.0, 9.0):
        run = simulate_dpn(curves, np.full(50, force), 2000.0)
        np.testing.assert_allclose(run.position, force / 2000.0, rtol=1e-6)


def test_a_diverging_motion_is_stopped_and_told():
    # A mass that falls by ten times over 2 mm, at a resonance without damping: each swing throws it further.
    y = np.linspace(-0.001, 0.001, 21)
    curves = tabulate_curves(y, 0.05 * np.exp(-1200.0 * y), np.zeros(21), 2000.0 * y)
    u = 1e3 * np.sin(2 * np.pi * 20.0 * np.arange(4000) / 2000.0)
    run = simulate_dpn(curves, u, 2000.0)
    assert np.all(np.isfinite(run.position))
    np.testing.assert_array_equal(run.position[run.diverged_at :], run.position[-1])


@pytest.mark.parametrize(
    ("changed", "code"),
    [
        ({"position": np.array([0.0, 0.0, 1.0])}, "dpn.bad_positions"),
        ({"force": np.array([0.0, 1.0, 0.5])}, "dpn.falling_force"),
        ({"mass": np.array([0.1, 0.0, 0.1])}, "dpn.bad_mass"),
        ({"damping": np.array([-1.0, 1.0, 1.0])}, "dpn.bad_mass"),
    ],
)
def test_curves_that_no_tissue_has_are_refused(changed: dict[str, np.ndarray], code: str):
    plain = {"position": np.arange(3.0), "mass": np.ones(3), "damping": np.ones(3), "force": np.arange(3.0)}
    refused(lambda: tabulate_curves(**(plain | changed)), code)


def test_curves_too_stiff_for_the_sample_rate_and_missing_input_are_refused():
    y = np.array([0.0, 0.001])
    stiff = tabulate_curves(y, np.full(2, 1e-6), np.full(2, 10.0), 2000.0 * y)
    refused(lambda: simulate_dpn(stiff, np.ones(10), 2000.0), "dpn.too_stiff")
    refused(
        lambda: simulate_dpn(tabulate_curves(y, np.ones(2), np.ones(2), y), np.full(10, np.nan), 2000.0), "dpn.no_input"
    )


@pytest.mark.parametrize("extended", [False, True], ids=["Eq. 3.33", "with direction and inertia"])
def test_slopes_are_those_of_the_simulated_output(extended: bool):
    record = simulated_dpn.record(simulated_dpn.GROWING, 3)[:1500]
    data = DpnData(record, slice(0, 1500), "band-limited")
    curves = LogCurves(
        low=0.0104,
        high=0.0124,
        mass=np.log(0.07) * np.eye(3)[0] + np.array([0.0, 0.1, 0.02]),
        damping=np.log(13.0) * np.eye(2)[0] + np.array([0.0, 0.2]),
        stiffness=np.log(3400.0) * np.eye(3)[0] + np.array([0.0, 0.3, 0.05]),
        level=3.9,
        direction=np.array([0.2, 0.1] if extended else []),
        speed_scale=0.02,
        inertia=np.array([0.6] if extended else []),
    )
    starts = data.starts()
    here = data.evaluate(curves, starts)
    theta = curves.theta
    for place in range(theta.size):
        step = np.zeros(theta.size)
        step[place] = 1e-4
        errors = []
        for sign in (1.0, -1.0):
            # Starting values are projected out, so what is compared must be the error that they cannot explain.
            there = data.evaluate(curves.with_theta(theta + sign * step), starts)
            errors.append(there.error)
        slope = (errors[1] - errors[0]) / 2e-4
        own = here.slopes[:, place]
        assert (own @ slope) / (own @ own) == pytest.approx(1.0, abs=0.01), place


# --- fit -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", list(TISSUES))
def test_curves_over_the_central_depths_are_within_two_percent(name: str):
    record, model = _fitted(name)
    assert np.all(_errors(model, record, TISSUES[name]) < 0.02)
    assert model.report.vaf_percent > 99.98
    assert model.report.warnings == ()
    assert model.degrees["direction"] == model.degrees["inertia"] == -1


@pytest.mark.soak
def test_white_force_held_at_500_hz():
    record = simulated_dpn.slow_record(simulated_dpn.THESIS, 1)
    model = Dpn(hold="zero-order").fit(record)
    assert np.all(_errors(model, record, simulated_dpn.THESIS) < 0.02)


def test_held_out_samples_are_told_better_than_by_a_wiener_cascade():
    record, _ = _fitted("skin")
    first, last = slice(0, 6000), slice(6000, None)
    ours = validated(Dpn().fit(record, first), record, last).report
    cascade = validated(Wiener().fit(record, first), record, last).report
    assert ours.vaf_validation_percent > 99.97 > cascade.vaf_validation_percent
    assert ours.n_parameters < 20


def test_numbers_are_told_at_the_median_position():
    record, model = _fitted("growing mass")
    tissue = simulated_dpn.GROWING
    parameters = model.report.parameters
    middle = np.array([np.median(record.output)])
    assert parameters["position_m"].value == pytest.approx(middle[0])
    assert parameters["mass_kg"].value == pytest.approx(tissue.masses(middle)[0], rel=0.002)
    simulated.near(
        parameters, 0.004, damping_n_s_per_m=tissue.dampings(middle)[0], stiffness_n_per_m=tissue.tangents(middle)[0]
    )
    assert parameters["mass_growth_per_m"].value == pytest.approx(tissue.mass_growth, abs=6.0)
    assert parameters["damping_growth_per_m"].value == pytest.approx(tissue.damping_growth, abs=10.0)
    for name in ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m", "natural_frequency_rad_per_s", "damping_ratio"):
        std = parameters[name].std
        assert 0.0 < std < 0.01 * parameters[name].value


def test_a_known_surface_gives_the_stiffness_of_the_equation():
    record, plain = _fitted("skin")
    model = Dpn(surface_position_m=simulated_dpn.SURFACE).fit(record)
    y = np.quantile(record.output, DEPTHS)
    secant = model.estimated.secant(y, simulated_dpn.SURFACE)
    np.testing.assert_allclose(secant.value, simulated_dpn.SKIN.secants(y), rtol=0.01)
    assert np.mean((secant.low < simulated_dpn.SKIN.secants(y)) & (simulated_dpn.SKIN.secants(y) < secant.high)) > 0.5
    assert np.all(
        np.isnan(model.estimated.secant(np.array([0.009, simulated_dpn.SURFACE]), simulated_dpn.SURFACE).value)
    )
    secant = model.report.parameters["secant_stiffness_n_per_m"]
    assert secant.value < model.report.parameters["stiffness_n_per_m"].value
    assert "secant_stiffness_n_per_m" not in plain.report.parameters


def test_a_linear_system_shows_no_depth():
    record = simulated_dpn.record(simulated_dpn.PLAIN, 4)
    model = Dpn().fit(record)
    assert set(model.degrees.values()) == {0, -1}
    profile = model.depth_profile()
    plain = simulated_dpn.PLAIN
    for value, std, truth in (
        (profile.mass, profile.mass_std, plain.masses(profile.position)),
        (profile.damping, profile.damping_std, plain.dampings(profile.position)),
        (profile.stiffness, profile.stiffness_std, plain.tangents(profile.position)),
    ):
        assert np.all(np.abs(value - truth) < 3.5 * std)
        np.testing.assert_allclose(value, truth, rtol=0.01)
    assert codes(model.report.findings).count("dpn.constant") == 3


def test_a_wiener_system_grows_by_one_factor():
    record = simulated.wiener_record(1)
    model = Dpn().fit(record)
    low, high = np.quantile(record.output, [0.05, 0.95])
    changes, _ = model.estimated.changes(low, high)
    # With y = offset + C1 (1 - exp(-C2 z)) all three go as 1 / (C1 - (y - offset)).
    depth = np.array([low, high]) - simulated.SURFACE
    truth = np.log((simulated.C1 - depth[0]) / (simulated.C1 - depth[1]))
    np.testing.assert_allclose(changes, truth, rtol=0.03)
    assert model.report.parameters["inertia_share"].value == pytest.approx(1.0, abs=0.1)
    assert "dpn.common_factor" in codes(model.report.findings)
    assert model.report.vaf_percent > Wiener().fit(record).report.vaf_percent - 0.1


def test_damping_that_depends_on_the_direction():
    tissue = replace(simulated_dpn.SKIN, turn=0.3, turn_speed=0.01)
    record = simulated_dpn.record(tissue, 5)
    model = Dpn().fit(record)
    assert model.degrees["direction"] >= 0
    middle = np.array([np.median(record.output)])
    into, out = (model.estimated.damping(middle, way).value[0] / tissue.dampings(middle)[0] for way in (1, -1))
    assert into == pytest.approx(1.3, abs=0.05)
    assert out == pytest.approx(0.7, abs=0.05)
    [finding] = [text for text in model.report.findings if code_of(text) == "dpn.direction"]
    assert 1.0 <= finding.values["factor"] < 2.0
    profile = model.depth_profile()
    assert set(profile.direction) == {1, -1}
    assert np.all(profile.damping[profile.direction == 1] > profile.damping[profile.direction == -1])
    assert 0.9 * len(record) < profile.support.sum() <= len(record)
    without = Dpn(direction="off", inertia="off").fit(record)
    assert "dpn.term_would_help" in codes(without.report.findings)
    assert without.report.vaf_percent < model.report.vaf_percent


def test_given_degrees_are_kept():
    record, _ = _fitted("skin")
    model = Dpn(mass_degree=0, damping_degree=1, stiffness_degree=2, direction="on", inertia="off", spare_degree=3).fit(
        record
    )
    details = model.report.details
    assert (details["mass_degree"], details["damping_degree"], details["stiffness_degree"]) == (0.0, 1.0, 2.0)
    assert (details["direction_degree"], details["inertia_degree"]) == (0.0, -1.0)
    assert model.report.n_parameters == 1 + 2 + 3 + 1 + 1
    assert model.estimated.curves.direction[0] == pytest.approx(0.0, abs=0.01)


def test_profile_has_the_central_depths_and_who_speaks_for_them():
    record, model = _fitted("skin")
    profile = model.depth_profile()
    low, high = np.quantile(record.output, [0.01, 0.99])
    assert profile.position[[0, -1]] == pytest.approx([low, high])
    assert np.all(profile.low < profile.position)
    assert np.all(profile.position < profile.high)
    assert set(profile.direction) == {0}
    np.testing.assert_allclose(profile.stiffness, simulated_dpn.SKIN.tangents(profile.position), rtol=0.02)
    for std in (profile.mass_std, profile.damping_std, profile.stiffness_std):
        assert np.all(std > 0.0)
    assert 0.97 * len(record) < profile.support.sum() <= len(record)
    assert np.argmax(profile.support) not in (0, len(profile) - 1)


def test_gaps_are_left_out_and_records_are_joined():
    first, _ = _fitted("skin")
    second = simulated_dpn.record(simulated_dpn.SKIN, 6, mean=5.0)
    u = simulated.changed(first.input, ([2000, 2001, 5000], np.nan))
    y = simulated.changed(first.output, (np.s_[2600:2700], np.nan))
    holed = Dpn().fit(replace(first, input=u, output=y))
    assert np.all(_errors(holed, first, simulated_dpn.SKIN) < 0.02)
    assert "record.lost_samples" in codes(holed.report.warnings)
    both = joined([first, second])
    together = Dpn().fit(both)
    assert np.all(_errors(together, both, simulated_dpn.SKIN) < 0.02)
    assert together.report.details["fitted_samples"] == 16000.0
    apart = _fitted("skin")[1].report.parameters["mass_kg"].std
    shared = together.report.parameters["mass_kg"].std
    assert shared < apart


def test_simulation_rests_where_the_tissue_bears_the_mean_input():
    record, model = _fitted("skin")
    output = model.simulate(np.full(500, np.mean(record.input)))
    np.testing.assert_allclose(output, model.rest_position, atol=1e-12)
    borne = model.estimated.curves.forces(np.array([model.rest_position]))[0]
    assert borne == pytest.approx(np.mean(record.input), abs=1e-5)


def test_a_push_far_beyond_anything_measured_gives_numbers():
    _, model = _fitted("skin")
    u = np.full(2000, 4.0)
    u[500:] = 4000.0
    assert np.all(np.isfinite(model.simulate(u)))
    u[500:] = -4000.0
    assert np.all(np.isfinite(model.simulate(u)))


def test_a_slow_force_does_not_pass_for_knowledge_of_the_mass():
    force, position = simulated_dpn.clean(simulated_dpn.THESIS, (7,), band=1.0)
    rng = simulated.generator(8)
    record = Record(force, position + simulated.noise(rng, position, 30.0), simulated_dpn.RATE)
    model = Dpn().fit(record)
    mass = model.report.parameters["mass_kg"]
    assert abs(mass.value - 0.06) < 3.0 * mass.std
    assert {"dpn.undetermined", "second_order.undetermined"} & set(codes(model.report.warnings))
    assert model.report.parameters["stiffness_n_per_m"].value == pytest.approx(
        simulated_dpn.THESIS.tangents(np.array([np.median(position)]))[0], rel=0.05
    )


def test_signals_that_are_not_force_and_position_have_a_gain():
    record, _ = _fitted("skin")
    other = Record(record.input, record.output, record.sample_rate_hz, "command", "position", "V", "m")
    model = Dpn().fit(other)
    assert {"gain", "natural_frequency_rad_per_s", "damping_ratio"} == set(model.report.parameters)
    assert model.depth_profile() is None


def test_an_output_that_falls_is_refused():
    record, _ = _fitted("skin")
    refused(lambda: Dpn().fit(replace(record, output=-record.output)), "dpn.falling", output="position", input="force")


def _bad_records() -> list[tuple[str, Record, Refusal]]:
    noise = simulated.generator(9).standard_normal(4000)
    holed = simulated.changed(noise, (np.s_[::100], np.nan))
    return [
        (
            "short",
            Record(noise[:100], noise[:100], 2000.0),
            Refusal("record.shorter_than_memory", memory=0.125, seconds=0.05),
        ),
        ("few", Record(noise[:254], noise[:254], 2000.0), Refusal("record.too_few_samples", count=5, parameters=7)),
        ("full of holes", Record(holed, noise, 2000.0), Refusal("record.too_few_samples", count=0, parameters=7)),
    ]


@pytest.mark.parametrize(("record", "refusal"), [pytest.param(r, t, id=i) for i, r, t in _bad_records()])
def test_records_that_carry_no_fit_are_refused(record: Record, refusal: Refusal):
    with pytest.raises(UnusableInputError, check=refusal.check):
        Dpn().fit(record)


def test_stretches_too_short_to_simulate_are_refused():
    record, _ = _fitted("skin")
    u = simulated.changed(record.input, (np.s_[::10], np.nan))
    refused(lambda: Dpn(memory=0.001).fit(replace(record, input=u)), "dpn.no_stretch")


def test_unrelated_signals_do_not_hang_or_break():
    rng = simulated.generator(10)
    record = Record(rng.standard_normal(4000), 1e-3 * rng.standard_normal(4000), 2000.0)
    model = Dpn().fit(record)
    assert model.report.vaf_percent < 10.0
    assert np.all(np.isfinite(model.simulate(record.input)))


# --- uncertainty -----------------------------------------------------------------------------------------------------


def _coverage(runs: int, tissue: simulated_dpn.Tissue, snr_db: float, colour: float) -> np.ndarray:
    """Share of runs in which the band holds the truth, shape (3, depths)."""
    held = np.zeros((3, DEPTHS.size))
    for run in range(runs):
        record = simulated_dpn.record(tissue, 20, run, snr_db=snr_db, colour=colour)
        known = Dpn().fit(record).estimated
        y = np.quantile(record.output, DEPTHS)
        bands = known.mass(y), known.damping(y), known.stiffness(y)
        truth = tissue.masses(y), tissue.dampings(y), tissue.tangents(y)
        for place, (band, true) in enumerate(zip(bands, truth, strict=True)):
            held[place] += (band.low < true) & (true < band.high)
    return held / runs


@pytest.mark.soak
def test_bands_hold_the_truth():
    runs = 6
    covered = _coverage(runs, simulated_dpn.SKIN, 30.0, 0.9)
    assert np.all(covered.mean(axis=1) >= stats.binom.ppf(0.001, runs, 0.93) / runs), covered.mean(axis=1)


@pytest.mark.soak
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("snr_db", "colour"), [(40.0, 0.0), (30.0, 0.9)], ids=["40 dB white", "30 dB coloured"])
@pytest.mark.parametrize("name", [*TISSUES, "linear"])
def test_coverage_over_200_runs(name: str, snr_db: float, colour: float):
    covered = _coverage(200, (TISSUES | {"linear": simulated_dpn.PLAIN})[name], snr_db, colour)
    print("\n", name, snr_db, covered.mean(axis=1), covered.min(axis=1), covered.max(axis=1))
    assert np.all((covered.mean(axis=1) > 0.90) & (covered.mean(axis=1) < 0.98))


@pytest.mark.skipif(not RIG.is_dir(), reason="the rig's sessions are not here")
@pytest.mark.parametrize("number", [1, 6, 16])
def test_held_out_free_run_on_the_rig(number: int):
    from tissueid.sessions import read_session

    record = read_session(RIG / f"rig-{number:03d}.h5").test(None).record("force", "position")
    cut = round(0.75 * len(record))
    report = validated(Dpn().fit(record, slice(0, cut)), record, slice(cut, None)).report
    assert report.vaf_validation_percent > 99.5
