"""Electrical check of the coil: steady voltages, measured currents, a straight line (thesis 2.4.1, first step)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from tissueid.acquisition import play
from tissueid.errors import UnusableInputError
from tissueid.instrument import CLINICAL, Instrument, Limits
from tissueid.records import Estimate

LEVELS_V = (0.0, 3.0, 6.0, 9.0, 12.0)
"""Up to 3 N into the tissue: enough for the line, gentle on the skin."""
HOLD_S = 0.3
_SETTLED = 0.4
"""Part of each level, at its end, that is averaged: by then coil and tissue are at rest."""


@dataclass(frozen=True)
class ElectricalCheck:
    """Resistance and zero of the current channel, and how noisy the channels are at rest."""

    coil_resistance_ohm: Estimate
    current_offset_a: Estimate
    position_noise_m: float
    residual_a: float
    passed: bool
    date: str

    def as_calibration(self) -> dict[str, float | str]:
        """What a session carries as the calibration in force."""
        return {
            "kind": "electrical check",
            "date": self.date,
            "coil_resistance_ohm": self.coil_resistance_ohm.value,
            "coil_resistance_std_ohm": self.coil_resistance_ohm.std or 0.0,
            "current_offset_a": self.current_offset_a.value,
            "position_noise_m": self.position_noise_m,
            "verdict": "passed" if self.passed else "failed",
        }


def check_coil(
    instrument: Instrument,
    limits: Limits = CLINICAL,
    *,
    tolerance: float = 0.05,
    progress: Callable[[float], None] = lambda _: None,
    cancelled: Callable[[], bool] = lambda: False,
) -> ElectricalCheck:
    """Hold five voltages, fit current against measured voltage, and compare the slope with the nominal resistance.

    It passes when the resistance lies within ``tolerance`` of the nominal one.

    Raises:
        UnusableInputError: a level has no samples, or the current does not follow the voltage (open coil).
    """
    device = instrument.device
    hold = round(HOLD_S * device.sample_rate_hz)
    blocks: list[NDArray[np.void]] = []

    def take(samples: NDArray[np.void], fraction: float) -> None:
        blocks.append(samples)
        progress(fraction)

    play(instrument, np.repeat(LEVELS_V, hold), limits, on_samples=take, cancelled=cancelled)
    samples = np.concatenate(blocks)
    level = (samples["index"] - samples["index"][0]) // hold
    late = (samples["index"] - samples["index"][0]) % hold >= hold * (1 - _SETTLED)
    late &= np.isfinite(samples["voltage"]) & np.isfinite(samples["current"]) & np.isfinite(samples["position"])
    means = []
    for number in range(len(LEVELS_V)):
        chosen = samples[late & (level == number)]
        if chosen.size < 10:
            raise UnusableInputError("samples were lost during the electrical check; repeat it")
        means.append((chosen["voltage"].mean(), chosen["current"].mean()))
    volts, amperes = np.array(means).T
    line = stats.linregress(volts, amperes)
    if line.slope * device.coil_resistance_ohm < 0.1:
        raise UnusableInputError("no current flows through the coil: check that it is connected")
    resistance = Estimate(float(1.0 / line.slope), float(line.stderr / line.slope**2))
    at_rest = samples[late & (level == 0)]["position"]
    return ElectricalCheck(
        coil_resistance_ohm=resistance,
        current_offset_a=Estimate(float(line.intercept), float(line.intercept_stderr)),
        position_noise_m=float(np.std(np.diff(at_rest)) / np.sqrt(2.0)),
        residual_a=float(np.std(amperes - line.slope * volts - line.intercept)),
        passed=bool(abs(resistance.value / device.coil_resistance_ohm - 1.0) <= tolerance),
        date=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
    )
