"""Search for instruments and for unfinished tests."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from PySide6.QtCore import QObject, Signal

from tissueid.app.context import AppContext
from tissueid.app.form import PlanForm
from tissueid.app.jobs import JobControl
from tissueid.app.navigation_bar import MEASURE
from tissueid.app.notice import Notice
from tissueid.app.words import CalibrationState, calibration_state, in_words, sentence
from tissueid.audit import AuditTrail
from tissueid.errors import TissueIDError
from tissueid.formatting import clean
from tissueid.instrument import FoundInstrument, Instrument
from tissueid.instrument.discovery import IN_PROCESS
from tissueid.instrument.twin_list import twins_in
from tissueid.language import _, plural
from tissueid.messages import Message, Verbatim, translated
from tissueid.procedures.import_export import RecoveredSession, recover_folder, unfinished_journals
from tissueid.procedures.instruments import survey_instruments

_MOST_NAMED = 4


@dataclass(frozen=True)
class Survey:
    """Found instruments, and calibration and maximum force, N, of those that answered, by address."""

    instruments: Sequence[FoundInstrument]
    calibrations: dict[str, CalibrationState] = field(default_factory=dict)
    forces_n: dict[str, float] = field(default_factory=dict)

    @property
    def summary(self) -> str:
        """Number and names of the instruments that answer."""
        answering = [item for item in self.instruments if item.answers is True and not item.url.startswith(IN_PROCESS)]
        names = "; ".join(clean(translated(item.name or item.what)) for item in answering[:_MOST_NAMED])
        if len(answering) > 1:
            what = Message(
                "instruments.answer",
                "{count} instruments answer ({names})",
                count=len(answering),
                names=Verbatim(names),
            )
        elif answering:
            what = Message("instruments.one_answers", "One instrument answers ({names})", names=Verbatim(names))
        else:
            what = Message("instruments.none_answers", "No instrument answers")
        return translated(
            Message("instruments.found", "{what}; simulations in this program can always be chosen.", what=what)
        )


def survey(
    finder: Callable[..., list[FoundInstrument]],
    opener: Callable[[str], Instrument],
    calibrate: Callable[[Instrument], object],
) -> Survey:
    """Ask every port, and read the calibration of each instrument that answers.

    Raises:
        TissueIDError, OSError: the ports cannot be listed.
    """
    asked = survey_instruments(finder, opener, calibrate)
    calibrations = {url: calibration_state(device) for url, device in asked.devices.items()}
    return Survey(asked.instruments, calibrations, dict(asked.forces_n))


class DeviceSearch(QObject):
    """Searches for instruments and unfinished tests, and shows the result in the window."""

    recovered = Signal(object)
    """The sessions that were recovered: a list of their paths with their contents."""

    def __init__(self, context: AppContext, form: PlanForm, notice: Notice, parent: QObject) -> None:
        super().__init__(parent)
        self._context, self._form, self._notice = context, form, notice
        self._chooser = form.instrument
        self._chooser.refresh.clicked.connect(self.find_instruments)
        notice.accepted.connect(self.recover)

    def find_instruments(self) -> None:
        """Ask every port for an instrument."""
        if self._context.busy:
            return
        self._chooser.about.setText(_("Asking every port…"))
        self._notice.retract()
        services = self._context.services
        work = functools.partial(survey, services.finder, services.opener, services.calibrate)
        why = _("Every port is being asked whether an instrument answers: wait a few seconds.")
        self._context.jobs.do(work, self._found, self._finding_failed, why=why)

    def list_instruments(self) -> None:
        """List the instruments that are visible without asking the ports."""
        try:
            self._chooser.offer(self._context.services.finder(probe=False))
        except (TissueIDError, OSError) as error:
            self._finding_failed(in_words(error))
        self.list_twins()

    def list_twins(self) -> None:
        """List the twins in the folder of sessions."""
        self._chooser.offer_twins(twins_in(self._context.services.folder))

    def _found(self, survey: Survey) -> None:
        self._chooser.offer(survey.instruments)
        self.list_twins()
        for url, state in survey.calibrations.items():
            self._chooser.tell_calibration(url, state)
        for url, force_n in survey.forces_n.items():
            self._form.tell_force(url, force_n)
        self._notice.say(survey.summary)

    def _finding_failed(self, message: str) -> None:
        self._chooser.offer([])
        self._notice.say(message, problem=True)

    def offer_recovery(self) -> None:
        """Offer to recover unfinished tests, if there are any."""
        folder = self._context.services.folder
        journals = unfinished_journals(folder)
        if journals:
            count = len(journals)
            names = ", ".join(path.name.removesuffix(".journal") for path in journals[:3])
            self._notice.say(
                plural(
                    "An unfinished test was found in {folder}: {names}.",
                    "{count} unfinished tests were found in {folder}: {names}.",
                    count,
                ).format(count=count, folder=folder, names=names),
                offer=_("Re&cover"),
            )

    def recover(self) -> None:
        """Recover all unfinished tests and show the last of them."""
        if not self._context.busy:
            self._notice.retract()
            work = functools.partial(recover_all, self._context.services.folder, self._context.trail)
            self._context.jobs.do(work, self._recovered, self._context.say_failed)

    def _recovered(self, recovery: tuple[list[RecoveredSession], list[str]]) -> None:
        sessions, problems = recovery
        saved = [_("Recovered {path}.").format(path=recovered.path) for recovered in sessions]
        message = " ".join(saved + problems) or _("There is nothing left to recover.")
        self._notice.say(message, problem=bool(problems), page=MEASURE)
        if sessions:
            self.recovered.emit([(recovered.path, recovered.session) for recovered in sessions])


def recover_all(folder: Path, trail: AuditTrail) -> tuple[list[RecoveredSession], list[str]]:
    """Recover what is unfinished now, which may differ from what was offered; also return problems as sentences."""
    control = JobControl()
    sessions, errors = recover_folder(folder, control, trail)
    return sessions, [*(sentence(translated(notice)) for notice in control.notices), *map(in_words, errors)]
