"""The state of the window between two starts: everything except subject and site."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from PySide6.QtCore import QByteArray, QSettings
from PySide6.QtWidgets import QMainWindow, QWidget

from tissueid.app.form import PlanForm
from tissueid.audit import ROLES, Role
from tissueid.formatting import clean

_GEOMETRY = "window/geometry"
_MAXIMISED = "window/maximised"
_PANELS = "window/panels"
_HELP = "window/help"
_PAGE = "window/page"
_ROLE = "window/role"
_FOLD = "window/settings-unfolded"
_INSTRUMENT = "test/instrument"
_LIMITS = "test/limits"
_LIVE_METHOD = "test/live-method"
_STUDIES = "window/studies"
_MOST_STUDIES = 20
_LONGEST = 200
_VERSION = 3


def saved_role(settings: QSettings) -> Role:
    """Return the role of the last start; "clinician" at the first start."""
    kept = _text(settings, _ROLE)
    return next((role for role in ROLES if role == kept), "clinician")


def save_role(settings: QSettings, role: Role) -> None:
    """Save a role at once, so that it is restored after a crash, too."""
    settings.setValue(_ROLE, role)
    settings.sync()


def saved_page(settings: QSettings) -> str:
    """Return the name of the last page; empty at the first start."""
    return _text(settings, _PAGE)


def save_window_state(
    window: QMainWindow, form: PlanForm, help_panel: QWidget, page: str, role: Role, settings: QSettings
) -> None:
    """Save the window state. Write errors are ignored."""
    settings.setValue(_GEOMETRY, window.saveGeometry())
    settings.setValue(_MAXIMISED, "yes" if window.isMaximized() else "no")
    settings.setValue(_PANELS, window.saveState(_VERSION))
    settings.setValue(_HELP, "no" if help_panel.isHidden() else "yes")
    settings.setValue(_PAGE, page)
    settings.setValue(_ROLE, role)
    settings.setValue(_FOLD, "yes" if form.fold.isChecked() else "no")
    settings.setValue(_INSTRUMENT, form.instrument.url)
    settings.setValue(_LIMITS, form.limits.currentData())
    settings.setValue(_LIVE_METHOD, form.stimulus.live_method.currentData())


def restore_window_state(window: QMainWindow, form: PlanForm, help_panel: QWidget, settings: QSettings) -> None:
    """Restore the window state except page and role. Values that are no longer valid are ignored."""
    window.setProperty(_MAXIMISED, _text(settings, _MAXIMISED))
    geometry, panels = settings.value(_GEOMETRY), settings.value(_PANELS)
    if isinstance(geometry, QByteArray):
        window.restoreGeometry(geometry)
    if isinstance(panels, QByteArray):
        window.restoreState(panels, _VERSION)
    help_panel.setHidden(_text(settings, _HELP) != "yes")
    form.fold.setChecked(_text(settings, _FOLD) == "yes")
    if url := _text(settings, _INSTRUMENT):
        form.instrument.choose(url)
    for choice, key in ((form.limits, _LIMITS), (form.stimulus.live_method, _LIVE_METHOD)):
        if (place := choice.findData(_text(settings, key))) >= 0:
            choice.setCurrentIndex(place)


def show_window(window: QMainWindow) -> None:
    """Show a window, maximised if it was left so: not every system does this by the geometry alone."""
    if window.property(_MAXIMISED) == "yes":
        window.showMaximized()
    else:
        window.show()


def _text(settings: QSettings, key: str) -> str:
    """Return a setting as one line of text; the file may contain anything."""
    kept = settings.value(key, "")
    return clean(kept).strip()[:_LONGEST] if isinstance(kept, str) else ""


RESEARCH_FOLDERS = "research/folders"
"""Setting with the folders of sessions that were added on the page Research."""
_MOST_TEXTS = 200
_LONGEST_TEXT = 5000


def save_texts(settings: QSettings, name: str, texts: Sequence[str]) -> None:
    """Save texts as JSON, because QSettings may return a list of one text as a plain text."""
    settings.setValue(name, json.dumps(list(texts)))


def load_texts(settings: QSettings, name: str) -> list[str]:
    """Return texts saved by :func:`save_texts`; an empty list if the content is invalid."""
    try:
        texts = json.loads(str(settings.value(name, "[]")))
    except (ValueError, RecursionError):
        return []
    if not isinstance(texts, list) or len(texts) > _MOST_TEXTS:
        return []
    return [text for text in texts if isinstance(text, str) and len(text) <= _LONGEST_TEXT]


def visited_studies(settings: QSettings) -> list[Path]:
    """Return the folders of studies in which a subject was measured, the newest first."""
    return [Path(text) for text in load_texts(settings, _STUDIES)]


def keep_visited_study(settings: QSettings, folder: Path) -> None:
    """Keep the folder of a study in which a subject is measured."""
    others = [path for path in visited_studies(settings) if path != folder]
    save_texts(settings, _STUDIES, [str(path) for path in (folder, *others)][:_MOST_STUDIES])
