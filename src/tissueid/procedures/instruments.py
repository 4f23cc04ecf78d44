"""Access to instruments and to the audit log, and what is asked of instruments without a test; the coil stays free."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition.surface_detection import RECENT_S, Contact, contact_of_free
from tissueid.audit import AuditLog, AuditTrail, Role, active_role, default_path
from tissueid.calibration.active import activate_calibration
from tissueid.device import DeviceDescription
from tissueid.instrument import (
    PROFILES,
    RESEARCH,
    SAMPLE,
    FoundInstrument,
    Instrument,
    Limits,
    SerialInstrument,
    find_instruments,
    open_instrument,
)
from tissueid.instrument.replies import describe_faults
from tissueid.plan_options import Option, Plan
from tissueid.wire import Flag


def user_log() -> AuditLog:
    """Return the audit log of this computer."""
    return AuditLog(default_path())


def audit_trail(role: Role = "researcher") -> AuditTrail:
    """Return a trail in the audit log of this computer; ``TISSUEID_ROLE`` overrides ``role``.

    Raises:
        UnusableInputError: ``TISSUEID_ROLE`` is not a role.
    """
    return AuditTrail(user_log(), active_role(role))


def opening_after(ready: Callable[[], None], opener: Callable[[str], Instrument]) -> Callable[[str], Instrument]:
    """Return an opener of instruments that calls ``ready`` first, which waits or raises."""

    def opened(url: str) -> Instrument:
        ready()
        return opener(url)

    return opened


@dataclass(frozen=True)
class InstrumentAccess:
    """How instruments are opened, found and calibrated, and the audit log of what is done; tests replace them.

    ``opener`` opens the instrument at an address, ``finder`` lists instruments, ``calibrate`` activates the newest
    calibration of an instrument.
    """

    opener: Callable[[str], Instrument] = open_instrument
    finder: Callable[..., list[FoundInstrument]] = find_instruments
    calibrate: Callable[[Instrument], object] = activate_calibration
    audit: AuditLog = field(default_factory=user_log)


LISTEN_S = 1.0
"""Duration over which samples are read, s."""
_POLL_S = 0.1
_MOST_POLLS = 400

Opener = Callable[[str], Instrument]
Calibrate = Callable[[Instrument], object]


class DevicesPlan(Plan):
    """A search for instruments."""

    probe: Annotated[bool, Option(help="connect to each instrument")] = True


def listed_instruments(plan: DevicesPlan) -> list[FoundInstrument]:
    """Return connected and simulated instruments; a probed one is closed again."""
    return find_instruments(probe=plan.probe)


def described_device(url: str | None) -> DeviceDescription:
    """Return the device of a URL; None is the desktop device of the thesis.

    Raises:
        InstrumentError: there is no such instrument, or it does not answer.
    """
    if url is None:
        return DeviceDescription()
    instrument = open_instrument(url)
    try:
        return instrument.device
    finally:
        instrument.close()


def greatest_force_n(instrument: Instrument) -> float:
    """Return the maximum force of an instrument, N in whole tenths, by its amplifier and its own limits."""
    own = math.floor(10.0 * instrument.effective_limits(RESEARCH).max_force_n) / 10.0
    return min(instrument.device.greatest_force_n, own)


@dataclass(frozen=True)
class InstrumentSurvey:
    """Found instruments, and device and maximum force, N, of those that answered, by address."""

    instruments: Sequence[FoundInstrument]
    devices: Mapping[str, DeviceDescription]
    forces_n: Mapping[str, float]


def survey_instruments(
    finder: Callable[..., list[FoundInstrument]], opener: Opener, calibrate: Calibrate
) -> InstrumentSurvey:
    """Ask every port, and activate the calibration of each instrument that answers.

    Raises:
        TissueIDError, OSError: the ports cannot be listed.
    """
    devices: dict[str, DeviceDescription] = {}
    forces_n: dict[str, float] = {}

    def open_and_ask(url: str) -> Instrument:
        instrument = opener(url)
        try:
            calibrate(instrument)
            forces_n[url] = greatest_force_n(instrument)
        except BaseException:
            instrument.close()
            raise
        devices[url] = instrument.device
        return instrument

    return InstrumentSurvey(finder(probe=True, opener=open_and_ask), devices, forces_n)


@dataclass(frozen=True)
class LinkStatistics:
    """Statistics of the link while the instrument was open; ``round_trip_s`` None if not measured."""

    frames: int
    damaged: int
    repeated: int
    round_trip_s: float | None


@dataclass(frozen=True)
class Checkup:
    """What an instrument answered: its ``nominal`` figures, and as ``device`` those by the active calibration.

    ``link`` is None where there is no cable. Values without a sensor are NaN.
    """

    url: str
    nominal: DeviceDescription
    device: DeviceDescription
    limits: dict[str, Limits]
    samples: int
    lost: int
    temperature_c: float
    resting_a: float
    faults: str
    link: LinkStatistics | None


def run_checkup(url: str, opener: Opener, calibrate: Calibrate, check: Callable[[], object]) -> Checkup:
    """Open an instrument, activate its calibration, read samples, and close it. The coil stays free throughout.

    ``check`` is called between the polls, and raises CancelledError to end it.

    Raises:
        TissueIDError, OSError: it does not answer, or not as it should.
    """
    instrument = opener(url)
    try:
        check()
        calibrate(instrument)
        device = instrument.device
        wanted = round(LISTEN_S * device.sample_rate_hz)
        samples = lost = 0
        temperatures: list[float] = []
        currents: list[float] = []
        for _ in range(_MOST_POLLS):
            check()
            block = instrument.poll(_POLL_S)
            samples += block.size
            received = np.isfinite(block["position"])
            lost += int(np.count_nonzero(~received))
            for kept, name in ((temperatures, "temperature"), (currents, "current")):
                values = block[name][np.isfinite(block[name])]
                if values.size:
                    kept.append(float(values.mean()))
            if samples >= wanted:
                break
        return Checkup(
            url,
            instrument.nominal,
            device,
            {name: instrument.effective_limits(limits) for name, limits in PROFILES.items()},
            samples,
            lost,
            float(np.mean(temperatures)) if temperatures else np.nan,
            float(np.mean(currents)) if currents else np.nan,
            _faults(instrument),
            _link(instrument),
        )
    finally:
        instrument.close()


def _faults(instrument: Instrument) -> str:
    """Return the faults that remain after they were cleared at opening; empty if there are none."""
    status = instrument.status if isinstance(instrument, SerialInstrument) else None
    return describe_faults(status.faults) if status is not None and status.faults else ""


def _link(instrument: Instrument) -> LinkStatistics | None:
    if not isinstance(instrument, SerialInstrument):
        return None
    frames = instrument.statistics
    return LinkStatistics(frames.accepted, frames.refused, instrument.repeated_requests, instrument.round_trip_s)


LONGEST_S = 180.0
"""Maximum duration of a watch, s; it then closes the port."""
_WATCH_POLL_S = 0.05


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
    def contact(self, contact: Contact) -> None:
        with self._lock:
            self._contact = contact


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
            samples = instrument.poll(_WATCH_POLL_S)
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
