"""Button that exports the selected tests, with a menu of formats and a folder dialog."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QFileDialog, QMenu, QPushButton, QWidget

from tissueid.app import build
from tissueid.app.context import AppContext
from tissueid.app.views.researcher.background_work import BackgroundWork, ProgressStrip
from tissueid.app.views.researcher.selected_test import SelectedTest
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
        for one in chosen:
            self._tests.setdefault(one.path, []).append(one.number)

    def run(self) -> SessionExport:
        """Export the sessions; a cancelled one leaves no files."""
        try:
            for done, (path, numbers) in enumerate(self._tests.items()):
                self._begun = done / len(self._tests)
                try:
                    self._export(path, numbers)
                except CancelledError:
                    raise
                except (TissueIDError, OSError) as error:
                    self.problems.append(in_words(error))
        except CancelledError:
            pass  # what is written stays
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
        for kind, words in EXPORTS.items():
            self.menu().addAction(f"{_(words)}…", partial(self._choose, kind))
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
        dialog = build.styled(
            QFileDialog(self.window(), _("Export into a new folder in"), str(chosen[0].path.parent)),
            file_mode=QFileDialog.FileMode.Directory,
            option=QFileDialog.Option.ShowDirsOnly,
            attribute=Qt.WidgetAttribute.WA_DeleteOnClose,
        )
        dialog.fileSelected.connect(partial(self._export, chosen, kind))
        dialog.open()

    def _export(self, chosen: Sequence[SelectedTest], kind: str, folder: str) -> None:
        if self._context.busy:
            self._context.say(_("Not exported: other work is running. Try again."), problem=True)
            return
        export = SessionExport(chosen, Path(folder), kind, self._context.trail)
        self._strip.watch(export)
        self._context.jobs.do(export.run, self._exported, self._failed)

    def _exported(self, export: SessionExport) -> None:
        self._strip.clear()
        self._context.say(export.words_after, problem=bool(export.problems))

    def _failed(self, words: str) -> None:
        self._strip.clear()
        self._context.say(words, problem=True)
