"""One test of a sweep: what was recorded while the coil shook the calibration spring about one position."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.sessions import Test

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SweepTest:
    """Readings (n,) of voltage, V, current, A, and position, m; NaN where a sample was not received.

    ``stage_m`` is where a motorised stage had put the fixture, NaN where a person did; ``rest_m`` where the probe then
    stood with the coil free; ``sweep`` counts the repeats of the whole sweep from 0.
    """

    voltage: Array
    current: Array
    position: Array
    sample_rate_hz: float
    stage_m: float = float("nan")
    rest_m: float = float("nan")
    sweep: int = 0

    @classmethod
    def of_session(cls, test: Test) -> SweepTest:
        """The test as a session keeps it, its preload cut off."""
        first = round(test.preload_s * test.sample_rate_hz)
        stage, sweep = test.notes.get("stage_m"), test.notes.get("sweep")
        return cls(
            voltage=test.signals["voltage"][first:],
            current=test.signals["current"][first:],
            position=test.signals["position"][first:],
            sample_rate_hz=test.sample_rate_hz,
            stage_m=float(stage) if isinstance(stage, float | int) else float("nan"),
            rest_m=test.surface_position_m,
            sweep=int(sweep) if isinstance(sweep, float | int) else 0,
        )

    @property
    def mean_position_m(self) -> float:
        """About which it shook."""
        return float(np.nanmean(self.position))

    @property
    def swing_m(self) -> float:
        """Root mean square of the position about its mean."""
        return float(np.nanstd(self.position))
