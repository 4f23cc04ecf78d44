"""The result of a test: verdict, numbers with their uncertainty, and the plots behind them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import (
    QComboBox,
    QFrame,
    QLabel,
    QScrollArea,
    QVBoxLayout,
    QWidget,
)

from tissueid.app import build
from tissueid.app.build import button, fill, grid, label, offer, row, styled
from tissueid.app.findings import Findings, Number, whose
from tissueid.app.plot_canvas import PlotCanvas
from tissueid.app.small_window import FoldingBox
from tissueid.app.views.clinician.comparing import ComparisonCard
from tissueid.app.views.clinician.sitting import HEADS, QUANTITIES, VALUE_HEAD, Standing
from tissueid.app.widgets import ElidedLabel, show_level
from tissueid.audit import Role
from tissueid.device import SIMULATED_LINE
from tissueid.formatting import local_time, value_and_rest, zone_offset
from tissueid.language import _, marked
from tissueid.messages import MISSING, Message, code_of, translated
from tissueid.records import Estimate
from tissueid.sessions import Test
from tissueid.sessions.model import DATE_NOTE
from tissueid.units import shown_si

_TILES = 5
_ROOM_FOR_TILES = 720
_ROOM_FOR_THREE = 500
_ONE_ROW = 560
_ROOM_FOR_TWO_PLOTS = 700
_APART = 16
"""Pixels."""
_METHODS = marked(
    "LMS: a linear model by least squares. Spectral: the same by frequency. Wiener: a linear model with a curve behind "
    "it."
)
_OF_MODEL = marked("The values are less certain than usual; Details says why.")
_PLOT_HEIGHT = 150
_MEANINGS = {
    "mass_kg": marked(
        "Mass: what moves with the probe, its coil and the tissue next to it. A larger mass follows the force more "
        "slowly."
    ),
    "damping_n_s_per_m": marked(
        "Damping: how strongly the tissue resists fast motion. More damping: it gives way and returns more slowly."
    ),
    "stiffness_n_per_m": marked(
        "Stiffness: the force that presses the tissue in further. 1000 N/m is 1 N for each millimetre; more is harder."
    ),
}
"""What the numbers mean, by quantity."""


class ResultPage(QScrollArea):
    """The page of results. ``test_chosen`` carries the number of another test of the same session.

    ``repeat_chosen`` carries the place of another test of the same sitting, from 0.
    """

    test_chosen = Signal(int)
    repeat_chosen = Signal(int)
    cards: tuple[PlotCanvas, ...] = ()
    """The plots, built for the first result."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        styled(
            self, widget_resizable=True, name=_("Result, to scroll by the arrow keys"), frame_shape=QFrame.Shape.NoFrame
        )
        page = QWidget()
        self.setWidget(page)
        self.tiles = [_Tile() for _ in range(_TILES)]
        self.summary = SittingSummary()
        self._tile_grid = grid(stretched=(), spacing=8)
        self.readings = label("muted", contents_margins=(12, 0, 8, 0), hidden=True)
        self.comparison = ComparisonCard()
        self._plot_grid = grid(stretched=(), spacing=8)
        build.column(
            self._make_verdict(),
            self.summary,
            self._tile_grid,
            self.readings,
            self.comparison,
            (self._plot_grid, 1),
            spacing=8,
            parent=page,
        )
        self._columns: tuple[int, int] | None = None
        self._findings: Findings | None = None
        self._standing: Standing | None = None
        self._changes: Mapping[str, str] = {}
        self._arrange(self.width())
        self.details.hide()

    def show_findings(self, findings: Findings) -> None:
        """Fill the page."""
        self._build_plots()
        self._findings, self._changes = findings, {}
        self.whose.setText(whose(findings))
        self.whose.setToolTip(self.whose.text())
        self.simulated.setVisible(findings.session.instrument.simulated)
        self.readings.setText(findings.readings)
        self._fill()
        curves, recorded = findings.plots, findings.recorded
        models = curves.nonlinearity, curves.impulse, curves.magnitude, curves.phase, curves.prediction
        plots = *models, recorded.coherence, recorded.spectra, recorded.voltage
        for plot, card in zip(plots, self.cards, strict=True):
            card.show_plots([plot])
        self._offer_tests(findings.session.tests, findings.test)
        self.verticalScrollBar().setValue(0)

    def show_standing(self, standing: Standing | None) -> None:
        """Show the summary of the sitting; an accepted result replaces the numbers of the test."""
        self._standing = standing
        self.summary.show_standing(standing)
        self._fill()

    def offer_repeats(self, files: Sequence[Path], shown: Path) -> None:
        """Offer the tests of a sitting, each of which has its own file."""
        names = [
            _("Test {number}: {kind}").format(number=number, kind=file.stem) for number, file in enumerate(files, 1)
        ]
        self.test.clear()
        self.test.addItems(names)
        self.test.setCurrentIndex(files.index(shown))
        self.test.show()

    def show_changes(self, changes: Mapping[str, str]) -> None:
        """Show what changed since the sitting before at this site, by quantity."""
        self._changes = changes
        self._fill()

    def show_role(self, role: Role) -> None:
        """Fold the details away for a clinician; others see all."""
        self.details.setVisible(role == "clinician")
        self.details.setChecked(role != "clinician")
        self._fill()

    def _fill(self) -> None:
        """Show the numbers and words of the test, and what belongs to them if details are shown."""
        findings, detailed = self._findings, self.details.isChecked()
        for card in self.cards:
            card.setVisible(detailed)
        if findings is None:
            return
        # Headline and light stand above, and so does what the quality gate said.
        shown = {finding.message for finding in findings.quality.findings} if findings.quality else set()
        reasons = [reason for reason in findings.verdict.reasons if reason not in shown]
        if not detailed:
            reasons = [_(_OF_MODEL) if code_of(reason) == "verdict.engine_warning" else reason for reason in reasons]
        cautions = findings.cautions if detailed else ()
        self.reasons.setText("\n".join(dict.fromkeys(map(translated, [*findings.unread, *reasons, *cautions]))))
        self.reasons.setVisible(bool(self.reasons.text()))
        facts = [_recorded(findings), findings.ended, findings.visited]
        self.facts.setText(" ".join(filter(None, facts)))
        self.readings.setVisible(detailed and bool(findings.readings))
        numbers = [number for number in findings.numbers if detailed or number.unit != "%"]
        if (standing := self._standing) is not None and standing.accepted:
            numbers = [_accepted(number, standing) for number in numbers]
        for index, tile in enumerate(self.tiles):
            tile.setVisible(index < len(numbers))
            if index < len(numbers):
                number = numbers[index]
                tile.fill(number, findings.verdict.level, self._changes.get(number.quantity, ""))
        self._arrange(self.width())

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Rearrange tiles and plots for the new width."""
        super().resizeEvent(event)
        self._arrange(event.size().width())

    # -- building -----------------------------------------------------------------------------------------

    def _make_verdict(self) -> QWidget:
        frame = styled(QFrame(), role="verdict")
        self.whose = styled(ElidedLabel(), role="headline")
        self.facts, self.simulated = label("muted"), label("heading")
        self.simulated.setText(_(SIMULATED_LINE))
        self.reasons = label(tip=_(_METHODS))
        self.test = styled(QComboBox(), name=_("Test of this session"), maximum_width=260)
        self.test.activated.connect(self._choose_test)
        self.pdf = button(_("PDF report"), tip=_("One or two pages to print, saved next to the session"))
        self.details = button(
            _("Details"), tip=_("How well the model fits, and the curves behind the numbers"), checkable=True
        )
        self.details.toggled.connect(self._fill)
        fill(
            QVBoxLayout(frame),
            fill(
                FoldingBox(_ONE_ROW),
                (row((self.whose, 1)), 1),
                row(None, self.test, self.details, self.pdf, spacing=_APART),
                spacing=4,
            ),
            self.simulated,
            self.reasons,
            self.facts,
            spacing=3,
            margins=(12, 8, 12, 8),
        )
        return frame

    def _build_plots(self) -> None:
        if self.cards:
            return
        self.cards = tuple(PlotCanvas() for _ in range(8))
        self.nonlinearity, self.impulse, self.bode, self.phase, self.prediction = self.cards[:5]
        self.coherence, self.spectra, self.voltage = self.cards[5:]
        for card in self.cards:
            card.setMinimumHeight(_PLOT_HEIGHT)
            card.focus = Qt.FocusPolicy.ClickFocus  # the page is scrolled by keys, not stop by stop
            card.setVisible(self.details.isChecked())
        self._columns = None
        self._arrange(self.width())

    def _arrange(self, width: int) -> None:
        """Put tiles and plots into as many columns as a width, pixels, holds."""
        shown = sum(not tile.isHidden() for tile in self.tiles) or _TILES
        columns = (
            (min(shown, _TILES) if width >= _ROOM_FOR_TILES else 3 if width >= _ROOM_FOR_THREE else 2),
            (2 if width >= _ROOM_FOR_TWO_PLOTS else 1),
        )
        if columns == self._columns:
            return
        self._columns = columns
        grids = (self._tile_grid, self.tiles), (self._plot_grid, self.cards)
        for (layout, widgets), across in zip(grids, columns, strict=True):
            for index, widget in enumerate(widgets):
                layout.addWidget(widget, index // across, index % across)
            for column in range(_TILES):
                layout.setColumnStretch(column, int(column < across))
            for index in range(len(widgets)):
                layout.setRowStretch(index, int(index * across < len(widgets)))

    # -- filling ------------------------------------------------------------------------------------------

    def _offer_tests(self, tests: tuple[Test, ...], shown: Test) -> None:
        kinds = {test.number: test.kind.replace("_", " ") for test in tests}
        template = _("Test {number}: {kind}")
        offer(
            self.test,
            {number: template.format(number=number, kind=kind) for number, kind in kinds.items()},
            shown.number,
        )
        self.test.setVisible(len(tests) > 1)

    def _choose_test(self) -> None:
        number = self.test.currentData()
        if number is None:
            self.repeat_chosen.emit(self.test.currentIndex())
        else:
            self.test_chosen.emit(number)


def _accepted(number: Number, standing: Standing) -> Number:
    """Return the accepted value of a number, labelled so; a number that was not accepted is that of the shown test."""
    value = standing.values.get(number.quantity)
    if value is None:
        return replace(number, note=_("this test alone; {note}").format(note=number.note))
    note = (
        translated(Message("result.accepted_mean", "accepted: mean of {count} tests", count=value.count))
        if value.count > 1
        else _("accepted")
    )
    return replace(number, note=note, estimate=Estimate(value.mean, value.std))


def _recorded(findings: Findings) -> str:
    """Return the time of the recording, local time with its offset from UTC; empty if it is not known."""
    moment = local_time(findings.session.created)
    if moment is None:
        return ""
    said = {
        "header": _("Imported; recorded {date} {time} ({zone}) by the header of its file."),
        "modified": _(
            "Imported; its file was modified {date} {time} ({zone}), the date of the recording is not known."
        ),
    }.get(str(findings.test.notes.get(DATE_NOTE, "")), _("Recorded {date} {time} ({zone})."))
    return said.format(date=f"{moment:%Y-%m-%d}", time=f"{moment:%H:%M}", zone=zone_offset(moment))


class _Tile(QFrame):
    """One number."""

    def __init__(self) -> None:
        super().__init__()
        self.setProperty("role", "card")
        self.number: Number | None = None
        self.label, self.value, self.rest, self.note, self._change = (QLabel() for _ in range(5))
        for part in (self.label, self.note, self._change):
            styled(part, role="field").setWordWrap(True)
        self.value.setProperty("role", "value")
        self.rest.setProperty("role", "muted")
        number = row(self.value, self.rest, None, spacing=5)
        number.setAlignment(self.rest, Qt.AlignmentFlag.AlignBottom)
        parts = self.label, number, self.note, self._change, None
        fill(QVBoxLayout(self), *parts, spacing=1, margins=(12, 7, 8, 7))

    def fill(self, number: Number, level: str, change: str) -> None:
        """Show a number of a test with a verdict of ``level``, and what ``change`` says of the sitting before."""
        self.number = number
        vaf = _("Variance accounted for (VAF): how much of the motion a simulation explains that sees only the force")
        self.setToolTip(_(_MEANINGS[number.quantity]) if number.quantity in _MEANINGS else vaf)
        show_level(self.value, level)
        self._change.setText(change)
        self._change.setVisible(bool(change))
        self.label.setText(number.label)
        self.note.setText(number.note)
        self.take_units()

    def take_units(self) -> None:
        """Show the number in the active units."""
        number = self.number
        if number is None:
            return
        estimate = number.estimate
        value, rest = (number.value, number.unit) if estimate is None else value_and_rest(estimate, number.si_unit)
        self.value.setText(value)
        self.rest.setText(rest)
        said = f"{number.label}: {value} {rest}, {number.note}. {self._change.text()}"
        self.setAccessibleName(said.strip())


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
        styled(self, role="card", tip=_(_EXPLAINED))
        self._standing: Standing | None = None
        self.heading, self.about = styled(QLabel(), role="headline"), label("muted")
        self._heads: list[QLabel] = []
        table = grid(stretched=(len(HEADS),), horizontal_spacing=22, vertical_spacing=2)
        for column, head in enumerate(HEADS):
            named = styled(QLabel(_(head)), role="field", minimum_width=1)
            self._heads.append(named)
            table.addWidget(named, 0, column)
        self.cells: dict[str, list[QLabel]] = {}
        for index, quantity in enumerate(QUANTITIES, 1):
            cells = [QLabel() for _head in HEADS]
            cells[1].setStyleSheet("font-weight: 600;")
            for column, cell in enumerate(cells):
                cell.setTextFormat(Qt.TextFormat.PlainText)
                table.addWidget(cell, index, column)
            self.cells[quantity] = cells
        fill(QVBoxLayout(self), self.heading, table, self.about, spacing=3, margins=(12, 6, 12, 8))
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
            f"{_(name)} {mean}"
            if limit == MISSING
            else _("{name} {mean}, repeatability {repeatability}").format(name=_(name), mean=mean, repeatability=limit)
            for name, mean, _relative, limit in rows.values()
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
