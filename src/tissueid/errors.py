"""The errors that a user can meet. Each message is one line and says what to do.

Anything that is not one of these and reaches the top of a command is a defect.
"""

from __future__ import annotations

from pathlib import Path


class TissueIDError(Exception):
    """Base of every error whose message is meant for the user."""


class UnusableInputError(TissueIDError):
    """A file, an option or a record cannot be used as it is."""


class SessionFormatError(UnusableInputError):
    """A file is not a session, or breaks the session format."""


class SessionExistsError(SessionFormatError):
    """There is a file where a session should be written. Sessions are never overwritten."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path} is there already; sessions are never overwritten")


class LimitError(TissueIDError):
    """A safety limit would be, or has been, exceeded. The coil is released."""


class InstrumentError(TissueIDError):
    """The instrument is missing, silent, or answers in a way that cannot be used."""


class ProtocolVersionError(InstrumentError):
    """The instrument speaks a version of the wire protocol that this software does not."""


class LinkLostError(InstrumentError):
    """The connection broke or went silent. Firmware releases the coil by its own watchdog.

    ``watchdog_s`` is within how many seconds, where the instrument said so before it was lost.
    """

    def __init__(self, words: str, watchdog_s: float | None = None) -> None:
        super().__init__(words)
        self.watchdog_s = watchdog_s


class FirmwareFaultError(InstrumentError):
    """The firmware latched a fault and released the coil."""


class CancelledError(TissueIDError):
    """The user cancelled; what was recorded is kept."""
