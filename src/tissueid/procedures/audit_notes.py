"""Entries of a procedure in the audit log."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from tissueid.audit import AuditTrail
from tissueid.errors import CancelledError, UnattendedError
from tissueid.messages import Message
from tissueid.procedures.control import Control

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
