"""Commands that read the options of their plan when they are first used.

The list of commands and the version need names and first lines only; plans import pydantic and take most of the time.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer
from typer.core import TyperCommand
from typer.main import get_command

JsonFile = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="write the result as JSON; - prints it")]
_Function = TypeVar("_Function", bound=Callable[..., None])


def add_command(group: typer.Typer, name: str, plans: str = "") -> Callable[[_Function], _Function]:
    """Return a decorator that adds a function to a group of commands.

        @add_command(app, "test", "test_plan")
        def run_test(plan: TestPlan, json_file: JsonFile = None) -> None:

    Args:
        group: of the command.
        name: of the command.
        plans: module with the plan, of ``tissueid.procedures`` if without a dot; its names are known in the annotations
            of the function.
    """

    def add(function: _Function) -> _Function:
        def declared() -> None:
            """Stand for the function until the command is used."""

        declared.__doc__ = function.__doc__
        declared.__dict__["build"] = lambda: _built(function, plans)
        group.command(name, cls=LazyCommand)(declared)
        return function

    return add


class LazyCommand(TyperCommand):
    """A command whose parameters are built at first use."""

    _built = False

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters; at the first call, import the plan and build them."""
        if not self._built:
            built = self.callback.__dict__["build"]()
            self.params, self.callback, self._built = built.params, built.callback, True
        return super().get_params(ctx)


def _built(function: Callable[..., None], plans: str) -> Any:
    from tissueid.cli.plan_command import plan_command

    module = plans if "." in plans else f"tissueid.procedures.{plans}"
    names = vars(importlib.import_module(module)) if plans else {}
    function.__annotations__ = {
        name: parameter.annotation
        for name, parameter in inspect.signature(function, eval_str=True, locals=names).parameters.items()
    }
    app = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    app.command()(plan_command(function))
    return get_command(app)
