"""Search field and filters of the list of sessions."""

from __future__ import annotations

from collections.abc import Iterable

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QComboBox, QHBoxLayout, QLineEdit, QWidget

from tissueid.app.build import button, column, row, styled
from tissueid.app.views.researcher.session_search import SessionEntry
from tissueid.app.widgets import plain_tip
from tissueid.formatting import clean, subject_text
from tissueid.language import _, marked

_NAMES = (marked("Subject"), marked("Site"), marked("Kind"))
_ALL = (marked("All subjects"), marked("All sites"), marked("All kinds"))
_LONGEST = 200
_MOST_OFFERED = 2000


class FilterBar(QWidget):
    """Search and filters; ``changed`` is emitted on each change."""

    changed = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.words = styled(
            QLineEdit(),
            max_length=_LONGEST,
            placeholder_text=_("Search in all columns"),
            name=_("Search in all columns"),
            tip=_("Rows that have every word (Ctrl+F)"),
            clear_button_enabled=True,
        )
        self.choices = tuple(QComboBox() for _name in _NAMES)
        self.subject, self.site, self.kind = self.choices
        self.clear = button(_("Clear"), self._clear, name=_("Clear search and filters"))
        choices = QHBoxLayout()
        choices.setSpacing(6)
        for choice, name, anything in zip(self.choices, _NAMES, _ALL, strict=True):
            styled(
                choice,
                name=_("Filter by {column}").format(column=_(name)),
                size_adjust_policy=QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon,
                minimum_contents_length=4,
            )
            choice.view().setTextElideMode(Qt.TextElideMode.ElideRight)
            choice.addItem(_(name), "")
            choice.setItemData(0, _(anything), Qt.ItemDataRole.ToolTipRole)
            choice.currentIndexChanged.connect(self._chosen)
            choices.addWidget(choice, 1)
        column(row((self.words, 1), self.clear), choices, parent=self)
        self.words.textChanged.connect(self._chosen)
        self._chosen()

    @property
    def asked(self) -> tuple[str, str, str, str]:
        """Search words, subject, site and kind; "" for no filter."""
        subject, site, kind = (str(choice.currentData() or "") for choice in self.choices)
        return self.words.text(), subject, site, kind

    def ask(self, words: str, subject: str, site: str, kind: str) -> None:
        """Set the search words and filters."""
        for choice, value in zip(self.choices, (subject, site, kind), strict=True):
            if value and choice.findData(value) < 0:
                choice.addItem(self._text(choice, value), value)
            choice.setCurrentIndex(choice.findData(value))
        self.words.setText(words)

    def offer(self, entries: Iterable[SessionEntry]) -> None:
        """Offer the values found in these files; the selection stays."""
        found: tuple[set[str], ...] = (set(), set(), set())
        for entry in entries:
            if not entry.problem:
                found[0].add(entry.pseudonym)
            for test in entry.tests:
                found[1].add(test.site)
                found[2].add(test.kind)
        for choice, values in zip(self.choices, found, strict=True):
            self._fill(choice, values - {""})

    def _fill(self, choice: QComboBox, values: set[str]) -> None:
        asked = str(choice.currentData() or "")
        wanted = ["", *sorted(values | ({asked} - {""}), key=str.casefold)[:_MOST_OFFERED]]
        if [choice.itemData(place) for place in range(choice.count())] == wanted:
            return
        choice.blockSignals(True)
        for place in range(choice.count() - 1, 0, -1):
            choice.removeItem(place)
        for value in wanted[1:]:
            choice.addItem(self._text(choice, value), value)
        choice.setCurrentIndex(max(0, choice.findData(asked)))
        choice.blockSignals(False)

    def _text(self, choice: QComboBox, value: str) -> str:
        if choice is self.subject:
            return subject_text(value)
        return _(clean(value)) if choice is self.kind else clean(value)

    def _chosen(self) -> None:
        self.clear.setEnabled(any(self.asked))
        for choice in self.choices:
            shown = choice.currentText() if choice.currentIndex() else choice.itemData(0, Qt.ItemDataRole.ToolTipRole)
            choice.setToolTip(plain_tip(str(shown)))
        self.changed.emit()

    def _clear(self) -> None:
        self.ask("", "", "", "")
        self.words.setFocus()
