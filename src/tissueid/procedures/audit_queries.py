"""Entries of a procedure in the audit log."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from tissueid.audit import HEAD_ATTRIBUTE, AuditTrail, Verification, default_path, last_lines, verify
from tissueid.audit.log import read_newest
from tissueid.errors import CancelledError, UnattendedError, UnusableInputError
from tissueid.messages import Message
from tissueid.plan_options import Option, Plan
from tissueid.procedures.control import Control
from tissueid.untrusted_input import toml_table

if TYPE_CHECKING:
    from tissueid.audit.line import LogLine


NOT_LOGGED = "audit.not_logged"
"""Code of the notice about what could not be logged."""


def audit_note(
    trail: AuditTrail, control: Control, what: str, *, subject: str = "", old: Any = None, new: Any = None
) -> None:
    """Log a finished operation, and wait for the disk; a failure is a notice."""
    trail.note(what, subject=subject, old=old, new=new)
    settle(trail, control)


def settle(trail: AuditTrail, control: Control) -> None:
    """Wait until all notes are written; a failure is a notice."""
    if problem := trail.settle():
        control.notice(Message("audit.not_logged", "not in the audit log: {problem}", problem=problem))


@contextmanager
def audit_failure(trail: AuditTrail, control: Control, what: str, *, subject: str) -> Iterator[None]:
    """Log that ``what`` was stopped or failed, with the reason, if the block raises an error."""
    try:
        yield
    except BaseException as error:
        by_a_person = isinstance(error, CancelledError | KeyboardInterrupt) and not isinstance(error, UnattendedError)
        how = "stopped" if by_a_person else "broken_off"
        audit_note(trail, control, f"{what}.{how}", subject=subject, new=str(error) or type(error).__name__)
        raise


def record_role(trail: AuditTrail, before: str, now: str) -> None:
    """Log that the user changed the role.

    Raises:
        AuditError: it cannot be logged.
    """
    trail.record("role.changed", old=before, new=now)


_MOST_TOML = 10_000_000
"""Number of bytes of a calibration that are read."""
LogFile = Annotated[Path | None, Option("--log", metavar="FILE", help="log file; default: the log of this computer")]


class VerifyLogPlan(Plan):
    """A log, and the heads that it must contain: those of ``files``, and those noted elsewhere."""

    files: Annotated[
        tuple[Path, ...],
        Option(argument=True, metavar="FILE...", help="sessions and calibrations whose heads the log must contain"),
    ] = ()
    log: LogFile = None
    heads: Annotated[
        tuple[str, ...], Option("--head", metavar="NUMBER:HASH", help="a head that was noted elsewhere")
    ] = ()
    after: Annotated[tuple[Path, ...], Option("--after", metavar="FILE", help="an earlier log that was moved")] = ()


class LogPlan(Plan):
    """A log and the number of its newest lines."""

    log: LogFile = None
    last: Annotated[int, Option("--last", metavar="N", help="number of lines"), Field(ge=1, le=1_000_000)] = 20


@dataclass(frozen=True)
class VerifiedLog:
    """The log ``path``, its verification, the number of its heads, and a remark for each file without a head."""

    path: Path
    result: Verification
    heads: int
    remarks: tuple[str, ...]


def verify_log(plan: VerifyLogPlan) -> VerifiedLog:
    """Verify a log line by line.

    Raises:
        UnusableInputError: there is no log, or a file is neither a session nor a calibration.
    """
    path = plan.log or default_path()
    heads = dict.fromkeys(plan.heads, "the head of --head")
    without = []
    for file in plan.files:
        if contained := _head_of(file):
            heads[contained] = str(file)
        else:
            without.append(Message("audit.no_head", "{path} contains no head of the log", path=str(file)))
    with _readable(path):
        result = verify(path, heads, after=plan.after)
    return VerifiedLog(path, result, len(heads), (*result.remarks, *without))


def newest_lines(plan: LogPlan) -> tuple[Path, Sequence[LogLine]]:
    """Return the path of a log and its newest lines, which are not verified.

    Raises:
        UnusableInputError: there is no log.
    """
    path = plan.log or default_path()
    with _readable(path):
        return path, last_lines(path, plan.last)


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
        raise UnusableInputError(
            "audit.no_calibration", "{path} is not a calibration of this software", path=str(path)
        ) from error
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
                "audit.log_removed",
                "the audit log {path} was removed or moved; its newest line had number {number}",
                path=str(path),
                number=newest[0],
            ) from error
        raise UnusableInputError(
            "audit.no_log",
            "there is no audit log {path}: nothing has been logged yet, or the log was moved",
            path=str(path),
        ) from error
