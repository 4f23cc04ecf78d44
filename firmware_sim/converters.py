"""Analogue front end: channel scales, 16-bit conversion, saturation and white sensor noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_sim.plant import STANDARD_GRAVITY

CODE_MIN, CODE_MAX = -32768, 32767


@dataclass(frozen=True)
class Channel:
    """One converted quantity: physical = gain * code + offset.

    ``noise_rms`` is white Gaussian noise ahead of the converter, in ``unit``.
    """

    name: str
    unit: str
    gain: float
    offset: float
    noise_rms: float

    def encode(self, physical: NDArray[np.float64]) -> tuple[NDArray[np.int16], NDArray[np.bool_]]:
        """Return the nearest codes and the saturation mask; both in the shape of ``physical``."""
        return _encoded(physical, self.gain, self.offset)

    def decode(self, codes: NDArray[np.int16]) -> NDArray[np.float64]:
        """Return the physical values of codes, in ``unit``."""
        return self.gain * codes.astype(np.float64) + self.offset


def _encoded(
    physical: NDArray[np.float64], gain: NDArray[np.float64] | float, offset: NDArray[np.float64] | float
) -> tuple[NDArray[np.int16], NDArray[np.bool_]]:
    codes = np.rint((physical - offset) / gain)
    saturated = (codes < CODE_MIN) | (codes > CODE_MAX)
    if saturated.any():
        codes = codes.clip(CODE_MIN, CODE_MAX)
    return codes.astype(np.int16), saturated


def _bipolar(name: str, unit: str, full_scale: float, noise_rms: float) -> Channel:
    return Channel(name, unit, full_scale / 32768.0, 0.0, noise_rms)


CHANNELS = (
    # The command is the input of the digital-to-analogue converter: quantized but without noise.
    _bipolar("command", "V", 60.0, 0.0),
    # Fig. 3.2a: the voltage falls 8 decades of power to its floor. 12 V rms over 200 Hz gives 2.7 mV over 1 kHz.
    _bipolar("voltage", "V", 60.0, 2.7e-3),
    # Fig. 3.2a: the force falls about 4 decades. 3 N rms over 200 Hz gives some 40 mN over 1 kHz at 4.4 decades.
    _bipolar("current", "A", 6.0, 13e-3),
    # 2.2.1: 0.5 um per code. Fig. 3.2a: about 6 decades from DC to the floor.
    Channel("position", "m", 0.5e-6, 0.016384, 1.0e-6),
    # 2.2.1: platinum film RTD in a bridge. Chosen: 0.05 K of noise, range -25 to 225 degC.
    Channel("temperature", "degC", 250.0 / 65536.0, 100.0, 0.05),
    # 2.3: ADXL-322, +-2 g; its data sheet gives 220 ug per root hertz, 7 mg over 1 kHz.
    _bipolar("accelerometer_x", "m/s^2", 2.2 * STANDARD_GRAVITY, 0.07),
    _bipolar("accelerometer_y", "m/s^2", 2.2 * STANDARD_GRAVITY, 0.07),
)
"""Channels in the order of the columns of a block and of the bits of its flags."""


@dataclass(frozen=True)
class ChannelError:
    """Error of a channel's scale against the announced one: reading = (1 + gain error) * truth + offset.

    For the command, the output has the error: volts = (1 + gain error) * command + offset.
    """

    gain_error: float = 0.0
    offset: float = 0.0


class Converters:
    """Conversion of analogue values to codes, with sensor noise.

    The noise is the same for the same seed and any division into blocks. It is added per conversion: its level does not
    depend on the sample rate.

    Raises:
        ValueError: an error is given for a channel that does not exist.
    """

    def __init__(
        self,
        seed: int,
        channels: tuple[Channel, ...] = CHANNELS,
        errors: Mapping[str, ChannelError] | None = None,
    ) -> None:
        self.channels = channels
        names = [channel.name for channel in channels]
        for name in errors or {}:
            if name not in names:
                raise ValueError(f"no channel {name!r}; there are: {', '.join(names)}")
        found = [(errors or {}).get(name, ChannelError()) for name in names]
        self.scale = 1.0 + np.array([error.gain_error for error in found])
        self._offset = np.array([error.offset for error in found])
        self._noise_rms = np.array([channel.noise_rms for channel in channels])
        self._gains = np.array([channel.gain for channel in channels])
        self._zeros = np.array([channel.offset for channel in channels])
        self._bits = np.array([1 << k for k in range(len(channels))], dtype=np.uint16)
        self._random = np.random.default_rng(seed)

    def restart_noise(self, seed: Sequence[int]) -> None:
        """Restart the noise from a seed."""
        self._random = np.random.default_rng(seed)

    @property
    def noise_state(self) -> dict[str, Any]:
        """State of the noise generator."""
        return dict(self._random.bit_generator.state)

    @noise_state.setter
    def noise_state(self, state: dict[str, Any]) -> None:
        self._random.bit_generator.state = state

    def drive(self, volts: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int16], NDArray[np.bool_]]:
        """Return the output of the digital-to-analogue converter: volts, codes, saturation; each of shape (n,)."""
        channel = self.channels[0]
        codes, saturated = channel.encode(volts)
        return self.scale[0] * channel.decode(codes) + self._offset[0], codes, saturated

    def read(self, physical: NDArray[np.float64]) -> tuple[NDArray[np.int16], NDArray[np.uint16]]:
        """Return noisy codes, shape (n, channels), and saturation flags, shape (n,), bit k for channel k."""
        noisy = self.scale * physical + self._offset + self._noise_rms * self._random.standard_normal(physical.shape)
        codes, saturated = _encoded(noisy, self._gains, self._zeros)
        return codes, saturated @ self._bits
