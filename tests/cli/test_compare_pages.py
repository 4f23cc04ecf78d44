"""The page and the figures of ``tissueid compare``, and the engines of ``tissueid report``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from coded import shows
from reports.page_check import checked
from reports.synthetic_sitting import make_session, make_test

from tissueid.cli import main
from tissueid.reports import page as page_module
from tissueid.sessions import read_session, write_session


@pytest.fixture(scope="module")
def session_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("pages") / "session.h5"
    write_session(path, make_session(make_test(1, seconds=1.5)))
    return path


def test_page_and_figures_are_written(
    session_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    draw = page_module.plain_image

    def one(figure: object, target: Path, form: str) -> None:
        draw(figure, target, form) if "lms-impulse" in target.name else target.write_bytes(b"drawn")

    monkeypatch.setattr(page_module, "plain_image", one)
    page, folder = tmp_path / "compare.html", tmp_path / "figures"
    arguments = ("--engines", "lms", "--memory", "0.02", "--out", str(page), "--figures", str(folder))
    assert main(["compare", str(session_file), *arguments]) == 0
    assert f"report: {page}" in capsys.readouterr().out.replace("\n", "")
    assert "Impulse response" in checked(page.read_text(encoding="utf-8")).text
    assert "<svg" in (folder / "lms-impulse.svg").read_text(encoding="utf-8")
    assert (folder / "lms-impulse.png").read_bytes().startswith(b"\x89PNG")
    assert len(list(folder.iterdir())) > 10


def test_pictures_of_an_earlier_comparison_stay_and_are_named(
    session_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page_module, "plain_image", lambda _figure, target, _form: target.write_bytes(b"drawn"))
    folder = tmp_path / "figures"
    folder.mkdir()
    names = [*(f"dpn-{number}.svg" for number in range(4)), "holiday.png"]
    for name in (*names, "letter.txt"):
        (folder / name).write_text("mine", encoding="utf-8")
    arguments = ("--engines", "lms", "--memory", "0.02", "--figures", str(folder))
    for _ in range(2):  # what it wrote itself is not left over
        assert main(["compare", str(session_file), *arguments]) == 0
        said = " ".join(capsys.readouterr().out.split())
        listed = "dpn-0.svg, dpn-1.svg, dpn-2.svg, dpn-3.svg, …"
        assert shows(said, "compare.other_pictures", count="5", names=listed)
    assert all((folder / name).read_text(encoding="utf-8") == "mine" for name in (*names, "letter.txt"))


def test_what_is_not_a_page_is_not_written_over(
    session_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "letter.txt").write_text("dear", encoding="utf-8")
    for option in ("--out", "--figures"):
        assert main(["compare", str(session_file), "--engines", "lms", option, str(tmp_path / "letter.txt")]) == 2
        assert "letter.txt" in capsys.readouterr().err
    assert (tmp_path / "letter.txt").read_text(encoding="utf-8") == "dear"


def test_a_report_does_without_an_engine_that_cannot_use_the_test(session_file: Path, tmp_path: Path, capsys) -> None:
    session = read_session(session_file)
    first = session.tests[0]
    start = round(first.preload_s * first.sample_rate_hz)
    signals = {name: values[: start + 1400].copy() for name, values in first.signals.items()}
    signals["position"][start + 700 : start + 710] = np.nan
    write_session(tmp_path / "gappy.h5", replace(session, tests=(replace(first, signals=signals),)))
    page = tmp_path / "gappy.html"
    assert main(["report", str(tmp_path / "gappy.h5"), "--out", str(page), "--engines", "lms,spectral"]) == 0
    assert "without spectral: " in capsys.readouterr().out
    text = " ".join(page.read_text(encoding="utf-8").split())
    assert shows(text, "report.engine_failed", engine="Spectral")
    assert shows(text, "report.could_not_use", engine="Spectral")
    assert main(["report", str(tmp_path / "gappy.h5"), "--out", str(page), "--engines", "spectral"]) == 2
    assert main(["report", str(tmp_path / "gappy.h5"), "--out", str(page), "--engines", "lms,nosuch"]) == 2


def test_report_of_other_engines(session_file: Path, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    assert main(["report", str(session_file), "--out", str(page), "--engines", "lms,hammerstein"]) == 0
    text = checked(page.read_text(encoding="utf-8")).text
    assert "Structure: a curve, then linear dynamics (Hammerstein)" in text
    assert shows(text, "report.engine_not_run", engine="Wiener")
