"""Commands as scripts and people meet them."""

from __future__ import annotations

import json
from typing import Any

import pytest

from tissueid.cli import main


def answer(capsys: pytest.CaptureFixture[str], *arguments: object) -> Any:
    """Run a command that prints JSON; return it parsed."""
    assert main([*map(str, arguments), "--json", "-"]) == 0
    return json.loads(capsys.readouterr().out)


def complaint(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Run a command that must refuse in one line; return the line."""
    assert main([*map(str, arguments)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "Traceback" not in captured.err
    lines = [line for line in captured.err.splitlines() if line.strip()]
    assert [line for line in lines if line.startswith("tissueid: ")] == lines[-1:]
    assert len(lines[-1]) < 600
    return lines[-1]
