"""Report of a session: one self-contained HTML page without scripts or external files."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup

from tissueid.analysis import Analysis
from tissueid.atomic_write import atomic_file
from tissueid.device import SIMULATED_LINE
from tissueid.errors import UnusableInputError
from tissueid.formatting import clean
from tissueid.language import _, current_language, marked
from tissueid.messages import Message, translated
from tissueid.reports.page import test_page
from tissueid.reports.tables import Comparison, comparison_table, readable_date, settings_tables
from tissueid.sessions import Session

RESEARCH_LINE = marked("Research use only. Not a medical device; not for diagnosis or treatment.")
NOTHING_ANALYSED = Message("report.nothing_analysed", "there is nothing to report: no test was analysed")


def report_html(
    session: Session,
    analyses: Mapping[int, Mapping[str, Analysis]],
    *,
    comparison: Comparison | None = None,
    title: str | None = None,
    refused: Mapping[str, str] | None = None,
) -> str:
    """Return the report as HTML text.

    Args:
        session: the session.
        analyses: analyses by test number and engine name. The first test is the main one; the others get a shorter
            section.
        comparison: estimates of a small-amplitude test and the known values of a simulated plant.
        title: heading of the page; the site of the main test by default.
        refused: engines that could not use the main test, and why.

    Raises:
        UnusableInputError: nothing was analysed, or the session lacks one of the tests.
    """
    tests = [(number, engines) for number, engines in analyses.items() if engines]
    if not tests:
        raise UnusableInputError(NOTHING_ANALYSED)
    pages = [
        test_page(session, number, engines, full=place == 0, refused=refused or {})
        for place, (number, engines) in enumerate(tests)
    ]
    number, engines = tests[0]
    main = session.test(number)
    return template("report.html.j2").render(
        title=title or (main.site[:1].upper() + main.site[1:]) or _("Tissue measurement"),
        research_line=_(RESEARCH_LINE),
        simulated_line=_(SIMULATED_LINE),
        session=session,
        date=readable_date(session.created),
        main=pages[0],
        others=pages[1:],
        comparison=None if comparison is None else comparison_table(comparison),
        settings=settings_tables(session, main, engines),
    )


def write_report(
    path: Path,
    session: Session,
    analyses: Mapping[int, Mapping[str, Analysis]],
    *,
    comparison: Comparison | None = None,
    title: str | None = None,
    refused: Mapping[str, str] | None = None,
) -> None:
    """Write the report atomically; arguments and errors as :func:`report_html`.

    Raises:
        OSError: the folder is missing, or the disk is full or not writable; nothing is left behind.
    """
    write_text_atomically(path, report_html(session, analyses, comparison=comparison, title=title, refused=refused))


def write_text_atomically(path: Path, text: str) -> None:
    """Write a text file atomically.

    Raises:
        OSError: the folder is missing, or the disk is full or not writable; nothing is left behind.
    """
    with atomic_file(path) as partial:
        partial.write_text(text, encoding="utf-8", newline="\n")


@cache
def template(name: str) -> Template:
    """Return the template of a page. It escapes all values and raises an error for an unknown one."""
    environment = Environment(
        loader=PackageLoader("tissueid.reports"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_without_control_characters,
    )
    environment.filters["svg"] = Markup
    environment.globals |= {"_": _, "translated": translated, "language": current_language}
    return environment.get_template(name)


def _without_control_characters(value: Any) -> Any:
    return clean(value) if type(value) is str else value
