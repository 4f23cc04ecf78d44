"""Output of ``tissueid audit``."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

from tissueid.cli.output import Output, table
from tissueid.errors import UnusableInputError
from tissueid.messages import stored
from tissueid.procedures.audit_queries import LogPlan, VerifiedLog, VerifyLogPlan, newest_lines, verify_log


def print_verification(plan: VerifyLogPlan, out: Output) -> None:
    """Verify a log and print the result.

    Raises:
        UnusableInputError: a line was altered, there is no log, or a file cannot be used.
    """
    verified = verify_log(plan)
    path, result = verified.path, verified.result
    out.print_lines(verified.remarks, soft_wrap=True)
    out.write_json(_answer(verified))
    if result.broken is not None:
        raise UnusableInputError(f"{path}: {result.broken.message}")
    if not result.lines:
        out.print(f"{path} contains no complete line: nothing has been logged yet", soft_wrap=True)
        return
    heads = f"; all {verified.heads} heads are in it" if verified.heads else ""
    out.print(f"{path}: {result.lines} lines, none altered{heads}", soft_wrap=True)
    out.print(f"head: {result.head}", soft_wrap=True)


def print_lines(plan: LogPlan, out: Output) -> None:
    """Print the newest lines of a log.

    Raises:
        UnusableInputError: there is no log.
    """
    path, lines = newest_lines(plan)
    out.write_json([asdict(line) for line in lines])
    out.widen(160)
    if out.json_on_stdout:
        return
    shown = (
        (str(line.number), line.time, line.role, line.who, line.what, line.subject, _short(line.old), _short(line.new))
        for line in lines
    )
    columns = ("line", "time", "role", "who", "what", "subject", "old", "new")
    out.print(table(str(path), *columns, rows=(map(_printable, row) for row in shown), left_aligned=True))


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
            "place": broken.line,
            "damage": broken.damage.value,
            "words": broken.message,
            "message": stored(broken.message),
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
