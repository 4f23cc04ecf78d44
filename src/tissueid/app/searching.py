"""Looking for instruments, and for tests that were never finished."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject

from tissueid.app.errands import Recovery, recover_all, unfinished
from tissueid.app.instruments import Survey, survey
from tissueid.app.layout import MEASURE
from tissueid.app.words import in_words
from tissueid.audit import Trail
from tissueid.errors import TissueIDError
from tissueid.instrument.twin_list import twins_in
from tissueid.language import _, plural

if TYPE_CHECKING:
    from tissueid.app.main_window import MainWindow


class Searching(QObject):
    """Stands between the window and what may be found."""

    def __init__(self, window: MainWindow) -> None:
        super().__init__(window)
        self._window = window
        self._chooser = window.ui.form.instrument
        self._chooser.refresh.clicked.connect(self.find_instruments)
        window.ui.notice.accepted.connect(self.recover)

    def find_instruments(self) -> None:
        """Ask every port whether an instrument answers."""
        if self._window.busy:
            return
        self._chooser.about.setText(_("Asking every port…"))
        self._window.ui.notice.retract()
        around = self._window.around
        work = functools.partial(survey, around.finder, around.opener, around.calibrate)
        why = _("Every port is being asked whether an instrument answers: wait a few seconds.")
        self._window.jobs.do(work, self._found, self._finding_failed, why=why)

    def list_instruments(self) -> None:
        """Offer what can be seen without asking; a system that cannot list its ports still has typed addresses."""
        try:
            self._chooser.offer(self._window.around.finder(probe=False))
        except (TissueIDError, OSError) as error:
            self._finding_failed(in_words(error))
        self.list_twins()

    def list_twins(self) -> None:
        """Offer the twins that lie where sessions are saved, and where diagnoses save them."""
        self._chooser.offer_twins(twins_in(self._window.around.folder))

    def _found(self, found: Survey) -> None:
        self._chooser.offer(found.found)
        self.list_twins()
        for url, state in found.calibrations.items():
            self._chooser.tell_calibration(url, state)
        for url, force_n in found.forces_n.items():
            self._window.ui.form.tell_force(url, force_n)
        self._window.ui.notice.say(found.words)

    def _finding_failed(self, words: str) -> None:
        self._chooser.offer([])
        self._window.ui.notice.say(words, problem=True)

    def offer_recovery(self) -> None:
        """Say which tests were never finished, where there are any."""
        folder = self._window.around.folder
        found = unfinished(folder)
        if found:
            count = len(found)
            names = ", ".join(path.name.removesuffix(".journal") for path in found[:3])
            self._window.ui.notice.say(
                plural(
                    "An unfinished test was found in {folder}: {names}.",
                    "{count} unfinished tests were found in {folder}: {names}.",
                    count,
                ).format(count=count, folder=folder, names=names),
                offer=_("Re&cover"),
            )

    def recover(self) -> None:
        """Make sessions of all tests that were never finished, and show the last of them."""
        if not self._window.busy:
            self._window.ui.notice.retract()
            trail = Trail(self._window.around.audit, self._window.ui.role.role)
            work = functools.partial(_recover_folder, self._window.around.folder, trail)
            self._window.jobs.do(work, self._recovered, self._window.say_failed)

    def _recovered(self, recovery: Recovery) -> None:
        saved = [_("Recovered {path}.").format(path=path) for path, _session in recovery.sessions]
        words = " ".join(saved + recovery.problems) or _("There is nothing left to recover.")
        self._window.ui.notice.say(words, problem=bool(recovery.problems), page=MEASURE)
        for path, _session in recovery.sessions:
            self._window.pages.heard_of(path)
        if recovery.sessions:
            self._window.identify(*recovery.sessions[-1])


def _recover_folder(folder: Path, trail: Trail) -> Recovery:
    """What is unfinished now, not what was when it was offered."""
    return recover_all(unfinished(folder), trail)
