"""A sitting of a study leads the page of the guided test; it starts no test by itself."""

import json

import pytest
from app.benches import WAIT_MS
from app.views.test_clinician import idle, press, run_test, seeded
from coded import shows
from PySide6.QtCore import Qt

from tissueid.procedures.study_plans import SUBJECTS_FILE
from tissueid.procedures.study_protocol import PROTOCOL_FILE
from tissueid.procedures.study_sitting import open_sitting
from tissueid.procedures.study_subjects import read_demographics
from tissueid.sessions import read_session
from tissueid.sessions.accepted_result import read_result, result_of

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]

LOTION = {"product": "lotion", "minutes_since_application": 60.0}
PROTOCOL = {
    "name": "Lotion",
    "sites": ["left calf", "abdomen"],
    "repeats": 1,
    "seconds": 1.0,
    "demographics": [],
    "conditions": [{}, LOTION],
}


@pytest.fixture
def study(tmp_path):
    folder = tmp_path / "study"
    folder.mkdir()

    def write(**changes):
        (folder / PROTOCOL_FILE).write_text(json.dumps(PROTOCOL | changes))
        return folder

    return write


def begin(qtbot, window, folder, subject="P01"):
    window.context.begin_sitting(folder, subject)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)


def test_the_window_leads_through_a_sitting(qtbot, open_window, bench, study):
    window = open_window(opener=seeded(bench))
    folder, ui, card = study(), window.ui, window.ui.study_card
    assert card.isHidden()
    begin(qtbot, window, folder)
    assert card.isVisible()
    assert card.progress_text.text() == "1 of 4"
    assert (ui.form.site.currentText(), ui.form.subject.text()) == ("left calf", "P01")
    assert card.map.next_site == "left calf"
    assert not window.testing
    run_test(qtbot, window, ui.start)
    assert card.progress_text.text() == "2 of 4"
    assert ui.form.site.currentText() == "abdomen"
    assert card.map.finished == {"left calf"}
    assert not ui.gate.repeats.offers_repeat
    assert ui.gate.run_again.isHidden()
    (path,) = (folder / "P01").glob("*.h5")
    assert read_session(path).subject.pseudonym == "P01"
    assert open_sitting(folder, "P01").step == window.study.state.step
    press(qtbot, card.leave)
    assert card.isHidden()
    assert ui.form.folder == window.services.folder
    assert ui.form.subject.text() == ""
    begin(qtbot, window, folder)
    assert card.progress_text.text() == "2 of 4"


def test_a_change_of_site_is_announced_and_repeats_are_those_of_the_protocol(qtbot, open_window, bench, study):
    window = open_window(opener=seeded(bench))
    folder, ui = study(repeats=2, conditions=[{}]), window.ui
    begin(qtbot, window, folder)
    said, remark = ui.guidance.instruction, ui.study_card.remark
    assert shows(said.text(), "study.first", site="left calf")
    run_test(qtbot, window, ui.start)
    assert shows(said.text(), "study.stay", site="left calf", repeat=2, count=2)
    assert remark.isHidden()
    assert window.clinician.sitting.wanted == 2
    assert ui.gate.repeats.dots.accessibleName().startswith("1 of 2")
    run_test(qtbot, window, ui.start)
    assert shows(said.text(), "study.move", site="abdomen")
    assert remark.isVisible()
    assert ui.form.site.currentText() == "abdomen"
    assert ui.gate.repeats._left == 0
    accepted = window.clinician.sitting.result
    assert accepted.count == 2
    assert result_of(folder / "P01", window.findings.test) == accepted
    assert not ui.gate.repeats.undo.isHidden()
    window.study.state.add(folder / "P01" / "other.h5", "P01", [])  # nothing was completed
    assert not window.study.complete


def test_a_visit_that_goes_on_takes_the_tests_before_into_the_mean(qtbot, open_window, bench, study):
    window = open_window(opener=seeded(bench))
    folder = study(repeats=2, conditions=[{}])
    begin(qtbot, window, folder)
    run_test(qtbot, window, window.ui.start)
    window.close()
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=WAIT_MS)
    again = open_window(opener=seeded(bench))
    begin(qtbot, again, folder)
    run_test(qtbot, again, again.ui.start)
    assert again.clinician.sitting.wanted == 2
    assert again.clinician.sitting.result.count == 2
    (result,) = (folder / "P01").glob("sitting-*.json")
    assert len({test.file for test in read_result(result).tests}) == 2


def test_nothing_starts_when_a_sitting_is_complete(qtbot, open_window, bench, study):
    window = open_window(opener=seeded(bench))
    folder, ui = study(sites=["left calf"], conditions=[{}]), window.ui
    begin(qtbot, window, folder)
    run_test(qtbot, window, ui.start)
    assert window.study.complete
    assert ui.form.subject.isReadOnly()
    assert not ui.start.isEnabled()
    assert ui.start.toolTip()
    opened = len(bench.opened)
    window.start_test()
    assert idle(window)
    assert len(bench.opened) == opened
    assert len(list((folder / "P01").glob("sitting-*.json"))) == 1
    assert ui.study_card.next_subject.isVisible()
    press(qtbot, ui.study_card.next_subject)
    assert ui.page == "studies"
    window.pages.show("measure")
    qtbot.waitUntil(ui.start.isEnabled, timeout=WAIT_MS)
    assert not ui.start.toolTip()
    assert not ui.form.subject.isReadOnly()


def test_the_result_of_another_subject_leaves_the_screen_when_a_sitting_begins(qtbot, open_window, bench, study):
    window = open_window(opener=seeded(bench))
    ui = window.ui
    ui.form.fill({"site": "left calf", "pseudonym": "P-001", "seconds": 1.0})
    run_test(qtbot, window, ui.start)
    assert window.findings is not None
    begin(qtbot, window, study())
    assert window.findings is None
    assert ui.gate.isHidden()
    assert not ui.pages.isTabVisible(1)
    assert ui.report.isHidden()
    assert "P-001" not in ui.guidance.instruction.text()


def test_the_result_of_another_subject_leaves_the_screen_when_one_is_typed(qtbot, open_window, bench):
    window = open_window(opener=seeded(bench))
    ui = window.ui
    ui.form.fill({"site": "left calf", "pseudonym": "P-001", "seconds": 1.0})
    run_test(qtbot, window, ui.start)
    ui.form.subject.setFocus()
    qtbot.keyClick(ui.form.subject, Qt.Key.Key_Return)
    assert window.findings is not None
    qtbot.keyClicks(ui.form.subject, "2")
    assert window.findings is not None
    qtbot.keyClick(ui.form.subject, Qt.Key.Key_Return)
    assert window.findings is None
    assert ui.gate.isHidden()


def test_a_condition_is_filled_in_and_stored(qtbot, open_window, bench, study):
    window = open_window(opener=seeded(bench))
    folder, ui = study(sites=["left calf"], conditions=[LOTION]), window.ui
    begin(qtbot, window, folder)
    assert (ui.form.product.text(), ui.form.minutes.given) == ("lotion", 60.0)
    assert shows(ui.study_card.condition.text(), "study.after", minutes=60.0)
    ui.form.minutes.give(63.5)
    run_test(qtbot, window, ui.start)
    (path,) = (folder / "P01").glob("*.h5")
    notes = read_session(path).test().notes
    assert (notes["condition"], notes["minutes_since_application"]) == ("lotion", 63.5)
    assert ui.study_card.map.next_site == ""
    assert shows(ui.study_card.site.text(), "study.all", total=1)
    assert shows(ui.notice.text.text(), "study.complete")


def test_demographic_values_are_asked_for_once(qtbot, open_window, study):
    window = open_window()
    folder = study(demographics=["age_years", "gender", "skin_conditions"])
    begin(qtbot, window, folder)
    dialog = window.study.dialog
    assert dialog.isVisible()
    dialog.fields["skin_conditions"].setText("a@b")
    dialog.save()
    assert shows(dialog.problem.text(), "subjects.text")
    assert not (folder / SUBJECTS_FILE).exists()
    dialog.fields["skin_conditions"].setText("none")
    dialog.fields["age_years"].give(30.0)
    dialog.fields["gender"].setCurrentIndex(1)
    dialog.save()
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    wanted = {"subject": "P01", "age_years": "30", "gender": "female", "skin_conditions": "none"}
    assert read_demographics(folder)["P01"] == wanted
    window.study.dialog = None
    begin(qtbot, window, folder)
    assert window.study.dialog is None
    window.study.ask_demographics()
    assert window.study.dialog.fields["age_years"].given == 30.0
    window.study.dialog.reject()


@pytest.mark.parametrize(("subject", "code"), [("John Smith", "protocol.pseudonym"), ("P01", "protocol.none")])
def test_a_sitting_that_cannot_be_opened_says_why(qtbot, window, tmp_path, subject, code, study):
    folder = study() if code == "protocol.pseudonym" else tmp_path
    begin(qtbot, window, folder, subject)
    assert window.study.state is None
    assert window.ui.study_card.isHidden()
    assert shows(window.ui.notice.text.text(), code)


def test_unreadable_sessions_of_a_subject_are_mentioned(qtbot, window, study):
    folder = study()
    (folder / "P01").mkdir()
    (folder / "P01" / "x.h5").write_bytes(b"rubbish")
    begin(qtbot, window, folder)
    assert shows(window.ui.notice.text.text(), "study.unreadable", count=1, file="x.h5")
    assert window.ui.study_card.progress_text.text() == "1 of 4"


def test_a_photograph_goes_into_the_folder(qtbot, window, tmp_path, study):
    folder = study(photograph=True)
    begin(qtbot, window, folder)
    assert window.ui.study_card.photograph.isVisible()
    source = tmp_path / "p.png"
    window.ui.study_card.grab().save(str(source))
    window.study.add_photograph(source)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert [path.name for path in (folder / "photographs").iterdir()] == ["P01 left-calf.png"]
    (tmp_path / "p.jpg").write_bytes(b"no")
    window.study.add_photograph(tmp_path / "p.jpg")
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert shows(window.ui.notice.text.text(), "photograph.kind")


def test_condition_fields(window):
    form = window.ui.form
    form.site.setCurrentText("abdomen")
    assert not form.minutes.isEnabled()
    assert form.plan().condition == ""
    form.product.setText("lotion")
    assert form.minutes.isEnabled()
    assert form.plan().minutes_since_application is None
    form.minutes.lineEdit().setText("12,5 min")
    assert form.plan().minutes_since_application == 12.5
    form.minutes.lineEdit().setText("-3")
    assert form.plan().minutes_since_application == 12.5
    form.product.clear()
    assert form.plan().minutes_since_application is None


def test_a_test_that_the_instrument_cannot_play_is_mentioned(qtbot, window, study):
    window.ui.form.tell_force(window.ui.form.instrument.url, 7.8)
    begin(qtbot, window, study(stimulus="thesis"))
    assert shows(window.ui.notice.text.text(), "form.preset_force", most=7.8)
    window.ui.form.tell_force(window.ui.form.instrument.url, 20.0)
    begin(qtbot, window, study(stimulus="thesis"), "P02")
    plan = window.ui.form.plan()
    assert (plan.min_force_n, plan.max_force_n) == (-5.0, 11.8)


SLIDING = {"external_spring_n_per_m": 300.0, "normal_preload_n": 1.0}
STRETCHING = {"initial_length_m": 0.02, "coupling": "tape"}


@pytest.mark.parametrize(
    ("configuration", "values", "condition"),
    [
        ("surface", SLIDING, {}),
        ("extension", STRETCHING, {"orientation_deg": 90.0}),
        ("extension", STRETCHING, {"orientation_deg": 17.5}),
        ("indentation", {"probe": "indenter-5mm"}, {}),
    ],
)
def test_the_form_gives_the_plan_of_the_protocol(qtbot, window, study, configuration, values, condition):
    begin(qtbot, window, study(conditions=[condition], configuration=configuration, **values))
    state, plan = window.study.state, window.ui.form.plan()
    expected = state.protocol.plan(state.step, plan.url, plan.out)
    assert plan.as_notes() == expected.as_notes()
    assert plan.configuration == configuration
