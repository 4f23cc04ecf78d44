"""Band-limited noise: what it promises of range, distribution, spectrum, and of being the same again."""

from __future__ import annotations

import json

import numpy as np
import pytest
from coded import coded
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal, stats

from tissueid.errors import UnusableInputError
from tissueid.stimuli import rebuild
from tissueid.stimuli.kinds.noise import Noise

DISTRIBUTIONS = ("gaussian", "uniform")


def share_above(values: np.ndarray, hz: float) -> float:
    frequency, power = signal.welch(values, 2000.0, nperseg=1000)
    return float(power[frequency > hz].sum() / power.sum())


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
@settings(max_examples=20)
@given(seed=st.integers(0, 2**63 - 1), low=st.floats(-5.0, 5.0), span=st.floats(0.1, 20.0))
def test_range_is_used_and_never_left(distribution: str, seed: int, low: float, span: float):
    noise = Noise.from_options(
        {"distribution": distribution, "seconds": 0.5, "seed": seed, "force_min_n": low, "force_max_n": low + span}
    ).build()
    assert noise.values.shape == (1000,)
    assert noise.values.min() >= low - 1e-9
    assert noise.values.max() <= low + span + 1e-9
    assert np.ptp(noise.values) > 0.8 * span


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_the_same_seed_gives_the_same_samples_and_another_does_not(distribution: str):
    first, again, other = (Noise.from_options({"distribution": distribution, "seed": s}).build() for s in (5, 5, 6))
    np.testing.assert_array_equal(first.values, again.values)
    assert abs(np.corrcoef(first.values, other.values)[0, 1]) < 0.2
    np.testing.assert_array_equal(rebuild(first.description).values, first.values)
    assert first.description["seed"] == first.seed == 5
    assert first.description["type"] == "noise"


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_power_stays_below_the_cut_off(distribution: str):
    for seed in range(5):
        values = Noise.from_options({"distribution": distribution, "seed": seed}).build().values
        assert share_above(values, 400.0) < 2e-4
        assert share_above(values, 220.0) < 0.02
        frequency, power = signal.welch(values, 2000.0, nperseg=200)
        band = power[(frequency > 15.0) & (frequency < 165.0)]
        assert band.max() / band.min() < 2.5  # white up to the cut-off, within the scatter of the estimate


def test_gaussian_holds_no_more_than_the_stated_share_at_the_limits():
    for share in (0.0, 0.0027, 0.02):
        values = Noise(seed=3, clipped=share, force_min_n=1.0, force_max_n=7.0).build().values
        held = np.mean((values <= 1.0) | (values >= 7.0))
        assert held <= share + 1.0 / values.size
        assert held >= share - 2.0 / values.size
    values = Noise(seed=3, seconds=20.0).build().values
    assert abs(stats.kurtosis(values)) < 0.2
    assert abs(stats.skew(values)) < 0.1


def test_default_share_is_three_standard_deviations():
    noise = Noise(seed=4, seconds=60.0).build()
    assert noise.crest_factor == pytest.approx(3.0, rel=0.06)


def test_uniform_is_uniform_to_the_last_sample():
    noise = Noise(distribution="uniform", seed=2, force_min_n=-1.0, force_max_n=3.0).build()
    np.testing.assert_allclose(np.sort(noise.values), np.linspace(-1.0, 3.0, 8000), atol=1e-12)
    assert noise.crest_factor == pytest.approx(np.sqrt(3.0), rel=1e-3)


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_the_first_sample_lies_within_one_step_of_the_mean(distribution: str):
    for seed in range(5):
        values = Noise.from_options({"distribution": distribution, "seed": seed}).build().values
        largest_step = np.max(np.abs(np.diff(values)))
        assert abs(values[0] - values.mean()) <= largest_step + 0.1 * np.std(values)


@pytest.mark.parametrize(
    ("distribution", "played"),
    [
        ("gaussian", [4.2663448389564165, 4.297991895903367, 6.530485720162437, 4.433720111821927]),
        ("uniform", [3.9260532566570823, 3.423740467558445, 0.8885485685710715, 4.535129391173897]),
    ],
)
def test_what_sessions_have_played_is_what_their_description_builds(distribution: str, played: list[float]):
    description = {
        "type": "noise",
        "distribution": distribution,
        "force_min_n": 0.5,
        "force_max_n": 7.5,
        "cutoff_hz": 200.0,
        "order": 8,
        "seconds": 4.0,
        "sample_rate": 2000.0,
        "seed": 7,
        "clipped": 0.0027,
    }
    np.testing.assert_allclose(rebuild(description).values[[0, 1, 1000, 7999]], played, rtol=1e-9)


TABLES: dict[str, dict[str, object]] = {
    "quantiles": {"quantiles": (0.0, 1.0, 4.0), "probabilities": (0.0, 0.2, 1.0)},
    "power": {"frequencies_hz": (20.0, 50.0, 300.0), "densities": (0.0, 3.0, 0.0)},
    "autocorrelation": {"lags_s": (0.0, 0.01), "correlations": (1.0, 0.0)},
}
SPECTRA = ("butterworth", "band", "white", "exponential", "second_order", "power", "autocorrelation")


@pytest.mark.parametrize("spectrum", SPECTRA)
@pytest.mark.parametrize("distribution", ["gaussian", "uniform", "rayleigh", "exponential", "quantiles"])
def test_every_distribution_with_every_spectrum(distribution: str, spectrum: str):
    options = {"distribution": distribution, "spectrum": spectrum, "seconds": 30.0, "seed": 1}
    noise = Noise.from_options(options | TABLES.get(distribution, {}) | TABLES.get(spectrum, {}))
    built = noise.build()
    if distribution != "gaussian":
        levels = noise.build_distribution().levels(60_000)
        np.testing.assert_array_equal(np.sort(built.values), noise.scale_to_range(levels))
    about = (built.values - built.values.mean()) / built.values.std()
    found = np.array([1.0] + [np.mean(about[:-k] * about[k:]) for k in range(1, 101)])
    wanted = noise.build_spectrum().autocorrelation(100, 2000.0)
    assert np.max(np.abs(found - wanted)) < 0.06  # four standard deviations of the estimate from 30 s, at the widest
    assert abs(about[0]) <= np.max(np.abs(np.diff(about)))


def test_a_binary_signal_keeps_its_two_values_and_most_of_its_spectrum():
    built = Noise(distribution="binary", seconds=30.0, force_min_n=1.0, force_max_n=3.0).build()
    assert np.count_nonzero(built.values == 1.0) == np.count_nonzero(built.values == 3.0) == 30_000
    assert share_above(built.values, 250.0) < 0.2
    assert built.crest_factor == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("options", "refusal"),
    [
        (
            {"cutoff_hz": 1e-4},
            coded("spectrum.low_cutoff", cutoff_hz=0.0001, sample_rate_hz=2000.0, reason="spectrum.settling"),
        ),
        (
            {"cutoff_hz": 5e-324},
            coded("spectrum.low_cutoff", cutoff_hz=5e-324, sample_rate_hz=2000.0, reason="spectrum.settling"),
        ),
        ({"spectrum": "band", "cutoff_hz": 1e-4}, coded("shape.no_power", samples=0.25, seconds=4.0)),
        (
            {"spectrum": "power", "frequencies_hz": (10.01, 10.02), "densities": (1.0, 1.0)},
            coded("shape.no_power", samples=0.25, seconds=4.0),
        ),
        ({"distribution": "quantiles", "quantiles": (-1e308, 1e308)}, coded("quantiles.scale")),
        ({"distribution": "quantiles", "quantiles": (0.0, 1.7e308)}, coded("quantiles.scale")),
        ({"distribution": "quantiles", "quantiles": (0.0, 5e-324)}, coded("quantiles.scale")),
        (
            {"force_min_n": 5.0, "force_max_n": 5.0 + 1e-9},
            coded("stimulus.narrow", low=5.0, least=1e-06, unit="N"),
        ),
    ],
)
def test_what_leaves_nothing_to_play_is_refused_in_one_line(options: dict[str, object], refusal):
    with pytest.raises(UnusableInputError, check=refusal) as refused:
        Noise.from_options(options)
    assert "\n" not in str(refused.value)


def test_tables_survive_json():
    options = {"distribution": "quantiles", "spectrum": "autocorrelation", "seconds": 1.0}
    first = Noise.from_options(options | TABLES["quantiles"] | TABLES["autocorrelation"]).build()
    again = rebuild(json.loads(json.dumps(first.description)))
    np.testing.assert_array_equal(again.values, first.values)
    assert again.description == first.description


@pytest.mark.parametrize(
    ("options", "refusal"),
    [
        (
            {"cutoff_hz": 1000.0},
            coded("spectrum.nyquist", what="a cutoff", frequency_hz=1000.0, needed=2000.0, sample_rate_hz=2000.0),
        ),
        (
            {"cutoff_hz": 1500.0},
            coded("spectrum.nyquist", what="a cutoff", frequency_hz=1500.0, needed=3000.0, sample_rate_hz=2000.0),
        ),
        ({"force_min_n": 8.0}, coded("stimulus.range", what="force", least=8.0, greatest=8.0, unit="N")),
        ({"seconds": 0.001}, coded("shape.short", seconds=0.001, sample_rate=2000.0, name="noise")),
        ({"seconds": -1.0}, coded("option.refused", option="seconds", reason="option.greater")),
        ({"order": 0}, coded("option.refused", option="order", reason="option.least")),
        ({"colour": "pink"}, coded("option.unknown", option="colour")),
        (
            {"spectrum": "band", "cutoff_hz": 1000.0},
            coded("spectrum.nyquist", what="a cutoff", frequency_hz=1000.0, needed=2000.0, sample_rate_hz=2000.0),
        ),
        (
            {"spectrum": "power", "frequencies_hz": (1.0, 2.0), "densities": (1.0, -1.0)},
            coded("spectrum.negative", at=2.0, densities=-1.0),
        ),
        ({"lags_s": (0.0, 1.0)}, coded("shape.table", table="lags_s", option="spectrum", choice="autocorrelation")),
        ({"distribution": "quantiles", "quantiles": (2.0, 1.0)}, coded("quantiles.fall")),
    ],
)
def test_what_cannot_be_built_is_refused_in_one_line(options: dict[str, object], refusal):
    with pytest.raises(UnusableInputError, check=refusal) as refused:
        Noise.from_options(options)
    assert "\n" not in str(refused.value)
