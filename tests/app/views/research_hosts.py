"""A year of sessions, and the page Research in a window of its own, for its tests."""

import gc
import json

import numpy as np
import pytest
from app.benches import WAIT_MS
from PySide6.QtCore import QCoreApplication, QEvent, QPoint, QSettings, Qt
from PySide6.QtWidgets import QMainWindow

from tissueid.app.context import AppContext, AppServices, AppState
from tissueid.app.jobs import Jobs
from tissueid.app.views.researcher.session_tree import SITE
from tissueid.app.views.researcher.view import ResearchView
from tissueid.device import DeviceDescription
from tissueid.sessions import Session, Subject, Test, write_session
from tissueid.sessions.quality import NOTE

RATE = 2000.0
SITES = {"a": "left forearm", "b": "right calf", "c": "left forearm"}


def signals(seed, samples=4000):
    """A force that is noise about 5 N, and a position that swings at 50 Hz by 2 mm about 14 mm."""
    rng = np.random.default_rng(seed)
    time = np.arange(samples) / RATE
    return {
        "command": rng.normal(0.0, 1.0, samples),
        "voltage": rng.normal(0.0, 2.0, samples),
        "force": rng.normal(5.0, 1.5, samples),
        "position": 0.014 + 0.002 * np.sin(2 * np.pi * 50.0 * time),
    }


def save(path, *, subject="P-1", site="left forearm", created="2026-03-01T10:00:00Z", tests=1, verdict=None):
    note = {}
    if verdict:
        finding = {"code": "x", "severity": verdict, "words": "w", "advice": "a", "value": None}
        note = {NOTE: json.dumps({"verdict": verdict, "findings": [finding]})}
    made = tuple(
        Test(number, "stochastic", signals(number), RATE, site=site, preload_s=0.5, notes=note)
        for number in range(1, tests + 1)
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    write_session(path, Session(DeviceDescription(), Subject(subject), made, created=created))
    return path


@pytest.fixture(scope="session")
def year(tmp_path_factory):
    """Three sessions in nested folders, and two files that are none."""
    folder = tmp_path_factory.mktemp("year")
    save(folder / "march" / "a.h5", subject="P-1", site=SITES["a"], created="2026-03-01T10:00:00Z", tests=2)
    save(folder / "b.h5", subject="P-2", site=SITES["b"], created="2026-05-01T10:00:00Z", verdict="repeat")
    save(folder / "march" / "deep" / "c.h5", subject="P-3", site=SITES["c"], created="2026-01-01T10:00:00Z")
    (folder / "march" / "rubbish.h5").write_bytes(b"<b>no session</b>")
    (folder / "notes.txt").write_text("not looked at")
    return folder


class Host(QMainWindow):
    """What stands around a page, as far as it sees: jobs, settings, and lists of what it says and asks for."""

    testing = False

    def __init__(self, folder, ini, page=ResearchView, **services):
        super().__init__()
        self.jobs = Jobs(self)
        self.settings = QSettings(str(ini), QSettings.Format.IniFormat)
        self.said, self.opened, self.prepared, self.shown = [], [], [], []
        context = AppContext(
            AppServices(folder=folder, separate_process=False, **services),
            AppState(self.jobs, "researcher"),
            self.settings,
            self.say,
            go=lambda _page: None,
            open_session=self.opened.append,
            prepare_test=lambda fields, words: self.prepared.append((fields, words)),
            show_file=self.shown.append,
            instrument=lambda: "simulated://forearm",
        )
        self.view = page(context)
        self.setCentralWidget(self.view)
        self.resize(1000, 580)
        self.view.apply_state()

    def say(self, text, *, problem=False):
        self.said.append(text)

    def start(self):
        self.view.enter()
        self.show()
        self.activateWindow()
        return self.view


def listed(view):
    return [entry.path.name for _, entry in view.browser.shown.shown()]


@pytest.fixture
def host(qtbot, tmp_path):
    hosts = []

    def make(folder, ini=None, page=ResearchView, **services):
        hosts.append(Host(folder, ini or tmp_path / "window.ini", page, **services))
        view = hosts[-1].start()
        qtbot.waitUntil(hosts[-1].isActiveWindow, timeout=WAIT_MS)
        return hosts[-1], view

    gc.disable()
    yield make
    for one in hosts:
        one.view.cancel()
        qtbot.waitUntil(lambda one=one: one.jobs.idle, timeout=WAIT_MS)
        one.close()
        one.deleteLater()
    hosts.clear()
    QCoreApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)
    gc.enable()


@pytest.fixture
def opened(qtbot, host, year):
    def make(folder=year, ini=None):
        window, view = host(folder, ini)
        qtbot.waitUntil(lambda: window.jobs.idle and not view.browser._all_wanted, timeout=WAIT_MS)
        return window, view

    return make


def click(qtbot, view, row, modifier=Qt.KeyboardModifier.NoModifier, double=False):
    tree = view.browser.tree
    place = tree.visualRect(view.browser.shown.index(row, SITE)).center()
    qtbot.mouseClick(tree.viewport(), Qt.MouseButton.LeftButton, modifier, place)
    if double:
        qtbot.mouseDClick(tree.viewport(), Qt.MouseButton.LeftButton, modifier, place)


def show(qtbot, window, view, rows, tests):
    for row in rows:
        click(qtbot, view, row, Qt.KeyboardModifier.ControlModifier)
    wait_shown(qtbot, window, view, tests)


def wait_shown(qtbot, window, view, tests):
    qtbot.waitUntil(lambda: len(view.signals.loaded) == tests and window.jobs.idle, timeout=WAIT_MS)
    qtbot.waitUntil(lambda: not view.signals._figures.isActive() and not view.signals.stack._frame.isActive())


def drag(qtbot, card, low, high):
    port = card.plot.viewport()
    box = card.plot.getViewBox()
    view = box.viewRange()[0]
    ends = []
    for time in (low, high):
        scene = box.sceneBoundingRect()
        share = (time - view[0]) / (view[1] - view[0])
        ends.append(QPoint(round(scene.left() + share * scene.width()), round(scene.center().y())))
    qtbot.mousePress(port, Qt.MouseButton.LeftButton, pos=ends[0])
    qtbot.mouseMove(port, ends[1])
    qtbot.mouseRelease(port, Qt.MouseButton.LeftButton, pos=ends[1])


def ranges(view):
    return [tuple(card.plot.getViewBox().viewRange()[0]) for card in view.signals.stack.cards]
