"""Measures how the exact Volterra answer grows with parameters and samples, beside the route of Chen 2010 (Fig. 4.2).

Without options it prints the times; ``--write`` draws them into docs/images/volterra-growth.png.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: two threads on a shared machine wait for each other

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from tissueid.identification.volterra.methods import factor_stimulus  # noqa: E402
from tissueid.identification.volterra.regressors import coefficient_count  # noqa: E402
from tissueid_lab.thesis import published_algorithms as published  # noqa: E402

mpl.use("Agg")
from matplotlib import pyplot as plt  # noqa: E402
from matplotlib.axes import Axes  # noqa: E402

PICTURE = ROOT / "docs" / "images" / "volterra-growth.png"
MEMORIES = (5, 8, 12, 16, 20, 25, 30, 35, 40, 50, 60)
LONGEST_PLAIN = 40
ROWS = 2700
LENGTHS = (500, 1000, 2000, 4000, 8000, 16000, 32000)
MEMORY = 20
RUNS = 3


def seconds(work: Callable[[], object]) -> float:
    """Processor time: the least of a few runs."""
    taken = []
    for _ in range(RUNS):
        begin = time.process_time()
        work()
        taken.append(time.process_time() - begin)
    return min(taken)


def measure(memory: int, rows: int, *, plain: bool) -> dict[str, float]:
    """Seconds of the whole answer and of a second response here, and of both by the plain route."""
    rng = np.random.Generator(np.random.PCG64(memory))
    x, y = rng.standard_normal((2, rows + memory))
    used = np.arange(x.size) >= memory
    kept = factor_stimulus(x, used, memory + 1)
    found = {
        "here, whole answer": seconds(lambda: factor_stimulus(x, used, memory + 1).solve(y)),
        "here, second response": seconds(lambda: kept.solve(y)),
    }
    if plain:
        stored = published.orthonormalise(published.construct_volterra(x, memory))
        found["plain, whole answer"] = seconds(lambda: published.volterra(x, y, memory))
        found["plain, second response"] = seconds(lambda: published.solve(stored, y[memory:]))
    return found


STYLE = {
    "plain, whole answer": ("tab:grey", "o", "-"),
    "plain, second response": ("tab:grey", "s", "--"),
    "here, whole answer": ("tab:blue", "o", "-"),
    "here, second response": ("tab:blue", "s", "--"),
}


def panel(axes: Axes, places: Sequence[int], found: Sequence[dict[str, float]], work: Sequence[float]) -> None:
    """One picture: seconds against ``places``, with the line of N M^2 through the plain route's last point."""
    for name, (colour, marker, line) in STYLE.items():
        points = [(place, one[name]) for place, one in zip(places, found, strict=True) if name in one]
        axes.loglog(*zip(*points, strict=True), color=colour, marker=marker, linestyle=line, markersize=4, label=name)
    anchor = max(k for k, one in enumerate(found) if "plain, whole answer" in one)
    bound = found[anchor]["plain, whole answer"] * np.array(work) / work[anchor]
    axes.loglog(places, bound, color="black", linewidth=0.8, linestyle=":", label="N M²")
    axes.grid(which="major", alpha=0.3)


def main() -> None:
    """Measure, print, and with ``--write`` draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="draw the picture")
    options = parser.parse_args()
    counts = [coefficient_count(memory + 1, 2) for memory in MEMORIES]
    by_parameters, by_rows = [], []
    for memory, count in zip(MEMORIES, counts, strict=True):
        by_parameters.append(measure(memory, ROWS, plain=memory <= LONGEST_PLAIN))
        print(f"M = {count}", {name: f"{value:.4f} s" for name, value in by_parameters[-1].items()}, flush=True)
    for rows in LENGTHS:
        by_rows.append(measure(MEMORY, rows, plain=True))
        print(f"N = {rows}", {name: f"{value:.4f} s" for name, value in by_rows[-1].items()}, flush=True)
    if not options.write:
        return
    figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained", sharey=True)
    panel(axes[0], counts, by_parameters, [float(count) ** 2 for count in counts])
    panel(axes[1], LENGTHS, by_rows, [float(rows) for rows in LENGTHS])
    axes[0].set(xlabel="parameters M", ylabel="seconds, one thread", title=f"N = {ROWS}")
    axes[1].set(xlabel="samples N", title=f"M = {coefficient_count(MEMORY + 1, 2)}")
    axes[0].legend(frameon=False, fontsize=8)
    figure.savefig(PICTURE, dpi=110)


if __name__ == "__main__":
    main()
