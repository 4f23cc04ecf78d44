"""Acceptance of the result of a sitting, and its withdrawal: the audit log first, then the result files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from tissueid.audit import AuditTrail
from tissueid.plan_options import Plan

if TYPE_CHECKING:  # it takes long to import
    from tissueid.sessions.accepted_result import AcceptedResult


class SittingPlan(Plan):
    """A sitting: its key, the folders that hold one of its tests, and the number of its tests."""

    key: str
    folders: tuple[Path, ...]
    tests: Annotated[int, Field(ge=0)]


def accept_sitting(plan: SittingPlan, result: AcceptedResult, trail: AuditTrail) -> AcceptedResult:
    """Log and store the accepted result of a sitting in each of its folders; return it.

    Raises:
        AuditError: it cannot be logged; no file is written.
        OSError: it cannot be written; the log says that the sitting goes on.
    """
    from tissueid.sessions.accepted_result import write_result

    trail.record("sitting.accepted", subject=plan.key, new=_logged(plan, result))
    try:
        for folder in plan.folders:
            write_result(folder, result)
    except OSError as error:
        reopen_sitting(plan, result, trail, why=f"the result file cannot be written: {error.strerror or error}")
        raise
    return result


def reopen_sitting(plan: SittingPlan, result: AcceptedResult, trail: AuditTrail, why: str = "by hand") -> None:
    """Log that an accepted sitting goes on, and remove its result files.

    Raises:
        AuditError: it cannot be logged; the files stay.
        OSError: a file cannot be removed.
    """
    from tissueid.sessions.accepted_result import withdraw_result

    trail.record("sitting.reopened", subject=plan.key, old=_logged(plan, result), new={"why": why})
    for folder in plan.folders:
        withdraw_result(folder, plan.key)


def _logged(plan: SittingPlan, result: AcceptedResult) -> dict[str, object]:
    """Return what the log keeps of a result: how many tests count of how many, which, and the values, SI."""
    return {
        "repeats": result.count,
        "tests": plan.tests,
        "accepted": [test.model_dump() for test in result.tests],
        "values": {name: value.model_dump(exclude_none=True) for name, value in result.values.items()},
    }
