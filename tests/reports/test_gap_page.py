"""The page of a diagnosis, on a short recording of the simulated laboratory."""

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from coded import shows
from golden.golden_page import check_golden_page, lines_of_html
from reports.in_german import SAME, in_both, in_each_language, shown
from reports.page_check import checked

from firmware_sim.effects import LISTED
from firmware_sim.laboratory.scenario_generation import NOMINAL, draw_scenario
from tissueid.device import DeviceDescription
from tissueid.gap.diagnosis import Diagnosis, NextExperiment, diagnose
from tissueid.gap.diagnosis_plots import largest_held_out_error
from tissueid.gap.preparation import prepare
from tissueid.gap.statement import headline_of, next_steps_of
from tissueid.gap.workers import SerialExecutor
from tissueid.reports.gap_page import DiagnosisOrigin, gap_html
from tissueid.reports.gap_panels import gap_panels
from tissueid.reports.page import write_text_atomically
from tissueid.sessions import Session, Subject, Test

EFFECT = "quadratic_drag"
SAMPLES = 3000


@cache
def diagnosis() -> Diagnosis:
    scenario = draw_scenario(3, without=tuple(name for name in LISTED if name != EFFECT))
    recording = scenario.record()[0]
    signals = {
        name: getattr(recording, name)[:SAMPLES] for name in ("time", "command", "voltage", "current", "position")
    }
    test = Test(1, "stochastic", signals, 2000.0, preload_s=0.5, surface_position_m=recording.surface_m)
    device = DeviceDescription(**{**NOMINAL, "serial_number": "<b>A&B</b>"})
    return diagnose(prepare(Session(device, tests=(test,))), SerialExecutor(), candidates=[EFFECT])


def as_effect() -> Diagnosis:
    found = diagnosis()
    ranking = tuple(replace(item, indistinguishable=("dry_friction",)) for item in found.ranking)
    step = NextExperiment("spring", "the spring shows the moving part alone", (EFFECT, "dry_friction"))
    return replace(found, verdict="effect", combination=(EFFECT,), ranking=ranking, next_experiment=step)


@pytest.mark.usefixtures("undrawn")
def test_the_page_tells_where_which_how_far_and_what_next():
    text = checked(gap_html(as_effect())).text
    for words in (
        "The gap is explained: ",
        "Moving part",
        "Where it lies",
        "Which cause",
        "How far it closes",
        "What to do next",
        "Run a test of the kind “spring”",
        "This data cannot separate the cause from",
        "Gap before",
        "Noise alone",
    ):
        assert words in text


def test_every_picture_is_drawn():
    drawn = {panel.key: panel.picture() for panel in gap_panels(as_effect())}
    always = {"chain", "frequency", "depth", "speed", "surface", "time", "ranking", "budget", "overlay"}
    assert set(drawn) == always | {"current", "amplitude"}
    assert all(picture.figure is not None for picture in drawn.values())


@pytest.mark.usefixtures("undrawn")
def test_current_size_and_phase_of_the_mains_are_told_where_they_matter():
    found = as_effect()
    phases = replace(found.where.regions.profiles["depth_m"], edges=np.linspace(0.0, 2.0 * np.pi, 13))
    regions = replace(
        found.where.regions,
        profiles=found.where.regions.profiles | {"mains_phase_rad": phases},
        mains_hz=49.97,
        above=found.where.regions.above
        | {
            "current_a": ((0.2, 0.6),),
            "amplitude_n": ((1.5, 2.5),),
            "mains_phase_rad": ((0.0, np.pi / 2.0),),
        },
    )
    found = replace(found, where=replace(found.where, regions=regions))
    text = checked(gap_html(found)).text
    assert shows(text, "gap.at_currents", spans="0.2 to 0.6 A")
    assert shows(text, "gap.at_amplitudes", spans="1.5 to 2.5 N")
    assert shows(text, "gap.at_mains_phases", hertz="50", spans="0 to 90 degrees")
    assert "mains" in {panel.key for panel in gap_panels(found)}


@pytest.mark.usefixtures("undrawn")
def test_no_gap_and_unexplained_are_said_so():
    found = diagnosis()
    page = checked(gap_html(replace(found, verdict="no_gap", combination=(), best=None, ranking=())))
    assert "No gap" in page.text
    assert shows(page.text, "gap.nothing_to_do")
    page = checked(gap_html(replace(found, verdict="unexplained", combination=(), next_experiment=None)))
    assert shows(page.text, "gap.unexplained")
    assert shows(page.text, "gap.look_at_stage")


def test_remarks_and_names_from_files_are_text():
    page = gap_html(replace(as_effect(), remarks=("test 4 is left out: <script>",)))
    assert "<script>" not in page
    assert "<b>A&B</b>" not in page
    assert "test 4 is left out" in checked(page).text


@pytest.mark.usefixtures("undrawn")
def test_the_page_is_written_whole_or_not_at_all(tmp_path):
    target = tmp_path / "gap.html"
    write_text_atomically(target, gap_html(as_effect()))
    assert target.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    with pytest.raises(FileNotFoundError):
        write_text_atomically(tmp_path / "missing" / "gap.html", gap_html(as_effect()))
    assert [item.name for item in tmp_path.iterdir()] == ["gap.html"]


@pytest.mark.usefixtures("undrawn")
def test_the_page_says_what_was_diagnosed_and_what_to_type():
    found = as_effect()
    tests = tuple(Test(number, "stochastic", {}, 2000.0, site=f"site {number}") for number in (1, 2))
    session = Session(found.dataset.instrument, Subject("P-007"), tests, created="2026-03-01T10:00:00")
    origin = DiagnosisOrigin(session, Path("some where/third.h5"))
    text = checked(gap_html(found, origin=origin)).text
    for words in ("third.h5", "1 March 2026, 10:00", "P-007", "site 1", "1 stochastic"):
        assert words in text
    assert "site 2" not in text, "it was not diagnosed"
    assert "tissueid gap accept 'some where/third.h5' --out TWIN.toml" in text
    assert not any("tissueid" in line for line in next_steps_of(found)), "in the window a button does it"


@pytest.mark.usefixtures("undrawn")
def test_words_are_explained_and_stages_are_called_alike():
    text = checked(gap_html(as_effect())).text
    assert "floors" not in text
    assert "announced" not in text
    assert shows(text, "report.gap.predicted")
    assert "as a multiple of the noise" in text
    assert "moving part (mechanics)" in text
    assert shows(text, "report.gap.not_shares")
    assert "quiet test" not in text, "there was none"


def test_a_named_cause_is_good_news_and_none_asks_for_a_look():
    assert headline_of(as_effect())[1] == "good"
    assert headline_of(replace(as_effect(), verdict="unexplained", combination=()))[1] == "check"


@pytest.mark.usefixtures("undrawn")
def test_parameters_have_three_digits_their_deviation_unit_and_meaning():
    found = replace(as_effect(), best=next(iter(as_effect().search_result.singles)))
    text = " ".join(checked(gap_html(found)).text.split())
    assert re.search(r"Force \d[\d.]* ± [\d.]+ N force at 50 mm/s", text)
    assert re.search(r"Exponent \d\.\d{0,2} ± [\d.]+ power of speed", text)


@pytest.mark.usefixtures("undrawn")
def test_a_column_that_is_empty_in_every_row_is_left_out():
    full = as_effect()
    bare = tuple(replace(item, indistinguishable=(), closed_ci=(np.nan, np.nan)) for item in full.ranking)
    assert '<th scope="col">Not separable</th>' in gap_html(full)
    page = gap_html(replace(full, ranking=bare))
    assert '<th scope="col">Not separable</th>' not in page
    assert '<th scope="col">95 %</th>' not in page
    assert '<th scope="col">Closed</th>' in page


def test_the_overlay_shows_a_stretch_in_which_the_signal_moves():
    found = as_effect()
    test, first, last = largest_held_out_error(found, "position")
    size = last - first
    shifted = test.signals["position"].copy()
    rest = next(
        start
        for start in range(0, shifted.size - size, size // 2)
        if (test.purpose[start : start + size] > 1).all() and not first - size < start < last
    )
    shifted[rest : rest + size] = shifted[rest] + 0.05
    resting = replace(test, signals=test.signals | {"position": shifted})
    chosen = largest_held_out_error(replace(found, dataset=replace(found.dataset, tests=(resting,))), "position")
    assert chosen[1:] != (rest, rest + size)
    assert np.std(shifted[chosen[1] : chosen[2]]) > 1e-4


@pytest.mark.usefixtures("undrawn")
def test_the_page_of_a_diagnosis_says_nothing_in_english():
    said = in_each_language(lambda: shown(gap_html(as_effect())))
    same = {"desktop indenter, <b>A&B</b>", "Tests", "Signal", "Position (µm/√Hz)", "linear", "Parameter", "Exponent"}
    assert in_both(said, SAME | same) == set()


@pytest.mark.usefixtures("undrawn")
def test_the_report_of_a_diagnosis_reads_as_its_golden_page():
    """Renew the page by ``python tests/golden/renew.py``."""
    check_golden_page("report-gap", lines_of_html(gap_html(as_effect())))
