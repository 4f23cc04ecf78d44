"""``tissueid gap``: diagnoses of sessions of the simulated laboratory, sound and spoilt."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from endless_files import files_that_never_end
from gap_records import DEVICE, changed, recorded
from golden.golden_page import check_golden_page
from shell import complaint

from tissueid.cli import main
from tissueid.sessions import Session, write_session
from tissueid.twin import catalogue as shelf

STAGES = {"drive", "coil", "mechanics", "tissue", "sensing", "environment"}
KEYS = {"verdict", "gap", "where", "ranking", "combination", "next_experiment", "seconds"}
FEW = ("dry_friction", "directional_damping", "sensor_lag")
SAMPLES = 3000


@pytest.fixture(autouse=True)
def _few_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three candidates are enough here, and quick."""
    everything = shelf.all_effects()
    few = {name: everything[name] for name in FEW}
    monkeypatch.setattr("tissueid.gap.fit_tasks.all_effects", lambda: few)


def spoilt(**change: Callable[[np.ndarray], np.ndarray]) -> Session:
    """A session without effects whose signals were changed."""
    first = recorded(samples=SAMPLES).tests[0]
    return changed(recorded(samples=SAMPLES), **{name: how(first.signals[name]) for name, how in change.items()})


def cut(samples: int) -> Session:
    return spoilt(**dict.fromkeys(recorded().tests[0].signals, lambda values: values[:samples]))


def with_gaps(values: np.ndarray) -> np.ndarray:
    random = np.random.default_rng(0)
    return np.where((random.random(values.size) < 0.1) | (np.abs(np.arange(values.size) - 1800) < 60), np.nan, values)


def in_millinewtons() -> Session:
    bare = recorded(samples=SAMPLES)
    force = 3e3 * bare.tests[0].signals["current"]
    return changed(bare, command=None, voltage=None, current=None, force=force)


def stored(folder: Path, session: Session) -> Path:
    path = folder / "session.h5"
    write_session(path, session)
    return path


def diagnosed(path: Path, *options: object) -> dict:
    out = path.parent / "answer.json"
    assert main(["gap", "diagnose", str(path), "--workers", "1", "--json", str(out), *map(str, options)]) == 0
    text = out.read_text()
    assert "NaN" not in text
    assert "Infinity" not in text
    return json.loads(text)


@pytest.fixture(scope="module")
def session_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return stored(tmp_path_factory.mktemp("gap"), recorded("dry_friction"))


def test_the_answer_keeps_to_the_contract(session_file: Path, capsys: pytest.CaptureFixture[str]):
    found = diagnosed(session_file)
    assert found.keys() >= KEYS
    assert found["verdict"] == "effect"
    assert found["combination"] == ["dry_friction"]
    gap = found["gap"]
    assert gap["floor"] <= gap["after"] < gap["before"]
    formula = 1 - np.sqrt((gap["after"] ** 2 - gap["floor"] ** 2) / (gap["before"] ** 2 - gap["floor"] ** 2))
    assert gap["closed"] == pytest.approx(formula)
    assert gap["closed"] > 0.9
    assert gap["closed_ci"][0] <= gap["closed"] <= gap["closed_ci"][1]
    where = found["where"]
    assert where["stage"] == "mechanics"
    assert set(where["stages"]) == STAGES
    assert {"bands_hz", "depth_m", "direction", "time_s"} <= set(where)
    first = found["ranking"][0]
    assert (first["effect"], first["stage"]) == ("dry_friction", "mechanics")
    assert first.keys() >= {"probability", "closed", "closed_ci", "indistinguishable", "parameters"}
    assert all(isinstance(value, float) for value in first["parameters"].values())
    assert found["seconds"] > 0.0
    table = capsys.readouterr().out
    assert "dry_friction" in table
    assert "of the gap closed" in table


def test_without_an_effect_there_is_no_gap(tmp_path: Path):
    found = diagnosed(stored(tmp_path, recorded(samples=SAMPLES)))
    assert (found["verdict"], found["combination"]) == ("no_gap", [])


def test_gaps_in_a_record_are_no_gap_of_the_twin(tmp_path: Path):
    found = diagnosed(stored(tmp_path, spoilt(position=with_gaps, current=with_gaps)))
    assert (found["verdict"], found["combination"]) == ("no_gap", [])


@pytest.mark.parametrize(
    "how",
    [lambda values: 2.0 * values, lambda values: np.minimum(values, np.quantile(values, 0.6))],
    ids=["scaled", "saturated"],
)
def test_a_spoilt_reading_is_no_success(how, tmp_path: Path):
    found = diagnosed(stored(tmp_path, spoilt(current=how)))
    assert (found["verdict"], found["combination"]) == ("unexplained", [])
    assert found["gap"]["before"] > 0.2


@pytest.mark.parametrize(
    ("session", "says"),
    [
        (lambda: Session(DEVICE), "no tests"),
        (partial(cut, 40), "too short"),
        (partial(cut, 1200), "too short"),
        (in_millinewtons, "is it in N"),
        (lambda: spoilt(position=lambda values: 1e3 * values), "is it in metres"),
        (lambda: spoilt(position=lambda values: 0.0 * values), "never changes"),
        (lambda: spoilt(position=lambda values: np.where(values < 1.0, np.nan, 0.0)), "missing"),
        (lambda: changed(recorded(samples=SAMPLES), position=None), "no position"),
    ],
)
def test_what_cannot_be_diagnosed_is_refused_in_one_line(session, says, tmp_path: Path, capsys):
    path = stored(tmp_path, session())
    out = tmp_path / "answer.json"
    assert says in complaint(capsys, "gap", "diagnose", path, "--workers", 1, "--json", out)
    assert not out.exists()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--fit", "7"), "no test 7"),
        (("--fit", "one"), "test numbers separated by commas"),
        (("--check", "1"), "none is left to be fitted"),
        (("--without", "dry_friction,no_such"), "there is no effect no_such"),
    ],
)
def test_options_that_cannot_be_followed(options, says, session_file: Path, capsys):
    assert says in complaint(capsys, "gap", "diagnose", session_file, "--workers", 1, *options)


def test_files_that_are_no_sessions(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    rubbish = tmp_path / "rubbish.h5"
    rubbish.write_bytes(b"no session at all" * 100)
    complaint(capsys, "gap", "diagnose", rubbish)
    complaint(capsys, "gap", "diagnose", tmp_path / "absent.h5")
    complaint(capsys, "gap", "diagnose", tmp_path)


def test_a_batch_answers_for_every_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    folder, out = tmp_path / "sessions", tmp_path / "answers.json"
    folder.mkdir()
    stored(folder, recorded(samples=SAMPLES)).rename(folder / "good.h5")
    (folder / "rubbish.h5").write_bytes(b"rubbish")
    others = files_that_never_end(folder)
    assert main(["gap", "batch", str(folder), "--workers", "1", "--json", str(out)]) == 0
    found = json.loads(out.read_text())
    assert set(found) == {"good.h5", "rubbish.h5", *others}
    assert {name for name in found if "verdict" in found[name]} == {"good.h5"}
    assert found["good.h5"]["verdict"] == "no_gap"
    assert "\n" not in found["rubbish.h5"]["error"]
    assert "good.h5: no gap" in capsys.readouterr().out
    empty = tmp_path / "empty"
    empty.mkdir()
    assert "no session files" in complaint(capsys, "gap", "batch", empty, "--json", out)


def test_an_interval_that_cannot_be_told_is_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    found = diagnosed(stored(tmp_path, recorded("dry_friction", samples=SAMPLES)))
    assert found["combination"] == ["dry_friction"]
    assert found["gap"]["closed_ci"] == [None, None]  # the check has one stretch alone
    assert "nan" not in capsys.readouterr().out


def test_an_accepted_effect_becomes_part_of_a_twin_and_a_line_of_the_log(tmp_path: Path, audit_file: Path) -> None:
    session, twin = stored(tmp_path, recorded("dry_friction", samples=SAMPLES)), tmp_path / "bench.toml"
    assert main(["gap", "accept", str(session), "--out", str(twin), "--workers", "1"]) == 0
    assert "dry_friction" in twin.read_text()
    line = json.loads(audit_file.read_text().splitlines()[-1])
    assert (line["what"], line["new"]["effects"]) == ("twin.accepted", ["dry_friction"])
    assert (line["new"]["name"], line["new"]["version"]) == ("bench", 1)


def test_a_diagnosis_reads_as_its_golden_page(
    session_file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    """Renew the page by ``python tests/golden/renew.py``."""
    monkeypatch.setenv("COLUMNS", "400")
    assert main(["gap", "diagnose", str(session_file), "--workers", "1"]) == 0
    check_golden_page("command-gap-diagnose", capsys.readouterr().out.splitlines())
