"""Description of an instrument: the properties in the ``/instrument`` attributes of a session."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from tissueid.language import marked
from tissueid.messages import Action, Message, message_from
from tissueid.untrusted_input import StoredName, StoredText, StoredValue, json_value

GRAVITY_M_S2 = 9.80665

SIMULATED_SERIAL = "TWIN-"
"""Prefix of the serial number of an instrument that the twin simulates."""

SIMULATED_LINE = marked("Simulated instrument: not a measurement of a person.")
"""Remark on every page of a session that a simulation recorded."""


_BETWEEN = "; "
"""Separator of calibration warnings in one text; no warning contains it."""
_MOST_WARNINGS = 50
"""Largest number of warnings that are kept as messages."""
CALIBRATE_STATIC = Action(
    "calibrate.static", "tissueid calibrate static", marked("the static calibration on the page Measure")
)
CALIBRATE_SWEEP = Action("calibrate.sweep", "tissueid calibrate sweep", marked("the sweep on the page Measure"))


@dataclass(frozen=True)
class DeviceDescription:
    """Nominal properties of an indenter, SI. Defaults: desktop research device (Chen 2010, 2.2.1)."""

    model: StoredText = "desktop indenter"
    serial_number: StoredText = "unknown"
    coil_resistance_ohm: float = 12.0
    coil_inductance_h: float = 1.00e-3
    force_constant_n_per_a: float = 3.0
    moving_mass_kg: float = 0.060
    bearing_damping_n_s_per_m: float = 3.5
    amplifier_gain: float = 1.0
    amplifier_limit_v: float = 48.0
    stroke_m: float = 0.032
    sample_rate_hz: float = 2000.0
    filter_corner_hz: float = 0.0
    """Corner of the first-order anti-alias filter of every channel; 0 where there is none or it is unknown."""
    calibration_spring_n_per_m: float = 1000.0
    calibration_relative_uncertainty: float = 0.02
    firmware_version: StoredText = ""
    protocol_version: StoredText = ""
    calibration: dict[StoredName, StoredValue] = field(default_factory=dict)

    @property
    def filter_time_s(self) -> float:
        """Time constant of the anti-alias filters; 0 where there are none or they are unknown."""
        return 0.5 / (math.pi * self.filter_corner_hz) if self.filter_corner_hz > 0.0 else 0.0

    @property
    def simulated(self) -> bool:
        """Whether the instrument is a simulation, by its model or serial number."""
        return "simulat" in self.model.lower() or self.serial_number.startswith(SIMULATED_SERIAL)

    @property
    def calibration_warnings(self) -> tuple[str, ...]:
        """Warnings about the calibration in force; messages where the calibration keeps them as such."""
        messages: dict[str, Message] = {}
        try:
            stored = json_value(str(self.calibration.get("warning_messages", "[]")))
        except ValueError:
            stored = []
        for item in stored[:_MOST_WARNINGS] if isinstance(stored, list) else ():
            if isinstance(message := message_from(item), Message):
                messages[_separable(message)] = message
        texts = str(self.calibration.get("warnings") or "").split(_BETWEEN)
        return tuple(messages.get(text, text) for text in texts if text)

    def voltage_for_force(self, force_n: float) -> float:
        """Return the voltage for a steady coil force without motion: V = F R / (force constant * gain)."""
        return force_n * self.coil_resistance_ohm / (self.force_constant_n_per_a * self.amplifier_gain)

    @property
    def greatest_force_n(self) -> float:
        """Greatest steady coil force that the amplifier can hold, N, rounded down to 0.1 N."""
        most = self.amplifier_limit_v / (self.voltage_for_force(1.0) * max(1.0, self.amplifier_gain))
        return math.floor(10.0 * most) / 10.0

    def weight_n(self, gravity_along_stroke_m_s2: float = GRAVITY_M_S2) -> float:
        """Return the weight of the moving part along the stroke, N into the tissue; default: pointing straight down."""
        return self.moving_mass_kg * gravity_along_stroke_m_s2


DESKTOP = DeviceDescription()
"""The desktop research device (thesis 2.2.1)."""

_WIRE = 9.5 / DESKTOP.coil_resistance_ohm
"""Ratio of the wire lengths of handheld and desktop coil, by their resistances; the gage is the same."""

HANDHELD = DeviceDescription(
    model="handheld indenter",
    coil_resistance_ohm=9.5,
    coil_inductance_h=DESKTOP.coil_inductance_h * _WIRE**2,
    force_constant_n_per_a=DESKTOP.force_constant_n_per_a * 0.35 / 0.53 * _WIRE,
    moving_mass_kg=0.0395,
)
"""The handheld device (thesis 2.2.2: 9.5 ohm, 0.35 T, 39.5 g of 256 g, 32 mm).

Force constant and inductance are not given there and are scaled from the desktop coil: the force constant with field
and length of wire, the inductance with the square of the number of turns. A calibration corrects them.
"""


def warning_entries(warnings: Sequence[str]) -> dict[str, str]:
    """Return warnings as entries of ``DeviceDescription.calibration``: as text, and as JSON of the messages."""
    messages = [warning.as_dict() for warning in warnings if isinstance(warning, Message)]
    entries = {"warnings": _BETWEEN.join(map(_separable, warnings))}
    return entries | ({"warning_messages": json.dumps(messages[:_MOST_WARNINGS])} if messages else {})


def _separable(warning: str) -> str:
    return str(warning).replace(_BETWEEN, ", ")


def angle_deg(a: tuple[float, float], b: tuple[float, float]) -> float:
    """Return the angle between two vectors in a plane, 0 to 180 degrees; 0 if one has zero length."""
    length = math.hypot(*a) * math.hypot(*b)
    if length == 0.0:
        return 0.0
    return math.degrees(math.acos(max(-1.0, min(1.0, (a[0] * b[0] + a[1] * b[1]) / length))))
