"""The contact light: a large lamp with words, and what watches the probe before a test."""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtGui import QAccessible, QAccessibleEvent
from PySide6.QtWidgets import QCheckBox, QHBoxLayout, QLabel, QPushButton, QWidget

from tissueid.acquisition.contact import Contact
from tissueid.language import _


class ContactLamp(QWidget):
    """A light in the colour of what it says. ``watch`` and ``arm`` are for before a test."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.contact: Contact | None = None
        self.light = QLabel("●")
        self.light.setStyleSheet("font-size: 24pt;")
        self.words = QLabel()
        for label in (self.light, self.words):
            label.setProperty("role", "headline")
            label.setTextFormat(Qt.TextFormat.PlainText)
        self.words.setWordWrap(True)
        self.words.setMinimumWidth(1)
        self.watch = QPushButton(_("Watch contact"))
        self.watch.setCheckable(True)
        self.watch.setToolTip(_("Read the instrument before the test; its coil stays free"))
        self.arm = QCheckBox(_("Start by the instrument's button"))
        self.arm.setToolTip(_("Press the button and let go of it: the test starts. During the test it stops."))
        self.arm.hide()
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        row.setSpacing(8)
        row.addWidget(self.light)
        row.addWidget(self.words, 1)
        row.addWidget(self.arm)
        row.addWidget(self.watch)
        self.setMinimumHeight(34)
        self.show_contact(Contact.UNWATCHED)

    def quiet(self, on: bool) -> None:
        """Hide the text after a test: the instruction next to the lamp is sufficient."""
        self.light.setVisible(not on)
        self.words.setVisible(not on)

    def show_contact(self, contact: Contact) -> None:
        """Show how the probe stands."""
        if contact is self.contact:
            return
        self.contact = contact
        self.words.setText(_(contact.value))
        self.words.setAccessibleName(_("Contact: {words}").format(words=_(contact.value)))
        for label in (self.light, self.words):
            label.setProperty("role", "muted" if contact is Contact.UNWATCHED else "headline")
            label.setProperty("level", contact.level)
            label.style().unpolish(label)
            label.style().polish(label)
        if contact.level:
            QAccessible.updateAccessibility(QAccessibleEvent(self.words, QAccessible.Event.NameChanged))
