"""Base class and widgets of the tabs of the page."""

from __future__ import annotations

import html
from collections.abc import Callable

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QFrame, QGridLayout, QLabel, QVBoxLayout, QWidget

from tissueid.app.context import AppContext
from tissueid.app.jobs import PageJob
from tissueid.app.theme import Theme
from tissueid.formatting import clean


class Tab(QWidget):
    """A tab. ``stale`` means that its files are read again when it is shown and no job runs."""

    def __init__(self, context: AppContext, page_job: PageJob, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.context = context
        self.page_job = page_job
        self.stale = True

    def load(self) -> None:
        """Read what is shown, in a job."""

    def update_enabled(self, *, busy: bool) -> None:
        """Enable what makes sense now."""

    def apply_theme(self, theme: Theme) -> None:
        """Take on the colours of a theme."""

    def save_state(self) -> None:
        """Save the state of the tab to the settings."""

    def begin(
        self,
        words: str,
        work: Callable[[Callable[[], object]], object],
        done: Callable[[object], None],
    ) -> bool:
        """Start a job whose error is shown as a notice."""
        return self.page_job.start(words, work, done, self.complain)

    def complain(self, words: str) -> None:
        """Show an error; a cancelled job has an empty one."""
        if words:
            self.context.say(words, problem=True)


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
    """Return a text whose tags are not interpreted as markup in a heading."""
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
