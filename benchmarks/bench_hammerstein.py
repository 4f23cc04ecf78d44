"""Hammerstein: six alternating iterations with joint refinement, against the iterations on dense lagged powers in
numpy.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from benchmarks import plain_hammerstein, records
from benchmarks.base import Comparison
from tissueid.identification.engines.hammerstein import Hammerstein
from tissueid.identification.second_order import SecondOrder
from tissueid.records import Record

LAGS = 250
DEGREE = 3
PASSES = 6


def _record() -> Record:
    """Return a broadband force through a cubic and a second-order tissue, with noise at -40 dB."""
    force = records.broadband(noise=0.0).input
    bend = force + 0.2 * (force - 4.0) ** 2 - 0.02 * (force - 4.0) ** 3
    tissue = SecondOrder(mass=0.0912, damping=22.77, stiffness=4670.0)
    position = tissue.simulate(bend - bend.mean(), records.RATE)
    rng = np.random.Generator(np.random.PCG64(3))
    noise = 0.01 * np.std(position) * rng.standard_normal(position.size)
    return Record(force, position + noise + 0.012, records.RATE)


def comparisons() -> Iterable[Comparison]:
    record = _record()
    grid = np.quantile(record.input, np.linspace(0.01, 0.99, 50))

    def product() -> np.ndarray:
        model = Hammerstein(memory=LAGS / record.sample_rate_hz, degree=DEGREE, iterations=PASSES).fit(record)
        return model.nonlinearity(grid)

    def in_numpy() -> np.ndarray:
        return plain_hammerstein.hammerstein(record.input, record.output, LAGS, DEGREE, PASSES)[1]

    yield Comparison(
        title="Hammerstein engine, refined and with uncertainties, against plain alternation",
        setting=f"degree {DEGREE}, {LAGS} lags, {len(record)} samples, {PASSES} passes",
        product=product,
        plain=in_numpy,
        agreement=lambda ours, theirs: float(np.linalg.norm(ours - theirs) / np.linalg.norm(theirs)),
        tolerance=0.03,
        blocks=2,
        runs_in_block=2,
    )
