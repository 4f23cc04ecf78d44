"""How far the repeats of a sitting have come: a dot for each, and what can be done next."""

from __future__ import annotations

import html
from collections.abc import Sequence

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QHBoxLayout, QLabel, QPushButton, QWidget

from tissueid.app.language import _, marked
from tissueid.app.theme import Theme
from tissueid.app.views.clinician.sitting import NORM, Sitting

_COLOURS = {"good": "good", "look": "check", "repeat": "poor", None: "muted"}
_WORDS = {
    "good": marked("good"),
    "look": marked("to be looked at"),
    "repeat": marked("not counted"),
    None: marked("not judged"),
}

_FINISH_ONE = marked("Finish: use this test")


class RepeatBar(QWidget):
    """Hidden where there is no sitting. ``again`` and ``accepted`` are sent by its two buttons."""

    again = Signal()
    accepted = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._theme: Theme | None = None
        self._shown: tuple[str | None, ...] = ()
        self._left = 0
        self.dots = QLabel()
        self.dots.setTextFormat(Qt.TextFormat.RichText)
        self.repeat = QPushButton(_("Measure again"))
        self.repeat.setToolTip(
            _("The same test once more, into a file of its own. Five are usual: their mean is steadier than one test")
        )
        self.accept = QPushButton(_(_FINISH_ONE))
        self.accept.setToolTip(
            _(
                "Enough was measured here: the mean of the tests that count is the result, and the next test begins a "
                "new sitting. No file is changed or deleted"
            )
        )
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        row.setSpacing(8)
        for part in (self.dots, self.repeat, self.accept):
            row.addWidget(part)
        self.repeat.clicked.connect(self.again)
        self.accept.clicked.connect(self.accepted)
        self.hide()

    def show_sitting(self, sitting: Sitting | None) -> None:
        """Show how far it has come; None hides it."""
        self.setVisible(sitting is not None and bool(sitting.repeats))
        if sitting is None:
            return
        self._shown = tuple(repeat.verdict if repeat.counts else "repeat" for repeat in sitting.repeats)
        self._left = max(0, NORM - sitting.counted)
        newest = bool(sitting.repeats) and sitting.repeats[-1].counts
        self.repeat.setText(_("Measure again ({number} of {count})").format(number=sitting.counted + 1, count=NORM))
        self.repeat.setVisible(newest and self._left > 0 and not sitting.accepted)
        self.accept.setVisible(sitting.counted > 0 and not sitting.accepted)
        self.accept.setText(
            _(_FINISH_ONE) if sitting.counted == 1 else _("Finish: mean of {count}").format(count=sitting.counted)
        )
        said = ", ".join(f"{place} {_(_WORDS[verdict])}" for place, verdict in enumerate(self._shown, 1))
        count = _("{done} of {count} repeats, finished") if sitting.accepted else _("{done} of {count} repeats")
        count = count.format(done=sitting.counted, count=NORM)
        self.dots.setAccessibleName(f"{count}: {said}")
        self.dots.setToolTip(
            _("{count}. Green: good. Yellow: to be looked at. Red: not counted. Ring: to come.").format(count=count)
        )
        self._draw()

    def settle(self, *, busy: bool) -> None:
        """Nothing begins beside something that goes on."""
        self.repeat.setEnabled(not busy)
        self.accept.setEnabled(not busy)

    def paint_with(self, theme: Theme) -> None:
        """Take on the colours of a theme."""
        self._theme = theme
        self._draw()

    def _draw(self) -> None:
        if self._theme is None:
            return
        colours: Sequence[str] = [getattr(self._theme, _COLOURS.get(verdict, "muted")) for verdict in self._shown]
        dots = [f'<span style="color:{html.escape(colour)}">●</span>' for colour in colours]
        dots += [f'<span style="color:{self._theme.muted}">○</span>'] * self._left
        self.dots.setText(" ".join(dots))
