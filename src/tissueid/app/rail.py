"""The rail at the left edge: which page is shown, by mouse, by Ctrl and a digit, or by the arrow keys."""

from __future__ import annotations

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QKeyEvent, QKeySequence, QShortcut
from PySide6.QtWidgets import QButtonGroup, QFrame, QToolButton, QVBoxLayout, QWidget

WIDTH = 92


class Rail(QFrame):
    """One button a page; ``chosen`` carries the page's name."""

    chosen = Signal(str)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setProperty("role", "rail")
        self.setFixedWidth(WIDTH)
        self.setAccessibleName("Pages")
        self.buttons: dict[str, QToolButton] = {}
        self._group = QButtonGroup(self)
        self._group.setExclusive(True)
        self._column = QVBoxLayout(self)
        self._column.setContentsMargins(0, 8, 0, 8)
        self._column.setSpacing(2)
        self._column.addStretch(1)

    def add(self, name: str, title: str) -> None:
        """Put a button for a page at the end."""
        button = QToolButton()
        button.setText(title)
        button.setCheckable(True)
        button.setProperty("role", "rail")
        button.setFixedWidth(WIDTH)
        button.setAccessibleName(f"Page {title}")
        keys = f"Ctrl+{len(self.buttons) + 1}"
        button.setToolTip(f"{title} ({keys})")
        button.clicked.connect(lambda _checked=False, name=name: self.chosen.emit(name))
        self._group.addButton(button)
        self._column.insertWidget(self._column.count() - 1, button)
        self.buttons[name] = button
        shortcut = QShortcut(QKeySequence(keys), self)
        shortcut.setContext(Qt.ShortcutContext.WindowShortcut)
        shortcut.activated.connect(button.click)

    def show_chosen(self, name: str) -> None:
        """Light the button of a page."""
        self.buttons[name].setChecked(True)

    def keyPressEvent(self, event: QKeyEvent) -> None:  # noqa: N802
        """Up and down go from button to button."""
        step = {Qt.Key.Key_Up: -1, Qt.Key.Key_Down: 1}.get(Qt.Key(event.key()))
        names = list(self.buttons)
        focus = next((k for k, name in enumerate(names) if self.buttons[name].hasFocus()), None)
        if step is None or focus is None:
            super().keyPressEvent(event)
            return
        self.buttons[names[(focus + step) % len(names)]].setFocus()
