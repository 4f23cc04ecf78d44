"""What a clinician sees and can reach on Start and Measure: everyday words, no old values, no lost keyboard."""

import dataclasses

import numpy as np
import pytest
from app.benches import WAIT_MS
from app.test_window import idle, press
from coded import code_of
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QApplication

from tissueid.acquisition.quality import Quality, QualityFinding
from tissueid.analysis.curves.plot import Axis, Curve, Plot
from tissueid.app.number_field import OptionalNumberField
from tissueid.app.plot_canvas import PlotCanvas
from tissueid.app.quality_gate import QualityGatePanel
from tissueid.app.views.clinician.comparing import Sighting, changes
from tissueid.records import Estimate
from tissueid.sessions import read_session, write_session

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]

UNCALIBRATED = QualityFinding("calibration_none", "note", "Not calibrated.", "Run the static calibration.")


@pytest.fixture
def opened(qtbot, open_window, saved):
    """Opens windows that show the result of a session."""

    def make(role, path=saved):
        window = open_window(role=role)
        window.open_session(path)
        qtbot.waitUntil(lambda: idle(window) and window.findings is not None, timeout=WAIT_MS)
        return window

    return make


def test_a_page_that_is_chosen_by_keys_gets_the_focus(qtbot, open_window, saved):
    window = open_window(role="clinician", first_page="start")
    for number, name in enumerate(window.ui.rail.buttons, 1):
        qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
        window.ui.open.setFocus()
        qtbot.keyClick(window, getattr(Qt.Key, f"Key_{number}"), Qt.KeyboardModifier.ControlModifier)
        assert window.ui.page == name
        assert window.ui.holders[name].isAncestorOf(QApplication.focusWidget()), name
    window.ui.start.setFocus()
    window.pages.go("start")
    window.pages.go("measure")
    assert window.ui.form.site.hasFocus()


def test_a_clinician_unfolds_the_details_and_others_see_them(qtbot, opened):
    window = opened("clinician")
    page, form = window.ui.result, window.ui.form
    assert [tile.isVisible() for tile in page.tiles] == [True, True, True, False, False]
    assert not any(card.isVisible() for card in page.cards)
    assert "Gaussian" not in form.summary.text()
    assert form.set_up.isHidden()
    assert all(tile.toolTip() for tile in page.tiles[:3])
    press(qtbot, page.details)
    assert all(tile.isVisible() for tile in page.tiles)
    assert all(card.isVisible() for card in page.cards)
    window.ui.role.choice.setCurrentIndex(window.ui.role.choice.findData("researcher"))
    assert page.details.isHidden()
    assert all(card.isVisible() for card in page.cards)
    assert form.set_up.isVisible()
    assert "Gaussian" in form.summary.text()


def test_the_numbers_of_a_test_that_does_not_count_are_not_bold(opened, saved, tmp_path):
    session = read_session(saved)
    finding = QualityFinding("lifted", "repeat", "The probe was lifted.", "Start again.")
    notes = session.tests[0].notes | Quality((finding,)).as_notes()
    path = tmp_path / "lifted.h5"
    write_session(path, dataclasses.replace(session, tests=(dataclasses.replace(session.tests[0], notes=notes),)))
    window = opened("clinician", path)
    assert window.findings.verdict.level == "poor"
    assert window.ui.result.tiles[0].value.property("level") == "poor"
    window.show_findings(window.findings)
    sizes = [tile.value.font().pointSizeF() for tile in window.ui.result.tiles[:1]]
    assert sizes[0] < 16


def test_a_clinician_is_sent_to_the_technician_who_is_led_to_the_calibration(qtbot):
    gate = QualityGatePanel()
    qtbot.addWidget(gate)
    wanted = []
    gate.calibration_wanted.connect(lambda: wanted.append(1))
    gate.show_role("clinician")
    gate.show_quality(Quality((UNCALIBRATED,)), can_repeat=True)
    assert UNCALIBRATED.advice not in " ".join(gate.texts)
    assert gate.calibrate.isHidden()
    gate.show_role("technician")
    assert UNCALIBRATED.advice in " ".join(gate.texts)
    press(qtbot, gate.calibrate)
    assert wanted == [1]
    gate.show_quality(Quality(()), can_repeat=True)
    assert gate.calibrate.isHidden()


def test_escape_leaves_a_problem_that_was_not_read(qtbot, window):
    window.ui.notice.say("The disk is full.", problem=True)
    qtbot.keyClick(window, Qt.Key.Key_Escape)
    assert window.ui.notice.text.text() == "The disk is full."


def test_old_curves_are_covered_until_the_new_ones_are_drawn(qtbot):
    x = np.linspace(0.0, 1.0, 5)
    plot = Plot("Force", Axis("Time", "s"), Axis("Force", "N"), (Curve(x, x),))
    first, second = PlotCanvas(), PlotCanvas()
    for canvas in (first, second):
        qtbot.addWidget(canvas)
        canvas.show()
        canvas.show_plots([plot])
    qtbot.waitUntil(lambda: not second.pending, timeout=WAIT_MS)
    for canvas in (first, second):
        canvas.show_plots([plot])
    assert second.pending
    assert second.cover.isVisible()
    qtbot.waitUntil(lambda: not second.pending, timeout=WAIT_MS)
    assert not first.cover.isVisible()
    assert not second.cover.isVisible()


def test_an_empty_field_stays_empty_where_a_number_is_refused(qtbot):
    field = OptionalNumberField(120.0)
    qtbot.addWidget(field)
    field.setSuffix(" years")
    field.give(None)
    field.show()
    field.setFocus()
    qtbot.keyClicks(field, "200")
    qtbot.keyClick(field, Qt.Key.Key_Return)
    assert "empty" in field.hint.text()
    assert field.given is None


@pytest.mark.parametrize(
    ("now", "std", "code"),
    [
        (100.0, 5.0, "comparison.same"),
        (120.0, 5.0, "comparison.higher"),
        (80.0, 5.0, "comparison.lower"),
        (120.0, 10.0, "comparison.same"),
    ],
)
def test_a_change_since_the_last_sitting_counts_beyond_the_repeatability(now, std, code):
    """Two tests of deviations of 5 differ by less than 1.96 · √2 · 5 = 13.9 in 95 % of cases."""

    def sighting(key, created, value, **others):
        return Sighting(key, created, "left calf", {"mass_kg": Estimate(value, std)}, **others)

    this = sighting("c", "2026-02-03T10:00:00Z", now, this=True)
    before = sighting("b", "2026-02-02T10:00:00Z", 100.0)
    other = sighting("x", "2026-02-02T12:00:00Z", 500.0, other_instrument=True)
    older = sighting("a", "2026-02-01T10:00:00Z", 300.0)
    found = changes([this, other, before, older])
    assert {name: code_of(words) for name, words in found.items()} == {"mass_kg": code}
    assert found["mass_kg"].values["date"] == "2026-02-02"
    assert changes([this, other]) == {}
    assert changes([before, older]) == {}
