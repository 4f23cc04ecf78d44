"""The page ``research``: sessions on the left; signals and analyses of the selected tests on the right."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from PySide6.QtCore import QByteArray, Qt
from PySide6.QtWidgets import (
    QAbstractButton,
    QMenu,
    QPushButton,
    QToolButton,
    QWidget,
)

from tissueid.app import build
from tissueid.app.context import AppContext, View
from tissueid.app.views.researcher.analysis import AnalysisPanel
from tissueid.app.views.researcher.background_work import BackgroundWork, ProgressStrip
from tissueid.app.views.researcher.browser import Browser
from tissueid.app.views.researcher.selected_test import SelectedTest
from tissueid.app.views.researcher.signals import SignalsPanel
from tissueid.app.words import in_words, sentence
from tissueid.atomic_write import unused_path
from tissueid.audit import AuditTrail
from tissueid.errors import CancelledError, TissueIDError
from tissueid.language import _, marked
from tissueid.messages import translated
from tissueid.procedures.import_export import ExportPlan, run_export

EXPORTS = {"csv": marked("CSV tables"), "mat": marked("MATLAB files"), "parquet": marked("Parquet tables")}


class SessionExport(BackgroundWork):
    """Writes a folder per session in ``folder``; a failing session is skipped."""

    def __init__(self, chosen: Sequence[SelectedTest], folder: Path, kind: str, trail: AuditTrail) -> None:
        super().__init__(_("Exporting"))
        self.written: list[Path] = []
        self.problems: list[str] = []
        self._folder = folder
        self._kind = kind
        self._trail = trail
        self._tests: dict[Path, list[int]] = {}
        for test in chosen:
            self._tests.setdefault(test.path, []).append(test.number)

    def run(self) -> SessionExport:
        """Export the sessions; a cancelled one leaves no files."""
        for done, (path, numbers) in enumerate(self._tests.items()):
            self._begun = done / len(self._tests)
            try:
                self._export(path, numbers)
            except CancelledError:
                break  # what is written stays
            except (TissueIDError, OSError) as error:
                self.problems.append(in_words(error))
        self.problems += [sentence(translated(notice)) for notice in self.notices]
        return self

    @property
    def words_after(self) -> str:
        """Notice after the export."""
        count = len(self.written)
        said = []
        if count == 1:
            said.append(_("Exported into {path}.").format(path=self.written[0]))
        elif count:
            said.append(
                _("Exported {count} sessions into folders in {folder}.").format(count=count, folder=self._folder)
            )
        if self.cancelled():
            said.append(_("The export was stopped; the other sessions are not exported."))
        return " ".join([*said, *dict.fromkeys(self.problems)])

    def _export(self, path: Path, numbers: Sequence[int]) -> None:
        self.check()
        folder = unused_path(self._folder / f"{path.stem}-{self._kind}", separator="-")
        plan = ExportPlan(session=path, out=folder, kind=self._kind, tests=tuple(numbers))
        run_export(plan, self, self._trail)
        self.written.append(folder)

    def progress(self, fraction: float | None, step: str) -> None:
        """Keep the completed share of all sessions."""
        super().progress(self._begun + (fraction or 0.0) / len(self._tests), step)


class ExportButton(QPushButton):
    """Export button; ``chosen`` returns the selected tests."""

    def __init__(
        self,
        context: AppContext,
        strip: ProgressStrip,
        chosen: Callable[[], Sequence[SelectedTest]],
        parent: QWidget | None = None,
    ) -> None:
        super().__init__(_("Export data"), parent)
        self._context = context
        self._strip = strip
        self._chosen = chosen
        self._busy = False
        build.styled(
            self, tip=_("The selected tests as files for other programs, a folder a session"), menu=QMenu(self)
        )
        for kind, title in EXPORTS.items():
            self.menu().addAction(f"{_(title)}…", partial(self._choose, kind))
        self.update_enabled(busy=False)

    def update_enabled(self, *, busy: bool) -> None:
        """Enable the button if tests are selected and no job runs."""
        self._busy = busy
        self.setEnabled(not busy and bool(self._chosen()))

    def selection_changed(self) -> None:
        """Update the button after a change of the selection."""
        self.update_enabled(busy=self._busy)

    def _choose(self, kind: str) -> None:
        chosen = list(self._chosen())
        if not chosen:
            return
        title, export = _("Export into a new folder in"), partial(self._export, chosen, kind)
        build.ask_path(self.window(), title, chosen[0].path.parent, export)

    def _export(self, chosen: Sequence[SelectedTest], kind: str, folder: Path) -> None:
        if self._context.busy:
            self._context.say(_("Not exported: other work is running. Try again."), problem=True)
            return
        export = SessionExport(chosen, folder, kind, self._context.trail)
        self._strip.watch(export)
        self._context.jobs.do(export.run, self._exported, self._failed)

    def _exported(self, export: SessionExport) -> None:
        self._strip.clear()
        self._context.say(export.words_after, problem=bool(export.problems))

    def _failed(self, message: str) -> None:
        self._strip.clear()
        self._context.say(message, problem=True)


_SPLIT, _TAB, _FOLDED = "research/split", "research/tab", "research/list-folded"
_WIDTHS = (300, 700)


class ResearchView(View):
    """Browser and panels. Starts waiting work, one job at a time."""

    name = "research"

    def __init__(self, context: AppContext, parent: QWidget | None = None) -> None:
        super().__init__(context, parent)
        self._to_open: Path | None = None
        self._testing = False
        self._over = False
        self.strip = ProgressStrip()
        self.browser = Browser(context, self.strip)
        self.export = ExportButton(context, self.strip, self.browser.chosen)
        self.browser.foot.addWidget(self.export)
        self.signals = SignalsPanel(context, self.strip)
        self.analysis = AnalysisPanel(context)
        pages = (self.signals, _("Signals")), (self.analysis, _("Analysis"))
        self.tabs = build.tabs(_("Signals and analysis"), *pages)
        self.tabs.setCornerWidget(self.strip)
        self.fold_list = build.styled(
            QToolButton(),
            role="fold",
            checkable=True,
            name=_("Hide the list of sessions"),
            tip=_("Hide the list of sessions, for more room; the selection stays"),
        )
        self.fold_list.toggled.connect(self._fold_list)
        self.tabs.setCornerWidget(self.fold_list, Qt.Corner.TopLeftCorner)
        self.split = build.styled(build.splitter((self.browser, 3), (self.tabs, 7), sizes=_WIDTHS), handle_width=8)
        QWidget.setTabOrder(self.export, self.fold_list)
        QWidget.setTabOrder(self.fold_list, self.tabs.tabBar())
        build.column((self.split, 1), spacing=4, margins=(12, 10, 12, 6), parent=self)
        # Not from within a job's end: the other pages must have settled first.
        self.refresh_timer = build.timer(self, 0, self._go_on)
        self.browser.work_waits.connect(self.refresh_timer.start)
        self.signals.work_waits.connect(self.refresh_timer.start)
        self.browser.selected.connect(self._show_selected)
        self.browser.opened.connect(self._open)
        self._restore()

    def enter(self) -> None:
        """Start the search for sessions on the first visit."""
        self.refresh_timer.start()

    def update_enabled(self, *, busy: bool, testing: bool) -> None:
        """Enable or disable the controls, and start waiting work."""
        self._testing = testing
        self.browser.update_enabled(testing=testing)
        self.signals.update_enabled(busy=busy, testing=testing)
        self.analysis.update_enabled(busy=busy, testing=testing)
        self.export.update_enabled(busy=busy)
        if not busy:
            self.refresh_timer.start()

    def list_sessions(self, paths: list[Path]) -> None:
        """Add folders and sessions to the list."""
        self.browser.list_sessions(paths)

    def show_new(self, path: Path) -> bool:
        """List a session that was made on this page, and show its signals."""
        self.browser.choose(path)
        self.tabs.setCurrentWidget(self.signals)
        return True

    def buttons(self) -> tuple[QAbstractButton, ...]:
        """Return the buttons that the command palette offers."""
        of_analysis = self.analysis.run, self.analysis.compare, self.analysis.save_table, self.analysis.save_figure
        return self.browser.again, self.export, *of_analysis, self.strip.stop

    def on_session_saved(self, path: Path) -> None:
        """List a new session."""
        self.browser.on_session_saved(path)

    def cancel(self) -> None:
        """Cancel the running work and start no more; the window closes."""
        self._over = True
        self.strip.cancel()
        self.analysis.cancel()

    def save_state(self) -> None:
        """Save folders, filters, columns, signals and sizes."""
        self.browser.save_state()
        self.signals.save_state()
        self.analysis.save_state()
        self.context.settings.setValue(_SPLIT, self.split.saveState())
        self.context.settings.setValue(_TAB, self.tabs.currentIndex())
        self.context.settings.setValue(_FOLDED, "yes" if self.fold_list.isChecked() else "no")

    def _go_on(self) -> None:
        if self._over or self._testing or self.context.busy or not self.isVisible():
            return
        if self._to_open is not None:
            path, self._to_open = self._to_open, None
            self.context.open_session(path)
        elif not self.analysis.go_on() and not self.signals.go_on():
            self.browser.go_on()

    def _open(self, path: Path) -> None:
        self._to_open = path
        self.strip.cancel()
        self.refresh_timer.start()

    def _show_selected(self) -> None:
        chosen = self.browser.chosen()
        self._to_open = None
        self.export.selection_changed()
        self.signals.show_tests(chosen)
        self.analysis.show_tests(chosen)

    def _fold_list(self, folded: bool) -> None:
        self.browser.setVisible(not folded)
        self.fold_list.setArrowType(Qt.ArrowType.RightArrow if folded else Qt.ArrowType.LeftArrow)

    def _restore(self) -> None:
        self.fold_list.setChecked(str(self.context.settings.value(_FOLDED, "no")) == "yes")
        self._fold_list(self.fold_list.isChecked())
        split = self.context.settings.value(_SPLIT)
        if isinstance(split, QByteArray):
            self.split.restoreState(split)
        build.restore_tab(self.tabs, self.context.settings.value(_TAB))
