"""Steps of force on a standard linear solid, and its readings in closed form."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from tissueid.records import Record
from tissueid.stimuli.kinds.quasi_static import StepHold

Array = NDArray[np.float64]

K0, K1, TAU = 2000.0, 8000.0, 0.4
"""Spring, N/m, in series with a Kelvin-Voigt element of another spring, N/m, and a time constant, s."""
LOW, HIGH = 1.0, 4.0
"""Levels of the force, N."""


def compliance(t: float, k0: float = K0, k1: float = K1, tau: float = TAU) -> float:
    """Return the creep compliance of the solid, m/N."""
    return 1.0 / k0 + (1.0 - np.exp(-t / tau)) / k1


def true_lengths(hold_s: float, final_s: float = 0.0, end_s: float = 0.0, **solid: float) -> dict[str, float]:
    """Return Ue, Uv, Uf, Ur and Ua, m, and their ratios, of one cycle of ideal steps with holds of a length.

    ``final_s`` and ``end_s`` are the times of the last positions of hold and cycle after the step; the ends by default.
    """
    final_s, end_s = final_s or hold_s, end_s or 2.0 * hold_s

    def j(t: float) -> float:
        return (HIGH - LOW) * compliance(t, **solid)

    found = {
        "ue_m": j(0.1),
        "uv_m": j(final_s) - j(0.1),
        "uf_m": j(final_s),
        "ur_m": j(final_s) - j(hold_s + 0.1) + j(0.1),
        "ua_m": j(final_s) - j(end_s) + j(end_s - hold_s),
    }
    return found | {
        "r2": found["ua_m"] / found["uf_m"],
        "r5": found["ur_m"] / found["ue_m"],
        "r6": found["uv_m"] / found["ue_m"],
        "r7": found["ur_m"] / found["uf_m"],
    }


def creep(force: Array, rate: float, k0: float = K0, k1: float = K1, tau: float = TAU) -> Array:
    """Return the position (n,) of the solid, m, at rest under the first force; the force is linear between samples."""
    change = force - force[0]
    decay = np.exp(-1.0 / (rate * tau))
    late = (1.0 - decay) * tau * rate  # the share of a linear course between two samples
    slow = signal.lfilter([1.0 - late, late - decay], [1.0, -decay], change)
    return change / k0 + slow / k1


def step_record(
    rng: np.random.Generator,
    *,
    cycles: int = 1,
    hold_s: float = 1.0,
    rate: float = 2000.0,
    noise_m: float = 2e-6,
    drift_m_per_s: float = 0.0,
    **solid: float,
) -> Record:
    """Return a step test of the solid with white noise and drift of the position."""
    holds = 2 * cycles + 1
    kind = StepHold(cycles=cycles, seconds=holds * hold_s, sample_rate=rate, force_min_n=LOW, force_max_n=HIGH)
    force = kind.build().values
    position = 0.012 + creep(force, rate, **solid) + drift_m_per_s * np.arange(force.size) / rate
    force = force + 2e-3 * rng.standard_normal(force.size)
    return Record(force, position + noise_m * rng.standard_normal(force.size), rate)
