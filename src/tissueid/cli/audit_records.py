"""Audit records of commands."""

from __future__ import annotations

import os

from tissueid.audit import ROLE_ENVIRONMENT, ROLES, AuditLog, AuditTrail, Role, active_role, default_path
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
