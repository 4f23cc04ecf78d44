"""Simulation of a mass under a given force over windows that each start from a given state, in one compiled call."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissueid.twin import _kernel, bus
from tissueid.twin.chain_parameters import InstrumentParameters, Tissue
from tissueid.twin.simulation import PreparedEffects

FloatArray = NDArray[np.float64]

_GIVEN = np.array([False, True, False])
"""Of voltage, current and motion only the current is given: the force at a force constant of 1 N/A."""


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _integrate(  # type: ignore[no-untyped-def]
    edges, starts, follows, force, given, figures, tissue, period, substeps, effects, places, parameters, states, out
):
    state = np.zeros(4)
    for k in range(edges.size - 1):
        first, end = edges[k], edges[k + 1]
        if follows:
            # The second mass keeps its motion relative to the first one.
            states[0, 0] += starts[k, 0] - state[1]
            states[0, 1] += starts[k, 1] - state[2]
        state[1] = starts[k, 0]
        state[2] = starts[k, 1]
        states[bus.SLOTS, bus.SAMPLE] = first
        piece = force[first:end].copy()
        measured = np.zeros((4, piece.size))
        measured[1] = piece
        found = np.empty((4, piece.size))
        _kernel.integrate(
            piece,
            measured,
            given,
            figures,
            tissue,
            period,
            substeps,
            state,
            effects,
            places,
            parameters,
            states,
            found,
            0.0,
        )
        out[:, first:end] = found


def simulate_windows(
    effects: PreparedEffects,
    force_n: FloatArray,
    sample_rate_hz: float,
    instrument: InstrumentParameters,
    tissue: Tissue,
    edges: NDArray[np.int64],
    starts: FloatArray,
    substeps: int,
    *,
    second_mass: bool = False,
) -> FloatArray:
    """Return voltage, current, position and velocity at the end of each sample, shape (4, n).

    Args:
        effects: effects at the start; their states are updated in place and continue from window to window.
        force_n: the force, shape (n,), held over each sample.
        sample_rate_hz: its sample rate.
        instrument: parameters of the mass, with a force constant of 1 N/A.
        tissue: the spring, or nothing.
        edges: first sample of each window, and n, shape (windows + 1,).
        starts: position (m) and velocity (m/s) at the start of each window, shape (windows, 2).
        substeps: integration steps in a sample.
        second_mass: whether the first effect is a second mass, whose state begins with its position and velocity.
    """
    out = np.empty((4, force_n.size))
    common: tuple[Any, ...] = (instrument.to_array(), tissue.to_array(), 1.0 / sample_rate_hz, substeps)
    _integrate(
        edges,
        starts,
        second_mass,
        force_n,
        _GIVEN,
        *common,
        effects.hooks,
        effects.places,
        effects.parameters,
        effects.states,
        out,
    )
    return out
