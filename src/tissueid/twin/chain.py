"""The baseline chain (contract: ideal amplifier, R-L coil with back-EMF, mass, viscous bearing, gravity, DPN tissue).

The thesis gives the tissue as a dynamic parameter nonlinearity (Eq. 3.33) whose stiffness and damping grow
exponentially with depth while the mass stays (5.2). Integrated by Heun's rule on a fine grid within each sample.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

SUBSTEPS = 20
"""At 2 kHz one step is 25 us, a third of the coil's electrical time constant of 83 us."""


@dataclass(frozen=True)
class TwinParameters:
    """Figures of the chain, SI. The order is that in which the compiled loop reads them."""

    amplifier_gain: float = 1.0
    amplifier_limit_v: float = 48.0
    resistance_ohm: float = 12.0
    inductance_h: float = 1.0e-3
    force_constant_n_per_a: float = 3.0
    mass_kg: float = 0.085
    """Moving mass and tissue mass together."""
    bearing_damping_n_s_per_m: float = 3.5
    weight_n: float = 0.060 * 9.81
    """Weight of the moving mass along the stroke, positive into the tissue."""
    surface_m: float = 0.010
    damping_n_s_per_m: float = 8.0
    """Tissue damping at the surface."""
    damping_growth_per_m: float = 250.0
    stiffness_n_per_m: float = 500.0
    """Tissue stiffness at the surface."""
    stiffness_growth_per_m: float = 250.0
    stroke_m: float = 0.032


@dataclass(frozen=True)
class State:
    """Where the chain stands: coil current (A), position (m), velocity (m/s)."""

    current_a: float
    position_m: float
    velocity_m_s: float


def simulate(
    command_v: NDArray[np.float64], parameters: TwinParameters, sample_rate_hz: float, state: State
) -> tuple[NDArray[np.float64], State]:
    """Run the chain through a command, shape (n,), V, held over each sample.

    Returns voltage (V), current (A) and position (m) at the end of each sample, shape (3, n), and the new state.
    """
    figures = np.array(astuple(parameters))
    start = np.array([state.current_a, state.position_m, state.velocity_m_s])
    signals, end = _integrate(np.ascontiguousarray(command_v, np.float64), figures, 1.0 / sample_rate_hz, start)
    return signals, State(*(float(value) for value in end))


@njit(cache=True)  # type: ignore[untyped-decorator]
def _slopes(volts, state, figures, out):  # type: ignore[no-untyped-def]
    current, position, velocity = state
    resistance, inductance, force_constant, mass = figures[2:6]
    bearing, weight, surface = figures[6:9]
    damping, damping_growth, stiffness, stiffness_growth, stroke = figures[9:14]
    depth = position - surface
    push = 0.0
    if depth > 0.0:
        push = stiffness * math.exp(stiffness_growth * depth) * depth
        push += damping * math.exp(damping_growth * depth) * velocity
        push = max(push, 0.0)
    # Rubber at both ends of the stroke keeps the simulation inside the housing.
    beyond = min(position, 0.0) + max(position - stroke, 0.0)
    if beyond != 0.0:
        push += 1.0e5 * beyond + 50.0 * velocity
    out[0] = (volts - resistance * current - force_constant * velocity) / inductance
    out[1] = velocity
    out[2] = (force_constant * current + weight - bearing * velocity - push) / mass


@njit(cache=True)  # type: ignore[untyped-decorator]
def _integrate(command, figures, period, start):  # type: ignore[no-untyped-def]
    gain, limit = figures[0], figures[1]
    step = period / SUBSTEPS
    state = start.copy()
    first, second = np.empty(3), np.empty(3)
    signals = np.empty((3, command.size))
    for n in range(command.size):
        volts = min(max(gain * command[n], -limit), limit)
        for _ in range(SUBSTEPS):
            _slopes(volts, state, figures, first)
            _slopes(volts, state + step * first, figures, second)
            state += 0.5 * step * (first + second)
        signals[0, n] = volts
        signals[1, n] = state[0]
        signals[2, n] = state[1]
    return signals, state
