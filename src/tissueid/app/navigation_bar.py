"""The navigation bar at the left edge: choose a page by mouse, by Ctrl and a digit, or by the arrow keys.

The tab key stops once for all pages, at the shown one, and at each button at the foot.
"""

from __future__ import annotations

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import QFrame, QToolButton, QWidget

from tissueid.app import build
from tissueid.language import _

WIDTH = 92
MEASURE = "measure"
"""The page of the guided test."""


class NavigationBar(QFrame):
    """One button for each page; ``chosen`` carries the page's name."""

    chosen = Signal(str)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        build.styled(self, role="rail", fixed_width=WIDTH, name=_("Pages"))
        self.buttons: dict[str, QToolButton] = {}
        self.keys: dict[str, str] = {}
        self.feet: list[QToolButton] = []
        self._column = build.column(None, spacing=2, margins=(0, 8, 0, 8), parent=self)

    def add(self, name: str, title: str) -> None:
        """Add a button for a page at the end."""
        button = _button(title)
        build.styled(button, focus_policy=Qt.FocusPolicy.TabFocus, name=_("Page {title}").format(title=title))
        keys = self.keys[name] = f"Ctrl+{len(self.buttons) + 1}"
        button.setToolTip(f"{title} ({keys})")
        button.clicked.connect(lambda _checked=False, name=name: self._choose(name))
        self._column.insertWidget(len(self.buttons), button)
        self.buttons[name] = button

    def add_foot(self, title: str, keys: str, what: str) -> QToolButton:
        """Add a button at the foot that opens and closes a panel next to the page."""
        button = _button(title)
        build.styled(button, focus_policy=Qt.FocusPolicy.TabFocus, name=what, tip=f"{what} ({keys})")
        self._column.addWidget(button)
        self.feet.append(button)
        return button

    def show_chosen(self, name: str) -> None:
        """Mark the button of the shown page; the tab key stops there."""
        held = any(button.hasFocus() for button in self.buttons.values())
        for other, button in self.buttons.items():
            button.setChecked(other == name)
        self.buttons[name].setFocusPolicy(Qt.FocusPolicy.TabFocus)
        if held:
            self.buttons[name].setFocus()
        for other, button in self.buttons.items():
            if other != name:
                button.setFocusPolicy(Qt.FocusPolicy.NoFocus)

    def keyPressEvent(self, event: QKeyEvent) -> None:  # noqa: N802
        """Up and down go from page to page."""
        step = {Qt.Key.Key_Up: -1, Qt.Key.Key_Down: 1}.get(Qt.Key(event.key()))
        names = list(self.buttons)
        focus = next((k for k, name in enumerate(names) if self.buttons[name].hasFocus()), None)
        if step is None or focus is None:
            super().keyPressEvent(event)
            return
        name = names[(focus + step) % len(names)]
        self._choose(name)
        self.buttons[name].setFocus()  # the page may have taken it

    def _choose(self, name: str) -> None:
        self.show_chosen(name)
        self.chosen.emit(name)


class _Button(QToolButton):
    """A button that leaves the arrow keys to the navigation bar; QToolButton uses them as tab keys."""

    def keyPressEvent(self, event: QKeyEvent) -> None:  # noqa: N802
        """Pass up and down on."""
        if event.key() in (Qt.Key.Key_Up, Qt.Key.Key_Down):
            event.ignore()
            return
        super().keyPressEvent(event)


def _button(title: str) -> QToolButton:
    button = _Button()
    button.setText(title)
    build.styled(button, checkable=True, role="rail", fixed_width=WIDTH)
    return button
