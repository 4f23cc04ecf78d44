"""Finishing a sitting: page, paper, result file and audit log name the same tests and the same values."""

import json

import pytest
from app.benches import WAIT_MS
from app.views.test_clinician import idle, press, run_test
from coded import reads

from tissueid.audit import AuditError
from tissueid.errors import LinkLostError
from tissueid.formatting import label_and_unit, plus_minus
from tissueid.instrument import SimulatedInstrument
from tissueid.procedures.study_sitting import accept_sitting
from tissueid.records import Estimate
from tissueid.reports import pdf
from tissueid.sessions.accepted_result import read_result
from tissueid.sessions.quality import HEADLINES
from tissueid.units import display_unit, shown_si

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]


class Unplugged(SimulatedInstrument):
    """Loses its cable in the middle of the stimulus."""

    polls = 0

    def poll(self, timeout_s):
        self.polls += 1
        if self.polls > 230:
            raise LinkLostError("the instrument does not answer any more")
        return super().poll(timeout_s)


@pytest.fixture
def sitting(qtbot, open_window, bench, monkeypatch):
    """Runs tests of one sitting, those at the places ``broken`` with a cable that comes off, and finishes it."""
    papers = []
    written = pdf.write_pdf

    def write(path, session, test, analyses, **tables):
        papers.append((path, session, test, tables))
        written(path, session, test, analyses, **tables)

    monkeypatch.setattr(pdf, "write_pdf", write)

    def run(count, broken=(), **changes):
        def opener(url):
            kind = Unplugged if len(bench.opened) + 1 in broken else SimulatedInstrument
            bench.opened.append(kind("forearm", seed=len(bench.opened)))
            return bench.opened[-1]

        window = open_window(opener=opener, **changes)
        ui = window.ui
        ui.form.fill({"seconds": 1.0})
        ui.form.site.setCurrentText("left calf")
        ui.form.subject.setText("P-7")
        for _ in range(count):
            run_test(qtbot, window, ui.start)
        return window

    run.papers = papers
    return run


def settle(qtbot, window):
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)


def entries(window, what):
    lines = [json.loads(line) for line in window.services.audit.path.read_text(encoding="utf-8").splitlines()]
    return [line for line in lines if line["what"] == what]


def stored(folder):
    (path,) = folder.glob("sitting-*.json")
    return read_result(path)


def check_agreement(qtbot, window, papers, folder, files):
    """The page, the paper, the result file and the audit log name these files and give the same values."""
    result, summary = stored(folder), window.ui.result.summary
    assert [test.file for test in result.tests] == files
    (entry,) = entries(window, "sitting.accepted")
    assert entry["subject"] == result.sitting
    assert entry["new"]["accepted"] == [test.model_dump() for test in result.tests]
    assert entry["new"]["values"] == {k: v.model_dump(exclude_none=True) for k, v in result.values.items()}
    press(qtbot, window.ui.result.pdf)
    settle(qtbot, window)
    path, session, test, tables = papers[-1]
    assert (session.session_id, test.number) in {(item.session_id, item.number) for item in result.tests}
    assert window.findings.path.name in files
    (heading, _heads, rows), below = tables["result"]
    assert summary.heading.text() == heading
    assert below[0] == f"Tests: {', '.join(files)}"
    assert below[0] in summary.about.text()
    by_name = {row[0]: row[1] for row in rows}
    assert set(result.values) == {"mass_kg", "damping_n_s_per_m", "stiffness_n_per_m"}
    for quantity, value in result.values.items():
        name, si_unit = label_and_unit(quantity)
        for shown, unit_for in ((by_name[name], display_unit), (summary.cells[quantity][1].text(), shown_si)):
            unit, scale = unit_for(si_unit)
            assert shown == f"{plus_minus(Estimate(value.mean, value.std), scale)} {unit}"
    assert session.session_id.encode() in path.read_bytes()  # the shell knows by it whose report it is


def test_the_good_test_is_accepted_shown_and_printed_after_a_broken_repeat(qtbot, sitting, tmp_path):
    window = sitting(2, broken=(2,))
    ui, bar = window.ui, window.ui.gate.repeats
    files = [repeat.path.name for repeat in window.clinician.sitting.repeats]
    assert window.findings.path.name == files[1]
    assert window.findings.test.status == "aborted"
    assert (ui.gate.headline.text(), ui.gate.property("level")) == (HEADLINES["repeat"], "poor")
    good = window.clinician.sitting.repeats[0].findings.verdict
    word = {"good": "good", "check": "to be looked at"}[good.level]
    assert bar.dots.accessibleName() == f"1 of 5 repeats: 1 {word}, 2 not counted"
    assert reads(bar.accept.text(), "sitting.finish_test", place=1)
    press(qtbot, bar.accept)
    settle(qtbot, window)
    assert window.findings.path.name == files[0]
    assert (ui.gate.headline.text(), ui.gate.property("level")) == (good.headline, good.level)
    assert reads(ui.result.summary.heading.text(), "sitting.accepted_this")
    assert reads(ui.notice.text.text(), "sitting.finished_test", place=1)
    check_agreement(qtbot, window, sitting.papers, tmp_path, files[:1])
    numbers = {number.label: number.estimate for number in window.findings.numbers if number.estimate is not None}
    assert numbers["Mass"].value == stored(tmp_path).values["mass_kg"].mean
    assert numbers["Mass"].std == stored(tmp_path).values["mass_kg"].std


def test_the_mean_is_accepted_printed_stored_and_read_back(qtbot, sitting, tmp_path):
    window = sitting(4, broken=(3,))
    bar = window.ui.gate.repeats
    files = [repeat.path.name for repeat in window.clinician.sitting.repeats]
    counted = [files[0], files[1], files[3]]
    assert reads(bar.accept.text(), "sitting.finish_tests", places="1, 2, 4")
    press(qtbot, bar.accept)
    settle(qtbot, window)
    assert reads(window.ui.result.summary.heading.text(), "sitting.accepted_mean", count=3)
    check_agreement(qtbot, window, sitting.papers, tmp_path, counted)
    said = window.ui.result.summary.accessibleName()
    window.close()
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=WAIT_MS)
    for name, belongs in ((files[0], True), (files[2], False)):
        again = sitting(0)
        again.open_session(tmp_path / name)
        qtbot.waitUntil(lambda again=again: idle(again) and again.findings is not None, timeout=WAIT_MS)
        shown = again.ui.result.summary.accessibleName()
        assert shown.startswith(said)
        assert ("does not belong" in shown) is not belongs
        press(qtbot, again.ui.result.pdf)
        settle(qtbot, again)
        (heading, _, rows), _ = sitting.papers[-1][3]["result"]
        assert reads(heading, "sitting.accepted_mean", count=3)
        assert list(map(tuple, rows)) == list(again.clinician.standing.rows().values())
    reports = sorted(path.name for path in tmp_path.glob("*.pdf"))
    assert len(reports) == 3
    assert len({path for path, *_ in sitting.papers}) == 3


def test_finish_can_be_undone_until_the_next_test(qtbot, sitting, tmp_path):
    window = sitting(1)
    bar = window.ui.gate.repeats
    press(qtbot, bar.accept)
    settle(qtbot, window)
    assert (bar.accept.isHidden(), bar.repeat.isHidden(), bar.undo.isHidden()) == (True, True, False)
    accepted = stored(tmp_path)
    press(qtbot, bar.undo)
    settle(qtbot, window)
    assert list(tmp_path.glob("sitting-*")) == []
    (entry,) = entries(window, "sitting.reopened")
    assert entry["subject"] == accepted.sitting
    assert entry["old"]["accepted"] == [test.model_dump() for test in accepted.tests]
    assert (bar.accept.isHidden(), bar.repeat.isHidden(), bar.undo.isHidden()) == (False, False, True)
    assert window.ui.result.summary.isHidden()
    run_test(qtbot, window, bar.repeat)
    assert bar.accept.text() == "Finish: mean of 2"
    assert {repeat.test.notes["sitting"] for repeat in window.clinician.sitting.repeats} == {accepted.sitting}
    press(qtbot, bar.accept)
    settle(qtbot, window)
    run_test(qtbot, window, window.ui.start)
    assert bar.undo.isHidden()
    assert stored(tmp_path).count == 2


def test_a_sitting_that_is_opened_again_has_all_its_tests_and_can_be_finished(qtbot, sitting, tmp_path):
    window = sitting(3, broken=(2,))
    files = [repeat.path.name for repeat in window.clinician.sitting.repeats]
    mean = window.clinician.sitting.values["mass_kg"]
    window.close()
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=WAIT_MS)
    again = sitting(0)
    again.open_session(tmp_path / files[2])
    qtbot.waitUntil(lambda: idle(again) and again.findings is not None, timeout=WAIT_MS)
    bar, result = again.ui.gate.repeats, again.ui.result
    assert reads(result.summary.heading.text(), "sitting.mean_so_far", count=2)
    assert result.test.count() == 3
    assert reads(bar.accept.text(), "sitting.finish_tests", places="1, 3")
    assert not bar.offers_repeat  # the next test begins another sitting
    result.test.setCurrentIndex(1)
    result.test.activated.emit(1)
    assert again.findings.path.name == files[1]
    assert not bar.isHidden()
    settle(qtbot, again)
    press(qtbot, bar.accept)
    settle(qtbot, again)
    assert stored(tmp_path).values["mass_kg"] == mean
    check_agreement(qtbot, again, sitting.papers, tmp_path, [files[0], files[2]])


def test_only_the_subject_and_site_that_are_shown_are_tested_again(qtbot, sitting, saved, bench):
    window = sitting(1)
    ui, opened = window.ui, len(bench.opened)
    assert ui.gate.repeats.offers_repeat
    ui.form.subject.setText("P-8")
    assert not ui.gate.repeats.offers_repeat
    window.clinician.test_wanted.emit()
    ui.form.subject.setText("P-7")
    assert ui.gate.repeats.offers_repeat
    window.open_session(saved)
    qtbot.waitUntil(lambda: idle(window) and window.findings.path == saved, timeout=WAIT_MS)
    ui.gate.show_quality(None, can_repeat=window._repeats_shown)
    ui.gate.again.emit()
    assert ui.gate.run_again.isHidden()
    assert len(bench.opened) == opened
    assert not window.testing


def test_a_result_that_cannot_be_stored_is_not_accepted(qtbot, sitting, tmp_path, monkeypatch):
    window = sitting(1)

    def full(folder, result):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tissueid.sessions.accepted_result.write_result", full)
    press(qtbot, window.ui.gate.repeats.accept)
    settle(qtbot, window)
    assert not window.clinician.sitting.accepted
    assert window.ui.notice.property("level") == "problem"
    assert len(entries(window, "sitting.accepted")) == len(entries(window, "sitting.reopened")) == 1
    assert not window.ui.gate.repeats.accept.isHidden()


def test_a_result_that_cannot_be_logged_is_not_stored(qtbot, sitting, tmp_path):
    window = sitting(1)

    class Full:
        def record(self, *_, **__):
            raise AuditError("the disk is full")

    kept = window.clinician.sitting
    with pytest.raises(AuditError):
        accept_sitting(kept.acceptance, kept.as_result(), Full())
    assert list(tmp_path.glob("sitting-*")) == []


def test_a_damaged_result_file_is_said_and_costs_nothing_else(qtbot, sitting, tmp_path):
    window = sitting(1)
    press(qtbot, window.ui.gate.repeats.accept)
    settle(qtbot, window)
    path = window.findings.path
    (file,) = tmp_path.glob("sitting-*.json")
    file.write_text("{", encoding="utf-8")
    window.close()
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=WAIT_MS)
    again = sitting(0)
    again.open_session(path)
    qtbot.waitUntil(lambda: idle(again) and again.findings is not None, timeout=WAIT_MS)
    assert again.ui.result.summary.isHidden()
    assert file.name in again.ui.result.reasons.text()
    assert again.findings.numbers
