"""What the repeats of a sitting say together: mean, deviation, repeatability."""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QFrame, QGridLayout, QLabel, QVBoxLayout, QWidget

from tissueid.app.language import _, marked
from tissueid.app.units import shown_si
from tissueid.app.views.clinician.sitting import QUANTITIES, Sitting, rows_of

_HEADS = ("", marked("Mean ± standard deviation"), marked("Relative"), marked("Two tests differ by less than"))
_EXPLAINED = marked(
    "Deviation: of one test about the mean of the repeats. Two tests of the same site differ by less than the last "
    "column in 95 % of cases: 1.96 · √2 deviations."
)


class SittingSummary(QFrame):
    """Hidden until two repeats count."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setProperty("role", "card")
        self._sitting: Sitting | None = None
        self.setToolTip(_(_EXPLAINED))
        self.heading = QLabel()
        self.heading.setProperty("role", "headline")
        grid = QGridLayout()
        grid.setHorizontalSpacing(22)
        grid.setVerticalSpacing(2)
        for column, head in enumerate(_HEADS):
            label = QLabel(_(head))
            label.setProperty("role", "field")
            grid.addWidget(label, 0, column)
        self.cells: dict[str, list[QLabel]] = {}
        for row, quantity in enumerate(QUANTITIES, 1):
            cells = [QLabel() for _head in _HEADS]
            cells[1].setStyleSheet("font-weight: 600;")
            for column, cell in enumerate(cells):
                cell.setTextFormat(Qt.TextFormat.PlainText)
                grid.addWidget(cell, row, column)
            self.cells[quantity] = cells
        grid.setColumnStretch(len(_HEADS), 1)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(12, 6, 12, 8)
        layout.setSpacing(3)
        layout.addWidget(self.heading)
        layout.addLayout(grid)
        self.hide()

    def show_sitting(self, sitting: Sitting | None) -> None:
        """Show what it says so far; None, and fewer than two repeats, hide it."""
        self._sitting = sitting
        rows = rows_of(sitting, shown_si)
        self.setVisible(bool(rows))
        if sitting is None or not rows:
            return
        done = _("Result: mean") if sitting.accepted else _("Mean so far")
        self.heading.setText(_("{done} of {count} repeats").format(done=done, count=sitting.counted))
        for quantity, cells in self.cells.items():
            texts = rows.get(quantity, ("", "", "", ""))
            for cell, text in zip(cells, texts, strict=True):
                cell.setText(_(text))
        said = "; ".join(
            _("{name} {mean}, repeatability {repeatability}").format(name=_(row[0]), mean=row[1], repeatability=row[3])
            for row in rows.values()
        )
        self.setAccessibleName(f"{self.heading.text()}: {said}")

    def take_units(self) -> None:
        """Show it in the units in force."""
        self.show_sitting(self._sitting)
