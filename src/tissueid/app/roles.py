"""The role of the user: it is logged with every action, and some roles see more controls."""

from __future__ import annotations

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QComboBox, QWidget

from tissueid.app.labelled_row import labelled_row
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
        self.choice = QComboBox()
        self.choice.setAccessibleName(_("Role"))
        self.choice.setToolTip(_("Actions are logged in this role; a technician can calibrate"))
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
