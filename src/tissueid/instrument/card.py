"""Analogue cards: drivers of other packages, by entry point. Limits, soft start and checks stay here.

A package adds a card by an entry point of the group ``tissueid.instruments``: its name is the scheme of the address,
its value a function that opens the card at an address (docs/write-a-driver.md).
"""

from __future__ import annotations

import contextlib
import re
import time
from collections.abc import Callable
from dataclasses import asdict
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tissueid.device import DeviceDescription
from tissueid.errors import InstrumentError, LinkLostError, TissueIDError
from tissueid.formatting import clean
from tissueid.instrument.handshake import implausible_property
from tissueid.instrument.host_played import BLOCK, RAMP_S, HostPlayedInstrument
from tissueid.instrument.interface import SIGNALS
from tissueid.instrument.limits import Limits
from tissueid.instrument.link import SCHEMES
from tissueid.instrument.replies import released_by_faults
from tissueid.messages import Message, Verbatim
from tissueid.wire import Fault, Flag

GROUP = "tissueid.instruments"
READ = SIGNALS[1:]
"""Signals that a card reads, in the order of its columns."""

SILENT_S = 0.25
"""Longest time of an exchange of 10 ms with the coil on, s: after it the samples are too old to protect anyone."""

_OWN_SCHEMES = (*SCHEMES, "simulated")
_SHOWN = 120
_ENERGISED = int(Flag.ENERGISED)


class Card(Protocol):
    """An analogue card with amplifier and sensors. An error of any method releases the coil and ends the test."""

    device: DeviceDescription
    """Properties of the instrument."""

    def exchange(self, command_v: NDArray[np.float64], enabled: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Play commands and return what was read meanwhile, in the time of the card.

        Args:
            command_v: voltages for the amplifier, shape (k,), V; one for each sample.
            enabled: whether the amplifier is enabled, shape (k,).

        Returns:
            Readings at the end of each sample, shape (k, 6), SI: voltage, current, position, temperature in degC, and
            two accelerations.
        """

    def button(self) -> bool:
        """Return whether the button is pressed."""

    def disable(self) -> None:
        """Disable the amplifier at once."""

    def close(self) -> None:
        """Disable the amplifier and close the card."""


class CardInstrument(HostPlayedInstrument):
    """An instrument on an analogue card. This process plays each sample and checks all limits, once per 10 ms.

    Args:
        card: opened card.
        name: for messages.
        clock: monotonic time, s.

    Raises:
        InstrumentError: the properties of the card are implausible.
    """

    def __init__(self, card: Card, name: str, clock: Callable[[], float] = time.monotonic) -> None:
        device = getattr(card, "device", None)
        problem: Message | None = Message("card.device", "device must be a DeviceDescription")
        if isinstance(device, DeviceDescription):
            problem = implausible_property(asdict(device))
        if not isinstance(device, DeviceDescription) or problem is not None:
            raise InstrumentError(
                "card.property", "the driver of {name} reports an impossible value: {why}", name=name, why=problem
            )
        # Without firmware the checks continue until the end of the soft release.
        super().__init__(device, winding=True, tail=round(RAMP_S * device.sample_rate_hz), temperature_c=np.zeros(0))
        self._card = card
        self._name = Verbatim(name)
        self._clock = clock
        try:
            self.poll(0.0)
        except BaseException:
            self.close()
            raise

    def arm(self, limits: Limits) -> None:
        """Set the limits of the next run.

        Raises:
            LimitError: the stimulus would exceed them.
            InstrumentError: the button is pressed, or the temperature sensor gives no usable reading.
        """
        self._require_no_button()
        super().arm(limits)

    def _coil_off(self) -> None:
        """Disable the amplifier. Never raises."""
        super()._coil_off()
        with contextlib.suppress(Exception):
            self._card.disable()

    def close(self) -> None:
        """Release, and close the card."""
        self.release()
        with contextlib.suppress(Exception):
            self._card.close()

    def move_stage(self, position_m: float | None) -> bool:
        """Return False: a card has no stage."""
        del position_m
        return False

    def _run_begins(self) -> None:
        self._require_no_button()

    def _require_no_button(self) -> None:
        try:
            pressed = bool(self._card.button())
        except Exception as error:
            raise self._failed(error) from error
        if pressed:
            self.release()
            raise released_by_faults(Fault.BUTTON)

    def _exchange(self, samples: NDArray[np.void]) -> None:
        enabled = (samples["flags"] & _ENERGISED) > 0
        if enabled.any():
            self._require_no_button()
        begin = self._clock()
        try:
            readings = np.array(self._card.exchange(samples["command"].copy(), enabled.copy()), np.float64)
        except Exception as error:
            raise self._failed(error) from error
        if readings.shape != (BLOCK, len(READ)) or not np.isfinite(readings).all():
            self.release()
            raise InstrumentError(
                "card.readings",
                "the driver of {name} must return finite readings of shape {wanted}, got {got}",
                name=self._name,
                wanted=str((BLOCK, len(READ))),
                got=str(readings.shape) if readings.shape != (BLOCK, len(READ)) else "NaN",
            )
        if enabled.any() and (seconds := self._clock() - begin) > SILENT_S:
            self.release()
            raise LinkLostError(
                Message(
                    "card.silent",
                    "the driver of {name} took {seconds:.2f} s for 10 ms: the coil was not watched, and is released",
                    name=self._name,
                    seconds=seconds,
                )
            )
        for name, column in zip(READ, readings.T, strict=True):
            samples[name] = column

    def _failed(self, error: Exception) -> TissueIDError:
        """Release the coil and return the error of a driver that failed."""
        self.release()
        if isinstance(error, TissueIDError):
            return error
        return LinkLostError(
            Message(
                "card.failed",
                "the driver of {name} failed: {kind}: {why}",
                name=self._name,
                kind=Verbatim(type(error).__name__),
                why=Verbatim(clean(str(error))[:_SHOWN]),
            )
        )


def card_schemes() -> dict[str, EntryPoint]:
    """Return the entry points of installed cards by the scheme of their addresses."""
    installed = {item.name: item for item in entry_points(group=GROUP)}
    return {
        name: item
        for name, item in installed.items()
        if re.fullmatch(r"[a-z][a-z0-9-]*", name) and name not in _OWN_SCHEMES
    }


def open_card(url: str) -> CardInstrument | None:
    """Open the card at an address ``SCHEME://...``; return None if no installed driver has that scheme.

    Raises:
        InstrumentError: the driver fails, or its properties are implausible.
    """
    scheme, separator, _ = url.partition("://")
    driver = card_schemes().get(scheme.lower()) if separator else None
    if driver is None:
        return None
    name = clean(url)[:_SHOWN]
    try:
        opener: Any = driver.load()
        card = opener(url)
    except TissueIDError:
        raise
    except (Exception, SystemExit) as error:
        raise InstrumentError(
            "card.not_opened",
            "cannot open {url}: the driver {driver} failed: {kind}: {why}",
            url=Verbatim(name),
            driver=Verbatim(driver.value),
            kind=Verbatim(type(error).__name__),
            why=Verbatim(clean(str(error))[:_SHOWN]),
        ) from error
    return CardInstrument(card, name)
