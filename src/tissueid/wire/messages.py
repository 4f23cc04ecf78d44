"""Messages: the payload of each frame type as a packed little-endian structured dtype (docs/protocol.md, section 3)."""

from __future__ import annotations

from enum import IntEnum, IntFlag
from typing import Any

import numpy as np


class PayloadError(ValueError):
    """A payload does not have the length of its message."""


class MessageType(IntEnum):
    """Host to device below 0x80, device to host from 0x80 on."""

    HELLO = 0x01
    STREAM = 0x02
    STIMULUS_BEGIN = 0x10
    STIMULUS_CHUNK = 0x11
    STIMULUS_COMMIT = 0x12
    FOLLOW = 0x13
    SETPOINTS = 0x14
    ARM = 0x20
    START = 0x21
    STOP = 0x22
    RELEASE = 0x23
    CLEAR_FAULTS = 0x24
    FINISH = 0x25
    STAGE = 0x26
    HEARTBEAT = 0x30
    STATUS_REQUEST = 0x31
    HELLO_ACK = 0x81
    ACK = 0x82
    DATA = 0x83
    STATUS = 0x84


class State(IntEnum):
    """States of the firmware. The amplifier is enabled in RUNNING alone."""

    IDLE = 0
    LOADED = 1
    ARMED = 2
    RUNNING = 3
    FAULT = 4


class Result(IntEnum):
    """How a request ended."""

    OK = 0
    BAD_STATE = 1
    BAD_ARGUMENT = 2
    TOO_LARGE = 3
    CHECKSUM = 4
    FAULT_LATCHED = 5
    BEYOND_LIMITS = 6
    UNKNOWN = 7
    LATE = 8


class Fault(IntFlag):
    """Latched causes of a release. They stay until CLEAR_FAULTS, and the test must be armed again."""

    NONE = 0
    WATCHDOG = 1
    OVER_FORCE = 2
    STROKE = 4
    OVER_TEMPERATURE = 8
    OVER_TIME = 16
    BUTTON = 32
    STARVED = 64
    BROWN_OUT = 128
    """The supply sagged."""
    SENSOR = 256
    """The position does not move although the force does, or its converter is at its end."""
    OPEN_COIL = 512
    """The current does not follow the voltage."""


class Flag(IntFlag):
    """Bits that travel with every sample."""

    BUTTON = 1
    PLAYING = 2
    """The sample belongs to the stimulus."""
    ENERGISED = 4
    """The amplifier is enabled."""
    SATURATED = 8
    """At least one converter is at its end."""
    HELD = 16
    """The host's set-point was missing: the command is the firmware's own."""
    SOFT_START = 32
    """The command is the host's, faded in from zero."""
    LIMITED = 64
    """The command is the host's, lowered because the coil's motion would have raised the force beyond its limit."""


HELLO = np.dtype([("protocol_min", "u1"), ("protocol_max", "u1"), ("host", "S30")])

HELLO_ACK = np.dtype(
    [
        ("protocol_min", "u1"),
        ("protocol_max", "u1"),
        ("channels", "u1"),
        ("samples_per_frame", "u1"),
        ("boot_id", "<u4"),
        ("stimulus_capacity", "<u4"),
        ("firmware_version", "S16"),
        ("model", "S32"),
        ("serial_number", "S16"),
        ("sample_rate_hz", "<f8"),
        ("watchdog_s", "<f8"),
        ("coil_resistance_ohm", "<f8"),
        ("coil_inductance_h", "<f8"),
        ("force_constant_n_per_a", "<f8"),
        ("moving_mass_kg", "<f8"),
        ("bearing_damping_n_s_per_m", "<f8"),
        ("amplifier_gain", "<f8"),
        ("amplifier_limit_v", "<f8"),
        ("stroke_m", "<f8"),
        ("max_force_n", "<f8"),
        ("max_temperature_c", "<f8"),
    ]
)
"""Followed by ``channels`` records of CHANNEL, in the order of the fields of SAMPLE."""

CHANNEL = np.dtype([("name", "S16"), ("unit", "S8"), ("gain", "<f8"), ("offset", "<f8")])
"""Physical value = gain * code + offset."""

STREAM = np.dtype([("on", "u1")])
STIMULUS_BEGIN = np.dtype([("stimulus_id", "<u4"), ("samples", "<u4"), ("crc32", "<u4")])
STIMULUS_CHUNK = np.dtype([("stimulus_id", "<u4"), ("offset", "<u4")])
"""Followed by the codes, ``<i2`` each."""
STIMULUS_COMMIT = np.dtype([("stimulus_id", "<u4")])
FOLLOW = np.dtype([("stimulus_id", "<u4"), ("samples", "<u4"), ("hold_code", "<i2")])
SETPOINTS = np.dtype([("token", "<u4"), ("offset", "<u4")])
"""Followed by the codes, ``<i2`` each."""

ARM = np.dtype(
    [
        ("token", "<u4"),
        ("stimulus_id", "<u4"),
        ("max_force_n", "<f8"),
        ("min_position_m", "<f8"),
        ("max_position_m", "<f8"),
        ("max_temperature_c", "<f8"),
        ("max_samples", "<u4"),
    ]
)
START = np.dtype([("token", "<u4")])
STAGE = np.dtype([("position_m", "<f8")])
"""Where a motorised stage brings the fixture under the probe, m on the actuator; NaN: out of reach."""

ACK = np.dtype([("request_type", "u1"), ("result", "u1"), ("request_sequence", "<u2"), ("detail", "<u8")])

STATUS = np.dtype(
    [
        ("state", "u1"),
        ("streaming", "u1"),
        ("faults", "<u2"),
        ("boot_id", "<u4"),
        ("dropped_frames", "<u4"),
        ("refused_frames", "<u4"),
        ("played_samples", "<u4"),
    ]
)
STATUS_SETPOINTS = np.dtype([("late_blocks", "<u4"), ("held_samples", "<u4")])
"""Follows STATUS where the firmware takes set-points; an older one ends before it."""

SAMPLE = np.dtype(
    [
        ("command", "<i2"),
        ("voltage", "<i2"),
        ("current", "<i2"),
        ("position", "<i2"),
        ("temperature", "<i2"),
        ("acceleration_x", "<i2"),
        ("acceleration_y", "<i2"),
        ("flags", "<u2"),
    ]
)
"""DATA carries any number of these; the frame's sample index and time are those of the first."""


def pack(dtype: np.dtype, **fields: Any) -> bytes:
    """The bytes of one message; every field of ``dtype`` must be given."""
    record = np.zeros((), dtype)
    for name in dtype.names or ():
        record[name] = fields.pop(name)
    if fields:
        raise TypeError(f"no such fields: {', '.join(fields)}")
    return record.tobytes()


def unpack(dtype: np.dtype, payload: bytes, *, tail: bool = False) -> tuple[dict[str, Any], bytes]:
    """Read one message off the front of a payload: its fields, and the bytes that follow.

    Raises:
        PayloadError: too short, or too long where no tail is allowed.
    """
    if len(payload) < dtype.itemsize or (not tail and len(payload) > dtype.itemsize):
        raise PayloadError(f"{len(payload)} bytes where the message has {dtype.itemsize}")
    record = np.frombuffer(payload, dtype, count=1)[0]
    return {name: record[name].item() for name in dtype.names or ()}, payload[dtype.itemsize :]


def text(raw: bytes) -> str:
    """A fixed-width text field as a string; what is not printable ASCII becomes ``?``."""
    return "".join(chr(byte) if 32 <= byte < 127 else "?" for byte in raw.rstrip(b"\0"))
