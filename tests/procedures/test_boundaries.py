"""The command line and the window contain no procedure: what the contract on imports of modules cannot see.

Packages re-export functions that open instruments, run tests and write files next to harmless names, and audit entries
are written by methods.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import tissueid

PACKAGE = Path(tissueid.__file__).parent
FORBIDDEN = {
    "AuditLog",
    "SerialInstrument",
    "SessionRecorder",
    "calibrate_static",
    "check_coil",
    "export_session",
    "find_instruments",
    "import_session",
    "keep_calibration",
    "open_instrument",
    "play",
    "recover",
    "run_guided_test",
    "run_multistep",
    "withdraw_result",
    "write_calibration",
    "write_result",
    "write_session",
    "write_twin",
}
"""Names that are imported to open an instrument, to run a test, or to write a session, calibration, twin or result."""
AUDIT_METHODS = {"record", "note", "submit"}


def found_in(path: Path) -> Iterator[str]:
    where = path.relative_to(PACKAGE).as_posix()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("tissueid."):
            if not node.module.startswith("tissueid.procedures"):
                yield from (f"{where}: {item.name}" for item in node.names if item.name in FORBIDDEN)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in AUDIT_METHODS:
            first = node.args[0] if node.args else None
            if isinstance(first, ast.Constant) and isinstance(first.value, str) and "." in first.value:
                yield f"{where}: audit entry {first.value}"
        if isinstance(node, ast.Call) and ast.unparse(node.func).rpartition(".")[2] == "opener":
            yield f"{where}: opens an instrument"


def test_only_procedures_open_instruments_write_sessions_and_log():
    found = {item for part in ("app", "cli") for path in (PACKAGE / part).rglob("*.py") for item in found_in(path)}
    assert found == set()


def test_the_procedures_do_what_is_forbidden_there():
    """The names above are those that are used."""
    found = {item.partition(": ")[2] for path in (PACKAGE / "procedures").rglob("*.py") for item in found_in(path)}
    assert {"open_instrument", "SessionRecorder", "run_guided_test", "write_twin", "write_result"} <= found
    assert any(item.startswith("audit entry") for item in found)
