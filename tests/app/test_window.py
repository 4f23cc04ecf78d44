"""The main window as people use it: keyboard and mouse in, files, words and a free coil out."""

import dataclasses
import threading
from datetime import datetime

import numpy as np
import pytest
from app.benches import WAIT_MS, Gate, found
from coded import begins, codes, message, reads, shows
from PySide6.QtCore import Qt
from support import connect

from tissueid.acquisition import SessionRecorder, journal_path
from tissueid.app import words as app_words
from tissueid.app.device_search import Survey
from tissueid.app.quality_gate import UNJUDGED
from tissueid.app.words import RESEARCH_USE
from tissueid.instrument import FoundInstrument, Run, SimulatedInstrument
from tissueid.sessions import read_session, write_session
from tissueid.sessions.quality import HEADLINES, NOTE, quality_of
from tissueid.wire import Flag

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]


def press(qtbot, widget):
    qtbot.mouseClick(widget, Qt.MouseButton.LeftButton)


def type_site(qtbot, window, site="left forearm"):
    window.ui.form.site.setFocus()
    qtbot.keyClicks(window.ui.form.site, site)


def idle(window):
    return window.jobs.idle and not window.testing


def wait_for_result(qtbot, window):
    qtbot.waitUntil(lambda: idle(window) and window.findings is not None, timeout=WAIT_MS)


def only_session(folder):
    (path,) = folder.glob("*.h5")
    return path, read_session(path)


def test_the_whole_path_by_keyboard(qtbot, window, tmp_path):
    ui = window.ui
    type_site(qtbot, window)
    qtbot.keyClick(ui.form.site, Qt.Key.Key_Return)
    assert ui.form.subject.hasFocus()
    assert not window.testing
    qtbot.keyClick(ui.form.subject, Qt.Key.Key_S, Qt.KeyboardModifier.AltModifier)
    qtbot.waitUntil(lambda: window.testing, timeout=WAIT_MS)
    assert ui.stop.hasFocus()
    wait_for_result(qtbot, window)
    path, session = only_session(tmp_path)
    test = session.test()
    assert (test.status, test.samples, test.site, session.subject.pseudonym) == (
        "completed",
        9000,
        "left forearm",
        "anonymous",
    )
    assert not journal_path(path).exists()
    assert ui.pages.currentWidget() is ui.result
    assert ui.gate.headline.text() == "Good test"
    assert "no sample lost" in ui.result.facts.text()
    numbers = {number.label: number for number in window.findings.numbers}
    assert 70 < float(numbers["Mass"].value) < 95
    assert numbers["Mass"].unit.startswith("± ")
    assert numbers["Mass"].unit.endswith(" g")
    assert numbers["Stiffness"].unit.endswith(" N/m")
    assert float(numbers["Motion explained, nonlinear"].value) > 95
    assert path.name in ui.guidance.instruction.text()
    assert not ui.notice.isVisible()
    # A hand that still hammers on Return when the test is over must not begin the next one.
    for _ in range(3):
        qtbot.keyClick(window.focusWidget(), Qt.Key.Key_Return)
    assert idle(window)
    qtbot.keyClick(window, Qt.Key.Key_S, Qt.KeyboardModifier.AltModifier)
    qtbot.waitUntil(lambda: window.testing, timeout=WAIT_MS)
    wait_for_result(qtbot, window)
    assert len(list(tmp_path.glob("*.h5"))) == 2


def test_the_whole_path_by_mouse(qtbot, open_window, tmp_path):
    shown = []
    window = open_window(show_file=lambda path: shown.append(path) or False)
    ui = window.ui
    ui.form.site.setCurrentText("material sample")
    press(qtbot, ui.form.fold)
    assert ui.form.options["seconds"].isVisible()
    ui.form.fill({"seconds": 1.0})
    ui.form.fill({"distribution": "uniform"})
    assert reads(ui.form.summary.text(), "form.noise", distribution="Uniform", low=0.5, high=10.5, seconds=1.0, seed=1)
    ui.form.subject.setText("P-017")
    press(qtbot, ui.start)
    wait_for_result(qtbot, window)
    path, session = only_session(tmp_path)
    assert session.subject.pseudonym == "P-017"
    assert session.test().samples == 3000
    assert session.test().stimulus["stimulus"]["distribution"] == "uniform"
    press(qtbot, ui.report)
    qtbot.waitUntil(lambda: bool(shown), timeout=WAIT_MS)
    assert shown == [path.with_name(f"{path.stem}-report.html")]
    assert "Research use only" in shown[0].read_text(encoding="utf-8")
    assert reads(ui.notice.text.text(), "report.no_browser", path=shown[0])
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    press(qtbot, ui.report)  # once written it is only shown again
    assert len(shown) == 2
    assert idle(window)
    assert RESEARCH_USE in [label.text() for label in window.findChildren(type(ui.notice.text))]


@pytest.mark.parametrize("how", ["button", "escape", "space"])
def test_stop_in_mid_test_keeps_the_recorded_part(qtbot, open_window, bench, tmp_path, how):
    gate = Gate(passed=300)
    window = open_window(wait=gate.wait)
    type_site(qtbot, window)
    press(qtbot, window.ui.start)
    qtbot.waitUntil(gate.reached.is_set, timeout=WAIT_MS)
    qtbot.waitUntil(lambda: "Measuring" in window.ui.guidance.instruction.text(), timeout=WAIT_MS)
    assert window.ui.stop.isEnabled()
    assert not window.ui.start.isEnabled()
    assert not window.ui.form.isEnabled()
    if how == "button":
        press(qtbot, window.ui.stop)
    else:
        key = Qt.Key.Key_Escape if how == "escape" else Qt.Key.Key_Space
        qtbot.keyClick(window.focusWidget(), key)
    gate.opened.set()
    wait_for_result(qtbot, window)
    path, session = only_session(tmp_path)
    assert session.test().status == "aborted"
    assert 3000 < session.test().samples < 5000
    assert bench.opened[0].current_run is None
    assert "Stopped" in window.ui.notice.text.text()
    assert str(path) in window.ui.notice.text.text()
    gate, result = window.ui.gate, window.ui.result
    findings = [finding.message for finding in window.findings.quality.findings]
    assert codes(findings).count("quality.ended_early") == 1
    said = " ".join([gate.headline.text(), *gate.texts, result.reasons.text(), result.facts.text()])
    # Once on the page, under one red light, with one button.
    assert said.count(message(findings, "quality.ended_early")) == 1
    assert "ended early" not in said.lower()
    assert (gate.headline.text(), gate.light.property("level")) == (HEADLINES["repeat"], "poor")
    assert (gate.run_again.isVisible(), gate.repeats.repeat.isVisible()) == (True, False)


def test_stop_while_the_probe_is_placed_leaves_no_file(qtbot, open_window, bench, tmp_path):
    gate = Gate(passed=20)
    window = open_window(wait=gate.wait)
    type_site(qtbot, window)
    press(qtbot, window.ui.start)
    qtbot.waitUntil(gate.reached.is_set, timeout=WAIT_MS)
    press(qtbot, window.ui.stop)
    gate.opened.set()
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert shows(window.ui.notice.text.text(), "outcome.nothing_yet")
    assert list(tmp_path.iterdir()) == []
    assert bench.opened[0].current_run is None


def test_stop_without_a_test_says_so(qtbot, window):
    press(qtbot, window.ui.stop)
    assert reads(window.ui.notice.text.text(), "stop.no_test")
    press(qtbot, window.ui.notice.dismiss)
    assert not window.ui.notice.isVisible()


def test_an_instrument_that_disappears_gives_words_and_leaves_the_window_alive(qtbot, open_window, tmp_path):
    links = []

    def opener(url):
        if url.startswith("simulated"):
            return SimulatedInstrument("forearm")
        instrument = connect()
        link = instrument.link
        links.append(link)

        def unplug_later(data):
            link.plugged = link.now < 4.0
            return data

        link.to_host = unplug_later
        return instrument

    window = open_window(opener=opener)
    type_site(qtbot, window)
    chooser = window.ui.form.instrument
    press(qtbot, chooser.refresh)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert "instrument" in window.ui.notice.text.text()
    chooser.choice.setEditText("/dev/ttyACM7")
    assert chooser.about.text().startswith("Ready")
    press(qtbot, window.ui.start)
    wait_for_result(qtbot, window)
    assert not chooser.about.text().startswith("Ready")
    assert shows(window.ui.notice.text.text(), "link.broken", port="loopback")
    released = "own watchdog releases the coil within 0.5 s"
    assert window.ui.notice.text.text().count(released) == 1
    assert released in window.ui.safety.keys.text()  # nothing is known of the coil but that
    assert "free" not in window.ui.safety.keys.text()
    path, session = only_session(tmp_path)
    assert f"saved in {path}" in window.ui.notice.text.text()
    assert session.test().status == "aborted"
    assert session.test().samples > 2000
    assert links[0].closed
    links[0].run_for(1.0)
    assert not links[0].firmware.energised
    window.ui.form.instrument.choice.setEditText("simulated://forearm")
    window.ui.form.fill({"seconds": 1.0})
    press(qtbot, window.ui.start)
    wait_for_result(qtbot, window)
    assert window.findings.test.status == "completed"


def test_closing_in_mid_test_releases_and_keeps(qtbot, open_window, bench, tmp_path):
    gate = Gate(passed=300)
    window = open_window(wait=gate.wait)
    type_site(qtbot, window)
    press(qtbot, window.ui.start)
    qtbot.waitUntil(gate.reached.is_set, timeout=WAIT_MS)
    assert not window.close()
    assert window.isVisible()
    assert "coil" in window.ui.guidance.instruction.text()
    gate.opened.set()
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=WAIT_MS)
    assert only_session(tmp_path)[1].test().status == "aborted"
    assert bench.opened[0].current_run is None
    assert not list(tmp_path.glob("*.journal"))


def test_a_rubbish_session_gives_words_and_keeps_what_is_shown(qtbot, window, tmp_path, saved):
    window.open_session(saved)
    wait_for_result(qtbot, window)
    rubbish = tmp_path / "rubbish.h5"
    rubbish.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(range(256)) * 20)
    window.open_session(rubbish)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert "rubbish.h5" in window.ui.notice.text.text()
    assert window.findings.path == saved
    assert saved.name in window.ui.guidance.instruction.text()


def test_a_test_too_short_to_identify_is_shown_without_numbers(qtbot, window, tmp_path, saved):
    session = read_session(saved)
    first = session.tests[0]
    signals = {name: values[:1050] for name, values in first.signals.items() if name != "time"}
    short = dataclasses.replace(first, signals=signals, status="aborted")
    path = tmp_path / "short.h5"
    write_session(path, dataclasses.replace(session, tests=(short,)))
    window.open_session(path)
    wait_for_result(qtbot, window)
    assert window.ui.gate.headline.text() == HEADLINES["repeat"]
    assert window.findings.numbers == ()
    assert window.findings.plots.impulse.missing.code == "report.no_impulse_response"
    assert not window.ui.result.impulse.axes


def test_another_test_of_a_session_can_be_chosen(qtbot, window, tmp_path, saved):
    session = read_session(saved)
    second = dataclasses.replace(session.tests[0], number=2, repeat_of=1)
    path = tmp_path / "two.h5"
    write_session(path, dataclasses.replace(session, tests=(session.tests[0], second)))
    window.open_session(path)
    wait_for_result(qtbot, window)
    assert window.ui.result.test.isVisible()
    window.ui.result.test.setFocus()
    qtbot.keyClick(window.ui.result.test, Qt.Key.Key_Down)
    qtbot.waitUntil(lambda: idle(window) and window.findings.test.number == 2, timeout=WAIT_MS)


def test_hostile_text_neither_widens_the_window_nor_becomes_markup(qtbot, window, tmp_path, saved):
    session = read_session(saved)
    hostile = dict(site="<b>" + "x" * 5000 + "\n" * 50, kind="k" * 500, notes={"reason": "r" * 5000}, status="aborted")
    tests = tuple(dataclasses.replace(session.tests[0], number=number, **hostile) for number in (1, 2))
    path = tmp_path / "hostile.h5"
    write_session(path, dataclasses.replace(session, tests=tests))
    window.open_session(path)
    wait_for_result(qtbot, window)
    assert window.ui.guidance.instruction.text().startswith("<b>xxx")
    assert window.ui.guidance.instruction.textFormat() is Qt.TextFormat.PlainText
    assert window.minimumSizeHint().width() <= 1000
    assert window.ui.result.widget().minimumSizeHint().width() <= 900


def leave_journal(folder, instrument):
    recorder = SessionRecorder(folder / "lost.h5", instrument.device)
    recorder.begin_test(Run(0, 4000), kind="stochastic", site="thigh", sample_rate_hz=2000.0)
    for _ in range(50):
        samples = instrument.poll(0.0)
        samples["flags"] = Flag.PLAYING
        recorder.add(samples)
    return recorder


def test_an_unfinished_test_is_offered_and_recovered(qtbot, open_window, tmp_path):
    leave_journal(tmp_path, SimulatedInstrument()).abandon()
    window = open_window()
    assert "lost.h5" in window.ui.notice.text.text()
    press(qtbot, window.ui.notice.offer)
    wait_for_result(qtbot, window)
    assert "Recovered" in window.ui.notice.text.text()
    assert window.findings.test.status == "recovered"
    assert "ended_early" in {finding.code for finding in window.findings.quality.findings}
    assert (window.ui.gate.headline.text(), window.ui.gate.property("level")) == (HEADLINES["repeat"], "poor")
    assert quality_of(read_session(tmp_path / "lost.h5").test()) == window.findings.quality
    assert window.ui.gate.judge_now.isHidden()
    assert not (tmp_path / "lost.h5.journal").exists()


def test_a_stored_test_that_was_never_judged_is_judged_by_a_button(qtbot, window, tmp_path, saved):
    session = read_session(saved)
    first = session.tests[0]
    notes = {name: value for name, value in first.notes.items() if name != NOTE}
    path = tmp_path / "old.h5"
    write_session(path, dataclasses.replace(session, tests=(dataclasses.replace(first, notes=notes),)))
    before = path.read_bytes()
    window.open_session(path)
    wait_for_result(qtbot, window)
    gate = window.ui.gate
    assert gate.texts == (UNJUDGED,)
    assert "'" not in UNJUDGED
    press(qtbot, gate.judge_now)
    qtbot.waitUntil(lambda: idle(window) and window.findings.quality is not None, timeout=WAIT_MS)
    assert gate.judge_now.isHidden()
    assert window.findings.quality == quality_of(first)
    assert path.read_bytes() == before


def test_an_emptied_place_to_save_is_named_by_date_again(qtbot, window, tmp_path):
    field = window.ui.form.path
    field.selectAll()
    qtbot.keyClick(field, Qt.Key.Key_Backspace)
    assert window.ui.form.plan().out.parent == tmp_path
    assert window.ui.form.plan().out.suffix == ".h5"
    field.selectAll()
    qtbot.keyClick(field, Qt.Key.Key_Backspace)
    field.editingFinished.emit()
    assert field.text() == str(window.ui.form.plan().out)


def test_an_empty_journal_gives_words(qtbot, open_window, tmp_path):
    SessionRecorder(tmp_path / "lost.h5", SimulatedInstrument().device).abandon()
    window = open_window()
    press(qtbot, window.ui.notice.offer)
    qtbot.waitUntil(lambda: idle(window) and "no sample" in window.ui.notice.text.text(), timeout=WAIT_MS)


def test_a_test_that_still_runs_is_not_offered(open_window, tmp_path):
    recorder = leave_journal(tmp_path, SimulatedInstrument())
    assert not open_window().ui.notice.isVisible()
    recorder.abandon()


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda form: form.site.setEditText(""), "fill in the site"),
        (lambda form: form.instrument.choice.setEditText(" "), "choose an instrument"),
        (lambda form: form.instrument.choice.setEditText("simulated://moon"), "no simulated tissue"),
        (lambda form: form.fill({"min_force_n": 11.0}), "must be below the highest"),
        (lambda form: _save_to(form, form.folder / "there.h5"), "never overwritten"),
        (lambda form: _save_to(form, form.folder / "nowhere" / "s.h5"), "no folder"),
    ],
)
def test_what_cannot_be_is_refused_in_words(qtbot, open_window, tmp_path, spoil, words):
    from tissueid.instrument import open_instrument

    (tmp_path / "there.h5").write_bytes(b"")
    window = open_window(opener=open_instrument)
    type_site(qtbot, window)
    spoil(window.ui.form)
    press(qtbot, window.ui.start)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert words in window.ui.notice.text.text()[:1].lower() + window.ui.notice.text.text()[1:]
    assert window.ui.start.isEnabled()
    assert [path.name for path in tmp_path.iterdir()] == ["there.h5"]


def _save_to(form, path):
    form.path.setText(str(path))
    form.take_own_path()


def test_a_path_of_ones_own_is_used_once(qtbot, window, tmp_path):
    type_site(qtbot, window)
    window.ui.form.fill({"seconds": 1.0})
    window.ui.form.path.setFocus()
    window.ui.form.path.selectAll()
    qtbot.keyClicks(window.ui.form.path, str(tmp_path / "mine.h5"))
    press(qtbot, window.ui.start)
    wait_for_result(qtbot, window)
    assert (tmp_path / "mine.h5").exists()
    assert window.ui.form.path.text() != str(tmp_path / "mine.h5")


def test_asking_the_ports_happens_in_another_thread(qtbot, open_window):
    asked = []

    def finder(*, probe, opener=None):
        asked.append((probe, threading.get_ident()))
        return found(probe=probe)

    window = open_window(finder=finder)
    chooser = window.ui.form.instrument
    assert chooser.url == "simulated://forearm"
    chooser.choice.setEditText("socket://localhost:1234")
    assert "Typed address" in chooser.about.text()
    press(qtbot, chooser.refresh)
    assert not window.ui.start.isEnabled()
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert [probe for probe, _ in asked] == [False, True]
    assert asked[0][1] == threading.get_ident() != asked[1][1]
    assert chooser.url == "socket://localhost:1234"
    chooser.choice.setCurrentText("/dev/ttyACM7")
    assert reads(chooser.about.text(), "instruments.ready", what="desktop indenter, TEST-7")


def test_the_list_of_instruments_shows_names_and_accepted_twins(qtbot, open_window, tmp_path):
    known = FoundInstrument("/dev/ttyACM7", "n/a", None, name="serial port")
    window = open_window(finder=lambda **_: [known, *found(probe=False)[1:]])
    chooser = window.ui.form.instrument
    shown = [chooser.choice.itemData(place, Qt.ItemDataRole.AccessibleTextRole) for place in range(2)]
    assert shown == ["serial port: /dev/ttyACM7", "simulation in this process: simulated://forearm"]
    chooser.choice.setCurrentText("/dev/ttyACM7")
    assert chooser.url == "/dev/ttyACM7"
    assert reads(chooser.about.text(), "instruments.not_asked", what="serial port")
    (tmp_path / "settings.toml").write_text("name = 'no twin'")
    (tmp_path / "my twin.toml").write_text("format = 'tissueid-twin'\nname = 'bench'\nversion = 2\n")
    window.pages.show("start")
    window.pages.show("measure")
    url = f"simulated://{tmp_path}/my%20twin.toml"
    assert chooser.choice.itemText(chooser.choice.count() - 1) == url
    assert chooser.url == "/dev/ttyACM7"
    chooser.choose(url)
    assert reads(chooser.about.text(), "instruments.ready", what="twin bench, version 2")
    (tmp_path / "my twin.toml").unlink()
    chooser.choose("simulated://forearm")
    window.pages.show("measure")
    assert url not in chooser.states


def test_finding_says_which_instrument_answers():
    ready = [FoundInstrument(f"/dev/{name}", "serial port", True, name=f"indenter, {name}") for name in ("A1", "B2")]
    simulated = FoundInstrument("simulated://spring", "simulation in this process", True, name="simulation, spring")
    assert begins(Survey([ready[0], simulated]).summary, "instruments.one_answers", names="indenter, A1")
    assert begins(
        Survey([*ready, simulated]).summary, "instruments.answer", count=2, names="indenter, A1; indenter, B2"
    )
    assert begins(Survey([simulated]).summary, "instruments.none_answers")


def test_a_system_that_cannot_list_its_ports_still_has_typed_addresses(qtbot, open_window):
    def finder(*, probe, opener=None):
        raise PermissionError(13, "Permission denied", "/sys/class/tty")

    window = open_window(finder=finder)
    assert "Permission denied" in window.ui.notice.text.text()
    press(qtbot, window.ui.form.instrument.refresh)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert window.ui.form.instrument.url == "simulated://forearm"
    window.ui.form.fill({"seconds": 1.0})
    type_site(qtbot, window)
    press(qtbot, window.ui.start)
    wait_for_result(qtbot, window)


def test_a_defect_is_words_and_a_file(qtbot, open_window, tmp_path, monkeypatch):
    monkeypatch.setattr(app_words, "user_log_path", lambda *_, **__: tmp_path)
    window = open_window(opener=lambda url: 1 / 0)
    type_site(qtbot, window)
    press(qtbot, window.ui.start)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert reads(window.ui.notice.text.text(), "window.defect", path=tmp_path / "last-defect.txt")
    assert "ZeroDivisionError" in (tmp_path / "last-defect.txt").read_text(encoding="utf-8")


def test_live_plots_show_the_running_test(qtbot, open_window):
    gate = Gate(passed=300)
    window = open_window(wait=gate.wait)
    type_site(qtbot, window)
    press(qtbot, window.ui.start)
    qtbot.waitUntil(gate.reached.is_set, timeout=WAIT_MS)
    curve = window.ui.signals.curves["force"]
    qtbot.waitUntil(lambda: curve.getData()[0] is not None and curve.getData()[0].max() > 1.5, timeout=WAIT_MS)
    time_s, force_n = curve.getData()
    width = window.ui.signals.force.plot.getViewBox().width()
    assert time_s.size <= 2 * width + 2
    assert time_s.min() == pytest.approx(-1.2, abs=0.01)
    assert np.nanmax(force_n) > 8.0
    voltage_v = window.ui.signals.curves["voltage"].getData()[1]
    assert 10.0 < np.nanmax(voltage_v) < 60.0
    assert window.ui.guidance.phase.value == "stimulus"
    press(qtbot, window.ui.stop)
    gate.opened.set()
    wait_for_result(qtbot, window)


def test_a_name_that_other_programs_take_at_the_start_gives_way_to_the_next_unused_name(
    qtbot, open_window, bench, tmp_path
):
    named = tmp_path / "2026-01-02_03-04-05.h5"

    def open_late(url):
        journal_path(named).touch()
        named.with_stem(f"{named.stem}_2").touch()
        return bench.open(url)

    window = open_window(opener=open_late, now=lambda: datetime(2026, 1, 2, 3, 4, 5))
    type_site(qtbot, window)
    press(qtbot, window.ui.start)
    wait_for_result(qtbot, window)
    assert window.findings.path == named.with_stem(f"{named.stem}_3")
    assert not window.ui.notice.isVisible()
    assert not window.ui.form.other_test.isVisible()
    assert journal_path(named).read_bytes() == b""
