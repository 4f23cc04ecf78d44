"""The audit log from the shell: `tissueid audit`, and what other commands write."""

from __future__ import annotations

import json
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from audit_logs import a_log, rows
from coded import shows

from tissueid.acquisition import SessionRecorder
from tissueid.audit import (
    AuditLog,
    last_lines,
    verify,
)
from tissueid.audit.line import make_line
from tissueid.cli import main
from tissueid.device import DeviceDescription
from tissueid.errors import FirmwareFaultError
from tissueid.instrument import SAMPLE, Run
from tissueid.procedures import calibrations
from tissueid.procedures.calibrations import Sweep
from tissueid.sessions import Session, write_session
from tissueid.wire import Flag


def test_a_whole_log_ends_with_status_0(audit_file, capsys):
    a_log(audit_file)
    assert main(["audit", "verify"]) == 0
    assert "5 lines, none altered" in capsys.readouterr().out


def test_a_broken_log_ends_with_status_2_and_one_line(path, tmp_path, capsys):
    path.write_bytes(path.read_bytes().replace(b"P1", b"P2"))
    assert main(["audit", "verify", "--log", str(path), "--json", str(tmp_path / "a.json")]) == 2
    assert shows(capsys.readouterr().err, "audit.changed", line=3)
    answer = json.loads((tmp_path / "a.json").read_text())
    assert (answer["whole"], answer["lines"], answer["broken"]["damage"]) == (False, 2, "changed")


def test_sessions_and_calibrations_tell_of_an_end_that_was_cut_off(path, tmp_path, capsys):
    head = verify(path).head
    session, calibration, none = (tmp_path / name for name in ("s.h5", "c.toml", "none.h5"))
    write_session(session, Session(DeviceDescription(), audit_head=head))
    write_session(none, Session(DeviceDescription()))
    calibration.write_text(f'[conditions]\naudit_head = "{head}"\n')
    arguments = ["audit", "verify", "--log", str(path)]
    assert main([*arguments, str(session), str(calibration), str(none), "--head", head]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "none.h5 contains no head of the log" in said
    assert "all 1 heads are in it" in said
    path.write_bytes(b"".join(rows(path)[:-1]))
    for file in (session, calibration):
        assert main([*arguments, str(file)]) == 2
        assert shows(capsys.readouterr().err, "audit.cut_off", number=5, lines=4)


def test_an_emptied_log_and_one_that_was_removed_are_no_logs_that_nothing_was_written_to(path, tmp_path, capsys):
    empty = tmp_path / "new.jsonl"
    empty.touch()
    assert main(["audit", "verify", "--log", str(empty)]) == 0
    assert "nothing has been logged yet" in capsys.readouterr().out
    lines = rows(path)
    path.write_bytes(b"")
    assert main(["audit", "verify", "--log", str(path)]) == 2
    assert shows(capsys.readouterr().err, "audit.cut_off", number=5, lines=0)
    path.unlink()
    assert main(["audit", "verify", "--log", str(path)]) == 2
    assert shows(capsys.readouterr().err, "audit.log_removed", path=str(path), number=5)
    AuditLog(path).record("clinician", "test.begun")
    moved = tmp_path / "2025.jsonl"
    moved.write_bytes(b"".join(lines))
    assert main(["audit", "verify", "--log", str(path)]) == 2
    said = capsys.readouterr().err
    assert shows(said, "audit.lines_missing", place=2, number=5)
    assert len(said.splitlines()) == 1
    assert main(["audit", "verify", "--log", str(path), "--after", str(moved)]) == 0


def test_show_prints_the_newest_lines(path, capsys):
    path.write_bytes(path.read_bytes())
    AuditLog(path).record("clinician", "settings.changed", old="dark", new="\x1b[31mlight")
    assert main(["audit", "show", "--log", str(path), "--last", "2"]) == 0
    said = capsys.readouterr().out
    assert "settings.changed" in said
    assert "?[31mlight" in said
    assert "P3" in said
    assert "P2" not in said
    assert main(["audit", "show", "--log", str(path), "--last", "1", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["old"] == "dark"


def test_refusals(tmp_path, capsys):
    (tmp_path / "x.toml").write_bytes(b"\xff")
    a_log(tmp_path / "a.jsonl", 1)
    for arguments, words in (
        (["audit", "verify", "--log", str(tmp_path / "none")], "there is no audit log"),
        (["audit", "show", "--log", str(tmp_path / "none")], "nothing has been logged yet, or the log was moved"),
        (["audit", "verify", str(tmp_path / "x.toml")], "is not a calibration"),
        (["audit", "verify", str(tmp_path / "x.h5")], "no such file"),
        (["audit", "verify", "--log", str(tmp_path / "a.jsonl"), "--head", "5"], "NUMBER:HASH"),
        (["--role", "boss", "devices"], "clinician or researcher or technician"),
    ):
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("TISSUEID_ROLE", "clinician")
            assert main(arguments) == 2
        said = capsys.readouterr().err
        assert words in said
        assert said.count("\n") == 1


def run_a_test(out: Path, *more: str) -> int:
    arguments = ["test", "--device", "simulated://forearm", "--site", "forearm", "--seconds", "0.5"]
    return main([*arguments, "--subject", "B17", "--out", str(out), *more])


def test_a_test_from_the_shell_is_logged(audit_file, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("TISSUEID_ROLE", "clinician")
    assert run_a_test(tmp_path / "s.h5", "--limits", "research") == 0
    lines = last_lines(audit_file, 100)
    assert [line.what for line in lines] == [
        "audit.started",
        "calibration.in_force",
        "session.begun",
        "limits.chosen",
        "test.begun",
        "test.completed",
        "session.written",
    ]
    assert {line.role for line in lines} == {"clinician"}
    assert lines[2].new["pseudonym"] == "B17"
    assert lines[4].new["site"] == "forearm"
    assert lines[5].new["samples"] == 2000
    assert main(["audit", "verify", str(tmp_path / "s.h5")]) == 0
    audit_file.write_bytes(b"".join(rows(audit_file)[:-2]))
    assert main(["audit", "verify", str(tmp_path / "s.h5")]) == 2
    assert shows(capsys.readouterr().err, "audit.cut_off")


def test_a_test_that_cannot_be_logged_is_refused_and_leaves_nothing(tmp_path, monkeypatch, capsys):
    (tmp_path / "file").touch()
    monkeypatch.setenv("TISSUEID_AUDIT", str(tmp_path / "file" / "audit.jsonl"))
    assert run_a_test(tmp_path / "s.h5") == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert shows(said, "audit.unwritable", variable="TISSUEID_AUDIT")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_log_in_a_folder_that_is_not_there_is_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("TISSUEID_AUDIT", str(tmp_path / "missing" / "audit.jsonl"))
    assert run_a_test(tmp_path / "s.h5") == 2
    assert shows(capsys.readouterr().err, "file.no_folder", folder=str(tmp_path / "missing"))
    assert list(tmp_path.iterdir()) == []


def test_an_empty_log_is_said_to_be_empty(tmp_path, capsys):
    (tmp_path / "log").touch()
    assert main(["audit", "verify", "--log", str(tmp_path / "log")]) == 0
    result = capsys.readouterr().out
    assert "nothing has been logged yet" in " ".join(result.split())
    assert "head:" not in result


def test_a_wrong_role_blames_the_option(capsys):
    assert main(["--role", "boss", "devices", "--no-probe"]) == 2
    said = capsys.readouterr().err
    assert "--role must be clinician or researcher or technician, got 'boss'" in said


def test_a_recovery_is_logged_and_never_refused(audit_file, tmp_path, monkeypatch, capsys):
    for name in ("s.h5", "t.h5"):
        recorder = SessionRecorder(tmp_path / name, DeviceDescription())
        recorder.begin_test(Run(0, 10), kind="stochastic", site="forearm", sample_rate_hz=2000.0)
        samples = np.zeros(10, SAMPLE)
        samples["index"] = np.arange(10)
        samples["flags"] = Flag.PLAYING
        recorder.add(samples)
        recorder.abandon()
    assert main(["recover", str(tmp_path / "s.h5")]) == 0
    line = last_lines(audit_file, 1)[0]
    assert (line.what, line.new) == ("session.recovered", {"tests": 1, "samples": 10})
    audit_file.write_bytes(b"something else\n")
    assert main(["recover", str(tmp_path / "t.h5")]) == 0
    assert (tmp_path / "t.h5").exists()
    assert "not in the audit log: the last line of the audit log" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("error", "what", "why"),
    [
        (KeyboardInterrupt(), "calibration.stopped", "KeyboardInterrupt"),
        (FirmwareFaultError("the button"), "calibration.broken_off", "the button"),
    ],
)
@pytest.mark.parametrize("kind", ["static", "sweep"])
def test_a_calibration_from_the_shell_that_broke_off_has_an_end_in_the_log(
    audit_file, tmp_path, monkeypatch, capsys, kind, error, what, why
):
    def fails(*_, **__):
        raise error

    monkeypatch.setattr(calibrations, "calibrate_static", fails)
    monkeypatch.setattr(Sweep, "run", fails)
    assert main(["calibrate", kind, "--device", "simulated://forearm", "--out", str(tmp_path / "c.toml")]) != 0
    lines = [line for line in last_lines(audit_file, 100) if line.what.startswith("calibration.")]
    assert [line.what for line in lines] == ["calibration.begun", what]
    assert (lines[0].new, lines[1].new) == (kind, why)
    assert lines[0].subject == lines[1].subject != ""
    assert {line.role for line in lines} == {"technician"}


@pytest.mark.soak
def test_a_hundred_thousand_lines_are_verified_in_seconds(tmp_path):
    log = a_log(tmp_path / "a.jsonl", 1)
    last = last_lines(log.path, 1)[0]
    with log.path.open("ab") as file:
        while last.number < 100_000:
            fields = asdict(last) | {"number": last.number + 1, "previous": last.hash}
            del fields["hash"]
            last, raw = make_line(**fields)
            file.write(raw)
    begin = time.perf_counter()
    assert verify(log.path).lines == 100_000
    assert time.perf_counter() - begin < 10.0
    log.record("clinician", "test.begun")
    assert verify(log.path).whole
