"""What narrows the list of sessions down: words in any column, and a subject, a site, a kind of test."""

from __future__ import annotations

from collections.abc import Iterable

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QComboBox, QHBoxLayout, QLineEdit, QPushButton, QVBoxLayout, QWidget

from tissueid.app.views.researcher.index import Entry
from tissueid.app.views.researcher.tips import plain_tip
from tissueid.language import _, marked
from tissueid.wording import clean

_NAMES = (marked("Subject"), marked("Site"), marked("Kind"))
_ANY = (marked("All subjects"), marked("All sites"), marked("All kinds"))
_LONGEST = 200
_MOST_OFFERED = 2000


class FilterBar(QWidget):
    """``changed`` is sent with every letter and every choice."""

    changed = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.words = QLineEdit()
        self.words.setMaxLength(_LONGEST)
        self.words.setPlaceholderText(_("Search in all columns"))
        self.words.setAccessibleName(_("Search in all columns"))
        self.words.setToolTip(_("Rows that have every word (Ctrl+F)"))
        self.words.setClearButtonEnabled(True)
        self.choices = tuple(QComboBox() for _name in _NAMES)
        self.subject, self.site, self.kind = self.choices
        self.clear = QPushButton(_("Clear"))
        self.clear.setAccessibleName(_("Clear search and filters"))
        choices = QHBoxLayout()
        choices.setSpacing(6)
        for choice, name, anything in zip(self.choices, _NAMES, _ANY, strict=True):
            choice.setAccessibleName(_("Filter by {column}").format(column=_(name)))
            choice.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
            choice.setMinimumContentsLength(4)
            choice.view().setTextElideMode(Qt.TextElideMode.ElideRight)
            choice.addItem(_(anything), "")
            choice.currentIndexChanged.connect(self._chosen)
            choices.addWidget(choice, 1)
        first = QHBoxLayout()
        first.setSpacing(6)
        first.addWidget(self.words, 1)
        first.addWidget(self.clear)
        rows = QVBoxLayout(self)
        rows.setContentsMargins(0, 0, 0, 0)
        rows.setSpacing(6)
        rows.addLayout(first)
        rows.addLayout(choices)
        self.words.textChanged.connect(self._chosen)
        self.clear.clicked.connect(self._clear)
        self._chosen()

    @property
    def asked(self) -> tuple[str, str, str, str]:
        """Words, subject, site and kind; "" where nothing is asked for."""
        subject, site, kind = (str(choice.currentData() or "") for choice in self.choices)
        return self.words.text(), subject, site, kind

    def ask(self, words: str, subject: str, site: str, kind: str) -> None:
        """Ask for these, whether or not the list has them yet."""
        for choice, value in zip(self.choices, (subject, site, kind), strict=True):
            if value and choice.findData(value) < 0:
                choice.addItem(clean(value), value)
            choice.setCurrentIndex(choice.findData(value))
        self.words.setText(words)

    def offer(self, entries: Iterable[Entry]) -> None:
        """Offer what these files hold; what is asked for stays."""
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
        anything = choice.itemText(0)
        choice.clear()
        for value in wanted:
            choice.addItem(clean(value) or anything, value)
        choice.setCurrentIndex(max(0, choice.findData(asked)))
        choice.blockSignals(False)

    def _chosen(self) -> None:
        self.clear.setEnabled(any(self.asked))
        for choice in self.choices:
            choice.setToolTip(plain_tip(choice.currentText()))
        self.changed.emit()

    def _clear(self) -> None:
        self.ask("", "", "", "")
        self.words.setFocus()


__all__ = ["FilterBar"]
