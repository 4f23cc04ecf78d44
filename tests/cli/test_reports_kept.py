"""Reports that a person may have kept: renewed by the same session, refused to any other, before any work."""

from dataclasses import replace

import pytest
from coded import coded, shows
from reports.synthetic_sitting import make_session, make_test

from tissueid.cli import main
from tissueid.errors import UnusableInputError
from tissueid.procedures.output_files import check_new, check_report
from tissueid.sessions import write_session

OWN = "5b2ad2c4-0000-4000-8000-000000000001"
HEAD = "<!DOCTYPE html>\n<html><body>Session {}.</body></html>"


@pytest.fixture
def session_file(tmp_path):
    path = tmp_path / "s.h5"
    write_session(path, replace(make_session(make_test()), session_id=OWN))
    return path


def test_a_report_of_the_same_session_may_be_written_again(tmp_path):
    session = replace(make_session(make_test()), session_id=OWN)
    page = tmp_path / "page.html"
    check_report(None, session)
    check_report(page, session)
    page.touch()
    check_report(page, session)
    page.write_text(HEAD.format(OWN), encoding="utf-8")
    check_report(page, session)
    with pytest.raises(UnusableInputError, check=coded("file.other_report", path=str(page))):
        check_report(page, replace(session, session_id="another"))
    with pytest.raises(UnusableInputError, check=coded("file.other_report", path=str(page))):
        check_report(page, replace(session, session_id=""))


@pytest.mark.parametrize(
    ("command", "name", "content"),
    [
        (("report", "--out"), "page.html", HEAD.format("another")),
        (("report", "--out", "fresh.html", "--pdf"), "page.pdf", "%PDF-1.4 another"),
        (("compare", "--out"), "page.html", HEAD.format("another")),
        (("gap", "diagnose", "--out"), "page.html", HEAD.format("another")),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_a_report_of_another_session_is_not_replaced(
    session_file, tmp_path, monkeypatch, capsys, command, name, content
):
    monkeypatch.chdir(tmp_path)
    kept = tmp_path / name
    kept.write_text(content, encoding="utf-8")
    words = [word for word in command if not word.startswith("--") and not word.endswith(".html")]
    options = list(command[len(words) :])
    assert main([*words, str(session_file), *options, str(kept)]) == 2
    assert shows(capsys.readouterr().err, "file.other_report")
    assert kept.read_text(encoding="utf-8") == content
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(["s.h5", name])


@pytest.mark.parametrize("kind", ["static", "sweep"])
def test_the_report_of_an_earlier_calibration_is_not_replaced(tmp_path, capsys, kind):
    kept = tmp_path / "page.html"
    kept.write_text(HEAD.format("of a calibration"), encoding="utf-8")
    arguments = ["calibrate", kind, "--device", "simulated://spring", "--out", str(tmp_path / "c.toml")]
    assert main([*arguments, "--report", str(kept)]) == 2
    assert "already exists" in " ".join(capsys.readouterr().err.split())
    assert kept.read_text(encoding="utf-8") == HEAD.format("of a calibration")
    check_new(tmp_path / "new.html")
