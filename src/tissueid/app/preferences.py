"""Language, units, appearance and text size of the window: stored choices and their choosers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

from PySide6.QtCore import QLibraryInfo, QLocale, QSettings, QTranslator, Signal
from PySide6.QtGui import QPalette
from PySide6.QtWidgets import QComboBox, QWidget

from tissueid.app.theme import DARK, LIGHT, Theme, theme_of
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


NAMES: dict[System, str] = {"clinical": marked("Clinical (mm, g)"), "si": marked("SI (m, kg)")}
APPEARANCE_SETTING, TEXT_SIZE_SETTING = "appearance", "text_size"
APPEARANCES = {"": marked("As the system"), "light": marked("Light"), "dark": marked("Dark")}
TEXT_SIZES = {"100": marked("Normal"), "115": marked("Large"), "130": marked("Larger")}


def chosen_theme(settings: QSettings, palette: QPalette) -> Theme:
    """Return the theme that was chosen, else that of the system's palette."""
    return {"light": LIGHT, "dark": DARK}.get(str(settings.value(APPEARANCE_SETTING, ""))) or theme_of(palette)


def text_scale(settings: QSettings) -> float:
    """Return how much larger than usual texts are."""
    kept = str(settings.value(TEXT_SIZE_SETTING, ""))
    return float(kept) / 100.0 if kept in TEXT_SIZES else 1.0


class Chooser(QWidget):
    """A small chooser that keeps what is chosen in the settings; ``chosen`` is sent for a new choice."""

    chosen = Signal()

    def __init__(self, settings: QSettings, key: str, name: str, entries: Mapping[str, str], now: str) -> None:
        super().__init__()
        self._settings, self._key = settings, key
        self.name = name
        self.choice = QComboBox()
        for value, words in entries.items():
            self.choice.addItem(words, value)
        self.choice.setCurrentIndex(max(0, self.choice.findData(now)))
        self.choice.setAccessibleName(name)
        labelled_row(self, name, self.choice)
        self.choice.currentIndexChanged.connect(self._keep)

    def _keep(self) -> None:
        self._settings.setValue(self._key, self.choice.currentData())
        self._settings.sync()
        self.chosen.emit()


def choosers(settings: QSettings) -> tuple[Chooser, Chooser, Chooser, Chooser]:
    """Return the choosers of language, units, appearance and text size."""
    kept = str(settings.value(LANGUAGE_SETTING, ""))
    known = languages()
    language = kept if kept in known else current_language()
    looks = {value: _(words) for value, words in APPEARANCES.items()}
    sizes = {value: f"{_(words)} ({value} %)" for value, words in TEXT_SIZES.items()}
    look, size = str(settings.value(APPEARANCE_SETTING, "")), str(settings.value(TEXT_SIZE_SETTING, ""))
    made = (
        Chooser(settings, LANGUAGE_SETTING, _("Language"), known, language),
        Chooser(settings, UNITS_SETTING, _("Units"), {name: _(NAMES[name]) for name in SYSTEMS}, in_force()),
        Chooser(settings, APPEARANCE_SETTING, _("Appearance"), looks, look),
        Chooser(settings, TEXT_SIZE_SETTING, _("Text size"), sizes, size),
    )
    tip = _("Units of plots and tables in the window; files and reports stay as they are")
    made[1].choice.setToolTip(tip)
    return made
