"""Small widgets of the window: buttons, elided and plain labels, labelled rows, and tool tips."""

from __future__ import annotations

import html
from collections.abc import Collection, Iterable, Sequence

from PySide6.QtCore import QEvent, QSignalBlocker, QSize, Qt
from PySide6.QtGui import QFont, QHelpEvent, QKeyEvent, QPainter, QPaintEvent
from PySide6.QtWidgets import (
    QHBoxLayout,
    QLabel,
    QPushButton,
    QTableWidget,
    QTableWidgetItem,
    QToolTip,
    QWidget,
)

from tissueid.app.build import restyle
from tissueid.formatting import clean


class BigButton(QPushButton):
    """A button that Return presses as well as Space, once for each time that the key goes down."""

    def keyPressEvent(self, event: QKeyEvent) -> None:  # noqa: N802
        """Press; a key that is held down is not pressed again."""
        if event.isAutoRepeat():
            return
        if event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter):
            self.click()
            return
        super().keyPressEvent(event)


class ElidedLabel(QLabel):
    """An elided label. ``text`` and accessible text stay complete; the tooltip of an elided text shows all of it."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setTextFormat(Qt.TextFormat.PlainText)
        self.setMinimumWidth(1)

    @property
    def shown(self) -> str:
        """The elided text as shown."""
        return self.fontMetrics().elidedText(self.text(), Qt.TextElideMode.ElideMiddle, self.contentsRect().width())

    def minimumSizeHint(self) -> QSize:  # noqa: N802
        """Return a size hint that allows any width."""
        return QSize(1, super().minimumSizeHint().height())

    def paintEvent(self, _event: QPaintEvent) -> None:  # noqa: N802
        """Draw the elided text in the colour of the style."""
        painter = QPainter(self)
        self.style().drawItemText(
            painter,
            self.contentsRect(),
            int(self.alignment()),
            self.palette(),
            self.isEnabled(),
            self.shown,
            self.foregroundRole(),
        )

    def event(self, event: QEvent) -> bool:
        """Show the complete text as the tooltip where it is elided and has no other tooltip."""
        if isinstance(event, QHelpEvent) and event.type() == QEvent.Type.ToolTip and self.shown != self.text():
            QToolTip.showText(event.globalPos(), self.text(), self)
            return True
        return super().event(event)


def labelled_row(
    holder: QWidget, name: str, control: QWidget, *, role: str = "field", spacing: int = 14
) -> QHBoxLayout:
    """Fill ``holder`` with a label in the style ``role`` and a control, ``spacing`` pixels from each other."""
    label = QLabel(name)
    label.setProperty("role", role)
    row = QHBoxLayout(holder)
    row.setContentsMargins(0, 0, 0, 0)
    row.setSpacing(spacing)
    row.addWidget(label)
    row.addWidget(control)
    return row


_OWN = "own_tip"


def show_disabled_reason(controls: Iterable[QWidget], why: str) -> None:
    """Set the tooltip of disabled controls to ``why``, and restore the tooltip of the others.

    ``why`` is empty if no job runs. A tooltip that was changed meanwhile is kept as the control's own.
    """
    for control in controls:
        shown = control.accessibleDescription()
        if not shown or control.toolTip() != shown:
            control.setProperty(_OWN, control.toolTip())
        waits = bool(why) and not control.isEnabled()
        control.setToolTip(why if waits else str(control.property(_OWN)))
        control.setAccessibleDescription(why if waits else "")


def plain_tip(text: str) -> str:
    """Return a tool tip that shows the lines as plain text, because Qt renders texts that look like HTML."""
    lines = "<br>".join(html.escape(clean(line)) for line in text.split("\n"))
    return f"<qt>{lines}</qt>" if text else ""


def show_level(widget: QWidget, level: str) -> None:
    """Set the colour level of a widget: good, check, poor or none."""
    if widget.property("level") != level:
        restyle(widget, level=level)


def fill_table(
    made: QTableWidget, rows: Sequence[Sequence[str]], bold: Collection[int] = (), right: Collection[int] = ()
) -> None:
    """Show rows of texts, each with itself as tool tip. ``bold`` are numbers of rows, ``right`` columns of numbers."""
    font = QFont(made.font())
    font.setBold(True)
    with QSignalBlocker(made):
        made.setRowCount(len(rows))
        for row, texts in enumerate(rows):
            for column, text in enumerate(texts):
                item = QTableWidgetItem(text)
                item.setToolTip(plain_tip(text))
                if row in bold:
                    item.setFont(font)
                if column in right:
                    item.setTextAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
                made.setItem(row, column, item)
