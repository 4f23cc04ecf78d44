"""The audit log as commands use it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from tissueid.audit import ROLE_ENVIRONMENT, ROLES, AuditLog, Role, Trail, default_path, role_in_force
from tissueid.cli.output import console
from tissueid.errors import CancelledError, UnusableInputError


def take_role(role: str) -> None:
    """This command, and whatever it starts, is run in a role.

    Raises:
        UnusableInputError: there is no such role.
    """
    if role.strip().lower() not in ROLES:
        raise UnusableInputError(f"--role is {' or '.join(ROLES)}, not {role!r}")
    os.environ[ROLE_ENVIRONMENT] = role


def trail(role: Role = "researcher") -> Trail:
    """A trail of this command in the computer's log; ``role`` where ``TISSUEID_ROLE`` names no other.

    Raises:
        UnusableInputError: it names none.
    """
    return Trail(AuditLog(default_path()), role_in_force(role))


def logged(role: Role, what: str, *, subject: str = "", old: Any = None, new: Any = None) -> str:
    """Log what is about to begin; returns the head, for a file that is made.

    Raises:
        AuditError: it cannot be logged, and must not begin.
    """
    own = trail(role)
    own.record(what, subject=subject, old=old, new=new)
    return own.head


def noted(role: Role, what: str, *, subject: str = "", old: Any = None, new: Any = None) -> str:
    """Log what has happened; where that fails, it is said on standard error. Returns the head, or nothing."""
    own = trail(role)
    own.note(what, subject=subject, old=old, new=new)
    tell(own)
    return own.head


@contextmanager
def end_noted(role: Role, what: str, *, subject: str) -> Iterator[None]:
    """Log that ``what`` was stopped, or broke off, and why, where the block does not come to its end."""
    try:
        yield
    except BaseException as error:
        how = "stopped" if isinstance(error, CancelledError | KeyboardInterrupt) else "broken_off"
        noted(role, f"{what}.{how}", subject=subject, new=str(error) or type(error).__name__)
        raise


def tell(own: Trail) -> None:
    """Say on standard error what could not be logged."""
    if problem := own.settle():
        console.print(f"not in the audit log: {problem}", markup=False, soft_wrap=True)
