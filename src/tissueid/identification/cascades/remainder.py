"""Whether the error of a fitted cascade is noise, or holds something that its own signals explain.

A cascade that is not what the system is leaves an error that depends on the input: damping that grows with depth, for
instance, leaves products of position and velocity. The error is regressed on such products, as they are and through the
cascade's own dynamics, less what the cascade could do itself by other values of its parameters (a Lagrange multiplier
test). Under a right structure the error is noise, of any colour, that knows nothing of the input.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from scipy import fft, linalg, stats

from tissueid.identification.base import Array
from tissueid.identification.cascades.blocks import Blocks, CascadeData, Signals, run, slopes
from tissueid.identification.cascades.starts import solved
from tissueid.identification.dependence import dependence_samples

_HIGHEST = 3
"""Degree of the products."""

_UNDETERMINED = 1e-9
"""Share of the largest eigenvalue under which a combination of products is one of the others again."""


@dataclass(frozen=True)
class Remainder:
    """How much of a cascade's error products of its signals explain, beyond what they would explain of noise.

    ``share`` is of the error's variance; ``p_value`` the chance that noise of that colour shows as much.
    """

    share: float
    p_value: float


def unexplained(blocks: Blocks, data: CascadeData) -> Remainder:
    """Test the error that fitted blocks leave on the rows they were fitted to."""
    signals = run(blocks, data)
    error = data.measured - signals.output[data.rows]
    by_all = slopes(blocks, data, signals)
    gram = by_all @ by_all.T
    products = _products(signals, blocks, data)
    products -= solved(gram, by_all @ products.T).T @ by_all  # what the blocks could do themselves
    error = error - solved(gram, by_all @ error) @ by_all
    size = np.linalg.norm(products, axis=1)
    products /= np.where(size > 0.0, size, 1.0)[:, None]
    values, vectors = linalg.eigh(products @ products.T)
    kept = values > _UNDETERMINED * values[-1]
    products = (vectors[:, kept] / np.sqrt(values[kept])).T @ products  # orthonormal, (k, rows)
    score = products @ error
    n, k = data.rows.size, int(kept.sum())
    free = n - blocks.n_parameters
    if free <= 2 * k:
        return Remainder(0.0, 1.0)
    covariance = _covariance(products, error, data) * n / free
    statistic = float(score @ linalg.solve(covariance, score, assume_a="pos")) / k
    by_chance = float(np.trace(covariance))
    share = max(0.0, float(score @ score) - by_chance) / float(error @ error)
    return Remainder(share, float(stats.f.sf(statistic, k, free - k)))


def _covariance(products: Array, error: Array, data: CascadeData) -> Array:
    """Covariance (k, k) of sums of products (k, rows) with noise that has the error's autocovariance, by FFT."""
    lags = dependence_samples(error, data.prepared.record.sample_rate_hz)
    if lags == 1:
        return np.asarray(products @ products.T * float(error @ error) / error.size)
    n = data.input.size
    length = fft.next_fast_len(2 * n, real=True)
    placed, known = np.zeros(n), np.zeros(n)
    placed[data.rows], known[data.rows] = error, 1.0
    pairs = fft.irfft(np.abs(fft.rfft(known, length)) ** 2, length)
    together = fft.irfft(np.abs(fft.rfft(placed, length)) ** 2, length)
    lag = np.minimum(np.arange(length), length - np.arange(length))
    weights = np.maximum(0.0, 1.0 - lag / lags)  # Bartlett's, so that the answer is never indefinite
    power = np.maximum(fft.rfft(together / np.maximum(pairs, 1.0) * weights, length).real, 0.0)
    spread = np.zeros((products.shape[0], n))
    spread[:, data.rows] = products
    coloured = fft.irfft(fft.rfft(spread, length) * power, length)[:, :n]
    return np.asarray(coloured @ spread.T)


def _products(passing: Signals, blocks: Blocks, data: CascadeData) -> Array:
    """Products (k, rows) of the input, the modelled output and its velocity, as they are and through the dynamics."""
    output = passing.output
    signals = [data.input - data.rest, output - blocks.offset, np.gradient(output)]
    signals = [signal / (float(np.std(signal[data.rows])) or 1.0) for signal in signals]
    products = [
        np.prod([signals[k] for k in places], axis=0)
        for degree in range(1, _HIGHEST + 1)
        for places in combinations_with_replacement(range(len(signals)), degree)
    ]
    plain = np.array(products)  # (k, n)
    weights = blocks.first if blocks.second is None else blocks.second
    return np.concatenate([plain, data.bank.apply(weights, plain)])[:, data.rows]
