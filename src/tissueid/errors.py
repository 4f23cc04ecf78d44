"""Errors that are shown to the user. Each message is one line and says what to do.

Anything that is not one of these and reaches the top of a command is a defect.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tissueid.messages import Message, code_of


class TissueIDError(Exception):
    """Base of every error with a message for the user: a text, or code, template and values of a ``Message``."""

    def __init__(self, *message: str, **values: Any) -> None:
        super().__init__(Message(*message, **values) if len(message) == 2 else message[0] if message else "")

    @property
    def message(self) -> str:
        """The text: a ``Message`` where the error has a code, else plain English."""
        text = self.args[0] if self.args else ""
        return text if isinstance(text, str) else str(text)

    @property
    def code(self) -> str:
        """Return the code of the message; "" where it is plain English."""
        return code_of(self.message)


class UnusableInputError(TissueIDError):
    """A file, an option or a record cannot be used as it is."""


class SessionFormatError(UnusableInputError):
    """A file is not a session, or breaks the session format."""


class SessionExistsError(SessionFormatError):
    """There is a file where a session should be written. Sessions are never overwritten."""

    def __init__(self, path: Path) -> None:
        super().__init__(
            Message("session.exists", "{path} is there already; sessions are never overwritten", path=str(path))
        )


class LimitError(TissueIDError):
    """A safety limit would be, or has been, exceeded. The coil is released."""


class InstrumentError(TissueIDError):
    """The instrument is missing, silent, or answers in a way that cannot be used."""


class ProtocolVersionError(InstrumentError):
    """The instrument uses a version of the wire protocol that this software does not support."""


class LinkLostError(InstrumentError):
    """The connection broke or went silent. The firmware releases the coil by its own watchdog.

    ``watchdog_s`` is the timeout of that watchdog in seconds; None where the instrument did not report it.
    """

    def __init__(self, message: str, watchdog_s: float | None = None) -> None:
        super().__init__(message)
        self.watchdog_s = watchdog_s


class FirmwareFaultError(InstrumentError):
    """The firmware latched a fault and released the coil.

    ``faults`` holds the bits of ``tissueid.wire.Fault``; 0 where the instrument did not report which faults.
    """

    def __init__(self, message: str, faults: int = 0) -> None:
        super().__init__(message)
        self.faults = faults


CANCELLED = Message("procedure.cancelled", "it was cancelled")


class CancelledError(TissueIDError):
    """The user cancelled; what was recorded is kept."""

    def __init__(self, message: str = CANCELLED) -> None:
        super().__init__(message)


class UnattendedError(CancelledError):
    """The program cancelled, not a person: the window stood still or had a defect, so that a person could not stop."""
