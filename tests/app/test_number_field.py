"""What is typed into a field for a force or a length is that number or none: never another one."""

from pathlib import Path

import pytest
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QDoubleSpinBox

from tissueid.app import number_field
from tissueid.app.number_field import NumberField, WholeNumberField
from tissueid.app.views.researcher.engine_form import PreparationForm

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]


@pytest.fixture
def window(fresh_window):
    return fresh_window


@pytest.mark.parametrize(
    ("typed", "value"),
    [
        ("4", 4.0),
        ("4.25", 4.25),
        ("0,5", 0.5),
        (",5", 0.5),
        ("7 N", 7.0),
        ("7N", 7.0),
        ("4 mm", 10.5),
        ("5 kN", 10.5),
        ("0.005 kN", 10.5),
        ("-3", 10.5),
        ("1e9", 10.5),
        ("20", 10.5),
        ("0,1", 10.5),
        ("1.000,5", 10.5),
        ("abc", 10.5),
        ("nan", 10.5),
        ("", 10.5),
    ],
)
def test_a_typed_force_is_taken_or_the_one_before_stands(qtbot, window, typed, value):
    form = window.ui.form
    form.fold.setChecked(True)
    field = form.options["max_force_n"].controls[0]
    assert isinstance(field, NumberField)
    assert field.value() == 10.5
    field.setFocus()
    field.selectAll()
    qtbot.keyClicks(field, typed) if typed else qtbot.keyClick(field, Qt.Key.Key_Backspace)
    qtbot.keyClick(field, Qt.Key.Key_Tab)
    assert form.plan().max_force_n == value
    assert field.text() == f"{value:.2f} N"


def test_fields_have_the_decimal_sign_of_the_language(open_window):
    form = open_window(language="de").ui.form
    assert form.options["seconds"].controls[0].text() == "4,00 s"
    form.fill({"seconds": 2.5})
    assert form.plan().seconds == 2.5


def test_a_test_that_is_begun_in_mid_typing_takes_what_is_typed(qtbot, window):
    form = window.ui.form
    form.fold.setChecked(True)
    seconds = form.options["seconds"].controls[0]
    seconds.setFocus()
    seconds.selectAll()
    qtbot.keyClicks(seconds, "1,5")
    assert seconds.value() == 4.0
    assert form.plan().seconds == 1.5


def test_arrows_still_step_and_what_is_undone_comes_back(qtbot, window):
    window.ui.form.fold.setChecked(True)
    field = window.ui.form.options["max_force_n"].controls[0]
    field.setFocus()
    qtbot.keyClick(field, Qt.Key.Key_Down)
    assert field.value() == 10.0
    field.selectAll()
    qtbot.keyClicks(field, "3,5")
    qtbot.keyClick(field, Qt.Key.Key_Z, Qt.KeyboardModifier.ControlModifier)
    qtbot.keyClick(field, Qt.Key.Key_Tab)
    assert field.value() == 10.0


@pytest.mark.parametrize(("typed", "at_once"), [("100", True), ("5 kN", True), ("0.2", False), ("4", None)])
def test_what_is_not_taken_is_explained_at_the_field(qtbot, window, typed, at_once):
    """Nothing moves for it, and it is gone once something better is typed."""
    form = window.ui.form
    form.fold.setChecked(True)
    field = form.options["max_force_n"].controls[0]
    refused = []
    field.refused.connect(refused.append)
    seconds = form.options["seconds"].controls[0]
    place = seconds.mapToGlobal(seconds.rect().topLeft())
    field.setFocus()
    field.selectAll()
    qtbot.keyClicks(field, typed)
    assert field.hint.isVisible() is bool(at_once)
    seconds.setFocus()
    assert seconds.mapToGlobal(seconds.rect().topLeft()) == place
    if at_once is None:
        assert not field.hint.isVisible()
        assert refused == []
        return
    assert refused == [typed]
    assert field.hint.text().startswith("0.5 to 12 N; 10.50 N")
    assert field.accessibleDescription() == field.hint.text()
    below = field.mapTo(window, field.rect().bottomLeft())
    assert field.hint.y() >= below.y()
    assert window.rect().contains(field.hint.geometry())
    assert field.toolTip() == field.hint.text()  # it stays when the hint has gone
    assert field.property("level") == "check"
    field.selectAll()
    qtbot.keyClicks(field, "4")
    assert not field.hint.isVisible()
    assert (field.toolTip(), field.property("level")) == ("", "")


def type_into(qtbot, field, typed):
    field.setFocus()
    field.selectAll()
    qtbot.keyClicks(field, typed)
    qtbot.keyClick(field, Qt.Key.Key_Return)


@pytest.mark.parametrize(
    ("typed", "value"),
    [
        ("0,5", 0.5),
        ("12,5", 12.5),
        ("12.5", 12.5),
        ("12,5 Hz", 12.5),
        ("5 kHz", 3.0),
        ("0", 0.0),
        ("", 3.0),
        ("-1", 3.0),
    ],
)
def test_edges_of_the_band(qtbot, typed, value):
    form = PreparationForm()
    qtbot.addWidget(form)
    form.show()
    edges = form.findChildren(QDoubleSpinBox)
    assert edges == [form.low, form.high]
    for edge in edges:
        edge.setValue(3.0)
        type_into(qtbot, edge, typed)
        assert edge.value() == value
    form.low.setValue(0.0)
    type_into(qtbot, form.low, "")
    assert form.low.text() == "no limit"
    assert form.low.hint.isHidden()


@pytest.mark.parametrize(("typed", "value"), [("7", 7), ("1,5", 3), ("1.5", 3), ("1e1", 3), ("12", 3), ("", 3)])
def test_whole_numbers(qtbot, typed, value):
    field = WholeNumberField()
    qtbot.addWidget(field)
    field.setRange(1, 9)
    field.setValue(3)
    field.show()
    type_into(qtbot, field, typed)
    assert field.value() == value


def test_no_field_of_the_window_is_a_bare_spin_box():
    bare = ("= QSpinBox(", "= QDoubleSpinBox(", ", QDoubleSpinBox(", "(QDoubleSpinBox)", "(QSpinBox)")
    sources = Path(number_field.__file__).parent.rglob("*.py")
    found = {path.name for path in sources if any(text in path.read_text(encoding="utf-8") for text in bare)}
    assert found == {"number_field.py"}
