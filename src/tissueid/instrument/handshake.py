"""Reading the handshake: who answers, whether it can be understood, and the scales of its channels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tissueid import wire
from tissueid.device import DeviceDescription
from tissueid.errors import InstrumentError, LimitError, ProtocolVersionError
from tissueid.instrument.interface import SIGNALS
from tissueid.instrument.limits import Limits


@dataclass(frozen=True)
class Introduction:
    """What a device said of itself: its figures, the scales of the channels in the order of SIGNALS, its boot id.

    ``max_force_n`` and ``max_temperature_c`` are as far as it ever goes, whatever limits it is asked for.
    """

    device: DeviceDescription
    gains: NDArray[np.float64]
    offsets: NDArray[np.float64]
    boot_id: int
    max_force_n: float
    max_temperature_c: float

    def narrowed(self, limits: Limits) -> Limits:
        """These limits, or the device's own where it goes less far."""
        return replace(
            limits,
            max_force_n=min(limits.max_force_n, self.max_force_n),
            max_temperature_c=min(limits.max_temperature_c, self.max_temperature_c),
        )

    def codes(self, command_v: NDArray[np.float64]) -> NDArray[np.int16]:
        """The converter's codes, shape (n,), of commands in V.

        Raises:
            LimitError: it has no codes for them.
        """
        codes = np.rint((np.asarray(command_v) - self.offsets[0]) / self.gains[0])
        if not np.all(np.abs(codes) <= 32767):
            raise LimitError("the stimulus goes beyond the range of the instrument's converter")
        data: NDArray[np.int16] = codes.astype("<i2")
        return data


_POSITIVE = (
    "coil_resistance_ohm",
    "force_constant_n_per_a",
    "moving_mass_kg",
    "amplifier_gain",
    "amplifier_limit_v",
    "stroke_m",
    "calibration_spring_n_per_m",
)
_NOT_NEGATIVE = ("coil_inductance_h", "bearing_damping_n_s_per_m", "calibration_relative_uncertainty")


def _possible(device: DeviceDescription) -> bool:
    """Whether all figures of a device are numbers, of the sign that they must have; calibrations are held to them."""
    figures = np.array([getattr(device, name) for name in (*_POSITIVE, *_NOT_NEGATIVE)])
    return bool(np.all(np.isfinite(figures)) and np.all(figures >= 0) and np.all(figures[: len(_POSITIVE)] > 0))


def read_hello(payload: bytes, name: str) -> Introduction:
    """A HELLO_ACK from the port called ``name``.

    Raises:
        ProtocolVersionError: it speaks other versions; says which side to update.
        InstrumentError: it is damaged, or cannot be true.
    """
    oldest, newest = payload[:2] if len(payload) >= 2 else (0, 0)
    if not oldest <= wire.PROTOCOL_VERSION <= newest:
        raise ProtocolVersionError(
            f"the instrument on {name} speaks protocol {oldest} to {newest}, "
            f"this software {wire.PROTOCOL_VERSION}: update the {'software' if oldest > 1 else 'firmware'}"
        )
    try:
        fields, table = wire.unpack(wire.HELLO_ACK, payload, tail=True)
        if len(table) != fields["channels"] * wire.CHANNEL.itemsize:
            raise wire.PayloadError("the channel table is cut short")
    except wire.PayloadError as error:
        raise InstrumentError(f"the handshake of {name} is damaged: {error}") from error
    channels = np.frombuffer(table, wire.CHANNEL)
    names = tuple(wire.text(channel) for channel in channels["name"])
    if names != SIGNALS or not np.all(np.isfinite(channels["gain"] + channels["offset"]) & (channels["gain"] != 0)):
        raise InstrumentError(f"{name} has other channels than this software knows: {names}")
    figures = {key: fields[key] for key in DeviceDescription.__dataclass_fields__ if key in fields}
    figures |= {key: wire.text(fields[key]) for key in ("model", "serial_number", "firmware_version")}
    device = DeviceDescription(**figures, protocol_version=str(wire.PROTOCOL_VERSION))
    if not 100 <= device.sample_rate_hz <= 100_000 or not _possible(device):
        raise InstrumentError(f"{name} reports impossible figures of itself")
    furthest = fields["max_force_n"], fields["max_temperature_c"]
    if not (np.all(np.isfinite(furthest)) and min(furthest) > 0):
        raise InstrumentError(f"{name} reports impossible limits of its own")
    gains, offsets = channels["gain"].astype(np.float64), channels["offset"].astype(np.float64)
    return Introduction(device, gains, offsets, fields["boot_id"], *furthest)
