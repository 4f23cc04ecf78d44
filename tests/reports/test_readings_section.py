"""Readings in the report of a step test and on the page Result."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from analysis import simulated_steps as steps
from reports.synthetic_sitting import make_session, make_test

from tissueid.analysis import analyse_all
from tissueid.app.identifying import identify
from tissueid.reports import report_html
from tissueid.sessions import Session, Test


def sitting() -> Session:
    record = steps.step_record(np.random.default_rng(0))
    time = np.arange(len(record)) / record.sample_rate_hz
    signals = {"time": time, "force": record.input, "position": record.output}
    return make_session(make_test(1, seconds=2.0), Test(2, "step_hold", signals, record.sample_rate_hz))


def test_the_report_of_a_step_test_has_its_readings_and_that_of_others_has_none() -> None:
    session = sitting()
    pages = [
        report_html(session, {number: analyse_all(session, ("lms",), test=session.test(number))}) for number in (1, 2)
    ]
    assert "test2-readings-step" not in pages[0]
    assert "test2-readings-step" in pages[1]
    assert "not comparable" in pages[1]


def test_the_page_result_shows_the_readings_of_a_step_test() -> None:
    session = sitting()
    assert identify(Path("a.h5"), session, 1).readings == ""
    shown = identify(Path("a.h5"), session, 2).readings
    assert "Ue" in shown
    assert "R7" in shown
    assert "Research use only" in shown
