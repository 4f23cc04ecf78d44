"""Leads the page Measure through a sitting of a study: fills the form with the next test after each test."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from PySide6.QtCore import QObject, Qt, Signal
from PySide6.QtWidgets import QDialog, QDialogButtonBox, QFormLayout, QLineEdit, QWidget

from tissueid.app import build
from tissueid.app.context import AppContext
from tissueid.app.layout import Layout
from tissueid.app.navigation_bar import MEASURE
from tissueid.app.number_field import OptionalNumberField
from tissueid.app.session_jobs import find
from tissueid.app.views.clinician.sitting import NORM, Repeat, repeat_of
from tissueid.app.window_state import keep_visited_study
from tissueid.app.words import in_words
from tissueid.atomic_write import private_folder
from tissueid.errors import UnusableInputError
from tissueid.language import _, marked
from tissueid.messages import Message, Verbatim, translated
from tissueid.procedures.study_protocol import SittingStep
from tissueid.procedures.study_sitting import SittingState, open_sitting
from tissueid.procedures.study_subjects import (
    DEMOGRAPHIC_FIELDS,
    DemographicField,
    add_photograph,
    demographic_value,
    read_demographics,
    save_demographics,
)
from tissueid.sessions import Session

_FIELD_HEIGHT = 28
"""Pixels."""


class DemographicsDialog(QDialog):
    """``filled`` carries the values as they are stored, by name; empty ones are not known."""

    filled = Signal(dict)

    def __init__(
        self, subject: str, names: Sequence[str], stored: Mapping[str, str], parent: QWidget | None = None
    ) -> None:
        super().__init__(parent)
        self.setWindowTitle(translated(Message("study.subject", "Subject {subject}", subject=Verbatim(subject))))
        about = build.label(
            "muted", text=_("For the statistics of the study. Leave empty what is not known. Never enter a name.")
        )
        self.problem = build.label("readout", level="poor", hidden=True)
        self.fields: dict[str, QWidget] = {}
        self._read: dict[str, Callable[[], str]] = {}
        form = QFormLayout()
        for name in names:
            kind = DEMOGRAPHIC_FIELDS[name]
            field, self._read[name] = _field(kind, stored.get(name, ""))
            build.styled(field, name=_(kind.title), minimum_height=_FIELD_HEIGHT)
            self.fields[name] = field
            form.addRow(_(kind.title), field)
        buttons = QDialogButtonBox(QDialogButtonBox.StandardButton.Ok | QDialogButtonBox.StandardButton.Cancel)
        buttons.button(QDialogButtonBox.StandardButton.Ok).setText(_("Save"))
        buttons.button(QDialogButtonBox.StandardButton.Cancel).setText(_("Later"))
        buttons.accepted.connect(self.save)
        buttons.rejected.connect(self.reject)
        build.column(about, form, self.problem, buttons, margins=(11,), parent=self)
        self.setMinimumWidth(360)

    def save(self) -> None:
        """Check the values, send them and close; say what is wrong otherwise."""
        try:
            values = {name: demographic_value(name, read()) for name, read in self._read.items()}
        except UnusableInputError as error:
            self.problem.setText(in_words(error))
            self.problem.show()
            return
        self.filled.emit(values)
        self.accept()


def _field(kind: DemographicField, stored: str) -> tuple[QWidget, Callable[[], str]]:
    """Return a control with a value, and a function that returns what it holds."""
    if kind.bounds is not None:
        number = OptionalNumberField(kind.bounds[1])
        build.styled(number, decimals=3, suffix=f" {_(kind.unit)}")
        try:
            number.give(float(stored))
        except ValueError:
            number.give(None)
        return number, lambda: "" if number.given is None else f"{number.given:.10g}"
    if kind.choices:
        entries = {"": _("not known")} | {value: _(value) for value in kind.choices}
        choice = build.choice(entries if stored in entries else entries | {stored: stored})
        choice.setCurrentIndex(choice.findData(stored))
        return choice, lambda: str(choice.currentData())
    text = build.styled(QLineEdit(stored), max_length=200)
    return text, text.text


@dataclass(frozen=True)
class _Opened:
    """A sitting, the stored values of its subject, and the tests that were recorded before at the next place."""

    state: SittingState
    demographics: dict[str, str]
    before: tuple[Repeat, ...]


class StudySitting(QObject):
    """The sitting of a study, if one is open. It starts no test: that is what the button Start test is for."""

    def __init__(self, context: AppContext, ui: Layout, parent: QObject) -> None:
        super().__init__(parent)
        self._context, self._ui = context, ui
        self.state: SittingState | None = None
        self.dialog: DemographicsDialog | None = None
        self.instruction = ""
        """What comes next, in one sentence; "" without a sitting."""
        self.before: tuple[Repeat, ...] = ()
        """Tests of the next place from an earlier visit, without an accepted result."""
        self._demographics: dict[str, str] = {}
        self._folder_before = ui.form.folder
        self.card = ui.study_card
        self.card.data.clicked.connect(self.ask_demographics)
        self.card.photograph.clicked.connect(self._ask_photograph)
        self.card.leave.clicked.connect(self.leave)
        self.card.next_subject.clicked.connect(self._choose_next)

    @property
    def leads(self) -> bool:
        """Whether a sitting is open."""
        return self.state is not None

    @property
    def complete(self) -> bool:
        """Whether a sitting is open in which nothing is left to measure."""
        return self.state is not None and self.state.step is None

    @property
    def moved_on(self) -> bool:
        """Whether the next test is the first one at its place, or none is left: the place before is finished."""
        step = None if self.state is None else self.state.step
        return self.complete or (step is not None and step.repeat == 1 and step.attempt == 1)

    @property
    def wanted(self) -> int:
        """Return the number of repeats at a new place, those recorded before left out."""
        step = None if self.state is None else self.state.step
        return NORM if step is None else step.repeats - step.repeat + 1

    def begin(self, folder: Path, subject: str) -> None:
        """Open the sitting of a subject and offer its next test on the page Measure."""
        if self._context.busy:
            return
        self._context.jobs.do(functools.partial(_open, folder, subject), self._opened, self._failed)

    def recorded(self, path: Path, session: Session) -> None:
        """Count the tests of a session that was just recorded, and offer the next one."""
        if self.state is not None and path.parent == self.state.sessions:
            before, self.before = self.state.step, ()
            self.state.add(path, session.subject.pseudonym, session.tests)
            self._offer(before)

    def leave(self) -> None:
        """Leave the sitting; it continues when it is opened again."""
        if self.state is None or self._context.state.testing:
            return
        self.state, self.instruction, self.before = None, "", ()
        self.card.hide()
        self._ui.start.setToolTip("")
        self._ui.start.setEnabled(not self._context.busy)
        self._context.show_idle()
        self._ui.form.subject.setReadOnly(False)
        self._ui.form.save_in(self._folder_before)
        self._ui.form.fill({"pseudonym": "", "site": "", "condition": "", "minutes_since_application": None})

    def _choose_next(self) -> None:
        self.leave()
        self._context.go("studies")
        self._ui.focus_page()

    def ask_demographics(self) -> None:
        """Ask for the values of the subject that the protocol wants."""
        if self.state is None or not self.state.protocol.demographics:
            return
        window = self._ui.form.window()
        self.dialog = DemographicsDialog(
            self.state.subject, self.state.protocol.demographics, self._demographics, window
        )
        self.dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self.dialog.setPalette(window.palette())
        self.dialog.filled.connect(self._save)
        self.dialog.open()

    def update_enabled(self, *, busy: bool) -> None:
        """Disable the buttons of the card while a job runs."""
        self.card.update_enabled(busy=busy)
        if self.complete:
            self._ui.start.setEnabled(False)
        self.card.data.setVisible(self.state is None or bool(self.state.protocol.demographics))

    # -- private ----------------------------------------------------------------------------------------------

    def _opened(self, opened: _Opened) -> None:
        if not self.leads:
            self._folder_before = self._ui.form.folder
        state, self._demographics, self.before = opened.state, opened.demographics, opened.before
        keep_visited_study(self._context.settings, state.folder.absolute())
        self.state = state
        self._context.go(MEASURE)
        self._ui.form.subject.setReadOnly(True)  # a test of another subject would be stored in this one's folder
        self._ui.form.subject_chosen.emit(state.subject)
        self._ui.form.save_in(state.sessions)
        self._offer(None)
        self._context.show_idle()
        if state.problems:
            self._say(_unreadable(state.problems.items()), problem=True)
        if any(not self._demographics.get(name, "").strip() for name in state.protocol.demographics):
            self.ask_demographics()

    def _offer(self, before: SittingStep | None) -> None:
        """Show the next test and fill the form with it; ``before`` is the test that was just recorded."""
        state = self.state
        assert state is not None
        step, protocol = state.step, state.protocol
        moved = before is not None and step is not None and step.site != before.site
        self.card.show_state(state, moved=moved)
        if step is None:
            done = Message("study.complete", "The sitting of {subject} is complete.", subject=Verbatim(state.subject))
            self.instruction = translated(done)
            self._ui.start.setToolTip(_("The sitting is complete. To measure anything else, press Leave."))
            self._ui.start.setEnabled(False)
            self._say(self.instruction)
            return
        self.instruction = _next_words(before, step)
        values = protocol.settings(step) | {
            "pseudonym": step.subject,
            "limits": protocol.limits,
            "preset": protocol.stimulus,
            "repeats": 1,
            "under_probe": "",
        }
        self._ui.form.fill(values | ({} if protocol.seconds is None else {"seconds": protocol.seconds}))
        if why := protocol.preset.why_not(self._ui.form.most_n):
            self._say(translated(why), problem=True)

    def _save(self, values: dict[str, str]) -> None:
        state = self.state
        if state is None:
            return
        self._demographics |= values
        work = functools.partial(save_demographics, state.folder, state.subject, dict(values))
        self._context.jobs.do(work, self._saved, self._failed)

    def _saved(self, _result: object) -> None:
        """They are in the file; there is nothing to say."""

    def _ask_photograph(self) -> None:
        kinds = _("Pictures (*.jpg *.jpeg *.png)")
        build.ask_path(self._ui.form, _("Photograph of the site"), None, self.add_photograph, kinds)

    def add_photograph(self, path: Path) -> None:
        """Copy a photograph of the site of the form into the folder of the study."""
        state, site = self.state, self._ui.form.site.currentText().strip()
        if state is not None and not self._context.busy:
            work = functools.partial(add_photograph, state.folder, state.subject, site, path)
            self._context.jobs.do(work, self._photographed, self._failed)

    def _photographed(self, path: Path) -> None:
        self._say(_("Saved in {path}.").format(path=path))

    def _failed(self, message: str) -> None:
        self._context.show_idle()
        self._context.say(message, problem=True)

    def _say(self, message: str, *, problem: bool = False) -> None:
        self._ui.notice.say(message, problem=problem, page=MEASURE)


def _open(folder: Path, subject: str) -> _Opened:
    state = open_sitting(folder, subject)
    demographics = read_demographics(folder).get(state.subject, {})
    private_folder(state.sessions)
    step = state.step
    tests = state.places.get((step.site, step.condition), []) if step is not None and step.repeat > 1 else []
    before = [find(path, None, number) for path, number in tests]
    return _Opened(state, demographics, tuple(repeat_of(test) for test in before if test.accepted is None))


def _next_words(before: SittingStep | None, step: SittingStep) -> str:
    """Return what to do for the next test, in one line."""
    names = {"site": Verbatim(step.site), "repeat": step.repeat, "count": step.repeats}
    if before is None:
        said = Message("study.first", "Place the probe: {site}. Then start the test.", **names)
    elif step.site != before.site:
        said = Message("study.move", "Now move to: {site}. Then start the test.", **names)
    else:
        said = Message("study.stay", "Same site again: {site}, test {repeat} of {count}.", **names)
    messages = [translated(said)]
    condition = step.condition.text
    if condition != ("" if before is None else before.condition.text):
        said = Message("study.now", "Condition: {condition}.", condition=condition or marked("without product"))
        messages.append(translated(said))
    return " ".join(messages)


def _unreadable(problems: Iterable[tuple[str, str]]) -> str:
    failures = list(problems)
    file, reason = failures[0]
    said = Message(
        "study.unreadable",
        "{count} files of this subject cannot be read and do not count; the first is {file}: {reason}",
        count=len(failures),
        file=file,
        reason=Verbatim(reason),
    )
    return translated(said)
