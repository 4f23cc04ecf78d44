"""Range of motion: ends of the stroke and weight of the moving part, from slow crossings in free air."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition import play
from tissueid.calibration.findings import CalibrationFindings, column, quantity
from tissueid.calibration.step_levels import Cancelled, OnProgress
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.instrument import Instrument, Limits, join_blocks
from tissueid.messages import Message, Quantity
from tissueid.records import Estimate

MAX_FREE_FORCE_N = 2.0
"""Maximum force in free air, N, which limits the impact at the ends of the stroke."""
STROKE_TOLERANCE_M = 1.0e-3
"""Distance of the position limits outside the nominal stroke, m."""
PUSH_FORCES_N = (0.2, 0.4, 0.8)
"""Forces in addition to the weight, N, tried in order until the probe moves from end to end."""
CROSSING_S = 1.8
"""Time for one crossing of the stroke, s."""
RISE_S = 0.1
"""Duration of the raised cosine between two forces, s."""
_ROUNDS = 2
"""Crossings in each direction."""
_AT_END_S = 0.3
"""Final part of a crossing, s, in which the probe must be at rest."""
_STILL_M = 30e-6
"""Largest range of the position of a probe at rest, m."""
_MIN_STROKE = 0.5
"""Minimum length of a crossing, relative to the nominal stroke."""
MAX_STROKE_ERROR = 0.06
"""Largest relative difference of the stroke from the nominal one."""


@dataclass(frozen=True)
class Crossing:
    """One crossing of the stroke: speed, m/s, and current, A, at mid-stroke, and end position, m."""

    speed_m_per_s: float
    current_a: float
    current_std_a: float
    end_m: float


def cross_stroke(
    instrument: Instrument, gravity_m_s2: float, *, progress: OnProgress = lambda _: None, cancelled: Cancelled
) -> tuple[Crossing, ...]:
    """Move the probe from end to end and back, twice, with the lowest sufficient force and nothing under it.

    ``gravity_m_s2`` is gravity along the stroke, positive if it pulls the probe out.

    Raises:
        UnusableInputError: the probe does not move freely.
        CancelledError, LimitError, InstrumentError: the coil is released.
    """
    device = instrument.device
    weight = device.moving_mass_kg * gravity_m_s2
    limits = Limits(
        max_force_n=MAX_FREE_FORCE_N,
        min_position_m=-STROKE_TOLERANCE_M,
        max_position_m=device.stroke_m + STROKE_TOLERANCE_M,
    )
    for push in PUSH_FORCES_N:
        if abs(weight) + push > MAX_FREE_FORCE_N:
            break
        forces = np.array([push - weight, *([-push - weight, push - weight] * _ROUNDS)])
        hold = round(CROSSING_S * device.sample_rate_hz)
        ramp = 0.5 - 0.5 * np.cos(np.pi * np.linspace(0.0, 1.0, round(RISE_S * device.sample_rate_hz)))
        parts, before = [], 0.0
        for force in forces:
            part = np.full(hold, force)
            part[: ramp.size] = before + ramp * (force - before)
            parts.append(part)
            before = float(force)
        command = np.concatenate(parts) * device.voltage_for_force(1.0)
        blocks: list[NDArray[np.void]] = []

        def take(samples: NDArray[np.void], fraction: float, blocks: list[NDArray[np.void]] = blocks) -> None:
            blocks.append(samples)
            progress(fraction)

        play(instrument, command, limits, on_samples=take, cancelled=cancelled)
        samples = join_blocks(blocks)
        crossings = [_crossing(samples[n * hold : (n + 1) * hold], device) for n in range(1, forces.size)]
        found = tuple(crossing for crossing in crossings if crossing is not None)
        if len(found) == len(crossings):
            return found
    raise UnusableInputError(
        "calibration.stuck",
        "the probe does not move from end to end with {force:g} N: check that nothing is under it and nothing rubs",
        force=MAX_FREE_FORCE_N,
    )


def _crossing(samples: NDArray[np.void], device: DeviceDescription) -> Crossing | None:
    """Return the crossing in these samples; None if the probe did not move from end to end."""
    position = samples["position"]
    received = np.isfinite(position) & np.isfinite(samples["current"])
    late = position[-round(_AT_END_S * device.sample_rate_hz) :]
    late = late[np.isfinite(late)]
    if late.size < 10 or np.ptp(late) > _STILL_M:
        return None
    start, end = float(position[received][0]), float(late.mean())
    if abs(end - start) < _MIN_STROKE * device.stroke_m:
        return None
    share = (position - start) / (end - start)
    middle = received & (share > 0.25) & (share < 0.75)
    if np.count_nonzero(middle) < 10:
        return None
    seconds = samples["index"][middle].astype(np.float64) / device.sample_rate_hz
    speed = float(np.polynomial.polynomial.polyfit(seconds - seconds[0], position[middle], 1)[1])
    current = samples["current"][middle]
    return Crossing(speed, float(current.mean()), float(current.std() / np.sqrt(current.size)), end)


def balancing_current(crossings: tuple[Crossing, ...]) -> Estimate:
    """Return the current, A, that balances the weight of the moving part.

    Friction is equal in both directions, and the speeds are similar: scaled to equal speed, the currents of both
    directions are symmetric about the balancing current.
    """
    speed = np.array([crossing.speed_m_per_s for crossing in crossings])
    current = np.array([crossing.current_a for crossing in crossings])
    pairs = []
    for one, other in zip(range(0, speed.size, 2), range(1, speed.size, 2), strict=True):
        per_speed = (current[other] - current[one]) / (speed[other] - speed[one])
        pairs.append(0.5 * (current[one] + current[other]) - per_speed * 0.5 * (speed[one] + speed[other]))
    noise = float(np.linalg.norm([crossing.current_std_a for crossing in crossings])) / len(crossings)
    return Estimate(float(np.mean(pairs)), float(np.hypot(noise, np.ptp(pairs) / 2.0)))


def range_findings(
    crossings: tuple[Crossing, ...],
    device: DeviceDescription,
    *,
    position_gain: float,
    position_offset: Estimate,
    force_constant_n_per_a: float,
    zero_a: float,
) -> CalibrationFindings:
    """Return the ends of the stroke on the corrected position scale, and the weight of the moving part."""
    ends = np.array([(crossing.end_m - position_offset.value) / position_gain for crossing in crossings])
    low, high = ends[0::2], ends[1::2]
    carrying = balancing_current(crossings)
    unsure = (position_offset.std or 0.0) / position_gain
    length = float(high.mean() - low.mean())
    problems = []
    if abs(length / device.stroke_m - 1.0) > MAX_STROKE_ERROR:
        problems.append(
            Message(
                "calibration.stroke",
                "the stroke is {found}, but {nominal} by the device: check what is in the way of the probe",
                found=Quantity(1e3 * length, "mm", 1),
                nominal=Quantity(1e3 * device.stroke_m, "mm", 1),
            )
        )
    return CalibrationFindings(
        quantities={
            "stroke_min_m": quantity(float(low.mean()), "m", float(np.hypot(unsure, np.ptp(low) / 2.0))),
            "stroke_max_m": quantity(float(high.mean()), "m", float(np.hypot(unsure, np.ptp(high) / 2.0))),
            "carrying_current_a": quantity(Estimate(carrying.value - zero_a, carrying.std), "A"),
            "moving_weight_n": quantity(
                Estimate(
                    -force_constant_n_per_a * (carrying.value - zero_a),
                    None if carrying.std is None else force_constant_n_per_a * carrying.std,
                ),
                "N",
            ),
        },
        tables={
            "range": {
                "end_m": column(ends),
                "speed_m_per_s": column([crossing.speed_m_per_s for crossing in crossings]),
                "current_a": column([crossing.current_a for crossing in crossings]),
            }
        },
        problems=tuple(problems),
    )
