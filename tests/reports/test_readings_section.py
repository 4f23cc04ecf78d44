"""Readings in the report of a step test and on the page Result, and the parameters that a test does not determine."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from analysis import simulated_steps as steps
from reports.synthetic_sitting import make_session, make_test
from scipy.signal import lfilter

from tissueid.analysis import analyse_all
from tissueid.app.identifying import identify
from tissueid.messages import MISSING
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


def test_a_mass_that_the_test_does_not_determine_is_no_number() -> None:
    time = np.arange(3000) / 1000.0
    force = 4.0 + 2.5 * np.sin(6.0 * time**2)
    decay = np.exp(-3200.0 / 39.0 / 1000.0)
    position = 0.015 + lfilter([1.0 - decay], [1.0, -decay], force - 4.0) / 3200.0
    signals = {"time": time, "force": force, "position": position}
    numbers = identify(Path("a.h5"), make_session(Test(1, "stochastic", signals, 1000.0)), 1).numbers
    assert [number.value == MISSING for number in numbers] == [True, False, False, False, False]
    assert numbers[0].estimate is None
