"""Completion scripts and the manual page: made from the argument parsers, so that they name every command."""

from __future__ import annotations

import shutil
import subprocess

import pytest
from typer.main import get_command

from tissueid.cli import main
from tissueid.cli.command_reference import all_commands, manual_markdown
from tissueid.cli.commands import loaded_app


@pytest.fixture(scope="module")
def words() -> set[tuple[str, ...]]:
    return {command.path for command in all_commands()}


def test_all_commands_are_read(words: set[tuple[str, ...]]):
    assert {name for (name, *_) in filter(None, words)} == set(get_command(loaded_app()).commands)
    assert {(), ("gap", "diagnose"), ("study", "report"), ("completion",)} <= words
    (test,) = [command for command in all_commands() if command.path == ("test",)]
    (method,) = [option for option in test.options if option.names == ("--live-method",)]
    assert method.choices == ("sliding", "rls", "als")
    assert all(option.help for command in all_commands() for option in command.options)


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_script_names_every_command(shell: str, words: set[tuple[str, ...]], capsys: pytest.CaptureFixture[str]):
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert all(name in script for command in words for name in command)
    assert "sliding rls als" in script


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
def test_bash_completes(capsys: pytest.CaptureFixture[str], tmp_path):
    assert main(["completion", "bash"]) == 0
    script = capsys.readouterr().out
    lines = {
        "tissueid ga": {"gap"},
        "tissueid gap di": {"diagnose"},
        "tissueid gap diagnose --wor": {"--workers"},
        "tissueid --role technician test --live-method r": {"rls"},
        "tissueid completion ": {"bash", "zsh", "fish"},
        "tissueid identify rec": {"record.h5"},
    }
    (tmp_path / "record.h5").touch()
    ask = "\n".join(
        f"COMP_LINE='{line}'; COMP_WORDS=({line} {chr(39) * 2 if line.endswith(' ') else ''});"
        " COMP_CWORD=$((${#COMP_WORDS[@]} - 1)); COMPREPLY=(); _tissueid; echo ${COMPREPLY[*]}"
        for line in lines
    )
    done = subprocess.run(["bash", "-c", script + ask], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.stderr == ""
    assert [set(line.split()) for line in done.stdout.splitlines()] == list(lines.values())


def test_an_unknown_shell_is_refused_in_one_line(capsys: pytest.CaptureFixture[str]):
    assert main(["completion", "tcsh"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "bash" in line


def test_the_manual_has_every_command(words: set[tuple[str, ...]], capsys: pytest.CaptureFixture[str]):
    assert main(["manual"]) == 0
    page = capsys.readouterr().out
    assert page.startswith(".TH TISSUEID 1")
    markdown = manual_markdown()
    for command in filter(None, words):
        assert f"tissueid {' '.join(command)}".replace("-", "\\-") in page
        assert f"\n## tissueid {' '.join(command)}\n" in markdown
    if shutil.which("groff") is not None:
        made = subprocess.run(
            ["groff", "-man", "-Tascii", "-ww"], input=page, capture_output=True, text=True, timeout=60
        )
        assert made.stderr == ""
