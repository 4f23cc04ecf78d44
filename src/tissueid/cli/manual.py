"""``tissueid manual``: the manual page of all commands, for ``man``, and the same as Markdown for the documentation."""

from __future__ import annotations

import typer

from tissueid.cli.command_reference import CommandText, all_commands
from tissueid.version import __version__


def manual_page(app: typer.Typer) -> str:
    """Return the manual page of the commands of ``app``, section 1, in the macros of man(7)."""
    first, *others = all_commands(app)
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


def manual_markdown(app: typer.Typer) -> str:
    """Return the reference of the commands of ``app`` as Markdown."""
    lines = ["# Commands", "", "Generated from the argument parsers. `tissueid COMMAND --help` prints the same.", ""]
    for command in all_commands(app):
        lines += [f"## {' '.join(('tissueid', *command.words))}", "", f"    {command.usage}", "", command.help, ""]
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
