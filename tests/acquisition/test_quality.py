"""The quality gate: quiet on good tests, and each finding on the fault that it is for."""

import json
import tracemalloc
import warnings
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from acquisition.simulated_tests import DEVICE, RATE, Desk, move, with_signal
from support import connect

from tissueid.acquisition import GuidedTest, NoiseChoice, SessionRecorder, run_guided_test
from tissueid.acquisition.quality import Quality, QualityFinding, QualityGate, gate, judge, judge_session, quality_of
from tissueid.device import DeviceDescription
from tissueid.instrument.answers import describe_faults
from tissueid.instrument.judge import BY_CURRENT
from tissueid.sessions import Session, Test, read_session
from tissueid.sessions.quality import worst_first
from tissueid.stimuli.base import guided
from tissueid.stimuli.kinds.noise import Noise
from tissueid.wire import Fault


def found(test, earlier=(), device=DEVICE):
    return {finding.code: finding for finding in judge(test, device, earlier).findings}


@pytest.fixture(scope="module")
def good():
    return Desk().run()


# -- nothing to say ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tissue", ["left-posterior-forearm", "upper-arm", "acrylamide-10", "latex", "linear-demo"])
def test_good_tests_and_their_repeats_pass(tissue):
    desk = Desk(tissue, seed=7, surface_m=0.010)
    for _ in range(3):
        quality = judge(desk.run(), DEVICE, desk.tests[:-1])
        assert quality.findings == ()
        assert quality.verdict == "good"


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(20))
def test_good_tests_pass_on_every_tissue(seed):
    from firmware_sim.presets import preset_names

    for tissue in preset_names():
        if tissue != "free-air":
            assert judge(Desk(tissue, seed=seed, surface_m=0.010).run(), DEVICE).verdict == "good", tissue


def test_the_small_test_of_the_demo_is_not_called_noisy():
    noise = Noise(seed=2, force_min_n=2.65, force_max_n=4.15, seconds=3.0, sample_rate=RATE)
    assert judge(Desk().run(guided(noise.build(), 0.5)), DEVICE).verdict == "good"


def test_a_test_that_ends_within_its_preload_is_told_how_long_that_was_held(good):
    cut = {name: values[: round(0.2 * RATE)] for name, values in good.signals.items()}
    findings = found(replace(good, signals=cut, status="aborted", notes=good.notes | {"reason": "interrupted"}))
    assert (
        "after 0.20 of the 0.50 s of its preload, without any stimulus: interrupted." in findings["ended_early"].words
    )
    assert findings["ended_early"].severity == "repeat"
    assert "preload_short" not in findings


@pytest.mark.parametrize("reason", [describe_faults(Fault.OVER_TEMPERATURE), f"the coil is at 80 °C {BY_CURRENT}"])
def test_a_test_that_the_calculated_temperature_ended_is_told_so(good, reason):
    notes = good.notes | {"reason": f"the instrument released the coil: {reason}", "limit_max_temperature_c": 80.0}
    ended = replace(with_signal(good, "temperature", np.full(good.samples, 60.0)), status="aborted", notes=notes)
    words = found(ended)["coil_warm"].words
    assert "it was the calculation" in words.lower()
    assert "limit of 80 °C" in words
    assert "read 60 °C" in words
    by_sensor = with_signal(ended, "temperature", np.full(good.samples, 81.0))
    assert found(by_sensor)["coil_warm"].words == "The coil was at 81 °C."


def test_warnings_of_the_calibration_end_like_sentences(good):
    known = {"state": "stale", "verdict": "passed", "warnings": "a.toml: it is 100 days old: calibrate again"}
    assert found(good, device=replace(DEVICE, calibration=known))["calibration_stale"].words.endswith("again.")


# -- each fault has its finding ----------------------------------------------------------------------------------


def lifting(desk):
    noise = Noise(seed=1, force_min_n=-6.0, force_max_n=11.5, seconds=3.0, sample_rate=RATE)
    return desk.run(guided(noise.build(), 0.5))


def jumping(desk):
    return desk.run(hook=lambda bench, at: move(bench, 0.4e-3) if at == 4000 else None)


def drifting(desk):
    return desk.run(hook=lambda bench, at: move(bench, 0.06e-3) if at >= 1000 else None)


def sticking(desk):
    return desk.run(hook=lambda bench, at: bench.stuck.add("position") if at == 5000 else None)


def cut(desk):
    return desk.run(hook=lambda bench, at: setattr(bench, "coil_open", True))


def sagging(desk):
    return desk.run(hook=lambda bench, at: setattr(bench, "supply_share", 0.5))


def noisy(desk):
    test = desk.run()
    random = np.random.default_rng(0)
    return with_signal(test, "position", test.signals["position"] + 6e-5 * random.standard_normal(test.samples))


def humming(desk, hertz):
    test = desk.run()
    hum = 2e-5 * np.sin(2 * np.pi * hertz * np.arange(test.samples) / RATE)
    return with_signal(test, "position", test.signals["position"] + hum)


def losing(desk):
    test = desk.run()
    signals = {name: np.where(np.arange(test.samples) // 400 == 10, np.nan, v) for name, v in test.signals.items()}
    return replace(test, signals=signals)


def knocked(desk):
    test = desk.run()
    return with_signal(test, "acceleration_y", test.signals["acceleration_y"] + 9.0 * (np.arange(test.samples) == 3000))


def turned(desk):
    return replace(desk.run(), notes={"gravity_along_stroke_m_s2": 9.2, "gravity_across_stroke_m_s2": 3.4})


def at_the_end(desk):
    return replace(desk.run(), notes={"limit_min_position_m": 3e-4, "limit_max_position_m": 0.0147})


def warm(desk):
    test = desk.run()
    return with_signal(test, "temperature", test.signals["temperature"] + 45.0)


def late(desk):
    return replace(desk.run(), notes={"held_samples": 400.0})


def full(desk):
    return replace(desk.run(), notes={"saturated_samples": 20.0})


def aborted(desk):
    test = desk.run()
    signals = {name: values[:1800] for name, values in test.signals.items()}
    return replace(test, signals=signals, status="aborted", notes={"reason": "the button was pressed"})


def hurried(desk):
    return replace(desk.run(), preload_s=0.1)


FAULTS = {
    "probe_lifted": ("look", lifting, "left the skin"),
    "reference_moved": ("look", jumping, "jumped by 0.39 mm at 2.0 s"),
    "sensor_stuck": ("repeat", sticking, "position stood still"),
    "coil_open": ("repeat", cut, "current"),
    "saturated": ("repeat", sagging, "amplifier"),
    "noisy_position": ("look", noisy, "noisy"),
    "samples_lost": ("look", losing, "400 of 7\u202f000 samples"),
    "shock": ("look", knocked, "1.5 s into the test"),
    "orientation_changed": ("repeat", turned, "turned by 20"),
    "end_of_stroke": ("look", at_the_end, "outer end"),
    "coil_warm": ("look", warm, "°C"),
    "setpoints_late": ("look", late, "400 samples"),
    "ended_early": ("repeat", aborted, "the button was pressed"),
    "preload_short": ("note", hurried, "0.10 s"),
}


@pytest.mark.parametrize("code", FAULTS)
def test_a_fault_is_found_and_said_in_words(code):
    severity, spoil, words = FAULTS[code]
    finding = found(spoil(Desk()))[code]
    assert finding.severity == severity
    assert words in finding.words
    assert not finding.words[0].islower()
    assert finding.words.endswith(".")
    assert finding.advice.endswith(".")
    assert finding.value is not None


def test_a_drift_is_told_from_a_jump():
    finding = found(drifting(Desk()))["reference_moved"]
    assert "drifted" in finding.words
    assert finding.value == pytest.approx(0.72e-3, rel=0.15)


@pytest.mark.parametrize(("metres", "severity"), [(0.3e-3, "look"), (-0.3e-3, "look"), (-0.8e-3, "repeat")])
def test_a_jump_during_the_preload_is_found(metres, severity):
    finding = found(Desk().run(hook=lambda bench, at: move(bench, metres) if at == 500 else None))["reference_moved"]
    assert finding.severity == severity
    assert finding.value == pytest.approx(abs(metres), rel=0.15)
    assert finding.words.startswith("The reference surface moved: the position jumped by ")
    assert " at 0.3 s " in finding.words or " at 0.2 s " in finding.words


@pytest.mark.parametrize("preload_s", [0.1, 0.3, 0.5, 2.0])
@pytest.mark.parametrize("creep_m", [0.1e-3, 1.0e-3])
def test_creep_during_the_preload_is_no_movement(preload_s, creep_m):
    noise = Noise(seed=4, seconds=1.5, sample_rate=RATE)
    test = Desk().run(guided(noise.build(), preload_s))
    time = np.arange(test.samples) / RATE
    given_way = creep_m * (0.5 * (1.0 - np.exp(-time / 0.05)) + 0.5 * (1.0 - np.exp(-time / 0.4)))
    crept = with_signal(test, "position", test.signals["position"] + given_way)
    assert "reference_moved" not in found(crept)


def test_a_preload_that_was_lost_or_stands_still_is_not_judged():
    test = Desk().run()
    place = np.arange(test.samples)
    lost = with_signal(test, "position", np.where((place > 300) & (place < 500), np.nan, test.signals["position"]))
    assert "reference_moved" not in found(lost)
    still = with_signal(test, "position", np.full(test.samples, 0.0125))
    assert {"reference_moved", "not_judged"}.isdisjoint(found(still))


def test_the_orientation_is_that_of_what_was_received_last():
    test = turned(Desk())
    signals = {name: np.where(np.arange(test.samples) < 5000, v, np.nan) for name, v in test.signals.items()}
    assert "turned by 20" in found(replace(test, signals=signals))["orientation_changed"].words


@pytest.mark.parametrize("hertz", [50.0, 60.0, 100.0])
def test_mains_are_named(hertz):
    finding = found(humming(Desk(), hertz))["mains"]
    assert f"{hertz:.0f} Hz" in finding.words


def test_a_multisine_is_not_taken_for_mains():
    time_s = np.arange(7000) / RATE
    lines = sum(np.sin(2 * np.pi * hertz * time_s + hertz) for hertz in (10.0, 30.0, 50.0, 90.0, 110.0))
    desk = Desk()
    noise = desk.run().stimulus
    from tissueid.stimuli.base import Stimulus

    values = np.where(time_s < 0.5, 5.0, 5.0 + lines)
    played = desk.run(Stimulus(values, RATE, noise, 1, 2.0, preload_s=0.5))
    assert "mains" not in found(played)


def test_converters_at_their_end_are_counted():
    assert found(full(Desk()))["saturated"].severity == "look"


def test_the_share_of_lost_contact_is_about_the_true_one():
    desk = Desk()
    touching = []
    advance = desk.bench.plant.advance

    def watched(volts):
        trace = advance(volts)
        touching.append(trace["touching"])
        return trace

    desk.bench.plant.advance = watched
    test = lifting(desk)
    true = 1.0 - float(np.concatenate(touching)[1000 : test.samples].mean())
    assert true > 0.02
    assert found(test)["probe_lifted"].value == pytest.approx(true, abs=0.05)


def test_a_glued_or_sliding_probe_cannot_lift():
    for configuration in ("extension", "surface"):
        assert "probe_lifted" not in found(replace(lifting(Desk()), configuration=configuration))


# -- the calibration in force ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("calibration", "code", "severity"),
    [
        ({}, "calibration_none", "note"),
        ({"state": "none"}, "calibration_none", "note"),
        ({"state": "stale", "warnings": "Static: 120 days old."}, "calibration_stale", "look"),
        ({"state": "valid", "verdict": "failed"}, "calibration_failed", "look"),
        ({"state": "foreign"}, "calibration_failed", "look"),
        ({"state": "valid", "verdict": "passed", "warnings": "no sweep"}, "calibration_warning", "note"),
        ({"kind": "electrical check", "verdict": "passed"}, None, None),
    ],
)
def test_the_calibration_is_looked_at(good, calibration, code, severity):
    findings = {f.code: f for f in judge(good, replace(DEVICE, calibration=calibration)).findings}
    assert set(findings) == ({code} if code else set())
    if code:
        assert findings[code].severity == severity


@pytest.mark.parametrize(("high", "severity"), [(13.0e-3, "look"), (14.15e-3, "note"), (25e-3, None)])
def test_leaving_the_linear_region_is_flagged(good, high, severity):
    region = {"state": "valid", "linear_region_min_m": 4e-3, "linear_region_max_m": high}
    findings = found(good, device=replace(DEVICE, calibration=region))
    assert (findings["outside_linear_region"].severity if severity else findings) == (severity or {})


# -- against other tests -----------------------------------------------------------------------------------------


def test_tissue_that_settles():
    desk = Desk()
    first = desk.run()
    move(desk.bench, 0.2e-3)
    finding = found(desk.run(), (first,))["settling"]
    assert "0.20 mm deeper" in finding.words
    assert "leave the first" in finding.advice
    move(desk.bench, 0.1e-3)
    third = desk.run()
    assert "settling" in found(third, desk.tests[:2])
    assert judge(desk.run(), DEVICE, (third,)).verdict == "good"


def test_a_test_unlike_its_repeats():
    desk = Desk("acrylamide-20", surface_m=0.010)
    desk.run(), desk.run()
    law = desk.bench.plant.tissue
    stiffness = replace(law.stiffness, coefficient=1.5 * law.stiffness.coefficient)
    desk.bench.plant.tissue = replace(law, stiffness=stiffness)
    findings = [f for f in judge(desk.run(), DEVICE, desk.tests[:-1]).findings if f.code == "unusual"]
    assert {f.severity for f in findings} == {"look", "repeat"}


def test_other_commands_are_compared_by_their_parameters():
    desks = [Desk("acrylamide-20", seed, 0.010) for seed in (1, 2, 3)]
    tests = [replace(desk.run(), number=place) for place, desk in enumerate(desks, 1)]
    assert judge(tests[2], DEVICE, tests[:2]).verdict == "good"
    other = replace(Desk("acrylamide-30", 4, 0.010).run(), number=4)
    assert "stiffness" in found(other, tests)["unusual"].words


def test_another_site_is_not_compared(good):
    other = replace(Desk("acrylamide-30").run(), number=2, site="block")
    assert judge(other, DEVICE, (good,)).verdict == "good"


def test_a_surface_found_elsewhere(good):
    finding = found(replace(good, number=2, surface_position_m=good.surface_position_m + 2e-3), (good,))
    assert "2.00 mm deeper" in finding["surface_changed"].words


# -- whatever comes in -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["stochastic", "quiet", "free_air", "slow_ramp", "step_hold", "spring"])
@pytest.mark.parametrize(
    "signals",
    [
        {"position": np.full(3000, np.nan)},
        {"force": np.zeros(3000), "position": np.zeros(3000)},
        {"force": np.full(3000, np.nan), "position": np.full(3000, np.nan)},
        {"force": np.ones(3), "position": np.ones(3)},
        {"command": np.zeros(5000), "voltage": np.zeros(5000), "current": np.zeros(5000), "position": np.zeros(5000)},
        {"force": np.where(np.arange(5000) % 2, np.nan, 1.0), "position": np.arange(5000.0) * 1e-6},
    ],
    ids=["no force", "nothing", "lost", "short", "still", "half"],
)
def test_any_record_can_be_judged(kind, signals):
    test = Test(number=1, kind=kind, signals=signals, sample_rate_hz=RATE, preload_s=0.5)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        quality = judge(test, DEVICE, (test,))
    json.dumps(quality.as_dict(), allow_nan=False)


def test_a_defect_of_the_gate_costs_no_test(good, monkeypatch):
    def broken(_evidence):
        raise ZeroDivisionError

    monkeypatch.setattr(gate, "CHECKS", (broken,))
    quality = QualityGate(DEVICE).judge(good)
    assert [f.code for f in quality.findings] == ["not_judged"]
    assert quality.verdict == "look"


def test_a_session_whose_figures_make_no_sense_is_told_so(good):
    senseless = replace(DEVICE, force_constant_n_per_a=0.0, coil_resistance_ohm=0.0)
    slow = replace(good, sample_rate_hz=0.5)
    for session in (Session(senseless, tests=(good,)), Session(DEVICE, tests=(slow,))):
        ((_, quality),) = judge_session(session)
        json.dumps(quality.as_dict(), allow_nan=False)
        assert quality.verdict != "good"


def test_figures_that_are_no_numbers_are_left_out():
    quality = worst_first(
        [QualityFinding("a", "note", "A.", "B.", float("inf")), QualityFinding("b", "look", "A.", "B.")]
    )
    assert [finding.value for finding in quality.findings] == [None, None]
    assert quality.as_notes()


def test_a_coil_that_opens_in_mid_test_is_open(good):
    current = good.signals["current"].copy()
    current[5500:] = 0.0
    spoilt = replace(
        good, signals=good.signals | {"current": current, "force": current * DEVICE.force_constant_n_per_a}
    )
    assert found(spoilt)["coil_open"].severity == "repeat"


def test_a_gate_remembers_no_more_than_it_should(good, monkeypatch):
    monkeypatch.setattr(gate, "MOST_SAMPLES", 2 * good.samples)
    keeper = QualityGate(DEVICE)
    for number in range(1, 6):
        keeper.judge(replace(good, number=number))
    assert [test.number for test in keeper._earlier] == [4, 5]
    assert set(keeper._earlier[0].signals) == {"command", "force", "position"}


# -- kept with the test ------------------------------------------------------------------------------------------


def test_the_verdict_is_worst_and_comes_first():
    note, look = (QualityFinding(code, code, "Words.", "Advice.") for code in ("note", "look"))
    assert Quality((note,)).verdict == "good"
    assert Quality((look, note)).verdict == "look"
    assert Quality((look, note)).headline == "Read this before you use the test"


def test_it_is_in_the_file_before_the_file_is_closed(tmp_path):
    instrument = connect()
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device)
    for _ in range(2):
        run_guided_test(instrument, GuidedTest(NoiseChoice(seconds=1.0).stimulus(RATE), "arm"), recorder)
    recorder.finish()
    session = read_session(tmp_path / "s.h5")
    for test, again in judge_session(session):
        kept = quality_of(test)
        assert kept is not None
        assert kept.verdict == again.verdict == "good"
        assert [f.code for f in kept.findings] == [f.code for f in again.findings] == ["calibration_none"]
        assert test.notes["net_force_n"] == pytest.approx(np.nanmean(test.signals["force"][1000:]) + 0.588, abs=2e-3)
        assert test.notes["saturated_samples"] == 0.0
        assert test.notes["probe_name"] == "indenter-4.4mm"


@pytest.mark.parametrize(
    "note",
    [
        None,
        3.0,
        "",
        "[]",
        "{}",
        '{"findings": 3}',
        '{"findings": null}',
        "[" * 100_000,
    ],
)
def test_a_note_that_is_none_says_nothing(good, note):
    notes = {} if note is None else {"quality": note}
    assert quality_of(replace(good, notes=notes)) is None


def test_a_note_from_elsewhere_is_cut_to_what_it_may_be(good):
    sound = {"code": "c", "severity": "look", "words": "w" * 5000, "advice": "a", "value": 1e400}
    items = [{"severity": "fatal"}, 7, sound, {**sound, "words": None}, *[sound] * 200]
    kept = quality_of(replace(good, notes={"quality": json.dumps({"findings": items})}))
    assert kept is not None
    assert 0 < len(kept.findings) < 60
    assert len(kept.findings[0].words) == 1000
    assert kept.findings[0].value is None


def test_old_sessions_can_be_judged(good):
    session = Session(DeviceDescription(), tests=(good, replace(good, number=2)))
    assert [quality.verdict for _, quality in judge_session(session)] == ["good", "good"]
    assert partial(quality_of, good)() is None


@pytest.mark.parametrize(("samples", "rate"), [(9000, 1.0), (400_000, 2000.0), (9000, 1e-6), (9000, 1e9)])
def test_memory_stays_in_proportion_to_the_test(samples, rate):
    rng = np.random.default_rng(2)
    signals = {name: rng.standard_normal(samples) for name in ("command", "current", "force", "position")}
    session = Session(DEVICE, tests=(Test(1, "stochastic", signals, rate),))
    tracemalloc.start()
    try:
        ((_, quality),) = judge_session(session)
        assert tracemalloc.get_traced_memory()[1] < 350_000_000
    finally:
        tracemalloc.stop()
    assert rate != 2000.0 or quality != gate.NOT_JUDGED
