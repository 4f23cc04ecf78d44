"""Import of records of other programs as sessions, and export of sessions to other programs (docs/sessions.md)."""

from tissueid.sessions.imports.column_mapping import ROLES, guessed_role, parse_map
from tissueid.sessions.imports.export import FORMATS, export_session
from tissueid.sessions.imports.imported_session import (
    ImportedSession,
    assembled,
    check_new_session,
    import_session,
    instrument_figures,
)
from tissueid.sessions.imports.imported_test import Choices, Imported, Source, import_test, is_record, open_foreign
from tissueid.sessions.imports.stated_units import OFFERED

__all__ = [
    "FORMATS",
    "OFFERED",
    "ROLES",
    "Choices",
    "Imported",
    "ImportedSession",
    "Source",
    "assembled",
    "check_new_session",
    "export_session",
    "guessed_role",
    "import_session",
    "import_test",
    "instrument_figures",
    "is_record",
    "open_foreign",
    "parse_map",
]
