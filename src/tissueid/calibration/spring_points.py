"""Linear identification of coil and spring at each position of a sweep (Chen 2010, 2.4.1, Fig. 2.12)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.calibration.sweep_test import Array, SweepTest
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.identification.engines.lms import Lms
from tissueid.identification.second_order import SecondOrder
from tissueid.messages import Message
from tissueid.records import Estimate, Record

MEMORY_S = 0.25
"""Length of the impulse response, s: a spring of 1,000 N/m with 66 g decays to 0.1 % within it."""
RATE_HZ = 2000.0
"""Sample rate of the identification, Hz."""
LOWEST_HZ, HIGHEST_HZ = 2.0, 200.0
"""Band of the Bode plot, Hz: the band of the stimulus."""
_FREQUENCIES = 41
"""Frequencies of the Bode plot."""


@dataclass(frozen=True, eq=False)
class SpringPoint:
    """Result at one position: apparent mass, damping and stiffness with the force constant of the device.

    ``vaf_percent`` is that of the impulse response, ``vaf_parametric_percent`` that of the second-order system.
    ``response_m_per_n`` (41,) is the measured compliance at ``frequency_hz`` (41,), from the impulse response.
    """

    position_m: float
    stage_m: float
    rest_m: float
    sweep: int
    swing_m: float
    peak_to_peak_m: float
    vaf_percent: float
    vaf_parametric_percent: float
    mass_kg: Estimate
    damping_n_s_per_m: Estimate
    stiffness_n_per_m: Estimate
    frequency_hz: Array
    response_m_per_n: NDArray[np.complex128]

    @property
    def system(self) -> SecondOrder:
        """The second-order system."""
        return SecondOrder(self.mass_kg.value, self.damping_n_s_per_m.value, self.stiffness_n_per_m.value)


def held_record(held: Array, position: Array, sample_rate_hz: float, unit: str) -> Record:
    """Return a record of the input held over the interval before each reading (n,), and of the position (n,), m.

    Higher sample rates are reduced to ``RATE_HZ`` by averaging the input: the spring does not respond faster.

    Raises:
        UnusableInputError: no samples were received.
    """
    every = max(1, round(sample_rate_hz / RATE_HZ))
    count = position.size // every
    means = held[: count * every].reshape(count, every).mean(axis=1)
    last = position[: count * every].reshape(count, every)[:, -1]
    held_from = np.append(means[1:], np.nan)  # a record stores the value held from each reading on
    known = np.flatnonzero(np.isfinite(held_from) & np.isfinite(last))
    if not known.size:
        raise UnusableInputError(
            Message("sweep.all_lost", "all samples were lost: check the cable and repeat the sweep")
        )
    whole = slice(int(known[0]), int(known[-1]) + 1)  # drop the ends, which lack a neighbour
    return Record(held_from[whole], last[whole], sample_rate_hz / every, "held", "position", unit, "m")


def _positive_std(found: Estimate) -> Estimate:
    """Return an estimate with a positive standard deviation, which an inverted coil would make negative."""
    return found if found.std is None else Estimate(found.value, abs(found.std))


def identify_point(test: SweepTest, mean_current: Array, device: DeviceDescription) -> SpringPoint:
    """Identify one test; ``mean_current`` (n,) is the mean over the interval before each reading.

    A current reading belongs to the end of the interval in which a command was held; used directly, it biases the mass
    low by some per cent. The mean current of each interval is therefore held over it.

    Raises:
        UnusableInputError: nothing moved, or the record is too short.
    """
    record = held_record(device.force_constant_n_per_a * mean_current, test.position, test.sample_rate_hz, "N")
    rate = record.sample_rate_hz
    model = Lms(memory=MEMORY_S, hold="zero-order").fit(record)
    found = model.report.parameters
    frequency = np.geomspace(LOWEST_HZ, HIGHEST_HZ, _FREQUENCIES)
    # Frequency response to a force, compensated for the zero-order hold.
    turned = np.exp(-2j * np.pi * frequency[:, None] * (model.lag_s - 0.5 / rate))  # (frequencies, lags)
    turned /= np.sinc(frequency / rate)[:, None]
    return SpringPoint(
        position_m=test.mean_position_m,
        stage_m=test.stage_m,
        rest_m=test.rest_m,
        sweep=test.sweep,
        swing_m=test.swing_m,
        peak_to_peak_m=float(np.nanmax(test.position) - np.nanmin(test.position)),
        vaf_percent=model.report.vaf_percent,
        vaf_parametric_percent=model.second_order.vaf_percent,
        mass_kg=_positive_std(found["mass_kg"]),
        damping_n_s_per_m=_positive_std(found["damping_n_s_per_m"]),
        stiffness_n_per_m=_positive_std(found["stiffness_n_per_m"]),
        frequency_hz=frequency,
        response_m_per_n=turned @ model.impulse_response / rate,
    )
