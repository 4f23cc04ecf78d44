"""The page of the guided test: the body map, and the contact light."""

import threading

import numpy as np
import pytest
from app.benches import WAIT_MS
from PySide6.QtCore import Qt

from tissueid.acquisition import Phase
from tissueid.acquisition.surface_detection import Contact, contact_of_free
from tissueid.app.form import SITES
from tissueid.app.guidance import contact_in_test
from tissueid.app.live_signals import Safety, Snapshot
from tissueid.app.views.clinician.body_map import HEIGHT, SPOTS, WIDTH, outline
from tissueid.device import DeviceDescription
from tissueid.errors import LinkLostError
from tissueid.instrument import CLINICAL, SAMPLE, SimulatedInstrument
from tissueid.procedures.instruments import ContactWatch, watch_contact
from tissueid.wire import Flag

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]


def press(qtbot, widget):
    qtbot.mouseClick(widget, Qt.MouseButton.LeftButton)


def idle(window):
    return window.jobs.idle and not window.testing


def run_test(qtbot, window, button):
    press(qtbot, button)
    qtbot.waitUntil(lambda: window.testing, timeout=WAIT_MS)
    qtbot.waitUntil(lambda: idle(window) and window.findings is not None, timeout=WAIT_MS)


def seeded(bench):
    """Each test meets other noise, as repeats do."""

    def open_next(url):
        bench.opened.append(SimulatedInstrument("forearm", seed=len(bench.opened)))
        return bench.opened[-1]

    return open_next


# -- the body map ---------------------------------------------------------------------------------------------------


def test_every_standard_site_on_a_body_has_its_point_inside_the_outline():
    assert {spot.site for spot in SPOTS} == set(SITES) - {"material sample"}
    body = outline()
    for spot in SPOTS:
        assert body.contains(_point(spot)), spot.site
        # From the front the subject's left is on the viewer's right.
        if spot.site.startswith("left"):
            assert (spot.x > WIDTH / 2) is (spot.side == "front")
    assert body.boundingRect().bottom() < HEIGHT


def _point(spot):
    from PySide6.QtCore import QPointF

    return QPointF(spot.x, spot.y)


def open_map(qtbot, window):
    press(qtbot, window.ui.form.map)
    chart = window.clinician.body_map
    qtbot.waitUntil(lambda: chart.isVisible() and chart.isActiveWindow(), timeout=WAIT_MS)
    return chart


def test_a_site_is_chosen_on_the_map_by_mouse_and_by_keys(qtbot, window):
    form = window.ui.form
    chart = open_map(qtbot, window)
    assert not chart.use.isEnabled()
    press(qtbot, chart.spots["right calf"])
    press(qtbot, chart.spots["left thigh"])
    assert chart.isVisible()
    assert chart.name.text() == "left thigh"
    assert form.site.currentText() == ""
    press(qtbot, chart.use)
    assert form.site.currentText() == "left thigh"
    open_map(qtbot, window)
    assert chart.site == "left thigh"
    qtbot.keyClick(chart.focusWidget(), Qt.Key.Key_Left)
    assert chart.site == "right thigh"
    assert chart.name.text() == "right thigh"
    qtbot.keyClick(chart.focusWidget(), Qt.Key.Key_Escape)
    assert form.site.currentText() == "left thigh"
    open_map(qtbot, window)
    qtbot.keyClick(chart.focusWidget(), Qt.Key.Key_Up)
    assert chart.site == "abdomen"
    wanted = chart.site
    qtbot.keyClick(chart.focusWidget(), Qt.Key.Key_Return)
    assert form.site.currentText() == wanted
    assert form.focusWidget() is form.subject
    open_map(qtbot, window)
    qtbot.mouseDClick(chart.spots["left calf"], Qt.MouseButton.LeftButton)
    assert not chart.isVisible()
    assert form.site.currentText() == "left calf"
    assert not window.testing


def test_a_site_of_ones_own_leaves_the_map_without_a_choice(qtbot, window):
    window.ui.form.site.setCurrentText("left big toe")
    chart = open_map(qtbot, window)
    assert chart.site == ""
    qtbot.keyClick(chart, Qt.Key.Key_Escape)
    assert window.ui.form.site.currentText() == "left big toe"


# -- the contact light -----------------------------------------------------------------------------------------------


def free(position_m, along=9.81, count=500):
    samples = np.zeros(count, SAMPLE)
    samples["position"] = position_m
    samples["acceleration_x"] = along
    return samples


@pytest.mark.parametrize(
    ("samples", "said"),
    [
        (free(0.010), Contact.ON),
        (free(0.0318), Contact.OFF),
        (free(0.0003), Contact.TOO_FAR),
        (free(np.linspace(0.010, 0.013, 500)), Contact.MOVING),
        (free(0.0003, along=-9.81), Contact.UNTOLD),
        (free(np.nan), Contact.FINDING),
    ],
)
def test_a_free_probe_tells_how_it_stands(samples, said):
    assert contact_of_free(samples, DeviceDescription()) is said


def snapshot(phase, position_m, contact=None):
    time_s = np.arange(600) / 2000.0
    return Snapshot(time_s, 0 * time_s, 0 * time_s + position_m, phase, 0.5, Safety(CLINICAL, contact=contact))


@pytest.mark.parametrize(
    ("seen", "said"),
    [
        (snapshot(None, 0.01), Contact.FINDING),
        (snapshot(Phase.PLACE, 0.010), Contact.ON),
        (snapshot(Phase.PLACE, 0.0319), Contact.OFF),
        (snapshot(Phase.PLACE, 0.0002), Contact.TOO_FAR),
        (snapshot(Phase.STIMULUS, 0.010), Contact.FINDING),
        (snapshot(Phase.STIMULUS, 0.012, True), Contact.ON),
        (snapshot(Phase.STIMULUS, 0.012, False), Contact.OFF),
        (snapshot(Phase.STIMULUS, 0.0314, True), Contact.TOO_DEEP),
        (snapshot(Phase.RELEASE, 0.012, True), Contact.UNWATCHED),
    ],
)
def test_the_light_follows_a_test(seen, said):
    assert contact_in_test(seen, DeviceDescription()) is said


def test_contact_is_watched_before_a_test_and_the_test_takes_over(qtbot, window, bench):
    lamp = window.ui.guidance.lamp
    window.ui.form.fill({"seconds": 1.0})
    window.ui.form.site.setCurrentText("left calf")
    press(qtbot, lamp.watch)
    qtbot.waitUntil(lambda: lamp.contact is Contact.ON, timeout=WAIT_MS)
    assert not window.testing
    assert bench.opened[0].current_run is None
    assert window.ui.safety.contact.text() == Contact.ON.value
    assert lamp.arm.isHidden()  # the simulation has no button
    assert window.ui.start.isEnabled()
    assert not window.ui.open.isEnabled()
    run_test(qtbot, window, window.ui.start)
    assert not window.clinician.watcher.watching
    assert lamp.contact is Contact.UNWATCHED
    assert len(bench.opened) == 2


def test_a_watch_is_ended_by_its_button_by_leaving_the_page_and_by_closing(qtbot, open_window):
    window = open_window()
    lamp = window.ui.guidance.lamp
    press(qtbot, lamp.watch)
    qtbot.waitUntil(lambda: lamp.contact is Contact.ON, timeout=WAIT_MS)
    press(qtbot, lamp.watch)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert not lamp.watch.isChecked()
    press(qtbot, lamp.watch)
    window.pages.show("research" if "research" in window.ui.views else "gap")
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    window.pages.show("measure")
    press(qtbot, lamp.watch)
    window.close()
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=WAIT_MS)


def test_an_instrument_that_is_not_there_cannot_be_watched(qtbot, open_window):
    def opener(url):
        raise LinkLostError("nothing answers")

    window = open_window(opener=opener)
    press(qtbot, window.ui.guidance.lamp.watch)
    qtbot.waitUntil(lambda: idle(window) and window.ui.notice.isVisible(), timeout=WAIT_MS)
    assert "Nothing answers" in window.ui.notice.text.text()
    assert window.ui.guidance.lamp.contact is Contact.UNWATCHED


class Scripted:
    """An instrument whose free probe and button follow a script, one entry a poll: down or not, and where."""

    def __init__(self, script, stop):
        self.device = self.nominal = DeviceDescription()
        self.closed = False
        self._script = list(script)
        self._stop = stop

    def effective_limits(self, limits):
        return limits

    def poll(self, timeout_s):
        if not self._script:
            self._stop.set()
            return np.zeros(0, SAMPLE)
        down, position_m = self._script.pop(0)
        samples = free(position_m, count=600)
        samples["flags"] = Flag.BUTTON if down else 0
        return samples

    def close(self):
        self.closed = True


@pytest.mark.parametrize(
    ("script", "armed", "pressed", "refused"),
    [
        ([(False, 0.01), (True, 0.01), (False, 0.01)], True, True, False),
        ([(False, 0.01), (True, 0.01), (False, 0.01)], False, False, False),
        ([(False, 0.01), (True, 0.01)], True, False, False),
        ([(True, 0.01), (False, 0.01)], True, False, False),
        ([(False, 0.0319), (True, 0.0319), (False, 0.0319)], True, False, True),
    ],
    ids=["pressed", "not armed", "never let go", "down before", "off the skin"],
)
def test_the_button_starts_only_where_the_window_says_so(script, armed, pressed, refused):
    stop, sight = threading.Event(), ContactWatch()
    if armed:
        sight.armed.set()
    instrument = Scripted(script, stop)
    ended = watch_contact("port", sight, stop, lambda _: instrument, lambda _: None)
    assert (ended.pressed, sight.refused, sight.has_button) == (pressed, refused, True)
    assert instrument.closed


def test_the_button_on_the_instrument_starts_a_test(qtbot, open_window, bench):
    go = threading.Event()

    class Held(Scripted):
        def poll(self, timeout_s):
            if not go.is_set():
                go.wait(0.01)
                return free(0.01, count=20)
            return super().poll(timeout_s)

    opened = []

    def opener(url):
        if not opened:
            stop = threading.Event()
            opened.append(Held([(False, 0.01), (True, 0.01), (False, 0.01)], stop))
            return opened[0]
        return bench.open(url)

    window = open_window(opener=opener, calibrate=lambda _: None)
    lamp = window.ui.guidance.lamp
    window.ui.form.fill({"seconds": 1.0})
    window.ui.form.site.setCurrentText("left calf")
    press(qtbot, lamp.watch)
    qtbot.waitUntil(lamp.arm.isVisible, timeout=WAIT_MS)
    assert not lamp.arm.isChecked()
    press(qtbot, lamp.arm)
    assert lamp.arm.isChecked()
    go.set()
    qtbot.waitUntil(lambda: window.testing, timeout=WAIT_MS)
    assert opened[0].closed
    qtbot.waitUntil(lambda: idle(window) and window.findings is not None, timeout=WAIT_MS)
    assert window.findings.test.status == "completed"
