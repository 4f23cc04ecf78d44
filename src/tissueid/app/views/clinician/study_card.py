"""The card of a sitting in a study: the next test, its site on a body, and the progress."""

from __future__ import annotations

from PySide6.QtWidgets import QFrame, QHBoxLayout, QLabel, QProgressBar, QPushButton, QVBoxLayout, QWidget

from tissueid.app.small_window import FoldingBox
from tissueid.app.theme import Theme
from tissueid.app.views.clinician.sitting_map import SittingMap
from tissueid.app.widgets import ElidedLabel, plain_label
from tissueid.formatting import clean
from tissueid.language import _
from tissueid.messages import Message, Verbatim, joined, translated
from tissueid.procedures.study_protocol import Condition, finished_sites
from tissueid.procedures.study_sitting import SittingState

_BUTTONS_IN_A_ROW = 250
"""Width from which the buttons are in one row, pixels."""


def condition_words(condition: Condition) -> str:
    """Return a condition in a line; "" for none."""
    words: list[str] = [Verbatim(condition.product)] if condition.product else []
    if condition.minutes_since_application is not None:
        words.append(Message("study.after", "after {minutes:g} min", minutes=condition.minutes_since_application))
    if condition.orientation_deg is not None:
        words.append(Verbatim(f"{condition.orientation_deg:g}°"))
    return translated(joined(words)) if words else ""


class StudyCard(QFrame):
    """Hidden without a study. Its buttons ask for the subject's data, a photograph, or the end of the sitting."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setProperty("role", "card")
        self.heading = ElidedLabel()
        self.heading.setProperty("role", "heading")
        self.progress_text = QLabel()
        self.progress_text.setProperty("role", "headline")
        self.site = plain_label("heading")
        self.test = plain_label()
        self.condition = plain_label()
        self.remark = plain_label("readout")
        self.remark.setProperty("level", "check")
        self.map = SittingMap()
        self.bar = QProgressBar()
        self.bar.setTextVisible(False)
        self.bar.setAccessibleName(_("Progress of the sitting"))
        self.data = QPushButton(_("Subject…"))
        self.data.setAccessibleName(_("Demographic values of the subject"))
        self.photograph = QPushButton(_("Photograph…"))
        self.photograph.setAccessibleName(_("Add a photograph of the site"))
        self.leave = QPushButton(_("Leave"))
        self.leave.setAccessibleName(_("Leave the sitting of the study"))
        self.leave.setToolTip(_("What is recorded is kept; the sitting continues when it is opened again"))
        for button in self.buttons:
            button.setProperty("role", "small")
        words = QVBoxLayout()
        words.setSpacing(2)
        for part in (self.progress_text, self.site, self.test, self.condition, self.remark):
            words.addWidget(part)
        words.addStretch(1)
        row = QHBoxLayout()
        row.setSpacing(8)
        row.addWidget(self.map)
        row.addLayout(words, 1)
        holder = QWidget()
        buttons = FoldingBox(_BUTTONS_IN_A_ROW, holder)
        buttons.setContentsMargins(0, 0, 0, 0)
        buttons.setSpacing(6)
        for button in self.buttons:
            buttons.addWidget(button)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(8, 8, 8, 8)
        layout.setSpacing(6)
        layout.addWidget(self.heading)
        layout.addLayout(row)
        layout.addWidget(self.bar)
        layout.addWidget(holder)
        self.hide()

    @property
    def buttons(self) -> tuple[QPushButton, ...]:
        """The buttons in their order."""
        return self.data, self.photograph, self.leave

    def show_state(self, state: SittingState) -> None:
        """Show where a sitting is and what comes next."""
        step, protocol = state.step, state.protocol
        subject = Verbatim(state.subject)
        heading = Message("study.heading", "{study}: {subject}", study=Verbatim(clean(protocol.name)), subject=subject)
        self.heading.setText(translated(heading))
        self.map.show_sites(
            [site.site for site in protocol.sites],
            "" if step is None else step.site,
            finished_sites(protocol, state.subject, step),
        )
        self.bar.setRange(0, state.total)
        self.bar.setValue(state.total if step is None else step.place - 1)
        self.photograph.setVisible(protocol.photograph)
        if step is None:
            self.progress_text.setText(_("Complete"))
            self.site.setText(translated(Message("study.all", "All {total} tests are done.", total=state.total)))
        else:
            place = Message("study.place", "{place} of {total}", place=step.place, total=step.total)
            self.progress_text.setText(translated(place))
            self.site.setText(clean(step.site))
            here = {"repeat": step.repeat, "count": step.repeats}
            repeat = Message("study.repeat", "Test {repeat} of {count} here", **here)
            self.test.setText(translated(repeat))
            self.condition.setText(condition_words(step.condition))
        again = step is not None and step.attempt > 1
        self.remark.setText(_("Again: the last test does not count.") if again else "")
        self.test.setVisible(step is not None)
        for label in (self.condition, self.remark):
            label.setVisible(step is not None and bool(label.text()))
        self.show()

    def update_enabled(self, *, busy: bool) -> None:
        """Disable the buttons while a job runs."""
        for button in self.buttons:
            button.setEnabled(not busy)

    def apply_theme(self, theme: Theme) -> None:
        """Apply the colours of a theme."""
        self.map.apply_theme(theme)
