"""Bootstrap confidence bands of any statistic of a fitted model.

Two ways to resample a record. ``residuals`` keeps the input and the simulated output and adds resampled blocks of
residuals: valid if the model error is noise independent of the input. ``blocks`` resamples stretches of input and
output, each with the inputs of its memory: also valid if the model error is nonlinearity, which depends on the input;
the record must hold many blocks.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import CancelledError, UnusableInputError
from tissueid.identification.base import Array, Engine, Model
from tissueid.identification.impulse_response import dependence_samples, widening_of_blocks
from tissueid.identification.preparation import complete_windows, part_mask, scored_samples
from tissueid.messages import Message
from tissueid.records import Record

Method = Literal["residuals", "blocks"]

_MOST_REFUSED = 0.1
"""Largest share of resampled records that an engine may refuse."""

_FEWEST_BLOCKS = 5
_USUAL_BLOCKS = 20


@dataclass(frozen=True, eq=False)
class Bands:
    """Result of a bootstrap; every array has the shape (k,) of the statistic, ``draws`` (n, k).

    ``low`` and ``high`` bound ``level_percent`` of the distribution. They are those of the basic bootstrap: the spread
    of the draws about the estimate, reflected, which removes the bias of the fit (Davison and Hinkley 1997, 5.2).
    """

    estimate: Array
    std: Array
    low: Array
    high: Array
    level_percent: float
    draws: Array
    method: Method
    block_samples: int
    refused: int


def bootstrap(
    engine: Engine,
    record: Record,
    fit_part: slice | None,
    statistic: Callable[[Model], Array],
    n: int = 200,
    seed: int = 0,
    *,
    method: Method = "residuals",
    level_percent: float = 95.0,
    block: float | None = None,
    progress: Callable[[int, int], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> Bands:
    """Fit an engine to ``n`` resampled records, and return the distribution of a statistic of the model.

    Args:
        engine: the specification, as for the fit itself.
        record: the data.
        fit_part: contiguous part that is fitted.
        statistic: returns numbers (k,) of a model: a kernel, a Bode magnitude, parameters.
        n: number of resampled records.
        seed: of the random generator.
        method: ``residuals`` or ``blocks``.
        level_percent: confidence level of the bands.
        block: length of a block, s; by default twice the time over which residuals are autocorrelated, and for
            ``blocks`` at least the memory.
        progress: called with the number of draws done, and the total.
        cancelled: called before each draw; the work ends if it returns True.

    Raises:
        UnusableInputError: the record is not sufficient for the fit, holds too few blocks, or more than a tenth of the
            draws were refused.
        CancelledError: ``cancelled`` returned True.
    """
    if n < 2 or not 0.0 < level_percent < 100.0:
        raise UnusableInputError(
            "bootstrap.arguments", "a bootstrap needs at least two draws and a level between 0 and 100 %"
        )
    model = engine.fit(record, fit_part)
    estimate = np.atleast_1d(np.asarray(statistic(model), dtype=np.float64))
    source = _Source(model, record, fit_part, method, block)
    rng = np.random.Generator(np.random.PCG64(seed))
    draws = []
    refused = 0
    for done in range(n):
        if cancelled is not None and cancelled():
            raise CancelledError(
                Message(
                    "bootstrap.cancelled",
                    "the bootstrap was cancelled after {done} of {draws} draws",
                    done=done,
                    draws=n,
                )
            )
        other, part = source.with_residuals(rng) if method == "residuals" else source.with_blocks(rng)
        try:
            draws.append(np.atleast_1d(np.asarray(statistic(engine.fit(other, part)), dtype=np.float64)))
        except UnusableInputError as error:
            refused += 1
            if refused > max(1.0, _MOST_REFUSED * n):
                raise UnusableInputError(
                    "bootstrap.refused", "too many drawn records cannot be fitted ({reason})", reason=error.message
                ) from error
        if progress is not None:
            progress(done + 1, n)
    replicates = np.array(draws)  # (n, k)
    if method == "blocks":
        replicates = estimate + widening_of_blocks(source.block / source.count) * (replicates - estimate)
    tail = 0.5 - level_percent / 200.0
    low, high = np.quantile(replicates, [tail, 1.0 - tail], axis=0)
    return Bands(
        estimate=estimate,
        std=np.std(replicates, axis=0, ddof=1),
        low=2.0 * estimate - high,
        high=2.0 * estimate - low,
        level_percent=level_percent,
        draws=replicates,
        method=method,
        block_samples=source.block,
        refused=refused,
    )


class _Source:
    """The residuals and stretches from which records are resampled."""

    def __init__(
        self, model: Model, record: Record, fit_part: slice | None, method: Method, block: float | None
    ) -> None:
        self.record, self.part = record, fit_part
        self.memory = model.memory_samples
        used = scored_samples(record, self.memory, fit_part)
        self.simulated = model.simulate(record.input)
        residual = np.where(used, record.output - self.simulated, np.nan)
        self.count = int(np.isfinite(residual).sum())
        finite = residual[np.isfinite(residual)]
        freedom = self.count / max(
            1.0, self.count - model.report.n_parameters
        )  # the fit reduces the variance of the residual
        self.residual = (residual - finite.mean()) * math.sqrt(min(freedom, 2.0))
        if block is not None:
            self.block = max(1, round(block * record.sample_rate_hz))
        else:
            self.block = max(1, 2 * dependence_samples(finite, record.sample_rate_hz))
            if method == "blocks":  # each block also needs the inputs of its memory, so it should not be much shorter
                self.block = max(self.block, min(self.memory, self.count // _USUAL_BLOCKS))
        if self.count < _FEWEST_BLOCKS * self.block:
            raise UnusableInputError(
                "bootstrap.few_blocks",
                "{count} residuals are fewer than {fewest} blocks of {samples} samples: record longer, or use "
                "shorter blocks",
                count=int(self.count),
                fewest=_FEWEST_BLOCKS,
                samples=self.block,
            )
        self.ends = np.flatnonzero(complete_windows(np.isfinite(residual), self.block))
        if self.ends.size == 0:
            raise UnusableInputError(
                "bootstrap.gaps",
                "there are no {samples} successive samples without a gap: use shorter blocks",
                samples=self.block,
            )

    def with_residuals(self, rng: np.random.Generator) -> tuple[Record, slice | None]:
        """Return the record with resampled residuals, and the part to fit."""
        n = len(self.record)
        added = self.residual[self._drawn_blocks(rng, math.ceil(n / self.block))].ravel()[:n]
        output = np.where(np.isfinite(self.record.output), self.simulated + added, np.nan)
        unfitted = ~part_mask(n, self.part)
        output[unfitted] = self.record.output[unfitted]
        return replace(self.record, output=output), self.part

    def with_blocks(self, rng: np.random.Generator) -> tuple[Record, None]:
        """Return resampled stretches of the record, each after the inputs of its memory, separated by gaps."""
        drawn = self._drawn_blocks(rng, math.ceil(self.count / self.block))  # (blocks, block)
        before = drawn[:, :1] - np.arange(self.memory - 1, 0, -1)
        gap = np.full((drawn.shape[0], 1), np.nan)
        u = np.hstack([gap, self.record.input[before], self.record.input[drawn]])
        y = np.hstack([gap, np.full(before.shape, np.nan), self.record.output[drawn]])
        return replace(self.record, input=u.ravel()[1:], output=y.ravel()[1:]), None

    def _drawn_blocks(self, rng: np.random.Generator, blocks: int) -> NDArray[np.intp]:
        """Return the indices (blocks, block) of blocks of known residuals."""
        last = self.ends[rng.integers(self.ends.size, size=blocks)]
        return np.asarray(last[:, None] + np.arange(1 - self.block, 1), dtype=np.intp)
