"""Small noise at several loads: means, noise about them, directions, preload, and what is refused."""

import json

import numpy as np
import pytest
from coded import coded
from hypothesis import given, settings
from hypothesis import strategies as st

from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.identification.engines.localized import Localized
from tissueid.identification.second_order import SecondOrder
from tissueid.records import Record
from tissueid.stimuli import get_stimulus, rebuild, with_preload
from tissueid.stimuli.kinds.noise import SteppedNoise
from tissueid.stimuli.stimulus_check import assess_stimulus


def holds(kind: SteppedNoise) -> np.ndarray:
    """Forces at each mean after its rise, N, shape (holds, samples)."""
    values = kind.build().values.reshape(kind.means_n.size, -1)
    return values[:, round(kind.rise_s * kind.sample_rate) :]


def test_means_rise_and_return_with_noise_about_each():
    kind = SteppedNoise(force_min_n=0.5, force_max_n=8.5, levels=5, amplitude_n=0.5, level_s=1.0, seed=3)
    assert kind.means_n.tolist() == [1.0, 2.75, 4.5, 6.25, 8.0, 6.25, 4.5, 2.75, 1.0]
    parts = holds(kind)
    np.testing.assert_allclose(parts.mean(axis=1), kind.means_n, atol=0.02)
    about = parts - kind.means_n[:, None]
    assert np.abs(about).max() == pytest.approx(0.5, abs=1e-9)
    np.testing.assert_allclose(about.std(axis=1), 0.165, atol=0.03)
    power = np.abs(np.fft.rfft(about * np.hanning(about.shape[1]), axis=1)) ** 2  # without leakage of the ends
    frequency = np.fft.rfftfreq(about.shape[1], 5e-4)
    # The low-pass of order 8 at 200 Hz passes 1 / (1 + 1.5^16) = 0.15 % of the power density at 300 Hz.
    assert power[:, frequency > 300.0].sum() < 1e-3 * power.sum()


@pytest.mark.parametrize(("direction", "sign"), [("in", 1.0), ("out", -1.0)])
def test_one_direction_alone(direction: str, sign: float):
    kind = SteppedNoise(levels=4, level_s=0.5, direction=direction)
    assert np.all(sign * np.diff(kind.means_n) > 0.0)
    assert kind.planned_samples() == 4 * 1000 == len(kind.build())


@pytest.mark.parametrize(("direction", "turns"), [("in", [0.0, 1.0]), ("out", [1.0, 0.0]), ("both", [0.0, 1.0, 0.0])])
@pytest.mark.parametrize("course", ["ramp", "sine"])
def test_the_mean_can_move_all_the_time(course: str, direction: str, turns: list[float]):
    kind = SteppedNoise(course=course, direction=direction, levels=4, level_s=0.5, amplitude_n=0.5, seed=3)
    values = kind.build().values
    assert values.size == kind.planned_samples()
    place = np.linspace(0.0, len(turns) - 1.0, values.size)
    share = np.interp(place, np.arange(len(turns)), turns)
    mean = 1.0 + 7.0 * (share if course == "ramp" else np.sin(0.5 * np.pi * share) ** 2)
    about = values - mean
    assert np.abs(about).max() <= 0.51
    assert abs(about.mean()) < 0.02
    assert with_preload(kind.build(), 0.5).values[999] == pytest.approx(mean[0])


@pytest.mark.parametrize("course", ["ramp", "sine"])
def test_local_stiffness_is_found_about_a_moving_mean(course: str):
    """A system of known tangent stiffness, 1 / (c1 c2) exp(c2 F), which is the slope of y = c1 (1 - exp(-c2 F))."""
    kind = SteppedNoise(course=course, direction="in", levels=8, level_s=1.0, amplitude_n=0.5, seed=3)
    force = kind.build().values
    slow = SecondOrder(mass=0.09, damping=20.0, stiffness=1000.0).simulate(force, kind.sample_rate)  # m, 1 N/mm
    record = Record(force, 8e-3 * (1.0 - np.exp(-0.15e3 * slow)), kind.sample_rate, "force", "position", "N", "m")
    levels = (2.0, 3.5, 5.0, 6.5)
    model = Localized(levels=levels).fit(record)
    for level in model.levels:
        tangent = np.exp(0.15 * level.force) / (8e-3 * 0.15)
        assert level.fit.system.stiffness == pytest.approx(tangent, rel=0.06)
    assert [level.force for level in model.levels][1:3] == pytest.approx([3.5, 5.0], abs=0.3)


@settings(max_examples=25)
@given(
    low=st.floats(-5.0, 5.0),
    span=st.floats(1.5, 10.0),
    levels=st.integers(2, 8),
    distribution=st.sampled_from(["gaussian", "uniform", "rayleigh"]),
)
def test_no_sample_leaves_the_range(low: float, span: float, levels: int, distribution: str):
    kind = SteppedNoise(
        force_min_n=low, force_max_n=low + span, levels=levels, level_s=0.25, distribution=distribution, seed=levels
    )
    values = kind.build().values
    assert values.size == kind.planned_samples()
    assert values.min() >= low
    assert values.max() <= low + span


def test_it_begins_at_its_first_mean_and_its_edges_are_gentle():
    played = with_preload(SteppedNoise().build(), 0.5)
    assert played.values[999] == pytest.approx(1.0)
    assert abs(played.values[1000] - 1.0) < 0.05
    found = assess_stimulus(played, DeviceDescription(), max_force_n=12.0, max_seconds=30.0, max_temperature_c=80.0)
    assert found.concerns == ()
    assert found.edge_ratio < 0.2


def test_it_is_built_again_sample_for_sample():
    played = with_preload(SteppedNoise(levels=3, level_s=0.5, seed=9).build(), 0.5)
    again = rebuild(json.loads(json.dumps(played.description)))
    np.testing.assert_array_equal(again.values, played.values)
    assert get_stimulus("stepped_noise").test_kind == "stochastic"


@pytest.mark.parametrize(
    ("options", "code"),
    [
        ({"force_min_n": 8.5, "force_max_n": 0.5}, "stimulus.range"),
        ({"amplitude_n": 4.0}, "stepped_noise.amplitude"),
        ({"level_s": 0.5, "rise_s": 0.4}, "stepped_noise.rise"),
        ({"level_s": 60.0, "levels": 50, "sample_rate": 1e6}, "stimulus.samples"),
    ],
)
def test_what_cannot_be_made_is_refused(options: dict, code: str):
    with pytest.raises(UnusableInputError, check=coded(code)):
        get_stimulus("stepped_noise").from_options(options)


@pytest.mark.parametrize("options", [{"cutoff_hz": 1500.0}, {"distribution": "quantiles"}, {"levels": 1}])
def test_noise_that_cannot_be_made_is_refused(options: dict):
    with pytest.raises(UnusableInputError):
        get_stimulus("stepped_noise").from_options(options)
