"""Identity of the device in the handshake."""

from __future__ import annotations

from dataclasses import dataclass

from firmware_sim.converters import Channel
from firmware_sim.plant import PlantParameters
from tissueid import wire


@dataclass(frozen=True)
class Identity:
    """Identity of the device, its protocol versions, and its absolute limits."""

    model: str = "desktop indenter (simulated)"
    serial_number: str = "SIM-0001"
    firmware_version: str = "sim-1.1"
    protocol_min: int = wire.PROTOCOL_VERSION
    protocol_max: int = wire.PROTOCOL_VERSION
    max_force_n: float = 15.0
    max_temperature_c: float = 85.0
    stage: bool = True
    """Whether a motorised stage positions the fixture."""

    def speaks(self, protocol_min: int, protocol_max: int) -> bool:
        """Return whether the two sides have a common protocol version."""
        return protocol_min <= self.protocol_max and protocol_max >= self.protocol_min

    def hello_ack(
        self,
        coil: PlantParameters,
        channels: dict[str, Channel],
        *,
        boot_id: int,
        sample_rate_hz: float,
        samples_per_frame: int,
        stimulus_capacity: int,
        watchdog_s: float,
    ) -> bytes:
        """Return the payload of HELLO_ACK, including the channel table and the corner of the filters."""
        head = wire.pack(
            wire.HELLO_ACK,
            protocol_min=self.protocol_min,
            protocol_max=self.protocol_max,
            channels=len(channels),
            samples_per_frame=samples_per_frame,
            boot_id=boot_id,
            stimulus_capacity=stimulus_capacity,
            firmware_version=self.firmware_version.encode(),
            model=self.model.encode(),
            serial_number=self.serial_number.encode(),
            sample_rate_hz=sample_rate_hz,
            watchdog_s=watchdog_s,
            max_force_n=self.max_force_n,
            max_temperature_c=self.max_temperature_c,
            coil_resistance_ohm=coil.resistance_ohm,
            coil_inductance_h=coil.inductance_h,
            force_constant_n_per_a=coil.force_constant_n_per_a,
            moving_mass_kg=coil.moving_mass_kg,
            bearing_damping_n_s_per_m=coil.bearing_damping_n_s_per_m,
            amplifier_gain=coil.amplifier_gain,
            amplifier_limit_v=coil.amplifier_limit_v,
            stroke_m=coil.stroke_m,
        )
        table = b"".join(
            wire.pack(wire.CHANNEL, name=name.encode(), unit=c.unit.encode(), gain=c.gain, offset=c.offset)
            for name, c in channels.items()
        )
        return head + table + wire.pack(wire.HELLO_ACK_FILTER, filter_corner_hz=coil.filter_cutoff_hz)
