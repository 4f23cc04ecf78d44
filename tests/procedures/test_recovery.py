"""The command line and the window recover the same session from the same journal, and log it alike."""

import json
import shutil

import numpy as np
import pytest
from coded import shows
from procedures.same_session import assert_same_session

from tissueid.acquisition import SessionRecorder
from tissueid.app.device_search import recover_all
from tissueid.audit import AuditLog, AuditTrail, last_lines
from tissueid.cli import main
from tissueid.device import DeviceDescription
from tissueid.instrument import SAMPLE, Run
from tissueid.messages import translated
from tissueid.procedures.control import Control
from tissueid.procedures.import_export import RecoveryPlan, run_recovery, unfinished_journals
from tissueid.sessions import read_session
from tissueid.wire import Flag


def leave_journal(folder, *, damaged):
    """Leave the journal of a test of 400 samples, of which the host lived to see 300."""
    folder.mkdir()
    recorder = SessionRecorder(folder / "s.h5", DeviceDescription())
    recorder.begin_test(Run(0, 400), kind="stochastic", site="forearm", sample_rate_hz=2000.0)
    samples = np.zeros(300, SAMPLE)
    samples["index"] = np.arange(300)
    samples["position"] = np.linspace(1e-3, 2e-3, 300)
    samples["flags"] = Flag.PLAYING
    for part in np.split(samples, 3):
        recorder.add(part)
    recorder.abandon()
    journal = folder / "s.h5.journal"
    if damaged:
        data = bytearray(journal.read_bytes())
        data[-len(samples[:100].tobytes()) // 2] ^= 0xFF
        journal.write_bytes(data)
    return journal


@pytest.mark.parametrize("damaged", [False, True])
def test_the_window_recovers_what_the_command_line_does(tmp_path, audit_file, capsys, damaged):
    shutil.copytree(leave_journal(tmp_path / "cli", damaged=damaged).parent, tmp_path / "window")
    answer = tmp_path / "answer.json"
    assert main(["recover", str(tmp_path / "cli" / "s.h5"), "--json", str(answer)]) == 0
    shown, problems = recover_all(tmp_path / "window", AuditTrail(AuditLog(audit_file), "researcher"))
    ours = read_session(tmp_path / "cli" / "s.h5")
    assert ours.test().samples == (200 if damaged else 300)
    assert_same_session(ours, read_session(tmp_path / "window" / "s.h5"))
    assert_same_session(ours, shown[0].session)
    lines = [(line.what, line.role, line.subject, line.new) for line in last_lines(audit_file, 9)]
    assert lines[-2] == lines[-1]
    assert len(json.loads(answer.read_text())["warnings"]) == len(problems) == damaged
    left = {path.name for path in (tmp_path / "cli").iterdir()}
    assert left == {path.name for path in (tmp_path / "window").iterdir()}
    assert left == ({"s.h5", "s.h5.journal.damaged"} if damaged else {"s.h5"})
    assert unfinished_journals(tmp_path / "window") == []


def test_what_could_not_be_logged_is_a_notice_of_both(tmp_path, audit_file, capsys):
    audit_file.write_bytes(b"something else\n")
    for name in ("cli", "window"):
        leave_journal(tmp_path / name, damaged=False)
    assert main(["recover", str(tmp_path / "cli" / "s.h5")]) == 0
    assert shows(capsys.readouterr().err, "audit.not_logged")
    shown, problems = recover_all(tmp_path / "window", AuditTrail(AuditLog(audit_file), "researcher"))
    assert len(shown) == 1
    assert shows(problems[0], "audit.not_logged")


def test_a_journal_that_fails_does_not_prevent_the_others(tmp_path, audit_file):
    leave_journal(tmp_path / "f", damaged=False)
    (tmp_path / "f" / "a.h5.journal").write_bytes(b"nothing of a journal")
    shown, problems = recover_all(tmp_path / "f", AuditTrail(AuditLog(audit_file), "researcher"))
    assert [one.path.name for one in shown] == ["s.h5"]
    assert len(problems) == 1


def test_warnings_are_notices_with_codes(tmp_path, audit_file):
    notices = []

    class Notices(Control):
        def notice(self, message):
            notices.append(message)

    journal = leave_journal(tmp_path / "f", damaged=True)
    out = tmp_path / "elsewhere.h5"
    trail = AuditTrail(AuditLog(audit_file), "researcher")
    recovered = run_recovery(RecoveryPlan(path=journal, out=out), Notices(), trail)
    assert recovered.path == out
    assert [notice.code for notice in notices] == ["recovery.damage"]
    assert recovered.warnings == tuple(notices)
    assert translated(notices[0])
