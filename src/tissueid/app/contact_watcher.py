"""Contact of the probe with the skin: the contact light, the watch before a test, and the contact during it."""

from __future__ import annotations

import functools
import threading

import numpy as np
from PySide6.QtCore import QObject, Qt, Signal
from PySide6.QtGui import QAccessible, QAccessibleEvent
from PySide6.QtWidgets import QCheckBox, QLabel, QWidget

from tissueid.acquisition.playback import Phase
from tissueid.acquisition.surface_detection import MARGIN_M, RECENT_S, Contact, contact_at, finite
from tissueid.app import build
from tissueid.app.calibration_state import calibration_state
from tissueid.app.context import AppContext
from tissueid.app.form import PlanForm
from tissueid.app.live_signals import Snapshot
from tissueid.app.navigation_bar import MEASURE
from tissueid.app.notice import Notice
from tissueid.app.readouts import SafetyReadouts
from tissueid.device import DeviceDescription
from tissueid.language import _, marked
from tissueid.procedures.contact_watch import ContactWatch, WatchEnd, watch_contact


def contact_in_test(snapshot: Snapshot, device: DeviceDescription) -> Contact:
    """Return the contact during a test."""
    if snapshot.phase is None:
        return Contact.FINDING
    if snapshot.phase is Phase.RELEASE:
        return Contact.UNWATCHED
    newest = snapshot.time_s[-1:] - RECENT_S
    position = finite(snapshot.position_m[snapshot.time_s >= newest]) if newest.size else np.zeros(0)
    if snapshot.phase is Phase.PLACE:
        found = contact_at(position, device.stroke_m) if position.size else Contact.FINDING
        return Contact.FINDING if found is Contact.MOVING else found
    safety = snapshot.safety
    if safety is None or safety.contact is None:
        return Contact.FINDING
    if not safety.contact:
        return Contact.OFF
    if position.size and float(position.max()) > safety.limits.max_position_m - MARGIN_M:
        return Contact.TOO_DEEP
    return Contact.ON


class ContactLamp(QWidget):
    """A light in the colour of what it says. ``watch`` and ``arm`` are for before a test."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.contact: Contact | None = None
        self.light = QLabel("●")
        self.light.setStyleSheet("font-size: 24pt;")
        self.words = QLabel()
        for label in (self.light, self.words):
            build.styled(label, role="headline", text_format=Qt.TextFormat.PlainText)
        build.styled(self.words, word_wrap=True, minimum_width=1)
        self.watch = build.button(
            _("Watch contact"), checkable=True, tip=_("Read the instrument before the test; its coil stays free")
        )
        self.arm = build.styled(
            QCheckBox(_("Start by the instrument's button")),
            tip=_("Press the button and let go of it: the test starts. During the test it stops."),
            hidden=True,
        )
        build.row(self.light, (self.words, 1), self.arm, self.watch, spacing=8, parent=self)
        self.setMinimumHeight(34)
        self.show_contact(Contact.UNWATCHED)

    def quiet(self, on: bool) -> None:
        """Hide the text after a test: the instruction next to the lamp is sufficient."""
        self.light.setVisible(not on)
        self.words.setVisible(not on)

    def show_contact(self, contact: Contact) -> None:
        """Show how the probe stands."""
        if contact is self.contact:
            return
        self.contact = contact
        self.words.setText(_(contact.value))
        self.words.setAccessibleName(_("Contact: {words}").format(words=_(contact.value)))
        for label in (self.light, self.words):
            build.styled(label, role="muted" if contact is Contact.UNWATCHED else "headline", level=contact.level)
            label.style().unpolish(label)
            label.style().polish(label)
        if contact.level:
            QAccessible.updateAccessibility(QAccessibleEvent(self.words, QAccessible.Event.NameChanged))


_LOOK_MS = 80
NOT_ON_SKIN = marked("The button was pressed, but the probe does not stand on the skin: nothing was started.")


class Watcher(QObject):
    """Runs one contact watch at a time. A test can be started during it: the watch then ends first."""

    start_wanted = Signal()
    """The test that was requested meanwhile shall start: the watch has ended and its port is closed."""

    def __init__(
        self,
        context: AppContext,
        lamp: ContactLamp,
        form: PlanForm,
        safety: SafetyReadouts,
        notice: Notice,
        parent: QObject,
    ) -> None:
        super().__init__(parent)
        self._context, self._lamp = context, lamp
        self._form, self._safety, self._notice = form, safety, notice
        self._sight: ContactWatch | None = None
        self._stop = threading.Event()
        self._url = ""
        self._start_next = False
        self._looks = build.timer(self, _LOOK_MS, self._look, repeat=True)
        self._lamp.watch.clicked.connect(self._toggle)
        self._lamp.arm.toggled.connect(self._arm)
        form.instrument.choice.currentTextChanged.connect(self.cancel)
        context.jobs.changed.connect(self._go_on)

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

    def update_enabled(self, *, busy: bool, testing: bool) -> None:
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
        elif not self._context.busy:
            self._begin()

    def _begin(self) -> None:
        services = self._context.services
        self._url = self._form.instrument.url
        self._stop = threading.Event()
        self._sight = sight = ContactWatch()
        self._lamp.arm.setChecked(False)
        self._lamp.show_contact(Contact.FINDING)
        self._looks.start()
        work = functools.partial(watch_contact, self._url, sight, self._stop, services.opener, services.calibrate)
        why = _("Contact is being watched on Measure: stop watching there first.")
        self._context.jobs.do(work, self._ended, self._failed, why=why)

    def _look(self) -> None:
        sight = self._sight
        if sight is None:
            return
        self._lamp.show_contact(sight.contact)
        self._safety.show_watched(_(sight.contact.value), sight.contact.level)
        if sight.device is not None:
            self._form.instrument.tell_calibration(self._url, calibration_state(sight.device))
            self._form.tell_force(self._url, sight.greatest_force_n)
            self._lamp.arm.setVisible(sight.has_button)
        if sight.refused:
            sight.refused = False
            self._notice.say(_(NOT_ON_SKIN), problem=True, page=MEASURE)

    def _arm(self, on: bool) -> None:
        if self._sight is not None and on:
            self._sight.armed.set()
        elif self._sight is not None:
            self._sight.armed.clear()

    def _ended(self, watched: WatchEnd) -> None:
        self._look()
        self._close()
        self._start_next = self._start_next or watched.pressed
        if watched.too_long:
            self._notice.say(_("Contact is no longer watched: that went on for three minutes."), page=MEASURE)

    def _failed(self, words: str) -> None:
        self._close()
        self._start_next = False
        self._form.instrument.doubt(self._url)
        self._notice.say(words, problem=True, page=MEASURE)

    def _close(self) -> None:
        self._looks.stop()
        self._sight = None
        self._lamp.arm.setChecked(False)
        self._lamp.show_contact(Contact.UNWATCHED)
        self._safety.clear()

    def _go_on(self) -> None:
        if self._start_next and not self._context.busy:
            self._start_next = False
            self.start_wanted.emit()
