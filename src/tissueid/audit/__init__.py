"""Audit log: who did what and when, with old and new values. Append-only, each line linked to the one before."""

from tissueid.audit.line import HEAD_ATTRIBUTE, LogLine
from tissueid.audit.log import (
    ENVIRONMENT,
    ROLE_ENVIRONMENT,
    ROLES,
    AuditError,
    AuditLog,
    AuditTrail,
    Role,
    active_role,
    default_path,
)
from tissueid.audit.verification import Broken, LogDamage, Verification, check_head, last_lines, verify

__all__ = [
    "ENVIRONMENT",
    "HEAD_ATTRIBUTE",
    "ROLES",
    "ROLE_ENVIRONMENT",
    "AuditError",
    "AuditLog",
    "AuditTrail",
    "Broken",
    "LogDamage",
    "LogLine",
    "Role",
    "Verification",
    "active_role",
    "check_head",
    "default_path",
    "last_lines",
    "verify",
]
