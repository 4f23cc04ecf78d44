"""The page of the gap as people use it: a session in; verdict, stage, effect, twin, report and answer out."""

import json
import threading
from dataclasses import replace

import pytest
from app.benches import WAIT_MS
from app.tabbing import check_tabs
from app.views.gap_pages import answer_dialog, idle, press, restarted
from coded import begins, part_of, reads, says, shows
from gap_records import FEW, SAMPLES, friction_diagnosis, recorded
from golden.golden_page import check_golden_page, lines_of_widget
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QAbstractButton, QComboBox, QFileDialog, QLabel, QLineEdit, QTableWidget

from tissueid.app.views.gap import diagnosis_result
from tissueid.app.views.gap.diagnosis_result import page_content_of, why_not_accepted
from tissueid.app.views.gap.page_content import STAGE_TITLES, VERDICT_TITLES, Proposal, session_url
from tissueid.app.views.gap.request_panel import RequestPanel
from tissueid.app.views.gap.view import EffectDialog
from tissueid.app.words import sentence
from tissueid.audit import AuditLog, last_lines
from tissueid.device import DeviceDescription
from tissueid.gap import fit_tasks
from tissueid.gap.next_experiment import NextExperiment, candidate_tests, settings_of
from tissueid.instrument import open_instrument
from tissueid.instrument.twin_file import TwinSource, content_of, device_of, read_twin, write_twin
from tissueid.instrument.twin_list import twins_in
from tissueid.language import set_language
from tissueid.messages import translated
from tissueid.procedures.control import counted
from tissueid.sessions import read_session, write_session
from tissueid.test_settings import TestSettings
from tissueid.twin.catalogue import all_effects
from tissueid.twin.chain_parameters import InstrumentParameters, Tissue
from tissueid.twin.effects.dry_friction import EFFECT as FRICTION
from tissueid.twin.simulation import NamedTwin

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]


@pytest.fixture
def shown(gap_page, diagnosed):
    """Opens the page in which a session with dry friction was diagnosed."""

    def make(**services):
        window, page = gap_page(**services)
        page.history.add(diagnosed)
        return window, page

    return make


def test_from_a_session_to_verdict_stage_and_effect(qtbot, shown):
    _, page = shown()
    result = page.result
    assert result.isVisible()
    headline = page.history.result.story.headline
    assert headline.code == "gap.explained"
    assert says(part_of(headline, "gap.cause_both"), "gap.cause_both", effect=FRICTION.title, percent="> 99")
    assert result.headline.text() == headline.replace(" %", "\N{NO-BREAK SPACE}%")
    assert FRICTION.remedy in result.todo.text()
    assert result.chain.stages["mechanics"].accessibleName().endswith("at fault")
    assert "Dry friction" in result.evidence.text()
    item = page.history.list.item(0).text()
    assert item.splitlines() == [
        f"friction.h5  ·  {page.history.result.when.astimezone():%Y-%m-%d %H:%M}",
        f"{VERDICT_TITLES['effect']}  ·  {STAGE_TITLES['mechanics']}",
        FRICTION.title,
    ]
    assert result.which.table.item(0, 0).text() == FRICTION.title
    fitted = result.which.figures.text().splitlines()
    assert fitted[1].casefold().startswith(f"{FRICTION.parameters[0].meaning}: ")
    assert fitted[1].endswith(" N")
    assert "Closed: 9" in result.far.closing.text()
    assert result.far.bars.accessibleName().startswith("Gap: Before ")
    for card in (*result.where.cards, result.far.signals):
        assert card.accessibleName().startswith("Plot: ")
    assert not page.asking.stop.isVisible()


def test_another_result_opens_at_the_top(shown, qapp):
    window, page = shown()
    window.resize(1000, 560)
    qapp.processEvents()
    bar = page.result.verticalScrollBar()
    bar.setValue(bar.maximum())
    assert bar.value() > 0
    page.history.add(page.history.result)
    qapp.processEvents()
    assert bar.value() == 0


def test_the_tab_key_visits_every_tab_of_a_diagnosis(qtbot, open_window, diagnosed):
    window = open_window(first_page="gap")
    page = window.ui.views["gap"]
    page.history.add(diagnosed)
    for place in range(page.result.tabs.count()):
        page.result.tabs.setCurrentIndex(place)
        seen = check_tabs(qtbot, window)
        assert {page.history.list, page.result.accept, page.result.tabs.tabBar()} <= set(seen)


@pytest.mark.soak
def test_no_word_is_known_to_its_makers_alone(qtbot, shown):
    _, page = shown()
    result = page.result
    said = [label.text() for label in result.findChildren(QLabel)]
    for box in result.chain.stages.values():
        said += [box.text(), box.toolTip(), box.accessibleName()]
        press(qtbot, box)
        said += [result.evidence.text()]
    for card in (*result.where.cards, result.far.signals):
        said += [card.toolTip(), card.accessibleDescription(), card.accessibleName()]
    told = " ".join([*said, result.far.closing.text(), result.far.bars.accessibleName()]).lower()
    assert "floor" not in told
    assert "announced" not in told
    for words in ("times the noise", "only noise", "of what noise does not explain", "noise alone", "predicted on"):
        assert words in told


@pytest.mark.soak
def test_in_german_it_is_as_wide_as_there_is_room(shown, qapp):
    try:
        set_language("de")
        window, page = shown()
        window.resize(1180, 600)
        qapp.processEvents()
        result = page.result
        assert result.widget().minimumSizeHint().width() <= result.viewport().width()
        assert begins(result.headline.text(), "gap.explained")
        assert shows(result.todo.text(), "gap.accept")
        assert translated(FRICTION.remedy) in result.todo.text()
        assert "korreliert mit: " in result.evidence.text()
        assert result.which.table.item(0, 0).text() == "Trockenreibung im Lager"
        assert sentence(translated(FRICTION.signature)) in result.which.leaves.text()
        assert result.which.figures.text().splitlines()[1].startswith("Reibkraft in Bewegung: ")
        said = [label.text() for label in result.findChildren(QLabel)]
        assert not [text for text in said if {"the", "and", "of", "is"} & set(text.split())]
    finally:
        set_language("en")


def test_stages_are_chosen_by_mouse_and_by_arrow_keys(qtbot, shown):
    _, page = shown()
    result = page.result
    press(qtbot, result.chain.stages["tissue"])
    assert result.stage.text() == "Evidence: Tissue"
    result.chain.stages["drive"].setFocus()
    qtbot.keyClick(result.chain.stages["drive"], Qt.Key.Key_Right)
    assert result.chain.stages["coil"].hasFocus()
    assert result.stage.text() == "Evidence: Coil"
    result.far.channel.setCurrentText("Current")
    assert [plot.y.unit for plot in result.far.signals.plots] == ["A", "mA"]


def test_an_accepted_effect_becomes_a_twin_that_is_logged(qtbot, shown, tmp_path, audit_file):
    window, page = shown(audit=AuditLog(audit_file))
    path = tmp_path / "mine.toml"
    press(qtbot, page.result.accept)
    answer_dialog(page, path)
    idle(qtbot, window)
    assert [item.name for item in read_twin(path).effects] == ["dry_friction"]
    assert "version 1, is saved" in window.said[-1]
    assert [line.what for line in last_lines(audit_file, 9)][-1] == "twin.accepted"
    assert page.asking.twin.choice.findData(str(path)) > 0
    press(qtbot, page.result.accept)
    answer_dialog(page, tmp_path / "größe.toml")
    idle(qtbot, window)
    assert not (tmp_path / "größe.toml").exists()
    assert "größe" in window.said[-1]


def test_what_is_accepted_is_chosen_among_members_and_close_rivals(qtbot, shown, tmp_path):
    window, page = shown()
    offered = (
        ("dry_friction", "Dry friction (40 %)", True),
        ("directional_damping", "Damping & direction (37 %)", False),
    )
    result = page.history.result
    page.history.add(replace(result, story=replace(result.story, offered=offered)))
    press(qtbot, page.result.accept)
    choice = page.findChild(EffectDialog)
    assert choice.names == ["dry_friction"]
    choice.boxes["dry_friction"].setChecked(False)
    assert not choice.accept_button.isEnabled()
    choice.boxes["directional_damping"].setChecked(True)
    press(qtbot, choice.accept_button)
    path = tmp_path / "other.toml"
    answer_dialog(page, path)
    idle(qtbot, window)
    made = read_twin(path)
    assert [item.name for item in made.effects] == ["directional_damping"]
    assert made.source.verdict == "by hand"


def test_report_and_answer_are_written_beside_the_session(qtbot, shown, friction, tmp_path):
    window, page = shown()
    press(qtbot, page.result.report)
    idle(qtbot, window)
    assert window.shown == [friction.with_name("friction-gap.html")]
    assert "Research use only" in window.shown[0].read_text(encoding="utf-8")
    press(qtbot, page.result.export)
    answer_dialog(page, tmp_path / "answer.json")
    idle(qtbot, window)
    found = json.loads((tmp_path / "answer.json").read_text())
    assert (found["verdict"], found["combination"]) == ("effect", ["dry_friction"])


def test_no_gap_says_so_and_makes_no_twin(qtbot, gap_page, tmp_path, monkeypatch):
    everything = all_effects()
    monkeypatch.setattr(fit_tasks, "all_effects", lambda: {name: everything[name] for name in FEW})
    write_session(tmp_path / "clean.h5", recorded(samples=SAMPLES))
    window, page = gap_page()
    qtbot.keyClick(page.asking.run, Qt.Key.Key_Return)
    assert page.asking.stop.isVisible()
    assert not page.asking.run.isEnabled()
    idle(qtbot, window)
    assert says(page.history.result.story.headline, "gap.none")
    name, verdict = page.history.list.item(0).text().splitlines()
    assert (name, verdict) == (f"clean.h5  ·  {page.history.result.when.astimezone():%Y-%m-%d %H:%M}", "No gap")
    press(qtbot, page.result.accept)
    assert says(why_not_accepted(page.history.result), "accept.no_gap")
    assert page.history.result.story.verdict == "no_gap"
    assert page.findChild(QFileDialog) is None
    press(qtbot, page.history.remove)
    assert page.welcome.isVisible()
    removed = page.history.list
    qtbot.keyClick(removed, Qt.Key.Key_Z, Qt.KeyboardModifier.ControlModifier)
    assert page.result.isVisible()
    name, verdict = page.history.list.item(0).text().splitlines()
    assert (name, verdict) == (f"clean.h5  ·  {page.history.result.when.astimezone():%Y-%m-%d %H:%M}", "No gap")
    qtbot.keyClick(removed, Qt.Key.Key_Delete)
    assert page.welcome.isVisible()


def test_a_diagnosis_is_cancelled_and_a_window_closed_in_mid_work(qtbot, open_window, friction, monkeypatch):
    reached = threading.Event()

    def slow(plan, control):
        control.progress(3 / 8, counted("Fitting", 3, 8))
        reached.set()
        while not control.check():
            threading.Event().wait(0.005)

    monkeypatch.setattr(diagnosis_result, "_diagnosed", slow)
    window = open_window(first_page="gap")
    page = window.ui.views["gap"]
    for end in ("cancel", "close"):
        reached.clear()
        press(qtbot, page.asking.run)
        qtbot.waitUntil(lambda: page.asking.doing.text() == "Fitting: 3 of 8", timeout=WAIT_MS)
        assert reached.is_set()
        if end == "cancel":
            press(qtbot, page.asking.stop)
            qtbot.waitUntil(page.asking.run.isEnabled, timeout=WAIT_MS)
            assert reads(window.ui.notice.text.text(), "gap.cancelled")
    assert not window.close()
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=WAIT_MS)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda page, folder: (folder / "friction.h5").write_bytes(b"rubbish" * 99), "friction.h5"),
        (lambda page, folder: (folder / "friction.h5").unlink(), "friction.h5"),
        (lambda page, folder: page.asking.take(folder / "bad.toml"), "not a twin"),
        (lambda page, folder: page.asking.fit.setText("one"), "test numbers"),
        (lambda page, folder: page.asking.fit.setText("7"), "no test 7"),
    ],
)
def test_what_cannot_be_diagnosed_is_words(qtbot, gap_page, friction, tmp_path, spoil, words):
    (tmp_path / "bad.toml").write_text("no = 1")
    window, page = gap_page()
    spoil(page, tmp_path)
    press(qtbot, page.asking.run)
    idle(qtbot, window)
    assert words in window.said[-1]
    assert page.history.result is None
    assert page.asking.run.isEnabled()


def test_an_empty_folder_offers_nothing_until_a_session_is_heard_of(gap_page, tmp_path, friction):
    content = friction.read_bytes()
    friction.unlink()
    _, page = gap_page()
    assert page.asking.session.path is None
    assert not page.asking.run.isEnabled()
    friction.write_bytes(content)
    page.on_session_saved(friction)
    assert page.asking.session.path == friction
    assert page.asking.run.isEnabled()


def test_a_dropped_file_is_chosen_and_found_again_at_the_next_start(gap_page, friction, tmp_path, qtbot):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    other = elsewhere / "<b>other.h5"
    other.write_bytes(friction.read_bytes())
    window, page = gap_page()
    page.offer_files([other])
    idle(qtbot, window)
    assert page.asking.session.path == other
    named = page.asking.session.choice
    alike = named.itemText(named.findData(str(friction)))  # both have the same title, so the file name tells them apart
    assert alike.endswith(", test 1 (stochastic), friction.h5")
    assert named.currentText() == alike.replace("friction.h5", "<b>other.h5")
    page.asking.check.setText("2")
    _, again = restarted(qtbot, window, gap_page)
    assert again.asking.session.path == other
    assert again.asking.check.text() == "2"
    assert again.asking.check.isVisible()


def test_nothing_begins_beside_a_running_test(qtbot, gap_page, friction):
    window, page = gap_page()
    idle(qtbot, window)
    page.update_enabled(busy=True, testing=True)
    for control in (page.asking.run, page.asking.session.choice, page.asking.open, page.asking.fold):
        assert not control.isEnabled()
    page.begin()
    assert not page.context.busy
    page.update_enabled(busy=False, testing=False)
    assert page.asking.run.isEnabled()


STEPS = (("The same, larger", 0.9, "2.5"), ("Press slowly", 0.2, "1.2"))


def with_proposal(result, proposal):
    return replace(result, story=replace(result.story, proposal=proposal))


def test_the_next_test_is_prepared_without_a_command_line(qtbot, shown):
    window, page = shown()
    fields = {"min_force_n": 1.5, "max_force_n": 9.0, "seconds": 3.0, "distribution": "uniform", "seed": 4}
    step = Proposal(STEPS[0][0], "Because.", STEPS, fields, "")
    page.history.add(with_proposal(page.history.result, step))
    page.result.tabs.setCurrentIndex(3)
    assert [page.result.next.gains.item(row, 1).text() for row in (0, 1)] == ["2.5 to 1", "1.2 to 1"]
    assert not page.result.next.findChildren(QLineEdit)
    press(qtbot, page.result.next.prepare)
    (prepared, words) = window.prepared[-1]
    assert prepared == fields
    assert "Prepared" in words


@pytest.mark.parametrize("kind", ["deeper", "slow_ramp"])
def test_no_shell_command_stands_on_the_page(shown, friction, kind):
    _, page = shown()
    found = friction_diagnosis()
    settings = TestSettings(distribution="uniform", min_force_n=1.0, max_force_n=8.0)
    gains = {"deeper": 0.9, "slow_ramp": 0.3}
    step = NextExperiment(kind, "Because.", FEW, 0.9, 1.8, gains, settings)
    page.result.show_story(page_content_of(replace(found, next_experiment=step), read_session(friction)))
    said = " ".join(label.text() for label in page.result.findChildren(QLabel))
    assert not {"tissueid", "nats", "--device", *FEW} & set(said.split())
    assert page.result.next.prepare.isVisibleTo(page.result.next)


PREPARED = {
    "quiet": ("quiet", "", 1.5),
    "slow_ramp": ("slow_ramp", "", 4.5),
    "step_hold": ("step_hold", "", 4.0),
    "spring": ("noise", "spring", None),
    "free_air": ("noise", "free_air", 0.6),
    "smaller_amplitude": ("noise", "", None),
    "deeper": ("noise", "", None),
}


def test_every_candidate_test_is_prepared_on_the_form(qtbot, open_window, diagnosed, friction):
    window, found = open_window(first_page="gap"), friction_diagnosis()
    page, form = window.ui.views["gap"], window.ui.form
    for kind, (stimulus, under, seconds) in PREPARED.items():
        window.pages.show("gap")
        chosen = next(item for item in candidate_tests(found.dataset) if item.kind == kind)
        settings = settings_of(found.dataset, chosen)
        step = NextExperiment(kind, "Because.", FEW, 0.9, 1.8, {kind: 0.9}, settings)
        story = page_content_of(replace(found, next_experiment=step), read_session(friction))
        page.history.add(replace(diagnosed, story=story))
        page.result.tabs.setCurrentIndex(3)
        assert page.result.next.put.isVisible() == bool(under)
        form.fill({"kind": "spring"})
        press(qtbot, page.result.next.prepare)
        assert window.ui.page == "measure"
        assert not window.testing
        plan = form.plan()
        assert (plan.stimulus, plan.kind) == (stimulus, under or None)
        assert seconds is None or plan.seconds == pytest.approx(seconds)
        assert form.subject.text() == ("" if under else read_session(friction).subject.pseudonym)
        assert {"spring": "calibration spring", "free_air": "free air"}.get(kind, plan.site) == plan.site
        assert ("under the probe" in form.summary.text()) == bool(under)
        assert shows(window.ui.notice.text.text(), "gap.choose_instrument", model="desktop indenter")
        assert plan.specification(2000.0) is not None


def test_the_simulated_twin_of_a_session_is_found_by_the_name_it_states(tmp_path):
    content = content_of(NamedTwin("bench", 1, InstrumentParameters(), Tissue(), (), 2000.0), TwinSource(), "", "")
    write_twin(tmp_path / "bench 1.toml", content)
    (tmp_path / "settings.toml").write_text("name = 'bench'\nversion = 1\n")
    (tmp_path / "broken.toml").write_text("[")
    url = session_url(device_of(content), None, [tmp_path / "none", tmp_path])
    assert open_instrument(url).device.model == device_of(content).model
    assert session_url(device_of(content), tmp_path / "bench 1.toml", []) == url
    assert session_url(DeviceDescription(), None, [tmp_path]) == ""
    assert list(twins_in(tmp_path)) == [url]


def test_a_test_that_the_form_cannot_do_is_done_by_hand(shown):
    _, page = shown()
    step = Proposal(STEPS[1][0], "Because.", STEPS, None, "By hand: press slowly.")
    page.history.add(with_proposal(page.history.result, step))
    page.result.tabs.setCurrentIndex(3)
    shown = page.result.next
    assert shown.by_hand.isVisible()
    assert not shown.prepare.isVisible()


def test_names_sizes_and_keys(qtbot, shown, qapp):
    window, page = shown()
    kinds = (QAbstractButton, QComboBox, QLineEdit, QTableWidget)
    every = [widget for kind in kinds for widget in page.findChildren(kind)]
    own = [item for item in every if not isinstance(item.parentWidget(), QComboBox | QTableWidget)]
    named = [item for item in own if item.accessibleName() or (isinstance(item, QAbstractButton) and item.text())]
    hidden = [item for item in own if item.focusPolicy() == Qt.FocusPolicy.NoFocus]
    assert [item for item in own if item not in named and item not in hidden] == []
    assert not [item for item in page.findChildren(QLabel) if "&" in item.text() and not item.text().startswith("<")]
    window.resize(1000, 560)
    qapp.processEvents()
    assert page.result.widget().minimumSizeHint().width() <= page.result.viewport().width()
    visited = []
    page.history.list.setFocus()
    for _ in range(12):
        visited.append(window.focusWidget())
        qtbot.keyClick(window.focusWidget(), Qt.Key.Key_Tab)
    asking, result = page.asking, page.result
    expected = [page.history.list, page.history.remove]
    expected += [asking.session.choice, asking.twin.choice, asking.open, asking.run]
    expected += [asking.fold, result.accept, result.report, result.export]
    expected += [result.chain.stages["mechanics"], result.tabs.tabBar()]
    assert visited == expected


@pytest.mark.parametrize("language", ["en", "de"])
def test_the_page_gap_reads_as_its_golden_page(shown, language):
    """Renew the pages by ``python tests/golden/renew.py``."""
    try:
        set_language(language)
        _, page = shown()
        lines = []
        for place in range(page.result.tabs.count()):
            page.result.tabs.setCurrentIndex(place)
            lines += lines_of_widget(page if not place else page.result.tabs.currentWidget())
        check_golden_page(f"window-gap-{language}", lines)
    finally:
        set_language("en")


def test_sessions_of_the_folders_of_research_and_of_those_in_them_are_listed(qtbot, tmp_path):
    own, other = tmp_path / "own", tmp_path / "other"
    files = [own / "a.h5", other / "b.h5", other / "subject" / "c.h5"]
    for path in (*files, other / "subject" / "deeper" / "d.h5", other / "notes.txt"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    panel = RequestPanel(own, lambda: [other, tmp_path / "gone"])
    qtbot.addWidget(panel)
    assert set(panel.session.untitled) == set(files)
