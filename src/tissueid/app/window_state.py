"""What the window keeps between two starts: its state, and role, language, units, appearance and text size."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

from PySide6.QtCore import QByteArray, QLibraryInfo, QLocale, QSettings, QSize, Qt, QTranslator, Signal
from PySide6.QtGui import QPalette, QResizeEvent
from PySide6.QtWidgets import QLabel, QMainWindow, QSizePolicy, QVBoxLayout, QWidget

from tissueid.app import build
from tissueid.app.form import PlanForm
from tissueid.app.theme import DARK, LIGHT, Theme, theme_of
from tissueid.app.widgets import BigButton, labelled_row
from tissueid.audit import ROLES, Role
from tissueid.formatting import clean
from tissueid.language import ENGLISH, _, current_language, languages, marked
from tissueid.units import SYSTEMS, System, in_force, use

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
    values = {
        _GEOMETRY: window.saveGeometry(),
        _MAXIMISED: "yes" if window.isMaximized() else "no",
        _PANELS: window.saveState(_VERSION),
        _HELP: "no" if help_panel.isHidden() else "yes",
        _PAGE: page,
        _ROLE: role,
        _FOLD: "yes" if form.fold.isChecked() else "no",
        _INSTRUMENT: form.instrument.url,
        _LIMITS: form.limits.currentData(),
        _LIVE_METHOD: form.stimulus.live_method.currentData(),
    }
    for key, value in values.items():
        settings.setValue(key, value)


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
        if (index := choice.findData(_text(settings, key))) >= 0:
            choice.setCurrentIndex(index)


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
        self.choice = build.choice(entries, name=name)
        self.choice.setCurrentIndex(max(0, self.choice.findData(now)))
        labelled_row(self, name, self.choice)
        self.choice.currentIndexChanged.connect(self._keep)

    def _keep(self) -> None:
        self._settings.setValue(self._key, self.choice.currentData())
        self._settings.sync()
        self.chosen.emit()


def choosers(settings: QSettings) -> tuple[Chooser, Chooser, Chooser, Chooser]:
    """Return the choosers of language, units, appearance and text size."""
    kept = str(settings.value(LANGUAGE_SETTING, ""))
    language_names = languages()
    language = kept if kept in language_names else current_language()
    looks = {value: _(title) for value, title in APPEARANCES.items()}
    sizes = {value: f"{_(title)} ({value} %)" for value, title in TEXT_SIZES.items()}
    look, size = str(settings.value(APPEARANCE_SETTING, "")), str(settings.value(TEXT_SIZE_SETTING, ""))
    made = (
        Chooser(settings, LANGUAGE_SETTING, _("Language"), language_names, language),
        Chooser(settings, UNITS_SETTING, _("Units"), {name: _(NAMES[name]) for name in SYSTEMS}, in_force()),
        Chooser(settings, APPEARANCE_SETTING, _("Appearance"), looks, look),
        Chooser(settings, TEXT_SIZE_SETTING, _("Text size"), sizes, size),
    )
    tip = _("Units of plots and tables in the window; files and reports stay as they are")
    made[1].choice.setToolTip(tip)
    return made


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
        roles = {name: _(ROLE_NAMES[name]) for name in ROLES}
        tip = _("Actions are logged in this role; a technician can calibrate")
        self.choice = build.choice(roles, name=_("Role"), tip=tip)
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
        title = _(ROLE_NAMES[self.role])
        self._title.setText(_("{role} (current)").format(role=title) if taken else title)
        self.setAccessibleName(f"{self._title.text()}: {self._sentence}")
        build.restyle(self, taken=taken)

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
