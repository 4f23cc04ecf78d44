"""One test of a sweep: what was recorded while the coil shook the calibration spring about one position."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.sessions import Test

Array = NDArray[np.float64]

LEAST_S, MOST_S = 0.5, 60.0
LOWEST_RATE_HZ, HIGHEST_RATE_HZ = 1000.0, 20_000.0
"""Samples a second: fewer do not show what coil and filter do, more only fill the memory."""
_LARGEST = {"voltage": 1e3, "current": 1e2, "position": 0.2}
"""Sizes beyond this, V, A and m, no instrument measures."""
_MOST_SWEEPS = 100


@dataclass(frozen=True, eq=False)
class SweepTest:
    """Readings (n,) of voltage, V, current, A, and position, m; NaN where a sample was not received.

    ``stage_m`` is where a motorised stage had put the fixture, NaN where a person did; ``rest_m`` where the probe then
    stood with the coil free; ``sweep`` counts the repeats of the whole sweep from 0. Infinity is taken for NaN.

    Raises:
        UnusableInputError: readings that no instrument gives, that do not change, or of which most are lacking.
    """

    voltage: Array
    current: Array
    position: Array
    sample_rate_hz: float
    stage_m: float = float("nan")
    rest_m: float = float("nan")
    sweep: int = 0

    def __post_init__(self) -> None:
        if not LOWEST_RATE_HZ <= self.sample_rate_hz <= HIGHEST_RATE_HZ:
            raise UnusableInputError(
                f"a sweep is recorded at {LOWEST_RATE_HZ:g} to {HIGHEST_RATE_HZ:g} samples a second, "
                f"not at {self.sample_rate_hz:g}"
            )
        for name, largest in _LARGEST.items():
            values = np.asarray(getattr(self, name), dtype=np.float64)
            values = np.where(np.isinf(values), np.nan, values)
            if values.shape != (self.position.size,):
                raise UnusableInputError("voltage, current and position of a test differ in length")
            size = float(np.max(np.abs(values), initial=0.0, where=np.isfinite(values)))
            if size > largest:
                raise UnusableInputError(f"the {name} goes to {size:.3g}: no instrument measures that, check the units")
            object.__setattr__(self, name, values)
        if not LEAST_S <= self.position.size / self.sample_rate_hz <= MOST_S:
            raise UnusableInputError(
                f"a test of a sweep lasts {LEAST_S:g} to {MOST_S:g} s, "
                f"not {self.position.size / self.sample_rate_hz:.3g} s"
            )
        received = np.isfinite(self.voltage + self.current + self.position)
        if np.mean(received) < 0.5:
            raise UnusableInputError("most samples of a test were lost; check the link and repeat the sweep")
        for name in _LARGEST:
            if not np.ptp(getattr(self, name)[received]) > 0.0:
                raise UnusableInputError(f"the {name} does not change in a test: nothing can be learned from it")

    @classmethod
    def of_session(cls, test: Test) -> SweepTest:
        """The test as a session keeps it, its preload cut off.

        Raises:
            UnusableInputError: it lacks a signal, or holds what no sweep leaves; says of which test.
        """
        preload = test.preload_s * test.sample_rate_hz
        first = round(min(preload, test.samples)) if preload > 0.0 else 0
        if missing := [name for name in _LARGEST if name not in test.signals]:
            raise UnusableInputError(f"test {test.number} has no {missing[0]}: a sweep needs it")
        stage, sweep = test.notes.get("stage_m"), test.notes.get("sweep", 0.0)
        if not (isinstance(sweep, float | int) and 0 <= sweep < _MOST_SWEEPS and sweep == int(sweep)):
            raise UnusableInputError(f"test {test.number} says that it is of sweep {sweep}: that is none")
        try:
            return cls(
                **{name: test.signals[name][first:] for name in _LARGEST},
                sample_rate_hz=test.sample_rate_hz,
                stage_m=float(stage) if isinstance(stage, float | int) and abs(stage) <= 1.0 else float("nan"),
                rest_m=test.surface_position_m,
                sweep=int(sweep),
            )
        except UnusableInputError as error:
            raise UnusableInputError(f"test {test.number}: {error}") from error

    @property
    def mean_position_m(self) -> float:
        """About which it shook."""
        return float(np.nanmean(self.position))

    @property
    def swing_m(self) -> float:
        """Root mean square of the position about its mean."""
        return float(np.nanstd(self.position))
