"""Commands whose module is imported when they are first used.

The list of commands and the version need names and help only; plans import pydantic and take most of the time.
"""

from __future__ import annotations

import importlib
from typing import Any

import typer
from typer.core import TyperCommand
from typer.main import get_command


def add_command(group: typer.Typer, name: str, function: str, help_text: str) -> None:
    """Add a command to a group.

        add_command(app, "test", "tissueid.cli.test:run_tests", "Run a guided test: placement, preload, stimulus.")

    Args:
        group: of the command.
        name: of the command.
        function: module and name of its function, whose parameters are those of the command
            (:func:`~tissueid.cli.plan_command.plan_command`).
        help_text: its help; the first line is shown in the list of commands.
    """

    def declared() -> None:
        """Stand for the function until the command is used."""

    declared.__doc__ = help_text
    declared.__dict__["function"] = function
    group.command(name, cls=LazyCommand)(declared)


class LazyCommand(TyperCommand):
    """A command whose parameters are built at first use."""

    _built = False

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters; at the first call, import the function and build them."""
        if not self._built:
            built = _built(self.callback.__dict__["function"])
            self.params, self.callback, self._built = built.params, built.callback, True
        return super().get_params(ctx)


def _built(function: str) -> Any:
    from tissueid.cli.plan_command import plan_command

    module, _colon, name = function.partition(":")
    app = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    app.command()(plan_command(getattr(importlib.import_module(module), name)))
    return get_command(app)
