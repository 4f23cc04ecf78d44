"""What the tests of the audit log share."""

from __future__ import annotations

from pathlib import Path

import pytest
from audit_logs import a_log


@pytest.fixture
def path(tmp_path: Path) -> Path:
    a_log(tmp_path / "audit.jsonl")
    return tmp_path / "audit.jsonl"
