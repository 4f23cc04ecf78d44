"""What holds for every test: no real audit log is written, nobody's role taken over, no calibration used by chance."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from pathlib import Path

import pytest

from tissueid.audit import ENVIRONMENT, ROLE_ENVIRONMENT
from tissueid.calibration.store import VARIABLE as CALIBRATIONS


def pytest_collection_finish() -> None:
    """What was imported and collected stays to the end: no later search for garbage need look at all of it."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def _audit_elsewhere(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Fixtures that several tests share run before those of one test."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(ENVIRONMENT, str(tmp_path_factory.mktemp("audit") / "shared.jsonl"))
        patch.setenv(CALIBRATIONS, str(tmp_path_factory.mktemp("calibrations")))
        yield


@pytest.fixture(autouse=True)
def audit_file(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The audit log of this test, and of every process that it starts."""
    path = tmp_path_factory.mktemp("audit") / "audit.jsonl"
    monkeypatch.setenv(ENVIRONMENT, str(path))
    monkeypatch.delenv(ROLE_ENVIRONMENT, raising=False)
    return path
