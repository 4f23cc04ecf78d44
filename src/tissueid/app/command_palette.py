"""The command palette: type a part of what is to be done, choose it by the arrow keys, press Return."""

from __future__ import annotations

from collections.abc import Callable

from PySide6.QtCore import QEvent, QObject, Qt, Signal
from PySide6.QtGui import QFocusEvent, QKeyEvent, QKeySequence, QShortcut
from PySide6.QtWidgets import QApplication, QFrame, QLineEdit, QListWidget, QListWidgetItem, QWidget

from tissueid.app import build
from tissueid.app.actions import PALETTE_KEY, Action
from tissueid.language import _

_WIDTH, _HEIGHT = 600, 380
_TOP = 76
"""Below the header and the line of notices, pixels. At most half as high as the window, so that it covers no STOP."""
_STEPS = {Qt.Key.Key_Up: -1, Qt.Key.Key_Down: 1, Qt.Key.Key_PageUp: -8, Qt.Key.Key_PageDown: 8}


class _Words(QLineEdit):
    """Takes Escape before it is a shortcut, and passes on the keys that choose."""

    left = Signal()
    pressed = Signal(int)

    def event(self, event: QEvent) -> bool:
        """Claim Escape: where no test runs, it closes the palette."""
        if (
            isinstance(event, QKeyEvent)
            and event.type() == QEvent.Type.ShortcutOverride
            and event.key() == Qt.Key.Key_Escape
        ):
            event.accept()
            return True
        return super().event(event)

    def keyPressEvent(self, event: QKeyEvent) -> None:  # noqa: N802
        """Pass on what is no part of a text. A Return that is held down counts once."""
        if event.key() in (*_STEPS, Qt.Key.Key_Escape, Qt.Key.Key_Return, Qt.Key.Key_Enter):
            if not (event.isAutoRepeat() and event.key() not in _STEPS):
                self.pressed.emit(event.key())
            return
        super().keyPressEvent(event)

    def focusOutEvent(self, event: QFocusEvent) -> None:  # noqa: N802
        """Say that something else is used now."""
        super().focusOutEvent(event)
        if event.reason() not in (Qt.FocusReason.PopupFocusReason, Qt.FocusReason.ActiveWindowFocusReason):
            self.left.emit()


class CommandPalette(QFrame):
    """Lies over the page and is no dialog: STOP and its keys work while it is open.

    What cannot be done now is listed with the reason, and does nothing. What starts a coil leads to its button.
    """

    def __init__(self, declare: Callable[[], tuple[Action, ...]], window: QWidget) -> None:
        super().__init__(window)
        self._declare, self._window = declare, window
        self._before: QWidget | None = None
        self._actions: tuple[Action, ...] = ()
        self.setProperty("role", "card")
        self.setAutoFillBackground(True)
        self.words = _Words()
        self.words.setMaxLength(100)
        self.words.setPlaceholderText(_("What do you want to do?"))
        self.words.setAccessibleName(_("Search all actions"))
        self.list = build.styled(
            QListWidget(),
            name=_("Actions"),
            focus_policy=Qt.FocusPolicy.NoFocus,
            horizontal_scroll_bar_policy=Qt.ScrollBarPolicy.ScrollBarAlwaysOff,
            text_elide_mode=Qt.TextElideMode.ElideRight,
        )
        build.column(self.words, (self.list, 1), margins=(8,), parent=self)
        self.words.textChanged.connect(self._fill)
        self.words.pressed.connect(self._take_key)
        self.words.left.connect(self.hide)
        self.list.itemClicked.connect(self._run)
        shortcut = QShortcut(QKeySequence(PALETTE_KEY), window)
        shortcut.setContext(Qt.ShortcutContext.WindowShortcut)
        shortcut.activated.connect(self.toggle)
        window.installEventFilter(self)
        self.hide()

    def toggle(self) -> None:
        """Open the palette, or close it."""
        if self.isVisible():
            self._close()
            return
        self._before = QApplication.focusWidget()
        self._actions = self._declare()
        self._place()
        self.words.clear()
        self._fill("")
        self.show()
        self.raise_()
        self.words.setFocus()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:  # noqa: N802
        """Stay in the middle of the window when its size changes."""
        if watched is self._window and event.type() == QEvent.Type.Resize and self.isVisible():
            self._place()
        return super().eventFilter(watched, event)

    def _place(self) -> None:
        window = self._window
        width, height = min(_WIDTH, window.width() - 40), min(_HEIGHT, window.height() // 2)
        self.setGeometry((window.width() - width) // 2, _TOP, width, height)

    @property
    def chosen(self) -> Action | None:
        """The action that Return would take; None where that is not possible now."""
        item = self.list.currentItem()
        action: Action | None = None if item is None else item.data(Qt.ItemDataRole.UserRole)
        return action

    def _close(self) -> None:
        self.hide()
        if self._before is not None and self._before.isVisible():
            self._before.setFocus()

    def _fill(self, text: str) -> None:
        """List what has every word; what is possible comes first."""
        wanted = text.casefold().split()
        found = [
            (action.why_not(), action)
            for action in self._actions
            if action.offered() and all(word in f"{action.title} {action.keys}".casefold() for word in wanted)
        ]
        self.list.clear()
        for why_not, action in sorted(found, key=lambda entry: bool(entry[0])):
            after = why_not or (_("goes to its button") if action.energises else action.keys)
            item = QListWidgetItem(f"{action.title}   –   {after}" if after else action.title)
            item.setToolTip(item.text().replace("<", "‹").replace(">", "›"))
            if why_not:
                item.setFlags(Qt.ItemFlag.NoItemFlags)
            else:
                item.setData(Qt.ItemDataRole.UserRole, action)
            self.list.addItem(item)
        if not self.list.count():
            item = QListWidgetItem(_("Nothing matches. Try another word, such as “page” or “open”."))
            item.setFlags(Qt.ItemFlag.NoItemFlags)
            self.list.addItem(item)
        self._step(0)

    def _step(self, by: int) -> None:
        """Go up or down among what is possible."""
        possible = [row for row in range(self.list.count()) if self.list.item(row).flags() & Qt.ItemFlag.ItemIsEnabled]
        row = self.list.currentRow()
        place = possible.index(row) + by if row in possible else 0
        self.list.setCurrentRow(possible[min(max(place, 0), len(possible) - 1)] if possible else -1)
        item = self.list.currentItem()
        self.words.setAccessibleDescription("" if item is None else item.text())

    def _take_key(self, key: int) -> None:
        step = _STEPS.get(Qt.Key(key))
        if step is not None:
            self._step(step)
        elif key == Qt.Key.Key_Escape:
            self._close()
        else:
            self._run()

    def _run(self) -> None:
        action = self.chosen
        if action is None or action.why_not():
            return
        self._close()
        action.run()
