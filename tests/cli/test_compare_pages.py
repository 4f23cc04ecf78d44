"""The page and the figures of ``tissueid compare``, and the engines of ``tissueid report``."""

from __future__ import annotations

from pathlib import Path

import pytest
from reports.page_check import checked
from reports.synthetic_sitting import make_session, make_test

from tissueid.cli import main
from tissueid.sessions import write_session


@pytest.fixture(scope="module")
def session_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("pages") / "session.h5"
    write_session(path, make_session(make_test(1, seconds=1.5)))
    return path


def test_page_and_figures_are_written(session_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page, folder = tmp_path / "compare.html", tmp_path / "figures"
    arguments = ("--engines", "lms", "--memory", "0.02", "--out", str(page), "--figures", str(folder))
    assert main(["compare", str(session_file), *arguments]) == 0
    assert f"report: {page}" in capsys.readouterr().out.replace("\n", "")
    assert "Impulse response" in checked(page.read_text(encoding="utf-8")).text
    assert (folder / "lms-impulse.svg").exists()
    assert (folder / "lms-impulse.png").exists()


def test_what_is_not_a_page_is_not_written_over(
    session_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "letter.txt").write_text("dear", encoding="utf-8")
    for option in ("--out", "--figures"):
        assert main(["compare", str(session_file), "--engines", "lms", option, str(tmp_path / "letter.txt")]) == 2
        assert "letter.txt" in capsys.readouterr().err
    assert (tmp_path / "letter.txt").read_text(encoding="utf-8") == "dear"


def test_report_of_other_engines(session_file: Path, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    assert main(["report", str(session_file), "--out", str(page), "--engines", "lms,hammerstein"]) == 0
    text = checked(page.read_text(encoding="utf-8")).text
    assert "Structure: a curve, then linear dynamics (Hammerstein)" in text
    assert "the Wiener engine was not run" in text
