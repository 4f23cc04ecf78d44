from __future__ import annotations

import json
import re
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from coded import coded, made, shows
from golden.golden_page import check_golden_page, lines_of_html
from jinja2 import UndefinedError
from reports.page_check import checked
from reports.synthetic_sitting import make_session, make_test

from tissueid.analysis import Analysis, analyse, analyse_all
from tissueid.analysis.curves.nonlinearity import SINGLE_PASS
from tissueid.analysis.curves.validation import held_out_prediction, prediction_plots, readable_stretch
from tissueid.device import SIMULATED_LINE, DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.messages import MISSING, code_of
from tissueid.records import Estimate
from tissueid.reports import ComparisonRow, ComparisonTable, report_html, session_page, write_report
from tissueid.reports.pdf import PageWriter, write_pdf
from tissueid.reports.session_page import signals_figure
from tissueid.reports.style import to_svg
from tissueid.reports.tables import named_text, parameter_table, readable_date, score_table, settings_tables
from tissueid.reports.verdict import FROM_ELSEWHERE, NOT_JUDGED, judge, key_numbers
from tissueid.sessions import Session, Subject
from tissueid.sessions.quality import HEADLINES, Quality
from tissueid.test_settings import PROPERTIES

Analyses = dict[int, dict[str, Analysis]]

WARNING = "mind the gap"
COMPARISON = ComparisonTable(
    0.0148,
    (
        ComparisonRow("mass_kg", "kg", Estimate(0.0912, 0.0011), 0.0902, Estimate(0.0870, 0.0030)),
        ComparisonRow("Stiffness", "N/m", Estimate(4700.0), 5000.0, Estimate(4300.0, 120.0)),
    ),
)
FIGURES = (
    "Signals",
    "Power spectra",
    "Mean squared coherence",
    "Distributions of input and output",
    "Bode diagram",
    "Impulse response",
    "Static nonlinearity and stiffness",
    "How the Wiener iteration settled",
    "Measured and predicted",
    "Measured against predicted",
    "What the models leave over",
)
SECTIONS = (
    "What was recorded",
    "Linear description",
    "Nonlinear description",
    "Against unseen data",
    "Parameters and scores",
    "Warnings",
    "Against the plant’s own values",
    "Settings of test and analysis",
    "Active calibration",
    "Engine: Wiener",
)


@pytest.fixture(scope="module")
def source(session: Session, analyses: Analyses) -> str:
    return report_html(session, analyses, comparison=COMPARISON)


def without_times(text: str) -> str:
    return re.sub(r"<td>\d+\.\d{3}</td>", "<td></td>", text)


def test_page_has_every_section_and_stays_small(source: str, session: Session) -> None:
    assert len(source.encode()) < 3_000_000
    found = checked(source)
    for heading in (*FIGURES, *SECTIONS):
        assert heading in found.text, heading
    assert "Left out" not in found.text
    assert len(found.named("svg")) == len(FIGURES) + 5
    for fact in ("TID-0042", "4 May 2026, 09:30 UTC", "Left posterior forearm", "SIM-7", session.session_id):
        assert fact in found.text, fact
    assert "Research use only" in found.text


def test_dates_are_local_and_say_how_far_from_utc(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TZ", "Europe/Berlin")
    time.tzset()
    assert readable_date("2026-05-04T09:30:00Z") == "4 May 2026, 11:30 UTC+02:00"
    assert readable_date("2026-05-04T09:30:00") == "4 May 2026, 09:30"
    assert readable_date("yesterday") == "yesterday"
    monkeypatch.undo()
    time.tzset()


def test_numbers_are_in_peoples_units(source: str, analyses: Analyses) -> None:
    text = checked(source).text
    mass = analyses[1]["lms"].model.report.parameters["mass_kg"]
    shown = re.search(r"Mass\s+([\d.]+)\s+± ([\d.]+) g", text)
    assert shown is not None
    assert float(shown.group(1)) == pytest.approx(1e3 * mass.value, rel=0.02)
    assert re.search(r"Mass \(g\)\s+91.2 ± 1.1\s+90.2\s+\+1.1\s+\+0.9\s+87.0 ± 3.0", text)
    assert re.search(r"Stiffness \(N/m\)\s+4700\s+5000\s+−6.0\s+—\s+4300 ± 120", text)
    assert "14.8 mm on the actuator" in text
    for label in ("Position (mm)", "Force (N)", "Frequency (Hz)", "Phase (°)", "Lag (ms)", "Magnitude (mm/N)"):
        assert label in text, label


def test_same_data_gives_the_same_page(session: Session) -> None:
    first, again = (report_html(session, {2: {"lms": analyse(session, "lms", test=2)}}) for _ in range(2))
    assert without_times(first) == without_times(again)


def test_verdict_follows_the_facts(session: Session, analyses: Analyses) -> None:
    test, found = session.test(1), analyses[1]

    def with_scores(seen: float, unseen: float | None) -> dict[str, Analysis]:
        changes = {"vaf_percent": seen, "vaf_validation_percent": unseen}
        return {name: replace(a, model=a.model.with_report(**changes)) for name, a in found.items()}

    assert (judge(test, found).level, judge(test, found).headline) == ("check", NOT_JUDGED)
    test = replace(test, notes=test.notes | Quality(()).as_notes())
    assert judge(test, found).level == "good"
    assert not judge(test, found).reasons
    assert judge(test, with_scores(38.0, 31.0)).level == "poor"
    assert judge(test, with_scores(38.0, None)).level == "poor"
    assert judge(test, with_scores(38.0, float("nan"))).level == "poor"
    assert judge(test, with_scores(65.0, 64.0)).level == "check"
    assert code_of(judge(test, with_scores(71.0, 95.0)).reasons[0]) == "verdict.drift"
    assert code_of(judge(test, with_scores(95.0, 75.0)).reasons[0]) == "verdict.worse_held_out"
    for status in ("aborted", "recovered"):
        ended = judge(replace(test, status=status), found)
        assert (ended.level, ended.headline, len(ended.reasons)) == ("poor", HEADLINES["repeat"], 1)
    imported = replace(test, notes=test.notes | {"source_format": "csv"})
    assert judge(imported, with_scores(38.0, 31.0)).headline == FROM_ELSEWHERE
    for name, level in (("lms", "check"), ("wiener", "good")):
        warned = replace(found[name], model=found[name].model.with_report(warnings=(WARNING,)))
        assert judge(test, found | {name: warned}).level == level
        reasons = (f"LMS: {WARNING}.",) if level == "check" else ()
        assert judge(test, found | {name: warned}).reasons == reasons


@pytest.mark.usefixtures("undrawn")
def test_warnings_are_listed_once_with_their_engines(session: Session, analyses: Analyses) -> None:
    warned = {name: replace(a, model=a.model.with_report(warnings=(WARNING,))) for name, a in analyses[1].items()}
    text = checked(report_html(session, {1: warned})).text
    assert f"LMS, Spectral, Wiener: {WARNING}" in text
    assert HEADLINES["look"] in text


def test_hostile_strings_stay_text() -> None:
    evil = "</title><script>alert(1)</script><img src=x onerror=alert(2)> & \"'\x00\u202e$^$ ${7*7}{{7*7}}"
    deep = {"deep": {"deeper": {"deepest": {"last": 1}}}}
    whole = make_test()
    test = replace(
        whole,
        signals=whole.signals | {evil: whole.signals["position"]},
        site=evil,
        kind=evil,
        configuration=evil,
        notes={"operator_note": evil, evil: evil, "events": json.dumps([{"kind": evil, "count": 3}, evil, None])},
        stimulus={evil: {evil: [evil, float("nan"), None, deep]}, "n": 10**400, "force_n": 10**400},
    )
    instrument = replace(make_session().instrument, model=evil, serial_number=evil, calibration={evil: evil})
    session = make_session(
        test,
        subject=Subject(evil, {evil: evil}),
        created=evil,
        software=evil,
        session_id=evil,
        instrument=instrument,
    )
    found = checked(report_html(session, {1: {"lms": analyse(session, "lms", output_name=evil)}}))
    assert "alert(1)" in found.text
    assert "{{7*7}}" in found.text
    assert "\x00" not in found.text
    assert "\u202e" not in found.text
    assert not found.named("img")


@pytest.mark.parametrize(
    ("events", "shown"),
    [
        ("", "none"),
        ("not json", "not json"),
        ("[" * 5000, "[[["),
        ("7", "7"),
        ('{"kind": "gap", "count": 3}', "Kind: gap; Count: 3"),
        ('[{"kind": "gap"}, {"kind": "fault"}]', "Kind: gap; Kind: fault"),
        ("[NaN, null]", "—; not set"),
    ],
)
def test_events_of_any_kind_are_shown(session: Session, events: str, shown: str) -> None:
    test = replace(session.test(1), notes={"events": events, "reason": "the probe slipped"})
    rows = dict(settings_tables(session, test, {})[1].rows)
    assert shown in rows["Events"]
    assert rows["Reason"] == "the probe slipped"


def test_stimulus_within_stimulus_is_laid_flat(session: Session) -> None:
    rows = dict(settings_tables(session, session.test(1), {})[2].rows)
    assert rows == {"Type": "guided", "Preload": "0.3 s", "Stimulus: Type": "noise", "Cutoff": "150 Hz"}


@pytest.mark.usefixtures("undrawn")
def test_force_and_position_alone_are_enough() -> None:
    whole = make_test(seconds=2.0)
    test = replace(
        whole,
        signals={name: whole.signals[name] for name in ("force", "position")},
        preload_s=0.0,
        surface_position_m=float("nan"),
        stimulus={},
        site="",
    )
    session = make_session(test, subject=Subject(""))
    found = checked(report_html(session, {1: analyse_all(session, ("lms", "spectral"))}))
    assert shows(found.text, "record.no_voltage")
    assert shows(found.text, "report.no_stimulus")
    assert len(found.named("svg")) == len(FIGURES) - 2
    assert found.text.count(made("report.engine_not_run", engine="Wiener")) == 2


@pytest.mark.usefixtures("undrawn")
def test_a_test_along_the_tissue_has_no_surface_below_which_it_goes(
    session: Session, analyses: Analyses, source: str
) -> None:
    test = replace(session.test(1), configuration="surface")
    along = re.sub(r"\s+", " ", report_html(replace(session, tests=(test,)), {1: analyses[1]}))
    into = re.sub(r"\s+", " ", source)
    assert "Where it began" in along
    assert "where it began" in along
    for words in ("surface of the tissue", "Surface of the tissue", "below the surface"):
        assert words not in along
        assert words in into


def test_what_cannot_be_told_from_zero_is_called_uncertain(analyses: Analyses) -> None:
    lms = analyses[1]["lms"]
    report = replace(
        lms.model.report,
        parameters=lms.model.report.parameters
        | {"mass_slope_kg_per_m": Estimate(0.7, 1.1), "stiffness_slope_n_per_m2": Estimate(-7.0, 1.1)},
    )
    table = parameter_table({"lms": replace(lms, model=replace(lms.model, report=report))})
    assert table is not None
    cells = {row[0]: row[2] for row in table.rows}
    assert cells["Mass slope"].endswith(", uncertain")
    assert "uncertain" not in cells["Stiffness slope"]
    assert "called uncertain" in table.note


@pytest.mark.usefixtures("undrawn")
def test_lost_samples_are_counted_and_left_out() -> None:
    test = make_test(seconds=2.0)
    signals = {name: values.copy() for name, values in test.signals.items()}
    for first in (200, 1100, 2200):
        for name in signals.keys() - {"time"}:
            signals[name][first : first + 25] = np.nan
    session = make_session(replace(test, signals=signals, notes={"samples_lost": 75.0}))
    found = checked(report_html(session, {1: analyse_all(session, ("lms", "spectral"))}))
    assert shows(found.text, "record.lost_samples")
    assert "■ not received" in found.text
    assert shows(found.text, "verdict.samples_lost", lost=75, samples=2300, percent="3.3")
    assert shows(found.text, "report.engine_not_run", engine="Wiener")


@pytest.mark.usefixtures("undrawn")
def test_very_short_test_says_what_is_missing() -> None:
    session = make_session(make_test(seconds=0.06))
    found = checked(report_html(session, {1: {"lms": analyse(session, "lms", {"memory": 0.005})}}))
    assert shows(found.text, "report.engine_not_run", engine="Spectral")
    assert "too short" in found.text
    assert "too few samples" in found.text


@pytest.mark.usefixtures("undrawn")
def test_other_signals_and_forms() -> None:
    session = make_session(make_test(seconds=2.0))
    options = {"nonlinearity": "polynomial", "iterations": 1, "refine": False}
    found = checked(
        report_html(
            session,
            {
                1: {
                    "wiener": analyse(session, "wiener", options, input_name="voltage"),
                    "spectral": analyse(session, "spectral", input_name="voltage"),
                }
            },
        )
    )
    assert str(SINGLE_PASS) in found.text
    assert shows(found.text, "report.engine_not_run", engine="LMS")
    assert "mm/V" in found.text


def test_validation_on_another_test(session: Session) -> None:
    analysis = analyse(session, "lms", test=1, validate=2)
    prediction = held_out_prediction("LMS", analysis)
    assert prediction.measured.size == len(session.test(2).record())
    stretch = readable_stretch(prediction)
    assert stretch.start >= prediction.memory_samples - 1 or np.isfinite(prediction.residual[stretch]).all()
    assert [len(plot.curves) for plot in prediction_plots([prediction])] == [2, 1]


def test_nothing_to_report_is_refused(session: Session, analyses: Analyses) -> None:
    for nothing in ({}, {1: {}}):
        with pytest.raises(UnusableInputError, check=coded("report.nothing_analysed")):
            report_html(session, nothing)
    with pytest.raises(UnusableInputError, check=coded("session.no_test", number=7)):
        report_html(session, {7: analyses[1]})


@pytest.mark.usefixtures("undrawn")
def test_written_whole_or_not_at_all(
    session: Session, analyses: Analyses, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "report.html"
    path.write_text("before", encoding="utf-8")
    only = {1: {"lms": analyses[1]["lms"]}}

    def full_disk(*_: object, **__: object) -> None:
        raise OSError("no space left")

    with monkeypatch.context() as broken:
        broken.setattr(Path, "replace", full_disk)
        with pytest.raises(OSError, match="no space"):
            write_report(path, session, only)
    assert [item.name for item in tmp_path.iterdir()] == ["report.html"]
    assert path.read_text(encoding="utf-8") == "before"
    write_report(path, session, only, title="Third visit <2>")
    assert [item.name for item in tmp_path.iterdir()] == ["report.html"]
    assert "Third visit <2>" in checked(path.read_text(encoding="utf-8")).text


def test_template_refuses_what_it_does_not_know() -> None:
    with pytest.raises(UndefinedError):
        session_page.template("report.html.j2").render(title="only this")


def test_users_own_settings_neither_matter_nor_change(session: Session) -> None:
    plain = to_svg(signals_figure(session.test(1)), "s", "signals")
    with mpl.rc_context({"lines.linewidth": 7.0, "svg.fonttype": "path", "axes.grid": False}):
        before = dict(mpl.rcParams)
        assert to_svg(signals_figure(session.test(1)), "s", "signals") == plain
        assert dict(mpl.rcParams) == before


def test_no_window_no_port() -> None:
    unwanted = {"matplotlib.pyplot", "PySide6", "pyqtgraph", "serial"}
    code = f"import sys, tissueid.reports; assert not {unwanted} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_two_threads_draw_the_same_figure(session: Session) -> None:
    drawn: list[str] = []

    def draw() -> None:
        drawn.append(to_svg(signals_figure(session.test(1)), "s", "signals"))

    threads = [threading.Thread(target=draw) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(drawn) == 3
    assert len(set(drawn)) == 1


def test_parameters_of_an_engine_that_predicts_nothing_are_left_out(session: Session, analyses: Analyses) -> None:
    found = {
        name: replace(analysis, model=analysis.model.with_validation(-3.1, 0.6))
        for name, analysis in analyses[1].items()
    }
    assert parameter_table(found) is None
    assert all("predicts nothing" in row[2] for row in score_table(found).rows)
    assert [number.label for number in key_numbers(found)] == [
        "Motion explained, linear",
        "Motion explained, nonlinear",
    ]
    one = {**analyses[1], "lms": found["lms"]}
    table = parameter_table(one)
    assert table is not None
    column = 2 + list(one).index("lms")
    assert {row[column] for row in table.rows} == {MISSING}
    assert judge(session.test(1), found).level == "poor"


@pytest.mark.usefixtures("undrawn")
def test_html_and_pdf_of_a_simulation_say_so(session: Session, analyses: Analyses, tmp_path: Path) -> None:
    real = replace(session, instrument=DeviceDescription(serial_number="D-17"))
    played = replace(session, instrument=DeviceDescription(serial_number="TWIN-0"))
    drawn: dict[str, list[str]] = {}
    for name, one in (("real", real), ("played", played)):
        lines = drawn.setdefault(name, [])
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(PageWriter, "line", lambda _self, words, lines=lines, **_: lines.append(words))
            write_pdf(tmp_path / f"{name}.pdf", one, one.test(1), analyses[1])
    assert [SIMULATED_LINE in drawn[name] for name in ("real", "played")] == [False, True]
    pages = [report_html(one, {1: analyses[1]}) for one in (real, played)]
    assert [SIMULATED_LINE in checked(page).text for page in pages] == [False, True]


def test_the_report_of_a_test_reads_as_its_golden_page(source: str) -> None:
    """Renew the page by ``python tests/golden/renew.py``."""
    check_golden_page("report-test", lines_of_html(source))


def test_settings_have_the_labels_of_the_form_without_its_marks_of_keys():
    assert named_text("external_spring_n_per_m", 500.0) == ("External spring", "500 N/m")
    assert named_text("coupling", "tape") == ("Coupling", "Double-sided tape")
    assert named_text("orientation_deg", 90.0)[1] == "90° horizontal, across the limb"
    assert not any("&" in named_text(name, 1.0)[0] for name in PROPERTIES)
