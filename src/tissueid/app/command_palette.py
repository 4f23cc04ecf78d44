"""The command palette: type a part of what is to be done, choose it by the arrow keys, press Return."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

from PySide6.QtCore import QEvent, QObject, Qt, Signal
from PySide6.QtGui import QFocusEvent, QKeyEvent
from PySide6.QtWidgets import (
    QAbstractButton,
    QApplication,
    QFrame,
    QLineEdit,
    QListWidget,
    QListWidgetItem,
    QScrollArea,
    QStackedWidget,
    QTabWidget,
    QWidget,
)

from tissueid.app import build
from tissueid.app.layout import Layout
from tissueid.app.navigation_bar import MEASURE
from tissueid.app.pages import Pages
from tissueid.app.panels import HELP_KEY, LOG_KEY, Panels
from tissueid.app.readouts import NO_TEST
from tissueid.app.words import sentence
from tissueid.language import _
from tissueid.messages import translated

PALETTE_KEY = "Ctrl+K"


@dataclass(frozen=True)
class PaletteEntry:
    """Something to do: its title in the language of the window, its shortcut if it has one, and what does it.

    ``why_not`` returns why it cannot be done now, and "" where it can; ``offered`` is whether the window has it now.
    One that ``energises`` a coil only leads to its button: it starts nothing.
    """

    title: str
    run: Callable[[], object]
    keys: str = ""
    offered: Callable[[], bool] = lambda: True
    why_not: Callable[[], str] = lambda: ""
    energises: bool = False


def declare(ui: Layout, panels: Panels, pages: Pages, window: QWidget) -> tuple[PaletteEntry, ...]:
    """Return the actions of the window as it is now, with those of the pages that have been made."""
    own = [PaletteEntry(ui.stop.accessibleName(), ui.stop.click, why_not=partial(_nothing_to_stop, ui))]
    own += [
        PaletteEntry(button.accessibleName(), partial(pages.go, name), ui.rail.keys[name])
        for name, button in ui.rail.buttons.items()
    ]
    own += [
        PaletteEntry(_("Help for this page"), panels.help_button.click, HELP_KEY),
        PaletteEntry(_("Log of the window"), panels.log_button.click, LOG_KEY),
        PaletteEntry(_("Close TissueID"), window.close, "Ctrl+Q"),
    ]
    for chooser in pages.start.choosers:
        choice = chooser.choice
        own += [
            PaletteEntry(f"{chooser.name}: {choice.itemText(index)}", partial(choice.setCurrentIndex, index))
            for index in range(choice.count())
            if index != choice.currentIndex()
        ]
    own += [_by_button(pages, MEASURE, button, energises=True) for button in ui.energising]
    own += [_by_button(pages, MEASURE, button) for button in ui.harmless]
    own += [_by_button(pages, "", button) for button in (ui.open, ui.report)]
    for view in pages.views:
        own += [_by_button(pages, view.name, button) for button in view.buttons()]
    return tuple(own)


def install_shortcuts(actions: Iterable[PaletteEntry], window: QWidget) -> None:
    """Make the shortcuts of the actions that have one."""
    for action in actions:
        if action.keys:
            build.shortcut(window, action.keys, action.run, Qt.ShortcutContext.ApplicationShortcut)


def _nothing_to_stop(ui: Layout) -> str:
    return "" if ui.state.testing else sentence(translated(NO_TEST))


def _by_button(pages: Pages, page: str, button: QAbstractButton, *, energises: bool = False) -> PaletteEntry:
    """Return the action that presses a button of a page, or that leads to it where it energises a coil."""
    name = button.accessibleName() or button.text().replace("&", "")
    title = f"{pages.title(page)}: {name}" if page else name

    def run() -> None:
        if page:
            pages.show(page)
        _reveal(button)
        if energises:
            button.setFocus(Qt.FocusReason.ShortcutFocusReason)
        else:
            button.click()

    def why_not() -> str:
        return "" if button.isEnabled() else button.accessibleDescription() or _("Not possible now.")

    return PaletteEntry(title, run, "", partial(_is_there, button), why_not, energises)


def _is_there(button: QAbstractButton) -> bool:
    """Whether the button can be seen, if need be after another page or tab is chosen."""
    part: QWidget | None = button
    while part is not None and not part.isWindow():
        parent = part.parentWidget()
        if isinstance(parent, QStackedWidget):
            tabs = parent.parentWidget()
            if isinstance(tabs, QTabWidget) and not tabs.isTabVisible(tabs.indexOf(part)):
                return False
        elif part.isHidden():
            return False
        part = parent
    return True


def _reveal(button: QAbstractButton) -> None:
    """Choose the tabs and scroll so that the button can be seen."""
    part: QWidget | None = button
    while part is not None and not part.isWindow():
        parent = part.parentWidget()
        tabs = parent.parentWidget() if isinstance(parent, QStackedWidget) else None
        if isinstance(tabs, QTabWidget):
            tabs.setCurrentWidget(part)
        if isinstance(part, QScrollArea):
            part.ensureWidgetVisible(button)
        part = parent


_WIDTH, _HEIGHT = 600, 380
_TOP = 76
"""Below the header and the line of notices, pixels. At most half as high as the window, so that it covers no STOP."""
_STEPS = {Qt.Key.Key_Up: -1, Qt.Key.Key_Down: 1, Qt.Key.Key_PageUp: -8, Qt.Key.Key_PageDown: 8}


class _Words(QLineEdit):
    """Takes Escape before it is a shortcut, and passes on the keys that choose."""

    escaped = Signal()
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
            self.escaped.emit()


class CommandPalette(QFrame):
    """Lies over the page and is no dialog: STOP and its keys work while it is open.

    What cannot be done now is listed with the reason, and does nothing. What starts a coil leads to its button.
    """

    def __init__(self, declare: Callable[[], tuple[PaletteEntry, ...]], window: QWidget) -> None:
        super().__init__(window)
        self._declare, self._window = declare, window
        self._before: QWidget | None = None
        self._actions: tuple[PaletteEntry, ...] = ()
        build.styled(self, role="card", auto_fill_background=True)
        self.search = _Words()
        build.styled(
            self.search, max_length=100, placeholder_text=_("What do you want to do?"), name=_("Search all actions")
        )
        self.list = build.styled(
            QListWidget(),
            name=_("Actions"),
            focus_policy=Qt.FocusPolicy.NoFocus,
            horizontal_scroll_bar_policy=Qt.ScrollBarPolicy.ScrollBarAlwaysOff,
            text_elide_mode=Qt.TextElideMode.ElideRight,
        )
        build.column(self.search, (self.list, 1), margins=(8,), parent=self)
        self.search.textChanged.connect(self._fill)
        self.search.pressed.connect(self._take_key)
        self.search.escaped.connect(self.hide)
        self.list.itemClicked.connect(self._run)
        build.shortcut(window, PALETTE_KEY, self.toggle, Qt.ShortcutContext.WindowShortcut)
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
        self.search.clear()
        self._fill("")
        self.show()
        self.raise_()
        self.search.setFocus()

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
    def chosen(self) -> PaletteEntry | None:
        """The action that Return would take; None where that is not possible now."""
        item = self.list.currentItem()
        action: PaletteEntry | None = None if item is None else item.data(Qt.ItemDataRole.UserRole)
        return action

    def _close(self) -> None:
        self.hide()
        if self._before is not None and self._before.isVisible():
            self._before.setFocus()

    def _fill(self, text: str) -> None:
        """List what has every word; what is possible comes first."""
        wanted = text.casefold().split()
        matches = [
            (action.why_not(), action)
            for action in self._actions
            if action.offered() and all(word in f"{action.title} {action.keys}".casefold() for word in wanted)
        ]
        self.list.clear()
        for why_not, action in sorted(matches, key=lambda entry: bool(entry[0])):
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
        index = possible.index(row) + by if row in possible else 0
        self.list.setCurrentRow(possible[min(max(index, 0), len(possible) - 1)] if possible else -1)
        item = self.list.currentItem()
        self.search.setAccessibleDescription("" if item is None else item.text())

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
