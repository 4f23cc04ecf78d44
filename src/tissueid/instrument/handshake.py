"""Reading the handshake: who answers, whether it can be understood, and the scales of its channels."""

from __future__ import annotations

from collections.abc import Mapping
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

    ``max_force_n`` and ``max_temperature_c`` are as far as it ever goes, whatever limits it is asked for. Without a
    heartbeat its watchdog releases the coil within ``watchdog_s``.
    """

    device: DeviceDescription
    gains: NDArray[np.float64]
    offsets: NDArray[np.float64]
    boot_id: int
    max_force_n: float
    max_temperature_c: float
    watchdog_s: float

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


RANGES = {
    "samples_per_frame": (1.0, 128.0),
    "stimulus_capacity": (1.0, 2.0**32),
    "sample_rate_hz": (100.0, 100_000.0),
    "watchdog_s": (0.2, 1.0),
    "coil_resistance_ohm": (0.5, 1000.0),
    "coil_inductance_h": (0.0, 0.1),
    "force_constant_n_per_a": (0.05, 100.0),
    "moving_mass_kg": (0.001, 2.0),
    "bearing_damping_n_s_per_m": (0.0, 1000.0),
    "amplifier_gain": (0.01, 100.0),
    "amplifier_limit_v": (1.0, 120.0),
    "stroke_m": (0.001, 0.5),
    "max_force_n": (0.1, 100.0),
    "max_temperature_c": (30.0, 150.0),
}
"""Between which values every figure of a device lies that this software drives (docs/protocol.md, 4.1)."""

SPANS = {
    "command": (1.0, 1000.0),
    "voltage": (1.0, 1000.0),
    "current": (0.1, 1000.0),
    "position": (0.001, 1.0),
    "temperature": (10.0, 2000.0),
    "acceleration_x": (1.0, 10_000.0),
    "acceleration_y": (1.0, 10_000.0),
}
"""How far the codes of each channel reach from end to end, in its unit; its gain is positive."""
_CODES = 65536
_LISTED = 8


def _impossible(figures: Mapping[str, float], ranges: Mapping[str, tuple[float, float]]) -> str:
    """Which figure cannot be, in words; "" where all can."""
    for name, (low, high) in ranges.items():
        if not low <= figures[name] <= high:  # so that nothing is in the range of a NaN
            return f"{name} is {figures[name]:.4g}, not {low:g} to {high:g}"
    return ""


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
    if names != SIGNALS:
        listed = ", ".join(names[:_LISTED]) + (", ..." if len(names) > _LISTED else "")
        raise InstrumentError(f"{name} has other channels than this software knows: {listed}")
    gains, offsets = channels["gain"].astype(np.float64), channels["offset"].astype(np.float64)
    spans = {signal: _CODES * float(gain) for signal, gain in zip(SIGNALS, gains, strict=True)}
    odd = _impossible(fields, RANGES)
    if scale := _impossible(spans, SPANS):
        odd = odd or f"from end to end {scale}"
    for signal, offset in zip(SIGNALS, offsets, strict=True):
        if not odd and not abs(offset) <= spans[signal]:
            odd = f"the offset of {signal} is {offset:.4g}, which its codes do not reach"
    if odd:
        raise InstrumentError(f"{name} reports impossible figures of itself: {odd}. Update its firmware")
    figures = {key: fields[key] for key in DeviceDescription.__dataclass_fields__ if key in fields}
    figures |= {key: wire.text(fields[key]) for key in ("model", "serial_number", "firmware_version")}
    device = DeviceDescription(**figures, protocol_version=str(wire.PROTOCOL_VERSION))
    own = {key: fields[key] for key in ("boot_id", "max_force_n", "max_temperature_c", "watchdog_s")}
    return Introduction(device, gains, offsets, **own)
