"""Begins and ends the watch of a probe before a test, and starts the test where that was asked for meanwhile."""

from __future__ import annotations

import functools
import threading
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject, QTimer

from tissueid.app.calibration_state import calibration_state
from tissueid.app.layout import MEASURE
from tissueid.app.views.clinician.contact import Contact
from tissueid.app.views.clinician.watching import Sight, Watched, watch
from tissueid.language import _, marked

if TYPE_CHECKING:
    from tissueid.app.main_window import MainWindow

_LOOK_MS = 80
NOT_ON_SKIN = marked("The button was pressed, but the probe does not stand on the skin: nothing was started.")


class Watcher(QObject):
    """One watch at a time. The window is busy with it, but a test can be started: then the watch ends first."""

    def __init__(self, window: MainWindow) -> None:
        super().__init__(window)
        self._window = window
        self._lamp = window.ui.guidance.lamp
        self._sight: Sight | None = None
        self._stop = threading.Event()
        self._url = ""
        self._start_next = False
        self._looks = QTimer(self)
        self._looks.setInterval(_LOOK_MS)
        self._looks.timeout.connect(self._look)
        self._lamp.watch.clicked.connect(self._toggle)
        self._lamp.arm.toggled.connect(self._arm)
        window.ui.form.instrument.choice.currentTextChanged.connect(self.cancel)
        window.ui.stack.currentChanged.connect(self._page_changed)
        window.jobs.changed.connect(self._go_on)

    @property
    def watching(self) -> bool:
        """Whether a probe is watched."""
        return self._sight is not None

    def cancel(self) -> None:
        """End the watch, if there is one."""
        self._stop.set()

    def start_after(self) -> bool:
        """Start a test as soon as the watch is over; False where none goes on."""
        if not self.watching:
            return False
        self._start_next = True
        self._stop.set()
        return True

    def settle(self, *, busy: bool, testing: bool) -> None:
        """The watch can be begun where nothing goes on, and ended while it does."""
        self._lamp.watch.setVisible(not testing)
        self._lamp.watch.setEnabled(self.watching or not busy)
        self._lamp.watch.setChecked(self.watching)
        self._lamp.watch.setText(_("Stop watching") if self.watching else _("Watch contact"))
        if not self.watching:
            self._lamp.arm.hide()

    def _toggle(self) -> None:
        if self.watching:
            self.cancel()
        elif not self._window.busy:
            self._begin()

    def _begin(self) -> None:
        around = self._window.around
        self._url = self._window.ui.form.instrument.url
        self._stop = threading.Event()
        self._sight = sight = Sight()
        self._lamp.arm.setChecked(False)
        self._lamp.show_contact(Contact.FINDING)
        self._looks.start()
        work = functools.partial(watch, self._url, sight, self._stop, around.opener, around.calibrate)
        why = _("Contact is being watched on Measure: stop watching there first.")
        self._window.jobs.do(work, self._ended, self._failed, why=why)

    def _look(self) -> None:
        sight = self._sight
        if sight is None:
            return
        self._lamp.show_contact(sight.contact)
        self._window.ui.safety.show_watched(_(sight.contact.value), sight.contact.level)
        if sight.device is not None:
            form = self._window.ui.form
            form.instrument.tell_calibration(self._url, calibration_state(sight.device))
            form.tell_force(self._url, sight.greatest_force_n)
            self._lamp.arm.setVisible(sight.has_button)
        if sight.refused:
            sight.refused = False
            self._window.ui.notice.say(_(NOT_ON_SKIN), problem=True, page=MEASURE)

    def _arm(self, on: bool) -> None:
        if self._sight is not None and on:
            self._sight.armed.set()
        elif self._sight is not None:
            self._sight.armed.clear()

    def _ended(self, watched: Watched) -> None:
        self._look()
        self._close()
        self._start_next = self._start_next or watched.pressed
        if watched.too_long:
            self._window.ui.notice.say(_("Contact is no longer watched: that went on for three minutes."), page=MEASURE)

    def _failed(self, words: str) -> None:
        self._close()
        self._start_next = False
        self._window.ui.form.instrument.doubt(self._url)
        self._window.ui.notice.say(words, problem=True, page=MEASURE)

    def _close(self) -> None:
        self._looks.stop()
        self._sight = None
        self._lamp.arm.setChecked(False)
        self._lamp.show_contact(Contact.UNWATCHED)
        self._window.ui.safety.rest()

    def _go_on(self) -> None:
        """The watch is over and its port free: now the test that was asked for can begin."""
        if self._start_next and not self._window.busy:
            self._start_next = False
            self._window.start_test()

    def _page_changed(self) -> None:
        if self._window.ui.page != MEASURE:
            self.cancel()
