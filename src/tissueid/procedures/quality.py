"""Quality of the tests of a saved session, by the current rules."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tissueid.plan_options import Option, Plan

if TYPE_CHECKING:  # each takes long to import
    from tissueid.acquisition.quality import Quality
    from tissueid.sessions import Session, Test


class QualityPlan(Plan):
    """A session, and the number of one of its tests; None for all."""

    session: Annotated[Path, Option(argument=True, metavar="SESSION", help="session file")]
    test: Annotated[int | None, Option("--test", metavar="N", help="one test; default: all")] = None


@dataclass(frozen=True)
class JudgedSession:
    """A session and its judged tests, in their order."""

    session: Session
    tests: tuple[tuple[Test, Quality], ...]


def judge_tests(plan: QualityPlan) -> JudgedSession:
    """Judge the tests of a session; the file is not changed.

    Raises:
        UnusableInputError: the file is not a session, or does not contain the test.
    """
    from tissueid.acquisition.quality import judge_session
    from tissueid.sessions import read_session

    session = read_session(plan.session)
    chosen = session.test(plan.test).number if plan.test is not None or not session.tests else None
    judged = tuple((test, found) for test, found in judge_session(session) if chosen in (None, test.number))
    return JudgedSession(session, judged)
