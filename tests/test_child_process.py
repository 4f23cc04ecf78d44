"""Child processes import nothing from the current folder, and every one is started where that is seen to."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from operator import neg
from pathlib import Path

import pytest

import firmware_sim
import tissueid
import tissueid_lab
from tissueid.acquisition.live_process import LiveProcess, LiveSettings
from tissueid.child_process import run
from tissueid.gap.workers import executor
from tissueid.procedures.control import Control
from tissueid.procedures.demo import firmware_process
from tissueid.procedures.separate_process import run_in_process
from tissueid_lab.blind_check.check import LaboratoryName, record_scenarios

HOSTILE = (
    "multiprocessing",
    "numpy",
    "tomllib",
    "pickle",
    "scipy",
    "typer",
    "pydantic",
    "runpy",
    "firmware_sim/__init__",
)
HOSTILE += ("firmware_sim/__main__", "firmware_sim/laboratory", "tissueid/__init__", "concurrent/__init__")
HOSTILE += ("firmware_sim/second_laboratory",)
STARTS = {
    "subprocess": {"Popen", "run", "call", "check_call", "check_output", "getoutput", "getstatusoutput"},
    "multiprocessing": {"Process", "Pool", "get_context", "set_start_method", "Manager"},
    "os": {"system", "popen", "fork", "forkpty", "posix_spawn", "posix_spawnp", "startfile"},
    "QProcess": {"start", "startDetached", "execute"},
}
"""What starts a process, by module."""
START_NAMES = {"ProcessPoolExecutor", "QProcess", "create_subprocess_exec", "create_subprocess_shell"}


def starts_in(path: Path) -> list[str]:
    """Everything in a file that starts a process by itself, with its line."""
    found: list[str] = []
    source = path.read_text(encoding="utf-8")
    if not any(re.search(rf"\b{name}\b", source) for name in (*STARTS, *START_NAMES)):
        return found  # without any of these names there is nothing to be found, and most files have none
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call):
            module, _, name = ast.unparse(node.func).rpartition(".")
            starts = STARTS.get(module.rpartition(".")[2], set())
            if name in starts | START_NAMES or (module == "os" and name.startswith(("exec", "spawn"))):
                found.append(f"{path.name}:{node.lineno} {module}.{name}")
        elif isinstance(node, ast.ImportFrom):
            starts = STARTS.get(node.module or "", set()) | START_NAMES
            found += [f"{path.name}:{node.lineno} {item.name}" for item in node.names if item.name in starts]
    return found


def test_every_process_is_started_by_the_one_module():
    found = []
    for package in (tissueid, tissueid_lab, firmware_sim):
        for path in sorted(Path(package.__file__).parent.rglob("*.py")):
            # The tools that build and drive the reference firmware are no part of the program.
            if path.name != "child_process.py" and "reference" not in path.parts:
                found += starts_in(path)
    assert found == []
    assert len(starts_in(Path(tissueid.__file__).parent / "child_process.py")) >= 3


@pytest.fixture
def hostile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A current folder whose modules say in a file that they were run."""
    folder = tmp_path / "received"
    for name in HOSTILE:
        path = folder / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"open({str(folder / 'PWNED')!r}, 'a').write(__name__ + ' ')\n", encoding="utf-8")
    monkeypatch.chdir(folder)
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    return folder


def ran_in(folder: Path) -> str:
    path = folder / "PWNED"
    return path.read_text(encoding="utf-8") if path.exists() else ""


def work_apart(control):
    import numpy as np

    control.progress(0.5, "counting")
    with executor() as people:
        return people.do(neg, [float(np.float64(3.0)), 4.0], control.check, lambda _: None)


def test_the_trap_shuts_on_an_unprotected_process(hostile: Path):
    bare = {name: value for name, value in os.environ.items() if name != "PYTHONSAFEPATH"}
    subprocess.run([sys.executable, "-c", "import tomllib"], env=bare, check=True)
    assert ran_in(hostile) == "tomllib "


def test_fits_in_other_processes_run_nothing_of_the_folder(hostile: Path):
    with executor(2) as people:
        assert people.do(neg, [1, 2, 3], lambda: False, lambda _: None) == [-1, -2, -3]
    assert ran_in(hostile) == ""


def test_a_diagnosis_of_the_window_runs_nothing_of_the_folder(hostile: Path):
    assert run_in_process(work_apart, Control()) == [-3.0, -4.0]
    assert ran_in(hostile) == ""


def test_the_demos_instrument_runs_nothing_of_the_folder(hostile: Path):
    with firmware_process("left-posterior-forearm", 1) as url:
        assert url
    values = run("-m", "firmware_sim", "--preset", "left-posterior-forearm", "--local-values", "0.014", check=True)
    assert values.returncode == 0
    assert ran_in(hostile) == ""


@pytest.mark.parametrize(("laboratory", "n"), [(LaboratoryName.FIRST, 1), (LaboratoryName.SECOND, 0)])
def test_the_laboratory_of_the_blind_check_runs_nothing_of_the_folder(
    hostile: Path, tmp_path: Path, laboratory: LaboratoryName, n: int
):
    record_scenarios(tmp_path / "sealed", n, 1, 0.0, laboratory)
    assert list((tmp_path / "sealed").iterdir())
    assert ran_in(hostile) == ""


def test_live_identification_runs_nothing_of_the_folder(hostile: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("tissueid.acquisition.live_process.FINAL_ESTIMATE_S", 300.0)  # a busy machine starts it late
    process = LiveProcess(LiveSettings(sample_rate_hz=2000.0))
    process.close()
    assert process.update.problem == ""
    assert ran_in(hostile) == ""


@pytest.mark.parametrize("start", [("-m", "tissueid"), ("-P", "-m", "tissueid")])
def test_the_program_runs_nothing_of_the_folder_once_it_has_begun(hostile: Path, start: tuple[str, ...]):
    # What Python imports by itself to find the module cannot be protected here.
    for name in ("runpy.py", "tissueid/__init__.py"):
        (hostile / name).unlink()
    (hostile / "tissueid").rmdir()
    bare = {name: value for name, value in os.environ.items() if name != "PYTHONSAFEPATH"}
    done = subprocess.run([sys.executable, *start, "--version"], env=bare, capture_output=True, text=True, check=False)
    assert (done.returncode, ran_in(hostile)) == (0, ""), done.stderr


def test_a_script_without_a_guard_runs_once(tmp_path: Path):
    script = tmp_path / "script.py"
    script.write_text(
        "from operator import neg\n"
        "from tissueid.gap.workers import executor\n"
        "print('begun')\n"
        "with executor(2) as pool:\n"
        "    print(pool.do(neg, [1, 2], lambda: False, lambda _: None))\n"
    )
    found = run(str(script), capture_output=True, text=True, check=True)
    assert found.stdout.splitlines() == ["begun", "[-1, -2]"]
    assert found.stderr == ""
