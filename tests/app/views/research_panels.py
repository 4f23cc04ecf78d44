"""The panel of analyses on a context of its own, and an engine that takes its time, for the tests of both."""

import dataclasses
import shutil
import threading
from pathlib import Path

import pytest
from app.benches import WAIT_MS
from PySide6.QtCore import QSettings, Qt
from PySide6.QtWidgets import (
    QFileDialog,
    QWidget,
)

from tissueid.analysis import analyse
from tissueid.app.context import AppContext, AppServices, AppState
from tissueid.app.jobs import Jobs
from tissueid.app.views.researcher import batch
from tissueid.app.views.researcher.analysis import AnalysisPanel
from tissueid.app.views.researcher.engine_outcome import AnalysisHistory
from tissueid.app.views.researcher.selected_test import SelectedTest
from tissueid.sessions import read_session, write_session

_ANALYSED = {}


def analyse_once(session, engine, options, **selection):
    """As ``analyse``: what several tests fit alike is fitted once. Refusals are worked out every time."""
    signals = [[values.tobytes() for values in test.signals.values()] for test in session.tests]
    about = [dataclasses.replace(test, signals={}) for test in session.tests]
    key = repr((engine, options, selection, session.instrument, about)), *map(tuple, signals)
    if key not in _ANALYSED:
        _ANALYSED[key] = analyse(session, engine, options, **selection)
    return _ANALYSED[key]


@pytest.fixture(autouse=True)
def _analysed_once(monkeypatch):
    monkeypatch.setattr(batch, "analyse", analyse_once)


class Strip:
    """What the panel says, and whether as a problem."""

    def __init__(self):
        self.said = []

    def __call__(self, text, *, problem=False):
        self.said.append((text, problem))


@pytest.fixture
def strip():
    return Strip()


@pytest.fixture
def history(tmp_path):
    return AnalysisHistory(tmp_path / "data" / "analyses.jsonl")


@pytest.fixture
def open_panel(qtbot, tmp_path, strip, history):
    """Opens panels on a context of their own; each is settled as the window would, and its work is waited for."""
    opened = []

    def make():
        home = QWidget()
        qtbot.addWidget(home)
        jobs = Jobs(home)
        settings = QSettings(str(tmp_path / "panel.ini"), QSettings.Format.IniFormat)
        nothing = lambda *_: None  # noqa: E731
        services = AppServices(folder=tmp_path, separate_process=False)
        context = AppContext(
            services, AppState(jobs, "researcher"), settings, strip, nothing, nothing, nothing, nothing
        )
        panel = AnalysisPanel(context, home, history=history)
        jobs.changed.connect(lambda: panel.update_enabled(busy=bool(jobs), testing=False))
        home.resize(700, 560)
        panel.resize(700, 560)
        home.show()
        opened.append((home, panel))
        return panel

    yield make
    for _, panel in opened:
        panel.cancel()
        wait(qtbot, panel)


@pytest.fixture
def panel(open_panel):
    return open_panel()


def wait(qtbot, panel):
    qtbot.waitUntil(lambda: panel.context.jobs.idle, timeout=WAIT_MS)


def press(qtbot, widget):
    qtbot.mouseClick(widget, Qt.MouseButton.LeftButton)


def chosen_of(path, subject="P-001", number=1):
    return SelectedTest(path, number, "left calf", subject, f"{subject} #{number}")


@pytest.fixture(scope="session")
def pair(tmp_path_factory, saved):
    """A folder with two sessions of the same record, of different subjects."""
    session, folder = read_session(saved), tmp_path_factory.mktemp("pair")
    for name in ("P-001", "P-002"):
        subject = dataclasses.replace(session.subject, pseudonym=name)
        write_session(folder / f"{name}.h5", dataclasses.replace(session, subject=subject))
    return folder


@pytest.fixture
def two(tmp_path, pair):
    """Copies of the two sessions that a test may change."""
    return [chosen_of(Path(shutil.copy(path, tmp_path)), path.stem) for path in sorted(pair.iterdir())]


def choose(panel, engine):
    panel.form.engine.setCurrentIndex(panel.form.engine.findData(engine))


def run(qtbot, panel, chosen, engine="lms"):
    choose(panel, engine)
    panel.show_tests(chosen)
    press(qtbot, panel.run)
    wait(qtbot, panel)


def answer(qtbot, panel, path):
    """Answer the file dialog that is open."""
    qtbot.waitUntil(lambda: bool(panel.findChildren(QFileDialog)), timeout=WAIT_MS)
    dialog = panel.findChildren(QFileDialog)[-1]
    dialog.fileSelected.emit(str(path))
    dialog.close()
    wait(qtbot, panel)


class Held:
    """Stands for an engine that takes its time: it fits when it is told to."""

    def __init__(self, real):
        self.real, self.reached, self.go_on = real, threading.Event(), threading.Event()
        self.single = False

    def __call__(self, *args, **options):
        self.reached.set()
        assert self.go_on.wait(WAIT_MS / 1000)
        if self.single:
            self.single = False
            self.go_on.clear()
        return self.real(*args, **options)

    def once(self):
        """Let one fit go on, and hold the next one."""
        self.single = True
        self.go_on.set()


@pytest.fixture
def held(monkeypatch):
    held = Held(batch.analyse)
    monkeypatch.setattr(batch, "analyse", held)
    yield held
    held.go_on.set()
