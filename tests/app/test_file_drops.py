"""Files that are opened or dropped in the window: records go through the import dialog, sessions where they belong."""

import json
import math

import pytest
from app.benches import WAIT_MS
from app.test_window import idle, press
from PySide6.QtCore import QMimeData, QPointF, Qt, QUrl
from PySide6.QtGui import QDragEnterEvent, QDropEvent
from PySide6.QtWidgets import QApplication, QLineEdit

from tissueid.audit import AuditLog, last_lines
from tissueid.cli import main
from tissueid.sessions import read_session

RATE_HZ = 1000.0


@pytest.fixture
def record(tmp_path):
    """A German table: decimal commas, semicolons, force in mN and position in mm."""
    path = tmp_path / "messung.csv"
    lines = ["Zeit (s);Kraft (mN);Weg (mm)"]
    for k in range(3000):
        t = k / RATE_HZ
        force = 2000.0 + 1500.0 * math.sin(30.0 * t) + 400.0 * math.sin(171.0 * t)
        row = (f"{t:.4f}", f"{force:.3f}", f"{10.0 + 2e-3 * force + 0.3 * math.sin(30.0 * t - 0.5):.5f}")
        lines.append(";".join(row).replace(".", ","))
    path.write_text("\n".join(lines) + "\n")
    return path


def drop(window, *paths):
    """Drop files on the window, as Qt delivers that; returns whether they were accepted."""
    data = QMimeData()
    data.setUrls([QUrl.fromLocalFile(str(path)) for path in paths])
    shared = (Qt.DropAction.CopyAction, data, Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier)
    enter = QDragEnterEvent(QPointF(9, 9).toPoint(), *shared)
    enter.setAccepted(False)
    QApplication.sendEvent(window, enter)
    if enter.isAccepted():
        QApplication.sendEvent(window, QDropEvent(QPointF(9, 9), *shared))
    return enter.isAccepted()


def asked(qtbot, window):
    """Wait for the import dialog."""
    qtbot.waitUntil(lambda: idle(window) and window.files.dialog is not None, timeout=WAIT_MS)
    return window.files.dialog


def roles_of(dialog):
    return [dialog.role_of(row).currentData() for row in range(dialog.table.rowCount())]


def test_a_dropped_record_is_imported_as_the_command_line_does(qtbot, open_window, record, tmp_path, audit_file):
    window = open_window(audit=AuditLog(audit_file))
    assert drop(window, record)
    dialog = asked(qtbot, window)
    assert roles_of(dialog) == ["time", "force", "position"]
    assert [dialog.unit_of(row).currentText() for row in range(3)] == ["s", "mN", "mm"]
    assert dialog.table.item(1, 3).text().split()[0] == "2000"
    dialog.site.setText("left forearm")
    dialog.subject.setText("P-007")
    press(qtbot, dialog.go)
    qtbot.waitUntil(lambda: window.files.dialog is None and idle(window), timeout=WAIT_MS)
    made = read_session(tmp_path / "messung.h5")
    command = ["import", str(record), "--out", str(tmp_path / "cli.h5"), "--site", "left forearm", "--subject", "P-007"]
    assert main([*command, "--map", "force=2:mN", "--map", "position=3:mm"]) == 0
    known = read_session(tmp_path / "cli.h5")
    assert made.subject.pseudonym == known.subject.pseudonym == "P-007"
    assert made.test().site == known.test().site
    for name, values in known.test().signals.items():
        assert (made.test().signals[name] == values).all()
    assert {**made.test().notes} == {**known.test().notes}
    assert [line.what for line in last_lines(audit_file, 9)].count("session.imported") == 2
    assert window.findings is not None
    assert window.findings.path == tmp_path / "messung.h5"


def test_an_import_stays_on_the_page_where_it_was_begun(qtbot, open_window, record, tmp_path):
    window = open_window()
    window.pages.show("research")
    view = window.ui.views["research"]
    view.tabs.setCurrentWidget(view.analysis)
    view.browser.bar.ask("nothing is called so", "", "", "")
    window.files.open([record])
    dialog = asked(qtbot, window)
    press(qtbot, dialog.go)
    qtbot.waitUntil(lambda: len(view.signals.loaded) == 1 and idle(window), timeout=WAIT_MS)
    assert window.ui.page == "research"
    assert [one.path for one in view.browser.chosen()] == [tmp_path / "messung.h5"]
    assert view.tabs.currentWidget() is view.signals
    assert "messung.h5" in window.ui.notice.text.text()


def test_what_cannot_be_imported_is_said_in_the_dialog_which_stays(qtbot, open_window, record, tmp_path):
    window = open_window()
    window.files.open([record])
    dialog = asked(qtbot, window)
    dialog.role_of(1).setCurrentIndex(0)
    press(qtbot, dialog.go)
    assert dialog.said.isVisible()
    assert window.files.dialog is dialog
    dialog.role_of(1).setCurrentIndex(dialog.role_of(1).findData("force"))
    dialog.unit_of(1).setEditText("mm")
    press(qtbot, dialog.go)
    assert dialog.said.isVisible()
    dialog.unit_of(1).setEditText("mN")
    (tmp_path / "there.h5").write_bytes(b"kept")
    dialog.out.setText(str(tmp_path / "there.h5"))
    press(qtbot, dialog.go)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert "never overwritten" in dialog.said.text()
    assert (tmp_path / "there.h5").read_bytes() == b"kept"
    press(qtbot, dialog.cancel)
    qtbot.waitUntil(lambda: window.files.dialog is None, timeout=WAIT_MS)
    assert list(tmp_path.glob("messung*.h5")) == []


def test_an_export_of_ours_needs_no_columns(qtbot, open_window, saved, tmp_path):
    assert main(["export", str(saved), "--out", str(tmp_path / "out"), "--format", "csv"]) == 0
    window = open_window()
    window.files.open([tmp_path / "out" / "test-0001.csv"])
    dialog = asked(qtbot, window)
    assert not dialog.table.isEnabled()
    press(qtbot, dialog.go)
    qtbot.waitUntil(lambda: window.files.dialog is None and idle(window), timeout=WAIT_MS)
    ours = json.loads((tmp_path / "out" / "test-0001.json").read_text())
    assert read_session(window.findings.path).session_id == ours["session"]["session_id"]


@pytest.mark.parametrize("page", ["start", "measure", "research", "instrument"])
def test_a_session_can_be_dropped_on_every_page(qtbot, open_window, saved, page):
    window = open_window(role="technician")
    window.pages.show(page)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert not any(field.acceptDrops() for field in window.ui.views[page].findChildren(QLineEdit))
    assert drop(window, saved)
    qtbot.waitUntil(lambda: window.findings is not None and idle(window), timeout=WAIT_MS)
    assert window.findings.path == saved
    assert window.ui.page == "measure"


def test_folders_and_several_sessions_are_listed_on_research(qtbot, open_window, saved, tmp_path):
    window = open_window()
    folder = tmp_path / "others"
    folder.mkdir()
    (folder / "one.h5").write_bytes(saved.read_bytes())
    assert drop(window, folder, saved)
    assert window.ui.page == "research"
    model = window.ui.views["research"].browser.model
    qtbot.waitUntil(lambda: idle(window) and model.rowCount() == 2, timeout=WAIT_MS)


def test_nothing_is_taken_while_work_goes_on(qtbot, open_window, saved, record):
    window = open_window()
    window.open_session(saved)
    assert window.busy
    assert not drop(window, record)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert window.files.dialog is None


def test_the_dialog_is_worked_by_keys(qtbot, open_window, record):
    window = open_window()
    window.files.open([record])
    dialog = asked(qtbot, window)
    assert dialog.go.isDefault()
    assert not dialog.cancel.autoDefault()
    qtbot.keyClick(dialog, Qt.Key.Key_Escape)
    qtbot.waitUntil(lambda: window.files.dialog is None, timeout=WAIT_MS)


def test_what_cannot_be_opened_is_named_and_leaves_the_page(qtbot, open_window, tmp_path):
    window = open_window()
    window.pages.show("research")
    (tmp_path / "bad.h5").write_bytes(b"rubbish" * 99)
    (tmp_path / "bad.csv").write_text("no numbers\nat all\n")
    for name in ("bad.h5", "bad.csv"):
        window.files.open([tmp_path / name])
        qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
        assert window.ui.page == "research"
        assert name in window.ui.notice.text.text()
