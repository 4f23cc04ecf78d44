"""``tissueid compare`` and fits of several tests, as people and scripts meet them."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pytest
from coded import made
from identification import simulated
from outside_data import RIG
from reports.synthetic_sitting import make_session, make_test
from shell import answer, complaint

from tissueid.cli import main
from tissueid.device import DeviceDescription
from tissueid.identification import engine_names
from tissueid.identification.base import Family
from tissueid.identification.engines.lms import Lms
from tissueid.sessions import Session, Test, write_session

BLIND = sorted(RIG.glob("*.h5"))
SCORES = {"vaf_percent", "vaf_validation_percent", "vaf_scheduled_percent", "aicc", "n_parameters", "seconds"}
QUICK = ("--engines", "lms,spectral,wiener")


@pytest.fixture(scope="module")
def session_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Test 1 bends, test 2 is another one, test 3 repeats test 1."""
    repeat = make_test(3, seconds=2.5, repeat_of=1)
    repeat.signals["position"] += 1e-5 * simulated.generator(8).standard_normal(repeat.samples)
    path = tmp_path_factory.mktemp("compare") / "session.h5"
    write_session(path, make_session(make_test(1, seconds=2.5), make_test(2, seconds=2.0, seed=5), repeat))
    return path


def test_the_answer_holds_all_engines(session_file: Path, capsys: pytest.CaptureFixture[str]):
    found = answer(capsys, "compare", session_file, *QUICK)
    assert (found["test"], found["tests"], found["validated_on"]) == (
        1,
        [1],
        made("split.part_of_test", which="last", percent=25.0, number=1),
    )
    assert [row["engine"] for row in found["engines"]] == ["lms", "spectral", "wiener"]
    for row in found["engines"]:
        assert row["refused"] is None
        assert row.keys() >= SCORES
        assert row["interpretability"] == "good"
        assert row["depth_profile"] is None
        assert 50 < row["vaf_validation_percent"] <= 100
    assert len({row["n_samples_compared"] for row in found["engines"]}) == 1
    assert 99 < found["ceiling_vaf_percent"] < 100
    assert found["memory_sweep"] == []
    recommended = found["recommendation"]
    assert recommended["engine"] == "wiener"  # the system is a line and a bend
    assert recommended["family"] == Family.STATIC
    assert recommended["choices"]["memory"]["value"] <= 0.125
    assert {s["engine"] for s in recommended["standings"]} == {"lms", "spectral", "wiener"}


def test_people_get_a_table_and_a_recommendation(session_file: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["compare", str(session_file), *QUICK]) == 0
    printed = capsys.readouterr().out
    for words in (
        "Engines on test 1",
        "AICc",
        "good",
        "No model can exceed 99",
        "The response changes with depth",
        "suggested tests",
    ):
        assert words in printed
    assert re.search(r"wiener +(9\d|100)\.\d +(9\d|100)\.\d", printed)


@pytest.mark.parametrize(
    ("lines", "pattern"),
    [
        ("odd_random", r"relative to the output: noise −\d+\.\d dB, even −\d+\.\d dB, odd"),
        ("full", "not known: the multisine drove"),
    ],
)
def test_noise_and_distortion_of_a_multisine_are_printed(
    lines: str, pattern: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    path = tmp_path / "multisine.h5"
    options = ["--stimulus", "multisine", "--option", f"lines={lines}", "--option", "phases=schroeder"]
    device = "simulated://forearm?seed=0"
    assert main(["test", "--device", device, "--site", "forearm", "--out", str(path), *options]) == 0
    capsys.readouterr()
    assert main(["compare", str(path), "--engines", "lms"]) == 0
    assert re.search(pattern, " ".join(capsys.readouterr().out.split()))


def test_an_engine_that_refuses_costs_no_other(session_file: Path, capsys: pytest.CaptureFixture[str]):
    arguments = ("compare", session_file, "--engines", "lms,spectral", "--option", "spectral.window=0.05")
    found = answer(capsys, *arguments)
    assert found["engines"][0]["refused"] is None
    refused = found["engines"][1]
    assert (refused["engine"], refused["family"]) == ("spectral", "linear")
    assert "0.05 s" in refused["refused"]
    assert refused.keys() == {"engine", "family", "interpretability", "refused", "refused_message"}
    assert main([*map(str, arguments)]) == 0
    assert f"1. refused: {refused['refused'][:40]}" in capsys.readouterr().out


def test_several_tests_are_fitted_together(session_file: Path, capsys: pytest.CaptureFixture[str]):
    found = answer(capsys, "compare", session_file, "--engines", "lms", "--test", 1, "--also", 2, "--also", 3)
    assert found["tests"] == [1, 2, 3]
    assert found["validated_on"] == made("split.part_of_tests", which="last", percent=25.0, numbers="1, 2 and 3")
    one = answer(capsys, "identify", session_file, "--engine", "lms", "--test", 2, "--also", 1, "--validate", 3)
    assert (one["test"], one["tests"], one["validated_on"]) == (2, [2, 1], "test 3")
    assert one["n_samples"] == 4500 - 2 * 124
    assert {"findings", "tests"} <= one["residual_tests"].keys()


def test_scores_against_memory(session_file: Path, capsys: pytest.CaptureFixture[str]):
    found = answer(capsys, "compare", session_file, "--engines", "lms", "--memory-sweep")
    assert [row["engine"] for row in found["memory_sweep"]] == ["lms"] * 7
    assert found["memory_sweep"][0].keys() >= SCORES | {"memory_s", "refused"}
    assert main(["compare", str(session_file), "--engines", "lms", "--memory-sweep"]) == 0
    assert "Scores against memory" in capsys.readouterr().out


def test_one_memory_for_all(session_file: Path, capsys: pytest.CaptureFixture[str]):
    found = answer(capsys, "compare", session_file, "--engines", "lms,spectral", "--memory", 0.05)
    assert [row["options"]["memory"] for row in found["engines"]] == [0.05, 0.05]


def test_identify_tells_what_is_known_against_depth(session_file: Path, capsys: pytest.CaptureFixture[str]):
    found = answer(capsys, "identify", session_file, "--engine", "dpn")
    assert found["depth_profile"]
    assert found["depth_profile"][0].keys() >= {"position_m", "stiffness_n_per_m", "support", "direction"}
    assert main(["identify", str(session_file), "--engine", "dpn"]) == 0
    printed = capsys.readouterr().out
    assert "Against depth" in printed
    assert "position mm" in printed


def test_an_interrupt_leaves_nothing(
    session_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    target = tmp_path / "answer.json"
    target.write_text("{}", encoding="utf-8")
    monkeypatch.setattr(Lms, "fit", interrupt)
    assert main(["compare", str(session_file), *QUICK, "--json", str(target)]) == 130
    assert "interrupted" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["answer.json"]
    assert target.read_text(encoding="utf-8") == "{}"


def test_commands_keep_linear_algebra_to_one_thread_unless_told_otherwise(monkeypatch: pytest.MonkeyPatch):
    for before, after in ((None, "1"), ("2", "2")):
        with monkeypatch.context() as patch:
            if before is None:
                patch.setenv("OPENBLAS_NUM_THREADS", "to be removed again")
                patch.delenv("OPENBLAS_NUM_THREADS")
            else:
                patch.setenv("OPENBLAS_NUM_THREADS", before)
            assert main(["--version"]) == 0
            assert os.environ["OPENBLAS_NUM_THREADS"] == after


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["SESSION", "--engines", "lms,magic"], "no engine 'magic'"),
        (["SESSION", "--engines", ""], "no engine is given: choose from"),
        (["SESSION", "--engines", " , "], "no engine is given"),
        (["SESSION", "--engines", "lms,lms"], "given twice"),
        (["SESSION", "--engines", "lms", "--test", "9"], "no test 9; it has 1, 2, 3"),
        (["SESSION", "--engines", "lms", "--also", "1"], "test 1 is given twice"),
        (["SESSION", "--engines", "lms", "--validate", "1"], "validate on another"),
        (["SESSION", "--engines", "lms", "--input", "torque"], "no signal 'torque'"),
        (["SESSION", "--engines", "lms", "--input", "position"], "the same signal"),
        (["SESSION", "--engines", "lms,wiener", "--memory", "5"], "memory of 5 s is longer"),
        (["SESSION", "--engines", "lms", "--memory", "-1"], "option 'memory'"),
        (["SESSION", "--engines", "lms", "--option", "memory=1"], "ENGINE.NAME=VALUE"),
        (["SESSION", "--engines", "lms", "--option", "lms.colour=red"], "colour"),
        (["SESSION", "--engines", "lms", "--option", "wiener.degree=2"], "not among"),
        (["SESSION", "--engines", "lms", "--option", "lms"], "NAME=VALUE"),
        (["SESSION", "--engines", "lms", "--json", "FOLDER/no/where.json"], "no folder"),
        (["SESSION", "--engines", "lms", "--json", "SESSION"], "already exists and has other content"),
        (["nothing.h5"], "no such file"),
        ([], "SESSION"),
    ],
)
def test_wrong_use_is_said_in_one_line(
    session_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
):
    names = {"SESSION": str(session_file), "FOLDER": str(tmp_path)}
    for name, path in names.items():
        arguments = [argument.replace(name, path) for argument in arguments]
    assert words in complaint(capsys, "compare", *arguments)


NOISE = simulated.generator(3).standard_normal(4000)


@pytest.mark.parametrize(
    ("force", "position", "words"),
    [
        (np.ones(4000), NOISE, r"the input \(force\) is constant"),
        (NOISE, np.ones(4000), r"the output \(position\) is constant"),
        (np.full(4000, np.nan), NOISE, r"the input \(force\) has no received sample"),
        (NOISE, np.full(4000, np.nan), "has no received sample"),
        (NOISE[:120], NOISE[:120] ** 2, "longer than the 0.045 s of record"),
    ],
    ids=["constant input", "constant output", "no input", "no output", "too short"],
)
def test_records_that_carry_no_fit_are_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], force: np.ndarray, position: np.ndarray, words: str
):
    path = tmp_path / "odd.h5"
    test = Test(number=1, kind="stochastic", signals={"force": force, "position": position}, sample_rate_hz=2000.0)
    write_session(path, Session(DeviceDescription(), tests=(test,)))
    assert re.search(words, complaint(capsys, "compare", path))


@pytest.mark.soak
@pytest.mark.skipif(not BLIND, reason="the independent rig's sessions are not beside the project")
@pytest.mark.parametrize("path", BLIND, ids=lambda path: path.stem)
def test_all_engines_on_sessions_of_an_independent_rig(path: Path, capsys: pytest.CaptureFixture[str]):
    found = answer(capsys, "compare", path)
    assert [row["engine"] for row in found["engines"]] == list(engine_names())
    done = [row for row in found["engines"] if row["refused"] is None]
    assert len(done) >= 3
    recommended = next(row for row in done if row["engine"] == found["recommendation"]["engine"])
    print(path.stem, recommended["engine"], f"{recommended['vaf_validation_percent']:.1f} %")
    assert recommended["vaf_validation_percent"] > 70
