"""Colours and the one style sheet, for light and dark palettes alike."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import asdict, dataclass
from string import Template

from PySide6.QtCore import QEvent, QObject, Signal
from PySide6.QtGui import QColor, QFont, QPalette
from PySide6.QtWidgets import QApplication, QWidget


@dataclass(frozen=True)
class Theme:
    """Colours by what they are for."""

    window: str
    panel: str
    text: str
    muted: str
    line: str
    edge: str
    field: str
    accent: str
    accent_text: str
    accent_hover: str
    stop: str
    stop_hover: str
    measured: str
    model: str
    good: str
    check: str
    amber: str
    """The level "check" of lights and borders: too bright for a text."""
    poor: str


LIGHT = Theme(
    window="#f4f6f7",
    panel="#ffffff",
    text="#1d252b",
    muted="#56636c",
    line="#d5dce0",
    edge="#b8c2c8",
    field="#ffffff",
    accent="#12617a",
    accent_text="#ffffff",
    accent_hover="#0d4f64",
    stop="#b3261e",
    stop_hover="#8f1d17",
    measured="#1f6f9f",
    model="#c25400",
    good="#1c7a4d",
    check="#9a6200",
    amber="#c97a00",
    poor="#b3261e",
)
DARK = Theme(
    window="#1b2024",
    panel="#232a2f",
    text="#e6eaec",
    muted="#a3afb6",
    line="#3b454c",
    edge="#55626b",
    field="#2b3339",
    accent="#2f8ca8",
    accent_text="#ffffff",
    accent_hover="#3ba0bf",
    stop="#c8372d",
    stop_hover="#dd4a3f",
    measured="#62b3e4",
    model="#f2a155",
    good="#58c491",
    check="#e0ac4a",
    amber="#e0ac4a",
    poor="#f0786e",
)

_SHEET = Template("""
QToolTip { color: $text; background: $panel; border: 1px solid $line; padding: 3px; }
QLabel { background: transparent; }
QLabel[role="title"] { font-size: 15pt; font-weight: 600; }
QLabel[role="muted"] { color: $muted; }
QLabel[role="field"] { color: $muted; font-size: 9pt; }
QLabel[role="readout"] { font-size: 9pt; }
QLabel[role="readout"][level="good"] { color: $good; }
QLabel[role="readout"][level="check"] { color: $check; font-weight: 600; }
QLabel[role="readout"][level="poor"] { color: $poor; font-weight: 600; }
QLabel[role="hint"] { background: $panel; color: $check; border: 1px solid $check; border-radius: 3px;
    padding: 2px 6px; }
QLabel[role="heading"] { font-weight: 600; font-size: 9pt; }
QLabel[role="research"] { color: $muted; border: 1px solid $line; border-radius: 9px; padding: 2px 10px; }
QLabel[role="instruction"] { font-size: 14pt; }
QLabel[role="value"] { font-size: 16pt; font-weight: 600; }
QLabel[role="value"][level="poor"] { font-size: 11pt; font-weight: 400; color: $muted; }
QLabel[role="headline"], QLabel[role="light"] { font-size: 13pt; font-weight: 600; }
QLabel[role="headline"][level="good"], QLabel[role="light"][level="good"] { color: $good; }
QLabel[role="headline"][level="check"] { color: $check; }
QLabel[role="headline"][level="poor"], QLabel[role="light"][level="poor"] { color: $poor; }
QLabel[role="light"][level="check"] { color: $amber; }
QFrame[role="card"] { background: $panel; border: 1px solid $line; border-radius: 6px; }
QFrame[role="rail"] { background: $panel; border: none; border-right: 1px solid $line; }
QToolButton[role="rail"] { background: transparent; color: $muted; border: none; border-left: 3px solid transparent;
    padding: 9px 6px; }
QToolButton[role="rail"]:hover { color: $text; }
QToolButton[role="rail"]:checked { color: $text; font-weight: 600; border-left-color: $accent; background: $window; }
QToolButton[role="rail"]:focus { border: 1px solid $accent; border-left: 3px solid $accent; }
QPushButton[role="halt"] { background: $stop; color: #ffffff; border: 2px solid $stop; font-weight: 600; }
QPushButton[role="halt"]:hover { background: $stop_hover; border-color: $stop_hover; }
QFrame[role="side"] { border: none; border-right: 1px solid $line; }
QFrame[role="header"] { background: $panel; border: none; border-bottom: 1px solid $line; }
QFrame[role="notice"] { background: $panel; border: 1px solid $line; border-left: 4px solid $accent; }
QFrame[role="notice"][level="problem"] { border-left-color: $poor; }
QFrame[role="verdict"] { background: $panel; border: 1px solid $line; border-left: 5px solid $line; }
QFrame[role="verdict"][level="good"] { border-left-color: $good; }
QFrame[role="verdict"][level="check"] { border-left-color: $amber; }
QFrame[role="verdict"][level="poor"] { border-left-color: $poor; }
QLabel[role="phase"] { color: $muted; border: none; border-bottom: 3px solid $line; padding: 1px 2px 4px 2px; }
QLabel[role="phase"][state="now"] { color: $text; font-weight: 600; border-bottom-color: $accent; }
QLabel[role="phase"][state="done"] { color: $text; border-bottom-color: $good; }
QPushButton { background: $panel; border: 1px solid $edge; border-radius: 4px; padding: 3px 12px;
    min-height: 18px; }
QPushButton:hover { border-color: $accent; }
QPushButton:focus { border: 2px solid $accent; padding: 2px 11px; }
QPushButton[role="small"] { padding: 0px 10px; min-height: 16px; }
QPushButton[role="small"]:focus { padding: 0px 9px; }
QPushButton[role="toggle"]:checked { border-color: $accent; color: $accent; background: $window; }
QPushButton:disabled { color: $muted; background: $window; border-color: $line; }
QAbstractSpinBox[level="check"] { color: $check; font-weight: 600; }
QComboBox[level="poor"] { color: $poor; font-weight: 600; }
QComboBox QAbstractItemView { background: $panel; color: $text; selection-background-color: $accent;
    selection-color: $accent_text; }
QToolButton[role="fold"] { background: transparent; border: 1px solid transparent; padding: 2px 6px 2px 0px; }
QToolButton[role="fold"]:focus { border: 1px solid $accent; }
QPushButton[role="start"] { background: $accent; color: $accent_text; border: 2px solid $accent; font-size: 14pt;
    font-weight: 600; padding: 8px; }
QPushButton[role="start"]:hover { background: $accent_hover; border-color: $accent_hover; }
QPushButton[role="start"]:focus { border: 2px solid $text; padding: 8px; }
QPushButton[role="start"]:disabled { background: $window; color: $muted; border: 2px solid $line; }
QPushButton[role="stop"] { background: $stop; color: #ffffff; border: 2px solid $stop; font-size: 13pt;
    font-weight: 600; padding: 8px; }
QPushButton[role="stop"]:hover { background: $stop_hover; border-color: $stop_hover; }
QPushButton[role="stop"]:focus { border: 2px solid $text; padding: 8px; }
QCheckBox::indicator:unchecked { width: 11px; height: 11px; border: 1px solid $edge; background: $field; }
QProgressBar { background: $line; border: none; border-radius: 3px; max-height: 6px; min-height: 6px; }
QProgressBar::chunk { background: $accent; border-radius: 3px; }
QTabWidget::pane { border: none; }
QTabBar::tab { background: transparent; color: $muted; border: 1px solid transparent;
    border-bottom: 2px solid transparent; padding: 1px 13px 5px 13px; }
QTabBar::tab:selected { color: $text; border-bottom-color: $accent; font-weight: 600; }
QTabBar::tab:focus { color: $accent; border: 1px solid $accent; border-bottom: 2px solid $accent; }
RoleCard { background: $panel; border: 1px solid $edge; border-radius: 6px; }
RoleCard[taken="true"] { border-left: 5px solid $accent; }
RoleCard:hover { border-color: $accent; }
RoleCard:focus { border: 2px solid $accent; }
RoleCard[taken="true"]:focus { border-left: 5px solid $accent; }
Rows { background: $panel; color: $text; border: 1px solid $line; border-radius: 6px;
    selection-background-color: $accent; selection-color: $accent_text; outline: none; }
Rows:focus { border: 1px solid $accent; }
Rows::item { padding: 4px 0px; }
Rows::item:selected { background: $accent; color: $accent_text; }
Rows QHeaderView { background: $panel; }
Rows QHeaderView::section { background: $panel; color: $muted; border: none; border-bottom: 1px solid $line;
    padding: 3px 4px; }
HelpText { background: $panel; color: $text; border: none; }
""")


class Appearance(QObject):
    """The active theme and text size; ``changed`` is sent for others.

    What is painted by Qt with the palette is painted again at a change. Widgets that put colours into texts, items or
    plots :meth:`follow` it.
    """

    changed = Signal()

    def __init__(self) -> None:
        super().__init__()
        self.theme, self.scale = LIGHT, 1.0

    def use(self, theme: Theme, scale: float = 1.0) -> None:
        """Apply a theme, and texts that are ``scale`` times as large as usual."""
        if (theme, scale) != (self.theme, self.scale):
            self.theme, self.scale = theme, scale
            self.changed.emit()

    def follow(self, paint: Callable[[], object]) -> None:
        """Call a method of a widget now and after every change."""
        paint()
        self.changed.connect(paint)

    def font(self, share: float = 1.0) -> QFont:
        """Return the font of the window, ``share`` times as large."""
        font = QApplication.font()
        font.setPointSizeF(share * self.scale * font.pointSizeF())
        return font


appearance = Appearance()
"""The appearance of the windows of this process."""


class PaletteWatch(QWidget):
    """A hidden widget without a style sheet: one with a style sheet gets no event when the system's palette changes."""

    changed = Signal()

    def changeEvent(self, event: QEvent) -> None:  # noqa: N802
        """Pass the change of a palette on."""
        super().changeEvent(event)
        if event.type() == QEvent.Type.PaletteChange:
            self.changed.emit()


def theme_of(palette: QPalette) -> Theme:
    """The theme that goes with a palette: dark when its windows are darker than its text."""
    background = palette.color(QPalette.ColorRole.Window)
    text = palette.color(QPalette.ColorRole.WindowText)
    return DARK if background.lightness() < text.lightness() else LIGHT


def palette_of(theme: Theme) -> QPalette:
    """Return the palette of the standard controls for ``theme``."""
    role = QPalette.ColorRole
    colours = {
        role.Window: theme.window,
        role.WindowText: theme.text,
        role.Base: theme.field,
        role.AlternateBase: theme.window,
        role.Text: theme.text,
        role.Button: theme.panel,
        role.ButtonText: theme.text,
        role.BrightText: theme.accent_text,
        role.PlaceholderText: theme.muted,
        role.Highlight: theme.accent,
        role.HighlightedText: theme.accent_text,
        role.ToolTipBase: theme.panel,
        role.ToolTipText: theme.text,
        role.Link: theme.accent,
    }
    palette = QPalette(QColor(theme.panel), QColor(theme.window))
    for name, colour in colours.items():
        palette.setColor(name, QColor(colour))
    for name in (role.WindowText, role.Text, role.ButtonText):
        palette.setColor(QPalette.ColorGroup.Disabled, name, QColor(theme.muted))
    palette.setColor(QPalette.ColorGroup.Disabled, role.Base, QColor(theme.window))
    return palette


def style_sheet(theme: Theme, scale: float = 1.0) -> str:
    """Return the style sheet of the window, with texts that are ``scale`` times as large as usual."""
    sheet = _SHEET.substitute(asdict(theme))
    return re.sub(r"(\d+)pt", lambda size: f"{scale * float(size[1]):g}pt", sheet)


def faint(colour: str, alpha: int) -> QColor:
    """A colour let through to ``alpha`` of 255."""
    faded = QColor(colour)
    faded.setAlpha(alpha)
    return faded
