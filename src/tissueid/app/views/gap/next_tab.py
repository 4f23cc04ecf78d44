"""Which test would tell more, and a way to it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QFrame, QHBoxLayout, QLineEdit, QPushButton, QVBoxLayout, QWidget

from tissueid.app.language import _, marked
from tissueid.app.theme import Theme
from tissueid.app.views.gap.bars import BarTable
from tissueid.app.views.gap.labels import plain_label

if TYPE_CHECKING:
    from tissueid.app.views.gap.proposal import Proposal
    from tissueid.app.views.gap.story import Story

_NONE = {
    "no_gap": marked("No further test is needed: the twin is as good as this recording can tell."),
    "effect": marked("No further test is needed: one cause stands clear of its rivals, or no test would part them."),
    "unexplained": marked("No test on the menu would part the candidates: none of them explains the gap."),
}


class NextTab(QWidget):
    """``wanted`` says that the test is to be prepared, ``copied`` that the command was put on the clipboard."""

    wanted = Signal()
    copied = Signal(str)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.title = plain_label("headline")
        self.why = plain_label()
        self.by_hand = plain_label()
        self.prepare = QPushButton(_("Prepare this test"))
        self.prepare.setToolTip(_("Fill in the form of the guided test; nothing moves before you start it there"))
        self.command = QLineEdit()
        self.command.setReadOnly(True)
        self.command.setAccessibleName(_("Command line of the test"))
        self.copy = QPushButton(_("Copy"))
        self.copy.setAccessibleName(_("Copy the command line"))
        self.gains = BarTable(_("What each test would be worth"), (_("Test"), _("Worth (nats a channel)")), 1)
        if (head := self.gains.horizontalHeaderItem(1)) is not None:
            head.setToolTip(
                _(
                    "How clearly the test would tell the candidates apart: 3 is about twenty to one, less than 1 is "
                    "little"
                )
            )
        self.prepare.clicked.connect(self.wanted)
        self.copy.clicked.connect(self._copy)
        self._arrange()

    @property
    def fields(self) -> list[QWidget]:
        """What the tab key visits, in order."""
        return [self.prepare, self.command, self.copy, self.gains]

    def show_story(self, story: Story) -> None:
        """Show what a diagnosis would measure next."""
        step = story.proposal
        self.title.setText(_("Nothing to measure") if step is None else step.title)
        self.why.setText(_(_NONE[story.verdict]) if step is None else step.why)
        self.by_hand.setText("" if step is None else step.by_hand)
        self.by_hand.setVisible(bool(self.by_hand.text()))
        self.prepare.setVisible(step is not None and step.fields is not None)
        line = "" if step is None else step.command_line
        self.command.setText(line)
        self.command.setCursorPosition(0)
        for widget in (self.command, self.copy):
            widget.setVisible(bool(line))
        self.gains.setVisible(step is not None)
        if step is not None:
            self._show_gains(step)

    def paint_with(self, theme: Theme) -> None:
        """Take on the colours of a theme."""
        self.gains.paint_with(theme)

    def _show_gains(self, step: Proposal) -> None:
        most = max((gain for _, gain in step.gains), default=0.0) or 1.0
        self.gains.fill([((words, f"{gain:.2f}"), gain / most, words == step.title) for words, gain in step.gains])

    def _copy(self) -> None:
        self.copied.emit(self.command.text())

    def _arrange(self) -> None:
        card = QFrame()
        card.setProperty("role", "card")
        column = QVBoxLayout(card)
        column.setContentsMargins(12, 8, 12, 10)
        column.setSpacing(8)
        for label in (self.title, self.why, self.by_hand):
            column.addWidget(label)
        buttons = QHBoxLayout()
        buttons.addWidget(self.prepare)
        buttons.addStretch(1)
        column.addLayout(buttons)
        line = QHBoxLayout()
        line.addWidget(self.command, 1)
        line.addWidget(self.copy)
        column.addLayout(line)
        column.addStretch(1)
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 6, 0, 0)
        row.setSpacing(8)
        row.addWidget(card, 1)
        row.addWidget(self.gains, 1)
