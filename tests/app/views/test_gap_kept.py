"""Diagnoses that outlive the window, and what sessions are called in its list."""

import json
import os
import stat
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from app.views.gap_pages import answer_dialog, idle, press, restarted
from coded import begins, part_of, reads, says
from gap_records import FEW, SAMPLES, recorded
from PySide6.QtCore import Qt

from tissueid.app.views.gap import view
from tissueid.app.views.gap.diagnosis_result import MOST_KEPT, default_folder, keep, new_key, read_kept
from tissueid.app.views.gap.page_content import STATE_TITLES, as_title
from tissueid.app.views.gap.view import EffectDialog
from tissueid.errors import UnusableInputError
from tissueid.gap import fit_tasks
from tissueid.instrument.twin_file import read_twin
from tissueid.language import set_language
from tissueid.messages import translated
from tissueid.sessions import Subject, write_session
from tissueid.twin.catalogue import all_effects

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]

WHEN = datetime(2026, 11, 23, 9, 0, tzinfo=UTC)


def files():
    return sorted(default_folder().iterdir())


def at(result, number):
    when = WHEN + timedelta(minutes=number)
    return replace(result, when=when, key=new_key(when))


def test_a_diagnosis_is_there_at_the_next_start_with_headline_odds_chain_and_curves(
    qtbot, gap_page, friction, monkeypatch
):
    every = all_effects()
    monkeypatch.setattr(fit_tasks, "all_effects", lambda: {name: every[name] for name in FEW})
    window, page = gap_page()
    press(qtbot, page.asking.run)
    idle(qtbot, window)
    before = page.history.result
    said = [page.result.headline.text(), page.result.todo.text(), page.result.far.closing.text()]
    _, page = restarted(qtbot, window, gap_page)
    assert page.history.list.count() == 1
    assert page.history.result is not before
    assert [page.result.headline.text(), page.result.todo.text(), page.result.far.closing.text()] == said
    story = page.history.result.story
    assert says(part_of(story.headline, "gap.cause_both"), "gap.cause_both", percent="> 99")
    assert [item.odds for item in story.ranking] == [item.odds for item in before.story.ranking]
    assert [item.share for item in story.stages] == [item.share for item in before.story.stages]
    assert np.array_equal(story.overlays[0].after, before.story.overlays[0].after)
    assert page.history.result.answer == before.answer
    assert page.result.accept.isVisible()
    assert not page.result.stale.isVisible()
    assert not page.result.again.isVisible()


def test_kept_files_are_the_owners_alone_and_the_newest_twenty(diagnosed):
    folder = default_folder()
    for number in range(MOST_KEPT + 2):
        keep(at(diagnosed, number), folder)
    assert len(files()) == MOST_KEPT
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert {stat.S_IMODE(path.stat().st_mode) for path in files()} == {0o600}
    kept = read_kept(folder)
    assert kept.bad == 0
    assert [item.when for item in kept.results] == [
        WHEN + timedelta(minutes=number) for number in range(MOST_KEPT + 1, 1, -1)
    ]
    assert json.loads(files()[0].read_text())["answer"]["verdict"] == "effect"


def test_what_is_removed_is_gone_at_the_next_start_and_comes_back_with_undo(qtbot, gap_page, diagnosed):
    keep(diagnosed, default_folder())
    window, page = gap_page()
    press(qtbot, page.history.remove)
    assert files() == []
    qtbot.keyClick(page.history.list, Qt.Key.Key_Z, Qt.KeyboardModifier.ControlModifier)
    idle(qtbot, window)
    assert [path.stem for path in files()] == [diagnosed.key]


def test_a_changed_session_is_marked_and_diagnosed_again_by_a_button(qtbot, gap_page, diagnosed, friction, monkeypatch):
    asked = diagnosed.asked.model_copy(update={"fit": (1,), "check": (1,)})
    keep(replace(diagnosed, asked=asked), default_folder())
    friction.unlink()
    write_session(friction, recorded("dry_friction", samples=SAMPLES + 100))
    window, page = gap_page()
    assert page.history.list.item(0).text().splitlines()[-1] == STATE_TITLES["changed"]
    assert page.history.state == "changed"
    assert page.result.stale.isVisible()
    assert page.result.headline.property("level") == "check"
    assert not page.result.accept.isVisible()
    asked = []
    monkeypatch.setattr(view, "run_diagnosis", lambda what, *_args, **_options: asked.append(what))
    press(qtbot, page.result.again)
    idle(qtbot, window)
    assert [(item.session, item.fit, item.check) for item in asked] == [(friction, (1,), (1,))]


def test_a_missing_session_is_marked_and_its_named_effect_still_makes_a_twin(qtbot, gap_page, diagnosed, tmp_path):
    keep(diagnosed, default_folder())
    diagnosed.asked.session.unlink()
    window, page = gap_page()
    assert page.history.state == "missing"
    assert not page.result.again.isVisible()
    press(qtbot, page.result.accept)
    answer_dialog(page, tmp_path / "mine.toml")
    idle(qtbot, window)
    made = read_twin(tmp_path / "mine.toml")
    assert (made.name, [item.name for item in made.effects]) == ("mine", ["dry_friction"])
    assert made.source.session_id == diagnosed.session_id


def test_a_session_that_changes_while_the_window_is_open_is_marked_when_the_page_is_shown(qtbot, gap_page, diagnosed):
    keep(diagnosed, default_folder())
    _, page = gap_page()
    assert page.history.state == ""
    path = diagnosed.asked.session
    os.utime(path, ns=(1, 1))
    page.enter()
    assert page.history.state == "changed"
    assert page.result.again.isVisible()


def test_another_effect_is_fitted_to_the_session_of_a_kept_diagnosis(qtbot, gap_page, diagnosed, tmp_path):
    offered = (("dry_friction", "Dry friction (40 %)", True), ("directional_damping", "Damping (37 %)", False))
    keep(replace(diagnosed, story=replace(diagnosed.story, offered=offered)), default_folder())
    window, page = gap_page()
    press(qtbot, page.result.accept)
    choice = page.findChild(EffectDialog)
    choice.boxes["dry_friction"].setChecked(False)
    choice.boxes["directional_damping"].setChecked(True)
    press(qtbot, choice.accept_button)
    answer_dialog(page, tmp_path / "other.toml")
    idle(qtbot, window)
    assert [item.name for item in read_twin(tmp_path / "other.toml").effects] == ["directional_damping"]


def test_a_kept_diagnosis_is_shown_in_the_language_of_the_window(gap_page, diagnosed):
    keep(diagnosed, default_folder())
    try:
        set_language("de")
        _, page = gap_page()
        story = page.history.result.story
        texts = [story.headline, *story.means, *story.todo, story.closing, *story.stages[2].evidence]
        texts += [text for item in story.ranking for text in (item.title, item.signature, item.remedy)]
        assert says(story.headline, "gap.explained")
        assert [text for text in texts if translated(text) == str(text)] == []
        assert page.result.headline.text() == as_title(diagnosed.story.headline)
        assert page.result.far.closing.text() == translated(diagnosed.story.closing)
    finally:
        set_language("en")


def test_report_and_answer_of_a_kept_diagnosis_are_those_that_were_made_with_it(qtbot, gap_page, diagnosed, tmp_path):
    keep(diagnosed, default_folder())
    window, page = gap_page()
    press(qtbot, page.result.report)
    idle(qtbot, window)
    assert window.shown[0].read_text(encoding="utf-8") == diagnosed.report
    press(qtbot, page.result.export)
    answer_dialog(page, tmp_path / "answer.json")
    idle(qtbot, window)
    assert json.loads((tmp_path / "answer.json").read_text()) == diagnosed.answer


def changed_story(**changes):
    return lambda content: content["story"].update(changes)


def shorter_curve(content):
    content["story"]["overlays"][0]["recorded"].pop()


def endless_curve(content):
    content["story"]["overlays"][0]["recorded"][0] = float("inf")


def text_in_a_curve(content):
    content["story"]["spectrum"]["frequency"][0] = {}


def other_field(content):
    content["story"]["proposal"] = {
        "title": "", "why": "", "gains": [], "fields": {"url": "rfc2217://elsewhere"}, "by_hand": "",
    }  # fmt: skip


def other_answer(content):
    content["answer"]["verdict"] = "no_gap"


def other_twin(content):
    content["accepted"]["effects"] = []


def other_key(content):
    content["key"] = new_key(WHEN)


@pytest.mark.parametrize(
    "spoil",
    [
        shorter_curve,
        endless_curve,
        text_in_a_curve,
        other_field,
        other_answer,
        other_twin,
        other_key,
        changed_story(stages=[]),
        changed_story(level="splendid"),
        changed_story(headline="x" * 6000),
        changed_story(profiles={"luck": {"middle": [], "error": [], "above": []}}),
    ],
)
def test_a_kept_file_that_does_not_agree_with_itself_is_passed_over(diagnosed, spoil):
    folder = default_folder()
    keep(diagnosed, folder)
    path = files()[0]
    content = json.loads(path.read_text())
    spoil(content)
    path.write_text(json.dumps(content))
    assert (read_kept(folder).results, read_kept(folder).bad) == ((), 1)


def test_a_damaged_file_costs_one_line_and_no_other_diagnosis(gap_page, diagnosed):
    keep(at(diagnosed, 1), default_folder())
    (default_folder() / "notes.json").write_text("mine")
    damaged = default_folder() / f"{new_key(WHEN)}.json"
    for content in (b"", b"{", b"\x80\x04N.", b"[" * 100_000, b"null", b'{"format": "x"}'):
        damaged.write_bytes(content)
        assert (len(read_kept(default_folder()).results), read_kept(default_folder()).bad) == (1, 1)
    window, page = gap_page()
    assert page.history.list.count() == 1
    assert page.result.headline.text() == as_title(diagnosed.story.headline)
    assert reads(window.said[-1], "gap.one_unreadable")


def test_what_cannot_be_kept_is_said_and_the_diagnosis_is_shown_all_the_same(qtbot, gap_page, diagnosed, monkeypatch):
    default_folder().parent.mkdir(exist_ok=True)
    default_folder().write_text("a file where the folder should be")
    monkeypatch.setattr(view, "run_diagnosis", lambda *_args, **_options: diagnosed)
    window, page = gap_page()
    press(qtbot, page.asking.run)
    idle(qtbot, window)
    assert page.history.result is diagnosed
    assert begins(window.said[-1], "gap.not_kept")


def test_what_could_not_be_read_again_is_not_written(diagnosed):
    endless = np.full_like(diagnosed.story.overlays[0].recorded, np.inf)
    overlay = replace(diagnosed.story.overlays[0], recorded=endless)
    with pytest.raises(UnusableInputError):
        keep(replace(diagnosed, story=replace(diagnosed.story, overlays=(overlay,))), default_folder())
    assert not default_folder().exists()


def test_sessions_are_listed_by_subject_site_date_and_test_with_their_files_as_tool_tips(gap_page, tmp_path):
    session = recorded("dry_friction", samples=SAMPLES)
    test = replace(session.tests[0], site="left calf")
    about = {"subject": Subject("P-007"), "created": "2026-11-23T09:14:00Z"}
    write_session(tmp_path / "one.h5", replace(session, tests=(test,), **about))
    _, page = gap_page()
    choice = page.asking.session.choice
    words = choice.itemText(0)
    assert words.startswith("P-007, left calf, 2026-11-23 ")
    assert words.endswith(", test 1 (stochastic)")
    assert choice.itemData(0, Qt.ItemDataRole.ToolTipRole) == str(tmp_path / "one.h5")


def test_sessions_of_the_same_title_are_told_apart_by_their_files(gap_page, tmp_path):
    created = "2026-11-23T09:14:00Z"
    session = replace(recorded("dry_friction", samples=SAMPLES), subject=Subject("P-007"), created=created)
    for name in ("a", "b"):
        write_session(tmp_path / f"{name}.h5", session)
    (tmp_path / "broken.h5").write_bytes(b"rubbish")
    _, page = gap_page()
    choice = page.asking.session.choice
    words = [choice.itemText(place).split(", ") for place in range(choice.count())]
    assert sorted((item[0], item[-1]) for item in words) == [
        ("P-007", "a.h5"),
        ("P-007", "b.h5"),
        ("broken.h5", "broken.h5"),
    ]


def test_files_from_elsewhere_are_offered_once_they_were_saved_or_opened_until_they_are_gone(
    qtbot, gap_page, diagnosed, friction, tmp_path
):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    keep(diagnosed, default_folder())
    window, page = gap_page()
    press(qtbot, page.result.accept)
    answer_dialog(page, elsewhere / "mine.toml")
    idle(qtbot, window)
    for name in ("heard.h5", "opened.h5"):
        (elsewhere / name).write_bytes(friction.read_bytes())
    page.on_session_saved(elsewhere / "heard.h5")
    page.offer_files([elsewhere / "opened.h5"])
    page.offer_files([friction])
    idle(qtbot, window)
    (elsewhere / "heard.h5").unlink()
    window, page = restarted(qtbot, window, gap_page)
    session, twin = page.asking.session, page.asking.twin
    assert twin.choice.findData(str(elsewhere / "mine.toml")) > 0
    assert session.path == friction
    assert session.choice.findData(str(elsewhere / "opened.h5")) >= 0
    assert session.recent == [elsewhere / "opened.h5"]
