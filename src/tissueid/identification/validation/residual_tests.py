"""Residual tests of a model on a record.

Linear and higher-order correlations (Billings and Voon 1986; Billings and Zhu 1994) of the residual with itself, the
input, and the output of the model. The residual of a complete model is independent of the input; the tests that fail
indicate what is missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import special

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Mask, Model
from tissueid.identification.impulse_response import Correlator
from tissueid.identification.preparation import scored_samples
from tissueid.identification.validation.prediction import fit_autoregression
from tissueid.identification.validation.residual_scores import (
    LEVEL,
    KernelError,
    Lags,
    Scores,
    independent_scores,
    kernel_error,
    whitened_products,
)
from tissueid.messages import Message
from tissueid.records import Record

TestName = Literal[
    "autocorrelation",
    "input",
    "feedback",
    "squared_input",
    "squared_output",
    "squared_speed",
    "cubed_output",
    "residual_size_input",
    "residual_size_squared_input",
    "residual_input_product",
]

MEANINGS: dict[TestName, Message] = {
    "autocorrelation": Message(
        "residuals.autocorrelation",
        "the residual is correlated in time: coloured noise or missing dynamics; a simulation is not affected, but "
        "standard deviations that assume white noise are too small",
    ),
    "input": Message(
        "residuals.input",
        "the residual depends linearly on the input: dynamics are missing, or the memory is too short",
    ),
    "feedback": Message(
        "residuals.feedback",
        "the residual predicts the input: the input depends on the output, and every fit to it is biased",
    ),
    "squared_input": Message(
        "residuals.squared_input", "the residual depends on the square of the input: an even nonlinearity is missing"
    ),
    "squared_output": Message(
        "residuals.squared_output",
        "the residual depends on the square of the depth: a stiffness that changes with depth is missing",
    ),
    "squared_speed": Message(
        "residuals.squared_speed",
        "the residual depends on the square of the speed: a damping that differs by direction is missing",
    ),
    "cubed_output": Message(
        "residuals.cubed_output",
        "the residual depends on the cube of the depth: a symmetric odd nonlinearity is missing",
    ),
    "residual_size_input": Message(
        "residuals.residual_size_input",
        "the residual is larger at one end of the input: the model is worse there, or the noise depends on the load",
    ),
    "residual_size_squared_input": Message(
        "residuals.residual_size_squared_input",
        "the residual is larger at large inputs: a nonlinearity of high order is missing, or the noise depends on "
        "the load",
    ),
    "residual_input_product": Message(
        "residuals.residual_input_product",
        "the correlation of the residual in time depends on the input: its dynamics change with the load",
    ),
}
"""Interpretation of each test that fails."""

_MOST_LAGS = 64
"""Largest number of lags of the tests with nuisance parameters and of the higher orders."""

_Z = 1.959964


@dataclass(frozen=True, eq=False)
class ResidualTest:
    """One test. ``lag_s``, ``correlation`` and ``band`` have shape (lags,).

    ``correlation`` is a coefficient between -1 and 1 of whitened signals; NaN for lags that cannot be tested. A single
    lag exceeds ``band`` by chance in 5 % of tests, any lag exceeds ``overall_band`` in 5 %. ``p_value`` is that of the
    largest lag; ``adjusted_p_value`` is corrected for the number of tests (Holm 1979). Both are None if nothing could
    be tested.
    """

    name: TestName
    lag_s: Array
    correlation: Array
    band: Array
    overall_band: Array
    p_value: float | None
    adjusted_p_value: float | None
    meaning: str

    @property
    def passed(self) -> bool | None:
        """False if p is below 5 % for this test alone; None if nothing could be tested."""
        return None if self.p_value is None else self.p_value >= 1.0 - LEVEL


@dataclass(frozen=True, eq=False)
class ResidualTests:
    """All tests of one model on one record, in the order of ``MEANINGS``.

    ``noise_order`` is the order of the whitening autoregression. ``findings`` are the failed tests at a family-wise
    level of 5 %.
    """

    tests: tuple[ResidualTest, ...]
    n_samples: int
    noise_order: int
    in_sample: bool
    findings: tuple[str, ...]

    def __getitem__(self, name: TestName) -> ResidualTest:
        """Return the test of that name."""
        return next(test for test in self.tests if test.name == name)


def residual_tests(
    model: Model, record: Record, part: slice | None = None, *, in_sample: bool = False, scheduled: bool = False
) -> ResidualTests:
    """Test the residual of a model on a record, or on a contiguous part of it.

    The tests are meant for held-out samples, on which their size is correct. The uncertainty of a fitted linear kernel
    is included, computed from ``model.report.n_samples``; for nonlinear parameters an upper bound is used, which makes
    the tests of the square and the cube conservative for nonlinear models.

    Args:
        model: any model.
        record: the data; inputs before the part still count as memory.
        part: contiguous part to test.
        in_sample: the samples are the fitted ones. The test against the input is then left out for a model with a free
            kernel, because the fit makes that correlation zero.
        scheduled: use the simulation whose kernels are selected by the measured output.

    Raises:
        UnusableInputError: another sample rate, a model without a schedule, or too few samples for the memory.
    """
    model.check_rate(record)
    simulated = model.simulate_scheduled(record) if scheduled else model.simulate(record.input)
    if simulated is None:
        raise UnusableInputError("residuals.no_schedule", "this model has no schedule: test its free run")
    memory = model.memory_samples
    used = scored_samples(record, memory, part) & np.isfinite(simulated)
    count = int(used.sum())
    if count < 4 * min(memory, _MOST_LAGS) + 2 * memory:
        raise UnusableInputError(
            "residuals.too_few",
            "{count} residuals are too few to test a memory of {samples} samples: use a longer part",
            count=count,
            samples=memory,
        )
    residual = np.where(used, record.output - simulated, np.nan)
    x = record.input - float(np.mean(record.input[used]))
    y = simulated - float(np.mean(simulated[used]))
    noise = fit_autoregression(residual)
    short = np.arange(max(2, min(memory, _MOST_LAGS, count // 20)))
    long = np.arange(memory + min(memory, _MOST_LAGS, count // 20))  # also beyond the memory, which may be too short
    speed = np.concatenate([[np.nan], np.diff(y)])
    products = whitened_products(
        residual,
        noise,
        (x, long.size),
        [(x, long), (x**2, short), (y**2, short), (speed**2, short), (y**3, short), (x, -1 - short[: short.size // 2])],
    )
    size = _normal_scores(np.abs(residual - noise.mean))
    size_products = whitened_products(size, fit_autoregression(size), (x, 0), [(x, short), (x**2, short)])

    fitted = max(1, model.report.n_samples)
    error = kernel_error(x, noise, memory, fitted, memory + 1)
    share = _share(model, x)
    free = model.report.n_parameters >= memory
    linear = in_sample or _is_linear(model, record.input, simulated, used)
    widening = 1.0 if linear else 1.0 + products.n_rows / fitted
    unknown = np.zeros((long.size, long.size))
    if not in_sample:
        unknown[:memory, :memory] = min(1.0, share) * error.covariance
    scores: dict[TestName, Scores | None] = {
        "autocorrelation": _autocorrelation(residual, np.arange(1, memory + 1), error, share, in_sample),
        "input": None if in_sample and free else products.scores(0, unknown, project=False),
        "feedback": products.scores(5),
        "squared_input": products.scores(1, widening=widening),
        "squared_output": products.scores(2, widening=widening),
        "squared_speed": products.scores(3, widening=widening),
        "cubed_output": products.scores(4, widening=widening),
        "residual_size_input": size_products.scores(0),
        "residual_size_squared_input": size_products.scores(1),
        "residual_input_product": _product(noise.innovations(residual), x, short + 1),
    }
    tests = _adjusted_tests(scores, record.sample_rate_hz)
    return ResidualTests(tests, count, noise.order, in_sample, _findings(tests))


def _autocorrelation(residual: Array, lags: Lags, error: KernelError, share: float, in_sample: bool) -> Scores:
    """Return the autocorrelation of a residual (n,), corrected for the error of the fitted kernel."""
    finite = np.isfinite(residual)
    centred = np.where(finite, residual - np.mean(residual[finite]), 0.0)
    length = int(lags[-1]) + 1
    pairs = np.maximum(1.0, np.round(Correlator(finite.astype(np.float64), length).auto() * finite.size))[lags]
    auto = Correlator(centred, length).auto() * finite.size
    bias = (-share * error.deficit) if in_sample else share * error.excess
    correlation = auto[lags] / pairs / (auto[0] / finite.sum()) - bias[lags] / (1.0 + bias[0])
    return independent_scores(lags, correlation, 1.0 / np.sqrt(pairs))


def _product(innovation: Array, x: Array, lags: Lags) -> Scores:
    """Return the scores of the innovation e[n] of the residual (n,) against e[n - k] x[n - k] (Billings and Voon).

    The terms of each sum are uncorrelated if the innovation is white and independent of the input.
    """
    carried = innovation * x
    rows = np.arange(int(lags[-1]), innovation.size)
    before = carried[rows[:, None] - lags]  # (rows, lags)
    finite = np.isfinite(before).all(axis=1) & np.isfinite(innovation[rows])
    before, now = before[finite], innovation[rows][finite]
    power = float(np.mean(now**2))
    scale = np.sqrt(power * now.size * np.sum(before**2, axis=0))
    return Scores(lags, now @ before / scale, power * before.T @ before / np.outer(scale, scale))


def _normal_scores(values: Array) -> Array:
    """Return the normal scores of the ranks of values (n,); NaN stay.

    Squared residuals have heavy tails, and sums of a few thousand of them are not yet normal.
    """
    finite = np.isfinite(values)
    scores = np.full(values.size, np.nan)
    ranks = np.empty(int(finite.sum()))
    ranks[np.argsort(values[finite])] = np.arange(1.0, ranks.size + 1.0)
    scores[finite] = special.ndtri((ranks - 0.5) / ranks.size)
    return scores


def _share(model: Model, x: Array) -> float:
    """Return the ratio of fitted parameters to independent directions of the kernel's error; 1 if every lag is free."""
    parameters, memory = model.report.n_parameters, model.memory_samples
    if parameters >= memory:
        return parameters / memory
    column = Correlator(np.where(np.isfinite(x), x, 0.0), memory).auto()
    squares = memory * column[0] ** 2 + 2.0 * float((memory - np.arange(1, memory)) @ column[1:] ** 2)
    directions = (memory * column[0]) ** 2 / squares
    return float(min(1.0, parameters / directions))


def _is_linear(model: Model, u: Array, simulated: Array, used: Mask) -> bool:
    """Return whether half of the input excursion gives half of the output excursion."""
    middle = float(np.mean(u[used]))
    half = model.simulate(middle + 0.5 * (u - middle))[used]
    rest = model.simulate(np.full(u.size, middle))[used]
    off = half - 0.5 * (simulated[used] + rest)
    return bool(np.nanmax(np.abs(off)) <= 1e-6 * np.std(simulated[used]))


def _adjusted_tests(scores: dict[TestName, Scores | None], rate: float) -> tuple[ResidualTest, ...]:
    joint = {name: test_scores.joint() for name, test_scores in scores.items() if test_scores is not None}
    p_values = {name: p for name, (p, _) in joint.items() if np.isfinite(p)}
    adjusted = _holm(p_values)
    tests = []
    for name, meaning in MEANINGS.items():
        test_scores = scores[name]
        none = np.zeros(0)
        std = none if test_scores is None else test_scores.std
        tests.append(
            ResidualTest(
                name=name,
                lag_s=none if test_scores is None else test_scores.lags / rate,
                correlation=none if test_scores is None else test_scores.correlation,
                band=_Z * std,
                overall_band=none if test_scores is None else joint[name][1] * std,
                p_value=p_values.get(name),
                adjusted_p_value=adjusted.get(name),
                meaning=meaning,
            )
        )
    return tuple(tests)


def _holm(p_values: dict[TestName, float]) -> dict[TestName, float]:
    """Return p-values corrected for their number (Holm 1979)."""
    adjusted: dict[TestName, float] = {}
    largest = 0.0
    for rank, name in enumerate(sorted(p_values, key=lambda name: p_values[name])):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[name]))
        adjusted[name] = largest
    return adjusted


def _findings(tests: Sequence[ResidualTest]) -> tuple[str, ...]:
    failed = [test for test in tests if test.adjusted_p_value is not None and test.adjusted_p_value < 1.0 - LEVEL]
    meanings = tuple(test.meaning for test in failed)
    if any(test.name != "autocorrelation" for test in failed):
        return meanings
    return (
        *meanings,
        Message(
            "residuals.unrelated",
            "these tests find no relation between residual and input: no missing dynamics or nonlinearity",
        ),
    )
