"""How much anything flexible could close: what goes with the command can be closed, what is hidden cannot."""

from dataclasses import dataclass, field, replace

import numpy as np

from tissueid.gap.ceiling import ceiling
from tissueid.gap.observed import ObservedTest, Purpose
from tissueid.gap.scoring import ChannelError

RATE = 2000.0
SAMPLES = 8000


@dataclass
class Stub:
    """Just what the ceiling asks of a fitted baseline."""

    observed: object
    predictions: list = field(default_factory=list)

    @property
    def parameters(self):
        return self


@dataclass
class Watched:
    tests: tuple
    channels: tuple = ("position",)


@dataclass
class Baseline:
    fit: Stub
    checked_by: tuple


def baseline(left, noise=1e-6, seed=2):
    random = np.random.default_rng(seed)
    command = np.convolve(random.uniform(-1, 1, SAMPLES), np.ones(8) / 8, "same")
    predicted = 1e-3 * np.convolve(command, np.exp(-np.arange(100) / 20.0), "full")[:SAMPLES]
    recorded = predicted + left(command, predicted, random) + noise * random.standard_normal(SAMPLES)
    purpose = np.choose((np.arange(SAMPLES) // 500) % 4, [Purpose.FIT, Purpose.CHOICE, Purpose.FIT, Purpose.CHECK])
    test = ObservedTest(1, "stochastic", "tissue", command, {"position": recorded}, purpose.astype(np.int8), RATE, 0.0)
    check = purpose == Purpose.CHECK
    square = float(np.mean((recorded - predicted)[check] ** 2))
    error = ChannelError(1, "position", square, noise, float(recorded.std()), int(check.sum()))
    return Baseline(Stub(Watched((test,)), [{"position": predicted}]), (error,))


def test_what_goes_with_the_motion_can_be_closed():
    assert ceiling(baseline(lambda u, x, r: 30.0 * x**2 + 4e4 * x**3)) > 0.85


def test_what_goes_with_the_past_of_the_command_can_be_closed():
    assert ceiling(baseline(lambda u, x, r: 1e-4 * np.roll(u, 3))) > 0.7


def test_what_is_hidden_cannot():
    hidden = baseline(lambda u, x, r: 1e-4 * np.convolve(r.standard_normal(SAMPLES), np.ones(50) / 7, "same"))
    assert ceiling(hidden) < 0.1


def test_without_a_gap_there_is_no_share_of_it():
    quiet = baseline(lambda u, x, r: 0.0)
    less = tuple(replace(item, square=0.9 * item.noise**2) for item in quiet.checked_by)
    assert np.isnan(ceiling(replace(quiet, checked_by=less)))
