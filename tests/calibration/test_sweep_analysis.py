"""Sweeps of a coil of which everything is known: what the analysis makes of them, and how sure it is."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from spring_rig import Rig, swept

from tissueid.calibration.flux import fit_flux
from tissueid.calibration.force_balance import fit_balance
from tissueid.calibration.force_profile import linear_region
from tissueid.calibration.spline_basis import SplineBasis
from tissueid.calibration.sweep_analysis import SweptSpring, analyse_sweep
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.identification.engines.lms import Lms
from tissueid.records import Record

NOMINAL = DeviceDescription()
TRUE = Rig(resistance=12.4, inductance=1.15e-3, force_constant=2.87, mass=0.0712, damping=4.1)
"""A device that is not what it says of itself."""
PLACES = 1e-3 * np.array([2, 4, 6, 10, 14, 18, 22, 25, 27, 29])
FEW = 1e-3 * np.array([8, 12, 16, 20, 24])
GOOD_SPRING = SweptSpring(1000.0, 0.003)


@cache
def recorded(rig, places=tuple(PLACES)):
    return tuple(swept(rig, places, 2.0))


@cache
def result_of(rig, places=tuple(PLACES), spring=None):
    return analyse_sweep(recorded(rig, places), NOMINAL, spring)


def both_halves(tests, stiffness=1000.0):
    basis = SplineBasis.covering([test.position for test in tests], 2e-3)
    flux = fit_flux(tests, basis)
    return flux, fit_balance(tests, flux, stiffness)


def test_the_force_constant_is_found_along_the_stroke():
    found = result_of(TRUE)
    places = np.linspace(found.positions_m[0], found.positions_m[-1], 200)
    off = found.force_constant.at(places) / TRUE.k(places) - 1.0
    assert np.abs(off).max() < 0.015
    assert np.abs(off * TRUE.k(places) / found.force_constant.std_at(places)).max() < 4.0


def test_the_linear_region_is_found_within_a_tenth_of_a_millimetre():
    found, (low, high) = result_of(TRUE).region, TRUE.linear_region()
    assert found.min_m.value == pytest.approx(low, abs=2e-4)
    assert found.max_m.value == pytest.approx(high, abs=2e-4)
    assert not found.open_below
    assert not found.open_above


def test_the_coil_and_the_moving_part_are_found():
    found = result_of(TRUE)
    for resistance in found.flux.resistance_ohm:
        assert resistance.value == pytest.approx(12.4, abs=5 * resistance.std)
    assert found.flux.inductance_h.value == pytest.approx(1.15e-3, rel=0.05)
    assert found.balance.mass_kg.value == pytest.approx(0.0712, abs=5 * found.balance.mass_kg.std)
    assert found.balance.mass_kg.std < 1e-4
    assert found.moving_mass_kg.value == pytest.approx(0.0652, rel=0.02)  # the spring's third taken off
    assert found.bearing_damping_n_s_per_m.value == pytest.approx(4.1, rel=0.03)
    assert found.passed


def test_by_position_it_is_what_an_instrument_with_a_belief_sees():
    for point in result_of(TRUE).points:
        believed = 3.0 / TRUE.k(point.position_m)
        assert point.stiffness_n_per_m.value == pytest.approx(1000.0 * believed, rel=0.02)
        assert point.mass_kg.value == pytest.approx(0.0712 * believed, rel=0.02)
        assert point.damping_n_s_per_m.value == pytest.approx(4.1 * believed, rel=0.02)
        assert point.vaf_percent > 99.0


def test_a_reading_taken_for_the_mean_of_its_interval_would_lose_mass():
    test = recorded(TRUE)[5]
    raw = Lms(memory=0.25).fit(Record(TRUE.k(test.mean_position_m) * test.current, test.position, 2000.0))
    assert raw.report.parameters["mass_kg"].value < 0.997 * 0.0712
    point = result_of(TRUE).points[5]
    mass = point.mass_kg.value * TRUE.k(point.position_m) / 3.0
    assert mass == pytest.approx(0.0712, abs=4 * point.mass_kg.std)


def test_the_flux_linkage_needs_no_spring_and_the_balance_goes_by_it():
    tests = recorded(TRUE, tuple(FEW))
    flux, balance = both_halves(tests)
    stiffer_flux, stiffer = both_halves(tests, 1100.0)
    assert np.array_equal(flux.coefficients, stiffer_flux.coefficients)
    assert stiffer.coefficients == pytest.approx(1.1 * balance.coefficients, rel=1e-6)
    assert stiffer.mass_kg.value == pytest.approx(1.1 * balance.mass_kg.value, rel=1e-6)


def test_ten_thousand_samples_a_second():
    rig = replace(TRUE, rate=10_000.0)
    tests = swept(rig, FEW, 1.0)
    flux, balance = both_halves(tests)
    places = np.linspace(8e-3, 24e-3, 50)
    values = flux.basis.values(places)
    assert np.abs(values @ balance.coefficients / rig.k(places) - 1.0).max() < 0.01
    assert np.mean(values @ flux.coefficients / rig.k(places)) == pytest.approx(1.0, abs=0.01)
    assert balance.mass_kg.value == pytest.approx(0.0712, rel=0.003)


@pytest.mark.parametrize(
    ("rig", "cause", "words"),
    [
        (Rig(current_gain=1.05), "current", "the current channel's scale"),
        (Rig(position_gain=1.03), "position", "the position channel's scale explains it, for the stage"),
        (Rig(voltage_gain=1.05), "voltage", "the voltage channel's scale"),
        (Rig(stiffness=1050.0), "spring", "the spring's stiffness"),
        (Rig(), None, "they agree"),
    ],
    ids=["current", "position", "voltage", "spring", "none"],
)
def test_where_the_two_disagree_it_says_which_scale_is_off(rig, cause, words):
    found = result_of(rig, tuple(FEW), GOOD_SPRING)
    assert found.agreement.cause == cause
    assert words in found.agreement.words
    assert found.passed == (cause is None)


def test_without_a_stage_position_and_spring_cannot_be_told_apart():
    tests = [replace(test, stage_m=float("nan")) for test in recorded(Rig(position_gain=1.03), tuple(FEW))]
    found = analyse_sweep(tests, NOMINAL, GOOD_SPRING)
    assert found.agreement.stage is None
    assert found.agreement.cause == "spring"
    assert "or the position channel's scale" in found.agreement.words


def test_a_region_ends_where_the_sweep_ends():
    region = result_of(Rig(), tuple(FEW)).region
    assert region.open_below
    assert region.open_above
    assert region.min_m.value == pytest.approx(8e-3, abs=1e-4)
    assert region.max_m.value == pytest.approx(24e-3, abs=1e-4)


def test_where_a_linear_model_explains_little_the_region_ends_before():
    found = result_of(TRUE)
    worse = [replace(p, vaf_percent=80.0) if abs(p.position_m - 25e-3) < 1e-3 else p for p in found.points]
    region = linear_region(found.force_constant, worse, 0.032 - 4e-3)  # a stroke of which 22 mm is over the middle half
    assert region.max_m.value == pytest.approx(22e-3, abs=2e-4)
    assert region.open_above


def test_lost_samples_are_passed_over():
    tests = list(recorded(TRUE, tuple(FEW)))
    received = np.ones(tests[2].current.size)
    received[1000:1040] = received[2500] = np.nan
    lost = {name: getattr(tests[2], name) * received for name in ("voltage", "current", "position")}
    tests[2] = replace(tests[2], **lost)
    found = analyse_sweep(tests, NOMINAL)
    places = np.array(found.positions_m)
    assert found.force_constant.at(places) == pytest.approx(TRUE.k(places), rel=0.015)


def test_repeats_are_told_apart_and_together():
    tests = [*swept(TRUE, FEW, 1.0, 1), *swept(TRUE, FEW, 1.0, 2, sweep=1)]
    found = analyse_sweep(tests, NOMINAL)
    assert [len(run.points) for run in found.repeats] == [5, 5]
    assert len(found.points) == 10
    one, other = (run.region.plateau_n_per_a.value for run in found.repeats)
    assert one != other
    assert min(one, other) - 0.01 <= found.region.plateau_n_per_a.value <= max(one, other) + 0.01


@pytest.mark.parametrize(
    ("places", "words"),
    [
        (FEW[:4], "needs 5 positions or more, and 4 could be measured"),
        (np.linspace(10e-3, 22e-3, 5), "must reach over the middle half of the stroke, 8 to 24 mm"),
    ],
)
def test_too_little_of_the_stroke_is_refused(places, words):
    with pytest.raises(UnusableInputError, match=words):
        analyse_sweep(swept(TRUE, places, 1.0), NOMINAL)


def test_a_spring_that_does_not_run_free_is_refused():
    random = np.random.default_rng(0)
    tests = [
        replace(test, position=test.position + test.swing_m * random.standard_normal(test.position.size))
        for test in swept(TRUE, FEW, 1.0)
    ]
    with pytest.raises(UnusableInputError, match="see that the spring is fixed at both ends and runs free"):
        analyse_sweep(tests, NOMINAL)


def test_a_coil_far_from_nominal_is_not_put_in_force():
    found = result_of(Rig(force_constant=2.2), tuple(FEW))
    assert not found.passed
    assert "should be near 3.00 N/A" in found.problems[0]


@pytest.mark.soak
def test_deviations_hold():
    """Each 95 % interval over 20 sweeps, of both halves: mass, damping, force constant at every position."""
    within = {"flux": [], "spring": [], "mass": [], "damping": []}
    for seed in range(20):
        tests = swept(TRUE, PLACES, 3.0, seed)
        flux, balance = both_halves(tests)
        values = flux.basis.values(PLACES)
        for name, half in (("flux", flux), ("spring", balance)):
            std = np.sqrt(np.einsum("ij,jk,ik->i", values, half.covariance, values))
            within[name].extend(np.abs(values @ half.coefficients - TRUE.k(PLACES)) < 1.96 * std)
        within["mass"].append(abs(balance.mass_kg.value - TRUE.mass) < 1.96 * balance.mass_kg.std)
        within["damping"].append(
            abs(balance.damping_n_s_per_m.value - TRUE.damping) < 1.96 * balance.damping_n_s_per_m.std
        )
    assert {name: np.mean(hits) > 0.8 for name, hits in within.items()} == dict.fromkeys(within, True)
