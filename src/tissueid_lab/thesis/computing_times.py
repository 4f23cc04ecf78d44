"""Computing times of the algorithms of the thesis as printed and of those used here, measured side by side."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tissueid.analysis.curves.plot import Axis, Curve, Plot
from tissueid.analysis.overlay import every
from tissueid.identification.volterra.methods import factor_stimulus
from tissueid.identification.volterra.regressors import coefficient_count
from tissueid.language import marked
from tissueid.messages import Verbatim
from tissueid.records import Record
from tissueid.stimuli.distributions import Uniform
from tissueid.stimuli.interchange import interchange
from tissueid.stimuli.spectra import Band
from tissueid_lab.thesis import published_algorithms as published

_RUNS = 3
"""Number of runs of a short computation; the shortest counts, because other load only adds."""
_LONG_S = 0.5
"""Duration of a run after which it is not repeated, s."""
_LAGS = 500
_RATE_HZ, _CUTOFF_HZ = 2000.0, 200.0
_SHARE = 3
"""Number of rows for each parameter (Chen 2010, 3.1.1)."""
_PARTITIONS, _PARTITION_LAGS = 15, 40
_PASSES = 6
_LINEAR_LAGS = 250
_COLOURS, _MARKERS = ("measured", "good", "check", "muted", "poor"), "os^Dv"


@dataclass(frozen=True)
class Timing:
    """Seconds of one method by size; ``here`` is whether it is the method of this program."""

    method: str
    sizes: tuple[int, ...]
    seconds: tuple[float, ...]
    here: bool = False

    @property
    def power(self) -> float:
        """Power of the size with which the time grows over the largest three sizes."""
        return float(np.polyfit(np.log(self.sizes[-3:]), np.log(self.seconds[-3:]), 1)[0])


def shortest(work: Callable[[], object]) -> float:
    """Return the shortest time of a few runs, s."""
    taken: list[float] = []
    for _ in range(_RUNS):
        begin = time.perf_counter()
        work()
        taken.append(time.perf_counter() - begin)
        if taken[-1] > _LONG_S:
            break
    return min(taken)


def autocorrelation_times(sizes: Sequence[int]) -> tuple[Timing, ...]:
    """Return the time of the autocorrelation of n samples by each method of Chen 2010, Fig. 6.2a.

    The last one is a tried swap of the compiled search, with 500 lags.
    """
    random = np.random.Generator(np.random.PCG64(1))
    values = {n: random.standard_normal(n) for n in sizes}
    start = {n: published.transformed_autocorrelation(samples) for n, samples in values.items()}
    methods: tuple[tuple[str, Callable[[int], object]], ...] = (
        ("direct", lambda n: published.direct_autocorrelation(values[n])),
        ("transform", lambda n: published.transformed_autocorrelation(values[n])),
        ("swap, all lags", lambda n: published.swapped_autocorrelation(values[n], start[n], n // 3, n // 2)),
        ("swap, 500 lags", lambda n: published.swapped_autocorrelation(values[n], start[n][:_LAGS], n // 3, n // 2)),
    )
    made = [
        Timing(name, tuple(sizes), tuple(shortest(lambda n=n, work=work: work(n)) for n in sizes))  # type: ignore[misc]
        for name, work in methods
    ]
    return (
        *made,
        Timing("swap, compiled", tuple(sizes), tuple(swap_seconds(n, min(_LAGS, n // 2), 4) for n in sizes), here=True),
    )


def swap_seconds(samples: int, lags: int, sweeps: int) -> float:
    """Return the time of a tried pair of the compiled search, s, with its share of the sums after every sweep.

    Args:
        samples: length of the stimulus.
        lags: length of the autocorrelation.
        sweeps: number of searches through all samples.
    """
    start = np.random.Generator(np.random.PCG64(1)).permutation(Uniform().levels(samples))
    target = Band(_CUTOFF_HZ).autocorrelation(lags, _RATE_HZ)
    reported: list[tuple[float, int]] = []
    interchange(
        start,
        target,
        tolerance=0.0,
        max_trials=sweeps * max(10_000, samples),
        seed=2,
        guided=False,
        on_progress=lambda progress: reported.append((time.perf_counter(), progress.tried)),
    )
    when, tried = np.array(reported).T
    return float(np.min(np.diff(when) / np.diff(tried)))


def orthonormalisation_times(memories: Sequence[int], rows: int = 2700) -> tuple[Timing, ...]:
    """Return times of a second-order Volterra fit by number of parameters (Chen 2010, Fig. 4.2).

    Args:
        memories: lags of each fit.
        rows: samples that each is fitted to.
    """
    seconds: dict[str, list[float]] = {}
    for memory in memories:
        x, y = np.random.Generator(np.random.PCG64(memory)).standard_normal((2, rows + memory))
        used = np.arange(x.size) >= memory
        stored = published.orthonormalise(published.construct_volterra(x, memory))
        kept = factor_stimulus(x, used, memory + 1)
        work: dict[str, Callable[[], object]] = {
            "orthonormalisation": lambda x=x, memory=memory: published.orthonormalise(  # type: ignore[misc]
                published.construct_volterra(x, memory)
            ),
            "solution with stored factors": lambda s=stored, y=y[memory:]: published.solve(s, y),  # type: ignore[misc]
            "here, factor": lambda x=x, u=used, lags=memory + 1: factor_stimulus(x, u, lags),  # type: ignore[misc]
            "here, solution with a stored factor": lambda k=kept, y=y: k.solve(y),  # type: ignore[misc]
        }
        for name, task in work.items():
            seconds.setdefault(name, []).append(shortest(task))
    sizes = tuple(coefficient_count(memory + 1, 2) for memory in memories)
    return tuple(Timing(name, sizes, tuple(taken), name.startswith("here")) for name, taken in seconds.items())


def lags_for(rows: int) -> int:
    """Return the longest memory, in lags, of a second-order model that leaves three rows for each parameter."""
    lags = 1
    while _SHARE * coefficient_count(lags + 2, 2) <= rows:
        lags += 1
    return lags


def technique_times(record: Record) -> dict[str, float]:
    """Return the times, s, of the techniques of Table 8.1 by the algorithms of the thesis, on a test at 2 kHz.

    LMS with 250 lags; six Wiener passes; a second-order system at every third sample and up to 15 partitions of 40 lags
    at every fourth sample, both with three rows for each parameter. NaN where a sample was not received.
    """
    x, y = record.input, record.output
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        return dict.fromkeys(("LMS", "Wiener", "Volterra", "depth"), float("nan"))
    third, fourth = every(record, 3), every(record, 4)
    memory = lags_for(len(third))
    partitions = min(_PARTITIONS, max(2, len(fourth) // (_SHARE * _PARTITION_LAGS)))
    edges = np.quantile(fourth.output, np.linspace(0.0, 1.0, partitions + 1))
    edges[[0, -1]] = -np.inf, np.inf
    inputs = third.input - third.input.mean()
    work: dict[str, Callable[[], object]] = {
        "LMS": lambda: published.impulse_response(x, y, _LINEAR_LAGS),
        "Wiener": lambda: published.wiener(x, y, _LINEAR_LAGS, _PASSES),
        "Volterra": lambda: published.volterra(inputs, third.output, memory),
        "depth": lambda: published.depth_partitions(fourth.input, fourth.output, edges, _PARTITION_LAGS),
    }
    return dict(_timed(work))


def _timed(work: dict[str, Callable[[], object]]) -> Iterator[tuple[str, float]]:
    for name, task in work.items():
        try:
            yield name, shortest(task)
        except (RuntimeError, ValueError, FloatingPointError):  # the curve of the Wiener iteration was not found
            yield name, float("nan")


def time_plot(timings: Sequence[Timing], size: str) -> Plot:
    """Return seconds against size for each method (Chen 2010, Figs. 4.2 and 6.2a).

    Args:
        timings: timings; those of this program are drawn in the colour of models.
        size: label of the abscissa.
    """
    curves = [
        Curve(
            np.array(timing.sizes, np.float64),
            np.array(timing.seconds),
            Verbatim(timing.method),
            "model" if timing.here else _COLOURS[index % len(_COLOURS)],
            marker=_MARKERS[index % len(_MARKERS)],
        )
        for index, timing in enumerate(timings)
    ]
    return Plot("", Axis(size, log=True), Axis(marked("Time"), "s", log=True), tuple(curves))
