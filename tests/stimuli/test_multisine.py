"""Multisines: their lines, spectrum, crest factor, joints, and the distortion that they let a record tell."""

from __future__ import annotations

import json
from itertools import pairwise
from typing import Any

import known_distortion as known
import numpy as np
import pytest
from coded import coded
from hypothesis import given, settings
from hypothesis import strategies as st

from tissueid.errors import UnusableInputError
from tissueid.identification.validation.distortion import distortion
from tissueid.stimuli import rebuild, stimulus_names, with_preload
from tissueid.stimuli.kinds.multisine import (
    Multisine,
    minimise_crest_factor,
    multisine_crest_factor,
    multisine_from_description,
    schroeder_phases,
)
from tissueid.stimuli.kinds.noise import Noise

QUICK: dict[str, Any] = {"phases": "random", "draws": 1}
RANGE = {"force_min_n": known.LOW_N, "force_max_n": known.HIGH_N}


def made(**options: Any) -> Multisine:
    return Multisine.from_options(options)


def levels(multisine: Multisine) -> np.ndarray:
    """Amplitude of every line from 1 to half the period, by the sums that define it."""
    one = multisine.build().values[-multisine.period :]
    k = np.arange(1, (multisine.period + 1) // 2)
    turns = np.exp(-2j * np.pi * (np.outer(k, np.arange(one.size)) % one.size) / one.size)
    return 2.0 * np.abs(turns @ (one - one.mean())) / one.size


def true_crest(values: np.ndarray) -> float:
    """Peak over root-mean-square of one period, with the values between the samples (zero-padded spectrum)."""
    about = values - values.mean()
    fine = np.fft.irfft(np.fft.rfft(about), 16 * about.size) * 16.0
    return float(np.abs(fine).max() / np.sqrt(np.mean(about**2)))


@pytest.mark.parametrize("lines", ["full", "odd", "odd_random"])
def test_driven_lines_are_flat_and_the_others_hold_nothing(lines: str):
    spec = made(lines=lines, period_s=0.5, lowest_hz=6.0, highest_hz=150.0, **QUICK)
    driven = spec.driven_lines()
    found = levels(spec)
    on = np.isin(np.arange(1, found.size + 1), driven)
    assert driven[0] >= 3
    assert driven[-1] <= 75
    assert np.ptp(found[on]) < 1e-9 * found[on].mean()
    assert found[~on].max() < 1e-12 * found[on].min()
    expected = {"full": np.arange(3, 76), "odd": np.arange(3, 76, 2)}
    if lines in expected:
        np.testing.assert_array_equal(driven, expected[lines])
        assert spec.detection_lines().size == 0
    else:
        np.testing.assert_array_equal(np.union1d(driven, spec.detection_lines()), expected["odd"])


@pytest.mark.parametrize("group", [2, 3, 4, 7])
def test_each_group_of_odd_lines_has_one_detection_line_within_the_driven_band(group: int):
    for seed in range(20):
        spec = made(group=group, lines_seed=seed, highest_hz=100.0, **QUICK)
        driven, detection = spec.driven_lines(), spec.detection_lines()
        odd = np.union1d(driven, detection)
        assert detection.size == odd.size // group
        np.testing.assert_array_equal(np.searchsorted(odd, detection) // group, np.arange(detection.size))
        assert driven[0] < detection[0]
        assert detection[-1] < driven[-1]
    choices = {tuple(made(group=group, lines_seed=seed, **QUICK).detection_lines()) for seed in range(20)}
    assert len(choices) == 20


def test_realisations_share_their_lines_and_differ_in_their_phases():
    first, second = (made(seed=seed, **QUICK) for seed in (1, 2))
    np.testing.assert_array_equal(first.driven_lines(), second.driven_lines())
    a, b = first.build().values, second.build().values
    assert abs(np.corrcoef(a, b)[0, 1]) < 0.2


def test_notches_and_their_edges_are_left_out():
    spec = made(notches=[(30.0, 40.0), (90.0, 90.5)], lines="full", period_s=1.0, **QUICK)
    left_out = np.concatenate([np.arange(30, 41), [90]])
    np.testing.assert_array_equal(spec.driven_lines(), np.setdiff1d(np.arange(1, 201), left_out))
    found = levels(spec)
    assert found[left_out - 1].max() < 1e-12 * found.max()
    odd = made(notches=[(30.0, 40.0)], **QUICK)
    hz = np.union1d(odd.driven_lines(), odd.detection_lines()) * odd.resolution_hz
    assert not np.any((hz >= 30.0) & (hz <= 40.0))


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"spectrum": "butterworth", "cutoff_hz": 50.0, "order": 3}, lambda f: 1.0 / np.sqrt(1.0 + (f / 50.0) ** 6)),
        ({"spectrum": "power_law", "exponent": 0.5}, lambda f: f**-0.5),
        ({"spectrum": "table", "table": [(10.0, 1.0), (110.0, 3.0)]}, lambda f: 1.0 + (np.clip(f, 10, 110) - 10) / 50),
    ],
)
def test_amplitudes_follow_the_spectrum(options: dict[str, Any], expected: Any):
    spec = made(period_s=1.0, lines="odd", **options, **QUICK)
    driven = spec.driven_lines()
    found, asked = levels(spec)[driven - 1], expected(driven * 1.0)
    np.testing.assert_allclose(found / found[0], asked / asked[0], rtol=1e-9)


def test_lines_of_no_amplitude_are_not_driven():
    spec = made(period_s=1.0, spectrum="table", table=[(50.0, 1.0), (100.0, 0.0)], lines="full", **QUICK)
    np.testing.assert_array_equal(spec.driven_lines(), np.arange(1, 100))


@settings(max_examples=25)
@given(
    period=st.integers(64, 500),
    periods=st.integers(1, 4),
    settling=st.integers(0, 900),
    seed=st.integers(0, 2**63 - 1),
    low=st.floats(-20.0, 20.0),
    span=st.floats(0.1, 30.0),
)
def test_periods_join_exactly_within_the_range(
    period: int, periods: int, settling: int, seed: int, low: float, span: float
):
    spec = made(
        period_samples=period, periods=periods, settling_s=settling / 2000.0, seed=seed, highest_hz=900.0,
        lines="odd", force_min_n=low, force_max_n=low + span, **QUICK,
    )  # fmt: skip
    built = spec.build()
    values = built.values
    assert values.shape == (settling + periods * period,)
    np.testing.assert_array_equal(values[period:], values[:-period] if values.size > period else values[period:])
    assert values[-period:].min() == pytest.approx(low, abs=1e-9 * (1.0 + abs(low)))
    assert values[-period:].max() == pytest.approx(low + span, abs=1e-9 * (1.0 + abs(low) + span))
    assert values.min() >= low
    assert values.max() <= low + span
    assert abs(values[0] - values.mean()) <= np.abs(np.diff(values)).max()


def test_the_preload_leads_into_it_without_a_step():
    for options in ({}, {"lines": "full"}, {"settling_s": 0.0}, {"settling_s": 1.3, "spectrum": "power_law"}):
        built = made(**options, **QUICK).build()
        values = with_preload(built).values
        assert np.abs(np.diff(values))[998:1001].max() <= np.abs(np.diff(built.values)).max()


def test_a_voltage_can_be_designed():
    built = made(voltage_min_v=-3.0, voltage_max_v=9.0, **QUICK).build()
    assert built.unit == "V"
    assert (built.values.min(), built.values.max()) == pytest.approx((-3.0, 9.0))


def test_the_same_specification_gives_the_same_samples_also_through_json():
    for options in ({"seed": 5}, {"notches": [(20.0, 30.0)], "phases": "random"}, {"lines": "full", "draws": 1}):
        options = {"period_s": 0.25, **options}
        spec = made(**options)
        built = spec.build()
        np.testing.assert_array_equal(made(**options).build().values, built.values)
        held = json.loads(json.dumps(with_preload(built).description))
        np.testing.assert_array_equal(rebuild(held).values, with_preload(built).values)
        assert held["stimulus"]["type"] == "multisine"
        assert held["stimulus"]["period_samples"] == spec.period
        assert held["stimulus"]["period_s"] == spec.period / 2000.0
        found = multisine_from_description(held)
        assert found is not None
        np.testing.assert_array_equal(found.driven_lines(), spec.driven_lines())
    assert "multisine" in stimulus_names()


def test_a_period_in_samples_and_in_seconds_are_the_same():
    for samples, seconds in ((3000, 1.5), (1000, 0.5), (14, 0.007)):
        band = {"highest_hz": 900.0, "lines": "full"}
        one, other = made(period_samples=samples, **band, **QUICK), made(period_s=seconds, **band, **QUICK)
        assert one.period == other.period == samples
        np.testing.assert_array_equal(one.build().values, other.build().values)


def test_descriptions_of_other_stimuli_are_no_multisine():
    assert multisine_from_description(Noise().describe()) is None
    assert multisine_from_description(with_preload(Noise(seconds=0.5).build()).description) is None
    assert multisine_from_description({"type": "multisine", "period_s": 1.0}) is None  # another program's
    assert multisine_from_description({}) is None
    with pytest.raises(UnusableInputError, check=coded("option.refused", option="periods", reason="option.least")):
        multisine_from_description(made().describe() | {"periods": 0})


@pytest.mark.parametrize(("lines", "most"), [("full", 1.42), ("odd", 1.50), ("odd_random", 1.62)])
def test_low_crest_factors(lines: str, most: float):
    spec = made(lines=lines, period_s=0.5)
    built = spec.build()
    assert true_crest(built.values[-spec.period :]) < most
    assert built.crest_factor < most
    schroeder = made(lines=lines, period_s=0.5, phases="schroeder").build()
    drawn = made(lines=lines, period_s=0.5, **QUICK).build()
    assert true_crest(built.values[-1000:]) < 0.95 * true_crest(schroeder.values[-1000:])
    assert true_crest(built.values[-1000:]) < 0.75 * true_crest(drawn.values[-1000:])


def test_low_crest_keeps_the_amplitudes():
    spec = made(period_s=0.25, lines="full", spectrum="butterworth")
    np.testing.assert_allclose(levels(spec)[:50] / levels(spec)[0], spec.amplitudes() / spec.amplitudes()[0], rtol=1e-9)


def test_more_draws_lower_the_crest_factor_of_random_phases():
    crests = [[made(phases="random", draws=n, seed=s).build().crest_factor for s in range(8)] for n in (1, 30)]
    assert np.mean(crests[1]) < np.mean(crests[0]) - 0.3


def test_schroeder_phases_of_a_flat_spectrum_are_those_of_his_closed_form():
    n = 31
    phases = schroeder_phases(np.ones(n))
    k = np.arange(1, n + 1)
    np.testing.assert_allclose(np.exp(1j * phases), np.exp(-1j * np.pi * k * (k - 1) / n), atol=1e-9)


def test_lowering_never_raises_and_reaches_the_literature():
    # Guillaume et al. (1991): 31 flat lines from 1.78 after Schroeder to about 1.4.
    lines, flat = np.arange(1, 32), np.ones(31)
    start = schroeder_phases(flat)
    once = minimise_crest_factor(lines, flat, start, 512)
    assert multisine_crest_factor(lines, flat, start, 512) == pytest.approx(1.78, abs=0.03)
    assert multisine_crest_factor(lines, flat, once, 512) < 1.42
    assert multisine_crest_factor(
        lines, flat, minimise_crest_factor(lines, flat, once, 512), 512
    ) <= multisine_crest_factor(lines, flat, once, 512)


def test_two_lines_are_a_multisine():
    built = made(lines="full", period_s=0.1, highest_hz=20.0).build()
    assert np.isfinite(built.values).all()
    assert built.crest_factor < 1.8


LINEAR_SEEDS = range(1000, 1024)


@pytest.mark.parametrize("realisations", [1, 6])
def test_levels_are_within_one_decibel_of_the_truth(realisations: int):
    spec = made(phases="random", draws=20, **RANGE)
    linear = known.linear_answer(spec, LINEAR_SEEDS)
    for first in (0, 10):
        played = [spec.model_copy(update={"seed": first + k}) for k in range(realisations)]
        exact = known.truth(played, linear)
        records = [known.recorded(one) for one in played]
        found = distortion(records, spec.period, spec.driven_lines().tolist(), spec.settling_s)
        assert found.noise_rms is not None
        assert found.even_rms is not None
        assert found.odd_rms is not None
        assert known.decibels(found.noise_rms.value / exact.noise) == pytest.approx(0.0, abs=1.0)
        assert known.decibels(found.even_rms.value / exact.even) == pytest.approx(0.0, abs=1.0)
        assert known.decibels(found.odd_rms.value / exact.odd) == pytest.approx(0.0, abs=1.0)


def test_low_crest_levels_at_lines_that_are_not_driven():
    spec = made(draws=1, **RANGE)
    exact = known.truth([spec], np.ones(spec.driven_lines().size, dtype=complex))
    found = distortion(known.recorded(spec), spec.period, spec.driven_lines().tolist(), spec.settling_s)
    assert found.even_rms is not None
    assert known.decibels(found.even_rms.value / exact.even) == pytest.approx(0.0, abs=0.3)
    stood = np.sqrt(np.sum(found.detection.level**2 - found.detection.noise**2))
    assert known.decibels(stood / exact.detection) == pytest.approx(0.0, abs=0.3)
    np.testing.assert_array_equal(found.detection.line, spec.detection_lines())


def test_distortion_finds_period_and_lines_by_itself():
    spec = made(phases="random", draws=20, **RANGE)
    found = distortion(known.recorded(spec))
    assert found.period == spec.period
    np.testing.assert_array_equal(found.driven.line, spec.driven_lines())
    np.testing.assert_array_equal(found.detection.line, spec.detection_lines())


@pytest.mark.parametrize(
    ("options", "refusal"),
    [
        ({"highest_hz": 1000.0}, coded("multisine.nyquist", highest_hz=1000.0, needed=2000.0, sample_rate=2000.0)),
        (
            {"highest_hz": 200.0, "sample_rate": 300.0},
            coded("multisine.nyquist", highest_hz=200.0, needed=400.0, sample_rate=300.0),
        ),
        ({"period_s": 0.0333}, coded("multisine.period_fraction", period_s=0.0333, sample_rate=2000.0, whole=0.0335)),
        (
            {"period_s": 1.0, "period_samples": 1999},
            coded("multisine.period_twice", period_s=1.0, exact=2000.0, period_samples=1999),
        ),
        ({"period_s": 0.002}, coded("multisine.period", limit=1048576, period=4)),
        ({"period_s": 100.0, "periods": 8}, coded("multisine.length", periods=8, seconds=800.25, limit=600.0)),
        ({"lowest_hz": 50.0, "highest_hz": 40.0}, coded("multisine.band", what="the band", low=50.0, high=40.0)),
        ({"notches": [(40.0, 30.0)]}, coded("multisine.band", what="a notch", low=40.0, high=30.0)),
        (
            {"notches": [(0.0, 250.0)]},
            coded("multisine.lines", count="no", which="odd line", left=" after the notches"),
        ),
        ({"lowest_hz": 10.1, "highest_hz": 10.2}, coded("multisine.lines", count="no", which="odd line", left="")),
        ({"lowest_hz": 1.0, "highest_hz": 4.0, "group": 9}, coded("multisine.detection", size=3, group=9)),
        ({"lines": "full", "group": 4}, coded("multisine.group", lines="full")),
        ({"lines": "odd", "group": 4}, coded("multisine.group", lines="odd")),
        ({"spectrum": "table"}, coded("multisine.table_spectrum")),
        ({"table": [(1.0, 1.0)]}, coded("multisine.table_spectrum")),
        ({"notches": [(1.0, 2.0)] * 1001}, coded("option.refused", option="notches", reason="option.long")),
        (
            {"spectrum": "table", "table": [(float(k), 1.0) for k in range(10_001)]},
            coded("option.refused", option="table", reason="option.long"),
        ),
        ({"spectrum": "table", "table": [(1.0, 1e-170)]}, coded("multisine.power", power=0.0)),
        ({"spectrum": "table", "table": [(1.0, 1e200)]}, coded("multisine.power")),
        (
            {"spectrum": "butterworth", "cutoff_hz": 1e-300, "order": 1},
            coded("multisine.lines", count="no", which="odd line", left=""),
        ),
        ({"spectrum": "table", "table": [(2.0, 1.0), (1.0, 1.0)]}, coded("multisine.table")),
        ({"spectrum": "table", "table": [(2.0, 0.0)]}, coded("multisine.table")),
        ({"force_min_n": 8.0}, coded("stimulus.range", what="force", least=8.0, greatest=8.0, unit="N")),
        ({"force_max_n": 101.0}, coded("option.refused", option="force_max_n", reason="option.most")),
        ({"voltage_min_v": 1.0}, coded("stimulus.voltage_ends")),
        ({"lines": "even"}, coded("option.refused", option="lines", reason="option.choice")),
        ({"group": 1}, coded("option.refused", option="group", reason="option.least")),
    ],
)
def test_what_cannot_be_built_is_refused_in_one_line(options: dict[str, Any], refusal):
    with pytest.raises(UnusableInputError, check=refusal) as refused:
        made(**options)
    assert "\n" not in str(refused.value)


def test_groups_of_lines_stay_apart_by_no_more_than_two_of_them():
    gaps = [b - a for a, b in pairwise(made(group=2, lines_seed=3, **QUICK).driven_lines())]
    assert max(gaps) <= 6
