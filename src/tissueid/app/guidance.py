"""Where a test stands and what to do next: phases, instruction, contact of the probe with the skin, progress."""

from __future__ import annotations

import functools
import math
import threading

import numpy as np
from PySide6.QtCore import QObject, Qt, Signal
from PySide6.QtGui import QAccessible, QAccessibleEvent
from PySide6.QtWidgets import QCheckBox, QFrame, QHBoxLayout, QLabel, QProgressBar, QVBoxLayout, QWidget

from tissueid.acquisition.playback import Phase
from tissueid.acquisition.surface_detection import MARGIN_M, PLACE_S, RECENT_S, Contact, contact_at, finite
from tissueid.app.build import button, fill, label, restyle, row, styled, timer
from tissueid.app.context import AppContext
from tissueid.app.form import PlanForm
from tissueid.app.live_signals import Snapshot
from tissueid.app.navigation_bar import MEASURE
from tissueid.app.notice import Notice
from tissueid.app.readouts import SafetyReadouts
from tissueid.app.words import calibration_state
from tissueid.device import DeviceDescription
from tissueid.language import _, marked
from tissueid.procedures.instruments import ContactWatch, WatchEnd, watch_contact
from tissueid.procedures.test_plan import TestPlan


def contact_in_test(snapshot: Snapshot, device: DeviceDescription) -> Contact:
    """Return the contact during a test."""
    if snapshot.phase is None:
        return Contact.FINDING
    if snapshot.phase is Phase.RELEASE:
        return Contact.UNWATCHED
    newest = snapshot.time_s[-1:] - RECENT_S
    position = finite(snapshot.position_m[snapshot.time_s >= newest]) if newest.size else np.zeros(0)
    if snapshot.phase is Phase.PLACE:
        contact = contact_at(position, device.stroke_m) if position.size else Contact.FINDING
        return Contact.FINDING if contact is Contact.MOVING else contact
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
        self.caption = QLabel()
        for part in (self.light, self.caption):
            styled(part, role="headline", text_format=Qt.TextFormat.PlainText)
        styled(self.caption, word_wrap=True, minimum_width=1)
        self.watch = button(
            _("Watch contact"), checkable=True, tip=_("Read the instrument before the test; its coil stays free")
        )
        self.arm = styled(
            QCheckBox(_("Start by the instrument's button")),
            tip=_("Press the button and let go of it: the test starts. During the test it stops."),
            hidden=True,
        )
        row(self.light, (self.caption, 1), self.arm, self.watch, spacing=8, parent=self)
        self.setMinimumHeight(34)
        self.show_contact(Contact.UNWATCHED)

    def quiet(self, on: bool) -> None:
        """Hide the text after a test: the instruction next to the lamp is sufficient."""
        self.light.setVisible(not on)
        self.caption.setVisible(not on)

    def show_contact(self, contact: Contact) -> None:
        """Show how the probe stands."""
        if contact is self.contact:
            return
        self.contact = contact
        self.caption.setText(_(contact.value))
        self.caption.setAccessibleName(_("Contact: {words}").format(words=_(contact.value)))
        for part in (self.light, self.caption):
            restyle(part, role="muted" if contact is Contact.UNWATCHED else "headline", level=contact.level)
        if contact.level:
            QAccessible.updateAccessibility(QAccessibleEvent(self.caption, QAccessible.Event.NameChanged))


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
        self._looks = timer(self, _LOOK_MS, self._look, repeat=True)
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

    def _failed(self, message: str) -> None:
        self._close()
        self._start_next = False
        self._form.instrument.doubt(self._url)
        self._notice.say(message, problem=True, page=MEASURE)

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


IDLE = marked("Place the probe on the skin and hold the reference surface firmly. Then start the test.")
CALIBRATION_IDLE = marked(
    "Calibration: take people and tissue away from the probe, the coil will move. Put the calibration spring under it."
)
_NAMES = {
    Phase.PLACE: marked("1  Place"),
    Phase.PRELOAD: marked("2  Preload"),
    Phase.STIMULUS: marked("3  Stimulus"),
    Phase.RELEASE: marked("4  Release"),
}
_WORDS = {
    Phase.PLACE: marked("Hold the reference surface firmly: the probe is finding the skin."),
    Phase.PRELOAD: marked("Hold still: the probe leans in to its mean force."),
    Phase.RELEASE: marked("Done. The coil is free: lift the probe off the skin."),
}
_STATES = {"todo": marked("todo"), "now": marked("now"), "done": marked("done")}
_STEPS = 1000


class Guidance(QFrame):
    """Phases, instruction and progress."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        styled(self, role="card")
        self.phase: Phase | None = None
        self._idle = ""
        self._resting = self._calibrating = False
        self._labels = {phase: styled(QLabel(_(name)), role="phase") for phase, name in _NAMES.items()}
        self._phases = QWidget()
        fill(QHBoxLayout(self._phases), *((part, 1) for part in self._labels.values()), spacing=8)
        self.instruction = label("instruction")
        self.bar = styled(QProgressBar(), name=_("Progress of the test"), range=(0, _STEPS), text_visible=False)
        self.lamp = ContactLamp()
        fill(QVBoxLayout(self), self._phases, self.instruction, self.lamp, self.bar, margins=(14, 8, 14, 10))
        self.show_idle()

    def show_idle(self, shown: str = "") -> None:
        """Show that nothing runs: what ``shown`` says of the test that is shown, or how to begin."""
        self._mark(None)
        self.bar.setValue(0)
        self._idle = shown
        self.say(_(CALIBRATION_IDLE) if self._calibrating else shown or _(IDLE))
        self._resting = True

    def turn_to_calibration(self, calibrating: bool) -> None:
        """Guide a calibration, which has other warnings and no phases, or else a test."""
        self._calibrating = calibrating
        for part in (self._phases, self.lamp, self.bar):
            part.setVisible(not calibrating)
        if self._resting:
            self.show_idle(self._idle)

    def say(self, text: str) -> None:
        """Change the instruction."""
        self._resting = False
        if text != self.instruction.text():
            self.instruction.setText(text)
            self.instruction.setAccessibleName(text)

    def follow(self, snapshot: Snapshot, plan: TestPlan) -> None:
        """Show where a running test stands."""
        phase = snapshot.phase
        if phase is None:
            return
        self._mark(phase)
        total_s = plan.total_s if snapshot.total_s is None else snapshot.total_s
        run_s = snapshot.fraction * total_s
        done_s = snapshot.fraction * PLACE_S if phase is Phase.PLACE else PLACE_S + run_s
        self.bar.setValue(round(_STEPS * done_s / (PLACE_S + total_s)))
        if phase is Phase.STIMULUS:
            self.say(_("Measuring. Hold still for {left} s.").format(left=max(1, math.ceil(total_s - run_s))))
        else:
            self.say(_(_WORDS[phase]))

    def _mark(self, now: Phase | None) -> None:
        """Set the phases before ``now`` done, and the ones after it to come."""
        if now is self.phase and now is not None:
            return
        self.phase = now
        order = list(self._labels)
        for index, (phase, part) in enumerate(self._labels.items()):
            state = "todo" if now is None or index > order.index(now) else "now" if phase is now else "done"
            if now is Phase.RELEASE:
                state = "done"
            restyle(part, state=state, name=f"{_(_NAMES[phase])}: {_(_STATES[state])}")
