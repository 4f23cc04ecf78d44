"""Progress of the repeats of a sitting with the next steps, and the accepted result or the mean so far."""

from __future__ import annotations

import html
from collections.abc import Sequence

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QFrame, QGridLayout, QLabel, QVBoxLayout, QWidget

from tissueid.app.build import button, fill, label, styled
from tissueid.app.small_window import FoldingBox
from tissueid.app.theme import appearance
from tissueid.app.views.clinician.sitting import HEADS, NORM, QUANTITIES, VALUE_HEAD, Sitting, Standing
from tissueid.language import _, marked
from tissueid.messages import MISSING, Message, translated
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
        styled(self, role="card", tip=_(_EXPLAINED))
        self._standing: Standing | None = None
        self.heading, self.about = styled(QLabel(), role="headline"), label("muted")
        self._heads: list[QLabel] = []
        grid = QGridLayout()
        styled(grid, horizontal_spacing=22, vertical_spacing=2)
        for column, head in enumerate(HEADS):
            named = styled(QLabel(_(head)), role="field", minimum_width=1)
            self._heads.append(named)
            grid.addWidget(named, 0, column)
        self.cells: dict[str, list[QLabel]] = {}
        for row, quantity in enumerate(QUANTITIES, 1):
            cells = [QLabel() for _head in HEADS]
            cells[1].setStyleSheet("font-weight: 600;")
            for column, cell in enumerate(cells):
                cell.setTextFormat(Qt.TextFormat.PlainText)
                grid.addWidget(cell, row, column)
            self.cells[quantity] = cells
        grid.setColumnStretch(len(HEADS), 1)
        fill(QVBoxLayout(self), self.heading, grid, self.about, spacing=3, margins=(12, 6, 12, 8))
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


_COLOURS = {"good": "good", "look": "amber", "repeat": "poor", None: "muted"}
_WORDS = {
    "good": marked("good"),
    "look": marked("to be looked at"),
    "repeat": marked("not counted"),
    None: marked("not judged"),
}

_FINISH_ONE = Message("sitting.finish", "Finish: use this test")


class RepeatBar(QWidget):
    """Hidden where there is no sitting. ``again``, ``accepted`` and ``undone`` are sent by its buttons."""

    again = Signal()
    accepted = Signal()
    undone = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.allowed = True
        """Whether the next test repeats the shown one: not where form or protocol say something else."""
        self._fits = False
        self._shown: tuple[str | None, ...] = ()
        self._left = 0
        self.dots = styled(QLabel(), text_format=Qt.TextFormat.RichText)
        again = Message(
            "sitting.repeat_tip",
            "The same test once more, into a file of its own. Five are usual: their mean is steadier than one test",
        )
        finish = Message(
            "sitting.finish_tip",
            "Enough was measured here: the mean of the tests that count is the result, and the next test begins a new "
            "sitting. No file is changed or deleted",
        )
        undo = _("Continue the sitting as if it had not been finished. Possible until the next test starts")
        self.repeat = button(_again(2, NORM), self.again, tip=translated(again))
        self.accept = button(translated(_FINISH_ONE), self.accepted, tip=translated(finish))
        self.undo = button(_("Undo Finish"), self.undone, tip=undo)
        fill(FoldingBox(0, self), self.dots, self.repeat, self.accept, self.undo, spacing=8)
        appearance.changed.connect(self._draw)
        self.hide()

    def show_sitting(self, sitting: Sitting | None) -> None:
        """Show the progress of a sitting; None hides the bar."""
        self.setVisible(sitting is not None and bool(sitting.repeats))
        if sitting is None:
            return
        self._shown = tuple(repeat.verdict if repeat.counts else "repeat" for repeat in sitting.repeats)
        self._left = max(0, sitting.wanted - sitting.counted)
        newest = bool(sitting.repeats) and sitting.repeats[-1].counts
        self.repeat.setText(_again(sitting.counted + 1, sitting.wanted))
        self._fits = newest and self._left > 0 and not sitting.accepted
        self.allow_repeat(self.allowed)
        self.accept.setVisible(sitting.counted > 0 and not sitting.accepted)
        self.accept.setText(_finish(sitting))
        self.undo.setVisible(sitting.accepted)
        said = ", ".join(f"{place} {_(_WORDS[verdict])}" for place, verdict in enumerate(self._shown, 1))
        done = {"done": sitting.counted, "count": sitting.wanted}
        if sitting.accepted:
            count = translated(Message("sitting.repeats_finished", "{done} of {count} repeats, finished", **done))
        else:
            count = translated(Message("sitting.repeats", "{done} of {count} repeats", **done))
        styled(
            self.dots,
            name=f"{count}: {said}",
            tip=_("{count}. Green: good. Yellow: to be looked at. Red: not counted. Ring: to come.").format(
                count=count
            ),
        )
        self._draw()

    def allow_repeat(self, allowed: bool) -> None:
        """Offer the next repeat, if there is one to come, or not."""
        self.allowed = allowed
        self.repeat.setVisible(self._fits and allowed)

    @property
    def offers_repeat(self) -> bool:
        """Whether the bar offers a button that measures again."""
        return not self.isHidden() and not self.repeat.isHidden()

    def update_enabled(self, *, busy: bool) -> None:
        """Disable the buttons while a job runs."""
        self.repeat.setEnabled(not busy)
        self.accept.setEnabled(not busy)
        self.undo.setEnabled(not busy)

    def _draw(self) -> None:
        colours: Sequence[str] = [getattr(appearance.theme, _COLOURS.get(verdict, "muted")) for verdict in self._shown]
        dots = [f'{place}<span style="color:{html.escape(colour)}">●</span>' for place, colour in enumerate(colours, 1)]
        dots += [f'<span style="color:{appearance.theme.muted}">○</span>'] * self._left
        self.dots.setText(" ".join(dots))


def _again(number: int, count: int) -> str:
    return translated(
        Message("sitting.measure_again", "Start test again ({number} of {count})", number=number, count=count)
    )


def _finish(sitting: Sitting) -> str:
    """What the button accepts: the only test, one of several by its place, or the mean of those that count."""
    places = sitting.places
    if len(places) == 1:
        return (
            translated(_FINISH_ONE)
            if len(sitting.repeats) == 1
            else translated(Message("sitting.finish_test", "Finish: use test {place}", place=places[0]))
        )
    if len(places) == len(sitting.repeats):
        return translated(Message("sitting.finish_mean", "Finish: mean of {count}", count=len(places)))
    return translated(
        Message("sitting.finish_tests", "Finish: mean of tests {places}", places=", ".join(map(str, places)))
    )
