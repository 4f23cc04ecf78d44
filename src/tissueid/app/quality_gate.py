"""The quality gate after a test: traffic light, findings, advice, and the repeats of the sitting."""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import TYPE_CHECKING

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QAccessible, QAccessibleEvent
from PySide6.QtWidgets import (
    QFrame,
    QLabel,
    QVBoxLayout,
    QWidget,
)

from tissueid.app.build import button, fill, grid, label, row, styled
from tissueid.app.small_window import FoldingBox
from tissueid.app.theme import appearance
from tissueid.app.views.clinician.sitting import NORM, Sitting
from tissueid.app.widgets import show_level
from tissueid.audit import Role
from tissueid.language import _, marked
from tissueid.messages import Message, sentences, translated
from tissueid.sessions.quality import Quality, QualityFinding, Verdict

if TYPE_CHECKING:
    from tissueid.reports import verdict as report


_COLOURS = {"good": "good", "look": "amber", "repeat": "poor", None: "muted"}
_WORDS = {
    "good": marked("good"),
    "look": marked("to be looked at"),
    "repeat": marked("not counted"),
    None: marked("not judged"),
}
_FINISH_ONE = Message("sitting.finish", "Finish: use this test")


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
        said = ", ".join(f"{number} {_(_WORDS[verdict])}" for number, verdict in enumerate(self._shown, 1))
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
        dots = [
            f'{number}<span style="color:{html.escape(colour)}">●</span>' for number, colour in enumerate(colours, 1)
        ]
        dots += [f'<span style="color:{appearance.theme.muted}">○</span>'] * self._left
        self.dots.setText(" ".join(dots))


_LEVELS: dict[Verdict, str] = {"good": "good", "look": "check", "repeat": "poor"}
_ONE_ROW = 640
MOST_SHOWN = 3
"""Number of findings that are shown at first; a button shows the others."""
_CALIBRATION = "calibration_"
"""First letters of the codes of findings about the calibration."""
_ASK = marked("The values can be compared only with those of this instrument. Ask the technician to calibrate it.")
UNJUDGED = marked("The quality gate did not judge this test when it was made.")


class QualityGatePanel(QFrame):
    """The verdict on a test, hidden until it is over.

    ``again`` is sent by the button that is there when the test should be repeated, ``judge`` by the one that is there
    when the gate never judged it.
    """

    again = Signal()
    judge = Signal()
    calibration_wanted = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._role: Role = "technician"
        self._quality: Quality | None = None
        self._poor = False
        styled(self, role="verdict")
        self.light, self.headline = styled(QLabel("●"), role="light"), label("headline")
        self.more = button("", name=_("All findings"), checkable=True)
        self.run_again = button(
            _("Start test again"), self.again, tip=_("The same test once more, into a file of its own")
        )
        self.calibrate = button(
            _("Calibrate…"), self.calibration_wanted, tip=_("Go to the calibrations; nothing starts")
        )
        judging = _("Let the quality gate look at the recorded signals; the file stays as it is")
        self.judge_now = button(_("Judge this test"), self.judge, tip=judging)
        self.repeats = RepeatBar()
        offered = None, self.run_again, self.repeats, self.more, self.judge_now, self.calibrate
        top = fill(
            FoldingBox(_ONE_ROW),
            (row(self.light, (self.headline, 1), spacing=8), 1),
            row(*offered, spacing=8),
            spacing=4,
        )
        self.grid = grid(stretched=(0, 1), horizontal_spacing=12, vertical_spacing=2)
        fill(QVBoxLayout(self), top, self.grid, spacing=3, margins=(12, 5, 10, 5))
        self.more.toggled.connect(self._fill)
        self.hide()

    def show_quality(self, quality: Quality | None, *, can_repeat: bool, verdict: report.Verdict | None = None) -> None:
        """Show the verdict and findings of the quality gate; None for a test that was not judged.

        These are the gate's until the ``verdict`` on the analysed test, which has the gate's findings in it, is known.
        ``can_repeat`` is whether a test can be run now.
        """
        self._quality = quality
        level = "" if quality is None else _LEVELS[quality.verdict]
        headline = "" if quality is None else quality.headline
        if verdict is not None:
            level, headline = verdict.level, verdict.headline
        for widget in (self, self.light, self.headline):
            show_level(widget, level)
        self.headline.setText(_(headline) if headline else _("Not judged"))
        self._poor = level == "poor"
        self.judge_now.setVisible(quality is None and verdict is not None)
        self.repeats.hide()
        self.allow_repeat(can_repeat)
        self.more.setChecked(False)
        self._fill()
        self.setAccessibleName(" ".join([_("Quality gate:"), self.headline.text() + ".", *self.texts]))
        self.show()
        if level in ("check", "poor"):
            QAccessible.updateAccessibility(QAccessibleEvent(self, QAccessible.Event.Alert))

    def show_role(self, role: Role) -> None:
        """Give advice that this role can follow."""
        self._role = role
        self._fill()

    def show_sitting(self, sitting: Sitting | None) -> None:
        """Show how far the sitting of the shown test has come; one button repeats it."""
        self.repeats.show_sitting(sitting)
        self.allow_repeat(self.repeats.allowed)

    def allow_repeat(self, allowed: bool) -> None:
        """Offer to repeat the shown test, or not: the next test is another one."""
        self.repeats.allow_repeat(allowed)
        self.run_again.setVisible(self._poor and allowed and not self.repeats.offers_repeat)

    @property
    def texts(self) -> tuple[str, ...]:
        """All findings, including those that are not shown at first."""
        findings = () if self._quality is None else self._quality.findings
        said = (sentences(finding.message, self._advice(finding)) for finding in findings)
        return (_(UNJUDGED),) if self._quality is None else tuple(translated(line) for line in said)

    def _advice(self, finding: QualityFinding) -> str:
        """Return what to do, as far as the role can do it."""
        asks = self._role != "technician" and finding.code.startswith(_CALIBRATION)
        return _(_ASK) if asks else translated(finding.advice)

    def _fill(self) -> None:
        while (item := self.grid.takeAt(0)) is not None:
            if (widget := item.widget()) is not None:
                widget.hide()
                widget.deleteLater()
        findings = () if self._quality is None else self._quality.findings
        calibrated = not any(finding.code.startswith(_CALIBRATION) for finding in findings)
        self.calibrate.setVisible(self._role == "technician" and not calibrated)
        if self._quality is None:
            self.grid.addWidget(_text(_(UNJUDGED), "muted"), 0, 0, 1, 2)
            self.more.hide()
            return
        hidden = len(findings) - MOST_SHOWN
        self.more.setVisible(hidden > 0)
        self.more.setText(_("Fewer") if self.more.isChecked() else _("{count} more").format(count=hidden))
        shown = findings if self.more.isChecked() else findings[:MOST_SHOWN]
        for index, finding in enumerate(shown):
            self.grid.addWidget(_text(translated(finding.message), ""), index, 0)
            self.grid.addWidget(_text(self._advice(finding), "muted"), index, 1)


def _text(text: str, role: str) -> QLabel:
    return label(role, text=text, alignment=Qt.AlignmentFlag.AlignTop | Qt.AlignmentFlag.AlignLeft)
