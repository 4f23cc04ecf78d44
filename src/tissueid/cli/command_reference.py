"""All commands with their options, read from the argument parsers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import typer


@dataclass(frozen=True)
class OptionText:
    """One option or argument: its ``names`` ("" for an argument), how help writes it, and the help itself.

    ``choices`` are its values where there are few; ``takes_value`` is false for switches, ``takes_file`` is true for
    paths.
    """

    names: tuple[str, ...]
    written: str
    help: str
    choices: tuple[str, ...] = ()
    takes_value: bool = False
    takes_file: bool = False


@dataclass(frozen=True)
class CommandText:
    """One command: the words after ``tissueid``, its help in paragraphs, its arguments and options, its subcommands."""

    words: tuple[str, ...]
    help: str
    arguments: tuple[OptionText, ...]
    options: tuple[OptionText, ...]
    subcommands: tuple[str, ...] = ()

    @property
    def usage(self) -> str:
        """The line that shows how the command is called."""
        tail = ["COMMAND"] if self.subcommands else [item.written for item in self.arguments]
        return " ".join(["tissueid", *self.words, *(["[OPTIONS]"] if self.options else []), *tail])


def all_commands(app: typer.Typer) -> tuple[CommandText, ...]:
    """Return all commands: ``tissueid`` itself first, each group before its commands."""
    group = typer.main.get_group(app)
    return tuple(_commands(group, (), typer.Context(group, info_name="tissueid")))


def _commands(command: Any, words: tuple[str, ...], context: Any) -> Iterator[CommandText]:
    subcommands: dict[str, Any] = getattr(command, "commands", {})
    parameters = [item for item in command.get_params(context) if not item.hidden]
    yield CommandText(
        words,
        "\n\n".join(" ".join(part.split()) for part in (command.help or "").split("\n\n")),
        tuple(_option(item, context) for item in parameters if not item.opts[0].startswith("-")),
        tuple(_option(item, context) for item in parameters if item.opts[0].startswith("-")),
        tuple(subcommands),
    )
    for name, subcommand in subcommands.items():
        inside = typer.Context(subcommand, info_name=name, parent=context)
        yield from _commands(subcommand, (*words, name), inside)


def _option(parameter: Any, context: Any) -> OptionText:
    written, text = parameter.get_help_record(context) or (parameter.metavar or parameter.name, parameter.help or "")
    option = parameter.opts[0].startswith("-")
    descriptor = getattr(parameter, "type_descriptor", None)
    kind = getattr(descriptor, "annotation", str)
    element = get_args(kind)[0] if get_origin(kind) is list else kind
    choices = tuple(map(str, get_args(element))) if get_origin(element) is Literal else ()
    if not option:
        written = parameter.metavar or parameter.name.upper()
    return OptionText(
        names=tuple(name for name in (*parameter.opts, *parameter.secondary_opts) if option),
        written=written,
        help=" ".join(text.split()),
        choices=choices,
        takes_value=option and not getattr(parameter, "is_flag", False),
        takes_file=isinstance(element, type) and issubclass(element, Path),
    )
