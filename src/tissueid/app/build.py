"""Build widgets in the order in which they are seen: rows, columns, labels, buttons and tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from PySide6.QtCore import QObject, Qt, QTimer, SignalInstance
from PySide6.QtWidgets import (
    QBoxLayout,
    QComboBox,
    QGridLayout,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QLayout,
    QPushButton,
    QTableView,
    QTableWidget,
    QVBoxLayout,
    QWidget,
)

Item = QWidget | QLayout | None
"""A part of a row or column; None is a stretch."""
AnyObject = TypeVar("AnyObject", bound=QObject)
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


def styled(widget: AnyObject, **properties: Any) -> AnyObject:
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


STYLE_PROPERTIES = ("role", "level", "state")
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


def choice(entries: Mapping[Any, str], **properties: Any) -> QComboBox:
    """Return a combo box with a text for each value."""
    made = QComboBox()
    for value, text in entries.items():
        made.addItem(text, value)
    return styled(made, **properties)


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
