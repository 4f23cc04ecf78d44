"""The command line and the window make the same calibration from the same plan, and log it alike."""

import json
from pathlib import Path

import pytest
import support
from procedures.same_session import assert_same_session
from support import LONG_TICK_S, connect_scenario

from firmware_sim.scenario import Scenario
from tissueid.app.calibration_controller import LiveCalibration, OperatorPrompts, calibrate
from tissueid.app.context import AppServices
from tissueid.app.emergency import BY_BUTTON, EmergencyStop
from tissueid.audit import AuditLog, AuditTrail, last_lines
from tissueid.calibration import read_calibration, spring_points
from tissueid.cli import main
from tissueid.errors import CancelledError
from tissueid.procedures import calibrations
from tissueid.procedures.calibration_plans import DynamicSweepPlan, StaticCalibrationPlan
from tissueid.procedures.calibrations import Sweep
from tissueid.sessions import read_session

STATIC = ("--steps", "electrical,temperature", "--ambient", "24", "--push-only")
SWEEP = ("--from", "8", "--to", "24", "--step", "4", "--seconds", "1")
PLANS = {
    "static": StaticCalibrationPlan(steps=("electrical", "temperature"), ambient_c=24.0, push_only=True),
    "sweep": DynamicSweepPlan(from_m=0.008, to_m=0.024, step_m=0.004, seconds=1.0),
}


@pytest.fixture
def spring(monkeypatch):
    """Opens a new device on the calibration spring, the same each time."""
    monkeypatch.setattr(support, "TICK_S", LONG_TICK_S)
    monkeypatch.setattr(spring_points, "GENTLE_S", 0.5)
    for module in ("acquisition.guided", "calibration.spring_points"):
        # The number of polls during other work depends on the computer, and each changes the noise of the device.
        monkeypatch.setattr(f"tissueid.{module}.run_while_polling", lambda _instrument, work, *_: work())
    scenario = Scenario(preset="calibration-spring", coil="finite", seed=5)

    def opened(url):
        assert url == "spring"
        return connect_scenario(scenario)

    monkeypatch.setattr(calibrations, "open_instrument", opened)
    return opened


def in_window(kind, folder, opener, audit_file, stop=None):
    prompts = OperatorPrompts(stop or EmergencyStop(), LiveCalibration(sweep=kind == "sweep"))
    plan = PLANS[kind].model_copy(update={"device": "spring", "folder": folder, "all_files": True})
    trail = AuditTrail(AuditLog(audit_file), "technician")
    return calibrate(plan, prompts, trail, AppServices(opener=opener))


def content(path: Path):
    """What a calibration says, without what differs from one run to the next."""
    found = read_calibration(path)
    conditions = {name: value for name, value in found.conditions.items() if name not in ("audit_head", "session_id")}
    assert found.conditions["audit_head"]
    return found.model_copy(update={"date": "", "conditions": conditions})


def entries(audit_file):
    lines = [line for line in last_lines(audit_file, 100) if line.what.startswith("calibration.")]
    return [(line.role, line.what, line.subject, line.new) for line in lines]


@pytest.mark.parametrize(("kind", "options"), [("static", STATIC), ("sweep", SWEEP)])
def test_the_window_makes_the_calibration_that_the_command_line_does(spring, tmp_path, audit_file, kind, options):
    """Also the report and the recording, and the same entries in the audit log."""
    ours, theirs = tmp_path / "cli", tmp_path / "window"
    for folder in (ours, theirs):
        folder.mkdir()
    files = ["--out", ours / "a.toml", "--report", ours / "a.html", "--json", ours / "a.json"]
    files += ["--session", ours / "a.h5"] if kind == "sweep" else []
    assert main(["calibrate", kind, "--device", "spring", *options, *map(str, files)]) == 0
    outcome = in_window(kind, theirs, spring, audit_file)
    assert outcome.path.parent == theirs
    assert content(ours / "a.toml") == content(outcome.path)
    assert outcome.report.stat().st_size == pytest.approx((ours / "a.html").stat().st_size, rel=1e-3)
    answer = json.loads((ours / "a.json").read_text())
    assert answer["quantities"] == {name: q.model_dump() for name, q in outcome.calibration.quantities.items()}
    assert answer["notes"] == list(outcome.remarks)
    if kind == "sweep":
        first, second = read_session(ours / "a.h5"), read_session(outcome.path.with_suffix(".h5"))
        assert_same_session(first, second, ("session_id", "created", "audit_head", "started"))
    begun, made, *again = entries(audit_file)
    assert begun == ("technician", "calibration.begun", answer["serial_number"], kind)
    assert made[3]["file"] == "a.toml"
    made[3]["file"] = outcome.path.name
    assert again == [begun, made]


@pytest.mark.parametrize("kind", ["static", "sweep"])
def test_both_log_a_calibration_that_was_stopped_alike(spring, tmp_path, audit_file, monkeypatch, kind):
    def poll_until_stopped(*_, **__):
        raise CancelledError("stopped")

    monkeypatch.setattr(calibrations, "calibrate_static", poll_until_stopped)
    monkeypatch.setattr(Sweep, "run", poll_until_stopped)
    assert main(["calibrate", kind, "--device", "spring", "--out", str(tmp_path / "a.toml")]) != 0
    with pytest.raises(CancelledError):
        in_window(kind, tmp_path, spring, audit_file)
    first, second = entries(audit_file)[:2], entries(audit_file)[2:]
    assert first == second
    assert [what for _, what, _, _ in first] == ["calibration.begun", "calibration.stopped"]
    assert list(tmp_path.iterdir()) == []


def test_a_stop_before_the_instrument_answers_leaves_no_entry(spring, tmp_path, audit_file):
    stop = EmergencyStop()
    stop.press(BY_BUTTON)
    with pytest.raises(CancelledError):
        in_window("static", tmp_path, spring, audit_file, stop)
    assert not audit_file.exists()


def test_neither_replaces_a_file(spring, tmp_path, audit_file):
    """The command line refuses before anything moves; the window takes a free name."""
    kept = tmp_path / "a.toml"
    first = in_window("static", tmp_path, spring, audit_file).path
    kept.write_bytes(first.read_bytes())
    before = entries(audit_file)
    arguments = ["calibrate", "static", "--device", "spring", *STATIC, "--out", str(kept)]
    assert main(arguments) == 2
    assert kept.read_bytes() == first.read_bytes()
    assert entries(audit_file) == before
    second = in_window("static", tmp_path, spring, audit_file)
    assert second.path != first
    assert second.report != first.with_suffix(".html")
    assert main([*arguments, "--overwrite"]) == 0
    assert kept.read_bytes() != first.read_bytes()


def test_without_a_name_the_command_line_files_a_calibration_where_the_window_does(spring, tmp_path, audit_file):
    arguments = ["calibrate", "static", "--device", "spring", *STATIC, "--calibrations", str(tmp_path)]
    assert main(arguments) == 0
    (path,) = tmp_path.iterdir()
    other = in_window("static", tmp_path, spring, audit_file).path
    assert path.parent == other.parent
    assert path.name.rpartition("-static-")[0] == other.name.rpartition("-static-")[0]
