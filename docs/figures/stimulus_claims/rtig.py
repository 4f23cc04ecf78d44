"""What real-time input generation promises: depths as desired, with identification and without, and at what cost."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator

import numpy as np
from engine_claims.base import Claim
from numpy.typing import NDArray
from scipy import stats
from simulated_plants import DEPTH_M, FORCE_N, PLANTS, RATE, SURFACE_M, Outcome, closed_loop

from firmware_sim.bench import Bench
from tissueid.analysis.curves.feedback import settling_times
from tissueid.identification.second_order import SecondOrder
from tissueid.stimuli.kinds.noise import Noise
from tissueid.stimuli.kinds.rtig import Rtig

Array = NDArray[np.float64]

SEEDS = 12
BENCH_SEEDS = 4
BAR = 0.08
WARM = 40
"""Steps at the start of a test that are left out of the times: caches fill."""

SKIN = (
    "left-posterior-forearm",
    "left-anterior-forearm",
    "left-distal-forearm",
    "right-posterior-forearm",
    "right-anterior-forearm",
    "upper-arm",
)


def claims() -> Iterator[Claim]:
    """Distributions on the thesis' plants and on the simulated instrument, parameters by depth, and time."""
    runs: dict[bool, list[Outcome]] = {True: [], False: []}
    for name in PLANTS:
        for lead in (2, 3):
            found = [_run(name, seed, lead=lead) for seed in range(SEEDS)]
            if lead == 2:
                runs[True] += found
            yield _distances(f"{name}, with identification, {lead} blocks ahead", found, BAR)
    for name in PLANTS:
        found = [_run(name, seed, lead=2, identify=False) for seed in range(SEEDS)]
        runs[False] += found
        yield _distances(f"{name}, without identification, 2 blocks ahead", found, None)
    for name in PLANTS:
        yield _open_loop(name)
    for name in PLANTS:
        yield from _cycles(name)
    yield from _settling()
    yield from _parameters(runs[True])
    yield from _times(runs)
    yield _compiling()
    for tissue in ("linear-demo", "wiener-demo", *SKIN):
        yield _bench(tissue)


def _run(name: str, seed: int, *, lead: int, identify: bool = True, **options: float) -> Outcome:
    kind = Rtig(
        depth_min_m=DEPTH_M[0],
        depth_max_m=DEPTH_M[1],
        force_min_n=FORCE_N[0],
        force_max_n=FORCE_N[1],
        lead=lead,
        seed=seed,
        identify=identify,
        **options,
    )
    return closed_loop(kind, PLANTS[name](), seed)


def _told(distances: list[float]) -> str:
    return f"{np.median(distances):.3f}, worst {max(distances):.3f}"


def _distances(what: str, found: list[Outcome], bar: float | None) -> Claim:
    distances = [outcome.distance() for outcome in found]
    return Claim(
        f"Kolmogorov distance from uniform, 5 s, 0 to 6 mm: {what} (median of {len(found)} seeds)",
        "no bar" if bar is None else f"{bar:g} at the worst",
        _told(distances),
        bar is None or max(distances) <= bar,
    )


def _open_loop(name: str) -> Claim:
    """Uniform force over the range that spans 0 to 6 mm on the linear plant."""
    distances = []
    for seed in range(SEEDS):
        force = Noise(distribution="uniform", force_min_n=0.0, force_max_n=6.0, seconds=5.0, seed=seed).build().values
        plant = PLANTS[name]()
        plant.block(np.full(round(0.5 * RATE), 3.0))
        span = DEPTH_M[1] - DEPTH_M[0]
        distances.append(float(stats.kstest(plant.block(force), "uniform", (DEPTH_M[0], span)).statistic))
    return Claim(
        f"the same: {name}, open loop, uniform noise of 0 to 6 N below 200 Hz", "no bar", _told(distances), True
    )


def _cycles(name: str) -> Iterator[Claim]:
    """Figs. 6.7 and 6.10: time from one end of the range back to it."""
    gain, thesis_s = {"linear": (1000.0, 0.5), "Wiener": (1200.0, 0.7), "DPN": (2500.0, 1.0)}[name]
    for what, asked_s, options, most_s in (
        (f"without identification, gain {gain:g} N/m", thesis_s, {"identify": False, "gain_n_per_m": gain}, 5.0),
        ("with identification, `cycle=0.2`", 0.2, {"cycle": 0.2}, 0.21),
    ):
        found = [_run(name, seed, lead=1 if "gain" in what else 2, **options) for seed in range(SEEDS)]
        cycle_s = float(np.median([5.0 / max(outcome.source.report()["cycles"], 0.5) for outcome in found]))
        yield Claim(
            f"{name}: length of a cycle, {what}; distance from uniform (median of {SEEDS} seeds)",
            f"thesis: {asked_s:g} s",
            f"{cycle_s:.2f} s; {_told([outcome.distance() for outcome in found])}",
            cycle_s <= most_s,
        )


def _settling() -> Iterator[Claim]:
    """Fig. 6.6 at the thesis' mass, and of the tissues that are simulated here."""
    damping, stiffness = np.linspace(0.5, 40.0, 80), np.linspace(250.0, 5000.0, 96)
    times = settling_times(0.06, damping, stiffness)
    yield Claim(
        "5 % settling time, 0.06 kg: least over the damping at 500, 1000, 2000 and 4000 N/m; share of 0.25 to 5 N/mm "
        "and 0.5 to 40 N s/m that settles within the memory of 62.5 ms; within a block of 25 ms",
        "thesis: about 60 ms in the dark region, 25 ms at the least",
        ", ".join(f"{1e3 * times[:, np.abs(stiffness - k).argmin()].min():.0f}" for k in (500, 1000, 2000, 4000))
        + f" ms; {100 * np.mean(times <= 0.0625):.0f} %; {100 * np.mean(times <= 0.025):.0f} %",
        True,
    )
    settled = {
        name: [1e3 * SecondOrder(*_tangent(name, depth)).settling_time_s() for depth in (0.0, 3e-3, 5e-3)]
        for name in PLANTS
    }
    yield Claim(
        "5 % settling time at 0, 3 and 5 mm: " + ", ".join(settled),
        "memory of 62.5 ms",
        "; ".join(", ".join(f"{value:.0f}" for value in found) + " ms" for found in settled.values()),
        max(max(found) for found in settled.values()) < 75.0,
    )


def _parameters(runs: list[Outcome]) -> Iterator[Claim]:
    """Fig. 6.12: what adaptive least squares found at eight levels of depth, against the plants' own tangents."""
    for place, name in enumerate(PLANTS):
        errors = []
        for outcome in runs[place * SEEDS : (place + 1) * SEEDS]:
            for level in outcome.source.report()["identification"]["levels"]:
                truth = _tangent(name, level["depth_m"])
                found = (level["mass_kg"], level["damping_n_s_per_m"], level["stiffness_n_per_m"])
                errors.append([abs(value / true - 1.0) for value, true in zip(found, truth, strict=True)])
        mass, damping, stiffness = 100.0 * np.median(errors, axis=0)
        yield Claim(
            f"{name}: local mass, damping, stiffness, median error over levels and seeds",
            "no bar",
            f"{mass:.0f}, {damping:.0f}, {stiffness:.0f} %",
            True,
        )


def _tangent(name: str, depth: float) -> tuple[float, float, float]:
    if name == "linear":
        return 0.08, 8.0, 1000.0
    if name == "Wiener":
        slope = 1.0 / (1.4 * (1.0 - depth / 7e-3))
        return 0.08 * slope, 8.0 * slope, 1000.0 * slope
    return 0.08, 8.0 * np.exp(150.0 * depth), 1000.0 * (np.exp(200.0 * depth) * (1.0 + 200.0 * depth) + 0.1)


def _times(runs: dict[bool, list[Outcome]]) -> Iterator[Claim]:
    for identify, asked, thesis in ((False, 3.0, "1.3 s of 5 s, 26 %"), (True, 15.0, "7.5 s of 5 s, 150 %")):
        share = 100.0 * float(np.median([outcome.seconds.sum() / 5.0 for outcome in runs[identify]]))
        worst = 100.0 * max(outcome.seconds.sum() / 5.0 for outcome in runs[identify])
        steps = 1e3 * np.concatenate([outcome.seconds[WARM:] for outcome in runs[identify]])
        how = "with" if identify else "without"
        yield Claim(
            f"computing time {how} identification, share of the test, one core",
            f"{asked:g} % at the most (thesis: {thesis})",
            f"{share:.1f} %, worst {worst:.1f} %",
            worst <= asked,
        )
        yield Claim(
            f"time for a block of 25 ms, {how} identification: 99.9 %, and the longest of {steps.size}",
            "well under 25 ms",
            f"{np.quantile(steps, 0.999):.2f} ms, {steps.max():.2f} ms",
            float(steps.max()) < 12.5,
        )


def _compiling() -> Claim:
    """First start on a machine, and every later one, in a process of its own; imports not counted."""
    code = (
        "import time; from tissueid.stimuli.kinds.rtig import Rtig; t = time.perf_counter(); Rtig().start(0.01);"
        "print(time.perf_counter() - t)"
    )
    with tempfile.TemporaryDirectory() as folder:
        seconds = [
            float(
                subprocess.run(
                    [sys.executable, "-c", code],
                    check=True,
                    capture_output=True,
                    text=True,
                    env=os.environ | {"NUMBA_CACHE_DIR": folder},
                ).stdout
            )
            for _ in range(2)
        ]
    return Claim(
        "compiling, before the test begins: once on a machine, and from the cache",
        "under 20 s",
        f"{seconds[0]:.1f} s, {seconds[1]:.2f} s",
        seconds[0] < 20.0,
    )


class _OnBench:
    """The simulated instrument as a plant: a voltage for the force at rest, and what its converters saw."""

    def __init__(self, tissue: str, seed: int) -> None:
        self._bench = Bench(tissue, seed)
        self._channels = {channel.name: (k, channel) for k, channel in enumerate(self._bench.channels)}
        self._volts_per_newton = self._bench.parameters.resistance_ohm / self._bench.parameters.force_constant_n_per_a
        self.felt = np.zeros(0)

    def block(self, force: Array) -> Array:
        codes = self._bench.block(force * self._volts_per_newton, True).codes
        k, current = self._channels["current"]
        self.felt = self._bench.parameters.force_constant_n_per_a * current.decode(codes[:, k])
        k, position = self._channels["position"]
        return position.decode(codes[:, k]) - SURFACE_M


def _bench(tissue: str) -> Claim:
    """Over the whole range that is asked for, by the positions that were measured."""
    distances, reachable = [], []
    for seed in range(BENCH_SEEDS):
        options = {"depth_min_m": 0.0005, "depth_max_m": 0.002} if tissue == "linear-demo" else {}
        report = closed_loop(Rtig(seed=seed, **options), _OnBench(tissue, seed), noise_m=0.0).source.report()
        distances.append(report["kolmogorov_distance"])
        reachable.append(report["reachable_m"])
    low, high = 1e3 * np.median(reachable, axis=0)
    return Claim(
        f"simulated instrument, {tissue}, -0.6 to 10 N, {'0.5 to 2' if options else '1 to 4'} mm "
        f"(within reach: {low:.1f} to {high:.1f} mm), median of {BENCH_SEEDS} seeds",
        f"{BAR:g} (median)",
        _told(distances),
        float(np.median(distances)) <= BAR,
    )
