"""Where a test stands and what to do next: four phases, one instruction, the contact light, one bar."""

from __future__ import annotations

import math

from PySide6.QtWidgets import QFrame, QHBoxLayout, QLabel, QProgressBar, QVBoxLayout, QWidget

from tissueid.acquisition.playback import Phase
from tissueid.acquisition.surface_detection import PLACE_S
from tissueid.app.build import fill, label, styled
from tissueid.app.contact_watcher import ContactLamp
from tissueid.app.live_signals import Snapshot
from tissueid.language import _, marked
from tissueid.procedures.test_plan import TestPlan

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
        for place, (phase, part) in enumerate(self._labels.items()):
            state = "todo" if now is None or place > order.index(now) else "now" if phase is now else "done"
            if now is Phase.RELEASE:
                state = "done"
            styled(part, state=state, name=f"{_(_NAMES[phase])}: {_(_STATES[state])}")
            part.style().unpolish(part)
            part.style().polish(part)
