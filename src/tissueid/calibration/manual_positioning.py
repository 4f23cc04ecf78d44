"""Manual positioning of the calibration spring: wait until the probe stands still at the wanted position."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tissueid.acquisition.playback import POLL_S, never
from tissueid.errors import CancelledError
from tissueid.instrument import Instrument
from tissueid.messages import Message

NEAR_M = 0.5e-3
"""Tolerance of the position, m: the measured position is used, so it need not be exact."""
STILL_M = 20e-6
"""Standard deviation of the position, m, below which the probe stands still."""
STILL_S = 1.0
"""Time for which the probe must stand still, s."""


@dataclass(frozen=True)
class Standing:
    """Position of the probe, and whether it is within the tolerance of the wanted position."""

    position_m: float
    there: bool


def wait_until_there(
    instrument: Instrument,
    place_m: float,
    tell: Callable[[Standing], None] = lambda _: None,
    cancelled: Callable[[], bool] = never,
) -> None:
    """Wait until the probe has stood still at a position for ``STILL_S``; call ``tell`` for each reading.

    Raises:
        CancelledError: ``cancelled`` returned true.
        InstrumentError: as ``poll`` says.
    """
    wanted = round(STILL_S * instrument.device.sample_rate_hz)
    recent = np.zeros(0)
    while True:
        if cancelled():
            raise CancelledError(Message("cancelled.coil_free", "cancelled; the coil is free"))
        read = instrument.poll(POLL_S)["position"]
        recent = np.concatenate([recent, read[np.isfinite(read)]])[-wanted:]
        if not recent.size:
            continue
        standing = Standing(float(recent[-1]), bool(abs(float(recent[-1]) - place_m) <= NEAR_M))
        tell(standing)
        if standing.there and recent.size == wanted and float(recent.std()) <= STILL_M:
            return
