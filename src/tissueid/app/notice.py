"""A line of notices: what happened, and a button that offers what can be done."""

from __future__ import annotations

from collections.abc import Callable

from PySide6.QtCore import QPoint, QRect, QSize, Qt, Signal
from PySide6.QtGui import QAccessible, QAccessibleEvent, QMoveEvent, QResizeEvent
from PySide6.QtWidgets import QAbstractButton, QFrame, QHBoxLayout, QPushButton, QWidget

from tissueid.app import build
from tissueid.language import _

_MARGIN = 4
_HEIGHT = 34
"""A line of text and its buttons, pixels."""


class NoticeLine(QWidget):
    """The room that is kept for a notice, whether there is one or not: nothing moves when one comes or goes.

    A notice of several lines lies over what is below, from the top; it takes none of its room.
    """

    def __init__(self, notice: Notice, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._notice = notice
        self.setFixedHeight(_HEIGHT)
        notice.changed.connect(self._place)

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Keep the notice where this line is."""
        super().resizeEvent(event)
        self._place()

    def moveEvent(self, event: QMoveEvent) -> None:  # noqa: N802
        """Keep the notice where this line is."""
        super().moveEvent(event)
        self._place()

    def _place(self) -> None:
        over = self._notice.parentWidget()
        if over is None or not over.isAncestorOf(self):
            return
        width = self.width() - 2 * _MARGIN
        height = max(_HEIGHT - _MARGIN, self._notice.needed_height(width))
        self._notice.setGeometry(QRect(self.mapTo(over, QPoint(_MARGIN, 0)), QSize(width, height)))
        self._notice.raise_()


class Notice(QFrame):
    """Hidden until there is something to say. ``accepted`` is sent by the offered button.

    What is said belongs to the page on which it is said: news are gone once that is left, a problem and an offer are
    shown again when the user comes back to it.
    """

    accepted = Signal()
    changed = Signal()
    """Sent when the text is another one, which may need more or less room."""
    said = Signal(str, bool)
    """What was said, and whether it was a problem."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._page = ""
        self._pages: frozenset[str] | None = frozenset()
        self._lasts = self._about_form = self._passed = False
        self._act: Callable[[], object] | None = None
        self.setProperty("role", "notice")
        self.text = build.label()
        self.offer = QPushButton()
        self.dismiss = build.button(_("Dis&miss"), self.retract)
        layout = self._row = QHBoxLayout(self)
        layout.setContentsMargins(10, 1, 2, 1)
        layout.addWidget(self.text, 1)
        layout.addWidget(self.offer, 0, Qt.AlignmentFlag.AlignTop)
        layout.addWidget(self.dismiss, 0, Qt.AlignmentFlag.AlignTop)
        self.offer.clicked.connect(self._accept)
        self.hide()

    def needed_height(self, width: int) -> int:
        """Return the height in which all of the text can be read, pixels."""
        self.ensurePolished()
        self._row.activate()
        return self._row.totalMinimumHeightForWidth(width)

    def turn_to(self, page: str) -> None:
        """Switch to the notices of another page."""
        if page == self._page:
            return
        self._page = page
        if self._pages is None or page in self._pages:
            self.setVisible(self._lasts or not self.isHidden())
        elif self._lasts:
            self.hide()
        else:
            self.retract()

    def retract(self) -> None:
        """Remove the notice: it was read, or is no longer true."""
        self._pages, self._lasts, self._about_form = frozenset(), False, False
        self.hide()

    @property
    def holds_problem(self) -> bool:
        """Whether a problem is shown that was not dismissed."""
        return self._lasts and not self.isHidden()

    def watch(self, page: QWidget) -> None:
        """Let a notice go when another action begins by a button of a page: news at once, problems when it succeeds."""
        for button in page.findChildren(QAbstractButton):
            if not button.isCheckable() and not self.isAncestorOf(button):
                button.pressed.connect(self._action_begins)

    def _action_begins(self) -> None:
        if self.isHidden():
            return
        if self._lasts:
            self._passed = True
        else:
            self.retract()

    def action_succeeded(self) -> None:
        """Retract a problem that was there before the action; an offer and a defect stay until they are answered."""
        if self._passed and self._pages is not None and self.offer.isHidden():
            self.retract()

    def _accept(self) -> None:
        if self._act is None:
            self.accepted.emit()
        else:
            self._act()

    def form_changed(self) -> None:
        """What was wrong in the form may be right now."""
        if self._about_form:
            self.retract()

    def say_everywhere(self, text: str) -> None:
        """Show a problem that is one on every page, until it is dismissed."""
        self.say(text, problem=True)
        self._pages = None

    def say(
        self,
        text: str,
        *,
        problem: bool = False,
        offer: str = "",
        act: Callable[[], object] | None = None,
        page: str = "",
        about_form: bool = False,
    ) -> None:
        """Show a text, as a problem or as news, with a button that offers something if there is anything.

        The button calls ``act``, or sends ``accepted`` without one. What only it offers does not outlast the news.
        ``page`` is where it belongs besides the page that is shown. What is ``about_form`` goes when that is changed.
        """
        self._pages, self._passed = frozenset({self._page, page or self._page}), False
        self._lasts, self._about_form, self._act = problem or (bool(offer) and act is None), about_form, act
        build.restyle(self, level="problem" if problem else "news")
        self.text.setText(text)
        self.setAccessibleName(text)
        self.offer.setText(offer)
        self.offer.setVisible(bool(offer))
        self.changed.emit()
        self.show()
        self.said.emit(text, problem)
        QAccessible.updateAccessibility(QAccessibleEvent(self, QAccessible.Event.Alert))
