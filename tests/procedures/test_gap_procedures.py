"""The command line and the window produce the same diagnosis, report and twin from the same plan."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any, get_args

import pytest
from coded import coded, says
from gap_records import recorded

from tissueid.app.views.gap.diagnosis_result import (
    DiagnosisResult,
    accept_into_twin,
    export_json,
    run_diagnosis,
    write_report,
)
from tissueid.audit import AuditLog, AuditTrail, last_lines
from tissueid.cli import main
from tissueid.errors import CancelledError, UnusableInputError
from tissueid.gap import fit_tasks
from tissueid.gap.search import SearchProgress, Work
from tissueid.gap.twin_export import NamedEffects
from tissueid.procedures.control import Control, RemainingTime, counted
from tissueid.procedures.diagnosis import SHARES, STEPS, SearchDisplay, accept_effects
from tissueid.procedures.gap_plans import AcceptPlan, DiagnosisPlan
from tissueid.sessions import write_session
from tissueid.twin import catalogue

FEW = ("dry_friction", "directional_damping")
SAMPLES = 3000


@pytest.fixture(autouse=True)
def _few_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    everything = catalogue.all_effects()
    monkeypatch.setattr(fit_tasks, "all_effects", lambda: {name: everything[name] for name in FEW})


@pytest.fixture(scope="module")
def session_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("gap") / "friction.h5"
    write_session(path, recorded("dry_friction", samples=SAMPLES))
    return path


@pytest.fixture(scope="module")
def shown(session_file: Path) -> DiagnosisResult:
    """The diagnosis as the window makes it."""
    with pytest.MonkeyPatch.context() as patch:
        everything = catalogue.all_effects()
        patch.setattr(fit_tasks, "all_effects", lambda: {name: everything[name] for name in FEW})
        return run_diagnosis(DiagnosisPlan(session=session_file), Control(), separate_process=False)


def command(*words: object) -> None:
    assert main([*map(str, words), "--workers", "1"]) == 0


def twin_of(path: Path) -> dict[str, Any]:
    return tomllib.loads(path.read_text(encoding="utf-8")) | {"created": ""}


def without_seconds(text: str) -> str:
    return re.sub(r"\b\d+(\.\d+)? s\b", "", text)


def test_the_same_diagnosis_and_report(session_file: Path, shown: DiagnosisResult, tmp_path: Path):
    command("gap", "diagnose", session_file, "--json", tmp_path / "command.json", "--out", tmp_path / "command.html")
    export_json(shown, tmp_path / "window.json")
    ours, theirs = (json.loads((tmp_path / f"{name}.json").read_text()) for name in ("window", "command"))
    assert ours | {"seconds": 0} == theirs | {"seconds": 0}
    page = write_report(shown)
    assert without_seconds(page.read_text()) == without_seconds((tmp_path / "command.html").read_text())
    page.unlink()


@pytest.mark.parametrize("effects", [(), ("directional_damping",)])
def test_the_same_twin_and_entry_in_the_audit_log(
    effects: tuple[str, ...], session_file: Path, shown: DiagnosisResult, tmp_path: Path, audit_file: Path
):
    for folder in ("window", "command"):
        (tmp_path / folder).mkdir()
    options = [word for effect in effects for word in ("--effect", effect)]
    command("gap", "accept", session_file, "--out", tmp_path / "command" / "arm.toml", *options)
    trail = AuditTrail(AuditLog(audit_file), "researcher")
    chosen = effects or ("dry_friction",)
    accept_into_twin(shown, tmp_path / "window" / "arm.toml", trail, chosen, separate_process=False)
    ours, theirs = (twin_of(tmp_path / folder / "arm.toml") for folder in ("window", "command"))
    assert ours == theirs
    assert [item["name"] for item in ours["effects"]] == list(chosen)
    entries = [(line.what, line.role, line.subject, line.new) for line in last_lines(audit_file, 2)]
    assert entries[0] == entries[1]
    assert entries[0][0] == "twin.accepted"


def test_a_twin_of_a_diagnosis_is_logged_as_well(session_file: Path, tmp_path: Path, audit_file: Path):
    command("gap", "diagnose", session_file, "--twin-out", tmp_path / "arm.toml")
    assert [line.what for line in last_lines(audit_file, 1)] == ["twin.accepted"]


def test_what_cannot_be_accepted_is_refused_before_any_fit(session_file: Path, tmp_path: Path, audit_file: Path):
    trail = AuditTrail(AuditLog(audit_file), "researcher")

    def refused(plan: AcceptPlan, code: str, named: NamedEffects | None = None) -> None:
        with pytest.raises(UnusableInputError, check=coded(code)):
            accept_effects(plan, Control(), trail, named)

    out = tmp_path / "arm.toml"
    refused(AcceptPlan(session=session_file, out=out), "gap.accept_none")
    refused(AcceptPlan(session=session_file, out=out, effects=FEW, name="größe"), "twin.name")
    refused(AcceptPlan(session=session_file, out=tmp_path / "arm.txt", effects=FEW), "twin.suffix")
    assert not audit_file.exists()
    assert not out.exists()


@pytest.mark.parametrize("separate_process", [False, True])
def test_a_cancelled_diagnosis_ends(session_file: Path, separate_process: bool):
    class Impatient(Control):
        count = 0

        def cancelled(self) -> bool:
            self.count += 1
            return self.count > 3

    with pytest.raises(CancelledError):
        run_diagnosis(DiagnosisPlan(session=session_file), Impatient(), separate_process=separate_process)


def test_every_step_of_a_search_has_a_text():
    assert set(STEPS) == set(get_args(Work))


class Shown(Control):
    """Keeps the progress that a procedure shows."""

    def __init__(self) -> None:
        self.shares: list[float | None] = []
        self.steps: list[str] = []

    def progress(self, fraction: float | None, step: str) -> None:
        self.shares.append(fraction)
        self.steps.append(step)


def test_the_remaining_time_of_a_search_follows_from_its_share():
    seconds = iter(range(0, 1000, 10))
    shown = Shown()
    display = SearchDisplay(shown, RemainingTime(lambda: next(seconds)))
    display(SearchProgress("baseline", 0, 1))
    display(SearchProgress("screening", 10, 20))
    begin, end = SHARES["screening"]
    share = 0.5 * (begin + end)
    assert shown.shares == [None, pytest.approx(share)]
    assert says(shown.steps[1], "procedure.seconds_left", seconds=pytest.approx(10.0 * (1.0 - share) / share))
    display(SearchProgress("leading candidates", 2, 3))
    for what in ("tissue", "removals", "screening", "additions"):
        display(SearchProgress(what, 1, 2))
    of_sets = shown.shares[-4:]
    assert of_sets == sorted(of_sets)
    assert of_sets[0] < shown.shares[-5]
    assert of_sets[-1] < 1.0


def test_long_work_states_minutes():
    seconds = iter((0.0, 60.0))
    remaining = RemainingTime(lambda: next(seconds))
    assert says(remaining.added_to(counted("Work", 1, 5), 0.2), "procedure.minutes_left", minutes=4.0)
