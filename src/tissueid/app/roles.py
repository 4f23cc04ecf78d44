"""The role of the user, its chooser and its cards. The role is logged, and some roles see more controls."""

from __future__ import annotations

from PySide6.QtCore import QSize, Qt, Signal
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QComboBox, QLabel, QSizePolicy, QVBoxLayout, QWidget

from tissueid.app import build
from tissueid.app.widgets import BigButton, labelled_row
from tissueid.audit import ROLES, Role
from tissueid.language import _, marked

ROLE_NAMES: dict[Role, str] = {
    "clinician": marked("Clinician"),
    "researcher": marked("Researcher"),
    "technician": marked("Technician"),
}


class RoleChooser(QWidget):
    """A chooser of roles; ``changed`` carries the previous and the new role."""

    changed = Signal(str, str)

    def __init__(self, role: Role, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._role: Role = role
        self.choice = build.styled(
            QComboBox(), name=_("Role"), tip=_("Actions are logged in this role; a technician can calibrate")
        )
        for name in ROLES:
            self.choice.addItem(_(ROLE_NAMES[name]), name)
        self.choice.setCurrentIndex(self.choice.findData(role))
        labelled_row(self, _("Role"), self.choice, role="muted", spacing=6)
        self.choice.currentIndexChanged.connect(self._change)

    @property
    def role(self) -> Role:
        """The chosen role."""
        return self._role

    def _change(self) -> None:
        before, self._role = self._role, self.choice.currentData()
        if before != self._role:
            self.changed.emit(before, self._role)


class RoleCard(BigButton):
    """A button with a title and a sentence."""

    def __init__(self, role: Role, sentence: str, parent: QWidget | None = None) -> None:
        super().__init__("", parent)
        self.role: Role = role
        self._sentence = sentence
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Minimum)
        self._title = build.styled(QLabel(_(ROLE_NAMES[role])), role="headline")
        self._text = build.styled(
            QLabel(sentence),
            word_wrap=True,
            minimum_width=1,
            alignment=Qt.AlignmentFlag.AlignTop | Qt.AlignmentFlag.AlignLeft,
        )
        layout = QVBoxLayout(self)
        layout.setContentsMargins(16, 10, 14, 12)
        layout.setSpacing(4)
        for label in (self._title, self._text):
            label.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
            layout.addWidget(label)
        layout.addStretch(1)
        self.show_taken(False)

    def show_taken(self, taken: bool) -> None:
        """Show whether this is the current role."""
        self.setProperty("taken", taken)
        title = _(ROLE_NAMES[self.role])
        self._title.setText(_("{role} (current)").format(role=title) if taken else title)
        self.setAccessibleName(f"{self._title.text()}: {self._sentence}")
        self.style().unpolish(self)
        self.style().polish(self)

    def sizeHint(self) -> QSize:  # noqa: N802
        """Return the height that the description needs at the present width."""
        layout = self.layout()
        assert layout is not None
        return QSize(240, layout.heightForWidth(max(200, self.width())))

    def minimumSizeHint(self) -> QSize:  # noqa: N802
        """A third of the smallest window."""
        return QSize(200, self.sizeHint().height())

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """At another width the sentence needs another height."""
        super().resizeEvent(event)
        if event.size().width() != event.oldSize().width():
            self.updateGeometry()
