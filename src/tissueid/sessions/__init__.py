"""Sessions: one sitting, any number of tests, in one HDF5 file that is written once (docs/sessions.md)."""

from tissueid.sessions.file import read_session, write_session
from tissueid.sessions.model import KINDS, SIGNAL_UNITS, Session, Subject, Test

__all__ = ["KINDS", "SIGNAL_UNITS", "Session", "Subject", "Test", "read_session", "write_session"]
