"""Multistep tests: how even the depth grows when each test is designed from those before it."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from engine_claims.base import Claim
from support import connect

from tissueid.acquisition import MultistepTest, SessionRecorder, run_multistep
from tissueid.instrument import Instrument, SimulatedInstrument
from tissueid.sessions import Test
from tissueid.stimuli.depth_uniform import DepthDesign
from tissueid.test_settings import TestSettings

STEPS = 3
SECONDS = 3.0
SEEDS = (1, 2, 3)
EVEN = 0.05
"""The target that ends a multistep test unless another is given."""

SYSTEMS: dict[str, tuple[Callable[[int], Instrument], float, float]] = {
    "twin of the forearm, in process": (lambda seed: SimulatedInstrument("baseline", seed=seed), 1.6e-3, 4.5e-3),
    "linear-demo": (lambda seed: connect("linear-demo", seed=seed), 0.3e-3, 2.0e-3),
    "wiener-demo": (lambda seed: connect("wiener-demo", seed=seed), 1.0e-3, 6.0e-3),
    "left-posterior-forearm": (lambda seed: connect("left-posterior-forearm", seed=seed), 2.3e-3, 3.8e-3),
}


def claims() -> Iterator[Claim]:
    """Kolmogorov distance of the depth from uniform after each of three tests of 3 s, over the range asked for."""
    for name, (make, low, high) in SYSTEMS.items():
        found = np.array([_distances(make(seed), seed, low, high) for seed in SEEDS])  # (seeds, steps)
        middle, worst = np.median(found, axis=0), found.max(axis=0)
        steps = ", ".join(f"{value:.3f}" for value in middle)
        yield Claim(
            f"{name}, {1e3 * low:.1f} to {1e3 * high:.1f} mm: distance after tests 1, 2 and 3 "
            f"(median of {len(SEEDS)} seeds; worst last)",
            f"at most {EVEN:g} after 3",
            f"{steps} ({worst[-1]:.3f})",
            bool(worst[-1] <= EVEN),
        )
    yield _out_of_reach()


def _run(instrument: Instrument, seed: int, low: float, high: float, steps: int) -> tuple[Test, ...]:
    """The tests of one run, none of them good enough to end it."""
    design = DepthDesign(depth_min_m=low, depth_max_m=high, seconds=SECONDS, force_max_n=11.0)
    with tempfile.TemporaryDirectory() as folder:
        recorder = SessionRecorder(Path(folder) / "s.h5", instrument.device)
        test = MultistepTest(design, TestSettings(site="claim"), steps=steps, target=0.0, seed=10 * seed)
        run_multistep(instrument, test, recorder)
        instrument.close()
        return recorder.finish().tests


def _distances(instrument: Instrument, seed: int, low: float, high: float) -> list[float]:
    return [_distance(test, low, high) for test in _run(instrument, seed, low, high, STEPS)]


def _distance(test: Test, low: float, high: float) -> float:
    """Kolmogorov distance of all depths after the preload from uniform, by its definition."""
    depth = np.sort(test.record().output - test.surface_position_m)
    wanted, counted = np.clip((depth - low) / (high - low), 0.0, 1.0), np.arange(depth.size + 1) / depth.size
    return float(max(np.abs(wanted - counted[1:]).max(), np.abs(wanted - counted[:-1]).max()))


def _out_of_reach() -> Claim:
    """A range of which the forces reach a part is cut to that part, and the session says so."""
    tests = _run(SimulatedInstrument("baseline", seed=1), 1, 1.0e-3, 8.0e-3, STEPS)
    notes = tests[-1].notes
    low, high = float(notes["depth_min_m"]), float(notes["depth_max_m"])
    found = _distance(tests[-1], low, high)
    told = notes["depth_asked_max_m"] == 8.0e-3 and low > 1.0e-3 and high < 8.0e-3
    return Claim(
        "twin, 1 to 8 mm asked of at most 11 N: designed for what can be reached, and said so; distance there",
        f"said; at most {EVEN:g}",
        f"{1e3 * low:.2f} to {1e3 * high:.2f} mm; {found:.3f}",
        told and found <= EVEN,
    )
