"""The redesign of a stimulus for an even depth, on systems that are written down here."""

import numpy as np
import pytest
from coded import coded
from scipy import signal

from tissueid.errors import UnusableInputError
from tissueid.stimuli import rebuild
from tissueid.stimuli.depth_uniform import DepthDesign, design_next_noise, distance_from_uniform

RATE = 2000.0
PRELOAD_S = 0.5


def lagging(curve, corner_hz=30.0):
    """A first-order lag and then a static curve, from rest at the first force."""
    pole = np.exp(-2.0 * np.pi * corner_hz / RATE)

    def simulate(force):
        lagged, _ = signal.lfilter([1.0 - pole], [1.0, -pole], force, zi=[pole * force[0]])
        return curve(lagged)

    return simulate


SYSTEMS = {
    "linear": lagging(lambda n: 1e-3 * n),
    "saturating": lagging(lambda n: 7e-3 * (1.0 - np.exp(-0.25 * n))),
    "stiffening": lagging(lambda n: 2e-3 * np.sign(n) * np.abs(n) ** 0.5),
    "slow": lagging(lambda n: 1e-3 * n, corner_hz=8.0),
}


def design(**changes):
    options = {"depth_min_m": 1.0e-3, "depth_max_m": 5.0e-3, "force_max_n": 10.0, "seconds": 3.0} | changes
    return DepthDesign.from_options(options)


def share_apart(depth, low, high):
    """Kolmogorov distance from uniform, by its definition."""
    depth = np.sort(depth)
    wanted = np.clip((depth - low) / (high - low), 0.0, 1.0)
    counted = np.arange(depth.size + 1) / depth.size
    return max(np.abs(wanted - counted[1:]).max(), np.abs(wanted - counted[:-1]).max())


@pytest.mark.parametrize("name", SYSTEMS)
def test_the_depth_is_even_where_the_description_is_the_truth(name):
    found = design_next_noise(SYSTEMS[name], design(), 3, PRELOAD_S)
    force = found.stimulus.build().values
    assert force.size == 6000
    assert force.min() >= 0.0
    assert force.max() <= 10.0
    depth = SYSTEMS[name](np.concatenate([np.full(1000, force.mean()), force]))[1000:]
    assert (found.depth_min_m, found.depth_max_m) == (1.0e-3, 5.0e-3)
    assert share_apart(depth, 1.0e-3, 5.0e-3) == pytest.approx(found.distance, abs=0.005)
    assert found.distance <= 0.025
    assert found.distance == min(found.history)
    assert found.history[0] > found.distance


def test_most_power_is_slow_and_some_reaches_the_cut_off_and_none_beyond():
    found = design_next_noise(SYSTEMS["saturating"], design(seconds=8.0), 3, PRELOAD_S)
    frequency, density = signal.welch(found.stimulus.build().values, RATE, nperseg=2000)
    power = np.cumsum(density) / density.sum()
    assert power[frequency <= 16.0][-1] > 0.75
    assert power[frequency <= 100.0][-1] < 0.96
    assert power[frequency <= 220.0][-1] > 0.995


def test_it_is_built_again_from_its_description():
    stimulus = design_next_noise(SYSTEMS["linear"], design(), 3, PRELOAD_S).stimulus
    np.testing.assert_array_equal(rebuild(stimulus.build().description).values, stimulus.build().values)


def test_another_seed_gives_other_noise_as_even():
    one, other = (design_next_noise(SYSTEMS["saturating"], design(), seed, PRELOAD_S) for seed in (1, 2))
    assert not np.array_equal(one.stimulus.build().values, other.stimulus.build().values)
    assert max(one.distance, other.distance) <= 0.025


def test_what_of_the_range_is_out_of_reach_is_left_out():
    found = design_next_noise(SYSTEMS["linear"], design(depth_max_m=20.0e-3), 3, PRELOAD_S)
    assert found.depth_min_m == 1.0e-3
    assert 9.0e-3 < found.depth_max_m <= 10.0e-3
    assert found.distance <= 0.025


def test_a_depth_of_which_nothing_is_reached_is_refused():
    with pytest.raises(UnusableInputError, check=coded("depth.out_of_reach", depth_min_m=12.0, depth_max_m=20.0)):
        design_next_noise(SYSTEMS["linear"], design(depth_min_m=12e-3, depth_max_m=20e-3), 3, PRELOAD_S)


@pytest.mark.parametrize(
    "simulate",
    [np.zeros_like, lambda force: -1e-3 * force, lambda force: np.full_like(force, np.nan)],
    ids=["deaf", "backwards", "lost"],
)
def test_a_description_that_answers_nothing_is_refused(simulate):
    with pytest.raises(UnusableInputError, check=coded("depth.no_response")):
        design_next_noise(simulate, design(), 3, PRELOAD_S)


def test_the_first_stimulus_is_gentle():
    first = design().first(4).build()
    assert first.values.min() >= 0.0
    assert first.values.max() <= 5.0
    assert not np.array_equal(first.values, design().first(5).build().values)


@pytest.mark.parametrize(
    ("changes", "refusal"),
    [
        ({"depth_min_m": 6e-3}, coded("stimulus.range", what="depth", least=6.0, greatest=5.0, unit="mm")),
        ({"force_min_n": 11.0}, coded("stimulus.range", what="force", least=11.0, greatest=10.0, unit="N")),
        ({"seconds": 0.0}, coded("option.refused", what="multistep", option="seconds", reason="option.least")),
        ({"colour": "red"}, coded("option.unknown", what="multistep", option="colour")),
        ({"depth_max_m": 1.0}, coded("option.refused", what="multistep", option="depth_max_m", reason="option.most")),
    ],
)
def test_what_cannot_be_designed_is_refused(changes, refusal):
    with pytest.raises(UnusableInputError, check=refusal):
        design(**changes)


def test_the_distance_is_that_of_the_definition():
    depth = np.random.Generator(np.random.PCG64(1)).normal(2e-3, 1e-3, 4000)
    assert distance_from_uniform(depth, 0.0, 4e-3) == pytest.approx(share_apart(depth, 0.0, 4e-3), abs=5e-4)
    assert distance_from_uniform(np.append(depth, np.nan), 0.0, 4e-3) == distance_from_uniform(depth, 0.0, 4e-3)
    with pytest.raises(UnusableInputError, check=coded("depth.lost")):
        distance_from_uniform(np.full(5, np.nan), 0.0, 1.0)
