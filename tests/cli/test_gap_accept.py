"""``tissueid gap accept`` at a terminal and in scripts: which members of a combination go into the twin."""

import io
import json
import sys
from dataclasses import replace

import pytest
from gap_records import observed, recorded

from tissueid.cli import main
from tissueid.gap.diagnosis import diagnose
from tissueid.gap.workers import SerialExecutor
from tissueid.instrument.twin_file import read_twin
from tissueid.procedures import diagnosis
from tissueid.sessions import write_session

PAIR = ("dry_friction", "directional_damping")
SAMPLES = 3000


class Terminal(io.StringIO):
    """Input of a person at a terminal."""

    def isatty(self):
        return True


@pytest.fixture(scope="module")
def pair():
    """A diagnosis that names two effects, the second one with a close rival."""
    found = diagnose(observed(PAIR[0], samples=SAMPLES), SerialExecutor(), candidates=PAIR)
    return replace(found, combination=PAIR, conditional_odds={PAIR[1]: ((PAIR[1], 0.4), ("latency", 0.3))})


@pytest.fixture
def accept(tmp_path, pair, monkeypatch):
    """Runs the command with an answer at the terminal, None for a script; returns its exit code."""
    monkeypatch.setattr(diagnosis, "diagnose", lambda *_args, **_options: pair)
    session = tmp_path / "session.h5"
    write_session(session, recorded(PAIR[0], samples=SAMPLES))

    def run(answer, *options):
        monkeypatch.setattr(sys, "stdin", io.StringIO() if answer is None else Terminal(answer))
        monkeypatch.setattr(sys.stderr, "isatty", lambda: answer is not None, raising=False)
        out = str(tmp_path / "twin.toml")
        return main(["gap", "accept", str(session), "--out", out, "--workers", "1", *options])

    run.out = tmp_path / "twin.toml"
    return run


def test_a_script_is_not_asked_and_is_shown_the_odds(accept, capsys):
    assert accept(None) == 0
    told = capsys.readouterr()
    assert "2. directional_damping: probability 40 %; rivals: latency 30 %" in told.out
    assert "1. dry_friction: probability > 99 %" in told.out
    assert "Which effects" not in told.err
    assert read_twin(accept.out).source.verdict == "effect"


def test_json_on_standard_output_holds_nothing_else(accept, capsys):
    assert accept(None, "--json", "-") == 0
    assert json.loads(capsys.readouterr().out)["name"] == "twin"


@pytest.mark.parametrize(("answer", "options"), [("\n", ()), ("1, 2\n", ()), ("", ("--yes",))])
def test_all_members_are_taken_by_enter_by_their_numbers_or_by_yes(accept, answer, options, capsys):
    assert accept(answer, *options) == 0
    assert ("Which effects" in capsys.readouterr().err) == (not options)
    assert read_twin(accept.out).source.verdict == "effect"


def test_one_member_is_fitted_by_itself(accept):
    assert accept("2\n") == 0
    made = read_twin(accept.out)
    assert [item.name for item in made.effects] == ["directional_damping"]
    assert made.source.verdict == "by hand"


@pytest.mark.parametrize(("answer", "code"), [("3\n", 2), ("dry_friction\n", 2), ("", 130)])
def test_another_answer_writes_nothing(accept, answer, code):
    assert accept(answer) == code
    assert not accept.out.exists()
