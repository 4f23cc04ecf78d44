"""Which language the window speaks, and what Qt itself says in it."""

from __future__ import annotations

from PySide6.QtCore import QLibraryInfo, QLocale, QSettings, QTranslator

from tissueid.language import ENGLISH, current_language, languages

SETTING = "language"
"""Under which the choice is kept."""


def chosen(wanted: str, settings: QSettings) -> str:
    """The code of the language to speak: the one wanted, else the kept one, else the system's, else English."""
    kept = settings.value(SETTING, "")
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
