"""The handshake: version, properties and channel scales of a device, checked for plausibility."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import tissueid.wire as wire
from tissueid.device import DeviceDescription
from tissueid.errors import InstrumentError, LimitError, ProtocolVersionError
from tissueid.instrument.interface import SIGNALS
from tissueid.instrument.limits import FORCE_MARGIN, GENTLE_FORCE_N, Limits
from tissueid.messages import Message, joined


@dataclass(frozen=True)
class Handshake:
    """What a device reports in its HELLO_ACK.

    ``gains`` and ``offsets``, shape (7,), convert codes to SI units in the order of SIGNALS. ``max_force_n`` and
    ``max_temperature_c`` are fixed limits of the device, whatever limits a test sets. Without a heartbeat its watchdog
    releases the coil within ``watchdog_s``. ``boot_id`` changes at every restart.
    """

    device: DeviceDescription
    gains: NDArray[np.float64]
    offsets: NDArray[np.float64]
    boot_id: int
    max_force_n: float
    max_temperature_c: float
    watchdog_s: float

    def effective_limits(self, limits: Limits) -> Limits:
        """Return ``limits``, reduced to the fixed limits of the device and to what its converters can read beyond.

        A limit at the end of a converter would never be exceeded. Up to ``GENTLE_FORCE_N`` a position may be there.
        """
        ends = np.array([[-32767.0], [32766.0]]) * self.gains + self.offsets  # one code within the range
        lowest, highest = (dict(zip(SIGNALS, map(float, row), strict=True)) for row in ends)
        largest_n = min(-lowest["current"], highest["current"]) * self.device.force_constant_n_per_a
        force_n = min(limits.max_force_n, self.max_force_n, largest_n / FORCE_MARGIN)
        gentle = force_n <= GENTLE_FORCE_N
        return replace(
            limits,
            max_force_n=force_n,
            min_position_m=limits.min_position_m if gentle else max(limits.min_position_m, lowest["position"]),
            max_position_m=limits.max_position_m if gentle else min(limits.max_position_m, highest["position"]),
            max_temperature_c=min(limits.max_temperature_c, self.max_temperature_c, highest["temperature"]),
        )

    def codes(self, command_v: NDArray[np.float64]) -> NDArray[np.int16]:
        """Return the converter codes, shape (n,), of commands in V.

        Raises:
            LimitError: a command is outside the range of the converter.
        """
        codes = np.rint((np.asarray(command_v) - self.offsets[0]) / self.gains[0])
        if not np.all(np.abs(codes) <= 32767):
            raise LimitError("limit.converter", "the stimulus exceeds the range of the instrument's output converter")
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
    "filter_corner_hz": (0.0, 1e6),
    "max_force_n": (0.1, 100.0),
    "max_temperature_c": (30.0, 150.0),
}
"""Lowest and highest plausible value of each property of a supported device (docs/protocol.md, 4.1), SI."""

SPANS = {
    "command": (1.0, 1000.0),
    "voltage": (1.0, 1000.0),
    "current": (0.1, 1000.0),
    "position": (0.001, 1.0),
    "temperature": (10.0, 2000.0),
    "acceleration_x": (1.0, 10_000.0),
    "acceleration_y": (1.0, 10_000.0),
}
"""Smallest and largest plausible span of each channel over all of its codes, in its unit; gains are positive."""
_CODES = 65536
_SHOWN_CHANNELS = 8


def _out_of_range(values: Mapping[str, float], ranges: Mapping[str, tuple[float, float]]) -> tuple[Any, ...] | None:
    """Return name, value, low and high of the first value outside its range; None where all are inside."""
    for name, (low, high) in ranges.items():
        if not low <= values[name] <= high:  # true for NaN
            return name, values[name], low, high
    return None


def implausible_property(properties: Mapping[str, Any]) -> Message | None:
    """Return the first value outside its range as a message; None if all properties in ``RANGES`` are plausible."""
    if odd := _out_of_range(properties, {name: RANGES[name] for name in RANGES if name in properties}):
        name, value, low, high = odd
        return Message(
            "handshake.value",
            "{name} is {value:.4g}, not {low:g} to {high:g}",
            name=name,
            value=value,
            low=low,
            high=high,
        )
    return None


def _problem(fields: Mapping[str, Any], spans: Mapping[str, float], offsets: NDArray[np.float64]) -> Message | None:
    """Return the first implausible value of a HELLO_ACK as a message."""
    if problem := implausible_property(fields):
        return problem
    if odd := _out_of_range(spans, SPANS):
        name, value, low, high = odd
        return Message(
            "handshake.span",
            "from end to end {name} is {value:.4g}, not {low:g} to {high:g}",
            name=name,
            value=value,
            low=low,
            high=high,
        )
    for name, offset in zip(SIGNALS, offsets, strict=True):
        if not abs(offset) <= spans[name]:
            return Message(
                "handshake.offset",
                "the offset of {name} is {value:.4g}, which is outside the range of its codes",
                name=name,
                value=offset,
            )
    return None


def parse_hello(payload: bytes, port: str) -> Handshake:
    """Parse the payload of a HELLO_ACK that arrived on ``port``.

    Raises:
        ProtocolVersionError: the versions do not overlap; the message says which side to update.
        InstrumentError: the payload is damaged, or a value is implausible.
    """
    oldest, newest = payload[:2] if len(payload) >= 2 else (0, 0)
    if not oldest <= wire.PROTOCOL_VERSION <= newest:
        versions = {"port": port, "oldest": oldest, "newest": newest, "own": wire.PROTOCOL_VERSION}
        if oldest > wire.PROTOCOL_VERSION:
            message = Message(
                "handshake.software_too_old",
                "the instrument on {port} speaks protocol {oldest} to {newest}, this software {own}: "
                "update the software",
                **versions,
            )
        else:
            message = Message(
                "handshake.firmware_too_old",
                "the instrument on {port} speaks protocol {oldest} to {newest}, this software {own}: "
                "update the firmware",
                **versions,
            )
        raise ProtocolVersionError(message)
    try:
        fields, table = wire.unpack(wire.HELLO_ACK, payload, tail=True)
        size = fields["channels"] * wire.CHANNEL.itemsize
        if len(table) < size:
            raise wire.PayloadError(f"the channel table has {len(table)} bytes, not {size}")
        table, rest = table[:size], table[size:]
        fields["filter_corner_hz"] = 0.0
        if len(rest) >= wire.HELLO_ACK_FILTER.itemsize:
            fields |= wire.unpack(wire.HELLO_ACK_FILTER, rest, tail=True)[0]
    except wire.PayloadError as error:
        raise InstrumentError(
            "handshake.damaged", "the handshake of {port} is damaged: {why}", port=port, why=str(error)
        ) from error
    channels = np.frombuffer(table, wire.CHANNEL)
    names = tuple(wire.text(channel) for channel in channels["name"])
    if names != SIGNALS:
        shown = joined([*names[:_SHOWN_CHANNELS], *(["..."] if len(names) > _SHOWN_CHANNELS else [])])
        raise InstrumentError("handshake.channels", "{port} has unknown channels: {names}", port=port, names=shown)
    gains, offsets = channels["gain"].astype(np.float64), channels["offset"].astype(np.float64)
    spans = {signal: _CODES * float(gain) for signal, gain in zip(SIGNALS, gains, strict=True)}
    if (problem := _problem(fields, spans, offsets)) is not None:
        raise InstrumentError(
            "handshake.impossible",
            "{port} reports an impossible value: {problem}. Update its firmware",
            port=port,
            problem=problem,
        )
    properties = {key: fields[key] for key in DeviceDescription.__dataclass_fields__ if key in fields}
    properties |= {key: wire.text(fields[key]) for key in ("model", "serial_number", "firmware_version")}
    device = DeviceDescription(**properties, protocol_version=str(wire.PROTOCOL_VERSION))
    own = {key: fields[key] for key in ("boot_id", "max_force_n", "max_temperature_c", "watchdog_s")}
    return Handshake(device, gains, offsets, **own)
