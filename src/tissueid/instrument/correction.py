"""Corrections of recorded channels by a calibration: offset and gain of the readings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.device import DeviceDescription
from tissueid.errors import InstrumentError
from tissueid.messages import Message


@dataclass(frozen=True)
class Correction:
    """The reading of a channel is ``gain`` * true value + ``offset``.

    Raises:
        InstrumentError: the gain is not between 0.5 and 2, or the offset is not finite.
    """

    gain: float = 1.0
    offset: float = 0.0

    def __post_init__(self) -> None:
        if not (0.5 < self.gain < 2.0 and np.isfinite(self.offset)):
            raise InstrumentError(
                Message(
                    "calibration.implausible_correction",
                    "a channel cannot have a gain of {gain:g} and an offset of {offset:g}",
                    gain=self.gain,
                    offset=self.offset,
                )
            )


Corrections = Mapping[str, Correction]
"""Corrections by channel name. A channel without one needs no correction."""


def corrected(samples: NDArray[np.void], corrections: Corrections) -> NDArray[np.void]:
    """Return corrected samples, shape (k,) of SAMPLE; the argument is not changed."""
    if not corrections:
        return samples
    result = samples.copy()
    for name, correction in corrections.items():
        result[name] -= correction.offset
        result[name] /= correction.gain
    return result


def check_corrections(corrections: Corrections, channels: Sequence[str]) -> dict[str, Correction]:
    """Return a copy of the corrections.

    Raises:
        InstrumentError: a correction is not for one of the measured ``channels``.
    """
    for name in corrections:
        if name not in channels or name == "command":
            raise InstrumentError(
                Message("calibration.unknown_channel", "there is no channel {name} to correct", name=name)
            )
    return dict(corrections)


def checked_descriptions(nominal: DeviceDescription, device: DeviceDescription) -> tuple[DeviceDescription, ...]:
    """Return the descriptions for which limits must hold, so that a calibration never loosens a limit."""
    return (nominal,) if device is nominal else (nominal, device)
