"""Build widgets in the order in which they are seen: rows, columns, labels, buttons and tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from PySide6.QtCore import QObject, QSignalBlocker, Qt, QTimer, SignalInstance
from PySide6.QtGui import QAction, QKeySequence, QShortcut
from PySide6.QtWidgets import (
    QBoxLayout,
    QComboBox,
    QFileDialog,
    QGridLayout,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QLayout,
    QMenu,
    QProgressBar,
    QPushButton,
    QSplitter,
    QStackedWidget,
    QTableView,
    QTableWidget,
    QTabWidget,
    QVBoxLayout,
    QWidget,
)

from tissueid.language import _

Item = QWidget | QLayout | None
"""A part of a row or column; None is a stretch."""
AnyObject = TypeVar("AnyObject", bound=QObject)
AnyWidget = TypeVar("AnyWidget", bound=QWidget)
Box = TypeVar("Box", bound=QBoxLayout)
AnyTable = TypeVar("AnyTable", bound=QTableView)


def fill(box: Box, *items: Item | tuple[Item, int], spacing: int | None = 6, margins: Sequence[int] = (0,)) -> Box:
    """Fill a box with items, each with its stretch if it has one. One margin is that of all sides.

    Without a ``spacing`` it takes that of the layout it is put into.
    """
    if spacing is not None:
        box.setSpacing(spacing)
    box.setContentsMargins(*(margins if len(margins) == 4 else [margins[0]] * 4))
    for entry in items:
        item, stretch = entry if isinstance(entry, tuple) else (entry, 0)
        if item is None:
            box.addStretch(1)
        elif isinstance(item, QWidget):
            box.addWidget(item, stretch)
        else:
            box.addLayout(item, stretch)
    return box


def row(
    *items: Item | tuple[Item, int],
    spacing: int | None = 6,
    margins: Sequence[int] = (0,),
    parent: QWidget | None = None,
) -> QHBoxLayout:
    """Return a row of items, the layout of ``parent`` if there is one."""
    box = QHBoxLayout() if parent is None else QHBoxLayout(parent)
    return fill(box, *items, spacing=spacing, margins=margins)


def column(
    *items: Item | tuple[Item, int],
    spacing: int | None = 6,
    margins: Sequence[int] = (0,),
    parent: QWidget | None = None,
) -> QVBoxLayout:
    """Return a column of items, the layout of ``parent`` if there is one."""
    box = QVBoxLayout() if parent is None else QVBoxLayout(parent)
    return fill(box, *items, spacing=spacing, margins=margins)


def styled(widget: AnyObject, /, **properties: Any) -> AnyObject:
    """Set properties of a widget: ``tip``, ``name`` (for screen readers), those of the style sheet, and those of Qt.

    ``word_wrap=True`` calls ``setWordWrap(True)``, ``range=(0, 9)`` calls ``setRange(0, 9)``. ``clicked`` is called,
    or sent, by a button.
    """
    for key, value in properties.items():
        if key in STYLE_PROPERTIES:
            widget.setProperty(key, value)
        elif key == "clicked":
            widget.clicked.connect(value)  # type: ignore[attr-defined]
        else:
            set_value = getattr(widget, _SETTERS.get(key) or "set" + key.title().replace("_", ""))
            set_value(*value) if isinstance(value, tuple) else set_value(value)
    return widget


def restyle(widget: AnyWidget, /, **properties: Any) -> AnyWidget:
    """Set properties of a widget that is shown, and apply the style sheet to it again."""
    styled(widget, **properties)
    widget.style().unpolish(widget)
    widget.style().polish(widget)
    return widget


STYLE_PROPERTIES = ("role", "level", "state", "taken")
"""Properties that the style sheet asks for."""
_SETTERS = {"tip": "setToolTip", "name": "setAccessibleName"}


def label(role: str = "", text: str = "", **properties: Any) -> QLabel:
    """Return a label that wraps plain text and allows copying."""
    made = QLabel(text, wordWrap=True, textFormat=Qt.TextFormat.PlainText)
    made.setMinimumWidth(1)
    made.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
    return styled(made, role=role, **properties) if role else styled(made, **properties)


def button(text: str, clicked: Callable[[], object] | SignalInstance | None = None, **properties: Any) -> QPushButton:
    """Return a button, and what it calls or sends."""
    made = styled(QPushButton(text), **properties)
    if clicked is not None:
        made.clicked.connect(clicked)
    return made


def choice(
    entries: Mapping[Any, str],
    changed: Callable[[], object] | SignalInstance | None = None,
    characters: int | None = None,
    **properties: Any,
) -> QComboBox:
    """Return a combo box with a text for each value, and what it calls or sends when another one is chosen.

    It is as wide as its texts, or with ``characters`` that wide at least and not as wide as its texts.
    """
    made = QComboBox()
    offer(made, entries)
    if characters is not None:
        policy = QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon
        styled(made, size_adjust_policy=policy, minimum_contents_length=characters)
    if changed is not None:
        made.currentIndexChanged.connect(changed)
    return styled(made, **properties)


def offer(box: QComboBox, entries: Mapping[Any, str], wanted: object = None) -> None:
    """Replace the entries of a choice without a signal. The chosen one stays, or ``wanted``; else it is the first."""
    wanted = box.currentData() if wanted is None else wanted
    with QSignalBlocker(box):
        box.clear()
        for value, text in entries.items():
            box.addItem(text, value)
        box.setCurrentIndex(max(0, box.findData(wanted)) if entries else -1)


def offer_texts(box: QComboBox, texts: Sequence[str]) -> None:
    """Replace the entries of a choice without values, without a signal. The chosen text stays, or it is the first."""
    kept = box.currentText()
    with QSignalBlocker(box):
        box.clear()
        box.addItems(list(texts))
        box.setCurrentIndex(max(0, box.findText(kept)) if texts else -1)


def grid(
    parent: QWidget | None = None, *, stretched: Sequence[int] = (1,), margins: Sequence[int] = (0,), **properties: Any
) -> QGridLayout:
    """Return a grid, the layout of ``parent`` if there is one, whose columns ``stretched`` take the spare width."""
    made = QGridLayout() if parent is None else QGridLayout(parent)
    made.setContentsMargins(*(margins if len(margins) == 4 else [margins[0]] * 4))
    for column in stretched:
        made.setColumnStretch(column, 1)
    return styled(made, **({"vertical_spacing": 6} | properties))


def timer(parent: QObject, interval_ms: int, timeout: Callable[[], object], *, repeat: bool = False) -> QTimer:
    """Return a timer that calls ``timeout`` once after each start, or again and again."""
    made = QTimer(parent)
    made.setSingleShot(not repeat)
    made.setInterval(interval_ms)
    made.timeout.connect(timeout)
    return made


def table(columns: Sequence[str], name: str, row_height: int = 22) -> QTableWidget:
    """Return a table that is read by rows, not edited."""
    return for_reading(QTableWidget(0, len(columns)), name, row_height, horizontal_header_labels=list(columns))


def for_reading(
    view: AnyTable,
    name: str,
    row_height: int = 22,
    columns: QHeaderView.ResizeMode = QHeaderView.ResizeMode.ResizeToContents,
    **properties: Any,
) -> AnyTable:
    """Set a table up that is read by rows, not edited: texts on the left, without grid, the tab key goes on.

    ``name`` is for screen readers, ``columns`` says what their widths follow, ``properties`` are as in :func:`styled`.
    """
    styled(view, name=name, tab_key_navigation=False, show_grid=False, word_wrap=False)
    view.setEditTriggers(QTableView.EditTrigger.NoEditTriggers)
    view.setSelectionBehavior(QTableView.SelectionBehavior.SelectRows)
    styled(view.verticalHeader(), hidden=True, default_section_size=row_height)
    alignment = Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter
    styled(view.horizontalHeader(), section_resize_mode=columns, default_alignment=alignment, highlight_sections=False)
    return styled(view, **properties)


def shortcut(
    parent: QWidget,
    keys: QKeySequence | QKeySequence.StandardKey | str,
    activated: Callable[[], object],
    context: Qt.ShortcutContext = Qt.ShortcutContext.WidgetWithChildrenShortcut,
) -> None:
    """Call ``activated`` when the keys are pressed in ``parent``."""
    styled(QShortcut(QKeySequence(keys), parent), context=context).activated.connect(activated)


def tabs(name: str, *pages: tuple[QWidget, str]) -> QTabWidget:
    """Return pages with a tab each; ``name`` is for screen readers."""
    made = styled(QTabWidget(), document_mode=True)
    styled(made.tabBar(), draw_base=False, name=name)
    for page, title in pages:
        made.addTab(page, title)
    return made


def single_tab_stop(pages: QTabWidget) -> None:
    """Make one stop of the tab key of tabs, not two: the second would lead back to the bar, and never past it."""
    pages.setFocusProxy(None)  # type: ignore[arg-type]
    pages.setFocusPolicy(Qt.FocusPolicy.NoFocus)
    pages.tabBar().setFocusPolicy(Qt.FocusPolicy.StrongFocus)


def splitter(
    *parts: tuple[QWidget, int], sizes: Sequence[int] = (), upright: bool = False, made: QSplitter | None = None
) -> QSplitter:
    """Return parts, each with its stretch, next to each other or ``upright`` below each other, with movable borders."""
    made = made or QSplitter(Qt.Orientation.Vertical if upright else Qt.Orientation.Horizontal)
    made.setChildrenCollapsible(False)
    for index, (part, stretch) in enumerate(parts):
        made.addWidget(part)
        made.setStretchFactor(index, stretch)
    if sizes:
        made.setSizes(list(sizes))
    return made


def stack(*pages: QWidget) -> QStackedWidget:
    """Return pages of which one is shown."""
    made = QStackedWidget()
    for page in pages:
        made.addWidget(page)
    return made


def holder(box: QLayout) -> QWidget:
    """Return a widget with a layout."""
    made = QWidget()
    made.setLayout(box)
    return made


def ask_path(
    parent: QWidget,
    title: str,
    at: Path | str | None,
    chosen: Callable[[Path], object],
    kinds: str = "",
    *,
    save: str | None = None,
    **properties: Any,
) -> QFileDialog:
    """Ask for a folder, for a file of some ``kinds``, or with the name ``save`` for one to write; return the dialog."""
    dialog = styled(QFileDialog(parent, title, str(at or ""), kinds), attribute=Qt.WidgetAttribute.WA_DeleteOnClose)
    if save is not None:
        styled(dialog, accept_mode=QFileDialog.AcceptMode.AcceptSave)
    elif kinds:
        styled(dialog, file_mode=QFileDialog.FileMode.ExistingFile)
    else:
        styled(dialog, file_mode=QFileDialog.FileMode.Directory, option=QFileDialog.Option.ShowDirsOnly)
    styled(dialog, **properties).fileSelected.connect(lambda path: chosen(Path(path)))
    if save:
        dialog.selectFile(save)
    dialog.open()
    return dialog


class ProgressRow:
    """What running work does, how far it is, and a button that cancels it. The parts are hidden while nothing runs."""

    STEPS = 1000

    def __init__(self, doing: QLabel, name: str, cancel: str, cancelled: Callable[[], object] | SignalInstance) -> None:
        self.doing = styled(doing, role="muted")
        self.bar = styled(QProgressBar(), text_visible=False, name=name)
        self.stop = button(_("Cancel"), cancelled, name=cancel)
        self.parts = self.doing, self.bar, self.stop
        self.clear()

    def show_progress(self, fraction: float | None, step: str) -> None:
        """Show the step and its completed share from 0 to 1; None where that is not known."""
        for part in self.parts:
            part.show()
        self.doing.setText(step)
        self.bar.setRange(0, 0 if fraction is None else self.STEPS)
        self.bar.setValue(0 if fraction is None else round(self.STEPS * fraction))

    def show_reason(self, why: str) -> None:
        """Say why no work can start; an empty text hides it. It gives way to running work."""
        if self.bar.isHidden():
            self.doing.setText(why)
            self.doing.setVisible(bool(why))

    def clear(self) -> None:
        """Hide the progress."""
        for part in self.parts:
            part.hide()


def restore_tab(pages: QTabWidget, kept: object) -> None:
    """Show the page with a number from the settings; anything else is ignored."""
    text = str(kept)
    pages.setCurrentIndex(int(text) if text.isdecimal() and int(text) < pages.count() else 0)


def tiles(columns: int, *parts: QWidget, stretch_rows: bool = False, **properties: Any) -> QGridLayout:
    """Return parts in rows of ``columns`` of equal width, of equal height too with ``stretch_rows``."""
    made = styled(QGridLayout(), **({"spacing": 6, "contents_margins": (0, 0, 0, 0)} | properties))
    for index, part in enumerate(parts):
        made.addWidget(part, index // columns, index % columns)
        made.setColumnStretch(index % columns, 1)
        made.setRowStretch(index // columns, int(stretch_rows))
    return made


def show_text(made: QLabel, text: str) -> None:
    """Show a text; an empty one hides the label."""
    made.setText(text)
    made.setVisible(bool(text))


def add_check(
    menu: QMenu, text: str, checked: bool, changed: Callable[[], object], data: object = None, enabled: bool = True
) -> QAction:
    """Add an entry with a check mark to a menu; ``changed`` is called when it is set or taken away."""
    action = styled(menu.addAction(text), checkable=True, checked=checked, data=data, enabled=enabled)
    action.toggled.connect(changed)
    return action
