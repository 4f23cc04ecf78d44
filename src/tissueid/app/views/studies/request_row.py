"""Choices of the page: folder, engine and its options, and the buttons that analyse, report and measure."""

from __future__ import annotations

import functools
from pathlib import Path

from PySide6.QtCore import QSettings, Qt, Signal
from PySide6.QtWidgets import (
    QCheckBox,
    QComboBox,
    QFileDialog,
    QFrame,
    QLineEdit,
    QMenu,
    QProgressBar,
    QPushButton,
    QSizePolicy,
    QVBoxLayout,
    QWidget,
)

from tissueid.app.build import button, fill, label, row, styled
from tissueid.app.small_window import FoldingBox
from tissueid.app.views.studies.protocol_dialog import OptionsDialog
from tissueid.app.views.studies.study_data import StudyData
from tissueid.app.widgets import ElidedLabel, plain_tip, show_level
from tissueid.app.window_state import load_texts, save_texts
from tissueid.formatting import clean
from tissueid.identification import engine_label, engine_names
from tissueid.language import _
from tissueid.messages import Message, Verbatim, translated
from tissueid.plan_options import parse_options
from tissueid.procedures.study_plans import StudyPlan

_STEPS = 1000
_ONE_ROW = 620
_FOLDER, _ENGINE, _OPTIONS, _HELD_OUT = "study/folder", "study/engine", "study/options", "study/held-out"
_RECENT = "study/recent"
_MOST_RECENT = 10


class RequestRow(QFrame):
    """Signals: ``chosen`` and ``made`` carry a folder; the others are sent by the buttons."""

    chosen = Signal(object)
    made = Signal(object)
    """The folder of a new study, which is to be made."""
    wanted = Signal()
    report_wanted = Signal()
    protocol_wanted = Signal()
    sitting_wanted = Signal(str)
    unwanted = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        styled(self, role="card")
        self.path: Path | None = None
        opening = _("A folder of sessions, with a protocol.json if sittings follow a protocol")
        self.open = button(_("Open study…"), self._choose, tip=opening)
        self.new = button(_("New study…"), self._name_new, tip=_("Name a folder for a new study; it is made"))
        self.folder = ElidedLabel()
        self.engine = styled(QComboBox(), name=_("Engine of the study"))
        for name in engine_names():
            self.engine.addItem(engine_label(name), name)
        self.recent = button(_("Recent"), name=_("Recent studies"), menu=QMenu(self))
        self.options = button("", self._edit_options, name=_("Options of the engine"))
        self._options: tuple[str, ...] = ()
        self._studies: list[str] = []
        held_out = _("Fit three quarters of each test and score the rest; otherwise fit whole tests")
        self.held_out = styled(QCheckBox(_("Score on held-out data")), tip=held_out)
        analysing = _("Sessions that are new or changed; after a cancellation it continues")
        self.analyse = button(_("Analyse"), self.wanted, tip=analysing)
        reporting = _("Analyse what has changed, compute all statistics, and open the page")
        self.report = button(_("Write report"), self.report_wanted, tip=reporting)
        self.protocol = label("muted")
        self.template = button(
            "", self.protocol_wanted, tip=_("Sites, repeats, conditions, and what a subject is asked for")
        )
        pseudonym = _("Pseudonym of the subject, never a name")
        self.subject = styled(QLineEdit(), name=pseudonym, tip=pseudonym, placeholder_text=_("Subject, such as P-001"))
        leading = _("Lead through the sitting of this subject on the page Measure; nothing starts yet")
        self.measure = button(_("Measure subject"), self._ask_sitting, tip=leading)
        self.doing = styled(ElidedLabel(), role="muted")
        self.bar = styled(QProgressBar(), name=_("Progress of the study"), text_visible=False)
        self.stop = button(_("Cancel"), self.unwanted, name=_("Cancel the work on the study"))
        self._of_analysis = self.engine, self.options, self.held_out, self.analyse, self.report
        self._of_visit = self.protocol, self.template, self.subject, self.measure
        self._arrange()
        self.subject.returnPressed.connect(self._ask_sitting)
        self.engine.currentIndexChanged.connect(lambda: self._take_options(()))
        self.engine.setCurrentIndex(self.engine.findData(StudyPlan.model_fields["engine"].default))
        self.show_study(None)
        self.clear()

    @property
    def fields(self) -> list[QWidget]:
        """Widgets in tab order."""
        first = [self.open, self.new, self.recent, self.engine, self.options, self.held_out, self.analyse, self.report]
        return [*first, self.template, self.subject, self.measure, self.stop]

    @property
    def waiting(self) -> tuple[QPushButton, ...]:
        """The buttons that are disabled while other work runs."""
        return self.open, self.new, self.analyse, self.report, self.template, self.measure

    def plan(self, folder: Path, *, workers: int | None) -> StudyPlan:
        """Return the plan of an analysis.

        Raises:
            UnusableInputError: a value is not possible.
        """
        return StudyPlan(
            folder=folder,
            engine=str(self.engine.currentData()),
            options=self._options,
            held_out=self.held_out.isChecked(),
            workers=workers,
        )

    def show_study(self, data: StudyData | None) -> None:
        """Show the folder and the protocol of a study."""
        self.path = None if data is None else data.folder
        self.folder.setText(_("No study is open.") if data is None else clean(str(data.folder)))
        if data is not None:
            self._studies = list(dict.fromkeys([str(data.folder), *self._studies]))[:_MOST_RECENT]
        self._offer_recent()
        for part in (*self._of_analysis, *self._of_visit):
            part.setVisible(data is not None)
        if data is None:
            return
        show_level(self.protocol, "check" if data.protocol_problem else "")
        if data.protocol is not None:
            said = Message(
                "study.protocol",
                "Protocol: {name}, {count} tests for each subject",
                name=Verbatim(clean(data.protocol.name)),
                count=data.steps,
            )
            self.protocol.setText(translated(said))
        else:
            self.protocol.setText(
                translated(data.protocol_problem)
                or _("This study has no protocol: its tests can be analysed; a visit needs a protocol.")
            )
        self.template.setVisible(not data.protocol_problem)
        self.template.setText(_("New protocol…") if data.protocol is None else _("Edit protocol…"))
        for part in (self.subject, self.measure):
            part.setVisible(data.protocol is not None)

    def show_progress(self, fraction: float | None, step: str) -> None:
        """Show the step, and its completed share from 0 to 1 or None where that is not known."""
        for part in (self.doing, self.bar, self.stop):
            part.show()
        self.doing.setText(translated(step))
        self.bar.setRange(0, 0 if fraction is None else _STEPS)
        self.bar.setValue(0 if fraction is None else round(_STEPS * fraction))

    def show_reason(self, why: str) -> None:
        """Say why no work on the study can start; an empty text hides it."""
        self.doing.setText(why)
        self.doing.setVisible(bool(why))

    def clear(self) -> None:
        """Hide the progress."""
        for part in (self.doing, self.bar, self.stop):
            part.hide()

    def update_enabled(self, *, busy: bool, working: bool) -> None:
        """Enable what makes sense now; Cancel is always possible. ``working`` is whether other long work runs."""
        for part in (self.open, self.new):
            part.setEnabled(not busy and self.bar.isHidden())
        for part in (self.analyse, self.report, self.template):
            part.setEnabled(not working and self.path is not None)
        self.measure.setEnabled(not busy and self.path is not None)

    def save(self, settings: QSettings) -> None:
        """Save the choices."""
        settings.setValue(_FOLDER, "" if self.path is None else str(self.path))
        settings.setValue(_ENGINE, self.engine.currentData())
        save_texts(settings, _OPTIONS, self._options)
        save_texts(settings, _RECENT, self._studies)
        settings.setValue(_HELD_OUT, "yes" if self.held_out.isChecked() else "no")

    def restore(self, settings: QSettings) -> Path | None:
        """Restore the choices; return the folder of the last study, if it is still there."""
        place = self.engine.findData(str(settings.value(_ENGINE, "")))
        self.engine.setCurrentIndex(place if place >= 0 else self.engine.currentIndex())
        self._take_options(tuple(load_texts(settings, _OPTIONS)))
        self._studies = load_texts(settings, _RECENT)[:_MOST_RECENT]
        self._offer_recent()
        self.held_out.setChecked(str(settings.value(_HELD_OUT, "no")) == "yes")
        kept = str(settings.value(_FOLDER, ""))
        return Path(kept) if kept and Path(kept).is_dir() else None

    def _arrange(self) -> None:
        chosen, led = QWidget(), QWidget()
        fill(FoldingBox(_ONE_ROW, chosen), *self._of_analysis, spacing=8)
        fill(FoldingBox(_ONE_ROW, led), *self._of_visit, spacing=8)
        styled(
            self.engine,
            size_adjust_policy=QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon,
            minimum_contents_length=12,
        )
        self.subject.setMaximumWidth(200)
        for part in (self.measure, self.template):
            part.setSizePolicy(QSizePolicy.Policy.Maximum, QSizePolicy.Policy.Fixed)
        fill(
            QVBoxLayout(self),
            row(self.open, self.new, self.recent, (self.folder, 1), spacing=8),
            chosen,
            led,
            row((self.doing, 2), (self.bar, 1), self.stop, spacing=8),
            margins=(12, 8, 12, 8),
        )

    def _take_options(self, options: tuple[str, ...]) -> None:
        """Take options, as NAME=VALUE, of the engine."""
        self._options = options
        changed = _("Options… ({count} changed)").format(count=len(options))
        self.options.setText(changed if options else _("Options…"))
        self.options.setToolTip(plain_tip("\n".join(options) or _("All options have their defaults")))

    def _edit_options(self) -> None:
        dialog = OptionsDialog(str(self.engine.currentData()), parse_options(self._options), self)
        dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        dialog.chosen.connect(self._take_options)
        dialog.open()

    def _offer_recent(self) -> None:
        menu = self.recent.menu()
        menu.clear()
        for folder in self._studies:
            menu.addAction(clean(folder).replace("&", "&&"), functools.partial(self.chosen.emit, Path(folder)))
        self.recent.setVisible(bool(self._studies))

    def _choose(self) -> None:
        dialog = styled(
            QFileDialog(self.window(), _("Open a study"), "" if self.path is None else str(self.path)),
            file_mode=QFileDialog.FileMode.Directory,
            option=QFileDialog.Option.ShowDirsOnly,
        )
        dialog.fileSelected.connect(lambda path: self.chosen.emit(Path(path)))
        dialog.open()

    def _name_new(self) -> None:
        near = None if self.path is None else self.path.parent
        dialog = styled(
            QFileDialog(self.window(), _("New study: name its folder"), "" if near is None else str(near)),
            accept_mode=QFileDialog.AcceptMode.AcceptSave,
        )
        dialog.setOption(QFileDialog.Option.DontConfirmOverwrite)  # a folder that is there is opened
        dialog.setLabelText(QFileDialog.DialogLabel.Accept, _("Create"))
        dialog.fileSelected.connect(lambda path: self.made.emit(Path(path)))
        dialog.open()

    def _ask_sitting(self) -> None:
        if self.measure.isEnabled() and self.measure.isVisible():
            self.sitting_wanted.emit(self.subject.text())
