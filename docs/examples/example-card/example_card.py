"""Example of a driver for an analogue card: ``example://`` is a coil on a spring, calculated instead of measured.

Replace ``exchange`` by the calls of your card, and ``disable`` by the line that switches the amplifier off.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.device import DeviceDescription

STIFFNESS_N_PER_M = 1500.0
DAMPING_N_S_PER_M = 6.0
SURFACE_M = 0.010
GRAVITY_N = 0.6
SUBSTEPS = 10


class ExampleCard:
    """A coil of 12 ohm and 3 N/A that presses 60 g against a spring with a damper."""

    def __init__(self) -> None:
        self.device = DeviceDescription(
            model="example card (simulated)", serial_number="CARD-1", firmware_version="1.0"
        )
        self.pressed = False
        self._random = np.random.default_rng(1)
        self._position_m = SURFACE_M + GRAVITY_N / STIFFNESS_N_PER_M
        self._speed_m_per_s = 0.0

    def exchange(self, command_v: NDArray[np.float64], enabled: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Return the readings of (k, 6) samples. A card returns when its hardware has timed them."""
        rows = []
        for volts, on in zip(command_v, enabled, strict=True):
            applied = float(volts) if on else 0.0
            current = self._step(applied)
            rows.append((applied, current, self._position_m, 25.0, 9.81, 0.0))
        noise = np.array((2e-3, 3e-4, 5e-7, 0.02, 0.05, 0.05))  # the standard deviation of each sensor
        return np.array(rows) + noise * self._random.standard_normal((len(rows), 6))

    def _step(self, volts: float) -> float:
        """Move by one sample, and return the current, A."""
        device = self.device
        dt = 1.0 / device.sample_rate_hz / SUBSTEPS
        current = 0.0
        for _ in range(SUBSTEPS):
            current = (volts - device.force_constant_n_per_a * self._speed_m_per_s) / device.coil_resistance_ohm
            depth = self._position_m - SURFACE_M
            tissue = max(0.0, STIFFNESS_N_PER_M * depth + DAMPING_N_S_PER_M * self._speed_m_per_s) if depth > 0 else 0.0
            force = device.force_constant_n_per_a * current + GRAVITY_N - tissue
            force -= device.bearing_damping_n_s_per_m * self._speed_m_per_s
            self._speed_m_per_s += force / device.moving_mass_kg * dt
            self._position_m += self._speed_m_per_s * dt
        return current

    def button(self) -> bool:
        """Return whether the button is pressed; read it from a digital input on which a broken wire reads pressed."""
        return self.pressed

    def disable(self) -> None:
        """Switch the amplifier off: on a card, clear the digital output that enables it."""

    def close(self) -> None:
        """Switch the amplifier off and close the card."""
        self.disable()


def open_card(url: str) -> ExampleCard:
    """Open the card at an address such as ``example://``. The rest of the address is yours: a slot, a serial number."""
    if url.removeprefix("example://"):
        raise ValueError(f"{url} names no card: write example://")
    return ExampleCard()
