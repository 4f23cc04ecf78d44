"""Small parts of the first page."""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QHBoxLayout, QLabel, QPushButton, QVBoxLayout

from tissueid.app.views.start.recent import Recent
from tissueid.app.views.start.rows import Rows


def cells(item: Recent) -> tuple[tuple[str, str], ...]:
    """Return the cells of a row for a session."""
    return (item.date, ""), (item.site, ""), (item.subject, ""), (item.verdict, item.level)


def brief(health: str) -> str:
    """Return a problem without its advice, which is in the tooltip of the row."""
    return health.partition(";")[0]


def heading(text: str) -> QLabel:
    """A heading."""
    label = QLabel(text)
    label.setProperty("role", "heading")
    return label


def words() -> QLabel:
    """A label for words of files and people: plain, wrapped, and to be copied from."""
    label = QLabel()
    label.setWordWrap(True)
    label.setMinimumWidth(1)
    label.setTextFormat(Qt.TextFormat.PlainText)
    label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
    return label


def under_heading(title: str, about: QLabel, table: Rows, *buttons: QPushButton) -> QVBoxLayout:
    """A table under a heading with buttons next to the heading."""
    about.setProperty("role", "muted")
    top = QHBoxLayout()
    top.setSpacing(8)
    top.addWidget(heading(title))
    top.addWidget(about, 1)
    for button in buttons:
        top.addWidget(button)
    column = QVBoxLayout()
    column.setSpacing(4)
    column.addLayout(top)
    column.addWidget(table, 1)
    return column
