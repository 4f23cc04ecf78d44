"""The ceiling of the VAF from repeats, against known noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from coded import refused
from identification import simulated
from identification import simulated_validation as systems
from outside_data import RIG
from scipy import signal

from tissueid.identification import validate
from tissueid.identification.validation.repeats import ceiling
from tissueid.messages import code_of
from tissueid.records import Record
from tissueid.sessions import read_session

SESSION = RIG / "rig-002.h5"
MEMORY = 0.04


def repeats(*seed: int, count: int = 2, noise: float = 0.3, pole: float = 0.0, jitter: float = 0.0, n: int = 6000):
    """Repeats of one command, each with noise, and an input that differs by so much."""
    rng = simulated.generator(*seed)
    command = systems.force(rng, n, False)
    found = []
    for _ in range(count):
        u = command + jitter * rng.standard_normal(command.size)
        y = signal.lfilter(systems.KERNEL, [1.0], u) + 0.2 * signal.lfilter(systems.KERNEL, [1.0], u) ** 2
        e = noise * systems.coloured(rng, n, pole)
        found.append(Record(u[systems.WARM :], y[systems.WARM :] + e, systems.RATE))
    return found


@pytest.mark.parametrize(
    ("count", "pole"),
    [(2, 0.9), *(pytest.param(*case, marks=pytest.mark.soak) for case in ((2, 0.0), (5, 0.0), (5, 0.9)))],
)
def test_the_noise_floor_is_the_noise(count: int, pole: float):
    apart, off = [], []
    for run in range(20):
        found = ceiling(repeats(110, run, count=count, pole=pole), memory=MEMORY)
        off.append((found.noise_rms.value - 0.3) / found.noise_rms.std)
        exact = 100.0 * (1.0 - 0.3**2 / found.output_rms**2)
        apart.append(found.vaf_percent.value - exact)
    assert 0.6 < np.std(off) < 1.5
    assert abs(np.mean(apart)) < 1.0


def test_the_ceiling_is_what_the_true_system_reaches():
    records = repeats(101, count=2)
    found = ceiling(records, memory=MEMORY)
    clean = repeats(101, count=2, noise=0.0)[0]
    reached = 100.0 * (1.0 - np.var(records[0].output - clean.output) / np.var(records[0].output))
    assert found.vaf_percent.value == pytest.approx(reached, abs=3.0 * (found.vaf_percent.std or 0.0) + 0.2)
    linear = validate(systems.PlainFir().fit(records[0]), records[1]).vaf_percent
    assert linear < found.vaf_percent.value
    assert found.explained_percent(linear) == pytest.approx(100.0 * linear / found.vaf_percent.value)


def test_the_answer_to_an_input_that_differs_is_not_noise():
    found = ceiling(repeats(102, jitter=0.1), memory=MEMORY)
    assert found.noise_rms.value == pytest.approx(0.3, rel=0.1)
    assert found.vaf_same_input_percent.value < found.vaf_percent.value - 0.5
    assert found.input_difference_percent == pytest.approx(10.0, rel=0.1)


def test_repeats_are_laid_on_one_another():
    one, two = repeats(103)
    late = replace(
        two, input=np.concatenate([one.input[:7], two.input]), output=np.concatenate([one.output[:7], two.output])
    )
    found = ceiling([one, late], memory=MEMORY)
    assert found.shifts == (0, 7)
    assert found.noise_rms.value == pytest.approx(0.3, rel=0.06)


def test_samples_lost_without_a_mark_are_found_and_left_out():
    one, two = repeats(104)
    kept = np.delete(np.arange(len(two)), slice(3100, 3104))
    lossy = replace(two, input=two.input[kept], output=two.output[kept])
    found = ceiling([one, lossy], memory=MEMORY)
    [finding] = [text for text in found.findings if code_of(text) == "ceiling.lost_samples"]
    assert finding.values["places"].items[0].values["samples"] == "-4"
    assert 3.0 <= finding.values["places"].items[0].values["seconds"] < 4.0
    assert found.noise_rms.value == pytest.approx(0.3, rel=0.06)
    assert np.isnan(found.noise[:, 3100]).all()


def test_gaps_are_left_out():
    one, two = repeats(105)
    y = simulated.changed(two.output, (np.s_[2000:2100], np.nan))
    found = ceiling([one, replace(two, output=y)], memory=MEMORY)
    assert found.n_samples <= 6000 - 39 - 100
    assert found.noise_rms.value == pytest.approx(0.3, rel=0.06)


def test_a_part_is_looked_at_alone():
    one, two = repeats(106)
    y = two.output.copy()
    y[:3000] += simulated.generator(106, 1).standard_normal(3000)
    whole, part = (
        ceiling([one, replace(two, output=y)], memory=MEMORY),
        ceiling([one, replace(two, output=y)], slice(3000, None), MEMORY),
    )
    assert part.noise_rms.value == pytest.approx(0.3, rel=0.08)
    assert whole.noise_rms.value > 0.5


def test_refusals_are_one_line():
    one, two = repeats(107)
    other = repeats(108)[0]
    refused(lambda: ceiling([one]), "ceiling.too_few_repeats")
    refused(lambda: ceiling([one, other]), "ceiling.different_inputs")
    refused(lambda: ceiling([one, replace(two, sample_rate_hz=2000.0)]), "ceiling.sample_rates")


@pytest.mark.skipif(not SESSION.exists(), reason="the session is not here")
def test_repeats_of_a_rig_agree_to_its_sensor_noise():
    session = read_session(SESSION)
    found = ceiling([session.test(n).record("force", "position") for n in (2, 3)])
    assert found.noise_rms.value == pytest.approx(2.0e-6, rel=0.1)
    assert found.vaf_percent.value > 99.99
