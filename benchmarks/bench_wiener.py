"""Six Wiener iterations: one factored input against all correlations in each iteration."""

from __future__ import annotations

from collections.abc import Iterable

from benchmarks import records
from benchmarks.base import Comparison
from tissueid.identification.engines.wiener import Wiener
from tissueid.identification.impulse_response import factor_input
from tissueid.identification.preparation import prepare
from tissueid.identification.static_nonlinearity import ExponentialCurve
from tissueid.identification.wiener_cascade import LinearStage, hunter_korenberg
from tissueid_lab.thesis import published_algorithms as published

LAGS = 250
PASSES = 6


def comparisons() -> Iterable[Comparison]:
    record = records.wiener()
    memory = LAGS / record.sample_rate_hz

    def iterated() -> tuple[float, float]:
        stage = LinearStage(factor_input(prepare(record, None, memory)))
        last = hunter_korenberg(stage, "exponential", 1, PASSES)[-1].cascade.nonlinearity
        assert isinstance(last, ExponentialCurve)
        return last.thesis_constants(None, 0.0)[:2]

    def fitted() -> tuple[float, float]:
        parameters = Wiener(memory=memory, iterations=PASSES).fit(record).report.parameters
        return parameters["c1_m"].value, parameters["c2_per_n"].value

    def in_numpy() -> tuple[float, float]:
        return published.wiener(record.input, record.output, LAGS, PASSES)

    def difference(ours: tuple[float, float], theirs: tuple[float, float]) -> float:
        return max(abs(a / b - 1.0) for a, b in zip(ours, theirs, strict=True))

    setting = f"{PASSES} passes, {LAGS} lags, {len(record)} samples"
    yield Comparison(
        "Wiener iteration", setting, iterated, in_numpy, difference, 1e-4, floor=20.0, blocks=4, runs_in_block=10
    )
    whole = "the same, refined jointly, with uncertainties"
    yield Comparison("Wiener engine against plain iteration", whole, fitted, in_numpy, difference, 0.03)
