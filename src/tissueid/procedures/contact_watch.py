"""Contact watch before a test, with released coil: contact of the probe and button of the instrument."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition.surface_detection import RECENT_S, Contact, contact_of_free
from tissueid.device import DeviceDescription
from tissueid.instrument import SAMPLE, Instrument
from tissueid.procedures.instrument_queries import greatest_force_n
from tissueid.wire import Flag

LONGEST_S = 180.0
"""Maximum duration of a watch, s; it then closes the port."""
_POLL_S = 0.05


class ContactWatch:
    """State of a contact watch, shared by the thread that polls and the window.

    ``armed`` is set by the window: only then does the button on the instrument count, once it was seen released.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._contact = Contact.FINDING
        self.device: DeviceDescription | None = None
        self.greatest_force_n = math.inf
        self.has_button = False
        self.refused = False
        self.armed = threading.Event()

    @property
    def contact(self) -> Contact:
        """Current contact of the probe."""
        with self._lock:
            return self._contact

    @contact.setter
    def contact(self, found: Contact) -> None:
        with self._lock:
            self._contact = found


@dataclass(frozen=True)
class WatchEnd:
    """How a watch ended: ``pressed`` where the button was pressed and released while it was armed."""

    pressed: bool = False
    too_long: bool = False


def watch_contact(
    url: str,
    state: ContactWatch,
    stop: threading.Event,
    opener: Callable[[str], Instrument],
    calibrate: Callable[[Instrument], object],
) -> WatchEnd:
    """Read the instrument until ``stop``; the coil stays free throughout.

    Raises:
        TissueIDError, OSError: the instrument cannot be opened, or is lost.
    """
    from tissueid.instrument.simulated import SimulatedInstrument

    instrument = opener(url)
    try:
        calibrate(instrument)
        device = instrument.device
        simulated = isinstance(instrument, SimulatedInstrument)
        state.has_button = not simulated
        state.greatest_force_n = greatest_force_n(instrument)
        state.device = device
        recent: NDArray[np.void] = np.zeros(0, SAMPLE)
        button = _Button()
        seen = 0
        while not stop.is_set():
            samples = instrument.poll(_POLL_S)
            if simulated:
                stop.wait(samples.size / device.sample_rate_hz)
            seen += samples.size
            recent = np.concatenate([recent, samples])[-round(RECENT_S * device.sample_rate_hz) :]
            state.contact = contact_of_free(recent, device)
            received = samples["flags"][np.isfinite(samples["position"])]
            if button.pressed_in(received, armed=state.armed.is_set()):
                # A press with the probe off the skin is more likely an accident.
                if state.contact in (Contact.ON, Contact.UNTOLD):
                    return WatchEnd(pressed=True)
                state.refused = True
            if seen > LONGEST_S * device.sample_rate_hz:
                return WatchEnd(too_long=True)
        return WatchEnd()
    finally:
        instrument.close()


class _Button:
    """Distinguishes a press and its release from a button that was down before it was armed."""

    def __init__(self) -> None:
        self._was_up = False
        self._down = False

    def pressed_in(self, flags: NDArray[np.uint16], *, armed: bool) -> bool:
        """Return whether it was pressed and released; flags of the newest samples, shape (k,)."""
        if not armed:
            self._was_up = self._down = False
            return False
        for down in (flags & Flag.BUTTON) != 0:
            if down:
                self._down = self._was_up
                continue
            if self._down:
                self._was_up = self._down = False
                return True
            self._was_up = True
        return False
