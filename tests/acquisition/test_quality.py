"""The quality gate: no finding on good tests, and the right finding for each fault."""

import json
import tracemalloc
import warnings
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from acquisition.simulated_tests import DEVICE, RATE, Desk, move, with_signal
from coded import made, says
from reports.in_german import in_german
from support import connect

from tissueid.acquisition import GuidedTest, SessionRecorder, run_guided_test, usual_noise
from tissueid.acquisition import quality as gate
from tissueid.acquisition.quality import Quality, QualityFinding, QualityGate, judge, judge_session, quality_of
from tissueid.acquisition.quality.prepared_test import AIR, SPRING, TISSUE
from tissueid.device import DeviceDescription
from tissueid.instrument.replies import released_by_faults
from tissueid.messages import Message, translated
from tissueid.sessions import Session, Test, read_session
from tissueid.sessions.model import reason_notes
from tissueid.sessions.quality import HEADLINES, worst_first
from tissueid.stimuli.base import Stimulus, with_preload
from tissueid.stimuli.kinds.noise import Noise, SteppedNoise
from tissueid.test_settings import TestSettings
from tissueid.wire import Fault

pytestmark = pytest.mark.usefixtures("long_frames")


def found(test, earlier=(), device=DEVICE):
    return {finding.code: finding for finding in judge(test, device, earlier).findings}


@pytest.fixture(scope="module")
def good():
    return Desk().run()


@pytest.fixture(scope="module")
def long():
    return Desk().run(with_preload(Noise(seed=4, seconds=4.0, sample_rate=RATE).build(), 0.5))


@pytest.fixture(scope="module")
def attached():
    options = {"force_min_n": -5.0, "force_max_n": 5.0, "level_s": 0.5, "sample_rate": RATE}
    return Desk("forearm-attached", surface_m=0.014).run(with_preload(SteppedNoise(**options).build(), 0.5))


# -- good tests -------------------------------------------------------------------------------------------------


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
    assert judge(Desk().run(with_preload(noise.build(), 0.5)), DEVICE).verdict == "good"


def test_a_test_that_ends_within_its_preload_reports_its_length(good):
    cut = {name: values[: round(0.2 * RATE)] for name, values in good.signals.items()}
    findings = found(replace(good, signals=cut, status="aborted", notes=good.notes | {"reason": "interrupted"}))
    words = findings["ended_early"].message
    assert says(words, "quality.ended_early", reason="interrupted")
    assert says(words.values["when"], "quality.ended_early.preload", held=0.2, preload=0.5)
    assert findings["ended_early"].severity == "repeat"
    assert "preload_short" not in findings


@pytest.mark.parametrize(
    "reason",
    [
        released_by_faults(Fault.OVER_TEMPERATURE).message,
        made("limit.winding_temperature", temperature=80.5, limit=80.0),
    ],
)
def test_a_test_ended_by_the_calculated_temperature_is_reported(good, reason):
    notes = good.notes | reason_notes(reason) | {"limit_max_temperature_c": 80.0}
    ended = replace(with_signal(good, "temperature", np.full(good.samples, 60.0)), status="aborted", notes=notes)
    assert says(found(ended)["coil_warm"].message, "quality.coil_warm.calculated", limit=80.0, read=60.0)
    by_sensor = with_signal(ended, "temperature", np.full(good.samples, 81.0))
    assert says(found(by_sensor)["coil_warm"].message, "quality.coil_warm", hottest=81.0)


def test_warnings_of_the_calibration_end_with_a_full_stop(good):
    known = {"state": "stale", "verdict": "passed", "warnings": "a.toml: it is 100 days old: calibrate again"}
    assert found(good, device=replace(DEVICE, calibration=known))["calibration_stale"].message[-1] == "."


# -- each fault has its finding ----------------------------------------------------------------------------------


def lifting(desk):
    noise = Noise(seed=1, force_min_n=-6.0, force_max_n=11.5, seconds=3.0, sample_rate=RATE)
    return desk.run(with_preload(noise.build(), 0.5))


def during(change):
    """A test during which ``change`` is made to the bench at some samples."""
    return lambda _good: Desk().run(hook=change)


def added(name, values):
    """A good test with values added to a signal."""
    return lambda good: with_signal(good, name, good.signals[name] + values)


def noted(**notes):
    return lambda good: replace(good, notes=notes)


def losing(good):
    signals = {name: np.where(PLACE // 400 == 10, np.nan, values) for name, values in good.signals.items()}
    return replace(good, signals=signals)


def aborted(good):
    signals = {name: values[:1800] for name, values in good.signals.items()}
    return replace(good, signals=signals, status="aborted", notes={"reason": "the button was pressed"})


PLACE = np.arange(7000)
TURNED = noted(gravity_along_stroke_m_s2=9.2, gravity_across_stroke_m_s2=3.4)
JUMPING = during(lambda bench, at: move(bench, 0.4e-3) if at == 4000 else None)
STICKING = during(lambda bench, at: bench.stuck.add("position") if at == 5000 else None)
CUT = during(lambda bench, at: setattr(bench, "coil_open", True))
SAGGING = during(lambda bench, at: setattr(bench, "supply_share", 0.5))
NOISY = added("position", 6e-5 * np.random.default_rng(0).standard_normal(7000))
AT_THE_END = noted(limit_min_position_m=3e-4, limit_max_position_m=0.0147)
FAULTS = {
    "probe_lifted": ("look", lambda _good: lifting(Desk()), "probe_lifted", {}),
    "reference_moved": ("look", JUMPING, "reference_moved.jump", {"size": 0.39, "seconds": 2.0}),
    "sensor_stuck": ("repeat", STICKING, "sensor_stuck", {"signal": "position"}),
    "coil_open": ("repeat", CUT, "coil_open", {}),
    "saturated": ("repeat", SAGGING, "saturated.amplifier", {}),
    "noisy_position": ("look", NOISY, "noisy", {"signal": "position"}),
    "samples_lost": ("look", losing, "samples_lost", {"lost": 400, "samples": 7000, "gap": 200.0}),
    "shock": ("look", added("acceleration_y", 9.0 * (PLACE == 3000)), "shock", {"seconds": 1.5}),
    "orientation_changed": ("repeat", TURNED, "orientation_changed", {"degrees": 20.3}),
    "end_of_stroke": ("look", AT_THE_END, "end_of_stroke.outer", {}),
    "coil_warm": ("look", added("temperature", 45.0), "coil_warm", {}),
    "setpoints_late": ("look", noted(held_samples=400.0), "setpoints_late", {"held": 400.0}),
    "ended_early": ("repeat", aborted, "ended_early", {"reason": "the button was pressed"}),
    "preload_short": ("note", lambda good: replace(good, preload_s=0.1), "preload_short", {"seconds": 0.1}),
}


@pytest.mark.parametrize("code", FAULTS)
def test_a_fault_has_its_finding_in_both_languages(good, code):
    severity, spoil, message, values = FAULTS[code]
    finding = found(spoil(good))[code]
    assert finding.severity == severity
    assert says(finding.message, f"quality.{message}")
    for name, value in values.items():
        known = finding.message.values[name]
        assert known == (pytest.approx(value, rel=0.03) if isinstance(value, float) else value)
    assert not finding.message[0].islower()
    assert finding.message.endswith(".")
    assert finding.advice.endswith(".")
    assert finding.value is not None
    german = in_german(lambda: (translated(finding.message), translated(finding.advice)))
    assert german[0] != finding.message
    assert german[1] != finding.advice
    assert "tissueid" not in german[1]


def test_every_text_of_the_gate_is_translated():
    texts = {text for one in (TISSUE, SPRING, AIR) for text in vars(one).values()}
    assert in_german(lambda: [text for text in texts if translated(text) == text]) == []


def test_a_drift_is_distinguished_from_a_jump():
    drifting = during(lambda bench, at: move(bench, 0.06e-3) if at >= 1000 else None)
    finding = found(drifting(None))["reference_moved"]
    assert says(finding.message, "quality.reference_moved.drift")
    assert finding.value == pytest.approx(0.72e-3, rel=0.15)


@pytest.mark.parametrize("phase", [0.0, 1.57, 3.14, 4.71])
def test_a_breath_is_no_drift_that_asks_for_a_repeat(long, phase):
    breath = added("position", 0.08e-3 * np.sin(2.0 * np.pi * 0.25 * np.arange(long.samples) / RATE + phase))
    finding = found(breath(long)).get("reference_moved")
    assert finding is None or (finding.severity == "look" and finding.value < 0.25e-3)


@pytest.mark.parametrize(("moved_m", "severity"), [(0.0, None), (0.8e-3, "repeat")])
def test_pulling_stiffer_than_pushing_is_no_movement(attached, moved_m, severity):
    moved = added("position", np.where(np.arange(attached.samples) < attached.samples / 2, 0.0, moved_m))
    finding = found(moved(attached)).get("reference_moved")
    assert (finding and finding.severity) == severity


@pytest.mark.parametrize(("metres", "severity"), [(0.3e-3, "look"), (-0.3e-3, "look"), (-0.8e-3, "repeat")])
def test_a_jump_during_the_preload_is_found(metres, severity):
    jumping = during(lambda bench, at: move(bench, metres) if at == 500 else None)
    finding = found(jumping(None))["reference_moved"]
    assert finding.severity == severity
    assert finding.value == pytest.approx(abs(metres), rel=0.15)
    assert says(finding.message, "quality.reference_moved.jump")
    assert finding.message.values["seconds"] == pytest.approx(0.25, abs=0.1)


@pytest.mark.parametrize("preload_s", [0.1, 0.3, 0.5, 2.0])
@pytest.mark.parametrize("creep_m", [0.1e-3, 1.0e-3])
def test_creep_during_the_preload_is_no_movement(preload_s, creep_m):
    noise = Noise(seed=4, seconds=1.5, sample_rate=RATE)
    test = Desk().run(with_preload(noise.build(), preload_s))
    time = np.arange(test.samples) / RATE
    given_way = creep_m * (0.5 * (1.0 - np.exp(-time / 0.05)) + 0.5 * (1.0 - np.exp(-time / 0.4)))
    crept = with_signal(test, "position", test.signals["position"] + given_way)
    assert "reference_moved" not in found(crept)


def test_a_preload_that_was_lost_or_stands_still_is_not_judged(good):
    position = np.where((PLACE > 300) & (PLACE < 500), np.nan, good.signals["position"])
    assert "reference_moved" not in found(with_signal(good, "position", position))
    still = with_signal(good, "position", np.full(good.samples, 0.0125))
    assert {"reference_moved", "not_judged"}.isdisjoint(found(still))


def test_the_orientation_is_that_of_what_was_received_last(good):
    test = TURNED(good)
    signals = {name: np.where(PLACE < 5000, values, np.nan) for name, values in test.signals.items()}
    words = found(replace(test, signals=signals))["orientation_changed"].message
    assert words.values["degrees"] == pytest.approx(20.3, abs=0.3)


@pytest.mark.parametrize("hertz", [50.0, 60.0, 100.0])
def test_mains_are_named(good, hertz):
    humming = added("position", 2e-5 * np.sin(2 * np.pi * hertz * PLACE / RATE))
    assert says(found(humming(good))["mains"].message, "quality.mains", hertz=hertz)


def test_a_multisine_is_not_taken_for_mains(good):
    time_s = PLACE / RATE
    lines = sum(np.sin(2 * np.pi * hertz * time_s + hertz) for hertz in (10.0, 30.0, 50.0, 90.0, 110.0))
    values = np.where(time_s < 0.5, 5.0, 5.0 + lines)
    played = Desk().run(Stimulus(values, RATE, good.stimulus, 1, 2.0, preload_s=0.5))
    assert "mains" not in found(played)


def test_converters_at_their_end_are_counted(good):
    assert found(noted(saturated_samples=20.0)(good))["saturated"].severity == "look"


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
    test = lifting(Desk())
    for configuration in ("extension", "surface"):
        assert "probe_lifted" not in found(replace(test, configuration=configuration))


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
    assert says(finding.message, "quality.settling", direction="deeper", earlier="the first test at this site")
    assert finding.message.values["size"] == pytest.approx(0.2, abs=0.005)
    assert finding.advice == TISSUE.settling_advice
    move(desk.bench, 0.1e-3)
    third = desk.run()
    assert "settling" in found(third, desk.tests[:2])
    assert judge(desk.run(), DEVICE, (third,)).verdict == "good"


def test_a_test_unlike_its_repeats():
    desk = Desk("acrylamide-20", surface_m=0.010)
    desk.run(), desk.run()
    law = desk.bench.plant.tissue
    stiffness = replace(law.stiffness, coefficient=1.5 * law.stiffness.coefficient)
    layers = tuple(replace(layer, stiffness_n_per_m=1.5 * layer.stiffness_n_per_m) for layer in law.layers)
    desk.bench.plant.tissue = replace(law, stiffness=stiffness, layers=layers)
    findings = [f for f in judge(desk.run(), DEVICE, desk.tests[:-1]).findings if f.code == "unusual"]
    assert {f.severity for f in findings} == {"look", "repeat"}


def test_other_commands_are_compared_by_their_parameters():
    desks = [Desk("acrylamide-20", seed, 0.010) for seed in (1, 2, 3)]
    tests = [replace(desk.run(), number=place) for place, desk in enumerate(desks, 1)]
    assert judge(tests[2], DEVICE, tests[:2]).verdict == "good"
    other = replace(Desk("acrylamide-30", 4, 0.010).run(), number=4)
    assert "quality.unusual.stiffness" in {finding.message.code for finding in judge(other, DEVICE, tests).findings}


def test_another_site_is_not_compared(good):
    other = replace(Desk("acrylamide-30").run(), number=2, site="block")
    assert judge(other, DEVICE, (good,)).verdict == "good"


def test_a_surface_found_elsewhere(good):
    finding = found(replace(good, number=2, surface_position_m=good.surface_position_m + 2e-3), (good,))
    words = finding["surface_changed"].message
    assert says(words, "quality.surface_changed")
    assert (words.template, words.values["size"]) == (TISSUE.deeper, pytest.approx(2.0))


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
    def broken(_prepared):
        raise ZeroDivisionError

    monkeypatch.setattr(gate, "CHECKS", (broken,))
    quality = QualityGate(DEVICE).judge(good)
    assert [f.code for f in quality.findings] == ["not_judged"]
    assert quality.verdict == "look"


def test_a_session_with_impossible_values_is_not_good(good):
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
    monkeypatch.setattr(gate, "MAX_SAMPLES", 2 * good.samples)
    keeper = QualityGate(DEVICE)
    for number in range(1, 6):
        keeper.judge(replace(good, number=number))
    assert [test.number for test in keeper.earlier] == [4, 5]
    assert set(keeper.earlier[0].signals) == {"command", "force", "position"}


# -- kept with the test ------------------------------------------------------------------------------------------


def test_the_verdict_is_that_of_the_worst_finding():
    note, look = (QualityFinding(code, code, "Words.", "Advice.") for code in ("note", "look"))
    assert Quality((note,)).verdict == "good"
    assert Quality((look, note)).verdict == "look"
    assert Quality((look, note)).headline == HEADLINES["look"]


def test_the_session_file_holds_the_result(tmp_path):
    instrument = connect()
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device)
    for _ in range(2):
        run_guided_test(instrument, GuidedTest(usual_noise(RATE, seconds=1.0), TestSettings(site="arm")), recorder)
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
def test_an_invalid_note_is_ignored(good, note):
    notes = {} if note is None else {"quality": note}
    assert quality_of(replace(good, notes=notes)) is None


def test_a_hostile_note_is_limited(good):
    sound = {"code": "c", "severity": "look", "words": "w" * 5000, "advice": "a", "value": 1e400}
    items = [{"severity": "fatal"}, 7, sound, {**sound, "words": None}, *[sound] * 200]
    kept = quality_of(replace(good, notes={"quality": json.dumps({"findings": items})}))
    assert kept is not None
    assert 0 < len(kept.findings) < 60
    assert len(kept.findings[0].message) == 1000
    assert kept.findings[0].value is None


def test_stored_findings_keep_code_and_values(good):
    ended = replace(good, status="aborted", notes=good.notes | reason_notes(Message("t.why", "at {x:.1f}", x=0.25)))
    finding = found(ended)["ended_early"]
    assert says(finding.message.values["reason"], "t.why", x=0.25)
    kept = quality_of(replace(ended, notes=ended.notes | judge(ended, DEVICE).as_notes()))
    again = next(item for item in kept.findings if item.code == "ended_early")
    assert again == finding
    assert says(again.message.values["reason"], "t.why", x=0.25)


def test_findings_without_messages_still_read(good):
    old = {"code": "c", "severity": "look", "words": "Words.", "advice": "Advice.", "value": 0.1}
    notes = {"quality": json.dumps({"verdict": "look", "findings": [old]})}
    assert quality_of(replace(good, notes=notes)).lines == ("Words. Advice.",)
    long = {"template": "w" * 5000, "code": "c", "values": {}}
    for messages in (None, 7, {"words": 3}, {"words": long, "advice": {"template": "{a}"}}):
        notes = {"quality": json.dumps({"findings": [old | {"messages": messages}]})}
        assert quality_of(replace(good, notes=notes)).lines == ("Words. Advice.",)


def test_old_sessions_can_be_judged(good):
    session = Session(DeviceDescription(), tests=(good, replace(good, number=2)))
    assert [quality.verdict for _, quality in judge_session(session)] == ["good", "good"]
    assert partial(quality_of, good)() is None


@pytest.mark.parametrize(
    ("samples", "rate"), [(9000, 1.0), pytest.param(400_000, 2000.0, marks=pytest.mark.soak), (9000, 1e-6), (9000, 1e9)]
)
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
