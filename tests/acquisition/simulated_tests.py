"""Tests recorded on a bench without a firmware: quick, and with whatever goes wrong in mid-test."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from firmware_sim.bench import Bench
from tissueid.acquisition import usual_noise
from tissueid.device import DeviceDescription
from tissueid.sessions import Test
from tissueid.stimuli.base import Stimulus

RATE = 2000.0
DEVICE = DeviceDescription(calibration={"state": "valid", "verdict": "passed"})
SIGNALS = ("command", "voltage", "current", "position", "temperature", "acceleration_x", "acceleration_y")
BLOCK = 500


class Desk:
    """A bench on which one test is played after the other."""

    def __init__(self, tissue: str = "left-posterior-forearm", seed: int = 1, surface_m: float = 0.0102) -> None:
        self.bench = Bench(tissue, seed=seed)
        self.seed = seed
        self.surface_m = surface_m
        self.tests: list[Test] = []

    def run(self, stimulus: Stimulus | None = None, hook: Callable[[Bench, int], None] | None = None) -> Test:
        """One test; ``hook`` gets the bench and the sample before every block of 250 ms."""
        chosen = stimulus or usual_noise(RATE, seed=self.seed, seconds=3.0)
        volts = 4.0 * chosen.values
        blocks = []
        for first in range(0, volts.size, BLOCK):
            if hook is not None:
                hook(self.bench, first)
            blocks.append(self.bench.block(volts[first : first + BLOCK], energised=True))
        codes = np.concatenate([block.codes for block in blocks])
        signals = {name: self.bench.channels[k].decode(codes[:, k]) for k, name in enumerate(SIGNALS)}
        signals["force"] = 3.0 * signals["current"]
        self.bench.block(np.zeros(1000), energised=False)
        test = Test(
            number=len(self.tests) + 1,
            kind="stochastic",
            signals=signals,
            sample_rate_hz=RATE,
            site="forearm",
            preload_s=chosen.preload_s,
            surface_position_m=self.surface_m,
            stimulus=chosen.description,
        )
        self.tests.append(test)
        return test


def move(bench: Bench, metres: float) -> None:
    """The tissue moves along the stroke."""
    bench.plant.tissue = replace(bench.plant.tissue, surface_m=bench.plant.tissue.surface_m + metres)


def with_signal(test: Test, name: str, values: np.ndarray) -> Test:
    """The test with another signal."""
    return replace(test, signals=test.signals | {name: values})
