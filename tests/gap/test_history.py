"""The gap of several sessions over time: their order, the first in which it grew, and their plot."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from coded import says

from tissueid.gap.diagnosis_plots import history_plot
from tissueid.gap.statement import GapHistory, GapHistoryEntry, history_headline
from tissueid.messages import Message


def entry(file: str, created: str, gap: float = 0.0, *named: str, verdict: str = "") -> GapHistoryEntry:
    verdict = verdict or ("effect" if named else "no_gap")
    figures = {"before": gap, "after": gap, "floor": 0.01, "closed": None, "closed_ci": [None, None]}
    answer: dict[str, Any] = {"verdict": verdict, "gap": figures, "combination": list(named)}
    return GapHistoryEntry(file, created, answer)


UNUSABLE = GapHistoryEntry("d.h5", "2026-01-03T09:00:00Z", None, Message("gap.no_tests", "it holds no tests"))
SESSIONS = [
    entry("c.h5", "2026-01-05T09:00:00Z", 0.04, "sensor_lag"),
    entry("b.h5", "2026-01-04T09:00:00Z", 0.03, verdict="unexplained"),
    UNUSABLE,
    entry("a.h5", "2026-01-01T10:00:00+01:00", 0.012),
]


def test_sessions_are_in_order_of_time_and_the_first_that_grew_is_known():
    history = GapHistory.of([*SESSIONS, entry("z.h5", "no date", 0.05, "latency")])
    assert [item.file for item in history.entries] == ["a.h5", "d.h5", "b.h5", "c.h5", "z.h5"]
    assert history.first_grown is not None
    assert history.first_grown.file == "b.h5"
    answer = history.as_answer()
    assert (answer["first_grown"], answer["grown_effects"]) == ("b.h5", [])
    assert [item["verdict"] for item in answer["sessions"]] == ["no_gap", None, "unexplained", "effect", "effect"]
    assert answer["sessions"][1]["message"]["code"] == "gap.no_tests"


def test_the_headline_names_session_and_cause():
    line, level = history_headline(GapHistory.of(SESSIONS[:1]))
    assert says(line, "watch.grown", file="c.h5")
    assert level == "check"
    quiet = GapHistory.of([SESSIONS[3], UNUSABLE])
    assert quiet.first_grown is None
    line, level = history_headline(quiet)
    assert says(line, "watch.not_grown", count=1)
    assert level == "good"


def test_the_plot_shows_gap_and_floor_over_time_and_marks_the_first_that_grew():
    plot = history_plot(GapHistory.of(SESSIONS))
    assert (plot.x.unit, plot.y.unit) == ("d", "%")
    np.testing.assert_allclose(plot.curve("noise floor").y, 1.0)
    np.testing.assert_allclose(plot.curve("no gap").x, [0.0])
    np.testing.assert_allclose(plot.curve("gap").x, [3.0, 4.0])
    np.testing.assert_allclose(plot.curve("gap").y, [3.0, 4.0])
    np.testing.assert_allclose(plot.curve("first session in which it grew").x, [3.0])


@pytest.mark.parametrize(
    ("sessions", "unit", "x"),
    [
        ([entry("a", "2026-01-01T10:00:00Z", 0.01), entry("b", "2026-01-01T11:30:00Z", 0.5)], "h", [0.0, 1.5]),
        ([entry("a", "", 0.01), entry("b", "2026-01-01", 0.01)], "", [1.0, 2.0]),
    ],
)
def test_the_axis_of_time_follows_the_sessions(sessions: list[GapHistoryEntry], unit: str, x: list[float]):
    plot = history_plot(GapHistory.of(sessions))
    assert plot.x.unit == unit
    np.testing.assert_allclose(plot.curve("noise floor").x, x)
    assert plot.y.log == (unit == "h")


def test_without_a_diagnosed_session_there_is_no_plot():
    assert history_plot(GapHistory.of([UNUSABLE])).missing
