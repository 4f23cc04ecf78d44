"""``tissueid report``: write the report of a test."""

from __future__ import annotations

from pathlib import Path

from tissueid.analysis import Analysis, analyse_all
from tissueid.cli.output import human_output
from tissueid.errors import UnusableInputError
from tissueid.identification import get_engine, report_engines
from tissueid.procedures.output_files import check_output, check_report
from tissueid.reports import write_report
from tissueid.reports.pdf import write_pdf
from tissueid.sessions import read_session


def run_report(path: Path, out: Path, test: int | None, engines: str | None = None, pdf: Path | None = None) -> None:
    """Analyse one test with the standard or the given engines, and write its page and optionally a short PDF.

    An engine that cannot use the test is left out, and the page gives the reason.

    Raises:
        UnusableInputError: the test or an engine is unknown, no engine can use the test, or a file cannot be written.
    """
    check_output(out, ("<!DOCTYPE html",))
    check_output(pdf, ("%PDF",))
    session = read_session(path)
    for target in (out, pdf):
        check_report(target, session)
    chosen = session.test(test)
    names = report_engines() if engines is None else [name.strip() for name in engines.split(",") if name.strip()]
    analyses: dict[str, Analysis] = {}
    refused: dict[str, str] = {}
    for name in dict.fromkeys(names):
        get_engine(name)
        try:
            analyses |= analyse_all(session, (name,), test=chosen)
        except UnusableInputError as error:  # the other engines can still be reported
            refused[name] = error.message
    if not analyses and refused:
        raise UnusableInputError(next(iter(refused.values())))
    try:
        write_report(out, session, {chosen.number: analyses}, refused=refused)
    except OSError as error:
        raise UnusableInputError(f"cannot write {out}: {error.strerror}") from error
    if pdf is not None:
        try:
            write_pdf(pdf, session, chosen, analyses)
        except OSError as error:
            raise UnusableInputError(f"cannot write {pdf}: {error.strerror}") from error
    which = f", test {chosen.number} of {len(session.tests)}" if len(session.tests) > 1 else ""
    human_output(None).print(f"report: {out}{which}", markup=False)
    if pdf is not None:
        human_output(None).print(f"report: {pdf}{which}", markup=False)
    for name, why in refused.items():
        human_output(None).print(f"without {name}: {why}", markup=False, soft_wrap=True)
