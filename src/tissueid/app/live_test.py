"""The control of a running test: passes samples and notices on to the window, and its stop to the test."""

from __future__ import annotations

from tissueid.acquisition.live import LiveIdentification
from tissueid.acquisition.playback import Progress
from tissueid.app.emergency import EmergencyStop
from tissueid.app.live_signals import LiveSignals, SafetyWatch
from tissueid.instrument import Instrument, Limits, SimulatedInstrument
from tissueid.procedures.instruments import greatest_force_n
from tissueid.procedures.test_run import TestControl


class LiveTest(TestControl):
    """Fills ``live`` until ``stop`` is triggered. ``notices`` and ``error`` are read by the GUI thread."""

    def __init__(self, live: LiveSignals, stop: EmergencyStop) -> None:
        self.notices: list[str] = []
        self.error: BaseException | None = None
        self._live, self._stop = live, stop

    def notice(self, message: str) -> None:
        """Keep a notice."""
        self.notices.append(message)

    def cancelled(self) -> bool:
        """Return whether the stop was triggered."""
        return self._stop.is_set()

    def check(self) -> bool:
        """Return False, or raise if the stop was triggered."""
        return self._stop.check()

    def ready(self, instrument: Instrument, limits: Limits) -> None:
        """Watch the safety of this instrument."""
        self._live.greatest_force_n = greatest_force_n(instrument)
        winding = not isinstance(instrument, SimulatedInstrument)
        self._live.begin(SafetyWatch(instrument.device, limits, winding=winding))

    def planned(self, total_s: float) -> None:
        """Set the duration of the test."""
        self._live.total_s = total_s

    def identifying(self, identification: LiveIdentification) -> None:
        """Show the estimates of the test."""
        self._live.identification = identification

    def placed(self, surface_m: float) -> None:
        """Set the position of the surface."""
        self._live.placed(surface_m)

    def aborted(self, error: BaseException) -> None:
        """Keep why the test ended early."""
        self.error = error

    def received(self, progress: Progress) -> None:
        """Show new samples."""
        if self._live.device is not None:
            self._live.add(progress, self._live.device)
