"""The command line and the window import and export the same from the same plan, and log it alike."""

import json
import math

import pytest
from coded import coded
from procedures.same_session import assert_same_session

from tissueid.app.import_dialog import ImportDialog, preview_of
from tissueid.app.views.researcher.selected_test import SelectedTest
from tissueid.app.views.researcher.view import SessionExport
from tissueid.audit import AuditLog, AuditTrail, last_lines
from tissueid.cli import main
from tissueid.errors import CancelledError, UnusableInputError
from tissueid.procedures.control import Control
from tissueid.procedures.import_export import ExportPlan, ImportPlan, run_export, run_import
from tissueid.sessions import read_session


@pytest.fixture
def record(tmp_path):
    path = tmp_path / "record.csv"
    rows = [f"{k / 1000},{2.0 + math.sin(k / 9)!r},{3.0 + math.sin(k / 9 - 0.4)!r}" for k in range(600)]
    path.write_text("time,force,disp\n" + "\n".join(rows) + "\n")
    return path


@pytest.fixture
def trail(audit_file):
    return AuditTrail(AuditLog(audit_file), "researcher")


@pytest.fixture
def imported(record, tmp_path, trail):
    plan = ImportPlan(
        files=(f"{record}@:200", f"{record}@200:600"), out=tmp_path / "s.h5", mapping=("force=2:N", "position=3:mm")
    )
    run_import(plan, Control(), trail)
    return tmp_path / "s.h5"


def logged(audit_file):
    """Return the last two lines of the log, without time and place."""
    return [(line.what, line.role, line.new) for line in last_lines(audit_file, 2)]


def test_the_dialog_imports_what_the_command_line_does(qtbot, record, tmp_path, trail, audit_file):
    dialog = ImportDialog(preview_of([record]), tmp_path / "window.h5")
    qtbot.addWidget(dialog)
    dialog.unit_of(0).setEditText("s")
    dialog.unit_of(1).setEditText("N")
    dialog.role_of(2).setCurrentIndex(dialog.role_of(2).findData("position"))
    dialog.unit_of(2).setEditText("mm")
    dialog.first.setText("100")
    dialog.site.setText("left calf")
    dialog.subject.setText("P-3")
    dialog.kind.setCurrentIndex(dialog.kind.findData("slow_ramp"))
    run_import(dialog.plan(), Control(), trail)
    options = ["--site", "left calf", "--subject", "P-3", "--kind", "slow_ramp", "--map", "time=1:s"]
    columns = ["--map", "force=2:N", "--map", "position=3:mm"]
    assert main(["import", f"{record}@100:", "--out", str(tmp_path / "cli.h5"), *options, *columns]) == 0
    one, other = read_session(tmp_path / "cli.h5"), read_session(tmp_path / "window.h5")
    assert one.test().samples == 500
    assert_same_session(one, other, except_for=("session_id", "created"))
    first, second = logged(audit_file)
    assert first == second


def test_the_dialog_shows_which_units_it_cannot_read(qtbot, tmp_path):
    path = tmp_path / "record.csv"
    path.write_text("Time (min),Load (lbf),Travel (mil),Other (counts)\n0,1,2,3\n1,2,3,4\n2,3,4,5\n")
    dialog = ImportDialog(preview_of([path]), tmp_path / "window.h5")
    qtbot.addWidget(dialog)
    assert [dialog.role_of(row).currentData() for row in range(4)] == ["time", "force", "position", ""]
    assert [dialog.unit_of(row).currentText() for row in range(4)] == ["min", "lbf", "mil", "counts"]
    dialog.role_of(3).setCurrentIndex(dialog.role_of(3).findData("output"))
    assert [dialog.unit_of(row).property("level") for row in range(4)] == [None, None, None, "poor"]
    assert dialog.unit_of(3).accessibleDescription()
    with pytest.raises(UnusableInputError, check=coded("import.unknown_unit", unit="counts")):
        dialog.plan()
    dialog.unit_of(3).setEditText("1")
    assert dialog.unit_of(3).property("level") is None
    assert dialog.plan().mapping == ("time=1:min", "force=2:lbf", "position=3:mil", "output=4:1")


def test_the_dialog_asks_for_the_decimal_sign(qtbot, tmp_path, trail):
    path = tmp_path / "record.csv"
    rows = [f"{load:,.0f}\t{load:,.0f}" for load in range(100, 3000, 50)]
    path.write_text("\n".join(["Load (mN)\tTravel (um)", *rows]) + "\n")
    dialog = ImportDialog(preview_of([path]), tmp_path / "window.h5")
    qtbot.addWidget(dialog)
    dialog.rate.setText("100")
    dialog.role_of(1).setCurrentIndex(dialog.role_of(1).findData("position"))
    with pytest.raises(UnusableInputError, check=coded("import.thousands", path=str(path))):
        run_import(dialog.plan(), Control(), trail)
    dialog.decimal.setCurrentIndex(dialog.decimal.findData("point"))
    assert run_import(dialog.plan(), Control(), trail).session.test().signals["force"][-1] == 2.95


def test_the_window_exports_what_the_command_line_does(imported, tmp_path, trail, audit_file):
    assert main(["export", str(imported), "--out", str(tmp_path / "cli"), "--format", "csv", "--test", "2"]) == 0
    export = SessionExport([SelectedTest(imported, 2, "", "", "")], tmp_path, "csv", trail).run()
    assert export.problems == []
    (folder,) = export.written
    names = sorted(path.name for path in folder.iterdir())
    assert names == ["test-0002.csv", "test-0002.json"]
    assert [(folder / name).read_bytes() for name in names] == [
        (tmp_path / "cli" / name).read_bytes() for name in names
    ]
    first, second = logged(audit_file)
    assert first == second == ("session.exported", "researcher", {"tests": 1, "format": "csv"})


def test_all_tests_are_exported_without_a_choice(imported, tmp_path, trail):
    _session, files = run_export(ExportPlan(session=imported, out=tmp_path / "x", kind="csv"), Control(), trail)
    assert files == ["test-0001.csv", "test-0001.json", "test-0002.csv", "test-0002.json"]
    assert json.loads((tmp_path / "x" / "test-0002.json").read_text())["test"]["samples"] == 400


def test_a_cancelled_procedure_leaves_nothing(record, imported, tmp_path, trail):
    class Stopped(Control):
        def cancelled(self):
            return True

    with pytest.raises(CancelledError):
        run_export(ExportPlan(session=imported, out=tmp_path / "x", kind="csv"), Stopped(), trail)
    plan = ImportPlan(files=(record,), out=tmp_path / "t.h5", mapping=("force=2:N", "position=3:mm"))
    with pytest.raises(CancelledError):
        run_import(plan, Stopped(), trail)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["record.csv", "s.h5"]


def test_what_could_not_be_logged_is_a_notice(imported, tmp_path, audit_file):
    audit_file.write_bytes(b"something else\n")
    trail = AuditTrail(AuditLog(audit_file), "researcher")
    export = SessionExport([SelectedTest(imported, 1, "", "", "")], tmp_path, "csv", trail).run()
    assert len(export.written) == 1
    assert len(export.problems) == 1
    assert [notice.code for notice in export.notices] == ["audit.not_logged"]


@pytest.mark.parametrize(
    ("options", "code"),
    [
        ({"sites": ("a\nb",)}, "import.not_printable"),
        ({"kinds": ("fast",)}, "import.unknown"),
        ({"rate_hz": math.nan}, "import.rate_range"),
        ({"sites": ("a", "b")}, "import.count"),
    ],
)
def test_options_are_checked_before_a_file_is_read(tmp_path, trail, options, code):
    plan = ImportPlan(
        files=(tmp_path / "no.csv",), out=tmp_path / "s.h5", mapping=("force=1:N", "position=2:m"), **options
    )
    with pytest.raises(UnusableInputError, check=coded(code)):
        run_import(plan, Control(), trail)
