"""Fits of several tests: sources, series, sweeps, repeats, and the plots of all of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from coded import coded
from reports.synthetic_sitting import make_session, make_test

from tissueid.analysis.curves import overlay_plots as curves
from tissueid.analysis.curves.kernels import first_kernels, kernel_lobes, partition_columns, second_kernels
from tissueid.analysis.curves.overlay_plots import depth_overlay, signal_correlations
from tissueid.analysis.overlay import (
    NamedFit,
    Overlay,
    TestSource,
    every,
    overlay,
    repeated_values,
    series_profiles,
)
from tissueid.errors import UnusableInputError
from tissueid.identification import get_engine
from tissueid.records import Record
from tissueid.sessions import Session


def fit(name: str, label: str = "", **options: object) -> NamedFit:
    return NamedFit(label or name, get_engine(name).from_options(options))


@pytest.fixture(scope="module")
def session() -> Session:
    first = make_test(1, seconds=2.0)
    return make_session(first, replace(make_test(2, seconds=2.0, seed=5)), make_test(3, seconds=2.0, seed=6))


@pytest.fixture(scope="module")
def three(session: Session) -> Overlay:
    sources = [TestSource("arm", session, (1,)), TestSource("arm", session, (2,)), TestSource("leg", session, (3,))]
    return overlay(sources, [fit("lms", memory=0.05), fit("wiener", memory=0.05)], whole=True)


def test_every_source_gets_its_fits_and_a_label(three: Overlay) -> None:
    assert [(one.source, one.fit.label) for one in three.entries] == [
        (source, name) for source in ("arm", "arm", "leg") for name in ("lms", "wiener")
    ]
    assert (three.sources, three.fits) == (("arm", "leg"), ("lms", "wiener"))
    assert three.label(three.entries[0]) == "arm, lms"
    report = three.entries[0].analysis.model.report
    assert report.vaf_validation_percent is None  # nothing was held out
    assert report.n_samples > 0.9 * len(three.records["arm"])


def test_linear_tests_of_one_label_are_one_series(three: Overlay) -> None:
    series = series_profiles(three)
    assert {key: len(profile) for key, profile in series.items()} == {
        ("arm", "lms"): 2, ("arm", "wiener"): 2, ("leg", "lms"): 1, ("leg", "wiener"): 1,
    }  # fmt: skip
    assert np.all(np.diff(series["arm", "lms"].position) >= 0.0)
    by_depth = series_profiles(three, from_surface=True)
    surface = three.entries[0].surface_position_m
    if np.isfinite(surface):
        np.testing.assert_allclose(by_depth["arm", "lms"].position, series["arm", "lms"].position - surface)


def test_repeats_have_mean_and_deviation(three: Overlay) -> None:
    values = {(one.source, one.fit, one.quantity): one for one in repeated_values(three)}
    arm = values["arm", "lms", "stiffness_n_per_m"]
    single = [
        one.analysis.model.report.parameters["stiffness_n_per_m"].value
        for one in three.entries
        if (one.source, one.fit.label) == ("arm", "lms")
    ]
    assert arm.count == 2
    assert arm.mean == pytest.approx(np.mean(single))
    assert arm.std == pytest.approx(np.std(single, ddof=1))
    assert arm.cv == pytest.approx(arm.std / arm.mean)
    assert np.isnan(values["leg", "lms", "stiffness_n_per_m"].std)
    assert {"vaf_percent", "c1_m"} <= {one[2] for one in values if one[1] == "wiener"}


def test_the_calibration_lies_under_the_profiles(three: Overlay) -> None:
    sweep = {
        "position_m": np.array([0.002, 0.03]),
        "mass_kg": np.array([0.06, 0.07]),
        "mass_std_kg": np.array([1e-3, 2e-3]),
        "stiffness_n_per_m": np.array([1000.0, 1100.0]),
    }
    mass, damping, stiffness = depth_overlay(three, sweep)
    assert mass.x.label == "Position"
    assert mass.curve("calibration spring").y.tolist() == [60.0, 70.0]
    assert mass.curve("calibration spring").high[0] == pytest.approx(60.0 + 1.96)
    assert stiffness.curve("calibration spring").low is None
    assert not [one for one in damping.curves if one.name == "calibration spring"]
    names = {one.name for one in damping.curves if one.name}
    assert names == {"arm, lms", "arm, wiener", "leg, lms", "leg, wiener"}


def test_nonlinearities_have_a_panel_for_each_source(three: Overlay) -> None:
    panels = curves.nonlinearity_overlay(three)
    assert [str(panel.title) for panel in panels] == ["arm", "leg"]
    wiener = [one for one in three.entries if one.fit.label == "wiener"]
    assert all(0.0 <= curves.loop_width(one) < 1e-4 for one in wiener)
    with pytest.raises(UnusableInputError, check=coded("overlay.no_nonlinearity")):
        curves.nonlinearity_overlay(Overlay(tuple(one for one in three.entries if one.fit.label == "lms")))


def test_a_sweep_tries_every_value_on_the_fits_that_have_the_option(session: Session) -> None:
    found = overlay(
        [TestSource("arm", session, (1,))],
        [fit("lms", taper=0.0), fit("depth", partitions=2, correct=False)],
        whole=True,
        downsample=2,
        sweep=("memory", (0.02, 0.04)),
    )
    assert [(one.fit.label, one.swept) for one in found.entries] == [
        ("lms", 0.02), ("lms", 0.04), ("depth", 0.02), ("depth", 0.04),
    ]  # fmt: skip
    scores, criterion = curves.sweep_overlay(found)
    assert scores.curve("lms").x.tolist() == [20.0, 40.0]
    depth = found.entries[2]
    assert scores.curve("depth").y[0] == depth.scheduled_percent != depth.analysis.model.report.vaf_percent
    assert criterion.curve("lms").y[0] == pytest.approx(1e-3 * found.entries[0].analysis.model.report.aicc)
    with pytest.raises(UnusableInputError, check=coded("compare.no_such_option")):
        overlay([TestSource("arm", session, (1,))], [fit("lms")], sweep=("nothing", (1.0,)))


def test_kernels_stand_side_by_side_with_their_scores(session: Session) -> None:
    sources = [TestSource(name, session, (number,)) for name, number in (("a", 1), ("b", 2))]
    options = {"method": "exact", "memory": 0.02, "downsample": 4}
    fits = [fit("volterra", "raw", **options), fit("depth", partitions=2, memory=0.02, correct=False)]
    found = overlay(sources, fits, whole=True)
    plots = second_kernels(found)
    assert [plot.title.values["name"] for plot in plots] == ["a, raw", "b, raw"]
    assert plots[0].surface.limit == plots[1].surface.limit  # kernels of one fit are drawn on one scale
    assert [curve.name for curve in first_kernels(found)[0].curves] == ["a, raw", "b, raw"]
    columns = partition_columns(found)
    assert len(columns) == 2
    assert columns[0][2].surface.values.shape[0] == 2


def test_lobes_of_a_kernel() -> None:
    lag = np.arange(40.0)
    wave = np.exp(-lag / 8.0) * np.sin(2.0 * np.pi * lag / 20.0)
    lobes = kernel_lobes(-np.outer(wave, wave), 2e-3)
    assert lobes.negative
    assert lobes.lag_s == pytest.approx(2e-3 * np.argmax(wave))
    assert lobes.side_lobe == pytest.approx(-wave.min() / wave.max(), rel=1e-6)


def test_correlations_of_a_delay() -> None:
    random = np.random.Generator(np.random.PCG64(1))
    force = random.standard_normal(4000)
    record = Record(force, 1e-3 * np.roll(force, 10), 2000.0)
    into, _out, cross = signal_correlations({"": record})
    values = into.curves[0]
    assert values.y[values.x.size // 2] == pytest.approx(1.0)
    assert np.abs(np.delete(values.y, values.x.size // 2)).max() < 0.1
    assert cross.curves[0].x[np.argmax(cross.curves[0].y)] == pytest.approx(5.0)  # ms: the output comes later


def test_every_nth_sample_has_the_lower_rate() -> None:
    record = Record(np.arange(10.0), np.arange(10.0), 1000.0)
    assert (every(record, 4).input.tolist(), every(record, 4).sample_rate_hz) == ([0.0, 4.0, 8.0], 250.0)


def test_an_unknown_fit_of_a_source_is_refused(session: Session) -> None:
    with pytest.raises(UnusableInputError, check=coded("overlay.unknown_fit")):
        overlay([TestSource("arm", session, (1,), ("raw",))], [fit("lms")])


def test_a_series_without_an_own_label_is_numbered(session: Session) -> None:
    options = {"partitions": 2, "memory": 0.02, "correct": False}
    found = overlay([TestSource("arm", session, (n,)) for n in (1, 2)], [fit("depth", **options)], whole=True)
    assert list(series_profiles(found)) == [("arm", "depth"), ("arm (2)", "depth")]
    mass, *_rest = depth_overlay(found)
    assert {one.name for one in mass.curves if one.name} == {"arm", "arm (2)"}
    assert {one.colour for one in mass.curves} == {"measured"}
