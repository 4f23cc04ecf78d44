"""Chooser of the units of the window, which change at once and are stored."""

from __future__ import annotations

from PySide6.QtCore import QSettings
from PySide6.QtWidgets import QComboBox, QWidget

from tissueid.app.labelled_row import labelled_row
from tissueid.app.unit_choice import SETTING, show_everywhere
from tissueid.language import _, marked
from tissueid.units import SYSTEMS, System, in_force, use

NAMES: dict[System, str] = {"clinical": marked("Clinical (mm, g)"), "si": marked("SI (m, kg)")}


class UnitChooser(QWidget):
    """A small chooser that keeps what is chosen in the settings and shows it in the whole window."""

    def __init__(self, settings: QSettings, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._settings = settings
        self.choice = QComboBox()
        for system in SYSTEMS:
            self.choice.addItem(_(NAMES[system]), system)
        self.choice.setCurrentIndex(self.choice.findData(in_force()))
        self.choice.setAccessibleName(_("Units"))
        self.choice.setToolTip(_("Units of plots and tables in the window; files and reports stay as they are"))
        labelled_row(self, _("Units"), self.choice)
        self.choice.currentIndexChanged.connect(self._take)

    def _take(self) -> None:
        use(self.choice.currentData())
        self._settings.setValue(SETTING, in_force())
        show_everywhere(self.window())
