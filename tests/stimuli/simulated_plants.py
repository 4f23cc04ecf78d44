"""The plants of the thesis' real-time input generation (Chen 2010, C.4.2), stepped block by block.

Force in newtons is held from sample to sample, and a reading is taken at the end of its sample. The linear block is
stepped by its exact solution, the one with depth-dependent parameters by Runge-Kutta. Nothing here comes from the
package but the interface of a feedback stimulus, which :func:`closed_loop` drives as an instrument would.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, stats

from tissueid.stimuli import FeedbackKind, FeedbackSource

Array = NDArray[np.float64]

RATE = 2000.0
BLOCK = 50
MASS, DAMPING, STIFFNESS = 0.08, 8.0, 1000.0
CURVE_M, CURVE_PER_N = 7e-3, 0.2
"""C1 and C2 of the Wiener curve; C2 is per millimetre of the linear block, which is a newton at 1000 N/m."""

DAMPING_GROWTH, STIFFNESS_GROWTH, STIFFNESS_OFFSET = 150.0, 200.0, 0.1
"""A2 and A3, per metre, and D3."""

DEPTH_M = (0.0, 6e-3)
FORCE_N = (-5.0, 25.0)
SURFACE_M = 0.010
PRELOAD_S = 0.5


class Linear:
    """M y'' + B y' + K y = force; ``curve`` may bend what is read."""

    def __init__(
        self,
        stiffness: float = STIFFNESS,
        mass: float = MASS,
        damping: float = DAMPING,
        curve: Callable[[Array], Array] | None = None,
    ) -> None:
        system = np.zeros((3, 3))
        system[0, 1] = 1.0
        system[1] = -stiffness / mass, -damping / mass, 1.0 / mass
        step = linalg.expm(system / RATE)
        self._a, self._b = step[:2, :2], step[:2, 2]
        self._curve = curve
        self._state = np.zeros(2)

    def block(self, force: Array) -> Array:
        """Depth, m, at the end of each sample, for a force (n,), N."""
        (a, b), (c, d) = self._a.tolist()
        g, h = self._b.tolist()
        x, v = self._state.tolist()
        depth = np.empty(force.size)
        for n, push in enumerate(force.tolist()):
            x, v = a * x + b * v + g * push, c * x + d * v + h * push
            depth[n] = x
        self._state[:] = x, v
        return depth if self._curve is None else self._curve(depth)


def wiener() -> Linear:
    """The linear block, then y = C1 (1 - exp(-C2 z))."""
    return Linear(curve=lambda z: CURVE_M * (1.0 - np.exp(-CURVE_PER_N * STIFFNESS * z)))


class DepthDependent:
    """M y'' + B exp(A2 y) y' + K (exp(A3 y) + D3) y = force (C.1.4)."""

    def __init__(self) -> None:
        self._state = (0.0, 0.0)

    def block(self, force: Array) -> Array:
        """Depth, m, at the end of each sample, for a force (n,), N."""
        exp, step = math.exp, 1.0 / RATE
        x, v = self._state

        def acceleration(push: float, x: float, v: float) -> float:
            damping = DAMPING * exp(DAMPING_GROWTH * x)
            return (push - damping * v - STIFFNESS * (exp(STIFFNESS_GROWTH * x) + STIFFNESS_OFFSET) * x) / MASS

        depth = np.empty(force.size)
        for n, push in enumerate(force.tolist()):
            a1 = acceleration(push, x, v)
            v2 = v + 0.5 * step * a1
            a2 = acceleration(push, x + 0.5 * step * v, v2)
            v3 = v + 0.5 * step * a2
            a3 = acceleration(push, x + 0.5 * step * v2, v3)
            v4 = v + step * a3
            a4 = acceleration(push, x + step * v3, v4)
            x += step / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
            v += step / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
            depth[n] = x
        self._state = (x, v)
        return depth


class Plant(Protocol):
    """What is pushed; ``felt``, when there is one, is the force that was measured over the last block."""

    def block(self, force: Array) -> Array: ...


PLANTS: dict[str, Callable[[], Plant]] = {"linear": Linear, "Wiener": wiener, "DPN": DepthDependent}


@dataclass(frozen=True)
class Outcome:
    """One test: set-points (n,), N, true depths (n,), m, after the preload; the source; the seconds that
    it took for each piece of samples, with the blocks that were made for it."""

    force: Array
    depth: Array
    source: FeedbackSource
    seconds: Array

    def distance(self, low: float = DEPTH_M[0], high: float = DEPTH_M[1]) -> float:
        """Kolmogorov distance of all depths from the uniform distribution over a range, m."""
        return float(stats.kstest(self.depth, "uniform", (low, high - low)).statistic)


def closed_loop(
    kind: FeedbackKind,
    plant: Plant,
    seed: int = 0,
    noise_m: float = 1e-6,
    surface_error_m: float = 0.0,
    spoil: Callable[[int, Array, Array], None] | None = None,
    chunk: int = 20,
    clock: Callable[[], float] = time.thread_time,
) -> Outcome:
    """Run a test as over a cable: a block is asked for when its start is ``kind.lead`` blocks off.

    ``spoil`` may change what is handed over: number of the first sample, force, position.
    """
    rng = np.random.default_rng([seed, 4])
    source = kind.start(SURFACE_M + surface_error_m)
    samples = round(kind.seconds * RATE)
    rest = round(PRELOAD_S * RATE)
    force = np.full(rest + samples + BLOCK, kind.preload_n)
    depth = np.empty(rest + samples)
    made = 0
    seconds: list[float] = []
    for begin in range(0, rest + samples, chunk):
        end = min(begin + chunk, rest + samples)
        spent = 0.0
        while made < samples and made - (begin - rest) <= kind.lead * BLOCK:
            began = clock()
            force[rest + made : rest + made + BLOCK] = source.next_block()
            spent += clock() - began
            made += BLOCK
        depth[begin:end] = plant.block(force[begin:end])
        f = np.array(getattr(plant, "felt", force[begin:end]))
        y = SURFACE_M + depth[begin:end] + noise_m * rng.standard_normal(end - begin)
        if spoil is not None:
            spoil(begin - rest, f, y)
        began = clock()
        source.take(f, y, begin - rest)
        seconds.append(spent + clock() - began)
    return Outcome(force[rest : rest + samples], depth[rest:], source, np.array(seconds))
