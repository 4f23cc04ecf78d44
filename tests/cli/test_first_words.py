"""What a stranger meets first: help that fits a terminal, and refusals that say what to do."""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path

import pytest
from rich.console import Console

from tissueid.cli import main, output
from tissueid.identification import engine_names


@pytest.mark.parametrize("command", [(), ("gap",), ("audit",), ("twin",)])
def test_no_line_of_the_list_of_commands_is_cut(
    command: tuple[str, ...], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("COLUMNS", "80")
    assert main([*command, "--help"]) == 0
    text = capsys.readouterr().out
    assert "Commands:" in text
    assert "..." not in text.partition("Commands:")[2]


def test_identify_without_an_engine_names_them(capsys: pytest.CaptureFixture[str]):
    assert main(["identify", "nosuch.h5"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert all(name in line for name in engine_names())


@pytest.mark.parametrize("written", [True, False])
def test_a_session_that_cannot_be_read_points_to_its_journal(
    written: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    path = tmp_path / "one.h5"
    if written:
        path.write_text("no session")
    assert main(["report", str(path), "--out", str(tmp_path / "page.html")]) == 2
    assert "recover" not in capsys.readouterr().err
    journal = tmp_path / "one.h5.journal"
    journal.write_bytes(b"")
    assert main(["report", str(path), "--out", str(tmp_path / "page.html")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"tissueid recover {journal}" in line
    assert ("is damaged" in line) == written


class _Flushed(io.StringIO):
    """Text that is only seen once it is flushed, as in a file."""

    seen = ""

    def flush(self) -> None:
        self.seen = self.getvalue()


def test_progress_into_a_file_comes_as_it_is_made_and_not_too_often(monkeypatch: pytest.MonkeyPatch):
    file, now = _Flushed(), 100.0
    monkeypatch.setattr(output, "console", Console(file=file, force_terminal=False))
    monkeypatch.setattr(output.time, "monotonic", lambda: now)
    with output.progress_bars() as show:
        show("fits", 0.0)
        assert file.seen == "fits: 0%\n"
        show("fits", 0.1)
        assert file.seen == "fits: 0%\n"
        now += 10.0
        show("fits", 0.5)
        assert file.seen == "fits: 0%\nfits: 50%\n"


@pytest.mark.parametrize(
    ("package", "extra", "command"),
    [
        ("pandas", "study", ["study", "table", "."]),
        ("sklearn", "study", ["study", "report", ".", "--out", "report.html"]),
        ("distributed", "cluster", ["study", "run", ".", "--scheduler", "tcp://127.0.0.1:1"]),
    ],
)
def test_without_an_extra_one_line_names_the_command_that_installs_it(
    package: str,
    extra: str,
    command: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.delitem(sys.modules, "tissueid.cli.study", raising=False)
    (tmp_path / "one.h5").touch()
    assert main(command) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"needs {package}, which is not installed" in line
    assert f"-m pip install 'tissueid[{extra}]'" in line
    assert [path.name for path in tmp_path.iterdir()] == ["one.h5"]


def test_the_list_of_commands_imports_no_library_and_has_the_laboratory_even_if_that_is_imported_first():
    code = """
import sys, tissueid_lab.commands
from tissueid.cli import main
assert main(["--help"]) == 0
heavy = {"numpy", "scipy", "h5py", "pydantic", "pandas", "matplotlib", "numba"}
assert not heavy & {name.partition(".")[0] for name in sys.modules}
assert main(["conformance", "--help"]) == 0
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (run.returncode, run.stderr) == (0, "")
