"""A strip that says in words what happened, and offers what can be done about it."""

from __future__ import annotations

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QAccessible, QAccessibleEvent
from PySide6.QtWidgets import QFrame, QHBoxLayout, QLabel, QPushButton, QWidget

from tissueid.app.language import _


class Notice(QFrame):
    """Hidden until there is something to say. ``accepted`` is sent by the offered button."""

    accepted = Signal()
    said = Signal(str, bool)
    """What was said, and whether it was a problem."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setProperty("role", "notice")
        self.text = QLabel()
        self.text.setWordWrap(True)
        self.text.setMinimumWidth(1)
        self.text.setTextFormat(Qt.TextFormat.PlainText)
        self.text.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.offer = QPushButton()
        self.dismiss = QPushButton(_("Dis&miss"))
        layout = QHBoxLayout(self)
        layout.setContentsMargins(12, 8, 8, 8)
        layout.addWidget(self.text, 1)
        layout.addWidget(self.offer, 0, Qt.AlignmentFlag.AlignTop)
        layout.addWidget(self.dismiss, 0, Qt.AlignmentFlag.AlignTop)
        self.offer.clicked.connect(self.accepted)
        self.dismiss.clicked.connect(self.hide)
        self.hide()

    def say(self, text: str, *, problem: bool = False, offer: str = "") -> None:
        """Show a text, as a problem or as news, with a button that offers something if there is anything."""
        self.setProperty("level", "problem" if problem else "news")
        self.style().unpolish(self)
        self.style().polish(self)
        self.text.setText(text)
        self.setAccessibleName(text)
        self.offer.setText(offer)
        self.offer.setVisible(bool(offer))
        self.show()
        self.said.emit(text, problem)
        QAccessible.updateAccessibility(QAccessibleEvent(self, QAccessible.Event.Alert))
