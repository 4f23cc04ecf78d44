"""What a stimulus is said to do to coil and person, against sums done apart and the instrument's own refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from coded import coded, is_german, message
from hypothesis import given, settings
from hypothesis import strategies as st

from tissueid.device import DeviceDescription
from tissueid.errors import LimitError, UnusableInputError
from tissueid.instrument import CLINICAL, RESEARCH, check_stimulus
from tissueid.stimuli import Stimulus, build_stimulus, to_voltage, with_preload
from tissueid.stimuli.stimulus_check import (
    REFERENCE_EDGE_N_PER_S,
    AssumedValue,
    StimulusCheck,
    ThermalParameters,
    assess_stimulus,
    heating,
)

DEVICE = DeviceDescription()
RATE = 2000.0


def stimulus(values: np.ndarray, unit: str = "N", rate: float = RATE) -> Stimulus:
    return Stimulus(np.asarray(values, dtype=float), rate, {"type": "test"}, 0, 1.0, unit=unit)  # type: ignore[arg-type]


def appraised(played: Stimulus, device: DeviceDescription = DEVICE, **options: float) -> StimulusCheck:
    limits = {"max_force_n": 12.0, "max_seconds": 30.0, "max_temperature_c": 80.0}
    return assess_stimulus(played, device, **{**limits, **options})


def refusals(found: StimulusCheck) -> list[str]:
    return [concern.message for concern in found.concerns if concern.severity == "refused"]


def test_a_sine_has_the_figures_of_a_sine():
    t = np.arange(8000) / RATE
    found = appraised(stimulus(6.0 + 3.0 * np.sin(2.0 * np.pi * 25.0 * t)))
    assert (found.force_min_n, found.force_max_n) == pytest.approx((3.0, 9.0), abs=1e-3)
    assert (found.voltage_min_v, found.voltage_max_v) == pytest.approx((12.0, 36.0), abs=4e-3)  # 12 ohm, 3 N/A
    assert found.force_mean_n == pytest.approx(6.0)
    assert found.force_std_n == pytest.approx(3.0 / np.sqrt(2.0))
    assert found.crest_factor == pytest.approx(np.sqrt(2.0), rel=1e-3)
    assert found.excess_kurtosis == pytest.approx(-1.5, abs=1e-6)
    assert found.skewness == pytest.approx(0.0, abs=1e-6)
    most = 3.0 * np.cos(0.05 * np.pi)  # a sine is above it for 5 % of the time
    assert found.percentiles_n == pytest.approx((6.0 - most, 6.0, 6.0 + most), abs=0.05)
    assert found.peak_current_a == pytest.approx(3.0, abs=1e-3)
    assert found.rms_current_a == pytest.approx(np.sqrt(4.0 + 0.5))
    assert found.power_95_hz == pytest.approx(25.0, abs=0.5)
    assert found.power_99_hz == pytest.approx(25.0, abs=0.5)
    assert dict(found.power_above)[100.0] < 1e-6
    assert found.steepest_edge_n_per_s == pytest.approx(3.0 * 2.0 * np.pi * 25.0, rel=2e-3)  # a chord
    assert found.steepest_edge_n_per_ms == pytest.approx(found.steepest_edge_n_per_s / 1e3)
    assert found.playable
    assert found.concerns == ()


def test_volts_are_taken_as_they_are():
    values = 20.0 + 4.0 * np.sin(np.arange(4000) / 10.0)
    volts, newtons = appraised(stimulus(values, "V")), appraised(stimulus(values / 4.0, "N"))
    assert volts.unit == "V"
    assert replace(volts, unit="N", concerns=()) == replace(newtons, concerns=())


def test_power_ends_where_it_was_put():
    rng = np.random.default_rng(3)
    spectrum = np.zeros(10001, dtype=complex)
    spectrum[1:1001] = np.exp(2j * np.pi * rng.random(1000))  # flat to 100 Hz
    noise = np.fft.irfft(spectrum, 20000)
    found = appraised(stimulus(5.0 + noise / np.abs(noise).max()))
    assert found.power_95_hz == pytest.approx(95.0, abs=2.0)
    assert found.power_99_hz == pytest.approx(99.0, abs=1.5)
    shares = dict(found.power_above)
    assert shares[100.0] < 0.01
    assert shares[200.0] < 1e-6
    binary = appraised(stimulus(np.where(rng.random(20000) < 0.5, 1.0, 5.0)))
    assert binary.power_95_hz == pytest.approx(950.0, abs=15.0)
    assert dict(binary.power_above)[200.0] == pytest.approx(0.8, abs=0.03)


def test_heating_is_the_solution_of_its_equation():
    rng = np.random.default_rng(4)
    current = np.repeat(rng.uniform(0.0, 4.0, 40), 500)  # 10 s at 2 kHz
    thermal = ThermalParameters(AssumedValue(5.0, 10.0, 20.0), AssumedValue(0.5, 1.0, 3.0))
    found = heating(current, 12.0, RATE, thermal)

    def slowly(capacity: float, resistance: float) -> float:
        warm, warmest, fine = 0.0, 0.0, 8
        for value in current[::500]:
            for _ in range(500 * fine):
                warm += (value**2 * 12.0 - warm / resistance) / capacity / RATE / fine
                warmest = max(warmest, warm)
        return warmest

    assert found.expected_k == pytest.approx(slowly(10.0, 1.0), rel=1e-3)
    assert found.least_k == pytest.approx(slowly(20.0, 0.5), rel=1e-3)
    assert found.most_k == pytest.approx(slowly(5.0, 3.0), rel=1e-3)
    energy = 12.0 * np.sum(current**2) / RATE
    assert found.energy_j == pytest.approx(energy)
    assert found.bound_k == pytest.approx(energy / 5.0)


def test_heating_figures_are_in_order():
    for seconds in (1.0, 10.0, 100.0):
        warmth = appraised(stimulus(np.full(round(seconds * RATE), 9.0))).heating
        assert 0.0 < warmth.least_k < warmth.expected_k < warmth.most_k <= warmth.bound_k
    # A long while: current squared times resistance times the way out.
    assert heating(np.full(400_000, 1.0), 12.0, 100.0).expected_k == pytest.approx(96.0, rel=1e-6)


def test_the_reference_edge_is_that_of_the_standard_noise():
    edges = [
        appraised(
            build_stimulus("noise", {"force_min_n": 0.5, "force_max_n": 10.5, "seed": seed})
        ).steepest_edge_n_per_s
        for seed in range(40)
    ]
    assert np.median(edges) == pytest.approx(REFERENCE_EDGE_N_PER_S, rel=0.03)
    assert min(edges) > 3700.0
    assert max(edges) < 5900.0


@pytest.mark.parametrize("kind", ["gaussian", "uniform"])
def test_noise_is_painless_and_binary_is_not(kind: str):
    options = {"distribution": kind, "force_min_n": 0.5, "force_max_n": 10.5}
    noise = appraised(with_preload(build_stimulus("noise", options)))
    assert noise.concerns == ()
    assert noise.feel.code == "stimulus.feel.gentle"
    binary = appraised(stimulus(np.where(np.random.default_rng(5).random(8000) < 0.5, 0.5, 10.5)))
    assert binary.edge_ratio == pytest.approx(4.35, abs=0.05)
    assert binary.sharp_edges_per_s == pytest.approx(1000.0, abs=50.0)
    assert [concern.severity for concern in binary.concerns] == ["caution"]
    assert binary.concerns[0].message.code == "stimulus.check.hurts"
    assert binary.feel.code == "stimulus.feel.hurts"
    assert binary.playable
    gentler = appraised(stimulus(np.where(np.random.default_rng(5).random(8000) < 0.5, 3.0, 8.0)))
    assert gentler.concerns[0].message.code == "stimulus.check.steep"
    assert gentler.feel.code == "stimulus.feel.harder"


def test_the_preload_counts_for_the_coil_and_not_for_the_stimulus():
    noise = build_stimulus("noise", {"force_min_n": 1.0, "force_max_n": 7.0, "seed": 2})
    bare, led = appraised(noise), appraised(with_preload(noise, 2.0))
    for name in ("force_std_n", "crest_factor", "percentiles_n", "power_95_hz", "excess_kurtosis"):
        assert getattr(bare, name) == getattr(led, name), name
    assert bare.crest_factor == pytest.approx(noise.crest_factor)
    assert led.seconds == bare.seconds + 2.0
    assert led.heating.energy_j > 1.4 * bare.heating.energy_j


def test_what_the_limits_refuse_is_told_before():
    steady = np.full(4000, 5.0)
    cases = [
        (stimulus(steady + 7.5), {}, ("stimulus.check.force", 12.5)),
        (stimulus(-steady - 7.5), {}, ("stimulus.check.force", 12.5)),
        (stimulus(steady + 8.0), {"max_force_n": 20.0}, ("stimulus.check.voltage", 52.0)),
        (stimulus(np.full(62_000, 1.0)), {}, ("stimulus.check.length", 31.0)),
        (stimulus(np.full(40_000, 12.0)), {}, ("stimulus.check.hot", None)),
        (stimulus(steady, rate=1000.0), {}, ("stimulus.check.rate", 1000.0)),
    ]
    for played, limits, (code, value) in cases:
        found = appraised(played, **limits)
        assert not found.playable
        refusal = message(refusals(found), code)
        assert value is None or value in [pytest.approx(held) for held in refusal.values.values()]
        assert is_german(refusal)
        assert all("\n" not in words for words in refusals(found))


def test_a_coil_that_may_get_too_warm_is_a_caution():
    found = appraised(stimulus(np.full(20_000, 9.0)))
    assert found.heating.most_k > 80.0 - 23.0
    assert found.heating.expected_k < 80.0 - 23.0
    assert [concern.severity for concern in found.concerns] == ["caution"]
    assert found.concerns[0].message.code == "stimulus.check.warm"
    assert not appraised(stimulus(np.full(20_000, 9.0)), start_c=45.0).playable


def test_pulling_is_a_caution():
    found = appraised(stimulus(2.0 + 3.0 * np.sin(np.arange(4000) / 20.0)))
    assert message([found.concerns[0].message], "stimulus.check.pulls").values["force"] == pytest.approx(1.0, rel=1e-3)
    assert found.playable


@settings(max_examples=60)
@given(
    peak=st.floats(0.1, 20.0),
    gain=st.sampled_from([1.0, 2.0]),
    seconds=st.floats(0.01, 40.0),
    research=st.booleans(),
    volts=st.booleans(),
)
def test_it_is_playable_exactly_when_the_instrument_takes_it(
    peak: float, gain: float, seconds: float, research: bool, volts: bool
):
    device = replace(DEVICE, amplifier_gain=gain)
    limits = RESEARCH if research else CLINICAL
    played = stimulus(np.full(max(2, round(seconds * RATE)), peak * (4.0 if volts else 1.0)), "V" if volts else "N")
    found = appraised(played, device, max_force_n=limits.max_force_n, max_temperature_c=1e9)
    try:
        check_stimulus(to_voltage(played.values, device, played.unit), device, limits)
        taken = True
    except LimitError:
        taken = False
    assert found.playable == taken


def test_a_steady_load_has_no_figures_of_variation():
    found = appraised(stimulus(np.full(1000, 4.0)))
    assert found.crest_factor is None
    assert found.power_95_hz is None
    assert found.skewness is None
    assert message(found.summary(), "stimulus.summary.constant").values["force"] == pytest.approx(4.0)
    assert appraised(stimulus(np.array([4.0]))).steepest_edge_n_per_s == 0.0
    assert appraised(stimulus(np.zeros(100))).crest_factor is None


def test_the_summary_is_sentences_for_a_person():
    found = appraised(
        with_preload(build_stimulus("multisine", {"force_min_n": 0.5, "force_max_n": 10.5, "phases": "random"}))
    )
    assert len(found.summary()) == 6
    assert all(map(is_german, found.summary()))
    for sentence in found.summary():
        assert sentence.endswith(".")
        assert "\n" not in sentence
        assert "nan" not in sentence
    told = " ".join(found.summary())
    for part in ("0.00 to 10.50 N", "0.0 to 42.0 V", "crest factor", "The coil warms by about", "N/ms"):
        assert part in told


@pytest.mark.parametrize("values", [np.zeros(0), np.array([1.0, np.nan]), np.array([1.0, np.inf])])
def test_what_is_no_row_of_numbers_is_refused(values: np.ndarray):
    with pytest.raises(UnusableInputError, check=coded("stimulus.not_finite")) as refused:
        appraised(stimulus(values))
    assert "\n" not in str(refused.value)
