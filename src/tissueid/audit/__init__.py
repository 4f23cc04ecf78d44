"""The audit log: who did what when, and what it was before; only ever added to, each line bound to the one before."""

from tissueid.audit.line import HEAD_ATTRIBUTE, Line
from tissueid.audit.log import ENVIRONMENT, AuditError, AuditLog, default_path
from tissueid.audit.trail import ROLE_ENVIRONMENT, ROLES, Role, Trail, role_in_force
from tissueid.audit.verification import Broken, Damage, Verification, check_head, last_lines, verify

__all__ = [
    "ENVIRONMENT",
    "HEAD_ATTRIBUTE",
    "ROLES",
    "ROLE_ENVIRONMENT",
    "AuditError",
    "AuditLog",
    "Broken",
    "Damage",
    "Line",
    "Role",
    "Trail",
    "Verification",
    "check_head",
    "default_path",
    "last_lines",
    "role_in_force",
    "verify",
]
