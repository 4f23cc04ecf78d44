"""``tissueid report``."""

from __future__ import annotations

from pathlib import Path

from tissueid.analysis import REPORT_ENGINES, Analysis, analyse_all
from tissueid.cli.output import check_output, check_report, people_read
from tissueid.errors import UnusableInputError
from tissueid.identification import get_engine
from tissueid.reports import write_report
from tissueid.reports.pdf import write_pdf
from tissueid.sessions import read_session


def run_report(path: Path, out: Path, test: int | None, engines: str | None = None, pdf: Path | None = None) -> None:
    """Analyse one test with the standard engines, or with those named, and write its page, and a short PDF if asked.

    An engine that cannot use the test is left out, and the page says why.

    Raises:
        UnusableInputError: no such test or engine, none that can use it, or the page cannot be written.
    """
    check_output(out, ("<!DOCTYPE html",))
    check_output(pdf, ("%PDF",))
    session = read_session(path)
    for target in (out, pdf):
        check_report(target, session)
    chosen = session.test(test)
    names = REPORT_ENGINES if engines is None else [name.strip() for name in engines.split(",") if name.strip()]
    analyses: dict[str, Analysis] = {}
    refused: dict[str, str] = {}
    for name in dict.fromkeys(names):
        get_engine(name)
        try:
            analyses |= analyse_all(session, (name,), test=chosen)
        except UnusableInputError as error:  # it costs its own figures only
            refused[name] = str(error)
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
    people_read(None).print(f"report: {out}{which}", markup=False)
    if pdf is not None:
        people_read(None).print(f"report: {pdf}{which}", markup=False)
    for name, why in refused.items():
        people_read(None).print(f"without {name}: {why}", markup=False, soft_wrap=True)
