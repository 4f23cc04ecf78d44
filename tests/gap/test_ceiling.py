"""The upper bound of the closed share: functions of the command can be closed, hidden disturbances cannot."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from tissueid.gap.closed_share import ceiling
from tissueid.gap.dataset import DatasetTest, Purpose
from tissueid.gap.decision import Candidate, ChannelError

RATE = 2000.0
SAMPLES = 8000


def baseline(left, noise=1e-6, seed=2):
    random = np.random.default_rng(seed)
    command = np.convolve(random.uniform(-1, 1, SAMPLES), np.ones(8) / 8, "same")
    predicted = 1e-3 * np.convolve(command, np.exp(-np.arange(100) / 20.0), "full")[:SAMPLES]
    recorded = predicted + left(command, predicted, random) + noise * random.standard_normal(SAMPLES)
    purpose = np.choose((np.arange(SAMPLES) // 500) % 4, [Purpose.FIT, Purpose.CHOICE, Purpose.FIT, Purpose.CHECK])
    test = DatasetTest(1, "stochastic", "tissue", command, {"position": recorded}, purpose.astype(np.int8), RATE, 0.0)
    check = purpose == Purpose.CHECK
    square = float(np.mean((recorded - predicted)[check] ** 2))
    error = ChannelError(1, "position", square, noise, float(recorded.std()), int(check.sum()))
    parameters = SimpleNamespace(dataset=SimpleNamespace(tests=(test,), channels=("position",)))
    fitted = SimpleNamespace(parameters=parameters, predictions=[{"position": predicted}])
    return Candidate((), fitted, (), (error,))


def test_the_ceiling_includes_functions_of_the_motion():
    assert ceiling(baseline(lambda u, x, r: 30.0 * x**2 + 4e4 * x**3)) > 0.85


def test_the_ceiling_includes_functions_of_past_commands():
    assert ceiling(baseline(lambda u, x, r: 1e-4 * np.roll(u, 3))) > 0.7


def test_the_ceiling_excludes_hidden_disturbances():
    hidden = baseline(lambda u, x, r: 1e-4 * np.convolve(r.standard_normal(SAMPLES), np.ones(50) / 7, "same"))
    assert ceiling(hidden) < 0.1


def test_without_a_gap_there_is_no_share_of_it():
    quiet = baseline(lambda u, x, r: 0.0)
    less = tuple(replace(item, square=0.9 * item.noise**2) for item in quiet.checked_by)
    assert np.isnan(ceiling(replace(quiet, checked_by=less)))
