"""Which test to run next: the one where the leading rivals differ most after each was refitted.

For two rivals with Gaussian predictions the expected gain in evidence grows with the distance of their predictions in
units of noise and of what is not yet known of their parameters (Box and Hill, Technometrics 9 (1967) 57-71); without
prior knowledge of the parameters it is the lack of fit of one to the other, T-optimality (Atkinson and Fedorov,
Biometrika 62 (1975) 57-70). What is known of them is what the tests at hand left: parameters can take up a difference
only as far as these tests let them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from tissueid.gap.decision import cost
from tissueid.gap.menu import MenuItem, menu
from tissueid.gap.observed import Observed, ObservedTest
from tissueid.gap.parameters import SPRING_COORDINATES, Parametrisation
from tissueid.gap.playing import played
from tissueid.gap.scoring import Candidate
from tissueid.stimuli.kinds.quiet import Quiet
from tissueid.stimuli.kinds.slow_ramp import SlowRamp
from tissueid.stimuli.kinds.step_hold import StepHold
from tissueid.twin.catalogue import effect
from tissueid.wording import number

FloatArray = NDArray[np.float64]

MOST_RIVALS = 4
LEAST_PROBABILITY = 0.01
MOST_SAMPLES = 3000
"""So many samples of a test are compared, evenly spread."""
WORTH_NATS = 0.05
"""Rivals that no test separates by this are not told apart by running one."""
_WORST = 1e6
_MOST_NATS = np.log(1e6)
"""Odds above a million to one say nothing more."""
_FIXTURES = {"spring": '"calibration spring"', "free_air": '"free air"'}
"""What the probe meets where that is no tissue, as the site of the test."""


@dataclass(frozen=True)
class NextExperiment:
    """The test that would separate the leading rivals best, and why.

    ``gain_nats`` is the evidence that it is expected to give, nats a channel, ``separation`` how far the rivals'
    predictions lie apart there after a refit, in noise deviations (root mean square over the pairs, by probability).
    ``gains`` is the same for everything on the menu. ``command_line`` runs it.
    """

    kind: str
    why: str
    separates: tuple[str, ...]
    gain_nats: float = 0.0
    separation: float = 0.0
    gains: dict[str, float] | None = None
    command_line: str = ""


@dataclass(frozen=True)
class _Predicted:
    """One rival's prediction of a test in noise deviations, shape (m,), and how its parameters move it, (m, k).

    The columns are scaled so that each has a standard deviation of 1 as the tests at hand left it.
    """

    values: FloatArray
    columns: FloatArray


def next_experiment(
    observed: Observed, candidates: Sequence[Candidate], probabilities: Sequence[float]
) -> NextExperiment | None:
    """Choose from the menu; None where there are no rivals, or nothing on it would separate them.

    Args:
        observed: the tests at hand.
        candidates: fitted rivals.
        probabilities: of each.
    """
    order = sorted(range(len(candidates)), key=lambda k: cost(candidates[k]))
    leading = [k for k in order if probabilities[k] >= LEAST_PROBABILITY][:MOST_RIVALS]
    if len(leading) < 2:
        leading = order[:2]
    rivals = [candidates[k] for k in leading]
    weights = np.maximum([probabilities[k] for k in leading], LEAST_PROBABILITY)
    weights = weights / weights.sum()
    items = menu(observed)
    if len(rivals) < 2 or not items:
        return None
    noise = _noise(observed, rivals[0])
    factors = [_factor(rival) for rival in rivals]
    found = [(*_expected(item, rivals, factors, weights, noise), item) for item in items]
    gain, apart, chosen = max(found, key=lambda entry: entry[0])
    if gain < WORTH_NATS:
        return None
    names = tuple(dict.fromkeys(name for rival in rivals for name in _own(rival, rivals)))
    gains = {item.kind: each for each, _, item in found}
    others = sorted((each for each in gains.values()), reverse=True)
    titles = "; ".join(effect(name).title for name in names)
    why = (
        f"{chosen.words[0].upper()}{chosen.words[1:]}: there the predictions differ by {apart:.2g} times the noise "
        f"after a refit ({titles}); expected odds {odds(gain)} to 1, with the next best test {odds(others[1])} to 1."
    )
    return NextExperiment(chosen.kind, why, names, gain, apart, gains, command_line(observed, chosen))


def command_line(observed: Observed, chosen: MenuItem) -> str:
    """The command that runs a test of the menu."""
    device = observed.instrument
    newtons = chosen.test.command * device.amplifier_gain * device.force_constant_n_per_a / device.coil_resistance_ohm
    low, high = float(newtons.min()), float(newtons.max())
    seconds = chosen.test.command.size / chosen.test.sample_rate_hz
    played = "--distribution uniform"
    if chosen.kind in (Quiet.name, SlowRamp.name, StepHold.name):
        played = f"--stimulus {chosen.kind}"
    elif chosen.kind in _FIXTURES:
        played = f"--kind {chosen.kind} {played}"
    if chosen.kind != Quiet.name:
        played += f" --min-force {low:.1f} --max-force {high:.1f}"
    site = _FIXTURES.get(chosen.kind, "SITE")
    return f"tissueid test --device URL --site {site} {played} --seconds {seconds:.1f} --out next.h5"


def odds(gain_nats: float) -> str:
    """Return the odds to which an expected gain in evidence (nats) amounts, to two digits."""
    return number(float(np.exp(min(gain_nats, _MOST_NATS))), 2)


def _own(rival: Candidate, rivals: Sequence[Candidate]) -> list[str]:
    # Effects that not all rivals share.
    return [name for name in rival.effects if not all(name in other.effects for other in rivals)]


def _noise(observed: Observed, best: Candidate) -> dict[str, float]:
    # What the best rival leaves today is as far as any prediction of the next test can be trusted.
    found = {}
    for name in observed.channels:
        ratios = [item.ratio for item in best.checked_by if item.channel == name]
        found[name] = observed.noise[name] * float(np.sqrt(np.mean(ratios))) if ratios else observed.noise[name]
    return found


def _expected(
    item: MenuItem,
    rivals: Sequence[Candidate],
    factors: Sequence[FloatArray],
    weights: FloatArray,
    noise: dict[str, float],
) -> tuple[float, float]:
    """Expected gain (nats a channel) and separation (noise deviations) of a test."""
    predicted = [_predicted(rival, factor, item.test, noise) for rival, factor in zip(rivals, factors, strict=True)]
    gain, apart, total = 0.0, 0.0, 0.0
    for i, j in combinations(range(len(rivals)), 2):
        weight = float(weights[i] * weights[j])
        distance = _distance(predicted[i], predicted[j])
        gain += weight * 0.5 * float(np.log1p(distance))
        apart += weight * distance
        total += weight
    return gain / total, float(np.sqrt(apart / total))


def _distance(one: _Predicted, other: _Predicted) -> float:
    """Mean square distance in units of noise and of what the parameters can take up: d' (I + V V')^-1 d / m."""
    apart = one.values - other.values
    columns = np.concatenate([one.columns, other.columns], axis=1)
    inner = np.eye(columns.shape[1]) + columns.T @ columns
    along = columns.T @ apart
    return max(float(apart @ apart - along @ np.linalg.solve(inner, along)), 0.0) / apart.size


def _factor(rival: Candidate) -> FloatArray:
    """A square root of the covariance of a rival's coordinates as the tests at hand left it, shape (k, k)."""
    fitted = rival.fit
    parameters = fitted.parameters
    reach = parameters.array("high") - parameters.array("low")
    normal = fitted.jacobian.T @ fitted.jacobian + np.diag(parameters.array("prior_std") ** -2.0 + reach**-2.0)
    values, vectors = np.linalg.eigh(normal / np.outer(1.0 / reach, 1.0 / reach))
    return np.asarray((vectors / np.sqrt(np.maximum(values, 1.0))) * reach[:, None])


def _predicted(rival: Candidate, factor: FloatArray, test: ObservedTest, noise: dict[str, float]) -> _Predicted:
    parameters, theta = rival.fit.parameters, rival.fit.theta
    here = _standardised(parameters, theta, test, noise)
    low, high = parameters.array("low"), parameters.array("high")
    steps = parameters.array("step")
    moved = np.empty((here.size, theta.size))
    for k, step in enumerate(steps):
        item = parameters.coordinates[k]
        if item.test is not None and item.test != test.number:
            moved[:, k] = 0.0
            continue
        signed = step if theta[k] + step <= high[k] else -step
        other = theta.copy()
        other[k] = min(max(theta[k] + signed, low[k]), high[k])
        moved[:, k] = (_standardised(parameters, other, test, noise) - here) / signed
    columns = [moved @ factor]
    if test.fixture == "spring":
        # A spring that no test has met yet is known as far as its maker says.
        for name, (value, std) in SPRING_COORDINATES.items():
            if name not in parameters.index:
                held = replace(parameters, constants=parameters.constants | {name: value + std})
                columns.append((_standardised(held, theta, test, noise) - here)[:, None])
    return _Predicted(here, np.concatenate(columns, axis=1))


def _standardised(
    parameters: Parametrisation, theta: FloatArray, test: ObservedTest, noise: dict[str, float]
) -> FloatArray:
    readings = played(parameters, theta, test)
    each = max(1, test.command.size // MOST_SAMPLES)
    # Where a simulation runs away, both rivals' do, and nothing is learnt.
    rows = [
        np.nan_to_num(np.clip(getattr(readings, name)[::each] / sigma, -_WORST, _WORST))
        for name, sigma in noise.items()
    ]
    return np.concatenate(rows)
