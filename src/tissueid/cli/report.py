"""``tissueid report``."""

from __future__ import annotations

from pathlib import Path

from tissueid.analysis import analyse_all
from tissueid.cli.output import console
from tissueid.errors import UnusableInputError
from tissueid.reports import write_report
from tissueid.sessions import read_session


def run_report(path: Path, out: Path, test: int | None) -> None:
    """Analyse one test with the standard engines and write its page."""
    if not out.parent.is_dir():
        raise UnusableInputError(f"there is no folder {out.parent}")
    session = read_session(path)
    chosen = session.test(test)
    write_report(out, session, {chosen.number: analyse_all(session, test=chosen)})
    console.print(f"report: {out}", markup=False)
