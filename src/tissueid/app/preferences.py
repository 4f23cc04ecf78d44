"""Language and units of the window: stored choices and their choosers."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from PySide6.QtCore import QLibraryInfo, QLocale, QSettings, QTranslator, Signal
from PySide6.QtWidgets import QComboBox, QWidget

from tissueid.app.widgets import labelled_row
from tissueid.language import ENGLISH, _, current_language, languages, marked
from tissueid.units import SYSTEMS, System, in_force, use

LANGUAGE_SETTING = "language"
"""Under which the choice is kept."""


def chosen(wanted: str, settings: QSettings) -> str:
    """The code of the language to speak: the one wanted, else the kept one, else the system's, else English."""
    kept = settings.value(LANGUAGE_SETTING, "")
    for code in (wanted, kept if isinstance(kept, str) else ""):
        if code:
            return code if code in languages() else ENGLISH
    code = QLocale.system().name().partition("_")[0]
    return code if code in languages() else ENGLISH


def qt_texts() -> QTranslator:
    """What Qt itself says in dialogs and menus, in the language of the window; empty where it has none."""
    translator = QTranslator()
    if current_language() != ENGLISH:
        translator.load(f"qtbase_{current_language()}", QLibraryInfo.path(QLibraryInfo.LibraryPath.TranslationsPath))
    return translator


@runtime_checkable
class FollowsUnits(Protocol):
    """A widget that shows figures."""

    def take_units(self) -> None:
        """Show the figures again in the active units."""


UNITS_SETTING = "units"
"""Under which the choice is kept."""


def take_kept(settings: QSettings) -> None:
    """Put the units of last time in force; whatever else stands there means clinical ones."""
    use(settings.value(UNITS_SETTING, ""))


def show_everywhere(window: QWidget) -> None:
    """Let everything in a window show its figures in the units in force."""
    for widget in window.findChildren(QWidget):
        if isinstance(widget, FollowsUnits):
            widget.take_units()


class LanguageChooser(QWidget):
    """A small chooser that keeps what is chosen in the settings; ``changed`` carries what is to be said about it."""

    changed = Signal(str)

    def __init__(self, settings: QSettings, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._settings = settings
        self.choice = QComboBox()
        for code, name in languages().items():
            self.choice.addItem(name, code)
        kept = self.choice.findData(settings.value(LANGUAGE_SETTING, ""))
        self.choice.setCurrentIndex(kept if kept >= 0 else self.choice.findData(current_language()))
        self.choice.setAccessibleName(_("Language"))
        self.choice.setToolTip(_("The language of the window, from its next start on"))
        labelled_row(self, _("Language"), self.choice).addStretch(1)
        self.choice.currentIndexChanged.connect(self._keep)

    def _keep(self) -> None:
        self._settings.setValue(LANGUAGE_SETTING, self.choice.currentData())
        self.changed.emit(_("{language} is taken on at the next start.").format(language=self.choice.currentText()))


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
        self._settings.setValue(UNITS_SETTING, in_force())
        show_everywhere(self.window())
