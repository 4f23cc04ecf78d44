"""Manual positioning of the calibration spring: waits until the probe is at rest at the requested position."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tissueid.acquisition.playback import POLL_S, never_stop
from tissueid.errors import CancelledError
from tissueid.instrument import Instrument
from tissueid.messages import Message

POSITION_TOLERANCE_M = 0.5e-3
"""Tolerance of the position, m; later steps use the measured position."""
STILL_M = 20e-6
"""Standard deviation of the position, m, below which the probe counts as at rest."""
STILL_S = 1.0
"""Time for which the probe must be at rest, s."""


@dataclass(frozen=True)
class ProbePosition:
    """Current position of the probe, and whether it is within the tolerance."""

    position_m: float
    in_place: bool


def wait_for_position(
    instrument: Instrument,
    place_m: float,
    tell: Callable[[ProbePosition], None] = lambda _: None,
    cancelled: Callable[[], bool] = never_stop,
) -> None:
    """Wait until the probe has been at rest at a position for ``STILL_S``; call ``tell`` for each reading.

    Raises:
        CancelledError: ``cancelled`` returned True.
        InstrumentError: see ``poll``.
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
        standing = ProbePosition(float(recent[-1]), bool(abs(float(recent[-1]) - place_m) <= POSITION_TOLERANCE_M))
        tell(standing)
        if standing.in_place and recent.size == wanted and float(recent.std()) <= STILL_M:
            return
