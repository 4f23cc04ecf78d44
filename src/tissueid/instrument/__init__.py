"""Talking to an instrument: a real one on a port, a simulated one in this process, a saved session replayed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tissueid.instrument.correction import Correction
from tissueid.instrument.discovery import Found, find_instruments, open_instrument
from tissueid.instrument.driver import SerialInstrument
from tissueid.instrument.interface import (
    SAMPLE,
    SIGNALS,
    Gap,
    Instrument,
    Observer,
    Run,
    force,
    not_played,
    until_released,
)
from tissueid.instrument.limits import (
    CLINICAL,
    PROFILES,
    RESEARCH,
    Limits,
    check_command,
    check_limits,
    check_samples,
    check_stimulus,
)
from tissueid.instrument.link import Link, SerialLink
from tissueid.instrument.replay import ReplayInstrument
from tissueid.lazily import on_first_use

if TYPE_CHECKING:
    from tissueid.instrument.simulated import SimulatedInstrument
else:
    __getattr__ = on_first_use(
        __name__,
        {
            "simulated": ("SimulatedInstrument",),
        },
    )

__all__ = [
    "CLINICAL",
    "PROFILES",
    "RESEARCH",
    "SAMPLE",
    "SIGNALS",
    "Correction",
    "Found",
    "Gap",
    "Instrument",
    "Limits",
    "Link",
    "Observer",
    "ReplayInstrument",
    "Run",
    "SerialInstrument",
    "SerialLink",
    "SimulatedInstrument",
    "check_command",
    "check_limits",
    "check_samples",
    "check_stimulus",
    "find_instruments",
    "force",
    "not_played",
    "open_instrument",
    "until_released",
]
