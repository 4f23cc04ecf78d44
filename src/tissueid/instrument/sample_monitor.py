"""Checks of the host on all samples of an instrument: limits, plausibility and calculated coil temperature."""

from __future__ import annotations

from collections import deque
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from tissueid.device import DeviceDescription
from tissueid.errors import InstrumentError, LimitError
from tissueid.instrument.interface import Run
from tissueid.instrument.limits import LIFT_S, Limits, check_samples, coil_too_hot
from tissueid.instrument.thermal import PLAUSIBLE_C, WindingTemperature
from tissueid.messages import Message

BLOCK_S = 0.01
"""Length of a block, s."""

POSITION_BLOCKS = 10
"""Blocks over which position and force are compared."""
FROZEN_SWING_N = 0.3
"""Change of force over 100 ms, N, above which the reading of an intact position sensor is not constant."""

STILL_SWING_N, STILL_M = 3.0, 6.0e-6
"""Change of force over 100 ms, N, that moves an intact probe by more than the second value, m."""

JUMP_M_PER_S = 10.0
"""Impossible speed between two samples, m/s: more than twice the maximum at full force over the whole stroke."""

COIL_BLOCKS = 2
OPEN_VOLTS, OPEN_SHARE = 2.0, 0.15
"""The coil is open if, over 20 ms at this voltage or more, the current is below this share of voltage / resistance."""

CURRENT_BLOCKS, CURRENT_SWING_V = 5, 1.0
"""The current sensor is frozen if its reading is constant over these blocks while the voltage changes
by this value, V.
"""

STUCK_POSITION = Message(
    "sensor.position_stuck",
    "the position reading does not change although the force does: check the plug and cable of the position sensor",
)
JUMPING_POSITION = Message(
    "sensor.position_jumps",
    "the position reading jumps further than the probe can move: check the plug and cable of the position sensor",
)
DEAD_COIL = Message(
    "sensor.no_current", "the coil current does not follow the voltage: check the plug and cable of the coil"
)

_COLUMNS = ("command", "voltage", "current", "position")


_Any = TypeVar("_Any")


def shallow_copy(value: _Any) -> _Any:
    """Return a copy of an object with the same attributes, in a fifth of the time of ``copy.copy``."""
    other = object.__new__(type(value))
    other.__dict__.update(value.__dict__)
    return other


class Plausibility:
    """Checks the samples of a run as they arrive. Blocks with lost samples are skipped."""

    def __init__(self, device: DeviceDescription) -> None:
        self._block = max(1, round(BLOCK_S * device.sample_rate_hz))
        self._jump_m = JUMP_M_PER_S / device.sample_rate_hz
        self._resistance_ohm = device.coil_resistance_ohm
        self._force_constant = device.force_constant_n_per_a
        self.begin()

    def begin(self, *, at_low_end: bool = False) -> None:
        """Begin a run. With ``at_low_end`` the probe may rest at the near end of its stroke, where readings are
        constant.
        """
        self._at_low_end = at_low_end
        self._pending = np.zeros((0, len(_COLUMNS)))
        self._seen: deque[dict[str, float]] = deque(maxlen=POSITION_BLOCKS)
        self._last_m = np.nan

    def check(self, samples: NDArray[np.void]) -> None:
        """Check the next samples of the run, shape (k,), in order.

        Raises:
            InstrumentError: the readings are implausible.
        """
        if samples.size == 0:
            return
        position = np.concatenate(((self._last_m,), samples["position"]))
        self._last_m = float(position[-1])
        if (np.abs(position[1:] - position[:-1]) > self._jump_m).any():  # NaN next to a lost sample: no jump
            raise InstrumentError(JUMPING_POSITION)
        rows = np.empty((samples.size, len(_COLUMNS)))
        for column, name in enumerate(_COLUMNS):
            rows[:, column] = samples[name]
        self._pending = np.concatenate((self._pending, rows)) if self._pending.size else rows
        while self._pending.shape[0] >= self._block:
            block, self._pending = self._pending[: self._block], self._pending[self._block :]
            if np.isfinite(block).all():
                self._seen.append(_summary(block))
                self._judge_position()
                self._judge_current()

    def copy(self) -> Plausibility:
        """Return a copy with the same samples."""
        other = shallow_copy(self)
        other._seen = self._seen.copy()
        return other

    def _judge_position(self) -> None:
        if len(self._seen) < POSITION_BLOCKS:
            return
        low, high = min(row["lowest_m"] for row in self._seen), max(row["highest_m"] for row in self._seen)
        if self._at_low_end and low <= 0.0:
            return
        swing = _spread([row["current"] for row in self._seen]) * self._force_constant
        frozen = low == high and swing >= FROZEN_SWING_N
        still = _spread([row["position"] for row in self._seen]) <= STILL_M and swing >= STILL_SWING_N
        if frozen or still:
            raise InstrumentError(STUCK_POSITION)

    def _judge_current(self) -> None:
        newest = list(self._seen)[-COIL_BLOCKS:]
        asked, measured, drawn = (
            sum([row[name] for row in newest]) / len(newest) for name in ("asked_v", "measured_v", "drawn_a")
        )
        weak = drawn * self._resistance_ohm < OPEN_SHARE * measured
        if len(newest) == COIL_BLOCKS and min(asked, measured) >= OPEN_VOLTS and weak:
            raise InstrumentError(DEAD_COIL)
        newest = list(self._seen)[-CURRENT_BLOCKS:]
        frozen = min(row["lowest_a"] for row in newest) == max(row["highest_a"] for row in newest)
        swing = _spread([row["voltage"] for row in newest])
        if len(newest) == CURRENT_BLOCKS and frozen and swing >= CURRENT_SWING_V:
            raise InstrumentError(DEAD_COIL)


def _spread(few: list[float]) -> float:
    # Ten times as fast as numpy for ten numbers.
    return max(few) - min(few)


def _summary(block: NDArray[np.float64]) -> dict[str, float]:
    """Return means, mean magnitudes and extremes of a block, by name."""
    columns = np.ascontiguousarray(block.T)
    count = block.shape[0]
    _, voltage, current, position = (np.add.reduce(columns, axis=1) / count).tolist()
    asked, measured, drawn, _ = (np.add.reduce(np.abs(columns), axis=1) / count).tolist()
    _, _, lowest_a, lowest_m = np.minimum.reduce(columns, axis=1).tolist()
    _, _, highest_a, highest_m = np.maximum.reduce(columns, axis=1).tolist()
    return {
        "asked_v": asked,
        "measured_v": measured,
        "drawn_a": drawn,
        "voltage": voltage,
        "current": current,
        "position": position,
        "lowest_a": lowest_a,
        "highest_a": highest_a,
        "lowest_m": lowest_m,
        "highest_m": highest_m,
    }


_NO_TEMPERATURE = Message(
    "sensor.no_temperature",
    "the temperature sensor of the coil gives no usable reading: check its plug and cable",
)


class SampleMonitor:
    """Host-side checks of one opened instrument; the calculated temperature carries over from test to test.

    Args:
        nominal: the instrument's own properties; an active calibration can only make the checks stricter.
        winding: whether to calculate the temperature; False for an in-process simulation, which has no coil.
    """

    def __init__(self, nominal: DeviceDescription, *, winding: bool = True) -> None:
        self._nominal = nominal
        self._plausibility = Plausibility(nominal)
        self._winding = WindingTemperature(nominal) if winding else None
        self.highest_expected_a = 0.0
        self._lifted = False

    def copy(self) -> SampleMonitor:
        """Return a copy that has checked the same samples."""
        other = shallow_copy(self)
        other._plausibility = self._plausibility.copy()
        other._winding = shallow_copy(self._winding) if self._winding is not None else None
        return other

    @property
    def winding_c(self) -> float:
        """Return the calculated temperature of the winding, degC; NaN where none is calculated."""
        return np.nan if self._winding is None else self._winding.temperature_c

    def arm(self, temperature_c: NDArray[np.float64], limits: Limits) -> None:
        """Check the temperature before a run is armed, and reset the checks of a run.

        ``temperature_c``, shape (k,), are the newest readings of the sensor.

        Raises:
            InstrumentError: the sensor is missing or its reading is implausible.
            LimitError: the coil is already too hot.
        """
        readings = temperature_c[np.isfinite(temperature_c)]
        if readings.size == 0:
            raise InstrumentError(_NO_TEMPERATURE)
        sensor = float(readings.mean())
        if not PLAUSIBLE_C[0] <= sensor <= PLAUSIBLE_C[1]:
            raise InstrumentError(
                "sensor.wrong_temperature",
                "the temperature sensor of the coil gives no usable reading ({temperature:.0f} °C): "
                "check its plug and cable",
                temperature=sensor,
            )
        if (hottest := max(sensor, np.nan_to_num(self.winding_c, nan=sensor))) > limits.max_temperature_c:
            raise coil_too_hot(hottest, limits)
        self._plausibility.begin(at_low_end=limits.min_position_m <= 0.0)
        self.highest_expected_a = 0.0
        self._lifted = False

    def expect_command(self, command_v: NDArray[np.float64]) -> None:
        """Add commands of the run, shape (n,), V: they bound the current that a lost sample may have carried."""
        volts = float(np.abs(command_v).max(initial=0.0)) * self._nominal.amplifier_gain
        self.highest_expected_a = max(self.highest_expected_a, volts / self._nominal.coil_resistance_ohm)

    def check(
        self,
        samples: NDArray[np.void],
        limits: Limits | None,
        run: Run | None,
        calibrated: tuple[NDArray[np.void], DeviceDescription] | None = None,
    ) -> None:
        """Check samples as read, shape (k,), each once and in order. Without ``limits`` no test is armed.

        ``calibrated`` holds the same samples corrected by the active calibration, and its device description; the
        limits must hold for both.

        Raises:
            LimitError, InstrumentError: a check failed. The caller releases the coil.
        """
        if self._winding is not None:
            highest_a = 0.0 if run is None else self.highest_expected_a
            self._winding.take(samples["current"], samples["temperature"], highest_a)
        if limits is None:
            return
        first_index = run.first_index if run else None
        resting = self._resting_at_near_end(samples, limits, first_index)
        check_samples(_without_position(samples, resting), self._nominal, limits, first_index)
        if calibrated is not None:
            check_samples(_without_position(calibrated[0], resting), calibrated[1], limits, first_index)
        if (samples["temperature"] < PLAUSIBLE_C[0]).any():
            raise InstrumentError(_NO_TEMPERATURE)
        if self.winding_c > limits.max_temperature_c:
            raise LimitError(
                "limit.winding_temperature",
                "the coil is at {temperature:.0f} °C by its current; the limit is {limit:g} °C: let it cool",
                temperature=self.winding_c,
                limit=limits.max_temperature_c,
            )
        if run is not None:
            inside = samples["index"] >= run.first_index
            self._plausibility.check(samples if inside.all() else samples[inside])

    def _resting_at_near_end(
        self, samples: NDArray[np.void], limits: Limits, first_index: int | None
    ) -> NDArray[np.bool_]:
        """Return where, shape (k,), the probe still rests at the near end of its stroke and is permitted to.

        A free probe rests there when the instrument points upwards. The near limit applies from the first sample of
        the run inside it, or after ``LIFT_S``.
        """
        off = np.zeros(samples.size, dtype=np.bool_)
        if self._lifted and first_index is not None:
            return off
        if first_index is not None and samples.size:
            off = (samples["position"] >= limits.min_position_m) & (samples["index"] >= first_index)
            off |= samples["index"] >= first_index + round(LIFT_S * self._nominal.sample_rate_hz)
            off = np.logical_or.accumulate(off)
            self._lifted = bool(off[-1])
        return np.asarray(~off & (samples["position"] < limits.min_position_m))


def _without_position(samples: NDArray[np.void], mask: NDArray[np.bool_]) -> NDArray[np.void]:
    """Return the samples with position NaN where ``mask`` is true."""
    if not mask.any():
        return samples
    samples = samples.copy()
    samples["position"][mask] = np.nan
    return samples
