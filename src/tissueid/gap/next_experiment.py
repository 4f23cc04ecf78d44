"""The next test to run: the one where the predictions of the leading candidates differ most after a refit.

For two rivals with Gaussian predictions the expected gain in evidence grows with the distance of their predictions in
units of noise and of what is not yet known of their parameters (Box and Hill, Technometrics 9 (1967) 57-71); without
prior knowledge of the parameters it is the lack of fit of one to the other, T-optimality (Atkinson and Fedorov,
Biometrika 62 (1975) 57-70). Here the covariance of the fit to the recorded tests is the prior: parameters can absorb a
difference only as far as the recorded tests allow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.formatting import number
from tissueid.gap.dataset import Dataset, DatasetTest, Fixture
from tissueid.gap.decision import Candidate, cost
from tissueid.gap.forward_model import simulate_test
from tissueid.gap.parameters import SPRING_COORDINATES, Parametrisation
from tissueid.language import marked
from tissueid.messages import Listing, Message
from tissueid.plan_options import shell_options
from tissueid.stimuli.kinds import quasi_static
from tissueid.stimuli.kinds.quasi_static import Quiet, SlowRamp, StepHold, ramp, steps
from tissueid.test_settings import TestSettings
from tissueid.twin.catalogue import effect

FloatArray = NDArray[np.float64]

MOST_RIVALS = 4
"""Most candidates that are compared."""
LEAST_PROBABILITY = 0.01
"""Least probability of a candidate that is compared."""
MOST_SAMPLES = 3000
"""Most samples of a test that are compared, evenly spaced."""
LEAST_GAIN_NATS = 0.05
"""Least expected gain for which a test is proposed, nats a channel."""
_WORST = 1e6
"""Bound of a prediction, in noise deviations, where a simulation diverges."""
_MOST_NATS = np.log(1e6)
"""Bound of a reported gain: odds of a million to one."""
_FIXTURES = {"spring": "calibration spring", "free_air": "free air"}
"""Site of the tests that are not on tissue, by kind."""


@dataclass(frozen=True)
class NextExperiment:
    """The test that is expected to separate the leading candidates best, and the reason.

    ``gain_nats`` is the expected gain in evidence, nats a channel. ``separation`` is the distance of the candidates'
    predictions after a refit, in noise deviations (root mean square over the pairs, weighted by probability).
    ``gains`` are the expected gains of all candidate tests. ``settings`` are those of the test; without a site, it is
    that of the recorded tests.
    """

    kind: str
    why: str
    separates: tuple[str, ...]
    gain_nats: float = 0.0
    separation: float = 0.0
    gains: dict[str, float] | None = None
    settings: TestSettings | None = None

    @property
    def command_line(self) -> str:
        """The shell command that runs the test; "" without settings."""
        if self.settings is None:
            return ""
        site = "" if self.settings.site else "--site SITE "
        return f"tissueid test --device URL {site}{shell_options(self.settings)} --out next.h5"


@dataclass(frozen=True)
class _Predicted:
    """Prediction of a test in noise deviations, shape (m,), and its derivatives by the parameters, shape (m, k).

    The derivatives are scaled by the posterior standard deviations of the fit to the recorded tests.
    """

    values: FloatArray
    columns: FloatArray


def next_experiment(
    dataset: Dataset, candidates: Sequence[Candidate], probabilities: Sequence[float]
) -> NextExperiment | None:
    """Choose the next test; None where there are no rival candidates, or no test would separate them.

    Args:
        dataset: the recorded tests.
        candidates: the fitted candidates.
        probabilities: their probabilities.
    """
    order = sorted(range(len(candidates)), key=lambda k: cost(candidates[k]))
    leading = [k for k in order if probabilities[k] >= LEAST_PROBABILITY][:MOST_RIVALS]
    if len(leading) < 2:
        leading = order[:2]
    rivals = [candidates[k] for k in leading]
    weights = np.maximum([probabilities[k] for k in leading], LEAST_PROBABILITY)
    weights = weights / weights.sum()
    items = candidate_tests(dataset)
    if len(rivals) < 2 or not items:
        return None
    noise = _noise(dataset, rivals[0])
    factors = [_factor(rival) for rival in rivals]
    expectations = [(*_expected(item, rivals, factors, weights, noise), item) for item in items]
    gain, separation, chosen = max(expectations, key=lambda entry: entry[0])
    if gain < LEAST_GAIN_NATS:
        return None
    shared = set.intersection(*(set(rival.effects) for rival in rivals))
    names = tuple(dict.fromkeys(name for rival in rivals for name in rival.effects if name not in shared))
    gains = {item.kind: each for each, _, item in expectations}
    others = sorted((each for each in gains.values()), reverse=True)
    why = Message(
        "gap.next_test",
        "Proposed: {test}. After a refit the predictions differ by {separation} times the noise ({causes}); expected "
        "odds {odds} to 1, with the next best test {next_odds} to 1.",
        test=chosen.instruction,
        separation=number(separation, 2),
        causes=Listing(tuple(effect(name).title for name in names), "; ", "; "),
        odds=odds(gain),
        next_odds=odds(others[1]),
    )
    return NextExperiment(chosen.kind, why, names, gain, separation, gains, settings_of(dataset, chosen))


def settings_of(dataset: Dataset, chosen: CandidateTest) -> TestSettings:
    """Return the settings of a candidate test."""
    device = dataset.instrument
    newtons = chosen.test.command * device.amplifier_gain * device.force_constant_n_per_a / device.coil_resistance_ohm
    values: dict[str, Any] = {"seconds": round(chosen.test.command.size / chosen.test.sample_rate_hz, 1)}
    if chosen.kind in (Quiet.name, SlowRamp.name, StepHold.name):
        values["stimulus"] = chosen.kind
    else:
        values["distribution"] = "uniform"
    if chosen.kind in _FIXTURES:
        values |= {"kind": chosen.kind, "site": _FIXTURES[chosen.kind]}
    if chosen.kind != Quiet.name:
        values |= {"min_force_n": round(float(newtons.min()), 1), "max_force_n": round(float(newtons.max()), 1)}
    return TestSettings(**values)


def odds(gain_nats: float) -> str:
    """Return an expected gain in evidence (nats) as odds, with two digits."""
    return number(float(np.exp(min(gain_nats, _MOST_NATS))), 2)


def _noise(dataset: Dataset, best: Candidate) -> dict[str, float]:
    # A prediction of the next test is no better than the residual of the best candidate.
    noise = {}
    for name in dataset.channels:
        ratios = [item.ratio for item in best.checked_by if item.channel == name]
        noise[name] = dataset.noise[name] * float(np.sqrt(np.mean(ratios))) if ratios else dataset.noise[name]
    return noise


def _expected(
    item: CandidateTest,
    rivals: Sequence[Candidate],
    factors: Sequence[FloatArray],
    weights: FloatArray,
    noise: dict[str, float],
) -> tuple[float, float]:
    """Return the expected gain (nats a channel) and the separation (noise deviations) of a test."""
    predicted = [_predicted(rival, factor, item.test, noise) for rival, factor in zip(rivals, factors, strict=True)]
    gain, separation, total = 0.0, 0.0, 0.0
    for i, j in combinations(range(len(rivals)), 2):
        weight = float(weights[i] * weights[j])
        distance = _distance(predicted[i], predicted[j])
        gain += weight * 0.5 * float(np.log1p(distance))
        separation += weight * distance
        total += weight
    return gain / total, float(np.sqrt(separation / total))


def _distance(first: _Predicted, second: _Predicted) -> float:
    """Return the mean square distance that the parameters cannot absorb: d' (I + V V')^-1 d / m."""
    difference = first.values - second.values
    columns = np.concatenate([first.columns, second.columns], axis=1)
    inner = np.eye(columns.shape[1]) + columns.T @ columns
    along = columns.T @ difference
    return max(float(difference @ difference - along @ np.linalg.solve(inner, along)), 0.0) / difference.size


def _factor(rival: Candidate) -> FloatArray:
    """Return a square root of the posterior covariance of a candidate's coordinates, shape (k, k)."""
    fitted = rival.fit
    parameters = fitted.parameters
    reach = parameters.array("high") - parameters.array("low")
    normal = fitted.normal + np.diag(parameters.array("prior_std") ** -2.0 + reach**-2.0)
    values, vectors = np.linalg.eigh(normal / np.outer(1.0 / reach, 1.0 / reach))
    return np.asarray((vectors / np.sqrt(np.maximum(values, 1.0))) * reach[:, None])


def _predicted(rival: Candidate, factor: FloatArray, test: DatasetTest, noise: dict[str, float]) -> _Predicted:
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
        # A spring that was not used in any test is known as precisely as its specification.
        for name, (value, std) in SPRING_COORDINATES.items():
            if name not in parameters.index:
                held = replace(parameters, constants=parameters.constants | {name: value + std})
                columns.append((_standardised(held, theta, test, noise) - here)[:, None])
    return _Predicted(here, np.concatenate(columns, axis=1))


def _standardised(
    parameters: Parametrisation, theta: FloatArray, test: DatasetTest, noise: dict[str, float]
) -> FloatArray:
    readings = simulate_test(parameters, theta, test)
    each = max(1, test.command.size // MOST_SAMPLES)
    # A diverging simulation is clipped: it diverges for both candidates and adds no information.
    rows = [
        np.nan_to_num(np.clip(getattr(readings, name)[::each] / sigma, -_WORST, _WORST))
        for name, sigma in noise.items()
    ]
    return np.concatenate(rows)


QUIET_S, AIR_S = 1.5, 0.6
"""Durations of the quiet test and of the test in free air, s."""
STEPS_FROM = 0.2
"""First and last step as a share of the highest step."""
SPRING_SHARE = 0.5
"""Command on the spring as a share of that on tissue: a spring is softer than tissue at depth."""
AMPLITUDES = (0.5, 1.4)
"""Amplitudes of the smaller and the larger test, relative to the recorded one."""
DEPTHS = (0.6, 1.3)
"""Mean loads of the shallower and the deeper test, relative to the recorded one."""
LIMIT_SHARE = 0.9
"""Largest command as a share of the amplifier's limit."""
KINDS = {
    "quiet": marked("quiet"),
    "slow_ramp": marked("slow ramp"),
    "step_hold": marked("step hold"),
    "spring": marked("spring"),
    "free_air": marked("free air"),
    "smaller_amplitude": marked("smaller amplitude"),
    "larger_amplitude": marked("larger amplitude"),
    "shallower": marked("shallower"),
    "deeper": marked("deeper"),
}
"""Names of the kinds of tests."""
_INSTRUCTIONS = {
    "quiet": marked("hold the probe on the tissue without a command"),
    "slow_ramp": marked("press slowly and release"),
    "step_hold": marked("press in steps and hold each"),
    "spring": marked("put the calibration spring in place of the tissue and run the stimulus"),
    "free_air": marked("run the stimulus in free air"),
    "smaller_amplitude": marked("the same test with the same mean and a smaller amplitude"),
    "larger_amplitude": marked("the same test with the same mean and a larger amplitude"),
    "shallower": marked("the same test with a smaller mean load"),
    "deeper": marked("the same test with a larger mean load"),
}


@dataclass(frozen=True)
class CandidateTest:
    """A test that could be run next: its kind, what the operator does, and the test with its command (V)."""

    kind: str
    instruction: str
    test: DatasetTest


def candidate_tests(dataset: Dataset) -> tuple[CandidateTest, ...]:
    """Return the tests that could be run next; none where the drive or the amplifier of the session is unknown."""
    model = _model_test(dataset)
    if model is None or not (dataset.instrument.amplifier_gain > 0.0 and dataset.instrument.amplifier_limit_v > 0.0):
        return ()
    if model.driven_by == "voltage":
        # A command goes into the amplifier, the recorded voltage comes out of it.
        model = replace(model, command=model.command / dataset.instrument.amplifier_gain, driven_by="command")
    rate = model.sample_rate_hz
    mean, swing = float(np.mean(model.command)), model.command - np.mean(model.command)
    spread = float(np.std(model.command))
    device = dataset.instrument
    most = LIMIT_SHARE * min(
        device.amplifier_limit_v / device.amplifier_gain, 1.2 * float(np.max(np.abs(model.command)))
    )
    level = min(mean + 2.0 * spread, most)
    pressed = level * ramp(round(quasi_static.RAMP_SECONDS * rate))
    hold = round(quasi_static.STEPS_SECONDS / len(quasi_static.LEVELS) * rate)
    stepped = level * (STEPS_FROM + (1.0 - STEPS_FROM) * steps(hold, quasi_static.RISE_S * rate))
    spring = next((test for test in dataset.tests if test.fixture == "spring"), None)
    items = [
        _item("quiet", model, np.zeros(round(QUIET_S * rate))),
        _item("slow_ramp", model, pressed),
        _item("step_hold", model, stepped),
        _item(
            "spring",
            spring or model,
            SPRING_SHARE * swing,
            "spring",
            surface_m=0.4 * device.stroke_m,
        ),
        _item(
            "free_air",
            model,
            SPRING_SHARE * swing[: round(AIR_S * rate)],
            "air",
            surface_m=0.5 * device.stroke_m,
        ),
        _item(
            "smaller_amplitude",
            model,
            mean + AMPLITUDES[0] * swing,
        ),
        _item(
            "larger_amplitude",
            model,
            mean + AMPLITUDES[1] * swing,
        ),
        _item("shallower", model, DEPTHS[0] * mean + DEPTHS[0] * swing),
        _item("deeper", model, DEPTHS[1] * mean + swing),
    ]
    clipped = [replace(item.test, command=np.clip(item.test.command, -most, most)) for item in items]
    return tuple(CandidateTest(item.kind, item.instruction, test) for item, test in zip(items, clipped, strict=True))


def _model_test(dataset: Dataset) -> DatasetTest | None:
    if dataset.equivalent is not None:
        return None
    usable = [test for test in dataset.tests if test.driven_by in ("command", "voltage") and np.ptp(test.command) > 0.0]
    on_tissue = [test for test in usable if test.fixture == "tissue"]
    stochastic = [test for test in on_tissue if test.kind == "stochastic"]
    return next(iter([*stochastic, *on_tissue]), None)


def _item(
    kind: str,
    model: DatasetTest,
    command: FloatArray,
    fixture: Fixture = "tissue",
    surface_m: float | None = None,
) -> CandidateTest:
    # Per-test parameters, such as a phase, are those of the model test.
    surface = model.surface_m if surface_m is None or model.fixture == fixture else surface_m
    test = replace(
        model,
        kind=kind,
        fixture=fixture,
        command=np.ascontiguousarray(command),
        signals={name: np.full(command.size, surface) for name in model.signals},
        purpose=np.zeros(command.size, np.int8),
        surface_m=surface,
        repeat_of=None,
        driven_by="command",
    )
    return CandidateTest(kind, _INSTRUCTIONS[kind], test)
