"""Chooser of the language of the window, which changes at the next start."""

from __future__ import annotations

from PySide6.QtCore import QSettings, Signal
from PySide6.QtWidgets import QComboBox, QWidget

from tissueid.app.labelled_row import labelled_row
from tissueid.app.language_choice import SETTING
from tissueid.language import _, current_language, languages


class LanguageChooser(QWidget):
    """A small chooser that keeps what is chosen in the settings; ``changed`` carries what is to be said about it."""

    changed = Signal(str)

    def __init__(self, settings: QSettings, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._settings = settings
        self.choice = QComboBox()
        for code, name in languages().items():
            self.choice.addItem(name, code)
        kept = self.choice.findData(settings.value(SETTING, ""))
        self.choice.setCurrentIndex(kept if kept >= 0 else self.choice.findData(current_language()))
        self.choice.setAccessibleName(_("Language"))
        self.choice.setToolTip(_("The language of the window, from its next start on"))
        labelled_row(self, _("Language"), self.choice).addStretch(1)
        self.choice.currentIndexChanged.connect(self._keep)

    def _keep(self) -> None:
        self._settings.setValue(SETTING, self.choice.currentData())
        self.changed.emit(_("{language} is taken on at the next start.").format(language=self.choice.currentText()))
