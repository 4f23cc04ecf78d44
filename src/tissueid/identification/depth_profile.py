"""Mass, damping and stiffness against depth, common to all engines that depend on depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DepthProfile:
    """Mass, damping and stiffness at k depths, or at k depths for each of two directions; all arrays have shape (k,).

    ``position`` is the value of the output for a row (m), ``low`` and ``high`` are its bounds. ``direction`` is 1 for
    indentation, -1 for retraction, 0 for both. ``mass`` is in kg, ``damping`` in N s/m, ``stiffness`` in N/m: the slope
    of force against depth, as a small-signal test there would measure it. The ``..._std`` are standard deviations, NaN
    if unknown; a value that the record does not determine is NaN. ``support`` is the number of samples of a row.
    """

    position: Array
    low: Array
    high: Array
    direction: NDArray[np.int_]
    mass: Array
    mass_std: Array
    damping: Array
    damping_std: Array
    stiffness: Array
    stiffness_std: Array
    support: NDArray[np.int_]

    def __len__(self) -> int:
        return int(self.position.size)

    def as_rows(self) -> list[dict[str, Any]]:
        """Return one mapping per row for JSON, with the unit in each name; values that are not finite are None."""
        columns = {
            "position_m": self.position,
            "low_m": self.low,
            "high_m": self.high,
            "mass_kg": self.mass,
            "mass_std_kg": self.mass_std,
            "damping_n_s_per_m": self.damping,
            "damping_std_n_s_per_m": self.damping_std,
            "stiffness_n_per_m": self.stiffness,
            "stiffness_std_n_per_m": self.stiffness_std,
        }
        return [
            {name: float(values[row]) if np.isfinite(values[row]) else None for name, values in columns.items()}
            | {"direction": int(self.direction[row]), "support": int(self.support[row])}
            for row in range(len(self))
        ]
