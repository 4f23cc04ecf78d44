"""Windows for tests: offscreen, unpaced, saving into a folder of their own."""

from __future__ import annotations

import functools
import gc
import math
import os

import pytest

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")

from app.benches import WAIT_MS, Bench, Clock, found
from app.fitted import analyse_once
from PySide6.QtCore import QCoreApplication, QEvent, QSettings

from tissueid.app.context import AppServices
from tissueid.app.emergency import EmergencyStop
from tissueid.app.main_window import MainWindow
from tissueid.app.theme import LIGHT, appearance
from tissueid.calibration.active import activate_calibration
from tissueid.instrument import SimulatedInstrument
from tissueid.language import ENGLISH, set_language


@pytest.fixture(scope="session")
def qapp_args():
    return ["tissueid"]


@pytest.fixture
def bench():
    return Bench()


@pytest.fixture
def clock():
    """What the dead man's switch goes by: it stands still until a test moves it on."""
    return Clock()


@pytest.fixture
def calibrations(tmp_path_factory):
    """The folder of calibrations: empty until a test puts one there."""
    return tmp_path_factory.mktemp("calibrations")


@pytest.fixture(autouse=True)
def _light():
    """Begin in light colours, whatever a test before chose: the appearance is that of the process."""
    appearance.use(LIGHT)


@pytest.fixture
def plots_rendered():
    """Whether plots get pixels: test files about pictures override this fixture."""
    return False


@pytest.fixture
def plots_laid_out(plots_rendered):
    """Whether plots make room for their labels: test files about sizes and places override this fixture."""
    return plots_rendered


@pytest.fixture(autouse=True)
def _plots_without_pixels(plots_rendered, plots_laid_out, monkeypatch):
    """Build plots but neither lay out nor render them: that takes a third of a test that shows a result."""
    if not plots_rendered:
        from matplotlib.backends.backend_qtagg import FigureCanvasQTAgg

        monkeypatch.setattr(FigureCanvasQTAgg, "draw", lambda _canvas: None)
    if not plots_laid_out:
        from pyqtgraph import GraphicsView

        monkeypatch.setattr(GraphicsView, "paintEvent", lambda _view, _event: None)
        monkeypatch.setattr("tissueid.reports.plot_axes.lay_out", lambda _figure: None)


def opened(folder, bench, clock, calibrations, rendered=False, /, **changes):
    """Open a window with services for tests: instruments of a bench, a clock that stands still, files in a folder."""
    services = {"opener": bench.open, "finder": found, "folder": folder, "wait": lambda _: None}
    services |= {"separate_process": False, "stop": lambda: EmergencyStop(clock.read), "show_file": lambda _: True}
    services |= {"calibrate": functools.partial(activate_calibration, folder=calibrations)}
    services |= {"first_page": "measure", "language": "en"}
    services["settings"] = lambda: QSettings(str(folder / "window.ini"), QSettings.Format.IniFormat)
    window = MainWindow(AppServices(**(services | changes)))
    if not window.settings.contains("window/geometry"):
        window.resize(1280, 720)  # more than the screen of the offscreen platform has
    window.setUpdatesEnabled(rendered)  # painting a window takes a twentieth of its test
    window.show()
    window.activateWindow()
    return window


@pytest.fixture(scope="module")
def module_window(qapp, tmp_path_factory):
    """A window for the tests of a module that begin no test; :func:`fresh_window` sets it back."""
    folder = tmp_path_factory.mktemp("module")
    window = opened(folder, Bench(), Clock(), folder)
    yield window
    window.close()
    window.deleteLater()
    QCoreApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)


@pytest.fixture
def fresh_window(qtbot, module_window):
    """The window of the module as at its start: page Measure, nothing said, the form with its usual values."""
    window, form = module_window, module_window.ui.form
    qtbot.waitUntil(lambda: window.jobs.idle, timeout=WAIT_MS)
    window.resize(1280, 720)
    window.pages.show("measure")
    form.tell_force(form.instrument.url, math.inf)
    usual = {"site": "", "pseudonym": "", "condition": "", "minutes_since_application": None, "limits": "clinical"}
    form.fill(usual | {"preset": "standard", "seed": 1, "repeats": 1, "rest_s": 0.0, "kind": None})
    form.fold.setChecked(False)
    form.save_in(window.services.folder)
    window.ui.notice.retract()
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow, timeout=WAIT_MS)
    form.site.setFocus()
    return window


@pytest.fixture
def open_window(qtbot, tmp_path, bench, clock, calibrations, monkeypatch, plots_rendered):
    """Opens windows; at the end each is closed, its work is waited for, and the garbage is collected in this thread."""
    windows = []
    monkeypatch.setattr("tissueid.analysis.analyse_all", analyse_once)

    def make(**changes):
        window = opened(tmp_path, bench, clock, calibrations, plots_rendered, **changes)
        windows.append(window)
        qtbot.waitUntil(window.isActiveWindow, timeout=WAIT_MS)
        return window

    gc.collect()
    gc.freeze()  # what was there before need not be searched at every end, nor what was frozen before it
    gc.disable()
    yield make
    for window in windows:
        window.close()
        qtbot.waitUntil(lambda window=window: not window.isVisible(), timeout=WAIT_MS)
        window.deleteLater()
    windows.clear()
    set_language(ENGLISH)  # it holds for the whole process: windows opened in another must not leave it behind
    QCoreApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)
    gc.enable()
    gc.collect()


@pytest.fixture
def window(open_window):
    return open_window()


@pytest.fixture(scope="session")
def saved(tmp_path_factory):
    """A session with one completed test of 1.5 s."""
    from tissueid.app.live_signals import LiveSignals
    from tissueid.app.live_test import LiveTest
    from tissueid.procedures.test_plan import TestPlan
    from tissueid.procedures.test_run import run_test

    path = tmp_path_factory.mktemp("saved") / "saved.h5"
    plan = TestPlan(url="simulated://forearm", site="left calf", out=path, seconds=1.5, live=True)
    run_test(
        plan,
        LiveTest(LiveSignals(), EmergencyStop()),
        None,
        opener=lambda _: SimulatedInstrument("baseline", seed=5),
        pace=lambda _: None,
        separate_process=False,
    )
    return path
