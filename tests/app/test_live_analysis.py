"""The panel beside the running signals: numbers, plots, words, and when it is there."""

from __future__ import annotations

import numpy as np
import pytest
from app.benches import WAIT_MS, Gate
from coded import made, reads
from identification import simulated
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QLabel

from tissueid.app.live_analysis import LiveAnalysis
from tissueid.app.theme import DARK, LIGHT, appearance
from tissueid.app.words import sentence
from tissueid.identification.live.live_view import METHODS, start_identifier, view
from tissueid.identification.live.stopping import precision
from tissueid.messages import Message
from tissueid.procedures.test_plan import TestPlan

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]

WAITING = "No estimate yet: it comes during the stimulus."


class Newest:
    """Stands for an identification that runs: what it shows is set from outside."""

    def __init__(self):
        self.view = None
        self.problem = ""

    def latest(self):
        return self.view


@pytest.fixture
def panel(qtbot, tmp_path):
    panel = LiveAnalysis()
    qtbot.addWidget(panel)
    panel.resize(520, 480)
    panel.expect(TestPlan(url="/dev/ttyUSB0", site="left forearm", out=tmp_path / "s.h5"))
    assert panel.simulated.isHidden()
    panel.expect(TestPlan(url="simulated://forearm", site="left forearm", out=tmp_path / "s.h5"))
    assert not panel.simulated.isHidden()
    return panel


def seen(seconds=4.0, method="sliding", looks=(1.0, 2.0, 4.0)):
    record = simulated.wiener_record(200)
    n = round(seconds * simulated.RATE)
    identifier = start_identifier(method, simulated.RATE)
    identifier.batch(record.input[:n], record.output[:n])
    taken = [precision(record[: round(at * simulated.RATE)]) for at in looks if at <= seconds]
    return view(identifier, taken)


def words(card):
    return card.missing.text()


def data(item):
    x, y = item.getData()
    return np.asarray(x), np.asarray(y)


def test_it_waits_until_there_is_a_view(panel):
    panel.show_live(Newest())
    assert {words(card) for card in panel.cards} == {WAITING}
    assert {figure.text for figure in panel.numbers.values()} == {"—"}


@pytest.mark.parametrize("method", METHODS)
def test_a_view_is_shown_in_the_units_of_people(panel, method):
    newest = Newest()
    newest.view = shown = seen(method=method)
    panel.show_live(newest)
    assert {words(card) for card in panel.cards} == {""}
    stiffness = shown.parameters["stiffness"]
    assert panel.numbers["stiffness"].text.endswith("N/m")
    assert float(panel.numbers["stiffness"].text.split()[0]) == pytest.approx(stiffness.value, rel=1e-2)
    assert panel.numbers["mass"].text.endswith(" g")
    assert panel.numbers["mass"].accessibleName().startswith("Mass: ")
    lag, response = data(panel._response)
    assert lag[-1] == pytest.approx(124.5)  # ms
    np.testing.assert_allclose(response, 1e3 * shown.impulse_response)
    frequency, coherence = data(panel._coherent)
    np.testing.assert_allclose(10.0**frequency, shown.bode.frequency_hz)
    np.testing.assert_allclose(coherence, shown.bode.coherence)
    np.testing.assert_allclose(10.0 ** data(panel._magnitude)[1], 1e3 * shown.bode.magnitude)
    np.testing.assert_allclose(data(panel._phase)[1], np.degrees(shown.bode.phase_rad))
    np.testing.assert_allclose(data(panel._phase_fit)[1][[0, -1]], [-2.0, -168.0], atol=6.0)  # of a system of order two
    density = 10.0 ** data(panel._spectra[1])[1]
    np.testing.assert_allclose(density, np.maximum(1e6 * shown.spectra.output_psd, 1e-12 * density.max()))
    assert panel.vaf.accessibleName().startswith(
        f"Explained, { {'sliding': 'LMS', 'rls': 'RLS', 'als': 'ALS'}[method] }: "
    )
    np.testing.assert_allclose(data(panel._levels)[0], 1e3 * shown.curve.predicted)
    seconds, change = data(panel._courses["damping"])
    assert seconds.tolist() == [1.0, 2.0, 4.0]
    assert change[-1] == 0.0
    assert change[0] == pytest.approx(100.0 * (shown.course.values[0, 1] / shown.course.values[2, 1] - 1.0))


def visible(panel):
    return [card._title for card in panel.cards if not card.isHidden()]


def test_as_many_plots_are_shown_as_fit(panel):
    model = ["Impulse response", "Bode magnitude", "Static nonlinearity", "Bode phase"]
    panel.show()
    assert visible(panel) == model
    panel.tabs.setCurrentIndex(1)
    assert visible(panel) == ["Coherence", "Force spectrum", "Position spectrum"]
    panel.resize(320, 480)  # one plot in a row
    assert panel.tabs.tabText(panel.tabs.currentIndex()) == "Spectra"
    assert visible(panel) == ["Force spectrum", "Position spectrum"]
    panel.tabs.setCurrentIndex(0)
    assert visible(panel) == ["Impulse response", "Static nonlinearity"]
    panel.resize(520, 900)
    assert visible(panel) == [card._title for card in panel.cards]
    assert panel.tabs.isHidden()
    panel.resize(520, 480)
    assert visible(panel) == model


def test_a_clinician_sees_the_values_and_no_terms_of_models(panel):
    panel.show_role("clinician")
    newest = Newest()
    newest.view = seen()
    panel.show_live(newest)
    visible = [card for card in panel.cards if not card.isHidden()]
    assert visible == [panel.plots["course"]]
    assert panel.vaf.isHidden()
    assert panel.tabs.isHidden()
    newest.problem = Message("record.few_samples", "{count} usable samples for {parameters} parameters", count=1)
    panel.show_live(newest)
    assert "samples" not in panel.said.text()
    panel.show_role("researcher")
    assert not panel.vaf.isHidden()
    assert not panel.tabs.isHidden()
    panel.show_live(newest)
    assert "samples" in panel.said.text()


def test_a_view_is_drawn_once(panel, monkeypatch):
    drawn = []
    newest = Newest()
    newest.view = seen()
    monkeypatch.setattr(panel, "show_view", drawn.append)
    for _ in range(3):
        panel.show_live(newest)
    assert len(drawn) == 1
    newest.view = seen(3.0)
    panel.show_live(newest)
    assert len(drawn) == 2


def test_what_is_not_there_yet_is_said_in_its_place(panel):
    newest = Newest()
    newest.view = seen(0.3)
    panel.show_live(newest)
    assert words(panel.plots["impulse"]) == ""
    assert reads(words(panel.plots["bode"]), "online.short_for_coherence", segments=3, memory=0.125)
    assert words(panel.plots["course"]) == words(panel.plots["bode"])
    newest.view = seen(4.0)
    panel.show_live(newest)
    assert words(panel.plots["bode"]) == ""


def test_a_problem_is_told_and_the_test_goes_on(panel):
    newest = Newest()
    newest.problem = made("live.defect", kind="ValueError", error="no such thing")
    panel.show_live(newest)
    assert reads(panel.said.text(), "live.goes_on", problem=sentence(newest.problem))


@pytest.mark.parametrize("theme", [LIGHT, DARK], ids=["light", "dark"])
def test_it_can_be_read_in_both_palettes(panel, theme):
    appearance.use(theme)
    panel.show()
    panel.show_view(seen())
    image = panel.grab().toImage()
    colours = {image.pixelColor(x, y).name() for x in range(0, image.width(), 2) for y in range(0, image.height(), 2)}
    assert theme.measured in colours
    assert theme.model in colours
    for label in panel.findChildren(QLabel):
        if label.isVisible() and not label.wordWrap():
            assert label.sizeHint().width() <= label.width() + 1, label.text()


def test_it_is_there_during_a_test_and_gone_with_an_opened_session(qtbot, open_window, saved):
    gate = Gate(passed=320)
    window = open_window(wait=gate.wait)
    panel = window.ui.analysis
    assert not panel.isVisible()
    window.ui.form.site.setCurrentText("left forearm")
    qtbot.mouseClick(window.ui.start, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(gate.reached.is_set, timeout=WAIT_MS)
    assert panel.isVisible()
    qtbot.waitUntil(lambda: "N/m" in panel.numbers["stiffness"].text, timeout=WAIT_MS)
    gate.opened.set()
    qtbot.waitUntil(lambda: window.findings is not None and not window.jobs, timeout=WAIT_MS)
    identification = window.live.identification
    assert identification.problem == ""
    assert identification.latest().seconds == 4.0
    window.ui.pages.setCurrentIndex(0)
    assert panel.isVisible()
    qtbot.waitUntil(lambda: panel._shown is identification.latest(), timeout=WAIT_MS)
    window.open_session(saved)
    qtbot.waitUntil(lambda: window.findings.path == saved and not window.jobs, timeout=WAIT_MS)
    assert not panel.isVisible()


def test_phase_and_nonlinearity_are_seen_at_1280x740_without_scrolling(qtbot, open_window, saved):
    window = open_window(role="researcher")
    window.resize(1280, 740)
    panel = window.ui.analysis
    panel.show()
    window.open_session(saved)
    qtbot.waitUntil(lambda: window.findings is not None and not window.jobs, timeout=WAIT_MS)
    page = window.ui.result
    measured = page.phase.plots[0].curve("measured")
    assert measured.x.size > 10
    assert -30.0 < measured.y[0] < 10.0
    card = page.nonlinearity
    window.ui.pages.setCurrentWidget(page)

    def bottom():
        return card.mapTo(page.viewport(), card.rect().bottomLeft()).y()

    qtbot.waitUntil(lambda: 0 < bottom() <= page.viewport().height(), timeout=WAIT_MS)
    window.ui.pages.setCurrentIndex(0)
    panel.expect(TestPlan(url="simulated://forearm", site="left forearm", out=saved))
    qtbot.waitUntil(panel.isVisible, timeout=WAIT_MS)
    panel.show_view(seen())
    for card in (panel.plots["curve"], panel.plots["phase"]):
        corner = card.mapTo(window, card.rect().bottomRight())
        assert window.rect().contains(corner), card
        assert not card.visibleRegion().isEmpty()
