"""Real-time input generation: depths as desired on the thesis' plants, and what it does when things go wrong."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from coded import coded
from scipy import stats
from stimuli.simulated_plants import (
    BLOCK,
    DAMPING,
    DEPTH_M,
    FORCE_N,
    MASS,
    PLANTS,
    PRELOAD_S,
    RATE,
    STIFFNESS,
    SURFACE_M,
    Array,
    DepthDependent,
    Linear,
    closed_loop,
    wiener,
)

from tissueid.errors import UnusableInputError
from tissueid.stimuli import FeedbackKind, build_stimulus, get_stimulus
from tissueid.stimuli.kinds.rtig import Rtig

BAR = 0.08


def kind(**options: Any) -> Rtig:
    ranges = {
        "depth_min_m": DEPTH_M[0],
        "depth_max_m": DEPTH_M[1],
        "force_min_n": FORCE_N[0],
        "force_max_n": FORCE_N[1],
    }
    return Rtig.from_options(ranges | options)


class Dead:
    """A sensor that always says the same."""

    def block(self, force: Array) -> Array:
        return np.full(force.size, 3e-3)


class Backwards(Linear):
    """A plant that comes towards whoever pushes it."""

    def block(self, force: Array) -> Array:
        return -super().block(force)


class Noise:
    """A plant that does as it likes."""

    def __init__(self) -> None:
        self._random = np.random.default_rng(5)

    def block(self, force: Array) -> Array:
        return 3e-3 + 3e-3 * self._random.standard_normal(force.size)


@pytest.mark.parametrize("lead", [1, pytest.param(2, marks=pytest.mark.soak), 3])
@pytest.mark.parametrize("name", PLANTS)
def test_all_depths_of_the_test_are_uniform_with_identification(name: str, lead: int):
    outcome = closed_loop(kind(lead=lead, seed=lead), PLANTS[name](), lead)
    assert outcome.depth.size == 5 * RATE
    assert outcome.distance() <= BAR


@pytest.mark.parametrize("name", ["Wiener", "DPN"])
def test_identification_is_worth_it_where_stiffness_grows_with_depth(name: str):
    plain, identified = (closed_loop(kind(identify=on), PLANTS[name]()).distance() for on in (False, True))
    assert identified < 0.5 * plain


def test_without_identification_a_linear_plant_of_the_assumed_stiffness_is_swept_evenly():
    outcomes = [closed_loop(kind(identify=False, seed=seed), Linear(), seed) for seed in range(3)]
    assert np.median([outcome.distance() for outcome in outcomes]) < 0.12
    assert all(outcome.source.report()["cycles"] >= 3 for outcome in outcomes)
    assert all(outcome.source.report()["identification"] is None for outcome in outcomes)


@pytest.mark.parametrize(
    ("wanted", "quantile"),
    [
        ({"distribution": "triangular"}, lambda p: np.where(p < 0.5, np.sqrt(p / 2), 1.0 - np.sqrt((1.0 - p) / 2))),
        ({"distribution": "table", "table": (3.0, 1.0)}, lambda p: np.where(p < 0.75, p / 1.5, 0.5 + 2.0 * (p - 0.75))),
    ],
)
def test_other_distributions(wanted: dict[str, Any], quantile: Any):
    outcome = closed_loop(kind(**wanted), DepthDependent())
    desired = DEPTH_M[1] * quantile(np.linspace(0.0, 1.0, 10_001))
    assert stats.ks_2samp(outcome.depth, desired).statistic <= BAR
    assert outcome.distance() > 0.1  # and so it is not just uniform


@pytest.mark.parametrize("identify", [True, False])
@pytest.mark.parametrize("plant", [Dead, Backwards, Noise, lambda: Linear(50.0), lambda: Linear(2e4)])
def test_the_force_stays_in_its_range_whatever_the_plant_does(plant: Any, identify: bool):
    outcome = closed_loop(kind(identify=identify, force_max_n=8.0, seconds=3.0), plant())
    assert np.isfinite(outcome.force).all()
    assert outcome.force.min() >= FORCE_N[0]
    assert outcome.force.max() <= 8.0
    json.dumps(outcome.source.report(), allow_nan=False)


@pytest.mark.parametrize("plant", [Dead, Backwards, Noise])
def test_identification_that_predicts_nothing_is_left_alone_and_said_so(plant: Any):
    report = closed_loop(kind(seconds=3.0), plant()).source.report()
    assert report["identification"]["verdict"].startswith("model rejected")
    assert report["identification"]["share"] < 0.7


def test_identification_comes_back_when_the_sensor_does():
    def dead_at_first(first: int, force: Array, position: Array) -> None:
        if first < 3000:
            position[:] = SURFACE_M + 3e-3

    report = closed_loop(kind(), DepthDependent(), spoil=dead_at_first).source.report()
    assert report["identification"]["verdict"] == "good, rejected for part of the test"
    assert 0.3 < report["identification"]["share"] < 1.0


def test_depths_beyond_the_force_are_left_out_and_reported():
    outcome = closed_loop(kind(force_max_n=3.0), Linear())
    report = outcome.source.report()
    assert report["reachable_m"] == pytest.approx([0.0, 3e-3], abs=3e-4)
    assert report["kolmogorov_distance"] > 0.4
    assert report["kolmogorov_distance_reachable"] <= BAR
    assert outcome.distance(0.0, 3e-3) <= BAR
    assert report["cover_s"] is None


@pytest.mark.parametrize("error_m", [-1e-3, 1e-3])
def test_a_surface_that_is_wrong_by_a_millimetre_only_moves_the_range(error_m: float):
    outcome = closed_loop(kind(depth_max_m=5e-3), wiener(), surface_error_m=error_m)
    assert outcome.distance(error_m, 5e-3 + error_m) <= BAR


def test_a_surface_that_moves_is_followed():
    class Breathing(Linear):
        time = 0

        def block(self, force: Array) -> Array:
            now = (self.time + np.arange(force.size)) / RATE
            self.time += force.size
            return super().block(force) + 1e-3 * np.sin(2.0 * np.pi * 0.3 * now)

    assert closed_loop(kind(), Breathing()).distance() <= BAR


@pytest.mark.parametrize("identify", [True, False])
def test_the_seed_and_the_answers_decide_every_set_point(identify: bool):
    first = kind(identify=identify, seconds=2.0, seed=3)
    again = Rtig.from_options({k: v for k, v in json.loads(json.dumps(first.describe())).items() if k != "type"})
    assert again == first
    one, two = closed_loop(first, Linear(), chunk=50), closed_loop(again, Linear(), chunk=10)
    np.testing.assert_array_equal(one.force, two.force)
    assert one.source.report() == two.source.report()
    other = closed_loop(kind(identify=identify, seconds=2.0, seed=4), Linear(), chunk=50)
    assert np.mean(np.abs(one.force - other.force)) > 0.1


def test_some_lost_samples_do_no_harm():
    rng = np.random.default_rng(8)

    def lose(first: int, force: Array, position: Array) -> None:
        lost = rng.random(force.size) < 0.1
        force[lost] = position[lost] = np.nan

    outcome = closed_loop(kind(), DepthDependent(), spoil=lose)
    assert outcome.distance() <= BAR
    assert 800 < outcome.source.report()["lost"] < 1200


@pytest.mark.parametrize("identify", [True, False])
def test_with_no_samples_at_all_the_load_of_the_preload_is_gone_back_to(identify: bool):
    def cut(first: int, force: Array, position: Array) -> None:
        if 4000 <= first < 6000:
            force[:] = position[:] = np.nan

    spec = kind(identify=identify)
    outcome = closed_loop(spec, Linear(), spoil=cut)
    np.testing.assert_allclose(outcome.force[5000:6000], spec.preload_n, atol=1e-9)
    assert np.std(outcome.force[6500:]) > 0.5
    assert outcome.source.report()["lost"] == 2000


def test_until_a_sample_comes_the_preload_is_held():
    source = kind().start(SURFACE_M)
    np.testing.assert_array_equal(source.next_block(), np.full(BLOCK, kind().preload_n))


def test_blocks_that_were_left_out_count_as_lost_and_repeated_ones_once():
    rest, samples = round(PRELOAD_S * RATE), 500
    rng = np.random.default_rng(2)
    force, depth = rng.standard_normal((2, rest + samples))
    position = SURFACE_M + 3e-3 + 1e-3 * depth
    whole, holed = kind(seconds=0.25).start(SURFACE_M), kind(seconds=0.25).start(SURFACE_M)
    spoilt = force.copy()
    spoilt[rest + 100 : rest + 200] = np.nan
    whole.take(spoilt, position, -rest)
    holed.take(force[: rest + 100], position[: rest + 100], -rest)
    holed.take(force[rest + 200 : rest + 300], position[rest + 200 : rest + 300], 200)
    holed.take(force[rest + 250 :], position[rest + 250 :], 250)
    assert whole.report() == holed.report()
    assert whole.report()["lost"] == 100
    np.testing.assert_array_equal(whole.next_block(), holed.next_block())


def test_the_report_counts_what_was_measured():
    seen: list[Array] = []

    def watch(first: int, force: Array, position: Array) -> None:
        if first >= 0:
            seen.append(position.copy())

    outcome = closed_loop(kind(), wiener(), spoil=watch)
    report = outcome.source.report()
    depth = np.concatenate(seen) - SURFACE_M
    assert report["samples"] == depth.size == sum(report["counts"]) + report["below"] + report["above"]
    np.testing.assert_array_equal(report["counts"], np.histogram(depth, report["edges_m"])[0])
    exact = stats.kstest(depth, "uniform", DEPTH_M).statistic
    assert report["kolmogorov_distance"] == pytest.approx(exact, abs=1e-12)
    assert 6 <= report["cycles"] <= 14
    assert 0.2 < report["cover_s"] < 2.5
    assert report["reached_m"] == pytest.approx(np.quantile(depth, [0.01, 0.99]).tolist())


def test_mass_damping_and_stiffness_of_a_linear_plant_do_not_vary_with_depth():
    report = closed_loop(kind(), Linear()).source.report()
    levels = report["identification"]["levels"]
    assert (report["block_s"], report["identification"]["memory_s"]) == (0.025, 0.0625)
    assert len(levels) == 8
    for level in levels:
        assert level["stiffness_n_per_m"] == pytest.approx(STIFFNESS, rel=0.1)
        assert level["damping_n_s_per_m"] == pytest.approx(DAMPING, rel=0.25)
        assert level["mass_kg"] == pytest.approx(MASS, rel=0.15)
        assert level["settling_s"] == pytest.approx(0.058, rel=0.15)  # within the memory, longer than a block


def test_stiffness_and_damping_of_the_depth_dependent_plant_grow_and_its_mass_does_not():
    runs = [closed_loop(kind(seed=seed), DepthDependent(), seed).source.report() for seed in range(3)]
    levels = [run["identification"]["levels"] for run in runs]
    depth, mass, damping, stiffness = (
        np.median([[level[name] for level in run] for run in levels], axis=0)
        for name in ("depth_m", "mass_kg", "damping_n_s_per_m", "stiffness_n_per_m")
    )
    tangent = 1000.0 * (np.exp(200.0 * depth) * (1.0 + 200.0 * depth) + 0.1)
    np.testing.assert_allclose(stiffness, tangent, rtol=0.3)
    np.testing.assert_allclose(damping, 8.0 * np.exp(150.0 * depth), rtol=0.35)
    np.testing.assert_allclose(mass, 0.08, rtol=0.35)


def test_the_static_force_is_found():
    static = closed_loop(kind(), DepthDependent()).source.report()["identification"]["static_force"]
    depth = np.array(static["depth_m"])
    truth = 1000.0 * (np.exp(200.0 * depth) + 0.1) * depth
    np.testing.assert_allclose(static["force_n"], truth, atol=0.5)


def test_the_depth_scatters_less_where_the_tissue_is_soft():
    """Once it is known, the stochastic part is turned down there, and the depth is not thrown about."""
    for seed in range(3):
        options = {"force_max_n": 10.0, "stochastic_share": 0.3, "seed": seed}
        depth = closed_loop(kind(**options), Linear(300.0), seed).depth[2000:]
        assert np.quantile(depth, 0.01) > -1.0e-3
        assert np.quantile(depth, 0.99) < 7.0e-3


@pytest.mark.parametrize(
    "options",
    [
        {"sample_rate": 60.0, "cutoff_hz": 20.0},
        {"cutoff_hz": 1.0},
        {"sample_rate": 20_000.0, "cutoff_hz": 9000.0},
        {"stochastic_share": 0.0},
        {"bins": 4, "cycle": 0.1, "memory": 0.001},
    ],
)
def test_odd_options_run_too(options: dict[str, Any]):
    source = kind(**options).start(SURFACE_M)
    plant = Linear()
    for k in range(60):
        block = source.next_block()
        assert ((block >= FORCE_N[0]) & (block <= FORCE_N[1])).all()
        source.take(block, SURFACE_M + plant.block(block), k * BLOCK)
    json.dumps(source.report(), allow_nan=False)


def test_blocks_beyond_the_end_of_the_test_can_be_had():
    source = kind(seconds=0.06).start(SURFACE_M)
    plant = Linear()
    for k in range(10):
        block = source.next_block()
        source.take(block, SURFACE_M + plant.block(block), k * BLOCK)
    assert source.report()["samples"] == 120


def test_it_is_a_feedback_kind_that_is_not_built_before_the_test():
    assert get_stimulus("rtig") is Rtig
    assert issubclass(Rtig, FeedbackKind)
    with pytest.raises(UnusableInputError, check=coded("stimulus.feedback", name="rtig")):
        build_stimulus("rtig", {})
    assert Rtig().preload_n == pytest.approx(1.0)
    assert Rtig(force_min_n=2.0, force_max_n=4.0).preload_n == pytest.approx(2.2)
    assert Rtig(force_min_n=-4.0, force_max_n=-2.0).preload_n == -2.0


@pytest.mark.parametrize(
    ("options", "refusal"),
    [
        ({"force_min_n": 10.0}, coded("stimulus.range", what="force", least=10.0, greatest=10.0, unit="N")),
        ({"depth_min_m": 4e-3}, coded("rtig.range", depth_max_m=4.0, least=0.1, depth_min_m=4.0)),
        ({"cutoff_hz": 1000.0}, coded("rtig.nyquist", cutoff_hz=1000.0, needed=2000.0, sample_rate=2000.0)),
        (
            {"cutoff_hz": 1.0, "sample_rate": 1e6, "seconds": 1.0},
            coded("spectrum.low_cutoff", cutoff_hz=1.0, least=8.04, reason="spectrum.settling"),
        ),
        ({"distribution": "table", "table": (1e308, 1e308)}, coded("rtig.table_sum")),
        ({"seconds": 0.01}, coded("rtig.short", seconds=0.01, sample_rate=2000.0, block=50)),
        ({"seconds": 600.0, "sample_rate": 1e6}, coded("rtig.samples", samples=600000000, limit=5000000)),
        ({"distribution": "table"}, coded("rtig.table")),
        ({"distribution": "table", "table": (1.0, -1.0)}, coded("rtig.table")),
        ({"distribution": "table", "table": (0.0, 0.0)}, coded("rtig.table")),
        ({"table": (1.0, 2.0)}, coded("rtig.table_distribution")),
        ({"stochastic_share": 0.5}, coded("option.refused", option="stochastic_share", reason="option.most")),
        ({"bins": 1}, coded("option.refused", option="bins", reason="option.least")),
        ({"distribution": "pink"}, coded("option.refused", option="distribution", reason="option.choice")),
        ({"depth_max_m": float("nan")}, coded("option.refused", option="depth_max_m", reason="option.finite")),
    ],
)
def test_what_cannot_be_run_is_refused_in_one_line(options: dict[str, Any], refusal):
    with pytest.raises(UnusableInputError, check=refusal) as refused:
        Rtig.from_options(options)
    assert "\n" not in str(refused.value)
