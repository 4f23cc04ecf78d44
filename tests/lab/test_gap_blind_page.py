"""The page of a sealed check, on a score made by hand."""

from dataclasses import replace
from pathlib import Path

import pytest
from coded import made, shows
from reports.in_german import english_in, in_german, shown, texts_of
from reports.page_check import checked

from tissueid_lab.blind_check.answers import BlindCheck, CheckInProgress
from tissueid_lab.blind_check.page import blind_html, blind_panels, confusion_names, headline_of, write_blind_report
from tissueid_lab.blind_check.scoring import BlindScore, Measured, Rate

SCORE = BlindScore(
    (Rate("top-1", 13, 14, 0.75), Rate("gap missed", 3, 14, 0.05, at_least=False), Rate("false alarms", 0, 0, 0.01)),
    (Measured("Brier score", 0.101, 14), Measured("pairs: F1 of the named set", float("nan"), 0, 0.75)),
    {"sensor_lag": {"sensor_lag": 2, "unexplained": 1}, "dry_friction": {"tissue_hysteresis": 1, "no_gap": 1}},
    ((0.5, 0.0), (1.0, 0.25)),
    ("scenario-0003: <b>dry_friction</b>; said nothing",),
    (Measured("labels permuted", 0.07, 14), Measured("always dry_friction", float("nan"), 0)),
)
NOTHING = BlindScore((Rate("top-1", 0, 0, 0.9),), (), {}, (), ())


def check(**scores: BlindScore) -> BlindCheck:
    begun = CheckInProgress(17, 2611, 0.3, "ab" * 32)
    return BlindCheck(begun, {key: (key.capitalize(), 17, score) for key, score in scores.items()})


def test_the_page_tells_the_score_the_controls_and_every_failure():
    page = checked(blind_html(check(single=SCORE)))
    for words in (
        "1 of 2 targets were reached",
        "not reached: gap missed",
        "13 of 14",
        "69 to 99 %",
        "at most 5 %",
        "labels permuted",
        "7 %",
        "scenario-0003: <b>dry_friction</b>; said nothing",
        "ab" * 32,
        "2611",
        "Risk and coverage",
    ):
        assert words in page.text
    assert "nan" not in page.text


def test_what_names_say_is_text():
    assert "<b>dry_friction" not in blind_html(check(single=SCORE))


def test_the_pictures():
    rows, columns = confusion_names(SCORE)
    assert rows == ["dry_friction", "sensor_lag"]
    assert columns == ["sensor_lag", "tissue_hysteresis", "unexplained", "no_gap"]
    drawn = {panel.key: panel.picture() for panel in blind_panels("single", SCORE)}
    assert set(drawn) == {"single-confusion", "single-risk"}
    assert all(picture.figure is not None for picture in drawn.values())


def test_a_kind_without_cases_says_so():
    page = checked(blind_html(check(single=SCORE, full=NOTHING)))
    assert shows(page.text, "report.no_single_effect")
    assert "every scenario was diagnosed correctly" in page.text
    assert headline_of(check(full=NOTHING)) == (made("blind.none_judged"), "check")


def test_the_page_says_nothing_in_english():
    named = ("pairs: F1 of the named set", "always dry_friction", "false alarms without effect")
    rates = (*SCORE.rates[:2], replace(SCORE.rates[2], what=named[2]))
    score = replace(SCORE, failures=(), rates=rates)
    texts = in_german(lambda: shown(blind_html(check(single=score, full=NOTHING))))
    drawn = in_german(lambda: [text for panel in blind_panels("single", score) for text in texts_of(panel.picture())])
    assert english_in(texts + drawn, ("Single Full",)) == []


def test_the_page_is_written_whole_or_not_at_all(tmp_path: Path):
    write_blind_report(check(single=SCORE), tmp_path / "check.html")
    with pytest.raises(FileNotFoundError):
        write_blind_report(check(single=SCORE), tmp_path / "missing" / "check.html")
    assert [item.name for item in tmp_path.iterdir()] == ["check.html"]
