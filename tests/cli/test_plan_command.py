"""A plan declares its options once; the parameters of its command are made from them."""

from pathlib import Path
from typing import Annotated

import pytest
import typer
from coded import coded
from pydantic import Field

from tissueid.cli.plan_command import plan_command
from tissueid.errors import CANCELLED, CancelledError, UnusableInputError
from tissueid.plan_options import Option, Plan
from tissueid.procedures.control import Control


class Walk(Plan):
    out: Annotated[Path, Option("--out", metavar="FILE", help="where to")]
    step_m: Annotated[float, Option("--step", metavar="MM", scale=1e-3, help="step"), Field(ge=1e-3, le=5e-3)] = 2.5e-3
    seed: Annotated[int | None, Option(help="seed"), Field(ge=0, le=9)] = None
    weights_kg: Annotated[tuple[float, ...], Option("--weight", metavar="GRAMS", scale=1e-3)] = ()
    ends: Annotated[tuple[float, float] | None, Option(read=lambda text: tuple(map(float, text.split(":"))))] = None
    quick: Annotated[bool, Option("--quick")] = False
    kept: Annotated[bool, Option()] = True
    steps: Annotated[tuple[str, ...], Option("--steps", metavar="A,B", separator=",")] = ()
    hidden: str = ""


def run(arguments: list[str]) -> tuple[Walk, Path | None]:
    made: list[tuple[Walk, Path | None]] = []
    app = typer.Typer(rich_markup_mode=None)

    @app.command()
    @plan_command
    def walk(plan: Walk, json_file: Annotated[Path | None, typer.Option("--json")] = None) -> None:
        made.append((plan, json_file))

    app(arguments, standalone_mode=False)
    return made[0]


def test_options_not_given_have_the_defaults_of_the_plan():
    assert run(["--out", "a"]) == (Walk(out=Path("a")), None)


def test_values_are_read_into_the_units_of_the_plan():
    given = "--out a --step 3 --seed 4 --weight 20 --weight 50 --ends 1:2 --quick --no-kept --json b --steps x,,y,"
    plan = Walk(
        out=Path("a"),
        step_m=3e-3,
        seed=4,
        weights_kg=(0.02, 0.05),
        ends=(1.0, 2.0),
        quick=True,
        kept=False,
        steps=("x", "y"),
    )
    assert run(given.split()) == (plan, Path("b"))


def test_help_has_defaults_and_bounds_in_the_units_of_the_command_line(capsys: pytest.CaptureFixture[str]):
    with pytest.raises(IndexError):
        run(["--help"])
    text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "[default: 2.5; 1.0<=x<=5.0]" in text
    assert "[0<=x<=9]" in text
    assert "hidden" not in text


@pytest.mark.parametrize("given", ["--step 6", "--seed -1"])
def test_the_command_line_refuses_values_out_of_bounds(given: str):
    with pytest.raises(typer.BadParameter):
        run(["--out", "a", *given.split()])


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
