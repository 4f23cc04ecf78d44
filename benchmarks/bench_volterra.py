"""Second-order Volterra kernels, memory 40 (M = 903), from 2,700 rows: against Eqs. 4.4-4.14 as in the thesis."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy import linalg, signal

from benchmarks.base import Comparison
from tissueid.identification.volterra.methods import VolterraStimulus, factor_stimulus
from tissueid_lab.thesis import published_algorithms as published

MEMORY = 40
ROWS = 2700
RATE = 2000.0 / 3.0
LOW_PASS_HZ = 200.0


def stimulus(*, white: bool) -> np.ndarray:
    """Return a Gaussian input (samples,): white, or low-passed at 200 Hz at 2 kHz and decimated by three."""
    rng = np.random.Generator(np.random.PCG64(1))
    samples = ROWS + MEMORY
    if white:
        return rng.standard_normal(samples)
    low_pass = signal.butter(8, LOW_PASS_HZ, fs=2000.0, output="sos")
    x = signal.sosfilt(low_pass, rng.standard_normal(3 * (samples + 200)))[600::3]
    return x / np.std(x)


def response(x: np.ndarray, seed: int) -> np.ndarray:
    """Return a tissue-like output: a lightly damped system with a quadratic nonlinearity and noise."""
    t = np.arange(MEMORY) / RATE
    z = signal.lfilter(np.exp(-60.0 * t) * np.sin(200.0 * t), [1.0], x)
    rng = np.random.Generator(np.random.PCG64(seed))
    return z - 0.1 * z**2 + 0.01 * np.std(z) * rng.standard_normal(x.size)


def difference(ours: np.ndarray, theirs: np.ndarray) -> float:
    return float(np.linalg.norm(ours - theirs) / np.linalg.norm(theirs))


def factored(x: np.ndarray) -> VolterraStimulus:
    return factor_stimulus(x, np.arange(x.size) >= MEMORY, MEMORY + 1)


def comparisons() -> Iterable[Comparison]:
    x = stimulus(white=True)
    y, again = response(x, 2), response(x, 3)
    factor = factored(x)
    stored = published.orthonormalise(published.construct_volterra(x, MEMORY))
    explicit = factor.regressors.matrix()
    size = f"M = {explicit.shape[1]}, N = {ROWS}"

    def reference() -> np.ndarray:
        return linalg.lstsq(explicit, y[MEMORY:], lapack_driver="gelsd")[0]

    def whole() -> np.ndarray:
        return factored(x).solve(y)

    def in_numpy() -> np.ndarray:
        return published.volterra(x, y, MEMORY)

    few = {"blocks": 2, "runs_in_block": 2}
    yield Comparison("Volterra, whole answer", f"{size}, white", whole, in_numpy, difference, 1e-8, 30.0, **few)
    yield Comparison(
        "Volterra, second response, against the plain whole answer",
        f"{size}, white",
        lambda: factor.solve(again),
        lambda: published.volterra(x, again, MEMORY),
        difference,
        1e-8,
        300.0,
        **few,
    )
    yield Comparison(
        "Volterra, second response, against the plain one with alpha and beta stored",
        f"{size}, white",
        lambda: factor.solve(again),
        lambda: published.solve(stored, again[MEMORY:]),
        difference,
        1e-8,
        **few,
    )
    yield Comparison("Volterra against lstsq", f"{size}, white", whole, reference, difference, 1e-8, **few)

    coloured = stimulus(white=False)
    hard = response(coloured, 4)
    ill = factored(coloured)
    condition = ill.factor.condition
    tall = ill.regressors.matrix()
    yield Comparison(
        "Volterra against lstsq, low-passed input",
        f"{size}, 200 Hz at 667 Hz, condition {condition:.0e}",
        lambda: factored(coloured).solve(hard),
        lambda: linalg.lstsq(tall, hard[MEMORY:], lapack_driver="gelsd")[0],
        difference,
        1e-8,
        **few,
    )
    yield Comparison(
        "Volterra, whole answer, low-passed input",
        f"{size}, 200 Hz at 667 Hz, condition {condition:.0e}",
        lambda: factored(coloured).solve(hard),
        lambda: published.volterra(coloured, hard, MEMORY),
        difference,
        1e-3,
        **few,
    )
