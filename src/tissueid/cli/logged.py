"""The audit log as commands use it."""

from __future__ import annotations

import os
from typing import Any

from tissueid.audit import ROLE_ENVIRONMENT, AuditLog, Role, Trail, default_path, role_in_force
from tissueid.cli.output import console


def take_role(role: str) -> None:
    """This command, and whatever it starts, is run in a role.

    Raises:
        UnusableInputError: there is no such role.
    """
    os.environ[ROLE_ENVIRONMENT] = role
    role_in_force("researcher")


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


def tell(own: Trail) -> None:
    """Say on standard error what could not be logged."""
    if problem := own.settle():
        console.print(f"not in the audit log: {problem}", markup=False, soft_wrap=True)
