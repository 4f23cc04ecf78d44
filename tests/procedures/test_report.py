"""The command line and the window write the same report of a test."""

from __future__ import annotations

from pathlib import Path

import pytest
from app.fitted import analyse_once
from reports.synthetic_sitting import make_session, make_test

from tissueid import analysis
from tissueid.app.clinician import write_paper
from tissueid.app.session_jobs import find
from tissueid.app.views.clinician.comparing import SittingComparison
from tissueid.cli import main
from tissueid.errors import CancelledError, UnusableInputError
from tissueid.procedures.control import Control
from tissueid.procedures.saved_test import ReportPlan, run_report, write_page
from tissueid.sessions import write_session


@pytest.fixture(scope="module")
def session_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "s.h5"
    write_session(path, make_session(make_test()))
    return path


def test_the_same_page(session_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(analysis, "analyse_all", analyse_once)  # a page states how long each fit took
    command, window = tmp_path / "command.html", tmp_path / "window.html"
    assert main(["report", str(session_file), "--out", str(command), "--pdf", str(tmp_path / "command.pdf")]) == 0
    findings = find(session_file)
    write_page(window, findings.analysed)
    assert window.read_text(encoding="utf-8") == command.read_text(encoding="utf-8")
    paper = write_paper(findings, None, SittingComparison())
    assert paper.stat().st_size == pytest.approx((tmp_path / "command.pdf").stat().st_size, rel=0.02)


def test_a_cancelled_report_writes_nothing(session_file: Path, tmp_path: Path):
    class Cancelled(Control):
        def cancelled(self) -> bool:
            return True

    page = tmp_path / "page.html"
    with pytest.raises(CancelledError):
        run_report(ReportPlan(session=session_file, page=page), Cancelled())
    assert not page.exists()


def test_a_folder_that_cannot_be_written_is_named(session_file: Path, tmp_path: Path):
    with pytest.raises(UnusableInputError, match=r"cannot write .*absent"):
        write_page(tmp_path / "absent" / "page.html", find(session_file).analysed)
