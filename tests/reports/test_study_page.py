"""Report of a study on paper and as a page: nothing overlaps, signs are explained, simulated tests are stated."""

import itertools
from functools import partial

import numpy as np
import pandas as pd
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tissueid.analysis.curves.plot import Axis, Curve, Plot
from tissueid.analysis.curves.samples import GRIDS, KERNEL2
from tissueid.device import SIMULATED_LINE
from tissueid.messages import Verbatim
from tissueid.reports import study_page
from tissueid.reports.pdf import PageWriter
from tissueid.reports.plot_axes import turn_names
from tissueid.reports.plot_renderer import draw_plot
from tissueid.reports.study_page import _figures, _parts, _with_broken_heads, study_facts, study_html
from tissueid.reports.study_tables import study_table, study_tables
from tissueid.reports.tables import Table
from tissueid.studies.study_plots import (
    COLOURS,
    conditions_plot,
    materials_plot,
    nonlinearity_plot,
    sites_plot,
    subjects_plot,
    surface_plot,
)
from tissueid.studies.study_statistics import StudyStatistics

SITES = ("cheek", "left forearm, anterior", "right forearm, anterior")
CONDITIONS = ("", "hydrating lotion", "moisturising lotion")
MATERIALS = ("Buna-N", "acrylamide 10 %", "acrylamide 20 %", "acrylamide 30 %", "latex")
NAMES = ("scaled_mass_s2", "scaled_damping_s", "c2_per_n")


def table(subjects=4, conditions=CONDITIONS, simulated=True):
    rows = []
    for who, site, condition in itertools.product(range(subjects), SITES, conditions):
        values = 1.0 + 0.1 * who + 0.01 * len(site) + 0.02 * len(condition)
        row = {
            "subject": f"P-{who:03}",
            "site": site,
            "condition": condition,
            "created": f"2026-03-0{who + 1}T10:00:00",
        }
        row |= {"scaled_mass_s2": 2e-5 * values, "scaled_damping_s": 6e-3 * values, "c1_m": 6e-3, "c2_per_n": values}
        rows.append(row | {"simulated": simulated})
    return pd.DataFrame(rows)


def samples():
    rows = [{"material": one, **dict.fromkeys(NAMES, 1e-5 * n), "c1_m": 5e-3} for n, one in enumerate(MATERIALS, 1)]
    return pd.DataFrame(rows)


def text_boxes(page):
    """Return text and box in pixels of everything that is written on a page."""
    canvas = FigureCanvasAgg(page)
    canvas.draw()
    renderer = canvas.get_renderer()
    texts = [*page.texts, *(text for legend in page.legends for text in legend.get_texts())]
    for axes in page.axes:
        texts += [axes.xaxis.label, axes.yaxis.label, axes.title]
        for axis, ends in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
            places = zip(axis.get_ticklocs(), axis.get_ticklabels(), strict=True)
            texts += [label for place, label in places if min(ends) <= place <= max(ends)]
            texts.append(axis.get_offset_text())
    return [(text.get_text(), text.get_window_extent(renderer)) for text in texts if text.get_text().strip()]


def overlapping(page):
    pairs = itertools.combinations(text_boxes(page), 2)
    return [(a, b) for (a, one), (b, other) in pairs if one.overlaps(other)]


@pytest.mark.parametrize("kind", ["subjects", "sites", "materials", "conditions"])
def test_no_text_of_the_figures_overlaps_another_one(kind):
    means = table()
    make = {
        "subjects": lambda name: subjects_plot(means, name),
        "sites": lambda name: sites_plot(means, name),
        "materials": lambda name: materials_plot(samples(), means, name),
        "conditions": lambda name: conditions_plot(means[means["site"] != "cheek"], "", name),
    }[kind]
    paper = PageWriter()
    _figures(paper, kind, "Heading", {name: partial(make, name) for name in NAMES})
    paper.line("Next heading", size=11.0, bold=True)
    assert [pair for page in paper.pages for pair in overlapping(page)] == []
    for page in paper.pages:
        boxes = [box for _text, box in text_boxes(page)]
        assert min(box.x0 for box in boxes) >= 0.0
        assert max(box.x1 for box in boxes) <= page.bbox.width


def test_colour_bars_on_paper_move_with_their_kernels():
    values = np.linspace(-0.5, 0.5, GRIDS[KERNEL2].x.size)
    plots = {Verbatim(site): partial(surface_plot, KERNEL2, values, f"{site}, VAF 90.0 %") for site in SITES}
    paper = PageWriter()
    _figures(paper, "second-site", "Second-order kernels: sites", plots)
    page = paper.pages[-1]
    assert overlapping(page) == []
    for axes in page.axes:
        (bar,) = axes.child_axes
        image, scale = axes.get_window_extent(), bar.get_window_extent()
        assert image.x1 < scale.x0 < image.x1 + 0.2 * image.width
        assert (scale.y0, scale.y1) == pytest.approx((image.y0, image.y1), abs=0.05 * image.height)
        assert image.width == pytest.approx(image.height, rel=0.01)


def test_a_heading_and_its_key_stay_with_their_figures():
    paper = PageWriter()
    paper.y = 0.75 + 2.8  # a row fits, but not with heading and key
    means = table()
    _figures(paper, "subjects", "Heading", {name: partial(subjects_plot, means, name) for name in NAMES})
    assert [bool(page.axes) for page in paper.pages] == [False, True]
    assert [len(page.legends) for page in paper.pages] == [0, 1]


def test_a_power_of_ten_stands_in_the_label_of_the_ordinate():
    axes = Figure().subplots()
    values = np.linspace(1e-5, 4e-5, 5)
    draw_plot(axes, Plot("", Axis("Time", "s"), Axis("Mass", "kg"), (Curve(np.arange(5.0), values),)))
    FigureCanvasAgg(axes.figure).draw()
    assert axes.get_ylabel() == "Mass (10⁻⁶ kg)"
    assert axes.yaxis.get_offset_text().get_text() == ""
    assert {"10", "20", "40"} <= {label.get_text() for label in axes.get_yticklabels()}


def test_names_that_do_not_fit_are_turned():
    def rotations(width):
        axes = Figure().subplots()
        draw_plot(axes, materials_plot(samples(), table(), NAMES[0]))
        turn_names(axes, width)
        return {label.get_rotation() for label in axes.get_xticklabels()}

    assert rotations(9.0) == {0.0}
    assert rotations(2.0) != {0.0}


def test_small_parameters_have_a_unit_of_their_size():
    plot = sites_plot(table(), "scaled_mass_s2")
    assert plot.y.unit == "ms²"
    assert 10.0 < float(np.mean(plot.curves[0].y)) < 100.0


def test_sites_and_materials_differ_in_colour_or_line():
    lines = [(curve.colour, curve.kind) for curve in nonlinearity_plot(table(), samples()).curves]
    assert len(set(lines)) == len(lines) == len(SITES) + len(MATERIALS)
    many = pd.concat([table().assign(site=f"site {n}") for n in range(10)])
    signs = [(curve.colour, curve.marker) for curve in subjects_plot(many, NAMES[0]).curves]
    assert len(set(signs)) == len(signs) == 10 > len(COLOURS)


def test_points_of_subjects_stay_beside_the_mean_of_their_group():
    plot = sites_plot(table(), NAMES[0])
    for points, mean in zip(plot.curves[::2], plot.curves[1::2], strict=True):
        assert points.x.max() < mean.x[0]
        assert np.ptp(np.append(points.x, mean.x)) < 0.6


def test_every_subject_that_fits_is_named():
    ticks = subjects_plot(table(6), NAMES[0]).x.ticks
    assert [text for _place, text in ticks] == [f"P-{who:03}" for who in range(6)]
    longer = table(9).replace("P-", "P-long-", regex=True)
    assert 2 < sum(bool(text) for _place, text in subjects_plot(longer, NAMES[0]).x.ticks) < 9


def test_a_wide_table_keeps_p_values_beside_their_difference():
    heads = ("Site", "Parameter", "Difference", "p", *(f"Column {n}" for n in range(12)))
    row = ("left forearm, anterior", "Nonlinear constant C₁ (mm)", "−0.00582 [−0.0358, 0.0242]", *(["0.12345"] * 13))
    parts = _parts(_with_broken_heads(Table("Caption", heads, (row,), "Note")), 7.0)
    assert len(parts) > 1
    assert parts[0][0].head[:4] == heads[:4]
    assert all(part.head[:2] == heads[:2] for part, _widths in parts)
    assert [bool(part.note) for part, _widths in parts] == [False] * (len(parts) - 1) + [True]


def test_what_is_the_same_in_all_rows_stands_in_the_note():
    row = {"site": "cheek", "parameter": "mass_kg", "before": "", "after": "lotion", "subjects": 3, "difference": 1e-3}
    row |= {"p_value": 0.03, "normal": False, "margin": 0.1, "equivalence_p_value": 0.2}
    made = study_table("efficacy", pd.DataFrame([row, row | {"site": "arm", "normal": True}]))
    assert made.head == ("Site", "Parameter", "Difference", "p", "p of equivalence")
    assert [cells[3] for cells in made.rows] == ["0.030*", "0.030"]
    for words in ("Reference: without", "Condition: lotion", "Subjects: 3", "margin of 10 %", "*: the residuals"):
        assert words in made.note


def test_statistics_of_several_factors_have_a_table_each():
    rows = pd.DataFrame({"factor": ["gender", "age_group"], "site": "arm", "parameter": "mass_kg", "p_value": 0.1})
    made = study_tables("groups", rows)
    assert [one.caption.rpartition(": ")[2] for one in made] == ["Gender", "Age group"]


def statistics(used):
    return StudyStatistics(used, used, ("scaled_mass_s2",))


@pytest.mark.parametrize(("simulated", "words"), [(True, SIMULATED_LINE), (False, None)])
def test_the_report_says_that_tests_are_simulated(monkeypatch, simulated, words):
    monkeypatch.setattr(study_page, "MOST_DRAWN", 0)
    page = study_html("Lotion trial", "wiener", statistics(table(simulated=simulated)), {})
    assert (SIMULATED_LINE in page) == (words is not None)
    assert "<h1>Study Lotion trial</h1>" in page


def test_the_report_counts_simulated_tests_among_others(monkeypatch):
    monkeypatch.setattr(study_page, "MOST_DRAWN", 0)
    used = table()
    used.loc[0, "simulated"] = False
    assert f"{len(used) - 1} of {len(used)} tests are simulated" in study_html("A", "wiener", statistics(used), {})


def test_names_of_sites_are_separated_by_semicolons():
    facts = dict(study_facts(statistics(table()), "wiener"))
    assert facts["Sites"] == "; ".join(SITES)
    assert facts["Recorded"] == "2026-03-01 to 2026-03-04"
