"""What can be done in the window, each action declared once: for its shortcut and for the command palette."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

from PySide6.QtCore import Qt
from PySide6.QtGui import QKeySequence, QShortcut
from PySide6.QtWidgets import QAbstractButton, QScrollArea, QStackedWidget, QTabWidget, QWidget

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
class Action:
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


def declare(ui: Layout, panels: Panels, pages: Pages, window: QWidget) -> tuple[Action, ...]:
    """Return the actions of the window as it is now, with those of the pages that have been made."""
    own = [Action(ui.stop.accessibleName(), ui.stop.click, why_not=partial(_nothing_to_stop, ui))]
    own += [
        Action(button.accessibleName(), partial(pages.go, name), ui.rail.keys[name])
        for name, button in ui.rail.buttons.items()
    ]
    own += [
        Action(_("Help for this page"), panels.help_button.click, HELP_KEY),
        Action(_("Log of the window"), panels.log_button.click, LOG_KEY),
        Action(_("Close TissueID"), window.close, "Ctrl+Q"),
    ]
    for chooser in pages.start.choosers:
        choice = chooser.choice
        own += [
            Action(f"{chooser.name}: {choice.itemText(place)}", partial(choice.setCurrentIndex, place))
            for place in range(choice.count())
            if place != choice.currentIndex()
        ]
    own += [_by_button(pages, MEASURE, button, energises=True) for button in ui.energising]
    own += [_by_button(pages, MEASURE, button) for button in ui.harmless]
    own += [_by_button(pages, "", button) for button in (ui.open, ui.report)]
    for view in pages.views:
        own += [_by_button(pages, view.name, button) for button in view.buttons()]
    return tuple(own)


def install_shortcuts(actions: Iterable[Action], window: QWidget) -> None:
    """Make the shortcuts of the actions that have one."""
    for action in actions:
        if action.keys:
            shortcut = QShortcut(QKeySequence(action.keys), window)
            shortcut.setContext(Qt.ShortcutContext.ApplicationShortcut)
            shortcut.activated.connect(action.run)


def _nothing_to_stop(ui: Layout) -> str:
    return "" if ui.testing else sentence(translated(NO_TEST))


def _by_button(pages: Pages, page: str, button: QAbstractButton, *, energises: bool = False) -> Action:
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

    return Action(title, run, "", partial(_is_there, button), why_not, energises)


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
