"""A person who presses the tab key until the focus is back where it began."""

from __future__ import annotations

from itertools import pairwise

from PySide6.QtCore import QCoreApplication, QPoint, QRect, Qt, QTimer
from PySide6.QtWidgets import QAbstractButton, QWidget

from tissueid.app.plot_canvas import PlotCanvas

MOST = 150
SAME_LINE = 12
"""Pixels."""


def named(widget):
    """A widget as a failing test tells it."""
    text = widget.text() if isinstance(widget, QAbstractButton) else ""
    return f"{type(widget).__name__} {widget.accessibleName() or text!r} at {place(widget).topLeft().toTuple()}"


def place(widget):
    """Where a widget is in its window."""
    return QRect(widget.mapTo(widget.window(), QPoint(0, 0)), widget.size())


def stops(window):
    """What the tab key has to visit: all that is there, takes the focus by it and is no part of another stop."""
    tab = Qt.FocusPolicy.TabFocus
    every = [
        widget
        for widget in window.findChildren(QWidget)
        if widget.focusPolicy() & tab == tab and widget.isVisibleTo(window) and widget.window() is window
    ]
    return [widget for widget in every if widget.isEnabled() and widget.focusProxy() is None]


def _settled(window):
    """Whether nothing that was put off is still to come: a canvas takes the focus from its first drawing on."""
    canvases = (canvas.pending for canvas in window.findChildren(PlotCanvas) if canvas.isVisible())
    delays = (timer.isActive() for timer in window.findChildren(QTimer) if timer.isSingleShot())
    return not any(canvases) and not any(delays)


def walked(qtbot, window, key=Qt.Key.Key_Tab):
    """All stops from the rail on, in order, until one comes again; that has to be the first."""
    QCoreApplication.processEvents()  # what was unfolded finds its place
    qtbot.waitUntil(lambda: _settled(window))
    first = window.ui.rail.buttons[window.ui.page]
    first.setFocus()
    seen = [first]
    for _ in range(MOST):
        qtbot.keyClick(window.focusWidget(), key)
        found = window.focusWidget()
        if found in seen:
            assert found is first, f"a trap: from {named(seen[-1])} to {named(found)}"
            return seen
        seen.append(found)
    raise AssertionError(f"no end after {MOST} steps")


def check_tabs(qtbot, window):
    """Every stop of the shown page is reached, in the order in which it is read, and the way back is the same."""
    seen = walked(qtbot, window)
    missed = [widget for widget in stops(window) if not any(at is widget or at.isAncestorOf(widget) for at in seen)]
    page = window.ui.stack.currentWidget()
    on_page = [widget for widget in seen if page.isAncestorOf(widget)]
    backwards = [f"{named(one)}, then {named(other)}" for one, other in pairwise(on_page) if not _reads_on(one, other)]
    nameless = [widget for widget in seen if not (widget.accessibleName() or _words(widget))]
    wrong = {"missed": missed, "nameless": nameless}
    told = {what: [named(widget) for widget in widgets] for what, widgets in wrong.items() if widgets}
    told |= {"against the order of reading": backwards} if backwards else {}
    assert not told, told
    back = walked(qtbot, window, Qt.Key.Key_Backtab)
    there_and_back = [[named(widget) for widget in seen], [named(widget) for widget in back]]
    assert back == [seen[0], *reversed(seen[1:])], there_and_back
    return seen


def _reads_on(one, other):
    """Whether one who reads comes from the one to the other: onwards on the line, further down, or in a next column."""
    before, after = place(one), place(other)
    if after.left() >= before.right() - SAME_LINE or before.contains(after):
        return True
    return after.top() > before.top() + SAME_LINE


def _words(widget):
    return widget.text() if isinstance(widget, QAbstractButton) else ""
