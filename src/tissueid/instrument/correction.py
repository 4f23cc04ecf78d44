"""Corrections of recorded channels by a calibration: what was read is scaled to what was there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.device import DeviceDescription
from tissueid.errors import InstrumentError


@dataclass(frozen=True)
class Correction:
    """A channel reads ``gain`` * truth + ``offset``.

    Raises:
        InstrumentError: the gain is not near one, or a figure is not finite.
    """

    gain: float = 1.0
    offset: float = 0.0

    def __post_init__(self) -> None:
        if not (0.5 < self.gain < 2.0 and np.isfinite(self.offset)):
            raise InstrumentError(f"a channel cannot have a gain of {self.gain:g} and an offset of {self.offset:g}")


Corrections = Mapping[str, Correction]
"""By the channel's name; channels that are missing are right as they are."""


def corrected(samples: NDArray[np.void], corrections: Corrections) -> NDArray[np.void]:
    """Samples, shape (k,) of SAMPLE, as the calibration in force reads them; the argument is left as it is."""
    if not corrections:
        return samples
    result = samples.copy()
    for name, correction in corrections.items():
        result[name] -= correction.offset
        result[name] /= correction.gain
    return result


def check_corrections(corrections: Corrections, channels: Sequence[str]) -> dict[str, Correction]:
    """A copy of the corrections of some of the recorded ``channels``.

    Raises:
        InstrumentError: one is for a channel that nothing is measured by.
    """
    for name in corrections:
        if name not in channels or name == "command":
            raise InstrumentError(f"there is no channel {name!r} to be corrected")
    return dict(corrections)


def most_cautious(nominal: DeviceDescription, device: DeviceDescription) -> tuple[DeviceDescription, ...]:
    """The descriptions by which limits are judged, one after the other: a calibration never loosens a limit."""
    return (nominal,) if device is nominal else (nominal, device)
