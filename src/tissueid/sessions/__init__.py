"""Sessions: one sitting with any number of tests, in one HDF5 file that is written once (docs/sessions.md)."""

from tissueid.sessions.hdf5_session import read_session as read_own_session
from tissueid.sessions.hdf5_session import write_session
from tissueid.sessions.model import KINDS, SIGNAL_UNITS, Outline, Session, Subject, Test, TestOutline
from tissueid.sessions.reader_process import read_outline, read_session, read_session_head, read_test
from tissueid.untrusted_input import MAX_NUMBERS, MAX_TESTS

__all__ = [
    "KINDS",
    "MAX_NUMBERS",
    "MAX_TESTS",
    "SIGNAL_UNITS",
    "Outline",
    "Session",
    "Subject",
    "Test",
    "TestOutline",
    "read_outline",
    "read_own_session",
    "read_session",
    "read_session_head",
    "read_test",
    "write_session",
]
