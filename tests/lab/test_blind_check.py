"""``tissueid gap blind-check``: sealed scenarios of the simulated laboratories, scored, interrupted and resumed."""

from __future__ import annotations

import contextlib
import io
import json
import subprocess
from pathlib import Path

import pytest
from coded import shows

from firmware_sim.laboratory.scenario_generation import main as record
from tissueid.cli import main
from tissueid.gap.decision import decide
from tissueid.gap.diagnosis import diagnose
from tissueid.twin import catalogue as shelf
from tissueid_lab.blind_check.answers import BlindScenario
from tissueid_lab.blind_check.threshold_fit import read_decided

FEW = ("dry_friction", "directional_damping", "sensor_lag")


@pytest.fixture(autouse=True)
def _few_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three candidates are enough here, and quick."""
    everything = shelf.all_effects()
    few = {name: everything[name] for name in FEW}
    monkeypatch.setattr("tissueid.gap.fit_tasks.all_effects", lambda: few)


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    assert main([*map(str, arguments)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "Traceback" not in captured.err
    lines = [line for line in captured.err.splitlines() if line.strip()]
    assert lines[-1].startswith("tissueid: ")
    return lines[-1]


@pytest.fixture
def _recorded_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """The laboratory records in this process: starting another takes longer than all the rest."""

    def run(*command: str, **others: object) -> subprocess.CompletedProcess[str]:
        assert command[:2] == ("-m", "firmware_sim.laboratory")
        said = io.StringIO()
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
            status = record(list(command[2:]))
        return subprocess.CompletedProcess(command, status, "", said.getvalue())

    monkeypatch.setattr("tissueid_lab.blind_check.check.run", run)


@pytest.mark.usefixtures("_recorded_here")
def test_nothing_is_scored_when_labels_change_under_the_seal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    def cheat(folder: Path, names: list[str], *others: object, **options: object) -> dict[str, dict]:
        (folder / "labels.json").write_text("{}")
        return {}

    monkeypatch.setattr("tissueid_lab.blind_check.answers.answers", cheat)
    arguments = ["--n", "1", "--full-share", "0", "--workers", "1", "--json", str(tmp_path / "score.json")]
    assert main(["gap", "blind-check", *arguments]) == 2
    assert "altered while sealed" in capsys.readouterr().err
    assert not (tmp_path / "score.json").exists()


@pytest.mark.usefixtures("_recorded_here")
def test_the_blind_check_scores_sealed_scenarios(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out, kept = tmp_path / "score.json", tmp_path / "kept"
    arguments = ["--n", "1", "--seed", "9", "--full-share", "0", "--keep", str(kept), "--json", str(out)]
    assert main(["gap", "blind-check", "--workers", "1", *arguments]) == 0
    found = json.loads(out.read_text())
    assert found["n"] == 1
    assert len(found["seal"]) == 64
    assert found["seal"] in capsys.readouterr().out.replace("\n", "")
    assert set(found["kinds"]) == {"single"}
    rates = {item["what"]: item for item in found["kinds"]["single"]["rates"]}
    assert {"top-1", "top-3", "stage"} <= set(rates)
    assert {"figures", "confusion", "risk_coverage", "failures"} <= set(found["kinds"]["single"])
    assert set(found["answers"]) == {"scenario-0001"}
    decided = [item for item in read_decided(kept) if not item.left_out]
    assert [decide(item.grounds) for item in decided] == [set(found["answers"]["scenario-0001"]["combination"])]
    assert "not empty" in refused(capsys, "gap", "blind-check", "--n", 1, "--workers", 1, "--keep", kept)


@pytest.mark.usefixtures("_recorded_here")
def test_a_check_that_was_interrupted_goes_on(tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch):
    kept, page, out = tmp_path / "kept", tmp_path / "check.html", tmp_path / "score.json"
    blind = ["gap", "blind-check", "--workers", "1", "--keep", str(kept)]
    answered: list[str] = []

    def diagnosed(piece: BlindScenario) -> dict:
        if answered == ["scenario-0001"]:
            answered.append("interrupted")
            raise KeyboardInterrupt
        answered.append(piece.name)
        gap = {"before": 0.1, "after": 0.1, "floor": 0.1, "closed": None, "announced": None}
        where = {"stage": "drive"}
        return {"verdict": "no_gap", "gap": gap, "where": where, "ranking": [], "combination": [], "oracle": 0.1}

    monkeypatch.setattr(BlindScenario, "diagnosed", diagnosed)
    assert main([*blind, "--n", "2", "--seed", "9", "--full-share", "0"]) == 130
    assert shows(capsys.readouterr().err, "blind.interrupted")
    assert shows(refused(capsys, *blind, "--resume", "--n", 3), "blind.other_option", option="--n", held="2", asked="3")
    other = refused(capsys, *blind, "--resume", "--laboratory", "second")
    assert shows(other, "blind.other_option", option="--laboratory", held="first", asked="second")
    assert main([*blind, "--resume", "--seed", "9", "--out", str(page), "--json", str(out)]) == 0
    assert answered == ["scenario-0001", "interrupted", "scenario-0002"]
    found = json.loads(out.read_text())
    assert set(found["answers"]) == {"scenario-0001", "scenario-0002"}
    assert {"permuted_labels_top1", "always_friction_top1", "in_sample_top1"} <= set(found["kinds"]["single"])
    assert found["seal"] in page.read_text(encoding="utf-8")
    capsys.readouterr()
    (kept / "scenario-0002.json").unlink()
    assert main([*blind, "--resume"]) == 2
    assert shows(capsys.readouterr().err, "blind.other_labels", folder=str(kept))
    (kept / "labels.json").write_text("{}")
    assert shows(refused(capsys, *blind, "--resume"), "blind.altered")


@pytest.mark.parametrize(("options", "module"), [([], "laboratory"), (["--laboratory", "second"], "second_laboratory")])
def test_the_laboratory_that_is_asked_for_records(
    options: list[str], module: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    def run(*command: str, **others: object) -> subprocess.CompletedProcess[str]:
        return subprocess.CompletedProcess(command, 2, "", f"ran {command[1]}")

    monkeypatch.setattr("tissueid_lab.blind_check.check.run", run)
    said = refused(capsys, "gap", "blind-check", "--n", 1, *options)
    assert shows(said, "blind.laboratory_failed", why=f"ran firmware_sim.{module}")


@pytest.mark.usefixtures("_recorded_here")
def test_a_check_on_skin_scores_sets(tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch):
    kept, out = tmp_path / "kept", tmp_path / "score.json"
    gap = {"before": 0.1, "after": 0.1, "floor": 0.05, "closed": None, "announced": None}
    answer = {"verdict": "unexplained", "gap": gap, "where": {"stage": "tissue"}, "ranking": [], "combination": []}
    monkeypatch.setattr(BlindScenario, "diagnosed", lambda piece: answer | {"oracle": 0.05})
    blind = ["gap", "blind-check", "--workers", "1", "--keep", str(kept)]
    assert main([*blind, "--n", "1", "--full-share", "0", "--skin", "--json", str(out)]) == 0
    found = json.loads(out.read_text())
    assert found["skin"] is True
    figures = {item["what"]: item["value"] for item in found["kinds"]["single"]["figures"]}
    assert figures["recall of the named set"] == 0.0
    assert figures["closed share relative to the true set, median"] == 0.0
    capsys.readouterr()
    assert main([*blind, "--resume", "--json", str(out)]) == 0
    assert json.loads(out.read_text())["skin"] is True
    capsys.readouterr()
    assert shows(refused(capsys, *blind, "--resume", "--take-out"), "blind.skin_alone", option="--take-out")


@pytest.mark.usefixtures("_recorded_here")
@pytest.mark.soak
def test_a_check_against_a_twin_scores_new_effects(tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch):
    kept, out = tmp_path / "kept", tmp_path / "score.json"
    searched: list[int] = []

    def baseline_only(dataset, pool, *, accepted=(), without=()):  # type: ignore[no-untyped-def]
        searched.append(len(dataset.priors))
        return diagnose(dataset, pool, accepted=accepted, candidates=())

    monkeypatch.setattr("tissueid_lab.blind_check.answers.diagnose", baseline_only)
    blind = ["gap", "blind-check", "--workers", "1", "--keep", str(kept)]
    assert main([*blind, "--n", "2", "--full-share", "0", "--against-twin", "--json", str(out)]) == 0
    found = json.loads(out.read_text())
    assert (found["skin"], found["against_twin"]) == (True, True)
    rates = {item["what"]: item["cases"] for item in found["kinds"]["single"]["rates"]}
    assert set(rates) == {"new effect: top-1", "nothing new: false alarms"}
    # One earlier session without a twin, then both later ones against its twin.
    assert [count > 0 for count in searched] == [False, True, True]
    assert all(answer["accepted"] == [] for answer in found["answers"].values())
    assert (kept / "earlier-0001.toml").exists()
    capsys.readouterr()
    assert main([*blind, "--resume", "--json", str(out)]) == 0
    assert len(searched) == 3
    capsys.readouterr()
    assert shows(
        refused(capsys, "gap", "blind-check", "--against-twin", "--take-out"),
        "blind.skin_alone",
        kind="--against-twin",
        option="--take-out",
    )


@pytest.mark.parametrize("options", [["--laboratory", "second"], ["--take-out"]])
def test_a_check_on_skin_refuses_what_it_cannot_score(options: list[str], capsys):
    said = refused(capsys, "gap", "blind-check", "--skin", *options)
    assert shows(said, "blind.skin_alone", option=" ".join(options))


def test_a_check_cannot_go_on_where_there_is_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert "add --keep DIR" in refused(capsys, "gap", "blind-check", "--resume")
    assert "omit --resume" in refused(capsys, "gap", "blind-check", "--resume", "--keep", tmp_path)
