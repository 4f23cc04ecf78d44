"""Sweeps of a coil of which everything is known: what the analysis makes of them, and how sure it is."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from coded import coded, is_german, message, says
from spring_rig import Rig, swept

from tissueid.calibration import sweep_analysis
from tissueid.calibration.flux import SplineBasis, fit_flux
from tissueid.calibration.force_constant import fit_balance, linear_region
from tissueid.calibration.spring_points import SweepTest
from tissueid.calibration.status import problems_of
from tissueid.calibration.sweep_analysis import SpringMass, analyse_sweep, as_calibration
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.identification.engines.lms import Lms
from tissueid.records import Record
from tissueid.reports.calibration_page import sweep_report
from tissueid.sessions import Test

NOMINAL = DeviceDescription()
TRUE = Rig(resistance=12.4, inductance=1.15e-3, force_constant=2.87, mass=0.0712, damping=4.1)
"""A device that is not what it says of itself."""
PLACES = 1e-3 * np.array([2, 4, 6, 10, 14, 18, 22, 25, 27, 29])
FEW = 1e-3 * np.array([8, 12, 16, 20, 24])
GOOD_SPRING = SpringMass(1000.0, 0.003)


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
    ("rig", "cause"),
    [
        (Rig(current_gain=1.05), "current"),
        (Rig(position_gain=1.03), "position"),
        (Rig(voltage_gain=1.05), "voltage"),
        (Rig(stiffness=1050.0), "spring"),
        (Rig(), None),
    ],
    ids=["current", "position", "voltage", "spring", "none"],
)
def test_a_disagreement_names_the_wrong_scale(rig, cause):
    found = result_of(rig, tuple(FEW), GOOD_SPRING)
    assert found.agreement.cause == cause
    said = found.agreement.message
    assert said.code == ("sweep.agree" if cause is None else "sweep.scales")
    assert cause is None or said.values["cause"].code == f"sweep.cause.{cause}"
    assert said.values["comparison"].values["difference"].value == pytest.approx(
        100.0 * abs(found.agreement.ratio.value - 1.0)
    )
    assert is_german(said)
    assert found.passed == (cause is None)


def test_without_a_stage_position_and_spring_are_not_distinguishable():
    tests = [replace(test, stage_m=float("nan")) for test in recorded(Rig(position_gain=1.03), tuple(FEW))]
    found = analyse_sweep(tests, NOMINAL, GOOD_SPRING)
    assert found.agreement.stage is None
    assert found.agreement.cause == "spring"
    assert found.agreement.message.values["cause"].code == "sweep.cause.spring"


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


@pytest.mark.parametrize(
    ("places", "code", "values"),
    [
        (FEW[:4], "sweep.too_few", {"least": 5, "count": 4}),
        (np.linspace(10e-3, 22e-3, 5), "sweep.too_short", {"low": 8.0, "high": 24.0}),
    ],
)
def test_too_little_of_the_stroke_is_refused(places, code, values):
    with pytest.raises(UnusableInputError, check=coded(code, **values)):
        analyse_sweep(swept(TRUE, places, 1.0), NOMINAL)


def test_a_spring_that_does_not_run_free_is_refused():
    random = np.random.default_rng(0)
    tests = [
        replace(test, position=test.position + test.swing_m * random.standard_normal(test.position.size))
        for test in swept(TRUE, FEW, 1.0)
    ]
    with pytest.raises(UnusableInputError, check=coded("sweep.nonlinear")):
        analyse_sweep(tests, NOMINAL)


def test_a_coil_far_from_nominal_is_not_put_in_force():
    found = result_of(Rig(force_constant=2.2), tuple(FEW))
    assert not found.passed
    assert says(found.problems[0], "sweep.force_constant", nominal=3.0)


@pytest.mark.parametrize(
    ("rig", "spring", "code", "value"),
    [
        (Rig(), SpringMass(1000.0, 0.003, 0.200), "sweep.implausible", None),
        (Rig(inductance=2e-3), GOOD_SPRING, "sweep.implausible", 0.002),
        (Rig(damping=8.0), GOOD_SPRING, "sweep.implausible", 8.0),
        (Rig(resistance=18.0), GOOD_SPRING, "sweep.resistance", 18.0),
        (Rig(force_constant=-3.0), GOOD_SPRING, "sweep.force_constant", -3.0),
        (Rig(position_gain=-1.0), GOOD_SPRING, "sweep.stage", -1.0),
    ],
    ids=["mass", "inductance", "damping", "resistance", "coil reversed", "position reversed"],
)
def test_implausible_figures_fail_the_sweep(rig, spring, code, value):
    made = as_calibration(analyse_sweep(swept(rig, FEW, 1.0), NOMINAL, spring))
    assert made.verdict == "failed"
    problem = message(problems_of(made), code)
    assert is_german(problem)
    held = problem.values if code != "sweep.implausible" else problem.values["reason"].values
    assert value is None or value == pytest.approx(held.get("value", held.get("reading")), rel=0.05)
    assert sweep_report(made).level == "poor"


def test_figures_are_held_against_what_the_device_says_of_itself_and_not_against_a_calibration():
    device = replace(NOMINAL, moving_mass_kg=0.08, calibration={"nominal_moving_mass_kg": 0.06})
    assert analyse_sweep(recorded(Rig(), tuple(FEW)), device, GOOD_SPRING).passed
    assert not analyse_sweep(recorded(Rig(), tuple(FEW)), replace(device, calibration={}), GOOD_SPRING).passed


@pytest.mark.parametrize("reversed_one", ["current_gain", "voltage_gain"])
def test_a_current_that_goes_against_the_voltage_is_refused(reversed_one):
    with pytest.raises(UnusableInputError, check=coded("sweep.conductance")):
        analyse_sweep(swept(Rig(**{reversed_one: -1.0}), FEW, 1.0), NOMINAL)


def test_tests_at_different_rates_are_refused():
    tests = [*recorded(Rig(), tuple(FEW))[:4], *swept(Rig(rate=4000.0), FEW[4:], 1.0)]
    with pytest.raises(UnusableInputError, check=coded("sweep.rates", lowest=2000.0, highest=4000.0)):
        analyse_sweep(tests, NOMINAL)


@pytest.mark.parametrize(
    ("device", "code", "name"),
    [
        ({"coil_resistance_ohm": 0.0}, "sweep.device_figure", "coil_resistance_ohm"),
        ({"coil_resistance_ohm": np.nan}, "sweep.device_figure", "coil_resistance_ohm"),
        ({"moving_mass_kg": np.inf}, "sweep.device_figure", "moving_mass_kg"),
        ({"calibration": {"nominal_coil_inductance_h": "none"}}, "sweep.device_figure", "coil_inductance_h"),
        ({"model": ""}, "sweep.device_name", "model"),
        ({"serial_number": "D-7\nD-8"}, "sweep.device_name", "serial number"),
        ({"serial_number": 201 * "7"}, "sweep.device_name", "serial number"),
    ],
)
def test_an_impossible_device_is_refused(device, code, name):
    with pytest.raises(UnusableInputError, check=coded(code, name=name)):
        analyse_sweep(recorded(Rig(), tuple(FEW)), replace(NOMINAL, **device))


def test_tests_that_tell_nothing_are_refused():
    still = 1e-3 * np.array([8, 12, 16, 20, 24])
    flicker = 1e-9 * np.array([1.0, -1.0])  # of the last digit: enough to be a change, not to be a motion
    tests = [
        replace(test, position=place + np.resize(flicker, test.position.size))
        for test, place in zip(recorded(Rig(), tuple(FEW)), still, strict=True)
    ]
    with pytest.raises(UnusableInputError, check=coded("sweep.nonlinear")):
        analyse_sweep(tests, NOMINAL)


def test_a_singular_problem_is_refused(monkeypatch):
    def singular(*_):
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr(sweep_analysis, "fit_flux", singular)
    with pytest.raises(UnusableInputError, check=coded("sweep.undetermined")):
        analyse_sweep(recorded(Rig(), tuple(FEW)), NOMINAL)


GOOD_SIGNALS = {
    "voltage": 3.0 * np.sin(np.arange(2000.0)),
    "current": 0.2 * np.sin(np.arange(2000.0)),
    "position": 0.016 + 1e-3 * np.sin(np.arange(2000.0)),
}


def kept_test(rate=2000.0, notes=None, preload_s=0.0, **signals):
    signals = {name: values for name, values in (GOOD_SIGNALS | signals).items() if values is not None}
    return Test(7, "spring", signals, rate, preload_s=preload_s, notes=notes or {})


def test_a_test_is_taken_from_a_session_with_what_is_not_known():
    lost = GOOD_SIGNALS["current"].copy()
    lost[100] = np.inf
    test = SweepTest.of_session(kept_test(current=lost, notes={"stage_m": "by hand", "sweep": 3.0}, preload_s=0.1))
    assert test.position.size == 1800
    assert test.sweep == 3
    assert np.isnan(test.stage_m)
    assert np.isfinite(test.current).all()  # the one that is not lay within the preload
    assert np.isnan(SweepTest.of_session(kept_test(current=lost)).current[100])


@pytest.mark.parametrize(
    ("kept", "code", "values"),
    [
        (kept_test(voltage=None), "sweep.no_channel", {"channel": "voltage"}),
        (kept_test(notes={"sweep": np.nan}), "sweep.number", {}),
        (kept_test(notes={"sweep": np.inf}), "sweep.number", {"sweep": np.inf}),
        (kept_test(notes={"sweep": 1.5}), "sweep.number", {"sweep": 1.5}),
        (kept_test(notes={"sweep": "first"}), "sweep.number", {"sweep": "first"}),
        (kept_test(rate=1e9), "sweep.sample_rate", {"lowest": 1000.0, "highest": 20000.0, "rate": 1e9}),
        (kept_test(rate=100.0), "sweep.sample_rate", {"rate": 100.0}),
        (kept_test(rate=np.nan), "sweep.sample_rate", {}),
        (kept_test(preload_s=1e300), "sweep.length", {"least": 0.5, "most": 60.0, "seconds": 0.0}),
        (kept_test(current=np.full(2000, 1e200)), "sweep.too_large", {"channel": "current", "value": 1e200}),
        (kept_test(position=1e3 * GOOD_SIGNALS["position"]), "sweep.too_large", {"channel": "position"}),
        (kept_test(current=np.zeros(2000)), "sweep.constant", {"channel": "current"}),
        (kept_test(voltage=np.full(2000, 5.0)), "sweep.constant", {"channel": "voltage"}),
        (kept_test(position=np.full(2000, np.inf)), "sweep.lost", {}),
    ],
)
def test_an_impossible_test_is_refused(kept, code, values):
    with pytest.raises(UnusableInputError, check=coded("sweep.test", number=7)) as caught:
        SweepTest.of_session(kept)
    assert says(caught.value.message.values["reason"], code, **values)
    assert is_german(caught.value.message)


def test_samples_lost_in_between_everywhere_are_refused():
    tests = list(recorded(Rig(), tuple(FEW)))
    tests[1] = replace(tests[1], current=np.where(np.arange(tests[1].current.size) % 3, tests[1].current, np.nan))
    tests[1] = replace(tests[1], voltage=np.where(np.arange(tests[1].current.size) % 3, tests[1].voltage, np.nan))
    with pytest.raises(UnusableInputError, check=coded("sweep.many_lost")):
        analyse_sweep(tests, NOMINAL)


def test_repeats_are_analysed_alone_and_together_and_a_weak_one_gives_a_remark():
    tests = [*swept(TRUE, FEW, 1.0, 1), *swept(TRUE, FEW[:3], 1.0, 3, sweep=1), *swept(TRUE, FEW, 1.0, 4, sweep=2)]
    found = analyse_sweep(tests, NOMINAL, remarks=("one before",))
    assert found.passed
    assert [(run.runs, len(run.points)) for run in found.repeats] == [((1,), 5), ((3,), 5)]
    assert len(found.points) == 13
    first, last = (run.region.plateau_n_per_a.value for run in found.repeats)
    assert first != last
    assert min(first, last) - 0.01 <= found.region.plateau_n_per_a.value <= max(first, last) + 0.01
    assert found.remarks[0] == "one before"
    assert says(found.remarks[1], "sweep.weak_run", run=2)
    assert found.remarks[1].values["reason"].code == "sweep.too_few"
    made = as_calibration(found)
    assert made.conditions["repeats"] == 3.0
    assert made.tables["repeats"]["run"] == (1.0, 3.0)


def test_a_field_that_cannot_be_stored_is_named():
    with pytest.raises(UnusableInputError, check=coded("sweep.not_stored", field="conditions.session_id")):
        as_calibration(result_of(Rig(), tuple(FEW)), conditions={"session_id": 1000 * "x"})


@pytest.mark.soak
def test_deviations_are_neither_too_small_nor_too_large():
    """Errors over deviations, root mean square: a third where they are three times too large, three where so small."""
    rig, off = Rig(), {}
    places = np.linspace(9e-3, 23e-3, 8)
    for seed in range(12):
        flux, balance = both_halves(swept(rig, FEW, 1.0, 50 + seed))
        values = flux.basis.values(places)
        for name, half in (("flux", flux), ("spring", balance)):
            std = np.sqrt(np.einsum("ij,jk,ik->i", values, half.covariance, values))
            off.setdefault(name, []).extend((values @ half.coefficients - rig.k(places)) / std)
        off.setdefault("resistance", []).extend((found.value - 12.0) / found.std for found in flux.resistance_ohm)
        off.setdefault("lag", []).append((flux.lag.seconds - 1e-3 / 12.0) / flux.lag.noise_s)
        for name, found, true in (
            ("mass", balance.mass_kg, rig.mass),
            ("damping", balance.damping_n_s_per_m, rig.damping),
        ):
            off.setdefault(name, []).append((found.value - true) / found.std)
    sizes = {name: float(np.sqrt(np.mean(np.square(values)))) for name, values in off.items()}
    assert {name: size for name, size in sizes.items() if not 0.6 < size < 2.0} == {}


def test_both_scales_are_within_the_deviation_of_all_together():
    plateau = result_of(Rig(), tuple(FEW), GOOD_SPRING).region.plateau_n_per_a
    together = 1.0 / np.hypot(1.0 / 0.003, 1.0 / 0.005)  # of spring and of voltage over position
    assert plateau.std / plateau.value == pytest.approx(together, rel=0.2)


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
