"""``tissueid audit``: show and verify the audit log."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from tissueid.audit import HEAD_ATTRIBUTE, Verification, default_path, last_lines, verify
from tissueid.audit.line import fields_of
from tissueid.audit.newest_head import read_newest
from tissueid.cli.output import check_json, human_output, message_json, table, write_json
from tissueid.errors import UnusableInputError
from tissueid.messages import Message
from tissueid.untrusted_input import toml_table

audit = typer.Typer(help="Show and verify the audit log.", no_args_is_help=True)

LogFile = Annotated[
    Path | None, typer.Option("--log", metavar="FILE", help="log file; default: the log of this computer")
]
JsonFile = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="write the result as JSON; - prints it")]

_MOST_TOML = 10_000_000


@audit.command("verify")
def verify_log(
    files: Annotated[
        list[Path] | None,
        typer.Argument(metavar="FILE...", help="sessions and calibrations whose heads the log must contain"),
    ] = None,
    log: LogFile = None,
    head: Annotated[
        list[str] | None, typer.Option("--head", metavar="NUMBER:HASH", help="a head that was noted elsewhere")
    ] = None,
    after: Annotated[
        list[Path] | None, typer.Option("--after", metavar="FILE", help="an earlier log that was moved")
    ] = None,
    json_file: JsonFile = None,
) -> None:
    """Verify the log line by line. Exit status 2 and the first altered line if it was changed."""
    check_json(json_file)
    path = log or default_path()
    heads = dict.fromkeys(head or (), "the head of --head")
    without = []
    for file in files or ():
        if carried := _head_of(file):
            heads[carried] = str(file)
        else:
            without.append(f"{file} contains no head of the log")
    with _readable(path):
        result = verify(path, heads, after=after or ())
    out = human_output(json_file)
    for remark in (*result.remarks, *without):
        out.print(remark, markup=False, soft_wrap=True)
    if json_file is not None:
        write_json(json_file, _answer(path, result, len(heads), without))
    if result.broken is not None:
        raise UnusableInputError(f"{path}: {result.broken.words}")
    if not result.lines:
        out.print(f"{path} contains no complete line: nothing has been logged yet", markup=False, soft_wrap=True)
        return
    known = f"; all {len(heads)} heads are in it" if heads else ""
    out.print(f"{path}: {result.lines} lines, none altered{known}", markup=False, soft_wrap=True)
    out.print(f"head: {result.head}", markup=False, soft_wrap=True)


@audit.command("show")
def show_log(
    log: LogFile = None,
    last: Annotated[int, typer.Option(min=1, max=1_000_000, metavar="N", help="number of lines")] = 20,
    json_file: JsonFile = None,
) -> None:
    """Print the newest lines without verifying them."""
    check_json(json_file)
    path = log or default_path()
    with _readable(path):
        lines = last_lines(path, last)
    if json_file is not None:
        write_json(json_file, [fields_of(line) for line in lines])
    out = human_output(json_file)
    if not out.is_terminal:
        out.width = 160
    rows = table(str(path), "line", "time", "role", "who", "what", "subject", "old", "new")
    for column in rows.columns[1:]:
        column.justify = "left"
    for line in lines:
        cells = (line.time, line.role, line.who, line.what, line.subject, _short(line.old), _short(line.new))
        rows.add_row(str(line.number), *(_printable(cell) for cell in cells))
    if str(json_file) != "-":
        out.print(rows, markup=False)


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
        else {
            "place": broken.place,
            "damage": broken.damage.value,
            "words": broken.words,
            "message": message_json(broken.words),
        },
        "remarks": [*result.remarks, *without],
    }


def _head_of(path: Path) -> str:
    """Return the head of the log that a session or a calibration contains; "" if there is none.

    Raises:
        UnusableInputError: the file is neither.
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
    """Convert the error of a missing log to a message for people.

    Raises:
        UnusableInputError: there is no log.
    """
    try:
        yield
    except FileNotFoundError as error:
        if (newest := read_newest(path)) is not None:
            raise UnusableInputError(
                Message(
                    "audit.log_removed",
                    "the audit log {path} was removed or moved; its newest line had number {number}",
                    path=str(path),
                    number=newest[0],
                )
            ) from error
        raise UnusableInputError(
            f"there is no audit log {path}: nothing has been logged yet, or the log was moved"
        ) from error


def _short(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, dict):
        return ", ".join(f"{key} {_short(item)}" for key, item in value.items())
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def _printable(text: str) -> str:
    """Return a text without characters that control a terminal."""
    return "".join(character if character.isprintable() else "?" for character in text)
