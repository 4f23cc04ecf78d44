"""Interchange: amplitudes exact, autocorrelation as reported, the same again, and what is impossible refused."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest
from coded import coded

from tissueid.errors import UnusableInputError
from tissueid.stimuli import interchange as module
from tissueid.stimuli import rebuild, stimulus_names, with_preload
from tissueid.stimuli.distributions import Binary, Exponential, Gaussian, Uniform
from tissueid.stimuli.interchange import InterchangeProgress, autocorrelation, initial_arrangement, interchange
from tissueid.stimuli.kinds.interchange import Interchange, error_bound
from tissueid.stimuli.spectra import Butterworth, ExponentialDecay

RATE = 2000.0
SHORT = {"seconds": 0.5, "lags": 60, "tolerance": 1e-5}


def plain(values: np.ndarray, lags: int) -> np.ndarray:
    about = values - values.mean()
    whole = np.correlate(about, about, "full")[values.size - 1 :]
    return whole[: lags + 1] / whole[0]


def swapped_one_by_one(start: np.ndarray, target: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """The algorithm as it was published: swap, work out the whole autocorrelation, keep or take back."""
    values = start.copy()
    error = np.sum((plain(values, target.size - 1) - target) ** 2)
    for one, other in pairs:
        values[[one, other]] = values[[other, one]]
        found = np.sum((plain(values, target.size - 1) - target) ** 2)
        if found < error:
            error = found
        else:
            values[[one, other]] = values[[other, one]]
    return values


def test_the_autocorrelation_is_the_biased_one_of_the_record_less_its_mean():
    values = np.random.default_rng(1).gamma(2.0, size=300)
    np.testing.assert_allclose(autocorrelation(values, 299), plain(values, 299), atol=1e-14)


@pytest.mark.parametrize("levels", [Uniform(), Exponential(), Binary()], ids=repr)
def test_the_same_swaps_tried_give_the_signal_of_the_published_algorithm(levels):
    start = np.random.default_rng(2).permutation(levels.levels(200))
    target = ExponentialDecay(0.002).autocorrelation(150, RATE)  # lags enough that swapped samples are neighbours
    found = interchange(start, target, tolerance=1e-12, max_trials=400, seed=4, guided=False)
    pairs = np.random.Generator(np.random.PCG64(4)).integers(1, 200, (400, 2))
    np.testing.assert_array_equal(found.values, swapped_one_by_one(start, target, pairs))
    assert found.tried == 400
    assert 30 < found.accepted < 400


@pytest.mark.parametrize("guided", [True, False])
def test_what_is_reported_is_what_the_values_have(guided: bool):
    start = np.random.default_rng(3).permutation(Uniform().levels(1000))
    target = Butterworth(200.0).autocorrelation(80, RATE)
    told: list[InterchangeProgress] = []
    found = interchange(
        start, target, tolerance=1e-3, max_trials=60_000, seed=1, guided=guided, on_progress=lambda p: told.append(p)
    )
    np.testing.assert_array_equal(np.sort(found.values), np.sort(start))
    assert found.values[0] == start[0]
    assert found.error == pytest.approx(np.sum((plain(found.values, 80) - target) ** 2), abs=1e-12)
    assert found.error_before == pytest.approx(np.sum((plain(start, 80) - target) ** 2), rel=1e-9)
    assert found.reached
    assert found.lags == 80
    assert found.drift < 1e-13
    assert np.all(np.diff(found.history[:, 2]) <= 0.0)
    assert np.all(np.diff(found.history[:, 1]) >= 0.0)
    assert found.history[-1, 0] == found.tried == told[-1].tried
    assert found.history[0, 2] == found.error_before
    assert found.history[-1, 2] == pytest.approx(found.error, abs=1e-12)


def test_chosen_partners_need_fewer_trials_than_drawn_ones():
    start = np.random.default_rng(5).permutation(Gaussian().levels(1000))
    target = Butterworth(200.0).autocorrelation(80, RATE)
    chosen, drawn = (
        interchange(start, target, tolerance=1e-3, max_trials=100_000, guided=guided) for guided in (True, False)
    )
    assert chosen.reached
    assert 5 * chosen.tried < drawn.tried


def test_it_ends_where_progress_says_so():
    start = np.random.default_rng(6).permutation(Uniform().levels(500))
    target = ExponentialDecay(0.002).autocorrelation(50, RATE)
    stopped = interchange(start, target, tolerance=1e-12, max_trials=10_000, on_progress=lambda told: told.tried < 200)
    assert 200 <= stopped.tried < 400
    assert not stopped.reached
    with pytest.raises(KeyboardInterrupt):
        interchange(start, target, tolerance=1e-12, max_trials=10_000, on_progress=interrupted)


def interrupted(told: InterchangeProgress) -> None:
    raise KeyboardInterrupt


def test_a_result_that_is_not_what_was_followed_is_a_defect(monkeypatch: pytest.MonkeyPatch):
    start = np.random.default_rng(7).permutation(Uniform().levels(500))
    target = ExponentialDecay(0.002).autocorrelation(50, RATE)
    honest = module.try_guided_pairs

    def careless(x, errors, *others):
        error = honest(x, errors, *others)
        errors[3] += 1e-6
        return error

    monkeypatch.setattr(module, "try_guided_pairs", careless)
    with pytest.raises(ArithmeticError, match=r"drift 1\.0e-06"):
        interchange(start, target, tolerance=1e-12, max_trials=200)


@pytest.mark.parametrize(
    ("start", "target", "refusal"),
    [
        (np.arange(10.0), np.array([1.0]), coded("interchange.target")),
        (np.arange(10.0), np.array([0.9, 0.1]), coded("interchange.target")),
        (np.arange(10.0), np.ones(11), coded("interchange.short", size=10, lags=10)),
        (np.full(10, 0.1), np.ones(3), coded("interchange.constant")),
    ],
)
def test_what_cannot_be_searched_for_is_refused(start: np.ndarray, target: np.ndarray, refusal):
    with pytest.raises(UnusableInputError, check=refusal):
        interchange(start, target, tolerance=1e-6, max_trials=100)


@pytest.mark.parametrize("distribution", ["uniform", "gaussian", "rayleigh", "exponential"])
@pytest.mark.parametrize("spectrum", ["butterworth", "band", "exponential", "second_order", "white"])
def test_every_distribution_with_every_spectrum(distribution: str, spectrum: str):
    kind = Interchange.from_options(
        {"distribution": distribution, "spectrum": spectrum, "seconds": 2.0, "lags": 200, "tolerance": 2e-6, "seed": 3}
    )
    found = kind.design()
    np.testing.assert_array_equal(np.sort(found.values), kind.build_distribution().levels(4000))
    wanted = kind.build_spectrum().autocorrelation(200, RATE)
    assert np.sum((plain(found.values, 200) - wanted) ** 2) <= 2.0e-6


def test_ten_thousand_uniform_samples_at_200_hz_to_a_hundredth_of_what_is_asked():
    kind = Interchange(spectrum="band", seconds=5.0, tolerance=1e-6)
    built = kind.build()
    assert built.values.size == 10_000
    expected = np.sinc(0.2 * np.arange(501))
    assert np.sum((plain(built.values, 500) - expected) ** 2) < 1.0001e-6
    np.testing.assert_allclose(np.sort(built.values), np.linspace(0.0, 8.0, 10_000), atol=1e-12)
    assert built.crest_factor == pytest.approx(np.sqrt(3.0), rel=1e-3)


def test_two_valued_signals_of_an_edged_autocorrelation():
    kind = Interchange(
        distribution="binary", spectrum="exponential", seconds=5.0, lags=200, tolerance=3e-4, force_min_n=1.0
    )
    built = kind.build()
    assert set(built.values) == {1.0, 8.0}
    assert np.count_nonzero(built.values == 1.0) == 5000
    assert np.sum((plain(built.values, 200) - np.exp(-np.arange(201) / 10.0)) ** 2) <= 3.0001e-4


def test_the_same_specification_gives_the_same_samples_also_after_json():
    options = SHORT | {
        "distribution": "quantiles",
        "quantiles": (0.0, 1.0, 1.5, 4.0),
        "spectrum": "power",
        "frequencies_hz": (0.0, 50.0, 300.0),
        "densities": (1.0, 2.0, 0.0),
        "seed": 2**62,
    }
    first = Interchange.from_options(options).build()
    again = rebuild(json.loads(json.dumps(first.description)))
    np.testing.assert_array_equal(again.values, first.values)
    assert "interchange" in stimulus_names()
    other = Interchange.from_options(options | {"seed": 1}).build()
    assert abs(np.corrcoef(first.values, other.values)[0, 1]) < 0.2


@pytest.mark.parametrize("distribution", ["uniform", "rayleigh", "exponential"])
def test_a_preload_at_the_mean_leads_into_it_without_a_step(distribution: str):
    for seed in range(3):
        built = Interchange.from_options(SHORT | {"distribution": distribution, "seed": seed}).build()
        assert abs(built.values[0] - built.values.mean()) < 0.01
        whole = with_preload(built).values
        assert abs(whole[1000] - whole[999]) < 0.01


def test_voltages_are_designed_like_forces():
    kind = Interchange.from_options(SHORT | {"voltage_min_v": -3.0, "voltage_max_v": 9.0})
    built = kind.build()
    assert (built.unit, built.values.min(), built.values.max()) == ("V", -3.0, 9.0)
    np.testing.assert_array_equal(built.values, kind.scale_to_range(kind.design().values))


def test_a_design_that_falls_short_is_told_and_not_played():
    kind = Interchange(seconds=0.5, tolerance=1e-9, max_trials=500)
    designed = kind.design()
    assert not designed.reached
    with pytest.raises(
        UnusableInputError, check=coded("interchange.not_reached", tried=500, lags=500, tolerance=1e-9, hint="")
    ):
        kind.stimulus_from(designed)
    two = Interchange(distribution="binary", spectrum="white", seconds=0.5, lags=100, tolerance=1e-6, max_trials=500)
    with pytest.raises(
        UnusableInputError, check=coded("interchange.not_reached", tolerance=1e-6, hint="interchange.binary")
    ):
        two.build()


@pytest.mark.parametrize(
    ("options", "refusal"),
    [
        (
            {"cutoff_hz": 1000.0},
            coded("spectrum.nyquist", what="a cutoff", frequency_hz=1000.0, needed=2000.0, sample_rate_hz=2000.0),
        ),
        ({"seconds": 0.25}, coded("interchange.lags", lags=500, needed=1000, samples=500)),
        ({"seconds": 0.001}, coded("shape.short", seconds=0.001, sample_rate=2000.0, name="interchange")),
        (
            {"distribution": "binary"},
            coded(
                "interchange.unreachable", distribution="binary", tolerance=1e-06, reason="autocorrelation.two_valued"
            ),
        ),
        (
            {"distribution": "binary", "spectrum": "second_order"},
            coded(
                "interchange.unreachable", distribution="binary", tolerance=1e-06, reason="autocorrelation.two_valued"
            ),
        ),
        (
            {"distribution": "exponential", "spectrum": "second_order", "natural_hz": 400.0, "damping": 0.01},
            coded(
                "interchange.unreachable", distribution="exponential", tolerance=1e-06, reason="autocorrelation.too_low"
            ),
        ),
        (
            {"spectrum": "autocorrelation", "lags_s": (0.0, 0.0005, 0.001), "correlations": (1.0, 0.9, 0.0)},
            coded("autocorrelation.impossible", frequency=1000.0),
        ),
        ({"spectrum": "power"}, coded("spectrum.table_lengths", frequencies_hz=0, densities=0)),
        ({"quantiles": (0.0, 1.0)}, coded("shape.table", table="quantiles", option="distribution", choice="quantiles")),
        ({"densities": (0.0, 1.0)}, coded("shape.table", table="densities", option="spectrum", choice="power")),
        ({"distribution": "quantiles"}, coded("quantiles.few", values=0)),
        ({"tolerance": 0.0}, coded("option.refused", option="tolerance", reason="option.least")),
        ({"correlations": "much"}, coded("option.list", option="correlations")),
        ({"distribution": "normal"}, coded("option.refused", option="distribution", reason="option.choice")),
        ({"force_min_n": 9.0}, coded("stimulus.range", what="force", least=9.0, greatest=8.0, unit="N")),
    ],
)
def test_what_cannot_be_built_is_refused_in_one_line(options: dict[str, object], refusal):
    with pytest.raises(UnusableInputError, check=refusal) as refused:
        Interchange.from_options(options)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("seed", range(4))
def test_no_order_of_two_valued_samples_comes_below_the_bound(seed: int):
    n, lags = 12, 6
    target = np.concatenate([[1.0], np.random.default_rng(seed).uniform(-1.0, 1.0, lags)])
    best = np.inf
    for high in itertools.combinations(range(n), n // 2):
        values = -np.ones(n)
        values[list(high)] = 1.0
        best = min(best, np.sum((plain(values, lags) - target) ** 2))
    bound = error_bound(Binary().levels(n), target)
    assert 0.0 < bound.error <= best + 1e-12


@pytest.mark.parametrize("levels", [Exponential(), Uniform()], ids=repr)
def test_no_order_of_few_samples_comes_below_the_bound(levels):
    values = levels.levels(7)
    target = np.array([1.0, -0.99, 0.9])
    best = min(np.sum((plain(np.array(order), 2) - target) ** 2) for order in itertools.permutations(values))
    assert 0.0 <= error_bound(values, target).error <= best + 1e-12


def test_bounds_are_nothing_where_nothing_is_known():
    assert error_bound(Uniform().levels(1000), Butterworth(200.0).autocorrelation(100, RATE)).error == 0.0
    assert error_bound(Binary().levels(1000), ExponentialDecay(0.005).autocorrelation(100, RATE)).error == 0.0


def test_the_start_is_near_already_and_begins_at_the_mean():
    levels = Uniform().levels(4000)
    target = Butterworth(200.0).autocorrelation(300, RATE)
    start = initial_arrangement(levels, Butterworth(200.0), 300, RATE, seed=1)
    np.testing.assert_array_equal(np.sort(start), levels)
    assert np.sum((plain(start, 300) - target) ** 2) < 1e-4
    assert abs(start[0]) < 1e-3
