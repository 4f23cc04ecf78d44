"""``tissueid report``."""

from __future__ import annotations

from pathlib import Path

from tissueid.analysis import REPORT_ENGINES, analyse_all
from tissueid.cli.output import check_output, people_read
from tissueid.errors import UnusableInputError
from tissueid.reports import write_report
from tissueid.sessions import read_session


def run_report(path: Path, out: Path, test: int | None, engines: str | None = None) -> None:
    """Analyse one test with the standard engines, or with those named, and write its page."""
    check_output(out, ("<!DOCTYPE html",))
    session = read_session(path)
    chosen = session.test(test)
    names = REPORT_ENGINES if engines is None else [name.strip() for name in engines.split(",") if name.strip()]
    analyses = analyse_all(session, dict.fromkeys(names), test=chosen)
    try:
        write_report(out, session, {chosen.number: analyses})
    except OSError as error:
        raise UnusableInputError(f"cannot write {out}: {error.strerror}") from error
    which = f", test {chosen.number} of {len(session.tests)}" if len(session.tests) > 1 else ""
    people_read(None).print(f"report: {out}{which}", markup=False)
