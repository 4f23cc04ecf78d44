"""What the tabs of the page have in common."""

from __future__ import annotations

import html
from collections.abc import Callable

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QFrame, QGridLayout, QLabel, QVBoxLayout, QWidget

from tissueid.app.theme import Theme
from tissueid.app.views.technician.errand import Errands
from tissueid.app.views.view import Desk
from tissueid.wording import clean


class Tab(QWidget):
    """A tab. ``stale`` says that what it shows is to be read anew as soon as it is seen and nothing else goes on."""

    def __init__(self, desk: Desk, errands: Errands, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.desk = desk
        self.errands = errands
        self.stale = True

    def load(self) -> None:
        """Read what is shown, in a job."""

    def settle(self, *, busy: bool) -> None:
        """Enable what makes sense now."""

    def paint_with(self, theme: Theme) -> None:
        """Take on the colours of a theme."""

    def save_state(self) -> None:
        """Write what is to be found again into the settings."""

    def begin(
        self,
        words: str,
        work: Callable[[Callable[[], None]], object],
        done: Callable[[object], None],
    ) -> bool:
        """Begin slow work whose failure is said where everybody reads it."""
        return self.errands.start(words, work, done, self.complain)

    def complain(self, words: str) -> None:
        """Say what went wrong; what was cancelled has no words."""
        if words:
            self.desk.say(words, problem=True)


def plain_label(text: str = "", role: str = "", name: str = "") -> QLabel:
    """A label that wraps and shows text as it stands."""
    label = QLabel(text)
    label.setTextFormat(Qt.TextFormat.PlainText)
    label.setWordWrap(True)
    label.setMinimumWidth(1)
    if role:
        label.setProperty("role", role)
    if name:
        label.setAccessibleName(name)
    return label


def tip(text: str) -> str:
    """A tool tip that shows text as it stands, line by line."""
    return f"<qt>{html.escape(text).replace(chr(10), '<br>')}</qt>" if text else ""


def unmarked(text: str) -> str:
    """Text for a heading that would take what looks like markup for markup."""
    return clean(text).replace("<", "‹")


def mark_level(widget: QWidget, level: str) -> None:
    """Give a widget the colour of a level."""
    if widget.property("level") != level:
        widget.setProperty("level", level)
        widget.style().unpolish(widget)
        widget.style().polish(widget)


class FactsCard(QFrame):
    """A heading over labels and values, row by row."""

    def __init__(self, title: str, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setProperty("role", "card")
        self.setAccessibleName(title)
        self._grid = QGridLayout()
        self._grid.setHorizontalSpacing(12)
        self._grid.setVerticalSpacing(3)
        self._grid.setColumnStretch(1, 1)
        self._cells: list[tuple[QLabel, QLabel]] = []
        column = QVBoxLayout(self)
        column.setContentsMargins(12, 8, 12, 8)
        column.setSpacing(4)
        column.addWidget(plain_label(title, "heading"))
        column.addLayout(self._grid)
        column.addStretch(1)

    @property
    def facts(self) -> dict[str, str]:
        """What is shown."""
        return {name.text(): value.text() for name, value in self._cells if not name.isHidden()}

    def show_facts(self, facts: dict[str, str]) -> None:
        """Show these rows, and no others."""
        while len(self._cells) < len(facts):
            row = len(self._cells)
            name, value = plain_label(role="muted"), plain_label()
            name.setWordWrap(False)
            value.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
            value.setAlignment(Qt.AlignmentFlag.AlignTop)
            name.setAlignment(Qt.AlignmentFlag.AlignTop)
            self._grid.addWidget(name, row, 0)
            self._grid.addWidget(value, row, 1)
            self._cells.append((name, value))
        rows = [*facts.items(), *[("", "")] * (len(self._cells) - len(facts))]
        for (name, value), (label, text) in zip(self._cells, rows, strict=True):
            name.setText(label)
            value.setText(text)
            value.setAccessibleName(f"{label}: {text}")
            name.setVisible(bool(label))
            value.setVisible(bool(label))
