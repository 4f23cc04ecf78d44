"""The accepted result of a sitting, or the mean so far: value, deviation, repeatability, and the tests behind it."""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QFrame, QGridLayout, QLabel, QVBoxLayout, QWidget

from tissueid.app.views.clinician.sitting import HEADS, QUANTITIES, VALUE_HEAD, Standing
from tissueid.language import _, marked
from tissueid.units import shown_si

_EXPLAINED = marked(
    "Deviation: of one test about the mean of the repeats. Two tests of the same site differ by less than the last "
    "column in 95 % of cases: √2 · t deviations, t of Student for as many repeats."
)

_ONE_LINE = 600
"""Width below which the heads of the columns wrap, pixels."""


class SittingSummary(QFrame):
    """Hidden until two repeats count or a result is accepted."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setProperty("role", "card")
        self._standing: Standing | None = None
        self.setToolTip(_(_EXPLAINED))
        self.heading = QLabel()
        self.heading.setProperty("role", "headline")
        self.about = QLabel()
        self.about.setProperty("role", "muted")
        self.about.setWordWrap(True)
        self.about.setMinimumWidth(1)
        self.about.setTextFormat(Qt.TextFormat.PlainText)
        self.about.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self._heads: list[QLabel] = []
        grid = QGridLayout()
        grid.setHorizontalSpacing(22)
        grid.setVerticalSpacing(2)
        for column, head in enumerate(HEADS):
            label = QLabel(_(head))
            label.setProperty("role", "field")
            label.setMinimumWidth(1)
            self._heads.append(label)
            grid.addWidget(label, 0, column)
        self.cells: dict[str, list[QLabel]] = {}
        for row, quantity in enumerate(QUANTITIES, 1):
            cells = [QLabel() for _head in HEADS]
            cells[1].setStyleSheet("font-weight: 600;")
            for column, cell in enumerate(cells):
                cell.setTextFormat(Qt.TextFormat.PlainText)
                grid.addWidget(cell, row, column)
            self.cells[quantity] = cells
        grid.setColumnStretch(len(HEADS), 1)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(12, 6, 12, 8)
        layout.setSpacing(3)
        layout.addWidget(self.heading)
        layout.addLayout(grid)
        layout.addWidget(self.about)
        self.hide()

    def show_standing(self, standing: Standing | None) -> None:
        """Show what stands as the result; None hides it."""
        self._standing = standing
        self.setVisible(standing is not None)
        if standing is None:
            return
        rows = standing.rows(shown_si)
        repeated = any(value.count > 1 for value in standing.values.values())
        self.heading.setText(standing.heading)
        self.about.setText("\n".join(filter(None, [standing.tests, standing.remark])))
        self.about.setVisible(bool(self.about.text()))
        for column, head in enumerate(self._heads):
            head.setText(_(HEADS[column] if repeated or column != 1 else VALUE_HEAD))
            head.setVisible(bool(rows) and (repeated or column < 2))
        for quantity, cells in self.cells.items():
            texts = rows.get(quantity, ("", "", "", ""))
            for column, (cell, text) in enumerate(zip(cells, texts, strict=True)):
                cell.setText(_(text) if repeated or column < 2 else "")
                cell.setVisible(bool(cell.text()))
        said = "; ".join(
            _("{name} {mean}, repeatability {repeatability}").format(name=_(row[0]), mean=row[1], repeatability=row[3])
            for row in rows.values()
        )
        self.setAccessibleName(" ".join(filter(None, [f"{standing.heading}: {said}", self.about.text()])))

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Wrap the column headers where they do not fit next to each other."""
        super().resizeEvent(event)
        for head in self._heads:
            head.setWordWrap(event.size().width() < _ONE_LINE)

    def take_units(self) -> None:
        """Show it in the units in force."""
        self.show_standing(self._standing)
