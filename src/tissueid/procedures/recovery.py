"""Recovery of sessions whose host died: from their journals, with an entry in the audit log."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tissueid.atomic_write import open_regular
from tissueid.errors import TissueIDError
from tissueid.plan_options import Option, Plan
from tissueid.procedures.audit_queries import settle
from tissueid.procedures.control import Control

if TYPE_CHECKING:  # each takes long to import
    from tissueid.audit import AuditTrail
    from tissueid.sessions import Session


class RecoveryPlan(Plan):
    """Which session to recover, and where to."""

    path: Annotated[Path, Option(argument=True, metavar="PATH", help="name of the unfinished session, or its journal")]
    out: Annotated[
        Path | None, Option("--out", metavar="SESSION", help="session file to write; default: next to the journal")
    ] = None


@dataclass(frozen=True)
class RecoveredSession:
    """A recovered session, its file, and warnings about damage of the journal."""

    path: Path
    session: Session
    warnings: tuple[str, ...] = ()


def run_recovery(plan: RecoveryPlan, control: Control, trail: AuditTrail) -> RecoveredSession:
    """Make the session of a journal and log it. All warnings are notices too.

    Raises:
        UnusableInputError: there is nothing to recover.
        JournalError: the test still runs.
        OSError: the session cannot be written; the journal stays as it was.
    """
    from tissueid.acquisition.recovery import recover

    warnings: list[str] = []
    path, session = recover(plan.path, plan.out, trail=trail, report=warnings.append)
    settle(trail, control)
    for warning in warnings:
        control.notice(warning)
    return RecoveredSession(path, session, tuple(warnings))


def unfinished_journals(folder: Path) -> list[Path]:
    """Return the journals of unfinished tests in a folder, without those of running tests."""
    from tissueid.acquisition.journal import JournalError, lock

    found = []
    for path in sorted(folder.glob("*.journal")):
        try:
            with open_regular(path) as file:
                lock(file)
        except (OSError, JournalError):
            continue
        found.append(path)
    return found


def recover_folder(
    folder: Path, control: Control, trail: AuditTrail
) -> tuple[list[RecoveredSession], list[TissueIDError | OSError]]:
    """Recover all unfinished sessions of a folder. A journal that fails does not prevent the others.

    Returns:
        The recovered sessions, and the errors of the others.
    """
    recovered: list[RecoveredSession] = []
    errors: list[TissueIDError | OSError] = []
    for journal in unfinished_journals(folder):
        try:
            recovered.append(run_recovery(RecoveryPlan(path=journal), control, trail))
        except (TissueIDError, OSError) as error:
            errors.append(error)
    return recovered, errors
