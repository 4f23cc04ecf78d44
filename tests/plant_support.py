"""What the tests of the plant share: the standard stimulus, and records of a preset under it."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from firmware_sim.bench import Bench
from firmware_sim.plant import SAMPLE_RATE_HZ, Plant, PlantParameters
from firmware_sim.presets import load_preset, preset_names
from tissueid.records import Record
from tissueid.stimuli.kinds.noise import Noise

SKIN = tuple(name for name in preset_names() if name.endswith(("forearm", "arm")) and not name.startswith("sliding"))
MATERIALS = ("acrylamide-10", "acrylamide-20", "acrylamide-30", "buna", "latex")
PRELOAD = 1000  # samples, 0.5 s
VOLTS_PER_NEWTON = 4.0


def standard_force(distribution: str = "gaussian", seed: int = 1) -> NDArray[np.float64]:
    """0.5 s at the mean load, then 4 s of the standard noise, N, shape (9000,)."""
    low, high = (-5.0, 12.0) if distribution == "gaussian" else (-3.5, 10.5)
    noise = Noise(distribution=distribution, seed=seed, force_min_n=low, force_max_n=high, clipped=0.0455).build()
    return preloaded(noise.values)


def small_force(mean_n: float = 3.5, half_n: float = 0.75, seed: int = 2) -> NDArray[np.float64]:
    """0.5 s at the mean load, then 4 s of small noise about it, N, shape (9000,)."""
    noise = Noise(seed=seed, force_min_n=mean_n - half_n, force_max_n=mean_n + half_n).build()
    return preloaded(noise.values)


def preloaded(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.concatenate([np.full(PRELOAD, values.mean()), values])


@cache
def bench_record(preset: str, distribution: str, seed: int = 1) -> Record:
    """Measured force and position of a preset in the standard test (or "small"), preload cut off."""
    force = small_force(seed=seed) if distribution == "small" else standard_force(distribution, seed)
    bench = Bench(preset, seed=seed)
    codes = bench.block(force * VOLTS_PER_NEWTON, energised=True).codes[PRELOAD:]
    values = {c.name: c.decode(codes[:, k]) for k, c in enumerate(bench.channels)}
    return Record(3.0 * values["current"], values["position"], SAMPLE_RATE_HZ)


def plant(preset: str, **options: int) -> Plant:
    return Plant(PlantParameters(), load_preset(preset), **options)
