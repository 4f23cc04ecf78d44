"""Figures of stimuli: what they show is what was designed, and every form of file is whole."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from coded import coded, made
from golden.golden_page import check_golden_page, lines_of_html
from matplotlib.figure import Figure
from reports.in_german import english_in, in_german, shown, texts_of
from reports.page_check import checked

from tissueid.analysis.curves.feedback import FeedbackRun, settling_plot
from tissueid.analysis.curves.signals import amplitude_plots
from tissueid.analysis.stimulus_design import StimulusDesign
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.identification.second_order import SecondOrder
from tissueid.messages import code_of
from tissueid.reports.page import Panel, draw_sheet
from tissueid.reports.stimulus_page import (
    feedback_panels,
    feedback_report,
    feedback_run,
    option_rows,
    run_from_report,
    stimulus_panels,
    stimulus_report,
)
from tissueid.sessions import Test
from tissueid.stimuli import get_stimulus, stimulus_names, with_preload
from tissueid.stimuli.kinds.designed import Designed
from tissueid.stimuli.kinds.interchange import Interchange
from tissueid.stimuli.stimulus_check import assess_stimulus

RATE = 2000.0


def design(kind: str, preload: bool = False, **options: Any) -> StimulusDesign:
    specification = get_stimulus(kind).from_options({"seconds": 1.0} | options if kind != "multisine" else options)
    search = None
    if isinstance(specification, Interchange):
        search = specification.design()
        built = specification.stimulus_from(search)
    else:
        built = specification.build()
    built = with_preload(built) if preload else built
    found = assess_stimulus(built, DeviceDescription(), max_force_n=12.0, max_seconds=30.0, max_temperature_c=80.0)
    return StimulusDesign(built, DeviceDescription(), found, search)


def drawn(made: StimulusDesign) -> dict[str, Figure]:
    """The panels that can be drawn, by their keys."""
    pictures = [panel.picture() for panel in stimulus_panels(made)]
    return {picture.key: picture.figure for picture in pictures if picture.figure is not None}


def line(figure: Figure, label: str, place: int = 0) -> tuple[np.ndarray, np.ndarray]:
    found = next(item for item in figure.axes[place].get_lines() if item.get_label() == label)
    return np.asarray(found.get_xdata()), np.asarray(found.get_ydata())


def test_noise_is_drawn_beside_what_was_asked_for():
    made = design("noise", distribution="uniform", force_min_n=1.0, force_max_n=5.0, preload=True)
    figures = drawn(made)
    assert set(figures) == {"time-series", "amplitudes", "power", "autocorrelation"}
    _, plot = amplitude_plots(made.played, "N", made.intended_amplitudes)
    levels, share = plot.curve("intended").x, plot.curve("intended").y
    np.testing.assert_allclose(levels, np.linspace(1.0, 5.0, 2000), atol=1e-12)
    np.testing.assert_allclose(share, 100.0 * (np.arange(2000) + 0.5) / 2000)
    np.testing.assert_allclose(plot.curve("played").x, levels, atol=1e-9)
    zoomed = figures["time-series"].axes[1]
    assert zoomed.get_xlim() == pytest.approx((500.0, 700.0))  # after the preload
    assert {"Force (N)", "Command (V)"} <= {axes.get_ylabel() for axes in _every_axis(figures["time-series"])}


def _every_axis(figure: Figure) -> list[Any]:
    return [*figure.axes, *(child for axes in figure.axes for child in axes.child_axes)]


def test_targets_of_power_and_autocorrelation_are_those_of_the_kind():
    made = design("noise", spectrum="band", cutoff_hz=100.0)
    figures = drawn(made)
    frequency, density = line(figures["power"], "target")
    assert frequency.max() <= 100.0
    np.testing.assert_allclose(np.trapezoid(density, frequency), np.var(made.played), rtol=0.05)
    _, target = line(figures["autocorrelation"], "target")
    np.testing.assert_allclose(target, np.sinc(2.0 * 100.0 * np.arange(501) / RATE), atol=1e-9)
    about = made.played - made.played.mean()
    plain = [float(about[: about.size - k] @ about[k:]) / float(about @ about) for k in range(501)]
    _, found = line(figures["autocorrelation"], "played")
    np.testing.assert_allclose(found, plain, atol=1e-12)
    error = made.autocorrelation_error
    assert error == pytest.approx(float(np.sum((np.array(plain) - target) ** 2)), rel=1e-9)


def test_an_interchange_shows_how_it_converged():
    made = design("interchange", seconds=0.5, spectrum="band", lags=100, tolerance=1e-5)
    assert made.search is not None
    assert made.search.accepted > 0
    figure = drawn(made)["swaps"]
    swaps, error = (np.asarray(data) for data in figure.axes[0].get_lines()[0].get_data())
    assert swaps[-1] == made.search.accepted
    assert np.all(np.diff(error) <= 0.0)
    assert error[-1] == pytest.approx(made.autocorrelation_error, rel=1e-6)
    assert made.amplitude_distance == 0.0


def test_a_search_that_swapped_nothing_says_so():
    made = design("interchange", seconds=0.5, spectrum="band", lags=50, tolerance=1.0)
    panel = {one.key: one for one in stimulus_panels(made)}["swaps"]
    assert code_of(panel.picture().missing.values["reason"]) == "report.no_swaps"


def test_lines_of_a_multisine_are_sorted_by_what_they_are_for():
    made = design("multisine", period_s=0.5, periods=2, notches=[[40.0, 60.0]])
    figure = drawn(made)["lines"]
    kind: Any = made.specification
    driven, amplitude = line(figure, "driven")
    np.testing.assert_allclose(driven, kind.driven_lines() * 2.0)
    assert amplitude.min() > 0.1
    detection, empty = line(figure, "detection")
    np.testing.assert_allclose(detection, kind.detection_lines() * 2.0)
    assert empty.max() < 1e-8
    assert not np.any((driven >= 40.0) & (driven <= 60.0))


def test_volts_are_drawn_as_volts():
    figures = drawn(design("noise", distribution="binary", voltage_min_v=2.0, voltage_max_v=12.0))
    assert {"Voltage (V)", "Force at rest (N)"} <= {a.get_ylabel() for a in _every_axis(figures["time-series"])}
    assert figures["power"].axes[0].get_ylabel() == made("stimulus.power_density", signal="Voltage", unit="V")


@pytest.mark.parametrize(
    ("form", "begins"), [(".svg", b"<?xml"), (".png", b"\x89PNG"), (".pdf", b"%PDF"), (".html", b"<!DOCTYPE html>")]
)
def test_every_form_of_file(tmp_path: Path, form: str, begins: bytes):
    path = tmp_path / f"plot{form}"
    stimulus_report(design("noise")).write(path)
    assert path.read_bytes().startswith(begins)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


def test_the_page_is_whole_and_says_what_to_know():
    page = checked(stimulus_report(design("noise", distribution="binary", force_max_n=11.0)).html())
    for words in ("read the cautions first", "Crest factor", "Distribution of amplitudes"):
        assert words in page.text


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("noise", {"distribution": "binary", "force_max_n": 11.0, "preload": True}),
        ("interchange", {"seconds": 0.5, "spectrum": "band", "lags": 100, "tolerance": 1e-5}),
        ("multisine", {"period_s": 0.5, "periods": 2, "notches": [[40.0, 60.0]]}),
        ("designed", {"seconds": 2.0, "preload": True}),
    ],
)
def test_the_report_of_a_stimulus_says_nothing_in_english(undrawn: None, kind: str, options: dict[str, Any]):
    made = design(kind, **options)
    texts = in_german(lambda: shown(stimulus_report(made).html()))
    drawn = in_german(lambda: [text for panel in stimulus_panels(made) for text in texts_of(panel.picture())])
    assert english_in(texts + drawn, (made.device.model, made.device.serial_number, kind)) == []


def test_the_report_of_a_feedback_stimulus_says_nothing_in_english(undrawn: None):
    kind: Any = get_stimulus("rtig").from_options({})
    runs = [swept(), swept(REPORT | {"identification": None})]
    texts = in_german(lambda: shown(feedback_report(kind, runs, ()).html()))
    drawn = in_german(lambda: [text for panel in feedback_panels(runs) for text in texts_of(panel.picture())])
    assert english_in(texts + drawn, ("spring",)) == []


@pytest.mark.parametrize("kind", stimulus_names())
def test_options_of_every_stimulus_have_german_labels(kind: str):
    rows = in_german(lambda: option_rows(dict.fromkeys(get_stimulus(kind).model_fields, 1.0)))
    assert english_in([label for label, _value in rows]) == []


def test_another_name_is_refused(tmp_path: Path):
    with pytest.raises(UnusableInputError, check=coded("report.unknown_form", name="plot.jpg")):
        stimulus_report(design("noise")).write(tmp_path / "plot.jpg")


def test_a_sheet_leaves_out_what_cannot_be_drawn():
    def nothing(_figure: object) -> None:
        raise UnusableInputError("there is none")

    def something(figure: Any) -> None:
        figure.subplots().plot([1.0, 2.0])

    panels = [Panel(str(k), "", "", "", draw, wide=False) for k, draw in enumerate((something, nothing, something))]
    assert len(_axes(draw_sheet("Both", panels))) == 2
    with pytest.raises(UnusableInputError, check=coded("report.nothing_to_draw")):
        draw_sheet("None", panels[1:2])


def _axes(figure: Figure) -> list[Any]:
    return [axes for part in (figure, *figure.subfigs) for axes in part.axes]


# -- feedback -------------------------------------------------------------------------------------------------

REPORT = {
    "edges_m": np.linspace(0.0, 0.004, 11).tolist(),
    "desired": [0.1] * 10,
    "identification": {
        "levels": [
            {"depth_m": d, "mass_kg": 0.08, "damping_n_s_per_m": 8.0, "stiffness_n_per_m": 1e3 + 1e6 * d, "samples": 90}
            for d in (0.001, 0.002, 0.003)
        ]
    },
}


def swept(report: dict[str, Any] | None = None) -> FeedbackRun:
    """A spring under a triangular force: depth even over 0 to 4 mm."""
    force = 4.0 * np.abs(2.0 * ((np.arange(4000) / 500.0) % 1.0) - 1.0)
    force += 0.05 * np.random.default_rng(1).standard_normal(4000)
    return run_from_report(report or REPORT, force, 1e-3 * np.convolve(force, [0.5, 0.3, 0.2])[:4000], RATE, "spring")


def test_distance_is_the_largest_gap_between_the_shares():
    run = FeedbackRun("", np.zeros(4), np.array([0.5, 1.5, 2.5, np.nan]), RATE, np.array([0.0, 2.0]), np.ones(1))
    assert run.distance == pytest.approx(0.75 - 1.0 / 3.0)  # just under 1.5: one of three below, 0.75 wanted
    assert swept().distance < 0.03


def test_runs_are_drawn_side_by_side():
    runs = [swept(), swept()]
    pictures = {panel.key: panel.picture().figure for panel in feedback_panels(runs)}
    series = pictures["feedback-series"]
    assert series is not None
    assert len(series.axes) == 4
    distributions = pictures["feedback-distributions"]
    assert distributions is not None
    assert len(distributions.axes) == 8
    parameters = pictures["feedback-parameters"]
    assert parameters is not None
    assert parameters.axes[2].get_ylabel() == "Stiffness (N/m)"


def test_settling_times_stand_beside_block_and_memory():
    times = {"block_s": 0.025, "identification": REPORT["identification"] | {"memory_s": 0.0625}}
    plot = settling_plot([swept(REPORT | times)])
    surface = plot.surface
    assert surface is not None
    assert plot.title.values == {"mass_g": "80"}
    place = int(np.argmin(np.abs(surface.y - 8.0))), int(np.argmin(np.abs(surface.x - 1000.0)))
    assert surface.values[place] == pytest.approx(58.0, rel=0.1)  # ms
    memory = next(curve for curve in plot.curves if curve.kind == "dotted")
    for stiffness, damping in zip(memory.x[::5], memory.y[::5], strict=True):
        assert SecondOrder(0.08, damping, stiffness).settling_time_s() == pytest.approx(0.0625, rel=0.15)
    assert plot.curves[-1].x.tolist() == [2000.0, 3000.0, 4000.0]
    bare = settling_plot()
    assert bare.title.values == {"mass_g": "60"}
    assert len(bare.parts) == 1


def test_a_run_that_identified_nothing_says_so():
    run = swept(REPORT | {"identification": None})
    missing: Any = list(feedback_panels([run]))[-1].picture().missing
    assert code_of(missing.values["reason"]) == "report.no_loop_parameters"
    kind: Any = get_stimulus("rtig").from_options({})
    page = checked(feedback_report(kind, [run], (("Length", "2 s"),)).html())
    assert str(missing) in page.text


def test_a_designed_stimulus_tells_how_well_the_tissue_will_be_known():
    made = design("designed", preload=True, seconds=2.0)
    kind = made.specification
    assert isinstance(kind, Designed)
    told = dict(made.rows())["Predicted uncertainty of mass, damping, stiffness"]
    shares = [float(share) for share in told.split(" %")[0].split(", ")]
    np.testing.assert_allclose(shares, 100.0 * np.array(kind.predicted_std), rtol=0.05)
    assert all("Predicted" not in label for label, _ in design("noise").rows())


def test_a_test_is_a_run_by_its_note():
    signals = {"force": np.ones(600), "position": np.full(600, 0.012)}
    test = Test(1, "stochastic", signals, RATE, preload_s=0.1, surface_position_m=0.010)
    noted = Test(**{**vars(test), "notes": {"stimulus_report": json.dumps(REPORT)}})
    run = feedback_run(noted, "x")
    assert run.force.size == 400
    np.testing.assert_allclose(run.depth, 0.002)
    with pytest.raises(UnusableInputError, check=coded("report.no_feedback", number=1)):
        feedback_run(test, "x")


@pytest.mark.parametrize(
    "spoilt",
    [
        {"edges_m": [1.0]},
        {"edges_m": [0.0, 1.0, 1.0], "desired": [0.5, 0.5]},
        {"desired": [1.0]},
        {"desired": "x"},
        {"identification": {"levels": [{"depth_m": 1.0}]}},
        {"identification": 3},
    ],
)
def test_a_spoilt_report_is_refused(spoilt: dict[str, Any]):
    with pytest.raises(UnusableInputError, check=coded("report.no_distribution")):
        swept(REPORT | spoilt)


def test_the_report_of_a_stimulus_reads_as_its_golden_page(undrawn: None):
    """Renew the page by ``python tests/golden/renew.py``."""
    made = design("noise", distribution="binary", force_max_n=11.0)
    check_golden_page("report-stimulus", lines_of_html(stimulus_report(made).html()))
