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

    ``position`` is where on the output's axis a row holds (m), ``low`` and ``high`` the stretch of output it speaks
    for, ``direction`` is 1 for rows of movement into the tissue, -1 out of it and 0 for both together. ``mass`` is in
    kg, ``damping`` in N s/m, ``stiffness`` in N/m: the slope of force against depth, as a small test there would
    measure it. The ``..._std`` are standard deviations, NaN where none can be had; a value is NaN where the record
    does not hold it. ``support`` is how many samples speak for a row.
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
        """Return one mapping a row with the unit in each name, fit for JSON: what is not finite is None."""
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
