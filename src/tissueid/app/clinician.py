"""The clinician's functions: site, contact, repeats, comparison, and reports as page and as PDF."""

from __future__ import annotations

import functools
import threading
from collections.abc import Sequence
from pathlib import Path

from PySide6.QtCore import QObject, Signal

from tissueid.acquisition.playback import Phase
from tissueid.acquisition.surface_detection import Contact
from tissueid.app.context import AppContext
from tissueid.app.findings import Findings
from tissueid.app.guidance import Guidance, Watcher, contact_in_test
from tissueid.app.layout import Layout
from tissueid.app.live_signals import Snapshot
from tissueid.app.navigation_bar import MEASURE
from tissueid.app.notice import Notice
from tissueid.app.views.clinician.body_map import BodyMap
from tissueid.app.views.clinician.comparing import Shelf, SittingComparison, compare_with
from tissueid.app.views.clinician.sitting import (
    HEADS,
    QUANTITIES,
    VALUE_HEAD,
    Repeat,
    Sitting,
    Standing,
    repeat_of,
    standing,
)
from tissueid.atomic_write import unused_path
from tissueid.device import DeviceDescription
from tissueid.formatting import ANONYMOUS, label_and_unit, plus_minus
from tissueid.language import _, marked
from tissueid.messages import MISSING, Message, Verbatim, translated
from tissueid.procedures.saved_test import write_page, write_pdf
from tissueid.procedures.study_sitting import accept_sitting, reopen_sitting
from tissueid.procedures.test_plan import TestPlan
from tissueid.records import Estimate
from tissueid.sessions import Test
from tissueid.sessions.accepted_result import AcceptedResult, sitting_of
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
        for sighting in comparison.sightings:
            texts = [
                _text(sighting.values.get(name), display_unit(unit)[1])
                for name, (_, unit) in zip(QUANTITIES, names, strict=True)
            ]
            lines.append((f"{_(THIS)} {sighting.label}" if sighting.this else sighting.label, *texts))
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


def _text(estimate: Estimate | None, scale: float) -> str:
    return MISSING if estimate is None else plus_minus(estimate, scale)


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


class Clinician(QObject):
    """The clinician's functions of the page Measure."""

    test_wanted = Signal()
    """The next test of the sitting shall start."""
    findings_wanted = Signal(object)
    """Findings that shall be shown: those of the newest test of an accepted result."""

    def __init__(self, context: AppContext, ui: Layout, parent: QObject) -> None:
        super().__init__(parent)
        self._context, self._ui = context, ui
        self.body_map: BodyMap | None = None
        self.watcher = Watcher(context, ui.guidance.lamp, ui.form, ui.safety, ui.notice, self)
        self.sitting: Sitting | None = None
        self._reopened: Sitting | None = None
        self._shelf = Shelf()
        self._cancelled = threading.Event()
        self._comparison = SittingComparison()
        self._found: Findings | None = None
        self._by_hand = True  # what is accepted next
        self._accepted = False  # just now: what comes next is the report, once it is logged
        self._paper: Path | None = None  # written of what is shown just so
        context.state.cancelling.connect(self.cancel)
        ui.form.map.clicked.connect(self.open_map)
        ui.gate.repeats.again.connect(self.test_wanted)
        ui.gate.repeats.accepted.connect(self.accept)
        ui.gate.repeats.undone.connect(self.undo)
        ui.result.comparison.cancel.clicked.connect(self.cancel)
        ui.result.pdf.clicked.connect(self.write_pdf)
        ui.result.repeat_chosen.connect(self._show_repeat)

    # -- the window tells --------------------------------------------------------------------------------------

    def planned(self, plan: TestPlan, wanted: int, before: Sequence[Repeat] = ()) -> TestPlan:
        """Return the plan of the next test as a repeat of the current sitting or of a new one.

        A new one has ``wanted`` repeats after those that a visit has ``before`` it, whose key it takes.
        """
        if self.sitting is None or not self.sitting.continues(plan):
            self.sitting = Sitting(plan, repeats=list(before), wanted=wanted + len(before))
            if (key := sitting_of(before[-1].test) if before else None) is not None:
                self.sitting.key = key
        return self.sitting.planned(plan)

    @property
    def earlier(self) -> tuple[Test, ...]:
        """The tests of the sitting so far: the quality gate judges the next one against them."""
        return tuple(repeat.test for repeat in self.sitting.counting) if self.sitting is not None else ()

    def follow(self, snapshot: Snapshot, device: DeviceDescription | None) -> None:
        """Show the contact of a running test."""
        self._ui.guidance.lamp.quiet(snapshot.phase is Phase.RELEASE)
        if device is not None:
            self._ui.guidance.lamp.show_contact(contact_in_test(snapshot, device))

    def freed(self) -> None:
        """Handle the end of a test: the coil is released."""
        self._ui.guidance.lamp.quiet(False)
        self._ui.guidance.lamp.show_contact(Contact.UNWATCHED)

    def found(self, findings: Findings, plan: TestPlan | None, *, done: bool) -> None:
        """Handle an analysed test: the newest one of the sitting, or one of an opened file.

        ``done`` is whether a visit goes on elsewhere: what was measured so far is then the result.
        """
        sitting = self.sitting
        new = sitting is not None and plan is not None and findings.path == plan.out and not sitting.holds(plan.out)
        if sitting is not None and new:
            sitting.repeats.append(repeat_of(findings))
        elif findings.repeats and not self.holds(findings.path):
            key = sitting_of(findings.test) or ""
            repeats = list(map(repeat_of, findings.repeats))
            self._reopened = Sitting(None, key, repeats, wanted=sum(repeat.counts for repeat in repeats))
        self._found, self._comparison = findings, SittingComparison()
        self._show_sitting()
        if sitting is not None and new and done and sitting.counted:
            self._accept(sitting, by_hand=False)
        self._ui.result.comparison.clear()
        self._compare(findings)

    def holds(self, path: Path) -> bool:
        """Return whether a file is a test of a sitting that is held here: its other tests need not be read."""
        return any(sitting is not None and sitting.holds(path) for sitting in (self.sitting, self._reopened))

    def clear(self) -> None:
        """Forget the shown test: it is of another subject than the next one."""
        self._found, self._comparison, self._paper = None, SittingComparison(), None
        self._cancelled.set()
        self._ui.result.comparison.clear()

    def _show_sitting(self) -> None:
        """Show the progress and the result of the sitting of the shown test."""
        self._paper = None
        self._ui.gate.show_sitting(self._shown_sitting)
        self._ui.result.show_standing(self.standing)
        if (sitting := self._shown_sitting) is not None and self._found is not None and len(sitting.repeats) > 1:
            self._ui.result.offer_repeats([repeat.path for repeat in sitting.repeats], self._found.path)

    def _show_repeat(self, index: int) -> None:
        sitting = self._shown_sitting
        if sitting is not None and not self._context.busy and sitting.repeats[index].findings is not None:
            self.findings_wanted.emit(sitting.repeats[index].findings)

    @property
    def _shown_sitting(self) -> Sitting | None:
        """Return the current or the opened sitting if the shown test belongs to it."""
        shown = None if self._found is None else self._found.path
        for sitting in (self.sitting, self._reopened):
            if sitting is not None and shown is not None and sitting.holds(shown):
                return sitting
        return None

    @property
    def standing(self) -> Standing | None:
        """What stands as the result of the sitting of the shown test, in progress or read from its file."""
        if self._found is None:
            return None
        sitting = self._shown_sitting
        return standing(sitting, self._found.accepted if sitting is None else sitting.result, self._found)

    def update_enabled(self, *, busy: bool, testing: bool) -> None:
        """Enable what makes sense now."""
        ui = self._ui
        self.watcher.update_enabled(busy=busy, testing=testing)
        ui.start.setEnabled(not busy or (self.watcher.watching and not testing))
        ui.gate.repeats.update_enabled(busy=busy and not self.watcher.watching)
        ui.result.pdf.setEnabled(not busy)
        if self._accepted and not busy:
            self._accepted = False
            ui.result.pdf.setFocus()

    def cancel(self) -> None:
        """Cancel the comparison and the watch of the contact."""
        self._cancelled.set()
        self.watcher.cancel()

    # -- a person asks -----------------------------------------------------------------------------------------

    def open_map(self) -> None:
        """Show the body map, with the site of the form chosen."""
        window = self._ui.form.window()
        if self.body_map is None:
            self.body_map = BodyMap(window)
            self.body_map.chosen.connect(self._take_site)
        self.body_map.setPalette(window.palette())  # a window of its own: it would have the system's colours
        self.body_map.show_site(self._ui.form.site.currentText())

    def _take_site(self, site: str) -> None:
        form = self._ui.form
        form.site.setCurrentText(site)
        form.site.setFocus()
        form.go_on()

    def accept(self) -> None:
        """Accept the repeats so far as the result; the next test starts a new sitting."""
        sitting = self._shown_sitting
        if sitting is not None and not (self._context.busy or sitting.accepted) and sitting.counted:
            self._accept(sitting, by_hand=True)

    def _accept(self, sitting: Sitting, *, by_hand: bool) -> None:
        self._by_hand = by_hand
        work = functools.partial(accept_sitting, sitting.acceptance, sitting.as_result(), self._context.trail)
        self._context.jobs.do(work, self._finished, self._failed)

    def undo(self) -> None:
        """Continue a finished sitting."""
        context, sitting = self._context, self._shown_sitting
        if sitting is None or context.busy or sitting.result is None:
            return
        work = functools.partial(reopen_sitting, sitting.acceptance, sitting.result, context.trail)
        context.jobs.do(work, self._undone, self._failed)

    def write_pdf(self) -> None:
        """Write the shown result as PDF next to its session, and open it; what is written already is only opened."""
        if self._found is None or self._context.busy:
            return
        if self._paper is not None and self._paper.exists():
            self._context.show_file(self._paper)
            return
        work = functools.partial(write_paper, self._found, self.standing, self._comparison)
        self._ui.guidance.say(_("Writing the report."))
        self._context.jobs.do(work, self._written, self._failed)

    # -- jobs --------------------------------------------------------------------------------------------------

    def _compare(self, findings: Findings) -> None:
        if findings.session.subject.pseudonym in ("", ANONYMOUS) or not findings.analyses:
            return
        self._cancelled = threading.Event()
        self._ui.result.comparison.expect()
        work = functools.partial(
            compare_with,
            findings.path.parent,
            findings.session,
            findings.path,
            findings.test,
            self._shelf,
            self._cancelled,
        )
        why = _("Earlier sittings are being compared on Measure: cancel that there, or wait.")
        self._context.jobs.do(work, self._compared, self._not_compared, why=why)

    def _compared(self, comparison: SittingComparison) -> None:
        if self._found is None:
            return
        self._comparison, self._paper = comparison, None
        self._ui.result.comparison.show_comparison(comparison)
        self._ui.result.show_changes({name: translated(change) for name, change in comparison.changes.items()})

    def _not_compared(self, message: str) -> None:
        self._ui.result.comparison.clear()
        self._ui.notice.say(message, problem=True, page=MEASURE)

    def _finished(self, result: AcceptedResult) -> None:
        findings = self._found
        sitting = next(
            (
                candidate
                for candidate in (self.sitting, self._reopened)
                if candidate and candidate.key == result.sitting
            ),
            None,
        )
        if sitting is None:
            return
        sitting.result, self._accepted = result, self._by_hand
        newest = sitting.counting[-1].findings
        if newest is not None and (
            findings is None or not result.holds(findings.session.session_id, findings.test.number)
        ):
            self.findings_wanted.emit(newest)
        else:
            self._show_sitting()
        if result.count == 1:
            said = Message(
                "sitting.finished_test",
                "Finished: test {place} is the result. The next test begins a new sitting.",
                place=sitting.places[0],
            )
        else:
            said = Message(
                "sitting.finished_mean",
                "Finished: the mean of {count} repeats is the result. The next test begins a new sitting.",
                count=result.count,
            )
        say = self._ui.notice.say if self._by_hand else self._context.note
        say(translated(said))

    def _undone(self, _result: object) -> None:
        if (sitting := self._shown_sitting) is not None:
            sitting.result = None
        self._show_sitting()
        self._ui.notice.say(_("The sitting goes on: measure again, or finish it."))

    def _written(self, path: Path) -> None:
        self._paper = path
        self._context.show_idle()
        self._context.show_file(path)

    def _failed(self, message: str) -> None:
        self._context.show_idle()
        self._ui.notice.say(message, problem=True, page=MEASURE)
