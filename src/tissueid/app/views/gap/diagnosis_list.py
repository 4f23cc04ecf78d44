"""List of diagnoses: session, verdict, stage and effect."""

from __future__ import annotations

from collections.abc import Sequence

from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtGui import QKeySequence
from PySide6.QtWidgets import QLabel, QListWidget, QListWidgetItem, QWidget

from tissueid.app import build
from tissueid.app.build import button, styled
from tissueid.app.views.gap.diagnosis_result import DiagnosisResult, State
from tissueid.app.views.gap.page_content import STAGE_TITLES, STATE_TITLES, VERDICT_TITLES, as_title
from tissueid.formatting import clean
from tissueid.language import _

_WIDTH, _LEAST_WIDTH = 196, 120
_MOST = 20
_LONGEST = 40


class DiagnosisList(QWidget):
    """Diagnoses, newest first. ``chosen`` is emitted when the selection changes.

    ``removed`` and ``returned`` carry one that was removed, or brought back.
    """

    chosen = Signal()
    removed = Signal(object)
    returned = Signal(object)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        build.styled(self, minimum_width=_LEAST_WIDTH, maximum_width=_WIDTH)
        self._results: list[DiagnosisResult] = []
        self._states: list[State] = []
        self.list = styled(
            QListWidget(),
            name=_("Diagnoses, newest first"),
            word_wrap=True,
            spacing=2,
            horizontal_scroll_bar_policy=Qt.ScrollBarPolicy.ScrollBarAlwaysOff,
        )
        self.list.currentRowChanged.connect(self._tell)
        self.remove = button(
            _("Remove"),
            self._remove,
            name=_("Remove the chosen diagnosis from the list"),
            tip=_("Delete does the same; Ctrl+Z brings it back"),
        )
        self.none = build.label("muted", _("No diagnosis yet."))
        self._removed: tuple[int, DiagnosisResult] | None = None
        build.shortcut(self, QKeySequence.StandardKey.Delete, self._remove)
        build.shortcut(self, QKeySequence.StandardKey.Undo, self._undo)
        heading = styled(QLabel(_("Diagnoses")), role="heading")
        build.column(heading, self.none, (self.list, 1), self.remove, parent=self)
        self._tell()

    @property
    def result(self) -> DiagnosisResult | None:
        """The selected diagnosis."""
        row = self.list.currentRow()
        return self._results[row] if 0 <= row < len(self._results) else None

    @property
    def state(self) -> State:
        """State of the session file of the selected diagnosis."""
        return "" if self.result is None else self._states[self.list.currentRow()]

    def add(self, result: DiagnosisResult) -> None:
        """Add a diagnosis at the top and select it; remove the oldest beyond the maximum."""
        self._put(0, result)

    def restore(self, results: Sequence[DiagnosisResult]) -> None:
        """Append stored diagnoses, newest first; the selection stays."""
        there = {result.key for result in self._results}
        with QSignalBlocker(self.list):
            for result in results:
                if result.key not in there and len(self._results) < _MOST:
                    self._insert(len(self._results), result)
        self.none.setVisible(not self._results)

    def look(self) -> None:
        """Check the session files again."""
        for row, result in enumerate(self._results):
            if (state := result.state) != self._states[row]:
                self._states[row] = state
                self._show_words(row)
                if row == self.list.currentRow():
                    self.chosen.emit()

    def _put(self, row: int, result: DiagnosisResult) -> None:
        with QSignalBlocker(self.list):
            self._insert(row, result)
            while len(self._results) > _MOST:
                self._take_out(_MOST)
            self.list.setCurrentRow(min(row, len(self._results) - 1))
        self._tell()

    def _take_out(self, row: int) -> DiagnosisResult:
        self.list.takeItem(row)
        del self._states[row]
        return self._results.pop(row)

    def _insert(self, row: int, result: DiagnosisResult) -> None:
        self._results.insert(row, result)
        self._states.insert(row, result.state)
        self.list.insertItem(row, QListWidgetItem())
        self._show_words(row)

    def _show_words(self, row: int) -> None:
        result, item = self._results[row], self.list.item(row)
        lines = _words(result, self._states[row])
        item.setText("\n".join(lines))
        made = _("Diagnosed {when}").format(when=f"{result.when.astimezone():%Y-%m-%d %H:%M}")
        item.setToolTip(f"{clean(str(result.asked.session))}\n{made}")
        item.setData(Qt.ItemDataRole.AccessibleTextRole, ", ".join(lines))

    def _remove(self) -> None:
        row = self.list.currentRow()
        if self.result is not None:
            self.list.setFocus()  # the button may have nothing more to do; here the keys for the list are heard
            with QSignalBlocker(self.list):
                self._removed = row, self._take_out(row)
            self._tell()
            self.removed.emit(self._removed[1])

    def _undo(self) -> None:
        """Restore the diagnosis that was removed last."""
        if self._removed is not None:
            (row, result), self._removed = self._removed, None
            self._put(min(row, len(self._results)), result)
            self.returned.emit(result)

    def _tell(self) -> None:
        self.none.setVisible(not self._results)
        self.remove.setEnabled(self.result is not None)
        self.chosen.emit()


def _words(result: DiagnosisResult, state: State) -> list[str]:
    story = result.story
    lines = [clean(result.asked.session.name)[:_LONGEST], _(VERDICT_TITLES[story.verdict])]
    lines[0] += f"  ·  {result.when.astimezone():%Y-%m-%d %H:%M}"
    if story.at_fault:
        lines[1] += f"  ·  {', '.join(_(STAGE_TITLES[stage]) for stage in story.at_fault)}"
    if story.effect:
        lines.append(as_title(story.effect))
    if result.twin is not None:
        lines.append(_("from twin {name}").format(name=result.twin.name))
    if state:
        lines.append(_(STATE_TITLES[state]))
    return lines
