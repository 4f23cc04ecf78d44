"""Dialog that selects the effects to accept into a twin."""

from __future__ import annotations

from collections.abc import Sequence

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QCheckBox, QDialog, QDialogButtonBox, QVBoxLayout, QWidget

from tissueid.app import build
from tissueid.app.views.gap.displayed_text import as_title
from tissueid.language import _


class EffectDialog(QDialog):
    """A check box for each effect; ``chosen`` carries the names of the checked effects."""

    chosen = Signal(list)

    def __init__(self, offered: Sequence[tuple[str, str, bool]], parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle(_("Accept into twin"))
        about = build.label(
            text=_(
                "Which effects is the twin to have? Those that the diagnosis names are checked; another choice is "
                "fitted to the session first."
            )
        )
        self.boxes: dict[str, QCheckBox] = {}
        self.buttons = QDialogButtonBox()
        self.accept_button = self.buttons.addButton(_("Accept"), QDialogButtonBox.ButtonRole.AcceptRole)
        self.buttons.addButton(_("Cancel"), QDialogButtonBox.ButtonRole.RejectRole)
        column = QVBoxLayout(self)
        column.addWidget(about)
        for name, title, named in offered:
            if name in self.boxes:
                continue
            box = build.styled(QCheckBox(as_title(title).replace("&", "&&")), checked=named)
            box.toggled.connect(self._settle)
            self.boxes[name] = box
            column.addWidget(box)
        column.addWidget(self.buttons)
        self.buttons.accepted.connect(self.accept)
        self.buttons.rejected.connect(self.reject)
        self.accepted.connect(lambda: self.chosen.emit(self.names))

    @property
    def names(self) -> list[str]:
        """The names of the checked effects."""
        return [name for name, box in self.boxes.items() if box.isChecked()]

    def _settle(self) -> None:
        self.accept_button.setEnabled(bool(self.names))
