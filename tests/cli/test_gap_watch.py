"""``tissueid gap watch``: sessions of a folder against an accepted twin; how it continues after a kill."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from coded import says, shows
from endless_files import files_that_never_end
from gap_records import DEVICE, RATE_HZ, SIGNALS, scenario
from reports.page_check import checked
from shell import complaint

from firmware_sim.effects import in_order
from tissueid.cli import main
from tissueid.errors import CancelledError
from tissueid.gap import as_answer, fit_tasks
from tissueid.instrument.twin_file import read_twin
from tissueid.procedures import diagnosis
from tissueid.procedures.control import Control
from tissueid.procedures.diagnosis import diagnose_folder, watch_folder
from tissueid.procedures.gap_plans import FolderPlan, WatchPlan
from tissueid.sessions import Session, Test, write_session
from tissueid.twin import catalogue

FEW = ("dry_friction", "directional_damping", "sensor_lag")
SAMPLES = 3000


@pytest.fixture(autouse=True)
def _few_effects(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    everything = catalogue.all_effects()
    monkeypatch.setattr(fit_tasks, "all_effects", lambda: {name: everything[name] for name in FEW})
    monkeypatch.setattr(diagnosis, "user_cache_path", lambda *_, **__: tmp_path / "cache")


def session(seed: int, created: str, *new: str, own: str = "dry_friction") -> Session:
    """Return a session of one device and tissue with its ``own`` effect and ``new`` ones; its stimulus is new."""
    drawn = scenario(own)
    effects = in_order([*drawn.effects, *(effect for name in new for effect in scenario(name).effects)])
    drawn = replace(drawn, seed=(seed,), effects=effects)
    (recording,) = drawn.record()
    signals = {name: getattr(recording, name)[:SAMPLES] for name in SIGNALS}
    test = Test(1, "stochastic", signals, RATE_HZ, preload_s=0.5, surface_position_m=recording.surface_m)
    return Session(DEVICE, tests=(test,), created=created)


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with three sessions, in another order by name than by time, and the twin of an earlier one beside it."""
    folder = tmp_path_factory.mktemp("watched") / "sessions"
    folder.mkdir()
    write_session(folder / "a-last.h5", session(3, "2026-03-09T08:00:00Z", "sensor_lag"))
    write_session(folder / "b-first.h5", session(1, "2026-03-01T08:00:00Z"))
    write_session(folder / "c-second.h5", session(2, "2026-03-02T08:00:00Z"))
    earlier = folder.parent / "earlier.h5"
    write_session(earlier, session(0, "2026-02-01T08:00:00Z"))
    with pytest.MonkeyPatch.context() as patch:
        everything = catalogue.all_effects()
        patch.setattr(fit_tasks, "all_effects", lambda: {name: everything[name] for name in FEW})
        words = ["gap", "accept", str(earlier), "--effect", "dry_friction", "--out", str(folder.parent / "arm.toml")]
        assert main([*words, "--workers", "1"]) == 0
    return folder


def test_the_new_effect_alone_is_named_in_the_session_in_which_it_appears(watched: Path, tmp_path: Path, capsys):
    twin, out, page = watched.parent / "arm.toml", tmp_path / "watch.json", tmp_path / "watch.html"
    words = ["gap", "watch", str(watched), "--twin", str(twin), "--workers", "1"]
    assert main([*words, "--json", str(out), "--out", str(page)]) == 0
    found = json.loads(out.read_text())
    assert [item["file"] for item in found["sessions"]] == ["b-first.h5", "c-second.h5", "a-last.h5"]
    assert [item["verdict"] for item in found["sessions"]] == ["no_gap", "no_gap", "effect"]
    assert [item["combination"] for item in found["sessions"]] == [[], [], ["sensor_lag"]]
    assert (found["first_grown"], found["grown_effects"]) == ("a-last.h5", ["sensor_lag"])
    figures = found["sessions"][2]["gap"]
    assert figures["floor"] <= figures["after"] < figures["before"]
    text = capsys.readouterr().out
    assert text.index("b-first") < text.index("c-second") < text.index("a-last")
    assert "a-last.h5" in checked(page.read_text(encoding="utf-8")).text
    assert not list((tmp_path / "cache").rglob("*.json"))


class Counted(Control):
    """Is cancelled after a number of sessions."""

    def __init__(self, most: int = 99) -> None:
        self.most, self.done = most, 0

    def progress(self, fraction: float | None, step: str) -> None:
        self.done += bool(fraction)

    def cancelled(self) -> bool:
        return self.done >= self.most


def watch(folder: Path, control: Control) -> object:
    return watch_folder(WatchPlan(folder=folder, twin=folder.parent / "arm.toml", workers=1), control)


def batch(folder: Path, control: Control) -> object:
    return diagnose_folder(FolderPlan(folder=folder, workers=1), control, as_answer)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Number of diagnoses; the second one is killed."""
    count: list[int] = []
    diagnose = diagnosis.diagnose

    def diagnosed(*arguments: object, **options: object) -> object:
        count.append(1)
        if len(count) == 2:
            raise SystemExit
        return diagnose(*arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(diagnosis, "diagnose", diagnosed)
    return count


@pytest.mark.parametrize("run", [watch, batch])
def test_a_killed_procedure_continues(run: Callable, watched: Path, tmp_path: Path, asked: list[int]):
    folder = tmp_path / "sessions"
    folder.mkdir()
    for seed in (1, 2):
        own = "" if run is batch else "dry_friction"
        write_session(folder / f"{seed}.h5", session(seed, f"2026-03-0{seed}T08:00:00Z", own=own))
    (tmp_path / "arm.toml").write_bytes((watched.parent / "arm.toml").read_bytes())
    with pytest.raises(SystemExit):
        run(folder, Control())
    (kept,) = (tmp_path / "cache").rglob("*.json")
    kept.with_name("0" * 64 + ".json").write_text("{", encoding="utf-8")
    run(folder, Control())
    assert len(asked) == 3
    assert not list((tmp_path / "cache").rglob("*.json"))


def test_a_cancelled_procedure_leaves_nothing_behind(watched: Path, tmp_path: Path):
    folder = tmp_path / "sessions"
    folder.mkdir()
    for name in ("b-first.h5", "c-second.h5"):
        (folder / name).write_bytes((watched / name).read_bytes())
    (tmp_path / "arm.toml").write_bytes((watched.parent / "arm.toml").read_bytes())
    with pytest.raises(CancelledError):
        watch(folder, Counted(most=1))
    assert not list((tmp_path / "cache").rglob("*.json"))


def test_bad_input_is_refused_in_one_line(watched: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    twin = watched.parent / "arm.toml"
    empty = tmp_path / "empty"
    empty.mkdir()
    assert "no session files" in complaint(capsys, "gap", "watch", empty, "--twin", twin)
    assert "cannot read" in complaint(capsys, "gap", "watch", watched, "--twin", tmp_path / "none.toml")
    write_session(empty / "bare.h5", Session(DEVICE))
    first = session(1, "2026-03-01T08:00:00Z")
    (test,) = first.tests
    short = replace(test, signals={name: values[:1200] for name, values in test.signals.items()})
    write_session(empty / "short.h5", replace(first, tests=(short,)))
    other = replace(DEVICE, stroke_m=0.02)
    write_session(empty / "other.h5", replace(first, instrument=other))
    assert shows(
        complaint(capsys, "gap", "watch", empty, "--twin", twin, "--workers", 1), "gap.nothing_watched", file="bare.h5"
    )
    line = complaint(capsys, "gap", "diagnose", empty / "other.h5", "--twin", twin, "--workers", 1)
    assert shows(line, "gap.other_instrument", twin="arm", name="stroke_m")
    assert "too short" in complaint(capsys, "gap", "diagnose", empty / "short.h5", "--twin", twin, "--workers", 1)


def test_a_session_that_cannot_be_used_is_listed_with_its_reason(watched: Path, tmp_path: Path):
    folder = tmp_path / "sessions"
    folder.mkdir()
    (folder / "b-first.h5").write_bytes((watched / "b-first.h5").read_bytes())
    write_session(
        folder / "other.h5", replace(session(1, "2026-02-28T08:00:00Z"), instrument=replace(DEVICE, stroke_m=0.02))
    )
    (folder / "b-first.h5").rename(folder / "b-\udce9.h5")
    others = files_that_never_end(folder)
    page = tmp_path / "page.html"
    plan = WatchPlan(folder=folder, twin=watched.parent / "arm.toml", workers=1, report=page)
    history = watch_folder(plan, Control())
    assert page.is_file()
    assert [entry.file for entry in history.entries] == ["other.h5", "b-\udce9.h5", *sorted(others)]
    assert history.first_grown is None
    assert says(history.entries[0].reason, "gap.other_instrument", name="stroke_m")


def test_the_twin_keeps_what_it_leaves_unmodelled(watched: Path):
    twin = read_twin(watched.parent / "arm.toml")
    assert set(twin.unmodelled) == {"voltage", "current", "position"}
    assert twin.unmodelled["position"] < 0.02
