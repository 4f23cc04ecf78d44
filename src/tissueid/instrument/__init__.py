"""Instruments: devices on a port, in-process simulations, and replays of saved tests."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tissueid.instrument.discovery import FoundInstrument, find_instruments, open_instrument
from tissueid.instrument.driver import SerialInstrument
from tissueid.instrument.interface import (
    SAMPLE,
    SIGNALS,
    Correction,
    Gap,
    Instrument,
    Observer,
    Run,
    force,
    is_not_played,
    join_blocks,
    trim_at_release,
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
from tissueid.lazy_import import lazy_attributes

if TYPE_CHECKING:
    from tissueid.instrument.simulated import SimulatedInstrument
else:
    __getattr__ = lazy_attributes(
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
    "FoundInstrument",
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
    "is_not_played",
    "join_blocks",
    "open_instrument",
    "trim_at_release",
]
