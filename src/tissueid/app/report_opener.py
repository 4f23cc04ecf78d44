"""The report of the shown result: write it next to its session once, open it, and show its path."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path

from PySide6.QtCore import QObject

from tissueid.app.context import AppContext
from tissueid.app.findings import Findings
from tissueid.app.guidance import Guidance
from tissueid.app.notice import Notice
from tissueid.app.views.clinician.comparing import SittingComparison
from tissueid.app.views.clinician.sitting import HEADS, QUANTITIES, VALUE_HEAD, Standing
from tissueid.atomic_write import unused_path
from tissueid.formatting import label_and_unit, plus_minus
from tissueid.language import _, marked
from tissueid.messages import MISSING, Message, Verbatim, translated
from tissueid.procedures.saved_test import write_page, write_pdf
from tissueid.records import Estimate
from tissueid.units import display_unit

THIS = marked("This:")
"""What stands before the label of the sitting of the shown test: what follows may be cut off, this not."""
Table = tuple[str, Sequence[str], Sequence[Sequence[str]]]


def write_paper(findings: Findings, standing: Standing | None, comparison: SittingComparison) -> Path:
    """Write the PDF of a test under an unused name; return its path.

    Raises:
        UnusableInputError: nothing could be identified, or it cannot be written.
    """
    path = unused_path(findings.path.with_name(f"{findings.path.stem}-report.pdf"))
    further: list[Table] = []
    if len(comparison.sightings) > 1:
        names = [label_and_unit(name) for name in QUANTITIES]
        columns = (_("Sitting"), *(f"{_(name)} ({display_unit(unit)[0]})" for name, unit in names))
        lines = []
        for one in comparison.sightings:
            texts = [
                _text(one.values.get(name), display_unit(unit)[1])
                for name, (_, unit) in zip(QUANTITIES, names, strict=True)
            ]
            lines.append((f"{_(THIS)} {one.label}" if one.this else one.label, *texts))
        heading = _("The subject's other sites and sittings")
        if comparison.remark:
            heading = _("The subject's other sites and sittings († another instrument)")
        further.append((heading, columns, lines))
    result = None if standing is None else _result(standing)
    return write_pdf(path, findings.analysed, result, further)


def _result(standing: Standing) -> tuple[Table, tuple[str, ...]]:
    """What stands as the result, as a table, and the lines below it."""
    repeated = any(value.count > 1 for value in standing.values.values())
    heads = [_(head) if head else "" for head in (HEADS if repeated else ("", VALUE_HEAD))]
    rows = [row[: len(heads)] for row in standing.rows().values()]
    return (standing.heading, heads, rows), tuple(filter(None, [standing.tests, standing.remark]))


def _text(found: Estimate | None, scale: float) -> str:
    return MISSING if found is None else plus_minus(found, scale)


def _shown(path: Path, *, opened: bool) -> Message:
    """Return where the report is, and what to do if no program opened it."""
    if opened:
        return Message("report.saved", "The report is saved in {path}.", path=Verbatim(path))
    if path.suffix.lower() == ".pdf":
        return Message(
            "report.no_pdf_viewer",
            "The report is saved in {path}. No program here shows a PDF: open that file with one that does, here or on "
            "another computer.",
            path=Verbatim(path),
        )
    return Message("report.no_browser", "The report is saved in {path}; open it in a browser.", path=Verbatim(path))


class Reports(QObject):
    """Writes and opens reports for the window and its pages."""

    def __init__(self, context: AppContext, notice: Notice, guidance: Guidance, parent: QObject) -> None:
        super().__init__(parent)
        self._context, self._notice, self._guidance = context, notice, guidance
        self._findings: Findings | None = None
        self._written: Path | None = None

    def show_findings(self, findings: Findings | None) -> None:
        """Take the result that is shown now; its report is not written yet."""
        self._findings, self._written = findings, None

    def open(self) -> None:
        """Write the report of the shown result next to its session, and open it."""
        if self._findings is None or self._context.busy:
            return
        if self._written is not None and self._written.exists():
            self.show(self._written)
            return
        self._guidance.say(_("Writing the report."))
        self._context.jobs.do(functools.partial(_written, self._findings), self._show_written, self._context.say_failed)

    def show(self, path: Path) -> None:
        """Open a report and show its path."""
        said = _shown(path, opened=self._context.services.show_file(path))
        show_folder = functools.partial(self._context.services.show_file, path.parent)
        self._notice.say(translated(said), offer=_("Open folder"), act=show_folder)

    def _show_written(self, path: Path) -> None:
        self._written = path
        self._context.show_idle()
        self.show(path)


def _written(findings: Findings) -> Path:
    """Write the page of a test next to its session under an unused name; return its path."""
    page = unused_path(findings.path.with_name(f"{findings.path.stem}-report.html"))
    return write_page(page, findings.analysed)
