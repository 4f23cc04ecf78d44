"""How the window looks in German and in the dark: nothing is cut that there is room for, and all has its colours."""

import pytest
from app.benches import WAIT_MS, found
from app.test_window import idle, press, type_site, wait_for_result
from PySide6.QtCore import Qt
from PySide6.QtGui import QColor, QPalette
from PySide6.QtWidgets import QAbstractSpinBox

from tissueid.app.theme import DARK
from tissueid.app.views.start.view import Rows
from tissueid.instrument import FoundInstrument
from tissueid.language import set_language

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]


@pytest.fixture(autouse=True)
def english_again():
    yield
    set_language("en")


@pytest.fixture
def dark(qapp):
    """What a desktop in dark colours gives, with bases that are not those of the theme."""
    before = qapp.palette()
    palette = QPalette(QColor("#232a2f"), QColor("#1b2024"))
    palette.setColor(QPalette.ColorRole.WindowText, QColor("#e6eaec"))
    qapp.setPalette(palette)
    yield
    qapp.setPalette(before)


def fill(qtbot, width, *lines):
    table = Rows("Instruments", ("Instrument", "Health", "Calibration"), (1, 2))
    qtbot.addWidget(table)
    table.resize(width, 300)
    table.show()
    table.fill([[(text, "") for text in line] for line in lines])
    return table


def test_a_column_gets_the_room_that_the_others_do_not_need(qtbot):
    health = "Ready: simulation in this program."
    table = fill(qtbot, 560, ("simulated://spring", health, "Not known yet"))
    assert table.columnWidth(1) >= table.sizeHintForColumn(1)
    assert table.columnWidth(2) >= table.sizeHintForColumn(2)
    assert sum(table.columnWidth(column) for column in range(3)) == table.viewport().width()
    assert table.rowHeight(0) == table.verticalHeader().minimumSectionSize()


def test_what_is_too_long_all_the_same_is_wrapped_and_not_cut(qtbot):
    table = fill(qtbot, 420, ("simulated://spring", "Does not answer: " + "look at the cable " * 8, "Not known yet"))
    assert table.columnWidth(2) >= table.sizeHintForColumn(2)
    assert table.rowHeight(0) > 2 * table.fontMetrics().height()
    table.resize(900, 300)
    assert table.rowHeight(0) <= 4 * table.fontMetrics().height()


@pytest.mark.soak
def test_health_on_the_first_page_is_not_cut(qtbot, open_window):
    def finder(**_):
        return [FoundInstrument("simulated://forearm", "simulation in this process", True), *found(probe=False)[1:]]

    for language in ("en", "de"):
        window = open_window(first_page="start", language=language, finder=finder)
        qtbot.waitUntil(lambda window=window: idle(window), timeout=WAIT_MS)
        window.resize(1280, 800)
        table = window.pages.start.instruments
        assert table.columnWidth(1) >= table.sizeHintForColumn(1)


@pytest.mark.soak
def test_gate_and_verdict_have_german_headlines(qtbot, open_window):
    window = open_window(language="de")
    type_site(qtbot, window)
    press(qtbot, window.ui.start)
    wait_for_result(qtbot, window)
    assert window.ui.gate.headline.text() == "Guter Test"
    assert window.ui.gate.property("level") == "good"
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    window.pages.show("start")
    recent = window.pages.start.recent
    qtbot.waitUntil(lambda: idle(window) and recent.rowCount() == 1, timeout=WAIT_MS)
    assert recent.item(0, 3).text() == "Guter Test"


def test_the_body_map_is_as_dark_as_the_window(qtbot, open_window, dark):
    window = open_window()
    press(qtbot, window.ui.form.map)
    chart = window.clinician.body_map
    qtbot.waitUntil(chart.isVisible, timeout=WAIT_MS)
    assert chart.palette().color(QPalette.ColorRole.Base).name() == DARK.field
    chart.close()


def test_fields_that_come_late_have_the_colours_of_the_page(qtbot, open_window, dark):
    window = open_window(first_page="research")
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    form = window.ui.views["research"].analysis.form
    form.choose("dpn")
    spins = [spin for spin in form.findChildren(QAbstractSpinBox) if spin.isVisibleTo(form) and spin.isEnabled()]
    assert len(spins) > 1
    assert {spin.palette().color(QPalette.ColorRole.Base).name() for spin in spins} == {DARK.field}


@pytest.mark.soak
def test_the_german_pages_need_no_more_room_than_there_is(qtbot, open_window):
    window = open_window(language="de", first_page="gap")
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    result = window.ui.views["gap"].result
    assert result.widget().minimumSizeHint().width() <= 950  # what the page has of the window's 1280
    assert result.horizontalScrollBarPolicy() == Qt.ScrollBarPolicy.ScrollBarAsNeeded


@pytest.mark.soak
def test_both_kinds_of_calibration_stand_side_by_side(open_window):
    window = open_window(role="technician", language="de")
    window.ui.pages.setCurrentWidget(window.ui.calibration)
    cards = [button.parentWidget() for button in window.ui.calibration.begin.values()]
    assert cards[0].geometry().top() == cards[1].geometry().top()
    assert cards[0].height() == cards[1].height()
