"""Error regions: rate of false regions in noise, and position of true ones."""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from tissueid.device import DeviceDescription
from tissueid.gap.dataset import Dataset, DatasetTest
from tissueid.gap.error_regions import ErrorRegions, find_error_regions, recent_size

RATE_HZ, SAMPLES = 2000.0, 3000
NOISE = {"voltage": 2e-3, "current": 1e-3, "position": 2e-6}
TIME_S = np.arange(SAMPLES) / RATE_HZ
SURFACE_M = 0.010
NAMES = ("bands_hz", "depth_m", "velocity_m_s", "current_a", "amplitude_n", "time_s", "mains_phase_rad")


@cache
def predicted() -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return a test with a command whose amplitude changes twice a second, and signals that follow it."""
    random = np.random.default_rng(7)
    shaking = np.convolve(random.standard_normal(SAMPLES + 4), np.ones(5), "valid") * (
        1.0 + 0.8 * np.sin(4.0 * np.pi * TIME_S)
    )
    slow = np.convolve(shaking, np.exp(-np.arange(200) / 40.0))[:SAMPLES]
    command = 14.0 + shaking
    position = SURFACE_M + 2e-3 + 1e-5 * slow
    return command, {"voltage": command, "current": command / 12.0, "position": position}


def regions_of(position_left: np.ndarray, others: float = 0.0, seed: int = 0) -> ErrorRegions:
    """Return the regions of a test whose position has a residual in floors, shape (n,), in white noise."""
    random = np.random.default_rng(seed)
    command, signals = predicted()
    left = {name: others * random.standard_normal(SAMPLES) for name in signals} | {"position": position_left}
    recorded = {name: values + NOISE[name] * left[name] for name, values in signals.items()}
    purpose = np.ones(SAMPLES, np.int8)
    test = DatasetTest(1, "stochastic", "tissue", command, recorded, purpose, RATE_HZ, SURFACE_M)
    observed = Dataset(DeviceDescription(), (test,), NOISE)
    baseline = SimpleNamespace(parameters=SimpleNamespace(dataset=observed), predictions=[signals])
    return find_error_regions(observed, baseline)  # type: ignore[arg-type]


def white(seed: int) -> np.ndarray:
    return np.random.default_rng([1, seed]).standard_normal(SAMPLES)


def anything(found: ErrorRegions) -> bool:
    answer = found.as_answer()
    return any(answer[name] for name in NAMES) or answer["direction"] != "both" or answer["mains_hz"] is not None


def test_noise_at_the_floor_is_no_region():
    assert not any(anything(regions_of(white(seed), 0.9, seed)) for seed in range(40))


def called(seeds: range) -> dict[str, int]:
    """Count the records by profile in which noise at the limit is called a region: 1.44 squared floors."""
    answers = [regions_of(1.2 * white(seed), 0.9, seed).as_answer() for seed in seeds]
    return {name: sum(bool(answer[name]) for answer in answers) for name in NAMES}


def test_noise_at_the_limit_is_rarely_a_region():
    # The size is 0.01 for each profile: three of forty have a probability of one in a hundred.
    assert max(called(range(40)).values()) <= 2


@pytest.mark.soak
def test_the_size_of_each_picture():
    # At most ten of 1000 are expected; 22 have a probability below one in a thousand.
    assert max(called(range(1000)).values()) <= 21


def test_errors_by_current_are_found():
    current = predicted()[1]["current"]
    high = current > np.quantile(current, 0.7)
    found = regions_of(white(1) + 8.0 * high * np.random.default_rng(2).standard_normal(SAMPLES))
    assert found.channel == "position"
    assert found.above["current_a"]
    # Half a bin can reach over the edge.
    width = np.diff(found.profiles["current_a"].edges)[0]
    assert found.above["current_a"][0][0] > np.quantile(current, 0.7) - width
    assert found.as_answer()["current_a"] == [list(item) for item in found.above["current_a"]]


def test_errors_by_recent_amplitude_are_found():
    test = DatasetTest(1, "x", "tissue", predicted()[0], {}, np.ones(SAMPLES, np.int8), RATE_HZ, SURFACE_M)
    size = recent_size(test, DeviceDescription())
    edge = np.quantile(size, 0.6)
    found = regions_of(white(1) + 8.0 * (size > edge) * np.random.default_rng(2).standard_normal(SAMPLES))
    assert found.above["amplitude_n"]
    assert found.above["amplitude_n"][0][0] == pytest.approx(edge, abs=np.diff(found.profiles["amplitude_n"].edges)[0])
    assert found.above["mains_phase_rad"] == ()


@pytest.mark.parametrize("hz", [49.93, 60.0])
def test_hum_is_found_at_its_phases(hz):
    found = regions_of(white(1) + 6.0 * np.sin(2.0 * np.pi * hz * TIME_S))
    assert found.mains_hz == pytest.approx(hz, abs=0.1)
    error = found.profiles["mains_phase_rad"].error
    # Twelfths of a period: about its top a sine of 6 floors has 5.8 with the noise, about its zeros 2.0.
    assert error[[2, 3, 8, 9]] == pytest.approx(5.8, rel=0.15)
    assert error[[0, 5, 6, 11]] == pytest.approx(2.0, rel=0.2)
    for low, high in found.above["mains_phase_rad"]:
        assert 0.0 <= low < high <= 2.0 * np.pi + 1e-9
    assert found.above["mains_phase_rad"]


def test_noise_that_comes_with_the_mains_is_found_without_a_line():
    burst = (TIME_S * 50.0) % 1.0 < 0.25
    found = regions_of(white(1) + 8.0 * burst * np.random.default_rng(2).standard_normal(SAMPLES))
    assert found.mains_hz == pytest.approx(50.0, abs=0.05)
    assert found.above["mains_phase_rad"][0] == pytest.approx((0.0, np.pi / 2.0), abs=0.55)
    assert (49.5, 50.5) not in found.above["bands_hz"]


def test_the_recent_size_looks_back_a_tenth_of_a_second():
    command = np.concatenate([np.zeros(1000), np.tile([8.0, -8.0], 500)])
    signals = {"position": np.zeros(2000)}
    test = DatasetTest(1, "x", "tissue", command, signals, np.ones(2000, np.int8), RATE_HZ, 0.0)
    size = recent_size(test, DeviceDescription())
    newtons = 8.0 * 3.0 / 12.0
    assert np.all(size[:1000] == 0.0)
    assert size[1100 - 1] == pytest.approx(newtons * np.sqrt(0.5))
    assert size[1200:] == pytest.approx(newtons)
    device = DeviceDescription()
    for by, share in (("voltage", 1.0), ("current", 12.0), ("input", 4.0)):
        other = DatasetTest(1, "x", "tissue", command, signals, test.purpose, RATE_HZ, 0.0, driven_by=by)
        assert recent_size(other, device)[-1] == pytest.approx(newtons * share)
