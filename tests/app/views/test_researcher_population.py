"""The population: a parameter of many fits as a histogram or against subject, site, date, repeat or another one."""

import dataclasses
import time
from pathlib import Path

import numpy as np
import pytest
from app.views.research_panels import run

from tissueid.app.theme import DARK, appearance
from tissueid.app.views.researcher.engine_outcome import EngineOutcome
from tissueid.app.views.researcher.outcome_tabs import PopulationView
from tissueid.app.views.researcher.population import (
    DATE,
    DISTRIBUTION,
    REPEAT,
    SITE,
    SUBJECT,
    parameters_of,
    population,
)
from tissueid.app.views.researcher.selected_test import SelectedTest
from tissueid.identification import FitReport
from tissueid.records import Estimate

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]

NOON = 1767268800.0
DAY = 86400.0


@pytest.fixture
def plots_laid_out():
    return True


def fit(mass_kg, subject="P-1", site="calf", when=NOON, number=1, file="a.h5", engine="lms", vaf=90.0, **more):
    parameters = {"mass_kg": Estimate(mass_kg, 0.001), **{name: Estimate(value, None) for name, value in more.items()}}
    report = FitReport(engine, {}, 100, 4, 95.0, vaf, parameters=parameters)
    return EngineOutcome(
        engine, {}, (SelectedTest(Path("/x") / file, number, site, subject, "x", when),), ("force", "position"), report
    )


def year(count=300):
    rng = np.random.default_rng(1)
    return [
        fit(
            0.08 + 0.01 * float(rng.standard_normal()),
            f"P-{k % 20:02d}",
            ("calf", "thigh", "forearm")[k % 3],
            NOON + DAY * (k // 4),
            1 + k % 2,
            f"{k}.h5",
            stiffness_n_per_m=3000.0 + k,
        )
        for k in range(count)
    ]


def test_means_and_spreads_are_those_of_the_groups_in_grams():
    values = [0.080, 0.082, 0.084]
    fits = [fit(value, "P-1", file=f"{value}.h5") for value in values] + [fit(0.1, "P-2")]
    found = population(fits, "mass_kg", SUBJECT, SUBJECT)
    assert found.unit == "g"
    assert found.places == found.groups == ("P-1", "P-2")
    assert sorted(found.y) == pytest.approx([80.0, 82.0, 84.0, 100.0])
    first, second = found.means
    assert (first.y, first.std, first.count) == (pytest.approx(82.0), pytest.approx(2.0), 3)
    # Student's t of two degrees of freedom: 4.303 standard errors.
    assert first.half_interval == pytest.approx(4.303 * 2.0 / np.sqrt(3.0), rel=1e-3)
    assert np.isnan(second.std)
    assert second.count == 1
    assert np.all(np.abs(found.x[:3] - first.x) < 0.33)
    assert np.rint(found.x).tolist() == [0.0, 0.0, 0.0, 1.0]


def test_what_is_not_drawn_is_counted_by_its_reason():
    refused = EngineOutcome("lms", {}, fit(1.0).tests, ("force", "position"), refused="no")
    fits = [fit(0.08), fit(0.08, vaf=-5.0), refused, fit(0.08, when=None)]
    assert len(population(fits, "mass_kg", SITE).outcomes) == 2
    assert population(fits, "mass_kg", DATE).left_out == {
        "predict nothing": 1,
        "refused": 1,
        "without a value across": 1,
    }
    assert len(population(fits, "vaf_validation_percent", DISTRIBUTION).outcomes) == 3
    assert list(parameters_of(fits)) == ["mass_kg", "vaf_validation_percent", "vaf_percent"]
    assert population(fits, "damping_n_s_per_m", DISTRIBUTION).y.size == 0


def test_repeats_are_counted_within_subject_site_and_day():
    fits = [
        fit(0.08, file="b.h5", when=NOON + 60),
        fit(0.08, file="a.h5", when=NOON),
        fit(0.08, file="c.h5", when=NOON + 2 * DAY),
        fit(0.08, file="d.h5", when=NOON + 120, site="thigh"),
        fit(0.09, file="a.h5", when=NOON, engine="wiener"),
    ]
    found = population(fits, "mass_kg", REPEAT)
    assert (np.rint(found.x) + 1).tolist() == [2.0, 1.0, 1.0, 1.0, 1.0]
    assert found.places == ("1", "2")


def test_dates_have_a_mean_a_day_and_another_parameter_one_a_group():
    fits = [fit(0.08, when=NOON), fit(0.09, when=NOON + 60), fit(0.1, when=NOON + 3 * DAY)]
    found = population(fits, "mass_kg", DATE)
    assert found.x.tolist() == [NOON, NOON + 60, NOON + 3 * DAY]
    assert [mean.count for mean in found.means] == [2, 1]
    fits = year(30)
    found = population(fits, "mass_kg", "stiffness_n_per_m", SITE)
    assert found.x.tolist() == [3000.0 + k for k in range(30)]
    assert [mean.count for mean in found.means] == [10, 10, 10]


def test_groups_that_are_too_many_share_the_last_colour():
    found = population(year(), "mass_kg", DISTRIBUTION, SUBJECT, 7)
    assert len(found.groups) == 7
    assert found.groups[-1] == "14 others"
    assert (found.group == 6).sum() == 14 * 15
    assert found.edges.size <= 61


@pytest.fixture
def view(qtbot):
    view = PopulationView()
    qtbot.addWidget(view)
    view.resize(600, 500)
    view.show_outcomes(year())
    view.show()
    return view


def choose(view, across, by="", parameter="mass_kg"):
    for choice, key in ((view.parameter, parameter), (view.across, across), (view.group, by)):
        assert choice.findData(key) >= 0
        choice.setCurrentIndex(choice.findData(key))
    view._choose()


def scene_of(view, x, y):
    return tuple(view.card.pixels(np.array([x]), np.array([y]))[0])


def test_a_histogram_counts_tests_and_one_engine_with_its_options_can_be_chosen(view):
    tests = [fit(0.08 + 0.001 * k, file=f"{k}.h5") for k in range(4)]
    refits = [dataclasses.replace(one, options={"memory_s": 0.06}) for one in tests[:2]]
    other = [dataclasses.replace(one, engine="wiener") for one in tests[:3]]
    view.show_outcomes([*tests, *refits, *other])
    choose(view, DISTRIBUTION, "engine")
    assert (len(view.shown.outcomes), view.shown.tests) == (9, 4)
    assert view.shown.counted == "Number of fits"  # LMS with two sets of options
    chosen = [view.engine.itemData(place) for place in range(view.engine.count())]
    assert chosen == ["", "LMS, default options", "LMS, Memory: 0.06 s", "Wiener, default options"]
    for variant, count in zip(chosen[1:], (4, 2, 3), strict=True):
        view.engine.setCurrentIndex(view.engine.findData(variant))
        view._choose()
        assert (len(view.shown.outcomes), view.shown.tests) == (count, count)
        assert view.shown.counted == "Number of tests"
        assert view.count.text() == f"{count} of {count} fits drawn of {count} tests; {variant}"


def test_every_view_of_three_hundred_fits_says_how_many_are_drawn(view):
    view.show_outcomes([*year(299), fit(0.08, vaf=-1.0)])
    for across in (DISTRIBUTION, SUBJECT, SITE, DATE, REPEAT, "stiffness_n_per_m"):
        for by in ("", "engine", SUBJECT, SITE):
            choose(view, across, by)
            assert view.count.text().startswith(
                "299 of 300 fits drawn of 299 tests; 1 predict nothing; LMS, default options"
            )
            (plot,) = view.card.plots
            drawn = sum(curve.x.size for curve in plot.curves if curve.kind == "points")
            assert drawn == (0 if across == DISTRIBUTION else 299)
    choose(view, DISTRIBUTION, SITE)
    assert sum(int(bars.height.sum()) for bars in view.card.plots[0].parts) == 299
    assert "calf" in view.key.text()
    assert "n = 100" in view.key.text()
    appearance.use(DARK)


def test_a_point_names_its_test_and_a_double_click_asks_for_it(qtbot, view):
    choose(view, "stiffness_n_per_m")
    wanted = view.shown.outcomes[7]
    found = view._at(scene_of(view, view.shown.x[7], view.shown.y[7]))
    assert found == [wanted]
    view.name(found)
    assert "P-07" in view.named.text()
    assert "g" in view.named.text()
    assert view._at(scene_of(view, view.shown.x[0], view.shown.y.max() + 30.0)) == []
    choose(view, DISTRIBUTION)
    edges = view.shown.edges
    some = view._at(scene_of(view, 0.5 * (edges[0] + edges[1]), 0.5))
    assert {id(one) for one in some} == {
        id(one) for one, y in zip(view.shown.outcomes, view.shown.y, strict=True) if y < edges[1]
    }


def test_axes_hold_the_points_alone(view):
    choose(view, DATE, SITE)
    (axes,) = view.card.axes
    (low, high), (bottom, _top) = axes.get_xlim(), axes.get_ylim()
    assert low > NOON - 20 * DAY
    assert high < NOON + 100 * DAY
    assert bottom > 30.0


def test_thousands_of_fits_are_arranged_in_a_fraction_of_a_second():
    fits = year(3000)
    times = []
    for across in (DISTRIBUTION, SUBJECT, DATE, REPEAT):
        begin = time.perf_counter()
        population(fits, "mass_kg", across, SITE)
        times.append(time.perf_counter() - begin)
    assert min(times) < 0.5
    assert sum(times) < 4.0


def test_the_panel_selects_in_the_table_what_the_population_asks_for(qtbot, panel, two):
    run(qtbot, panel, two)
    panel.tabs.setCurrentWidget(panel.population)
    assert panel.population.shown is not None
    assert len(panel.population.shown.outcomes) == 2
    second = panel.results.outcomes[1]
    panel.population.wanted.emit([second])
    assert panel.results.chosen == [second]
    assert panel.tabs.currentWidget() is not panel.population
    assert "P-002" in panel.pictures.legend.text()


def test_where_some_are_drawn_the_legend_says_of_how_many(qtbot, panel, two):
    run(qtbot, panel, two[:1])
    (outcome,) = panel.results.outcomes
    tests = [dataclasses.replace(outcome.tests[0], path=Path(f"/x/{k}.h5")) for k in range(20)]
    panel._keep([dataclasses.replace(outcome, tests=(test,)) for test in tests])
    assert len(panel.results.chosen) == 7
    assert "7 of 21 drawn" in panel.pictures.legend.text()
