"""A diagnosis that is made once, and the page Gap in a window of its own, for its tests."""

from dataclasses import replace
from pathlib import Path

import pytest
from app.benches import WAIT_MS
from gap_records import SAMPLES, friction_diagnosis, recorded
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QFileDialog

from tissueid.app.user_files import stamp_of
from tissueid.app.views.gap.diagnosis_result import result_of
from tissueid.app.views.gap.view import GapView
from tissueid.procedures.diagnosis import DiagnosedSession
from tissueid.procedures.gap_plans import DiagnosisPlan
from tissueid.sessions import write_session


@pytest.fixture(scope="session")
def made():
    """What the page keeps of the diagnosis; its report is drawn once."""
    session = recorded("dry_friction", samples=SAMPLES)
    plan = DiagnosisPlan(session=Path("friction.h5"))
    return result_of(DiagnosedSession(plan, session, None, friction_diagnosis()), None)


@pytest.fixture
def friction(tmp_path):
    path = tmp_path / "friction.h5"
    write_session(path, recorded("dry_friction", samples=SAMPLES))
    return path


@pytest.fixture
def diagnosed(made, friction):
    return replace(made, asked=DiagnosisPlan(session=friction), stamp=stamp_of(friction))


@pytest.fixture
def gap_page(qtbot, host, tmp_path):
    """Opens the page, waits for what it reads, and chooses the first diagnosis."""

    def make(**services):
        window, page = host(tmp_path, page=GapView, **services)
        idle(qtbot, window)
        page.history.list.setCurrentRow(0)
        return window, page

    return make


def idle(qtbot, window):
    qtbot.waitUntil(lambda: _idle(window, window.view), timeout=WAIT_MS)


def _idle(window, page):
    reads = page.background.wanted or page.background.running or page.asking.session.untitled
    return window.jobs.idle and not page.asking.bar.isVisible() and not reads


def press(qtbot, widget):
    qtbot.waitUntil(widget.isEnabled, timeout=WAIT_MS)
    qtbot.mouseClick(widget, Qt.MouseButton.LeftButton)


def answer_dialog(page, path):
    dialog = page.findChild(QFileDialog)
    dialog.fileSelected.emit(str(path))
    dialog.close()


def restarted(qtbot, window, gap_page):
    """Close the page as the window does, and open it again."""
    window.view.save_state()
    window.view.cancel()
    window.close()
    return gap_page()
