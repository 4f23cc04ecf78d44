"""The designed stimulus: its predictions against a plant integrated here, its swing, and what it refuses."""

from __future__ import annotations

import json

import numpy as np
import pytest
from coded import coded

from tissueid.errors import UnusableInputError
from tissueid.identification.live.stopping import PARAMETERS, precision
from tissueid.records import Estimate, Record
from tissueid.stimuli import get_stimulus, rebuild
from tissueid.stimuli.kinds.designed import Designed, LocalTissue, predicted_precision
from tissueid.stimuli.kinds.noise import Noise

RATE = 2000.0
CUTOFF = 150.0
NOISE_N = 0.04  # white over 1 kHz
DENSITY = NOISE_N / np.sqrt(RATE / 2.0)
RUNS = 48
SECONDS = 1.5
TISSUE = LocalTissue(0.09, 12.0, 6000.0, stiffness_growth_per_m=1000.0, damping_asymmetry_n_s2_per_m2=60.0)
STRAIGHT = LocalTissue(0.09, 12.0, 6000.0)


def answers(tissue: LocalTissue, force: np.ndarray) -> np.ndarray:
    """Positions (runs, n) for forces (runs, n): Runge-Kutta of order four, force linear between samples."""
    growth, turn = tissue.stiffness_growth_per_m, tissue.damping_asymmetry_n_s2_per_m2
    m, b, k = tissue.mass_kg, tissue.damping_n_s_per_m, tissue.stiffness_n_per_m
    h = 1.0 / RATE

    def pull(y: np.ndarray, v: np.ndarray, f: np.ndarray) -> np.ndarray:
        return (f - b * v - turn * v**2 - k * (y + 0.5 * growth * y**2)) / m

    y, v = np.zeros(force.shape[0]), np.zeros(force.shape[0])
    out = np.zeros_like(force)
    for step in range(force.shape[1] - 1):
        f0, f1 = force[:, step], force[:, step + 1]
        fm = 0.5 * (f0 + f1)
        a1 = pull(y, v, f0)
        v2 = v + 0.5 * h * a1
        a2 = pull(y + 0.5 * h * v, v2, fm)
        v3 = v + 0.5 * h * a2
        a3 = pull(y + 0.5 * h * v2, v3, fm)
        v4 = v + h * a3
        a4 = pull(y + h * v3, v4, f1)
        y = y + h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
        v = v + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
        out[:, step + 1] = y
    return out


def spread(tissue: LocalTissue, rms_n: float) -> np.ndarray:
    """Standard deviation of log M, log B, log K over runs, (3,)."""
    random = np.random.default_rng(11)
    half = 3.0 * rms_n
    force = np.stack(
        [
            Noise(force_min_n=-half, force_max_n=half, cutoff_hz=CUTOFF, seconds=SECONDS, seed=s).build().values
            for s in range(RUNS)
        ]
    )
    force *= rms_n / force.std(axis=1, keepdims=True)
    position = answers(tissue, force)
    measured = force + NOISE_N * random.standard_normal(force.shape)
    looks = [precision(Record(u, y, RATE)) for u, y in zip(measured, position, strict=True)]
    values = np.array([[np.log(look.estimates[name].value) for name in PARAMETERS] for look in looks])
    return values.std(axis=0, ddof=1)


@pytest.mark.parametrize(
    ("tissue", "rms_n", "least", "most"),
    [(STRAIGHT, 0.3, 0.8, 1.3), (TISSUE, 0.3, 0.75, 1.5), (TISSUE, 0.9, 0.75, 1.7)],
    ids=["straight", "about the best", "too large"],
)
def test_prediction_agrees_with_the_spread_of_fits(tissue: LocalTissue, rms_n: float, least: float, most: float):
    """48 runs know a spread to 10 %; beyond the best swing the third order, which is left out, begins to count."""
    ratio = spread(tissue, rms_n) / predicted_precision(tissue, CUTOFF, DENSITY).std(rms_n, SECONDS)
    assert ratio.min() > least
    assert ratio.max() < most


def test_the_best_swing_is_a_valley():
    design = predicted_precision(TISSUE, CUTOFF, DENSITY)
    best = design.optimal_rms_n
    worst = [float(design.std(factor * best, 1.0).max()) for factor in (0.5, 0.9, 1.0, 1.1, 2.0)]
    assert worst[2] == min(worst)
    assert worst[0] > 1.3 * worst[2]
    assert worst[4] > 1.3 * worst[2]


def test_a_tissue_that_does_not_bend_takes_all_the_range():
    assert predicted_precision(STRAIGHT, CUTOFF, DENSITY).optimal_rms_n == float("inf")
    straight = Designed(stiffness_n_per_m=6000.0, stiffness_growth_per_m=0.0, damping_asymmetry_n_s2_per_m2=0.0)
    assert straight.amplitude_n == pytest.approx(5.0)


def test_four_times_as_long_is_twice_as_good():
    design = predicted_precision(TISSUE, CUTOFF, DENSITY)
    np.testing.assert_allclose(design.std(0.3, 1.0), 2.0 * design.std(0.3, 4.0))


def test_it_is_even_noise_about_the_load_and_can_be_built_again():
    design = get_stimulus("designed").from_options({"load_n": 4.0, "seed": 3})
    assert isinstance(design, Designed)
    played = design.build()
    assert played.values.size == 4000
    assert played.values.min() == pytest.approx(4.0 - design.amplitude_n)
    assert played.values.max() == pytest.approx(4.0 + design.amplitude_n)
    assert played.values.mean() == pytest.approx(4.0)
    assert played.crest_factor == pytest.approx(np.sqrt(3.0), rel=0.01)
    again = rebuild(json.loads(json.dumps(played.description)))
    np.testing.assert_array_equal(again.values, played.values)
    assert not np.array_equal(Designed(load_n=4.0, seed=4).build().values, played.values)


def test_the_swing_keeps_to_the_range():
    assert Designed(load_n=10.3).amplitude_n == pytest.approx(0.2)
    assert Designed(load_n=0.6).amplitude_n == pytest.approx(0.1)


def test_more_bend_asks_for_a_smaller_swing_and_more_noise_for_a_larger_one():
    plain = Designed()
    assert Designed(stiffness_growth_per_m=2000.0, stiffness_n_per_m=5500.0).amplitude_n < plain.amplitude_n
    assert Designed(force_noise_n_per_root_hz=4.8e-3).amplitude_n > 1.5 * plain.amplitude_n


def test_a_first_test_tells_the_tissue():
    first = {
        "mass_kg": Estimate(0.1),
        "damping_n_s_per_m": Estimate(15.0, 0.2),
        "stiffness_n_per_m": Estimate(7000.0),
        "stiffness_growth_per_m": Estimate(1100.0),
        "damping_ratio": Estimate(0.3),
    }
    design = Designed.after(first, first_load_n=5.0, load_n=7.0, seconds=1.0)
    assert (design.mass_kg, design.damping_n_s_per_m, design.load_n, design.seconds) == (0.1, 15.0, 7.0, 1.0)
    assert design.stiffness_n_per_m == pytest.approx(9200.0)
    assert Designed.after(first, first_load_n=9.0, load_n=1.0).stiffness_n_per_m == pytest.approx(700.0)
    line = Designed.after({"stiffness_n_per_m": Estimate(7000.0)}, first_load_n=5.0, load_n=5.0)
    assert line.stiffness_n_per_m == 7000.0
    assert line.mass_kg == Designed().mass_kg
    shrinking = first | {"stiffness_growth_per_m": Estimate(-300.0)}
    assert Designed.after(shrinking, first_load_n=5.0, load_n=7.0).stiffness_n_per_m == 7000.0


def test_the_prediction_is_told_for_the_whole_length():
    short, long = Designed(seconds=1.0), Designed(seconds=4.0)
    np.testing.assert_allclose(short.predicted_std, 2.0 * np.array(long.predicted_std))
    assert all(0.002 < std < 0.02 for std in long.predicted_std)


@pytest.mark.parametrize(
    ("options", "refusal"),
    [
        ({"load_n": 11.0}, coded("designed.load", load_n=11.0, force_min_n=0.5, force_max_n=10.5)),
        ({"load_n": 0.5}, coded("designed.load", load_n=0.5, force_min_n=0.5, force_max_n=10.5)),
        (
            {"cutoff_hz": 1000.0},
            coded("spectrum.nyquist", what="a cutoff", frequency_hz=1000.0, needed=2000.0, sample_rate_hz=2000.0),
        ),
        (
            {"cutoff_hz": 1e-5},
            coded("spectrum.low_cutoff", cutoff_hz=1e-05, sample_rate_hz=2000.0, reason="spectrum.settling"),
        ),
        (
            {"cutoff_hz": 1e-300},
            coded("spectrum.low_cutoff", cutoff_hz=1e-300, sample_rate_hz=2000.0, reason="spectrum.settling"),
        ),
        (
            {"mass_kg": 1e-310},
            coded(
                "design.unanswerable",
                mass_kg=1e-310,
                damping_n_s_per_m=12.0,
                stiffness_n_per_m=5500.0,
                force_noise_n_per_root_hz=0.0012,
                cutoff_hz=100.0,
            ),
        ),
        (
            {"stiffness_n_per_m": 1e-300},
            coded("design.unanswerable", mass_kg=0.09, damping_n_s_per_m=12.0, cutoff_hz=100.0),
        ),
        (
            {"force_noise_n_per_root_hz": 1e-300},
            coded("design.unanswerable", mass_kg=0.09, damping_n_s_per_m=12.0, cutoff_hz=100.0),
        ),
        ({"seconds": 0.001}, coded("shape.short", seconds=0.001, sample_rate=2000.0, name="noise")),
        ({"mass_kg": 0.0}, coded("option.refused", option="mass_kg", reason="option.greater")),
        ({"swing": 1.0}, coded("option.unknown", option="swing")),
    ],
)
def test_what_cannot_be_designed_is_refused_in_one_line(options: dict[str, float], refusal):
    with pytest.raises(UnusableInputError, check=refusal) as refused:
        get_stimulus("designed").from_options(options)
    assert "\n" not in str(refused.value)
