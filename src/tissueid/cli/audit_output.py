"""Output of ``tissueid audit``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tissueid.audit.line import fields_of
from tissueid.cli.output import check_json, human_output, table, write_json
from tissueid.errors import UnusableInputError
from tissueid.messages import stored
from tissueid.procedures.audit_queries import LogPlan, VerifiedLog, VerifyLogPlan, newest_lines, verify_log


def print_verification(plan: VerifyLogPlan, json_file: Path | None) -> None:
    """Verify a log and print the result.

    Raises:
        UnusableInputError: a line was altered, there is no log, or a file cannot be used.
    """
    check_json(json_file)
    verified = verify_log(plan)
    path, result = verified.path, verified.result
    out = human_output(json_file)
    for remark in verified.remarks:
        out.print(remark, markup=False, soft_wrap=True)
    if json_file is not None:
        write_json(json_file, _answer(verified))
    if result.broken is not None:
        raise UnusableInputError(f"{path}: {result.broken.words}")
    if not result.lines:
        out.print(f"{path} contains no complete line: nothing has been logged yet", markup=False, soft_wrap=True)
        return
    known = f"; all {verified.heads} heads are in it" if verified.heads else ""
    out.print(f"{path}: {result.lines} lines, none altered{known}", markup=False, soft_wrap=True)
    out.print(f"head: {result.head}", markup=False, soft_wrap=True)


def print_lines(plan: LogPlan, json_file: Path | None) -> None:
    """Print the newest lines of a log.

    Raises:
        UnusableInputError: there is no log.
    """
    check_json(json_file)
    path, lines = newest_lines(plan)
    if json_file is not None:
        write_json(json_file, [fields_of(line) for line in lines])
    out = human_output(json_file, width=160)
    rows = table(str(path), "line", "time", "role", "who", "what", "subject", "old", "new")
    for column in rows.columns[1:]:
        column.justify = "left"
    for line in lines:
        cells = (line.time, line.role, line.who, line.what, line.subject, _short(line.old), _short(line.new))
        rows.add_row(str(line.number), *(_printable(cell) for cell in cells))
    if str(json_file) != "-":
        out.print(rows, markup=False)


def _answer(verified: VerifiedLog) -> dict[str, Any]:
    result, broken = verified.result, verified.result.broken
    return {
        "log": str(verified.path),
        "whole": result.whole,
        "lines": result.lines,
        "head": result.head,
        "heads_checked": verified.heads,
        "broken": None
        if broken is None
        else {
            "place": broken.place,
            "damage": broken.damage.value,
            "words": broken.words,
            "message": stored(broken.words),
        },
        "remarks": list(verified.remarks),
    }


def _short(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, dict):
        return ", ".join(f"{key} {_short(item)}" for key, item in value.items())
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def _printable(text: str) -> str:
    """Return a text without characters that control a terminal."""
    return "".join(character if character.isprintable() else "?" for character in text)
