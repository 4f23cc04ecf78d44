"""The tree of commands: completion scripts of shells, and the manual page."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

import typer

from tissueid.cli.commands import loaded_app
from tissueid.version import __version__


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
    """One command: the names after ``tissueid``, its help in paragraphs, its arguments and options, its subcommands."""

    path: tuple[str, ...]
    help: str
    arguments: tuple[OptionText, ...]
    options: tuple[OptionText, ...]
    subcommands: tuple[str, ...] = ()

    @property
    def usage(self) -> str:
        """The line that shows how the command is called."""
        tail = ["COMMAND"] if self.subcommands else [item.written for item in self.arguments]
        return " ".join(["tissueid", *self.path, *(["[OPTIONS]"] if self.options else []), *tail])


@cache
def all_commands() -> tuple[CommandText, ...]:
    """Return all commands: ``tissueid`` itself first, each group before its commands."""
    group = typer.main.get_group(loaded_app())
    return tuple(_commands(group, (), typer.Context(group, info_name="tissueid")))


def _commands(command: Any, path: tuple[str, ...], context: Any) -> Iterator[CommandText]:
    subcommands: dict[str, Any] = getattr(command, "commands", {})
    parameters = [item for item in command.get_params(context) if not item.hidden]
    yield CommandText(
        path,
        "\n\n".join(" ".join(part.split()) for part in (command.help or "").split("\n\n")),
        tuple(_option(item, context) for item in parameters if not item.opts[0].startswith("-")),
        tuple(_option(item, context) for item in parameters if item.opts[0].startswith("-")),
        tuple(subcommands),
    )
    for name, subcommand in subcommands.items():
        inside = typer.Context(subcommand, info_name=name, parent=context)
        yield from _commands(subcommand, (*path, name), inside)


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


def print_completion(
    shell: Annotated[Literal["bash", "zsh", "fish"], typer.Argument(metavar="SHELL", help="bash, zsh or fish")],
) -> None:
    """Print the completion script of a shell."""
    typer.echo(completion_script(shell), nl=False)


def completion_script(shell: Literal["bash", "zsh", "fish"]) -> str:
    """Return the completion script of a shell for all commands."""
    commands = {command.path: command for command in all_commands()}
    return {"bash": _bash, "zsh": _zsh, "fish": _fish}[shell](commands)


def _bash(commands: dict[tuple[str, ...], CommandText]) -> str:
    lines = [
        "# tissueid completion bash > ~/.local/share/bash-completion/completions/tissueid",
        "_tissueid() {",
        "    local word=${COMP_WORDS[COMP_CWORD]} before=${COMP_WORDS[COMP_CWORD-1]}",
        "    local command= item words= options= values= files=",
        '    for item in "${COMP_WORDS[@]:1:COMP_CWORD-1}"; do',
        '        case "$command $item" in',
    ]
    for path in filter(None, commands):
        command = shlex.quote(_joined(path))
        lines.append(f"            {command}) command={command} ;;")
    lines += ["        esac", "    done", '    case "$command" in']
    for path, text in commands.items():
        names = [*text.subcommands, *(choice for item in text.arguments for choice in item.choices)]
        options = [name for option in text.options for name in option.names]
        quoted = f"words={shlex.quote(' '.join(names))} options={shlex.quote(' '.join(options))}"
        lines.append(f"        {shlex.quote(_joined(path))}) {quoted} files={'' if names else 1} ;;")
    lines += ["    esac", '    case "$command $before" in']
    for path, text in commands.items():
        for option in (item for item in text.options if item.takes_value):
            patterns = "|".join(shlex.quote(f"{_joined(path)} {name}") for name in option.names)
            files = "" if option.choices else "files=1 "
            lines.append(f"        {patterns}) words= {files}values={shlex.quote(' '.join(option.choices))} ;;")
    return "\n".join([*lines, _BASH_END])


_BASH_END = """\
    esac
    if [ -n "$values" ]; then
        COMPREPLY=($(compgen -W "$values" -- "$word"))
    elif [[ $word == -* ]]; then
        COMPREPLY=($(compgen -W "$options" -- "$word"))
    else
        COMPREPLY=($(compgen -W "$words" -- "$word"))
        [ -z "$files" ] || COMPREPLY+=($(compgen -f -- "$word"))
    fi
}
complete -o filenames -F _tissueid tissueid
"""


def _joined(path: tuple[str, ...]) -> str:
    return "".join(f" {word}" for word in path)


def _zsh(commands: dict[tuple[str, ...], CommandText]) -> str:
    lines = [
        "#compdef tissueid",
        "# Completion of tissueid for zsh: tissueid completion zsh > a folder of $fpath/_tissueid",
    ]
    for path, command in commands.items():
        lines += [f"{_function(path)}() {{", "    local context state state_descr line", "    typeset -A opt_args"]
        parts = [_zsh_option(name, option) for option in command.options for name in option.names]
        if command.subcommands:
            parts += ["'1: :->command'", "'*::argument:->arguments'"]
        elif command.arguments:
            choices = " ".join(choice for item in command.arguments for choice in item.choices)
            parts.append(f"'*:value:({choices})'" if choices else "'*:file:_files'")
        lines.append("    _arguments -C " + " ".join(parts))
        if command.subcommands:
            described = " ".join(
                shlex.quote(f"{name}:{_first(commands[(*path, name)].help)}") for name in command.subcommands
            )
            lines += [
                "    case $state in",
                f"        command) local -a names=({described}); _describe command names ;;",
                "        arguments) case $line[1] in",
                *(f"            {name}) {_function((*path, name))} ;;" for name in command.subcommands),
                "        esac ;;",
                "    esac",
            ]
        lines.append("}")
    return "\n".join([*lines, '_tissueid "$@"']) + "\n"


def _function(path: tuple[str, ...]) -> str:
    return "_".join(("_tissueid", *(word.replace("-", "_") for word in path)))


def _zsh_option(name: str, option: OptionText) -> str:
    about = option.help.translate(str.maketrans("[]:", "();"))
    text = f"*{name}[{about}]"
    if option.choices:
        text += f":value:({' '.join(option.choices)})"
    elif option.takes_value:
        text += ":file:_files" if option.takes_file else ":value: "
    return shlex.quote(text)


def _fish(commands: dict[tuple[str, ...], CommandText]) -> str:
    lines = ["# tissueid completion fish > ~/.config/fish/completions/tissueid.fish"]
    for path, command in commands.items():
        given = "; and ".join(f"__fish_seen_subcommand_from {word}" for word in path) or "true"
        if command.subcommands:
            inside = f"{given}; and not __fish_seen_subcommand_from {' '.join(command.subcommands)}"
            for name in command.subcommands:
                about = _first(commands[(*path, name)].help)
                lines.append(f"complete -c tissueid -f -n {shlex.quote(inside)} -a {name} -d {shlex.quote(about)}")
        for option in command.options:
            for name in option.names:
                line = (
                    f"complete -c tissueid -n {shlex.quote(given)} -l {name.lstrip('-')} -d {shlex.quote(option.help)}"
                )
                if option.choices:
                    line += f" -x -a {shlex.quote(' '.join(option.choices))}"
                elif option.takes_value:
                    line += " -r"
                lines.append(line)
    return "\n".join(lines) + "\n"


def _first(text: str) -> str:
    """Return the first sentence of a help without its full stop."""
    return text.split(". ")[0].removesuffix(".").split("\n")[0]


def print_manual() -> None:
    """Print the manual page of all commands."""
    typer.echo(manual_page(), nl=False)


def manual_page() -> str:
    """Return the manual page of all commands, section 1, in the macros of man(7)."""
    first, *others = all_commands()
    lines = [
        f'.TH TISSUEID 1 "" "tissueid {__version__}" "User commands"',
        ".SH NAME",
        "tissueid \\- measure living tissue with a voice coil and nonlinear system identification",
        ".SH SYNOPSIS",
        ".B tissueid",
        "[\\fIOPTIONS\\fR] [\\fICOMMAND\\fR]",
        ".SH DESCRIPTION",
        _roff(first.help),
        "Without a command, the window is opened.",
        *_roff_options(first),
        ".SH COMMANDS",
    ]
    for command in others:
        lines += [f".SS {_roff(command.usage)}", *(_roff(part) for part in command.help.split("\n\n"))]
        lines += _roff_options(command)
    lines += [
        ".SH EXIT STATUS",
        *(".TP", ".B 0", "success"),
        *(".TP", ".B 2", "unusable input; one line on standard error says what to do"),
        *(".TP", ".B 130", "interrupted; recorded data is kept"),
        *(".TP", ".B 1", "a defect, or a clause that failed"),
        ".SH SAFETY",
        "For research use only. This is not a medical device.",
    ]
    return "\n".join(lines) + "\n"


def manual_markdown() -> str:
    """Return the reference of all commands as Markdown."""
    lines = ["# Commands", "", "Generated from the argument parsers. `tissueid COMMAND --help` prints the same.", ""]
    for command in all_commands():
        lines += [f"## {' '.join(('tissueid', *command.path))}", "", f"    {command.usage}", "", command.help, ""]
        rows = [(item.written, item.help) for item in (*command.arguments, *command.options)]
        if rows:
            lines += ["| | |", "| --- | --- |"]
            lines += [f"| `{_cell(written)}` | {_plain(about)} |" for written, about in rows]
            lines.append("")
    return "\n".join(lines)


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def _plain(text: str) -> str:
    """Return a text in which Markdown finds no markup."""
    return "".join(f"\\{sign}" if sign in "\\`*_<>[]|#" else sign for sign in text)


def _roff(text: str) -> str:
    escaped = text.replace("\\", "\\e").replace("-", "\\-")
    return f"\\&{escaped}" if escaped[:1] in (".", "'") else escaped


def _roff_options(command: CommandText) -> list[str]:
    lines: list[str] = []
    for item in (*command.arguments, *command.options):
        lines += [".TP", f".B {_roff(item.written)}", _roff(item.help)]
    return lines
