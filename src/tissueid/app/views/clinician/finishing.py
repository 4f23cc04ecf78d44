"""Finishing a sitting and taking that back: audit log first, then the result file. Independent of Qt."""

from __future__ import annotations

from tissueid.app.views.clinician.sitting import Sitting
from tissueid.audit import AuditTrail
from tissueid.sessions.accepted_result import AcceptedResult, withdraw_result, write_result


def finish(sitting: Sitting, result: AcceptedResult, trail: AuditTrail) -> AcceptedResult:
    """Log and store the accepted result of a sitting, in every folder that holds one of its tests; return it.

    Raises:
        AuditError: it cannot be logged; no file is written.
        OSError: it cannot be written; the log says that the sitting goes on.
    """
    trail.record("sitting.accepted", subject=sitting.key, new=logged(result, sitting))
    try:
        for folder in sitting.folders:
            write_result(folder, result)
    except OSError as error:
        undo(sitting, result, trail, why=f"the result file cannot be written: {error.strerror or error}")
        raise
    return result


def undo(sitting: Sitting, result: AcceptedResult, trail: AuditTrail, why: str = "by hand") -> None:
    """Log that a finished sitting goes on, and remove its result files.

    Raises:
        AuditError: it cannot be logged; the files stay.
        OSError: a file cannot be removed.
    """
    trail.record("sitting.reopened", subject=sitting.key, old=logged(result, sitting), new={"why": why})
    for folder in sitting.folders:
        withdraw_result(folder, sitting.key)


def logged(result: AcceptedResult, sitting: Sitting) -> dict[str, object]:
    """What the audit log keeps of an accepted result: how many tests count of how many, which, and the values, SI."""
    return {
        "repeats": result.count,
        "tests": len(sitting.repeats),
        "accepted": [test.model_dump() for test in result.tests],
        "values": {name: value.model_dump(exclude_none=True) for name, value in result.values.items()},
    }
