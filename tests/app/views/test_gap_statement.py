"""One statement per diagnosis: page, chain, tabs, report and shell agree for every verdict."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from html import escape

import numpy as np
import pytest
from coded import made, part_of, reads, says
from gap_records import SAMPLES, friction_diagnosis, observed, recorded

from tissueid.app.views.gap.diagnosis_result import page_content_of
from tissueid.app.views.gap.page_content import as_title
from tissueid.app.views.gap.result_page import DiagnosisPage
from tissueid.app.views.gap.result_tabs import _NONE, _NONE_SEPARATES, NextTestTab
from tissueid.cli.gap import summary_lines
from tissueid.gap.closed_share import Budget, BudgetStep
from tissueid.gap.diagnosis import Diagnosis, diagnose
from tissueid.gap.statement import LIKELY, effect_title, headline_of, members_of, ordered_candidates, shown_probability
from tissueid.gap.twin_export import twin_of, with_prior_twin
from tissueid.gap.workers import SerialExecutor
from tissueid.messages import MISSING, code_of, messages_in
from tissueid.reports.gap_page import gap_html
from tissueid.reports.gap_panels import gap_panels
from tissueid.twin.effect import STAGE_NAMES

EFFECT, RIVAL, PARTNER = "dry_friction", "directional_damping", "latency"
SEED = 3


@cache
def with_twin() -> Diagnosis:
    best = friction_diagnosis().best
    assert best is not None
    tests = with_prior_twin(observed(EFFECT, SEED, SAMPLES), twin_of(best, "accepted"))
    return diagnose(tests, SerialExecutor(), accepted=[EFFECT], candidates=[RIVAL])


def synthetic(case: str) -> Diagnosis:
    found = friction_diagnosis()
    if case == "sure":
        return found
    if case == "doubtful":
        shares = {EFFECT: 0.4, RIVAL: 0.37}
        ranking = tuple(replace(item, probability=shares[item.effect]) for item in found.ranking)
        return replace(found, ranking=ranking)
    if case == "pair":
        odds = {PARTNER: ((PARTNER, 0.95), (RIVAL, 0.04))}
        return replace(found, combination=(EFFECT, PARTNER), conditional_odds=odds)
    if case == "no gap":
        return replace(found, verdict="no_gap", combination=())
    if case == "unexplained":
        return replace(found, verdict="unexplained", combination=())
    if case == "nowhere":
        nothing = dict.fromkeys(found.where.shares, 0.0)
        return replace(found, verdict="unexplained", combination=(), where=replace(found.where, shares=nothing))
    return with_twin()


CASES = ("sure", "doubtful", "pair", "no gap", "unexplained", "nowhere", "twin")


@pytest.mark.parametrize("case", CASES)
def test_page_chain_tabs_report_and_shell_agree(qtbot, case):
    found = synthetic(case)
    story = page_content_of(found, recorded(EFFECT, SEED, SAMPLES))
    page = DiagnosisPage()
    qtbot.addWidget(page)
    page.show_story(story)
    headline, level = headline_of(found)
    assert (page.headline.text(), page.headline.property("level")) == (as_title(headline), level)
    lit = {stage for stage, box in page.chain.stages.items() if box.accessibleName().endswith("at fault")}
    assert lit == set(found.at_fault) == {item.stage for item in story.stages if item.lit}
    html = gap_html(found)
    assert escape(headline) in html
    assert f'class="verdict {level}"' in html
    alternative = next(panel for panel in gap_panels(found) if panel.key == "chain").alt
    assert alternative.endswith(f"at fault: {', '.join(STAGE_NAMES[stage] for stage in found.at_fault) or 'none'}.")
    shell = summary_lines(found)
    assert shell[0] == f"{headline}."
    stages = " and ".join(STAGE_NAMES[stage] for stage in found.at_fault)
    assert [line for line in shell if line.startswith("Stage at fault")] == (
        [f"Stage at fault: {stages}."] if stages else []
    )
    assert page.which.table.rowCount() == len(ordered_candidates(found)) == len(story.ranking)
    if found.verdict != "no_gap":
        return
    assert level == "good"
    assert all((item.share, item.lit) == (0.0, False) for item in story.stages)
    assert not any("times the noise" in line for item in story.stages for line in item.evidence)
    assert all(box.text() == "only noise" for box in page.chain.stages.values())
    assert story.spectrum is None or story.spectrum.bands == ()
    assert not any(profile.above.any() for profile in story.profiles.values())
    assert {code_of(sentence) for sentence in story.means} <= {"gap.detection_limits"}
    assert reads(page.which.none.text(), "gap.no_cause")
    assert code_of(story.closing) == "gap.nothing_to_close"
    assert made("report.gap.findings") not in html


def test_an_accepted_twin_explains_its_own_recording_stage_by_stage():
    found = with_twin()
    assert (found.verdict, found.at_fault) == ("no_gap", ())


def test_rivals_close_to_the_named_effect_stand_in_the_headline_and_lower_the_level():
    found = synthetic("doubtful")
    member = members_of(found)[0]
    assert (member.effect, member.rivals) == (EFFECT, ((RIVAL, 0.37),))
    headline, level = headline_of(found)
    assert level == "check"
    named, rival = (part for part in messages_in(headline) if part.code == "gap.cause_both")
    assert (named.values["percent"], rival.values["percent"]) == ("40", "37")
    closed = {item.effect: f"{100.0 * item.closed:.0f}" for item in found.ranking}
    assert rival.values["share"] == closed[RIVAL]
    alone = replace(found, ranking=tuple(replace(item, probability=LIKELY / 2) for item in found.ranking[:1]))
    assert headline_of(alone)[1] == "check"


def test_every_member_of_a_combination_is_listed_first_with_its_odds():
    found = synthetic("pair")
    rows = ordered_candidates(found)
    assert [item.effect for item in rows[:2]] == [EFFECT, PARTNER]
    assert rows[1].probability == 0.95
    assert rows[1].stage == "drive"
    assert found.at_fault == ("mechanics", "drive")
    assert [item.effect for item in rows[2:]] == [RIVAL]


def test_a_member_of_a_combination_is_named_with_what_it_closes_and_not_with_its_probability_as_the_only_cause():
    found = synthetic("pair")
    steps = (BudgetStep(EFFECT, "mechanics", 0.1, 0.79, (0.7, 0.8), 0.3, (0.2, 0.4)),)
    steps += (BudgetStep(PARTNER, "drive", 0.1, 0.10, (0.0, 0.2), 0.1, (0.0, 0.2)),)
    found = replace(found, budget=Budget(1.0, 0.1, 0.05, steps, 0.0, None))
    shown = [shown_probability(found, name, 0.5) for name in (EFFECT, PARTNER, RIVAL)]
    assert np.isnan(shown[0])
    assert shown[1:] == [0.5, 0.5]
    headline = headline_of(found)[0]
    assert says(part_of(headline, "gap.cause_share"), "gap.cause_share", effect=effect_title(EFFECT), share="79")
    partner = part_of(headline, "gap.cause_both")
    assert says(partner, "gap.cause_both", effect=effect_title(PARTNER), share="10", percent="95")
    content = page_content_of(found, recorded(EFFECT, SEED, SAMPLES))
    assert [item.odds for item in content.ranking[:2]] == [MISSING, "95 %"]
    offered = {name: title for name, title, _named in content.offered}
    assert says(offered[EFFECT], "gap.cause_share", share="79")


@pytest.mark.parametrize(("level", "alike", "clear"), [("good", "", True), ("check", "", False), ("good", "x", False)])
def test_without_a_next_test_the_page_says_whether_the_cause_is_clear(qtbot, level, alike, clear):
    content = page_content_of(synthetic("sure"), recorded(EFFECT, SEED, SAMPLES))
    ranking = tuple(replace(item, alike=alike if item.named else "") for item in content.ranking)
    tab = NextTestTab()
    qtbot.addWidget(tab)
    tab.show_story(replace(content, proposal=None, level=level, ranking=ranking))
    assert (tab.why.text() == _NONE["effect"]) == clear
    assert (tab.why.text() == _NONE_SEPARATES) != clear


def test_where_nothing_is_named_the_list_is_ordered_by_what_is_closed():
    found = synthetic("unexplained")
    first, second = found.ranking[0], found.ranking[1]
    ranking = (replace(first, closed=0.1), replace(second, closed=0.4), replace(first, effect=PARTNER, closed=np.nan))
    assert [item.closed for item in ordered_candidates(replace(found, ranking=ranking))[:2]] == [0.4, 0.1]
