"""Progress of the repeats of a sitting: a dot for each, and buttons for the next step."""

from __future__ import annotations

import html
from collections.abc import Sequence

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QLabel, QPushButton, QWidget

from tissueid.app.small_window import FoldingBox
from tissueid.app.theme import Theme
from tissueid.app.views.clinician.sitting import NORM, Sitting
from tissueid.language import _, marked
from tissueid.messages import Message, translated

_COLOURS = {"good": "good", "look": "check", "repeat": "poor", None: "muted"}
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
        self._theme: Theme | None = None
        self._shown: tuple[str | None, ...] = ()
        self._left = 0
        self.dots = QLabel()
        self.dots.setTextFormat(Qt.TextFormat.RichText)
        self.repeat = QPushButton(_("Measure again"))
        self.repeat.setToolTip(
            translated(
                Message(
                    "sitting.repeat_tip",
                    "The same test once more, into a file of its own. Five are usual: their mean is steadier than one "
                    "test",
                )
            )
        )
        self.accept = QPushButton(translated(_FINISH_ONE))
        self.accept.setToolTip(
            translated(
                Message(
                    "sitting.finish_tip",
                    "Enough was measured here: the mean of the tests that count is the result, and the next test "
                    "begins a new sitting. No file is changed or deleted",
                )
            )
        )
        self.undo = QPushButton(_("Undo Finish"))
        self.undo.setToolTip(
            _("Continue the sitting as if it had not been finished. Possible until the next test starts")
        )
        row = FoldingBox(0, self)
        row.setContentsMargins(0, 0, 0, 0)
        row.setSpacing(8)
        for part in (self.dots, self.repeat, self.accept, self.undo):
            row.addWidget(part)
        self.repeat.clicked.connect(self.again)
        self.accept.clicked.connect(self.accepted)
        self.undo.clicked.connect(self.undone)
        self.hide()

    def show_sitting(self, sitting: Sitting | None) -> None:
        """Show the progress of a sitting; None hides the bar."""
        self.setVisible(sitting is not None and bool(sitting.repeats))
        if sitting is None:
            return
        self._shown = tuple(repeat.verdict if repeat.counts else "repeat" for repeat in sitting.repeats)
        self._left = max(0, NORM - sitting.counted)
        newest = bool(sitting.repeats) and sitting.repeats[-1].counts
        self.repeat.setText(
            translated(
                Message(
                    "sitting.measure_again",
                    "Measure again ({number} of {count})",
                    number=sitting.counted + 1,
                    count=NORM,
                )
            )
        )
        self.repeat.setVisible(newest and self._left > 0 and not sitting.accepted)
        self.accept.setVisible(sitting.counted > 0 and not sitting.accepted)
        self.accept.setText(_finish(sitting))
        self.undo.setVisible(sitting.accepted)
        said = ", ".join(f"{place} {_(_WORDS[verdict])}" for place, verdict in enumerate(self._shown, 1))
        done = {"done": sitting.counted, "count": NORM}
        if sitting.accepted:
            count = translated(Message("sitting.repeats_finished", "{done} of {count} repeats, finished", **done))
        else:
            count = translated(Message("sitting.repeats", "{done} of {count} repeats", **done))
        self.dots.setAccessibleName(f"{count}: {said}")
        self.dots.setToolTip(
            _("{count}. Green: good. Yellow: to be looked at. Red: not counted. Ring: to come.").format(count=count)
        )
        self._draw()

    @property
    def offers_repeat(self) -> bool:
        """Whether the bar offers a button that measures again."""
        return not self.isHidden() and not self.repeat.isHidden()

    def update_enabled(self, *, busy: bool) -> None:
        """Disable the buttons while a job runs."""
        self.repeat.setEnabled(not busy)
        self.accept.setEnabled(not busy)
        self.undo.setEnabled(not busy)

    def apply_theme(self, theme: Theme) -> None:
        """Take on the colours of a theme."""
        self._theme = theme
        self._draw()

    def _draw(self) -> None:
        if self._theme is None:
            return
        colours: Sequence[str] = [getattr(self._theme, _COLOURS.get(verdict, "muted")) for verdict in self._shown]
        dots = [f'{place}<span style="color:{html.escape(colour)}">●</span>' for place, colour in enumerate(colours, 1)]
        dots += [f'<span style="color:{self._theme.muted}">○</span>'] * self._left
        self.dots.setText(" ".join(dots))


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
