"""What the window finds again at the next start: all but subject and site, which the next test has others of."""

from __future__ import annotations

from typing import TYPE_CHECKING

from PySide6.QtCore import QByteArray, QSettings

from tissueid.audit import ROLES, Role
from tissueid.wording import clean

if TYPE_CHECKING:
    from tissueid.app.main_window import MainWindow

_GEOMETRY = "window/geometry"
_PANELS = "window/panels"
_PAGE = "window/page"
_ROLE = "window/role"
_FOLD = "window/settings-unfolded"
_INSTRUMENT = "test/instrument"
_LIMITS = "test/limits"
_LONGEST = 200
_VERSION = 2


def remembered_role(settings: QSettings) -> Role:
    """Who sat there last; at first a clinician."""
    kept = _text(settings, _ROLE)
    return next((role for role in ROLES if role == kept), "clinician")


def remember_role(settings: QSettings, role: Role) -> None:
    """Save a role as soon as it is chosen, so that it is the one in use after a crash too."""
    settings.setValue(_ROLE, role)
    settings.sync()


def remembered_page(settings: QSettings) -> str:
    """Which page was shown last; empty at the first start."""
    return _text(settings, _PAGE)


def remember(window: MainWindow, settings: QSettings) -> None:
    """Write it all down; what cannot be written is forgotten, and nothing else suffers."""
    form = window.ui.form
    settings.setValue(_GEOMETRY, window.saveGeometry())
    settings.setValue(_PANELS, window.saveState(_VERSION))
    settings.setValue(_PAGE, window.ui.page)
    settings.setValue(_ROLE, window.ui.role.role)
    settings.setValue(_FOLD, "yes" if form.fold.isChecked() else "no")
    settings.setValue(_INSTRUMENT, form.instrument.url)
    settings.remove("test/subject")  # kept by earlier versions
    settings.setValue(_LIMITS, form.limits.currentData())


def put_back(window: MainWindow, settings: QSettings) -> None:
    """Bring it all back but for page and role; what makes no sense any more stays as it is."""
    form = window.ui.form
    geometry, panels = settings.value(_GEOMETRY), settings.value(_PANELS)
    if isinstance(geometry, QByteArray):
        window.restoreGeometry(geometry)
    if isinstance(panels, QByteArray):
        window.restoreState(panels, _VERSION)
    form.fold.setChecked(_text(settings, _FOLD) == "yes")
    if url := _text(settings, _INSTRUMENT):
        form.instrument.choose(url)
    if (place := form.limits.findData(_text(settings, _LIMITS))) >= 0:
        form.limits.setCurrentIndex(place)


def _text(settings: QSettings, key: str) -> str:
    """A setting as one line of text: somebody may have written anything into the file."""
    kept = settings.value(key, "")
    return clean(kept).strip()[:_LONGEST] if isinstance(kept, str) else ""
