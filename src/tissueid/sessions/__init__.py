"""Sessions: one sitting, any number of tests, in one HDF5 file that is written once (docs/sessions.md)."""

from tissueid.sessions.file import MAX_NUMBERS, read_session, read_session_head, write_session
from tissueid.sessions.model import KINDS, SIGNAL_UNITS, Session, Subject, Test

__all__ = [
    "KINDS",
    "MAX_NUMBERS",
    "SIGNAL_UNITS",
    "Session",
    "Subject",
    "Test",
    "read_session",
    "read_session_head",
    "write_session",
]
