"""A plan declares its options once; the parameters of its command are made from them."""

import shlex
from pathlib import Path
from typing import Annotated, Any

import pytest
import typer
from coded import coded
from pydantic import Field

from tissueid.app.option_field import OptionField
from tissueid.cli.plan_command import plan_command
from tissueid.errors import CANCELLED, CancelledError, UnusableInputError
from tissueid.plan_options import Option, Plan, shell_options
from tissueid.procedures.control import Control
from tissueid.test_settings import TestSettings


class Walk(Plan):
    out: Annotated[Path, Option("--out", metavar="FILE", help="where to")]
    step_m: Annotated[float, Option("--step", metavar="MM", scale=1e-3, help="step"), Field(ge=1e-3, le=5e-3)] = 2.5e-3
    seed: Annotated[int | None, Option(help="seed"), Field(ge=0, le=9)] = None
    load_kg: Annotated[float, Option(help="load", scale=1e-3), Field(gt=0.0, le=0.05)] = 0.02
    turns: Annotated[int, Option(help="turns"), Field(gt=1, lt=5)] = 2
    weights_kg: Annotated[tuple[float, ...], Option("--weight", metavar="GRAMS", scale=1e-3)] = ()
    ends: Annotated[tuple[float, float] | None, Option(read=lambda text: tuple(map(float, text.split(":"))))] = None
    quick: Annotated[bool, Option("--quick")] = False
    kept: Annotated[bool, Option()] = True
    steps: Annotated[tuple[str, ...], Option("--steps", metavar="A,B", separator=",")] = ()
    hidden: str = ""


def run(arguments: list[str], kind: type[Plan] = Walk) -> tuple[Any, Path | None]:
    made: list[tuple[Plan, Path | None]] = []
    app = typer.Typer(rich_markup_mode=None)

    def walk(plan: Plan, json_file: Annotated[Path | None, typer.Option("--json")] = None) -> None:
        made.append((plan, json_file))

    walk.__annotations__["plan"] = kind
    app.command()(plan_command(walk))
    app(arguments, standalone_mode=False)
    return made[0]


def test_options_not_given_have_the_defaults_of_the_plan():
    assert run(["--out", "a"]) == (Walk(out=Path("a")), None)


def test_values_are_read_into_the_units_of_the_plan():
    given = "--out a --step 3 --load-kg 12.5 --seed 4 --weight 20 --weight 50 --ends 1:2 --quick --no-kept"
    plan = Walk(
        out=Path("a"),
        step_m=3e-3,
        load_kg=0.0125,
        seed=4,
        weights_kg=(0.02, 0.05),
        ends=(1.0, 2.0),
        quick=True,
        kept=False,
        steps=("x", "y"),
    )
    assert run([*given.split(), "--json", "b", "--steps", "x,,y,"]) == (plan, Path("b"))


def test_help_has_defaults_and_bounds_in_the_units_of_the_command_line(capsys: pytest.CaptureFixture[str]):
    with pytest.raises(IndexError):
        run(["--help"])
    text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "[default: 2.5; 1.0<=x<=5.0]" in text
    assert "[0<=x<=9]" in text
    assert "load [0.0<x<=50.0] [default: 20.0]" in text
    assert "turns [1<x<5] [default: 2]" in text
    assert "hidden" not in text


@pytest.mark.parametrize("given", ["--step 6", "--seed -1", "--load-kg 0", "--load-kg 51", "--turns 1", "--turns 5"])
def test_the_command_line_refuses_values_out_of_bounds(given: str):
    with pytest.raises(typer.BadParameter):
        run(["--out", "a", *given.split()])


def test_a_form_has_the_bounds_of_the_command_line(qtbot):
    load, turns = (OptionField(name, Walk.model_fields[name]) for name in ("load_kg", "turns"))
    for field, value in ((load, 0.0), (load, 1.0), (turns, 0), (turns, 9)):
        qtbot.addWidget(field)
        field.set_value(value)
    assert (load.value(), turns.value()) == (0.05, 4)
    load.set_value(-1.0)
    turns.set_value(1)
    assert 0.0 < load.value() < 1e-9
    assert turns.value() == 2


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"step_m": 4.3e-3, "seed": 0, "load_kg": 1 / 64, "weights_kg": (0.02, 0.0125), "kept": False},
        {"steps": ("x y", "-z"), "quick": True},
    ],
)
def test_printed_options_are_read_again(values):
    plan = Walk(out=Path("a b"), **values)
    assert run(shlex.split(shell_options(plan)))[0] == plan


@pytest.mark.parametrize(
    "values",
    [
        {"stimulus": "noise", "distribution": "uniform", "min_force_n": -0.5, "max_force_n": 1 / 3, "seconds": 4.0},
        {"configuration": "extension", "coupling": "tape", "orientation_deg": -45.0, "initial_length_m": 0.0123},
        {"configuration": "surface", "external_spring_n_per_m": 1234.5, "normal_preload_n": 1e-3, "seed": 7},
        {"site": "left 'arm'", "condition": "-lotion", "minutes_since_application": 30.0, "kind": "spring"},
    ],
)
def test_the_printed_settings_of_a_test_are_read_again(values):
    settings = TestSettings(**values)
    assert run(shlex.split(shell_options(settings)), TestSettings)[0] == settings


def test_a_plan_refuses_values_out_of_bounds():
    with pytest.raises(UnusableInputError, check=coded("option.refused", option="seed")):
        Walk(out=Path("a"), seed=12)


def test_a_control_raises_its_reason_once_it_is_cancelled():
    class Stopped(Control):
        def cancelled(self) -> bool:
            return True

    assert Control().check() is False
    with pytest.raises(CancelledError) as cancelled:
        Stopped().check()
    assert cancelled.value.message == CANCELLED
