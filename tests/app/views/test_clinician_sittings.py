"""The page of the guided test: repeats, limits of an instrument, comparison and report."""

import dataclasses
import threading
import time

import numpy as np
import pytest
from app.benches import WAIT_MS
from app.views.test_clinician import idle, press, run_test, seeded
from coded import code_of, codes, made, reads, shows

from tissueid.app.views.clinician.comparing import (
    STUDY,
    THIS,
    Shelf,
    Sighting,
    SittingComparison,
    compare_with,
    of_study,
)
from tissueid.app.views.clinician.sitting import Repeat, Sitting, together
from tissueid.instrument import SimulatedInstrument
from tissueid.procedures.study_protocol import PROTOCOL_FILE
from tissueid.procedures.test_plan import TestPlan
from tissueid.records import Estimate
from tissueid.sessions import Subject, read_session, write_session
from tissueid.sessions.accepted_result import AcceptedResult, AcceptedTest, AcceptedValue, write_result

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]


# -- repeats ----------------------------------------------------------------------------------------------------------


def test_repeats_are_counted_and_accepted(qtbot, open_window, bench, tmp_path):
    window = open_window(opener=seeded(bench))
    ui, bar = window.ui, window.ui.gate.repeats
    ui.form.fold.setChecked(True)
    ui.form.fill({"seconds": 1.0})
    ui.form.site.setCurrentText("left calf")
    run_test(qtbot, window, ui.start)
    assert bar.isVisible()
    assert reads(bar.repeat.text(), "sitting.measure_again", number=2, count=5)
    assert reads(bar.accept.text(), "sitting.finish")
    assert ui.result.summary.isHidden()
    run_test(qtbot, window, bar.repeat)
    assert reads(bar.repeat.text(), "sitting.measure_again", number=3, count=5)
    levels = [repeat.findings.verdict.level for repeat in window.clinician.sitting.repeats]
    words = [{"good": "good", "check": "to be looked at"}[level] for level in levels]
    assert bar.dots.accessibleName() == f"2 of 5 repeats: 1 {words[0]}, 2 {words[1]}"
    assert reads(ui.result.summary.heading.text(), "sitting.mean_so_far", count=2)
    tests = [read_session(path).test() for path in sorted(tmp_path.glob("*.h5"))]
    assert len({test.notes["sitting"] for test in tests}) == 1
    assert sorted(test.notes["repeat"] for test in tests) == [1.0, 2.0]
    assert ui.result.summary.cells["mass_kg"][1].text().endswith(" g")
    tile = next(tile for tile in ui.result.tiles if tile.number.quantity == "mass_kg")
    own = tile.number
    press(qtbot, bar.accept)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    mean = window.clinician.sitting.result.values["mass_kg"]
    assert tile.number.estimate == Estimate(mean.mean, mean.std)
    assert reads(tile.note.text(), "result.accepted_mean", count=2)
    assert f"{tile.value.text()} {tile.rest.text()}" == ui.result.summary.cells["mass_kg"][1].text()
    press(qtbot, bar.undo)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert tile.number is own
    press(qtbot, bar.accept)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert bar.repeat.isHidden()
    assert reads(ui.result.summary.heading.text(), "sitting.accepted_mean", count=2)
    assert any(line.what == "sitting.accepted" for line in _logged(window))
    run_test(qtbot, window, ui.start)
    assert bar.dots.accessibleName().startswith("1 of 5")


def _logged(window):
    from types import SimpleNamespace

    path = window.services.audit.path
    return [SimpleNamespace(what=what) for what in ("sitting.accepted",) if what in path.read_text(encoding="utf-8")]


class Holding(SimulatedInstrument):
    """Holds a test in its preload until it is told to go on."""

    reached = threading.Event()
    go = threading.Event()
    polls = 0

    def poll(self, timeout_s):
        self.polls += 1
        if self.polls > 180:
            self.reached.set()
            assert self.go.wait(WAIT_MS / 1000)
        return super().poll(timeout_s)


def test_a_stopped_test_does_not_count_and_another_site_begins_anew(qtbot, open_window):
    window = open_window(opener=lambda _: Holding("forearm", seed=3))
    ui = window.ui
    ui.form.site.setCurrentText("left calf")
    press(qtbot, ui.start)
    qtbot.waitUntil(Holding.reached.is_set, timeout=WAIT_MS)
    press(qtbot, ui.stop)
    Holding.go.set()
    qtbot.waitUntil(lambda: idle(window) and window.findings is not None, timeout=WAIT_MS)
    bar = ui.gate.repeats
    assert bar.dots.accessibleName() == f"{made('sitting.repeats', done=0, count=5)}: 1 not counted"
    assert bar.repeat.isHidden()
    assert bar.accept.isHidden()
    first = window.clinician.sitting
    ui.form.site.setCurrentText("right calf")
    assert not first.continues(ui.form.plan())


def repeat(value, verdict="good", site="left calf"):
    from tissueid.sessions import Test

    test = Test(1, "stochastic", {"time": np.zeros(1)}, 2000.0, site=site)
    return Repeat(test, test, verdict, {"mass_kg": Estimate(value, 0.001)})


def test_mean_deviation_and_repeatability():
    said = together([Estimate(value) for value in (1.0, 2.0, 3.0, float("nan"))])
    assert (said.mean, said.std, said.count) == (2.0, 1.0, 3)
    # √2 times the quantile of Student's t for as many repeats: 4.303 for three.
    assert said.repeatability == pytest.approx(np.sqrt(2.0) * 4.3027 * said.std, rel=1e-4)
    assert together([Estimate(1.0)]) is None
    close = together([Estimate(4491.0, 210.0), Estimate(4492.0, 210.0)])  # two tests that agree by chance
    assert (close.std, close.repeatability) == (pytest.approx(210.0), None)
    assert together([Estimate(1.0, 0.1)] * 2).std == 0.0
    plan = TestPlan(url="u", site="left calf", out="s.h5", lower_force=True)
    sitting = Sitting(plan, repeats=[repeat(0.08), repeat(0.09, "repeat"), repeat(0.10)])
    assert sitting.together["mass_kg"].mean == pytest.approx(0.09)
    assert sitting.counted == 2
    # An instrument that gives less took the usual force down: that is the same test.
    assert sitting.continues(plan.model_copy(update={"max_force_n": 7.8}))
    assert not sitting.continues(plan.model_copy(update={"max_force_n": 7.8, "lower_force": False}))


# -- the instrument's own limits --------------------------------------------------------------------------------------


def handheld(url):
    from dataclasses import replace

    from tissueid.device import HANDHELD
    from tissueid.instrument.limits import PROFILES

    class Handheld(SimulatedInstrument):
        def effective_limits(self, limits):
            return replace(limits, max_force_n=min(limits.max_force_n, 7.8))

    instrument = Handheld("forearm", seed=3)
    assert HANDHELD.greatest_force_n < PROFILES["clinical"].max_force_n
    return instrument


def test_the_usual_force_goes_down_to_what_the_instrument_gives(qtbot, open_window):
    window = open_window(opener=handheld, role="researcher")
    ui = window.ui
    ui.form.fill({"seconds": 1.0})
    ui.form.site.setCurrentText("left calf")
    assert ui.form.options["max_force_n"].value() == 10.5
    run_test(qtbot, window, ui.start)
    assert window.findings.test.stimulus["stimulus"]["force_max_n"] == 7.8
    assert ui.form.options["max_force_n"].value() == 7.8
    assert "0.5 to 7.8 N" in ui.form.summary.text()
    assert window.clinician.sitting.continues(ui.form.plan())
    ui.form.instrument.choice.setEditText("simulated://spring")
    assert ui.form.options["max_force_n"].value() == 10.5


def test_a_force_of_ones_own_is_not_changed(window):
    form = window.ui.form
    form.fill({"max_force_n": 6.0})
    form.tell_force(form.instrument.url, 7.8)
    assert form.options["max_force_n"].value() == 6.0
    assert form.options["max_force_n"].controls[0].maximum() == 7.8
    assert not form.plan().lower_force


# -- comparison and report ------------------------------------------------------------------------------------------


@pytest.fixture
def shelf_of(saved, tmp_path):
    """A folder with sessions of two subjects, and rubbish."""
    session = read_session(saved)
    for number, (name, site) in enumerate([("P-1", "left calf"), ("P-1", "right calf"), ("P-2", "left calf")]):
        test = dataclasses.replace(session.test(), site=site)
        changes = {"subject": Subject(name), "tests": (test,), "created": f"2026-01-0{number + 1}T10:00:00Z"}
        write_session(tmp_path / f"s{number}.h5", dataclasses.replace(session, session_id=f"{number}", **changes))
    (tmp_path / "rubbish.h5").write_bytes(b"rubbish")
    (tmp_path / "folder.h5").mkdir()
    return tmp_path


def compared(folder, name, cancelled=None):
    session = read_session(folder / name)
    return compare_with(folder, session, folder / name, session.test(), Shelf(), cancelled or threading.Event())


def test_a_subject_is_compared_with_its_own_sittings_only(shelf_of):
    found = compared(shelf_of, "s0.h5")
    assert [(one.site, one.this) for one in found.sightings] == [("right calf", False), ("left calf", True)]
    assert codes(found.left_out.values["parts"].items) == ["comparison.file_skipped"]
    assert 0.06 < found.sightings[0].values["mass_kg"].value < 0.1
    stopped = threading.Event()
    stopped.set()
    cut = compared(shelf_of, "s0.h5", stopped)
    assert (cut.sightings, code_of(cut.left_out)) == ((), "comparison.cancelled")


def test_a_result_of_a_study_is_compared_with_the_other_subjects_at_the_site(tmp_path, saved):
    session = read_session(saved)
    study, key = tmp_path / "lotion", "0f8fad5b-d9cb-469f-a165-70867728950{}"
    names = ("P-1", "P-2", "P-3", "P-4", "P-5")
    for number, (name, mass) in enumerate(zip(names, (0.5, 0.07, 0.08, 0.09, 0.3), strict=True)):
        site = "abdomen" if name == "P-5" else "left calf"
        folder = study / name
        folder.mkdir(parents=True)
        test = dataclasses.replace(session.test(), site=site)
        theirs = dataclasses.replace(session, session_id=f"{number}", subject=Subject(name), tests=(test,))
        write_session(folder / "s.h5", theirs)
        first = AcceptedTest(file="s.h5", number=test.number, session_id=f"{number}")
        values = {"mass_kg": AcceptedValue(mean=mass, std=0.001)}
        write_result(folder, AcceptedResult(sitting=key.format(number), tests=(first,), values=values))
    test = read_session(study / "P-1" / "s.h5").test()
    assert of_study(study / "P-1" / "s.h5", test, Shelf(), threading.Event()) is None  # no study: a mere folder
    (study / PROTOCOL_FILE).write_text("{}", encoding="utf-8")
    found = compared(study / "P-1", "s.h5")
    (row,) = [one for one in found.sightings if one.key == STUDY]
    assert (row.values["mass_kg"].value, row.values["mass_kg"].std) == pytest.approx((0.08, 0.01))
    assert row.count == 3
    assert shows(str(found.changes["mass_kg"]), "comparison.study_above", count=3, spread="12")
    assert set(found.changes) == {"mass_kg"}


def test_nobody_is_compared_with_everybody(saved):
    assert compared(saved.parent, saved.name) == SittingComparison()


def test_an_opened_session_is_compared_and_printed(qtbot, open_window, shelf_of):
    shown = []
    window = open_window(show_file=lambda path: shown.append(path) or True)
    window.open_session(shelf_of / "s1.h5")
    qtbot.waitUntil(lambda: idle(window) and window.findings is not None, timeout=WAIT_MS)
    card = window.ui.result.comparison
    assert card.isVisibleTo(window)
    assert f"right calf, {THIS}" in card.accessibleName()
    assert "left calf" in card.accessibleName()
    assert window.ui.gate.repeats.isHidden()
    press(qtbot, window.ui.result.pdf)
    qtbot.waitUntil(lambda: idle(window) and bool(shown), timeout=WAIT_MS)
    assert shown == [shelf_of / "s1-report.pdf"]
    press(qtbot, window.ui.notice.offer)
    assert shown.pop() == shelf_of
    content = shown[0].read_bytes()
    assert content.startswith(b"%PDF")
    assert 1 <= content.count(b"/Type /Page ") + content.count(b"/Type /Page\n") <= 2


def test_a_pdf_that_cannot_be_written_is_said(qtbot, open_window, shelf_of, monkeypatch):
    window = open_window()
    window.open_session(shelf_of / "s1.h5")
    qtbot.waitUntil(lambda: idle(window) and window.findings is not None, timeout=WAIT_MS)

    def full(path, *_, **__):
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr("tissueid.reports.pdf.write_pdf", full)
    press(qtbot, window.ui.result.pdf)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert "s1-report.pdf" in window.ui.notice.text.text()
    assert window.ui.notice.property("level") == "problem"


def test_no_report_is_written_over_another(qtbot, open_window, shelf_of):
    shown = []
    window = open_window(show_file=lambda path: shown.append(path) or True)
    kept = {shelf_of / f"s1-report.{kind}": f"kept {kind}" for kind in ("pdf", "html")}
    for path, content in kept.items():
        path.write_text(content, encoding="utf-8")
    window.open_session(shelf_of / "s1.h5")
    qtbot.waitUntil(lambda: idle(window) and window.findings is not None, timeout=WAIT_MS)
    for button in (window.ui.result.pdf, window.ui.report, window.ui.result.pdf):
        press(qtbot, button)
        qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert [path.name for path in shown] == ["s1-report-2.pdf", "s1-report-2.html", "s1-report-2.pdf"]
    assert {path: path.read_text(encoding="utf-8") for path in kept} == kept


def test_long_and_hostile_sites_are_cut():
    one = Sighting("k", "2026-01-01T00:00:00", "<b>x\x00" + "y" * 90, {}, count=3)
    assert one.label.startswith("2026-01-01  ×3  <b>x\ufffd")
    assert one.label.endswith("…")
    assert len(one.label) < 50


def test_sittings_of_one_day_and_of_other_instruments_are_told_apart(shelf_of, monkeypatch):
    monkeypatch.setenv("TZ", "Europe/Berlin")
    time.tzset()
    session = read_session(shelf_of / "s1.h5")
    other = dataclasses.replace(session.instrument, serial_number="OTHER-1")
    changes = {"created": "2026-01-02T23:30:00Z", "instrument": other, "session_id": "9"}
    write_session(shelf_of / "s9.h5", dataclasses.replace(session, **changes))
    found = compared(shelf_of, "s1.h5")
    assert [one.label for one in found.sightings] == [
        "2026-01-03 00:30†  right calf",
        "2026-01-02 11:00  right calf",
        "2026-01-01 11:00  left calf",
    ]
    assert code_of(found.remark) == "comparison.other_instrument"
    assert compared(shelf_of, "s0.h5").sightings[0].other_instrument
    monkeypatch.undo()
    time.tzset()
