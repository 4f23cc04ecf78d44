"""Records from elsewhere into sessions, and sessions out to other programs (docs/sessions.md)."""

from tissueid.sessions.imports.assembling import assembled, instrument_figures
from tissueid.sessions.imports.building import Choices, Imported, Source, import_test
from tissueid.sessions.imports.exporting import FORMATS, export_session
from tissueid.sessions.imports.mapping import parse_map

__all__ = [
    "FORMATS",
    "Choices",
    "Imported",
    "Source",
    "assembled",
    "export_session",
    "import_test",
    "instrument_figures",
    "parse_map",
]
