"""Parameters of the simulated plant, as one NumPy record that the compiled laws read, with its tables.

Every law that is not part of the baseline vanishes where its parameters are zero, as they are at first.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

CELLS = 4
"""Largest number of cells of the coil's lossy inductance."""
ELEMENTS = 6
"""Largest number of slipping elements, and of relaxation branches."""

FORCE_CURVE, INDUCTANCE_CURVE, SATURATION, RELUCTANCE, POSITION_FORCE, LAYER = range(6)
"""Rows of the tables: relative force constant, relative inductance, relative force constant by current, half the slope
of the inductance (H/m), force by position (N), and static force of a second layer by depth (N)."""
TABLES = 6
NODES = 2049
"""Nodes of a table; between them it is linear, outside it is constant."""

(
    POSITION,
    SPEED,
    CURRENT,
    CELL_CURRENT,
    BRISTLE,
    COIL_HEAT,
    BODY_HEAT,
    FRAME,
    FRAME_SPEED,
    BRANCH,
    LOOP,
    WORKED,
    TWITCH,
    TWITCH_RATE,
) = (0, 1, 2, 3, 7, 8, 9, 10, 11, 12, 18, 19, 20, 21)
"""Places of the states; ``CELL_CURRENT`` is the first of ``CELLS``, ``BRANCH`` the first of ``ELEMENTS``."""
STATES = 22

BEARING_SLIP, TISSUE_SLIP, LATERAL, TOUCHING = 0, ELEMENTS, 2 * ELEMENTS, 2 * ELEMENTS + 1
"""Places of the memories, which change between the steps only."""
MEMORIES = 2 * ELEMENTS + 2

_SCALARS = (
    "resistance_ohm",
    "inductance_h",
    "force_constant_n_per_a",
    "mass_kg",
    "damping_n_s_per_m",
    "weight_n",
    "stiffness_n_per_m",
    "stiffness_rate_per_m",
    "tissue_damping_n_s_per_m",
    "damping_rate_per_m",
    "tissue_mass_kg",
    "surface_m",
    "heat_per_j",
    "heat_rate_hz",
    "heat_share",
    "bristle_n_per_m",
    "bristle_n_s_per_m",
    "static_ratio",
    "stribeck_m_s",
    "drag_n",
    "drag_power",
    "stop_m",
    "stop_side",
    "stop_n_per_m",
    "stop_n_per_m3",
    "stop_n_s_per_m",
    "frame_ratio",
    "frame_rad_s",
    "frame_damping_ratio",
    "cable_n_per_m",
    "cable_slack_m",
    "cable_n_s_per_m",
    "cable_middle_m",
    "periodic_drag_n_s_per_m",
    "periodic_drag_rad_per_m",
    "periodic_drag_phase_rad",
    "branch_exponential",
    "loop_n",
    "loop_yield_m",
    "loop_power",
    "loop_gamma",
    "soften_share",
    "soften_scale",
    "soften_kind",
    "added_kg_per_m",
    "added_length_m",
    "contact_share",
    "contact_length_m",
    "adhesion_n",
    "adhesion_reach_m",
    "direction_share",
    "direction_speed_m_s",
    "reflex_n_s_per_m",
    "reflex_threshold_m_s",
    "reflex_rate_hz",
    "wave_share",
    "wave_rad_s",
    "wave_phase_rad",
    "lateral_n_per_m",
    "lateral_static",
    "lateral_kinetic",
)
_COUNTS = ["cells", "branches", "bearing_slips", "tissue_slips", "reflex_delay"]
_ELEMENTS = (
    "bearing_n_per_m",
    "bearing_push_m",
    "bearing_pull_m",
    "tissue_n_per_m",
    "tissue_slip_m",
    "branch_share",
    "branch_rate_hz",
)

PLANT = np.dtype(
    [(name, "f8") for name in _SCALARS]
    + [(name, "i8") for name in _COUNTS]
    + [(name, "f8", (ELEMENTS,)) for name in _ELEMENTS]
    + [("cell_ohm", "f8", (CELLS,)), ("cell_h", "f8", (CELLS,)), ("coulomb_n", "f8", (2,))]
    + [("tabled", "i8", (TABLES,)), ("table_low", "f8", (TABLES,)), ("table_step", "f8", (TABLES,))]
)
"""Type of the record of the plant. Names carry their units; coulomb_n is for motion inwards and outwards."""


class PlantModel:
    """A record of the plant with its tables, which effects change before a simulation."""

    def __init__(self) -> None:
        self._record = np.zeros(1, PLANT)
        self.tables = np.zeros((TABLES, NODES))

    @property
    def values(self) -> np.record:
        """The record, whose fields are set by name: ``plant.values["mass_kg"] = 0.06``."""
        return self._record[0]  # type: ignore[no-any-return]

    def tabulate(self, row: int, low: float, high: float, law: Callable[[Floats], Floats]) -> None:
        """Use ``law`` as table ``row``, from ``low`` to ``high`` (m, or A for the saturation)."""
        nodes = np.linspace(low, high, NODES)
        self.tables[row] = law(nodes)
        self.values["tabled"][row] = 1
        self.values["table_low"][row] = low
        self.values["table_step"][row] = nodes[1] - nodes[0]
