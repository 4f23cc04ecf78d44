"""The next test: it separates the top candidates."""

import shlex
from itertools import pairwise

import numpy as np
import pytest
from gap_records import RATE_HZ, with_friction

from tissueid.gap.decision import score_candidate
from tissueid.gap.fitting import fit
from tissueid.gap.next_experiment import NextExperiment, candidate_tests, next_experiment, settings_of
from tissueid.stimuli import get_stimulus
from tissueid.twin.catalogue import effect


@pytest.fixture(scope="module")
def observed():
    return with_friction(4000)


@pytest.fixture(scope="module")
def rivals(observed):
    baseline = fit(observed, most_steps=8)
    names = ("dry_friction", "tissue_hysteresis")
    return [score_candidate(fit(observed, [effect(name)], near=baseline, most_steps=6)) for name in names]


def test_the_next_test_separates_friction_from_tissue_hysteresis(observed, rivals):
    found = next_experiment(observed, rivals, [0.5, 0.4])
    assert found is not None
    # Friction acts without tissue, and its slow loops differ.
    assert found.kind in ("spring", "free_air", "slow_ramp")
    assert found.gains["spring"] > found.gains["smaller_amplitude"]
    assert set(found.separates) == {"dry_friction", "tissue_hysteresis"}
    assert found.why.values["causes"].items == tuple(effect(name).title for name in found.separates)
    assert not any(word in found.why for word in ("nats", *found.separates))


def test_a_rival_is_not_separated_from_itself(observed, rivals):
    assert next_experiment(observed, [rivals[0], rivals[0]], [0.5, 0.5]) is None


def test_one_rival_needs_no_test(observed, rivals):
    assert next_experiment(observed, rivals[:1], [0.99]) is None


def test_candidate_tests_keep_within_the_amplifier(observed):
    items = candidate_tests(observed)
    assert {item.kind for item in items} >= {"quiet", "slow_ramp", "step_hold", "spring", "free_air", "deeper"}
    assert all(np.max(np.abs(item.test.command)) <= 48.0 for item in items)


def test_the_command_of_a_candidate_test_runs_it(observed):
    device = observed.instrument
    for item in candidate_tests(observed):
        step = NextExperiment(item.kind, "", (), settings=settings_of(observed, item))
        words = shlex.split(step.command_line)
        assert words[:2] == ["tissueid", "test"]
        given = dict(pairwise(words))
        newtons = item.test.command / device.voltage_for_force(1.0)
        assert float(given["--seconds"]) == pytest.approx(newtons.size / RATE_HZ, abs=0.051)
        assert given.get("--kind") == (item.kind if item.kind in ("spring", "free_air") else None)
        if item.kind == "quiet":
            assert "--max-force" not in given
            assert not newtons.any()
            continue
        low, high = float(given["--min-force"]), float(given["--max-force"])
        assert (low, high) == pytest.approx((newtons.min(), newtons.max()), abs=0.051)
        if "--stimulus" in given:
            options = {"force_min_n": newtons.min(), "force_max_n": newtons.max(), "seconds": newtons.size / RATE_HZ}
            played = get_stimulus(given["--stimulus"]).from_options(options).build()
            np.testing.assert_allclose(played.values, newtons, atol=1e-9)
        else:
            assert given["--distribution"] == "uniform"
