"""Sample sessions: every plan is valid, every suggested command exists, and files are never overwritten."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from coded import coded

from tissueid.cli import main
from tissueid.cli.command_reference import all_commands
from tissueid.errors import UnusableInputError
from tissueid.procedures import demo
from tissueid.procedures.control import Control
from tissueid.procedures.demo import SAMPLES, SamplesPlan, make_samples
from tissueid.procedures.test_plan import TestPlan
from tissueid.sessions import read_session


def test_every_plan_and_command_is_valid(tmp_path: Path):
    commands = {" ".join(command.path): command for command in all_commands()}
    for name, sample in SAMPLES.items():
        TestPlan(url=sample.url, out=tmp_path / name, **sample.values).check()
        program, command, *words = sample.command.split()
        assert program == "tissueid"
        options = {option for item in commands[command].options for option in item.names}
        assert {word for word in words if word.startswith("--")} <= options
        assert {word for word in words if word.endswith(".h5")} <= set(SAMPLES)


def test_samples_are_the_same_at_every_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(demo, "SAMPLES", {"spring.h5": SAMPLES["spring.h5"]})
    for folder in ("one", "two"):
        assert main(["samples", "--out", str(tmp_path / folder), "--json", str(tmp_path / f"{folder}.json")]) == 0
    assert "tissueid identify spring.h5" in capsys.readouterr().out
    one, two = (read_session(tmp_path / folder / "spring.h5").tests[0] for folder in ("one", "two"))
    np.testing.assert_array_equal(one.signals["position"], two.signals["position"])
    (answer,) = json.loads((tmp_path / "one.json").read_text())
    assert answer["tests"] == 1
    with pytest.raises(UnusableInputError, check=coded("save_path.exists")):
        make_samples(SamplesPlan(out=tmp_path / "one"), Control())
