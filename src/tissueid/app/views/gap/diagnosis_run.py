"""Run a diagnosis outside the GUI thread, and make the result that the page shows and stores."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

from tissueid.app.user_files import Stamp, stamp_of
from tissueid.app.views.gap.diagnosis_result import DiagnosisResult
from tissueid.app.views.gap.page_content import PageContent
from tissueid.procedures.control import Control
from tissueid.procedures.gap_plans import DiagnosisPlan
from tissueid.stored_values import finite

if TYPE_CHECKING:
    from tissueid.gap.diagnosis import Diagnosis
    from tissueid.procedures.diagnosis import DiagnosedSession
    from tissueid.sessions import Session


def run_diagnosis(plan: DiagnosisPlan, control: Control, *, separate_process: bool) -> DiagnosisResult:
    """Diagnose a session, in other processes if ``separate_process`` is true.

    Raises:
        UnusableInputError: the session, the twin or the numbers of tests cannot be used.
        CancelledError: it was cancelled.
    """
    from tissueid.procedures.separate_process import run_in_process

    if separate_process:
        return run_in_process(functools.partial(_diagnosed, plan), control)
    return _diagnosed(plan.model_copy(update={"workers": 1}), control)


def _diagnosed(plan: DiagnosisPlan, control: Control) -> DiagnosisResult:
    # Imported here and not above: the window should not wait for what only this needs.
    from tissueid.procedures.diagnosis import diagnose_session

    stamp = stamp_of(plan.session)
    return result_of(diagnose_session(plan, control), stamp)


def result_of(diagnosed: DiagnosedSession, stamp: Stamp | None = None) -> DiagnosisResult:
    """Return the values of a diagnosis that the page shows and stores, without its records.

    Args:
        diagnosed: the diagnosis.
        stamp: of the session file, from before it was read.
    """
    from tissueid.gap import as_answer

    found, session, named = diagnosed.found, diagnosed.session, diagnosed.named
    return DiagnosisResult(
        diagnosed.plan,
        session.session_id,
        found.dataset.instrument,
        diagnosed.twin,
        page_content_of(found, session),
        finite(as_answer(found)),
        diagnosed.report_html,
        named.twin,
        named.refused,
        stamp,
    )


def page_content_of(found: Diagnosis, session: Session) -> PageContent:
    """Return the content of the page for a diagnosis."""
    from tissueid.app.views.gap.next_test import proposal_of
    from tissueid.gap.answer import content_of

    return PageContent(**vars(content_of(found)), proposal=proposal_of(found, session))
