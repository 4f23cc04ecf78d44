"""Audit logs to try things on, and their chain reckoned by hand."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from hashlib import sha256
from pathlib import Path

from tissueid.audit import AuditLog
from tissueid.audit.log import newest_path

START = datetime(2026, 3, 4, 5, 6, 7, tzinfo=UTC)


class Clock:
    """A second a line."""

    def __init__(self) -> None:
        self.now = START

    def __call__(self) -> datetime:
        self.now += timedelta(seconds=1)
        return self.now


def a_log(path: Path, lines: int = 4) -> AuditLog:
    log = AuditLog(path, Clock())
    for number in range(lines):
        log.record(
            "researcher", "test.begun", subject=f"P{number}", old=number, new={"site": "forearm [x]\n", "n": 1.5}
        )
    return log


def forget(path: Path) -> None:
    """Have nothing know of the newest line of a log but the log: as after a computer that died while it was written."""
    newest_path(path).unlink(missing_ok=True)


def chain_by_hand(path: Path) -> list[dict]:
    """The chain as docs/audit.md says it, reckoned without the package."""
    previous, lines = "0" * 64, []
    for number, raw in enumerate(path.read_bytes().splitlines(), start=1):
        body, _, tail = raw.rpartition(b',"hash":"')
        line = json.loads(raw)
        assert tail == line["hash"].encode() + b'"}'
        assert line["hash"] == sha256(body).hexdigest()
        assert (line["previous"], line["number"]) == (previous, number)
        previous = line["hash"]
        lines.append(line)
    return lines


def rows(path: Path) -> list[bytes]:
    return path.read_bytes().splitlines(keepends=True)
