"""Layers of tissue in series that bottom out in order of softness (thesis 2.1, Fig. 2.2).

Layer ``i`` of thickness ``h``, small-strain stiffness ``k`` and compression ``c`` carries the force

    f = k c / (1 - c / h),    so that    c = h f / (k h + f),

and bottoms out at ``h``. A layer without a thickness is a linear spring, c = f / k. All layers carry the same force,
and the compressions add up to the depth ``y``. With the tangent compliances ``s_i = dc_i/df`` and ``S`` their sum,
layer ``i`` is compressed at ``v s_i / S`` and its lower face moves at ``v a_i``, with ``a_i`` the share of the
compliance below it. The energy and losses of the chain then are those of one mass with

    stiffness 1 / S,    damping sum b_i (s_i / S)^2,    mass sum m_i a_i^2,

where the mass of a layer lies at its lower face: a layer that has bottomed out moves as one with the probe. The
dynamics of the layers among themselves are left out. Pulled, every layer is linear with its small-strain stiffness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

MAX_LAYERS = 4
LAYER_VALUES = 4  # thickness (0: linear), stiffness, damping, mass of each layer
_ITERATIONS = 40
_PRECISION = 1e-14


@dataclass(frozen=True)
class Layer:
    """One layer, from the surface down, SI; the last one has neither thickness nor mass, and rests on a fixed base."""

    stiffness_n_per_m: float
    damping_n_s_per_m: float = 0.0
    thickness_m: float | None = None
    mass_kg: float = 0.0

    def to_array(self) -> Array:
        """Return the values for the compiled loop, shape (LAYER_VALUES,)."""
        return np.array([self.thickness_m or 0.0, self.stiffness_n_per_m, self.damping_n_s_per_m, self.mass_kg])


def layer_problem(layers: tuple[Layer, ...]) -> str:
    """Return what is wrong with the layers, from the surface down; empty if nothing is."""
    if not layers:
        return ""
    if len(layers) > MAX_LAYERS:
        return f"at most {MAX_LAYERS} layers, not {len(layers)}"
    if any(layer.stiffness_n_per_m <= 0 or layer.damping_n_s_per_m < 0 or layer.mass_kg < 0 for layer in layers):
        return "a layer needs a positive stiffness, and damping and mass of 0 or more"
    if any(layer.thickness_m is None or layer.thickness_m <= 0 for layer in layers[:-1]):
        return "every layer but the last needs a positive thickness"
    if layers[-1].thickness_m is not None or layers[-1].mass_kg:
        return "the last layer is the base: it has neither thickness nor mass"
    return ""


@njit(error_model="numpy")
def layer_values(values: Array, first: int, count: int, depth: float) -> tuple[float, float, float, float]:
    """Return force (N), damping (N s/m), mass (kg) and its slope (kg/m) of layers compressed by a depth, m.

    ``values`` holds LAYER_VALUES of each of ``count`` layers from the index ``first`` on.
    """
    compliance, room = 0.0, 0.0
    for i in range(count):
        at = first + LAYER_VALUES * i
        compliance += 1.0 / values[at + 1]
        room += values[at]
    force = depth / compliance
    if depth > 0.0:
        # Depth is a concave function of force: Newton from a lower bound of the force rises to the root.
        force = max(force, values[first + LAYER_VALUES * (count - 1) + 1] * (depth - room))
        for _ in range(_ITERATIONS):
            reached, slope = 0.0, 0.0
            for i in range(count):
                h, k = values[first + LAYER_VALUES * i], values[first + LAYER_VALUES * i + 1]
                if h > 0.0:
                    whole = k * h + force
                    reached += h * force / whole
                    slope += h * k * h / (whole * whole)
                else:
                    reached += force / k
                    slope += 1.0 / k
            change = (depth - reached) / slope
            force += change
            if abs(change) <= _PRECISION * force:
                break
    carried = max(force, 0.0)
    total, total_slope = 0.0, 0.0
    for i in range(count):
        at = first + LAYER_VALUES * i
        h, k = values[at], values[at + 1]
        s = h * k * h / (k * h + carried) ** 2 if h > 0.0 else 1.0 / k
        total += s
        if h > 0.0:
            total_slope -= 2.0 * s / (k * h + carried)
    damping, mass, mass_slope = 0.0, 0.0, 0.0
    below, below_slope = 0.0, 0.0
    for i in range(count - 1, -1, -1):
        at = first + LAYER_VALUES * i
        h, k = values[at], values[at + 1]
        share = below / total
        mass += values[at + 3] * share * share
        mass_slope += 2.0 * values[at + 3] * share * (below_slope - share * total_slope) / total
        s = h * k * h / (k * h + carried) ** 2 if h > 0.0 else 1.0 / k
        damping += values[at + 2] * (s / total) ** 2
        below += s
        if h > 0.0:
            below_slope -= 2.0 * s / (k * h + carried)
    return force, damping, mass, mass_slope / total if depth > 0.0 else 0.0
