"""``tissueid quality``, and the verdict in the answers of other commands."""

import json
from dataclasses import replace

import numpy as np
import pytest
from coded import made, shows
from shell import complaint

from tissueid.cli import main
from tissueid.sessions import read_session, write_session
from tissueid.sessions.quality import HEADLINES, Quality, QualityFinding


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    out = tmp_path_factory.mktemp("quality") / "s.h5"
    told = out.with_suffix(".json")
    command = [
        "test",
        "--device",
        "simulated://baseline?seed=1",
        "--site",
        "arm",
        "--out",
        str(out),
        "--seconds",
        "1.5",
    ]
    assert main([*command, "--seconds", "1.5", "--repeats", "2", "--json", str(told)]) == 0
    return out, json.loads(told.read_text())


def test_a_test_ends_with_its_verdict(session):
    _, told = session
    assert [test["verdict"] for test in told["tests"]] == ["good", "good"]
    assert [finding["code"] for finding in told["tests"][0]["quality"]] == ["calibration_none"]
    assert set(told["tests"][0]["quality"][0]) == {"code", "severity", "words", "advice", "value", "messages"}


def test_a_site_that_looks_like_markup_is_shown_as_it_is(session, tmp_path, capsys):
    one = read_session(session[0])
    odd = replace(one, tests=tuple(replace(test, site="[/b] arm [left]") for test in one.tests))
    write_session(tmp_path / "odd.h5", odd)
    assert main(["quality", str(tmp_path / "odd.h5")]) == 0
    assert "[/b] arm [left]" in " ".join(capsys.readouterr().out.split())


def test_a_saved_session_is_judged_anew(session, tmp_path, capsys):
    path, _ = session
    answer = tmp_path / "q.json"
    assert main(["quality", str(path), "--json", str(answer)]) == 0
    printed = capsys.readouterr().out
    assert "test 1: Good test" in printed
    assert f"note: {made('quality.calibration_none')}" in " ".join(printed.split())
    tests = json.loads(answer.read_text())["tests"]
    assert [(test["test"], test["verdict"], test["verdict_when_recorded"]) for test in tests] == [
        (1, "good", "good"),
        (2, "good", "good"),
    ]
    assert main(["quality", str(path), "--test", "2", "--json", str(answer)]) == 0
    assert [test["test"] for test in json.loads(answer.read_text())["tests"]] == [2]


def test_what_is_judged_anew_is_the_recording_and_not_the_note(session, tmp_path, capsys):
    path, _ = session
    saved = read_session(path)
    first = saved.test(1)
    position = first.signals["position"].copy()
    position[2500:] = position[2500]
    spoilt = replace(first, signals=first.signals | {"position": position})
    write_session(tmp_path / "stuck.h5", replace(saved, tests=(spoilt,)))
    answer = tmp_path / "q.json"
    assert main(["quality", str(tmp_path / "stuck.h5"), "--json", str(answer)]) == 0
    assert shows(capsys.readouterr().out.partition("REPEAT: ")[2], "quality.sensor_stuck", signal="position")
    test = json.loads(answer.read_text())["tests"][0]
    assert (test["verdict"], test["verdict_when_recorded"]) == ("repeat", "good")


def test_engines_warn_of_a_test_that_was_to_be_repeated(session, tmp_path, capsys):
    path, _ = session
    saved = read_session(path)
    stuck = "The reading stood still."
    bad = Quality((QualityFinding("sensor_stuck", "repeat", stuck, "Repeat it."),))
    tests = (replace(saved.test(1), notes=saved.test(1).notes | bad.as_notes()), saved.test(2))
    write_session(tmp_path / "bad.h5", replace(saved, tests=tests))
    answer = tmp_path / "a.json"
    for command in (["identify", "--engine", "lms"], ["compare", "--engines", "lms,spectral"]):
        arguments = [command[0], str(tmp_path / "bad.h5"), *command[1:], "--test"]
        assert main([*arguments, "1", "--json", str(answer)]) == 0
        assert shows(capsys.readouterr().out, "quality.advised_repeat", test=1, finding=stuck)
        assert len(json.loads(answer.read_text())["quality_warnings"]) == 1
        assert main([*arguments, "2"]) == 0
        assert "advised to repeat" not in capsys.readouterr().out
    page = tmp_path / "r.html"
    assert main(["report", str(tmp_path / "bad.h5"), "--out", str(page)]) == 0
    text = page.read_text()
    assert f"Recording: {HEADLINES['repeat']}" in text
    assert text.count(HEADLINES["repeat"]) == 2  # the headline, and what the gate said


def test_refusals_are_one_line(session, tmp_path, capsys):
    path, _ = session
    (tmp_path / "no.h5").write_bytes(b"nothing")
    for arguments, words in (
        ([str(tmp_path / "no.h5")], "damaged, or not an HDF5 session"),
        ([str(path), "--test", "9"], "the session has no test 9"),
    ):
        assert words in complaint(capsys, "quality", *arguments)


def test_a_session_of_outside_data_can_be_judged(tmp_path, capsys):
    from tissueid.device import DeviceDescription
    from tissueid.sessions import Session, Test

    time = np.arange(4000) / 2000.0
    signals = {"force": 5 + np.sin(60 * time), "position": 0.012 + 1e-4 * np.sin(60 * time + 1)}
    test = Test(number=1, kind="stochastic", signals=signals, sample_rate_hz=2000.0)
    write_session(tmp_path / "out.h5", Session(DeviceDescription(), tests=(test,)))
    assert main(["quality", str(tmp_path / "out.h5")]) == 0
    assert "not judged" in capsys.readouterr().out
