"""What can be done in the window, each action declared once: for its shortcut and for the command palette."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from PySide6.QtCore import Qt
from PySide6.QtGui import QKeySequence, QShortcut
from PySide6.QtWidgets import QAbstractButton, QScrollArea, QStackedWidget, QTabWidget, QWidget

from tissueid.app.layout import MEASURE
from tissueid.app.panels import HELP_KEY, LOG_KEY
from tissueid.language import _

if TYPE_CHECKING:
    from tissueid.app.main_window import MainWindow

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


def declare(window: MainWindow) -> tuple[Action, ...]:
    """Return the actions of the window as it is now, with those of the pages that have been made."""
    ui = window.ui
    own = [Action(ui.stop.accessibleName(), ui.stop.click, why_not=partial(_nothing_to_stop, window))]
    own += [
        Action(button.accessibleName(), button.click, ui.rail.keys[name]) for name, button in ui.rail.buttons.items()
    ]
    own += [
        Action(_("Help for this page"), window.panels.help_button.click, HELP_KEY),
        Action(_("What happened so far"), window.panels.log_button.click, LOG_KEY),
        Action(_("Close TissueID"), window.close, "Ctrl+Q"),
    ]
    coil = ui.start, ui.gate.run_again, ui.gate.repeats.repeat, *ui.calibration.begin.values()
    free = ui.gate.repeats.accept, ui.guidance.lamp.watch, ui.form.instrument.refresh, ui.form.map, ui.result.pdf
    own += [_by_button(window, MEASURE, button, energises=True) for button in coil]
    own += [_by_button(window, MEASURE, button) for button in free]
    own += [_by_button(window, "", button) for button in (ui.open, ui.report)]
    for view in window.pages.views:
        own += [_by_button(window, view.name, button) for button in view.buttons()]
    return tuple(own)


def install_shortcuts(window: MainWindow) -> None:
    """Make the shortcuts of the actions that have one."""
    for action in declare(window):
        if action.keys:
            shortcut = QShortcut(QKeySequence(action.keys), window)
            shortcut.setContext(Qt.ShortcutContext.ApplicationShortcut)
            shortcut.activated.connect(action.run)


def _nothing_to_stop(window: MainWindow) -> str:
    return "" if window.testing else _("No test is running.")


def _by_button(window: MainWindow, page: str, button: QAbstractButton, *, energises: bool = False) -> Action:
    """Return the action that presses a button of a page, or that leads to it where it energises a coil."""
    name = button.accessibleName() or button.text().replace("&", "")
    title = f"{window.ui.rail.buttons[page].text()}: {name}" if page else name

    def run() -> None:
        if page:
            window.pages.show(page)
        _reveal(button)
        if energises:
            button.setFocus()
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


__all__ = ["PALETTE_KEY", "Action", "declare", "install_shortcuts"]
