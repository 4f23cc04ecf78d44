"""The command line and the window make the same session from the same plan, with the same entries in the audit log."""

import contextlib
import gc
import weakref

import pytest
from coded import coded
from procedures.same_session import assert_same_session
from support import connect, connect_scenario

from firmware_sim.scenario import Scenario
from tissueid.acquisition.stimulus_choice import save_stimulus
from tissueid.app.emergency import EmergencyStop
from tissueid.app.live_signals import LiveSignals
from tissueid.app.live_test import LiveTest
from tissueid.audit import AuditLog, AuditTrail, last_lines
from tissueid.cli import main
from tissueid.errors import CancelledError, InstrumentError, LimitError, UnusableInputError
from tissueid.instrument import SimulatedInstrument
from tissueid.procedures import test_run
from tissueid.procedures.test_plan import TestPlan
from tissueid.procedures.test_run import TestControl, run_test
from tissueid.sessions import read_session
from tissueid.stimuli import get_stimulus

URL = "simulated://baseline?seed=3"
SURFACE = {"configuration": "surface", "external_spring_n_per_m": 500.0}
EXCEPT = ("session_id", "created", "audit_head", "generating_share", "generating_longest_s")
"""Values that differ between two runs of one test: time, identity, and the time that the computer took."""


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    path = tmp_path_factory.mktemp("saved") / "stimulus.json"
    save_stimulus(path, get_stimulus("multisine").from_options({"seed": 4, "phases": "random"}).build())
    return path


def in_window(plan, audit_file, **services):
    """Run a plan as the window does, with a pace that waits for nothing."""
    control = LiveTest(LiveSignals(), EmergencyStop())
    trail = AuditTrail(AuditLog(audit_file), "researcher")
    usual = {"pace": lambda _: None, "separate_process": False}
    return run_test(plan, control, trail, **(usual | services)), control


def logged(audit_file, last):
    """Return what the newest lines log, without the session."""
    return [(line.what, line.role, line.new) for line in last_lines(audit_file, last)]


@pytest.mark.parametrize(
    ("options", "fields"),
    [
        ("", {}),
        (
            "--min-force 1 --max-force 6 --seconds 1 --seed 7 --distribution uniform --subject P-1",
            {
                "min_force_n": 1.0,
                "max_force_n": 6.0,
                "seconds": 1.0,
                "seed": 7,
                "distribution": "uniform",
                "subject": "P-1",
            },
        ),
        (
            "--stimulus multisine --option phases=schroeder --limits research --configuration extension",
            {
                "stimulus": "multisine",
                "options": (("phases", "schroeder"),),
                "limits": "research",
                "configuration": "extension",
            },
        ),
        (
            "--stimulus rtig --seconds 1.5 --depth-range 1:3",
            {"stimulus": "rtig", "seconds": 1.5, "depth_range_m": (1e-3, 3e-3)},
        ),
        ("--repeats 2 --rest 1 --seconds 0.5", {"repeats": 2, "rest_s": 1.0, "seconds": 0.5}),
        (
            "--multistep 2 --depth-range 1:3 --seconds 1.5 --target 0.001",
            {"multistep": 2, "depth_range_m": (1e-3, 3e-3), "seconds": 1.5, "target": 0.001},
        ),
        ("--stimulus-file SAVED", {"stimulus_file": "SAVED"}),
        ("--stop-when stiffness=0.2 --seconds 6", {"stop_when": ("stiffness=0.2",), "seconds": 6.0}),
    ],
    ids=["usual", "noise", "multisine", "feedback", "repeats", "steps", "file", "stop"],
)
def test_the_window_makes_the_session_of_the_command_line(tmp_path, audit_file, saved, options, fields):
    out = tmp_path / "cli.h5"
    line = [str(saved) if word == "SAVED" else word for word in options.split()]
    assert main(["test", "--device", URL, "--site", "left calf", "--out", str(out), *line]) == 0
    before = len(last_lines(audit_file, 99))
    fields = {name: saved if value == "SAVED" else value for name, value in fields.items()}
    plan = TestPlan(url=URL, site="left calf", out=tmp_path / "window.h5", **fields)
    outcome, control = in_window(plan, audit_file)
    assert outcome.error is outcome.not_saved is None
    ours = read_session(out)
    assert ours.tests
    assert_same_session(ours, read_session(plan.out), except_for=EXCEPT)
    assert_same_session(ours, outcome.session, except_for=EXCEPT)
    lines = logged(audit_file, 99)
    assert lines[before:] == lines[before - len(lines[before:]) : before]
    assert ("calibration.in_force", "researcher") in [line[:2] for line in lines[before:]]
    assert control.notices == []


class Stopping(TestControl):
    """Cancels the test after a given number of samples."""

    def __init__(self, most):
        self.left = most

    def received(self, progress):
        self.left -= progress.samples.size

    def check(self):
        if self.left < 0:
            raise CancelledError("stopped here")
        return False


def test_a_cancelled_test_keeps_its_samples_and_logs_why(tmp_path, audit_file):
    plan = TestPlan(url=URL, site="left calf", out=tmp_path / "s.h5")
    outcome = run_test(plan, Stopping(6000), AuditTrail(AuditLog(audit_file), "clinician"))
    assert outcome.cancelled
    assert not outcome.instrument_failed
    assert outcome.session.test().status == "aborted"
    assert [what for what, *_ in logged(audit_file, 3)] == ["test.stopped", "session.broken_off", "session.written"]


def test_without_samples_no_file_is_left(tmp_path, audit_file):
    plan = TestPlan(url=URL, site="left calf", out=tmp_path / "s.h5")
    outcome = run_test(plan, Stopping(-1), AuditTrail(AuditLog(audit_file), "clinician"))
    assert outcome.cancelled
    assert outcome.session is None
    assert list(tmp_path.iterdir()) == []


def test_both_lower_the_usual_force_to_that_of_the_instrument_and_say_so(tmp_path, audit_file, monkeypatch, capsys):
    def handheld(_url):
        return connect_scenario(Scenario(model="handheld", seed=3))

    monkeypatch.setattr(test_run, "open_instrument", handheld)
    plan = TestPlan(url="x", site="left calf", out=tmp_path / "window.h5", seconds=1.0)
    outcome, control = in_window(plan, audit_file)
    assert [(notice.code, notice.values["force"]) for notice in control.notices] == [("test.force_lowered", 7.8)]
    assert outcome.session.test().stimulus["stimulus"]["force_max_n"] == 7.8
    assert main(["test", "--device", "x", "--site", "a", "--out", str(tmp_path / "cli.h5"), "--seconds", "1"]) == 0
    assert "7.8 N instead of 10.5 N" in " ".join(capsys.readouterr().err.split())
    with pytest.raises(LimitError):
        in_window(plan.model_copy(update={"out": tmp_path / "no.h5", "max_force_n": 10.5}), audit_file)
    lowered = plan.model_copy(update={"out": tmp_path / "low.h5", "max_force_n": 10.5, "lower_force": True})
    assert in_window(lowered, audit_file)[0].session.test().stimulus["stimulus"]["force_max_n"] == 7.8


@pytest.mark.parametrize(
    ("fields", "code"),
    [
        ({"url": ""}, "plan.no_instrument"),
        ({"site": " "}, "plan.no_site"),
        ({"site": "a\nb"}, "plan.text"),
        ({"subject": "x" * 201}, "plan.text"),
        ({"limits": "none"}, "plan.limits"),
        ({"min_force_n": 5.0, "max_force_n": 4.0}, "plan.force_range"),
        ({"rest_s": 1.0}, "plan.rest"),
        ({"kind": "tissue"}, "plan.kind"),
        ({"depth_range_m": (1e-3, 1.01e-3)}, "plan.narrow_depth"),
        ({"depth_range_m": (1e-3, 2e-3)} | SURFACE, "plan.no_depth"),
        ({"multistep": 2}, "plan.multistep_depth"),
        ({"multistep": 2, "depth_range_m": (1e-3, 2e-3), "live": True}, "plan.multistep_options"),
        ({"multistep": 2, "depth_range_m": (1e-3, 2e-3), "stop_when": ("mass=0.1",)}, "plan.no_stop_rule"),
        ({"options": (("cutoff_hz", 50.0), ("cutoff_hz", 60.0))}, "plan.option_twice"),
        ({"stimulus_file": "a.json", "seconds": 1.0}, "plan.saved_stimulus"),
    ],
)
def test_a_plan_is_refused_before_an_instrument_is_opened(tmp_path, audit_file, fields, code):
    opened = []

    def open_instrument(url):
        opened.append(url)
        return SimulatedInstrument()

    plan = TestPlan(**({"url": "x", "site": "a", "out": tmp_path / "s.h5"} | fields))
    with pytest.raises(UnusableInputError, check=coded(code)):
        in_window(plan, audit_file, opener=open_instrument)
    assert opened == []


@pytest.mark.parametrize(
    ("name", "code"),
    [("there.h5", "save_path.exists"), ("left.h5", "save_path.unfinished"), ("f/s.h5", "save_path.no_folder")],
)
def test_the_path_of_the_session_is_checked_first_by_both(tmp_path, audit_file, capsys, name, code):
    (tmp_path / "there.h5").touch()
    (tmp_path / "left.h5.journal").touch()
    out = tmp_path / name
    with pytest.raises(UnusableInputError, check=coded(code)):
        in_window(TestPlan(url="nothing", site="a", out=out), audit_file)
    assert main(["test", "--device", "nothing", "--site", "a", "--out", str(out)]) == 2
    assert "nothing" not in capsys.readouterr().err.splitlines()[-1].replace(str(tmp_path), "")


@pytest.mark.parametrize("how", ["refused", "tripped"])
def test_a_run_that_fails_leaves_nothing_behind_for_a_collection(tmp_path, how):
    """Its error would hold the frames, and these the instrument: half a megabyte a run until a full collection."""
    opened = []

    def opener(_url):
        instrument = connect()
        opened.append(weakref.ref(instrument))
        if how == "tripped":
            instrument.link.firmware.bench.stuck.add("position")
        return instrument

    most_n = 14.0 if how == "refused" else 6.0
    plan = TestPlan(url="x", site="s", out=tmp_path / "s.h5", seconds=1.0, min_force_n=most_n - 1.0, max_force_n=most_n)
    gc.disable()
    try:
        with contextlib.suppress(LimitError):
            outcome = run_test(plan, TestControl(), None, opener=opener, separate_process=False)
            assert isinstance(outcome.error, InstrumentError)
        assert [reference() for reference in opened] == [None]
    finally:
        gc.enable()
