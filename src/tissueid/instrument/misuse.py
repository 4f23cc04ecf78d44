"""Errors for calls in the wrong state, the same for every kind of instrument."""

from __future__ import annotations

from tissueid.errors import InstrumentError
from tissueid.messages import Message


def calibration_while_running() -> InstrumentError:
    """Return the error for a calibration applied while a test is armed or running."""
    return InstrumentError(
        Message("instrument.calibration_in_test", "a calibration can be applied between two tests only")
    )


def nothing_loaded() -> InstrumentError:
    """Return the error for set-points announced before a stimulus is loaded."""
    return InstrumentError(
        Message("instrument.nothing_loaded", "load the stimulus that comes before the set-points first")
    )


def not_armed() -> InstrumentError:
    """Return the error for a start without a loaded and armed stimulus."""
    return InstrumentError(Message("instrument.not_armed", "load and arm the stimulus before starting"))


def unexpected_set_points(first: int, end: int) -> InstrumentError:
    """Return the error for set-points that were not announced."""
    return InstrumentError(
        Message(
            "instrument.unexpected_set_points",
            "set-points {first} to {end} were not announced: call follow and arm first",
            first=first,
            end=end,
        )
    )


def stage_while_running() -> InstrumentError:
    """Return the error for a stage movement while a test is armed or running."""
    return InstrumentError(
        Message("instrument.stage_in_test", "the stage moves only while the coil is free: end the test first")
    )
