"""``tissueid audit``: what the log says, and whether it is whole."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from tissueid.audit import HEAD_ATTRIBUTE, Verification, default_path, last_lines, verify
from tissueid.audit.line import fields_of
from tissueid.audit.newest import read_newest
from tissueid.cli.output import check_json, people_read, table, write_json
from tissueid.errors import UnusableInputError
from tissueid.untrusted import toml_table

audit = typer.Typer(help="The audit log: who did what when, and whether it is whole.", no_args_is_help=True)

LogFile = Annotated[Path | None, typer.Option("--log", metavar="FILE", help="the log; this computer's without")]
JsonFile = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="write the answer as JSON; - prints it")]

_MOST_TOML = 10_000_000


@audit.command("verify")
def verify_log(
    files: Annotated[
        list[Path] | None, typer.Argument(metavar="FILE...", help="sessions and calibrations that the log must know")
    ] = None,
    log: LogFile = None,
    head: Annotated[
        list[str] | None, typer.Option("--head", metavar="NUMBER:HASH", help="a head that was written down elsewhere")
    ] = None,
    after: Annotated[
        list[Path] | None, typer.Option("--after", metavar="FILE", help="an earlier log that was moved away")
    ] = None,
    json_file: JsonFile = None,
) -> None:
    """Go through the log line by line. Ends with status 2 and the first line that is not as it was written."""
    check_json(json_file)
    path = log or default_path()
    heads = dict.fromkeys(head or (), "the head that was written down")
    without = []
    for file in files or ():
        if carried := _head_of(file):
            heads[carried] = str(file)
        else:
            without.append(f"{file} carries no head of the log")
    with _readable(path):
        result = verify(path, heads, after=after or ())
    people = people_read(json_file)
    for remark in (*result.remarks, *without):
        people.print(remark, markup=False, soft_wrap=True)
    if json_file is not None:
        write_json(json_file, _answer(path, result, len(heads), without))
    if result.broken is not None:
        raise UnusableInputError(f"{path}: {result.broken.words}")
    if not result.lines:
        people.print(f"{path} holds no whole line: nothing has been logged yet", markup=False, soft_wrap=True)
        return
    known = f", and all {len(heads)} heads are in it" if heads else ""
    people.print(f"{path}: {result.lines} lines, all as they were written{known}", markup=False, soft_wrap=True)
    people.print(f"head: {result.head}", markup=False, soft_wrap=True)


@audit.command("show")
def show_log(
    log: LogFile = None,
    last: Annotated[int, typer.Option(min=1, max=1_000_000, metavar="N", help="how many of the newest lines")] = 20,
    json_file: JsonFile = None,
) -> None:
    """Print the newest lines. It does not check them: 'tissueid audit verify' does."""
    check_json(json_file)
    path = log or default_path()
    with _readable(path):
        lines = last_lines(path, last)
    if json_file is not None:
        write_json(json_file, [fields_of(line) for line in lines])
    people = people_read(json_file)
    if not people.is_terminal:
        people.width = 160
    rows = table(str(path), "line", "time", "role", "who", "what", "subject", "old", "new")
    for column in rows.columns[1:]:
        column.justify = "left"
    for line in lines:
        cells = (line.time, line.role, line.who, line.what, line.subject, _short(line.old), _short(line.new))
        rows.add_row(str(line.number), *(_printable(cell) for cell in cells))
    if str(json_file) != "-":
        people.print(rows, markup=False)


def _answer(path: Path, result: Verification, heads: int, without: list[str]) -> dict[str, Any]:
    broken = result.broken
    return {
        "log": str(path),
        "whole": result.whole,
        "lines": result.lines,
        "head": result.head,
        "heads_checked": heads,
        "broken": None
        if broken is None
        else {"place": broken.place, "damage": broken.damage.value, "words": broken.words},
        "remarks": [*result.remarks, *without],
    }


def _head_of(path: Path) -> str:
    """The head that a session or a calibration carries; empty where it carries none.

    Raises:
        UnusableInputError: it is neither.
    """
    from tissueid.sessions import read_session_head

    if path.suffix != ".toml":
        return read_session_head(path).audit_head
    with path.open("rb") as file:
        raw = file.read(_MOST_TOML)
    try:
        conditions = toml_table(raw).get("conditions", {})
    except ValueError as error:
        raise UnusableInputError(f"{path} is not a calibration of this software") from error
    return str(conditions.get(HEAD_ATTRIBUTE, "")) if isinstance(conditions, dict) else ""


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Tell a log that is not there from one that cannot be read.

    Raises:
        UnusableInputError: there is none.
    """
    try:
        yield
    except FileNotFoundError as error:
        if (newest := read_newest(path)) is not None:
            raise UnusableInputError(
                f"there is no audit log {path} any more: its newest line was number {newest[0]}, and it was removed or "
                "moved"
            ) from error
        raise UnusableInputError(
            f"there is no audit log {path}: nothing has been logged yet, or it was moved"
        ) from error


def _short(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, dict):
        return ", ".join(f"{key} {_short(item)}" for key, item in value.items())
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def _printable(text: str) -> str:
    """Text that does nothing to a terminal but stand there."""
    return "".join(character if character.isprintable() else "?" for character in text)
