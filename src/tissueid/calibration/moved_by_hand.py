"""Waiting for a person to bring the spring to a place: seen by where the probe stands, so that both hands are free."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tissueid.acquisition.playing import POLL_S, never
from tissueid.errors import CancelledError
from tissueid.instrument import Instrument

NEAR_M = 0.5e-3
"""As near as this to the place is there: what counts is where the probe stands, and that is measured."""
STILL_M = 20e-6
"""Standard deviation of the position under which nothing moves."""
STILL_S = 1.0


@dataclass(frozen=True)
class Standing:
    """Where the probe stands, and whether it is where it should be."""

    position_m: float
    there: bool


def wait_until_there(
    instrument: Instrument,
    place_m: float,
    tell: Callable[[Standing], None] = lambda _: None,
    cancelled: Callable[[], bool] = never,
) -> None:
    """Return when the probe has stood still at a place for a second; ``tell`` hears of every reading meanwhile.

    Raises:
        CancelledError: ``cancelled`` said so.
        InstrumentError: as ``poll`` says.
    """
    wanted = round(STILL_S * instrument.device.sample_rate_hz)
    recent = np.zeros(0)
    while True:
        if cancelled():
            raise CancelledError("cancelled; the coil is free")
        read = instrument.poll(POLL_S)["position"]
        recent = np.concatenate([recent, read[np.isfinite(read)]])[-wanted:]
        if not recent.size:
            continue
        standing = Standing(float(recent[-1]), bool(abs(float(recent[-1]) - place_m) <= NEAR_M))
        tell(standing)
        if standing.there and recent.size == wanted and float(recent.std()) <= STILL_M:
            return
