"""The commands as people and scripts meet them: answers by the contract, one line for what cannot be used."""

import json
import os
import signal
import sys

import numpy as np
import platformdirs
import pytest
from golden.golden_page import check_golden_page
from numpy.lib.stride_tricks import sliding_window_view
from outside_data import RIG
from shell import answer, complaint

from tissueid.cli import main
from tissueid.device import DeviceDescription
from tissueid.identification.base import PREDICTS_NOTHING
from tissueid.procedures import instruments, test_run
from tissueid.sessions import Session, Test, read_session, write_session

A_TEST = ["test", "--device", "simulated://forearm", "--site", "x", "--out", "FOLDER/a.h5"]
ENGINES = ("lms", "spectral", "wiener")
BLIND = [(path, ENGINES[number % 3]) for number, path in enumerate(sorted(RIG.glob("*.h5")))]
"""Sessions of the independent rigs, each with one engine in rotation."""

KEYS = {
    "engine",
    "options",
    "n_samples",
    "n_parameters",
    "vaf_percent",
    "vaf_validation_percent",
    "vaf_scheduled_percent",
    "aicc",
    "parameters",
    "seconds",
    "warnings",
}


@pytest.fixture(scope="module")
def session_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("cli") / "session.h5"
    arguments = ["test", "--device", "simulated://forearm?seed=4", "--site", "left forearm", "--out", str(path)]
    assert main([*arguments, "--repeats", "2", "--seconds", "2", "--subject", "P-7"]) == 0
    return path


def test_a_test_from_the_shell(session_file):
    session = read_session(session_file)
    assert [test.status for test in session.tests] == ["completed", "completed"]
    assert session.tests[1].repeat_of == 1
    assert session.subject.pseudonym == "P-7"
    np.testing.assert_array_equal(session.tests[0].signals["command"], session.tests[1].signals["command"])


@pytest.mark.parametrize("engine", ENGINES)
def test_identify_answers_by_the_contract(session_file, capsys, engine):
    result = answer(capsys, "identify", session_file, "--engine", engine)
    assert result.keys() >= KEYS
    assert result["engine"] == engine
    assert 50 < result["vaf_percent"] <= 100
    assert 50 < result["vaf_validation_percent"] <= 100
    assert result["vaf_scheduled_percent"] is None
    assert result["seconds"] > 0
    for name in ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m"):
        assert result["parameters"][name]["value"] > 0
        assert result["parameters"][name]["std"] > 0


def test_identify_validates_on_another_test(session_file, capsys):
    result = answer(capsys, "identify", session_file, "--engine", "lms", "--test", 2, "--validate", 1)
    assert (result["test"], result["validated_on"]) == (2, "test 1")


def test_options_reach_the_engine(session_file, capsys):
    result = answer(capsys, "identify", session_file, "--engine", "lms", "--memory", 0.06, "--option", "method=svd")
    assert result["options"]["memory"] == 0.06
    assert result["options"]["method"] == "svd"


def test_json_goes_to_a_file_whole(session_file, tmp_path):
    target = tmp_path / "answer.json"
    assert main(["identify", str(session_file), "--engine", "lms", "--json", str(target)]) == 0
    assert json.loads(target.read_text())["engine"] == "lms"
    assert [path.name for path in tmp_path.iterdir()] == ["answer.json"]


def test_people_get_a_table(session_file, capsys):
    assert main(["identify", str(session_file), "--engine", "lms"]) == 0
    printed = capsys.readouterr().out
    assert "VAF on the fitted samples" in printed
    assert "N/m" in printed


def test_a_report_is_one_page(session_file, tmp_path):
    page = tmp_path / "report.html"
    assert main(["report", str(session_file), "--out", str(page)]) == 0
    assert page.read_text(encoding="utf-8").lstrip().startswith("<!DOCTYPE html>")


def test_devices_lists_the_simulation(capsys):
    found = answer(capsys, "devices", "--no-probe")
    assert "simulated://forearm" in {item["url"] for item in found}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["identify", "SESSION", "--engine", "magic"], "magic"),
        (["identify", "SESSION", "--engine", "lms", "--test", "9"], "no test 9; it has 1, 2"),
        (["identify", "SESSION", "--engine", "lms", "--test", "1", "--validate", "1"], "validate on another"),
        (["identify", "SESSION", "--engine", "lms", "--input", "torque"], "no signal 'torque'"),
        (["identify", "SESSION", "--engine", "lms", "--memory", "-1"], "memory"),
        (["identify", "SESSION", "--engine", "lms", "--memory", "100"], "memory"),
        (["identify", "SESSION", "--engine", "lms", "--option", "colour=red"], "colour"),
        (["identify", "SESSION", "--engine", "lms", "--option", "colour"], "NAME=VALUE"),
        (["identify", "SESSION"], "--engine"),
        (["identify", "nothing.h5", "--engine", "lms"], "no such file"),
        (["identify", "RUBBISH", "--engine", "lms"], "damaged, or not an HDF5 session"),
        (["identify", "FOLDER", "--engine", "lms"], "is a folder"),
        (["identify", "SESSION", "--engine", "lms", "--json", "FOLDER/no/where.json"], "no folder"),
        (["recover", "nothing.h5"], "nothing to recover"),
        (["report", "SESSION", "--out", "FOLDER/no/where.html"], "no folder"),
        (["test", "--device", "simulated://moon", "--site", "x", "--out", "FOLDER/a.h5"], "no simulated tissue"),
        (["test", "--device", "/dev/none", "--site", "x", "--out", "FOLDER/a.h5"], "cannot open /dev/none"),
        (["test", "--device", "simulated://forearm", "--site", "x", "--out", "SESSION"], "never overwritten"),
        (["test", "--device", "simulated://forearm", "--site", "x", "--out", "FOLDER/no/a.h5"], "no folder"),
        ([*A_TEST, "--max-force", "13"], "reaches 13.0 N; the limit is 12 N"),
        ([*A_TEST, "--limits", "none"], "the limits must be one of"),
        ([*A_TEST, "--seconds", "nan"], "seconds"),
        ([*A_TEST, "--seconds", "1e9"], "seconds"),
        (["identify", "SESSION", "--engine", "lms", "--json", "SESSION"], "already exists and has other content"),
        (["identify", "SESSION", "--engine", "lms", "--json", "RUBBISH"], "already exists and has other content"),
        (["identify", "SESSION", "--engine", "lms", "--memory", "0.1", "--option", "memory=0.1"], "given twice"),
        (["identify", "SESSION", "--engine", "lms", "--input", "position"], "the same signal"),
        (["report", "SESSION", "--out", "SESSION"], "already exists and has other content"),
        (["report", "SESSION", "--out", "FOLDER"], "is a folder"),
        ([*A_TEST, "--json", "SESSION"], "already exists and has other content"),
        ([*A_TEST, "--json", "FOLDER/a.h5"], "is named for two outputs"),
        ([*A_TEST, "--seconds", "29.6"], "lasts 30.1 s in all, preload included; the limit is 30 s"),
        ([*A_TEST, "--min-force", "-13"], "reaches 13.0 N; the limit is 12 N"),
        ([*A_TEST, "--subject", " "], "the subject must be one line"),
        (["test", "--device", "simulated://forearm", "--site", "a\x1bb", "--out", "FOLDER/a.h5"], "the site must be"),
        (["test", "--device", "simulated://forearm?sed=3", "--site", "x", "--out", "FOLDER/a.h5"], "parameter sed;"),
        (["test", "--device", "socket://127.0.0.1", "--site", "x", "--out", "FOLDER/a.h5"], "socket://HOST:PORT"),
        (["test", "--device", "/dev/null", "--site", "x", "--out", "FOLDER/a.h5"], "not a serial port"),
        (["test", "--device", "", "--site", "x", "--out", "FOLDER/a.h5"], "choose an instrument"),
        (["test", "--device", "simulated://forearm", "--site", "x", "--out", "FOLDER"], "is a folder"),
        (["demo", "--out", "RUBBISH"], "is not a folder"),
        (["demo", "--out", "FOLDER/d", "--preset", "moon"], "no preset 'moon'"),
        (["demo", "--out", "FOLDER/d", "--seed", "-1"], "seed"),
        (["fly"], "fly"),
        (["--fly"], "fly"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_said_in_one_line(session_file, tmp_path, capsys, arguments, words):
    rubbish = tmp_path / "rubbish.h5"
    rubbish.write_bytes(b"rubbish" * 100)
    names = {"SESSION": str(session_file), "RUBBISH": str(rubbish), "FOLDER": str(tmp_path)}
    for name, path in names.items():
        arguments = [argument.replace(name, path) for argument in arguments]
    before = session_file.read_bytes()
    assert words in complaint(capsys, *arguments)
    assert session_file.read_bytes() == before
    assert not list(tmp_path.rglob("*.journal"))
    assert not list(tmp_path.rglob("a.h5"))


@pytest.mark.parametrize(
    ("force", "position", "words"),
    [
        (np.ones(4000), np.arange(4000.0), "constant|vary"),
        (np.full(4000, np.nan), np.full(4000, np.nan), "sample|NaN|received"),
        (np.sin(np.arange(50.0)), np.cos(np.arange(50.0)), "memory|sample"),
    ],
    ids=["constant", "nothing received", "too short"],
)
@pytest.mark.parametrize("engine", ENGINES)
def test_records_that_carry_no_fit(tmp_path, capsys, engine, force, position, words):
    import re

    path = tmp_path / "odd.h5"
    test = Test(number=1, kind="stochastic", signals={"force": force, "position": position}, sample_rate_hz=2000.0)
    write_session(path, Session(DeviceDescription(), tests=(test,)))
    assert re.search(words, complaint(capsys, "identify", path, "--engine", engine))


def test_a_fit_that_predicts_nothing_prints_no_parameters_and_keeps_them_in_json(tmp_path, capsys):
    rng = np.random.default_rng(3)
    force, position = rng.standard_normal((2, 6000))
    path, answer = tmp_path / "unrelated.h5", tmp_path / "a.json"
    test = Test(number=1, kind="stochastic", signals={"force": force, "position": position}, sample_rate_hz=2000.0)
    write_session(path, Session(DeviceDescription(), tests=(test,)))
    assert main(["identify", str(path), "--engine", "lms", "--json", str(answer)]) == 0
    printed = capsys.readouterr().out
    assert "N/m" not in printed
    assert PREDICTS_NOTHING in " ".join(printed.split())
    found = json.loads(answer.read_text())
    assert (found["predicts_nothing"], "stiffness_n_per_m" in found["parameters"]) == (True, True)
    assert main(["compare", str(path), "--engines", "lms,spectral"]) == 0
    assert PREDICTS_NOTHING in " ".join(capsys.readouterr().out.split())


def test_a_defect_leaves_its_details_in_a_file(monkeypatch, capsys, tmp_path):
    def fail(*_args, **_kwargs):
        raise ZeroDivisionError("a defect")

    monkeypatch.setattr(instruments, "find_instruments", fail)
    monkeypatch.setattr(platformdirs, "user_log_path", lambda *_, **__: tmp_path)
    assert main(["devices"]) == 1
    printed = capsys.readouterr().err
    assert "Traceback" not in printed
    assert "ZeroDivisionError" in (tmp_path / "last-defect.txt").read_text()


def test_an_interrupt_leaves_nothing_behind(monkeypatch, tmp_path, capsys):
    def interrupt(*_args, **_kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(test_run, "place", interrupt)
    out = tmp_path / "s.h5"
    assert main(["test", "--device", "simulated://forearm", "--site", "x", "--out", str(out)]) == 130
    assert list(tmp_path.iterdir()) == []
    assert "interrupted" in capsys.readouterr().err


def ctrl_c():
    raise KeyboardInterrupt


def request_to_end():
    os.kill(os.getpid(), signal.SIGTERM)


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX")
def test_more_interrupts_do_not_disturb_the_letting_go(monkeypatch, tmp_path, capsys):
    from tissueid.instrument import SimulatedInstrument

    release, poll, polls = SimulatedInstrument.release, SimulatedInstrument.poll, iter(range(1000))

    def interrupted_poll(self, timeout_s):
        if next(polls) == 200:
            os.kill(os.getpid(), signal.SIGINT)
        return poll(self, timeout_s)

    def disturbed(self):
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGINT):
            os.kill(os.getpid(), number)
        release(self)

    monkeypatch.setattr(SimulatedInstrument, "poll", interrupted_poll)
    monkeypatch.setattr(SimulatedInstrument, "release", disturbed)
    out = tmp_path / "s.h5"
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where tests run in the background
    try:
        assert main(["test", "--device", "simulated://forearm", "--site", "x", "--out", str(out)]) == 130
    finally:
        signal.signal(signal.SIGINT, before)
    assert read_session(out).test().status == "aborted"
    assert [path.name for path in tmp_path.iterdir()] == ["s.h5"]
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize(
    "ending", [ctrl_c, pytest.param(request_to_end, marks=pytest.mark.skipif(sys.platform == "win32", reason="POSIX"))]
)
def test_an_interrupt_in_mid_test_keeps_what_was_recorded(monkeypatch, tmp_path, ending):
    from tissueid.instrument import SimulatedInstrument

    poll = SimulatedInstrument.poll
    polls = iter(range(1000))

    def interrupted_poll(self, timeout_s):
        if next(polls) == 200:
            ending()
        return poll(self, timeout_s)

    monkeypatch.setattr(SimulatedInstrument, "poll", interrupted_poll)
    out = tmp_path / "s.h5"
    assert main(["test", "--device", "simulated://forearm", "--site", "x", "--out", str(out)]) == 130
    test = read_session(out).test()
    assert test.status == "aborted"
    assert test.samples > 1000
    assert [path.name for path in tmp_path.iterdir()] == ["s.h5"]


def test_help_and_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("tissueid 0.")
    assert main(["--help"]) == 0
    assert "Research use only" in capsys.readouterr().out


@pytest.mark.skipif(not BLIND, reason="the independent rig's sessions are not beside the project")
@pytest.mark.parametrize(("path", "engine"), BLIND, ids=[f"{path.stem}-{engine}" for path, engine in BLIND])
def test_identify_answers_on_sessions_of_an_independent_rig(path, engine, capsys):
    result = answer(capsys, "identify", path, "--engine", engine)
    assert result.keys() >= KEYS
    assert result["vaf_validation_percent"] > min(40, linear_vaf_percent(read_session(path).test().record()) - 2)


def linear_vaf_percent(record):
    """VAF of a linear FIR model of 0.06 s by plain least squares, fitted as `identify` does and scored on the rest."""
    lags = round(0.06 * record.sample_rate_hz)
    windows = sliding_window_view(record.input, lags)
    matrix = np.column_stack([windows, np.ones(len(windows))])
    output = record.output[lags - 1 :]
    fitted = round(0.75 * len(record.output)) - lags + 1
    residual = output - matrix @ np.linalg.lstsq(matrix[:fitted], output[:fitted], rcond=None)[0]
    return 100 * (1 - np.var(residual[fitted:]) / np.var(output[fitted:]))


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
def test_the_demo_leaves_its_three_files(tmp_path, capsys):
    out = tmp_path / "d"
    result = answer(capsys, "demo", "--out", out)
    assert sorted(path.name for path in out.iterdir()) == ["report.html", "results.json", "session.h5"]
    assert json.loads((out / "results.json").read_text()) == result
    linear, wiener = (result["tests"]["1"][engine] for engine in ("lms", "wiener"))
    for figure in ("vaf_percent", "vaf_validation_percent"):
        assert 70 <= linear[figure] <= 90
        assert wiener[figure] > linear[figure]
    for row in result["small_amplitude"]["rows"]:
        assert row["small"]["value"] == pytest.approx(row["truth"], rel=0.05), row["quantity"]
    session = read_session(out / "session.h5")
    assert session.instrument.calibration["verdict"] == "passed"
    assert not any("samples_lost" in test.notes for test in session.tests)


def test_identify_reads_as_its_golden_page(session_file, capsys, monkeypatch):
    """Renew the page by ``python tests/golden/renew.py``."""
    monkeypatch.setenv("COLUMNS", "400")
    assert main(["identify", str(session_file), "--engine", "wiener"]) == 0
    check_golden_page("command-identify", capsys.readouterr().out.splitlines())


@pytest.mark.parametrize("command", [[*A_TEST, "--seconds", "1"], ["import", "no.csv"]])
def test_a_name_is_no_subject_unless_it_is_confirmed(tmp_path, monkeypatch, capsys, command):
    monkeypatch.chdir(tmp_path)
    out = [] if "--out" in command else ["--out", "made.h5"]
    assert main([*command, *out, "--subject", "Hans Müller"]) == 2
    assert "looks like a person's name" in capsys.readouterr().err
    main([*command, *out, "--subject", "Hans Müller", "--confirm-pseudonym"])
    assert "looks like a person's name" not in capsys.readouterr().err
