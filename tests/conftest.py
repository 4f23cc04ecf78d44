"""What holds for every test: no real audit log or analysis is written, no role taken over, no calibration used."""

from __future__ import annotations

import gc
import itertools
from collections.abc import Generator, Iterator
from pathlib import Path
from types import SimpleNamespace

import hypothesis
import pytest
import support

from tissueid.app.user_files import ENVIRONMENT as ANALYSES
from tissueid.audit import ENVIRONMENT, ROLE_ENVIRONMENT
from tissueid.calibration.status import VARIABLE as CALIBRATIONS
from tools.translations import compile_stale


def pytest_configure() -> None:
    """Compile the translations that were edited since."""
    compile_stale()
    # No test depends on the time that it takes, and every run tries the same examples.
    hypothesis.settings.register_profile("any_speed", deadline=None, derandomize=True)
    hypothesis.settings.load_profile("any_speed")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """What is imported and collected stays to the end: no search for garbage, now or later, need look at all of it."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.collect()
        gc.freeze()
        gc.set_threshold(20_000, 20, 20)  # numpy makes little garbage: seldom is soon enough


@pytest.fixture(scope="module")
def long_frames() -> Iterator[None]:
    """Devices on a loopback link send frames of 50 ms instead of 10 ms, which takes half the processor time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("support.TICK_S", support.LONG_TICK_S)
        yield


@pytest.fixture(scope="session", autouse=True)
def _audit_elsewhere(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Fixtures that several tests share run before those of one test."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(ENVIRONMENT, str(tmp_path_factory.mktemp("audit") / "shared.jsonl"))
        patch.setenv(CALIBRATIONS, str(tmp_path_factory.mktemp("calibrations")))
        patch.setenv(ANALYSES, str(tmp_path_factory.mktemp("analyses") / "shared.jsonl"))
        yield


@pytest.fixture(scope="session", autouse=True)
def _frozen_to_the_end() -> Iterator[None]:
    """A played stimulus does not release what was frozen after the collection of the tests."""
    with pytest.MonkeyPatch.context() as patch:
        nothing = SimpleNamespace(freeze=lambda: None, unfreeze=lambda: None)
        patch.setattr("tissueid.acquisition.playback.gc", nothing)
        yield


@pytest.fixture(scope="session", autouse=True)
def _figures_as_texts() -> Iterator[None]:
    """Pages get the texts of their figures: drawing takes most of the time of a page. ``reports`` draws them."""
    from reports.in_german import texts_as_svg

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tissueid.reports.page.to_svg", texts_as_svg)
        yield


@pytest.fixture(scope="session")
def _audit_folders(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder for each test, without a look at those of all tests before: with thousands of them that takes long."""
    everyones = tmp_path_factory.mktemp("audits")
    return (everyones / str(number) for number in itertools.count())


@pytest.fixture(autouse=True)
def audit_file(_audit_folders: Iterator[Path], monkeypatch: pytest.MonkeyPatch) -> Path:
    """The audit log of this test, and of every process that it starts."""
    folder = next(_audit_folders)
    folder.mkdir()
    path = folder / "audit.jsonl"
    monkeypatch.setenv(ENVIRONMENT, str(path))
    monkeypatch.setenv(ANALYSES, str(folder / "analyses.jsonl"))
    monkeypatch.delenv(ROLE_ENVIRONMENT, raising=False)
    return path
