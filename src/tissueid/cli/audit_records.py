"""Audit records of commands."""

from __future__ import annotations

import os
from typing import Any

from tissueid.audit import ROLE_ENVIRONMENT, ROLES, AuditLog, AuditTrail, Role, active_role, default_path
from tissueid.cli.output import console
from tissueid.errors import UnusableInputError


def set_role(role: str) -> None:
    """Set the user role of this command and of the processes that it starts.

    Raises:
        UnusableInputError: the role is unknown.
    """
    if role.strip().lower() not in ROLES:
        raise UnusableInputError(f"--role must be {' or '.join(ROLES)}, got {role!r}")
    os.environ[ROLE_ENVIRONMENT] = role


def audit_trail(role: Role = "researcher") -> AuditTrail:
    """Return a trail of this command in the audit log; ``TISSUEID_ROLE`` overrides ``role``.

    Raises:
        UnusableInputError: ``TISSUEID_ROLE`` is not a role.
    """
    return AuditTrail(AuditLog(default_path()), active_role(role))


def audit_record(role: Role, what: str, *, subject: str = "", old: Any = None, new: Any = None) -> str:
    """Log an operation before it begins, and return the head of the log for the file that is made.

    Raises:
        AuditError: the log cannot be written; the operation must not begin.
    """
    own = audit_trail(role)
    own.record(what, subject=subject, old=old, new=new)
    return own.head


def audit_note(role: Role, what: str, *, subject: str = "", old: Any = None, new: Any = None) -> str:
    """Log a finished operation and return the head of the log; a failure is printed on standard error."""
    own = audit_trail(role)
    own.note(what, subject=subject, old=old, new=new)
    print_audit_problems(own)
    return own.head


def print_audit_problems(own: AuditTrail) -> None:
    """Print on standard error what could not be logged."""
    if problem := own.settle():
        console.print(f"not in the audit log: {problem}", markup=False, soft_wrap=True)
