"""Placing the probe: which way the instrument points, and where the tissue begins (thesis 2.2.2, Fig. 2.7)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition.playing import POLL_S, Phase, Progress, ignore, never, play
from tissueid.device import GRAVITY_M_S2
from tissueid.errors import UnusableInputError
from tissueid.instrument import CLINICAL, SAMPLE, Instrument, Limits

CONTACT_FORCES_N = (0.10, 0.05)
"""Net forces while the surface is sought: the weight of the coil is carried by the coil itself, but for these."""
PLACE_S = 1.2
APPROACH_FORCE_N, APPROACH_S = 0.25, 1.0
"""Where gravity does not lay the probe onto the tissue it is brought there first: the whole stroke takes some 0.6 s."""
_LAID_M_S2 = 0.5 * GRAVITY_M_S2
PLACING_FORCE_N = 2.0
"""No more is ever needed to place; under it the probe may begin at an end of its stroke."""

QUIET_S = 0.2
"""How long the accelerometer is read before the coil is driven."""
_QUIET_POLLS = 60
_SILENT_POLLS = 4
GREATEST_GRAVITY_M_S2 = 10.5
"""More than this is no accelerometer at rest: its zero or its gain is off, or it is being moved."""
_LEAST_GRAVITY_M_S2 = 0.05
_IN_PLANE_M_S2 = 0.3

LEVEL_M_S2 = 0.5
"""Along the stroke in free air: 3 degrees, with which the probe slides some centimetres in a second."""

_SETTLED_S = 0.2
_STILL_M = 50e-6
_STROKE_MARGIN_M = 1.0e-3


@dataclass(frozen=True)
class Orientation:
    """Gravity as the accelerometer tells it, m/s^2: ``along`` the stroke into the tissue, and ``across`` it.

    ``measured`` is False where it tells nothing that can be: then the stroke is taken to point straight down, and
    ``why`` says so.
    """

    along_m_s2: float = GRAVITY_M_S2
    across_m_s2: float = 0.0
    measured: bool = False
    why: str = "the orientation was not measured: the stroke is taken to point straight down"

    @property
    def tilt_deg(self) -> float:
        """Between the stroke and straight down, degrees from 0 to 180.

        By both axes where all of gravity lies in their plane; else by the stroke's alone, which near 0 and 180 degrees
        knows it to some degrees only.
        """
        if self.measured and abs(math.hypot(self.along_m_s2, self.across_m_s2) - GRAVITY_M_S2) < _IN_PLANE_M_S2:
            return math.degrees(math.atan2(abs(self.across_m_s2), self.along_m_s2))
        return math.degrees(math.acos(max(-1.0, min(1.0, self.along_m_s2 / GRAVITY_M_S2))))

    def as_notes(self) -> dict[str, str | float]:
        """What a session keeps with every test."""
        notes: dict[str, str | float] = {"gravity_along_stroke_m_s2": self.along_m_s2, "tilt_deg": self.tilt_deg}
        if self.measured:
            notes["gravity_across_stroke_m_s2"] = self.across_m_s2
        else:
            notes["orientation"] = self.why
        return notes


@dataclass(frozen=True)
class Placement:
    """Where the tissue begins on the actuator, m, and how the instrument was held when that was found."""

    surface_m: float
    orientation: Orientation = Orientation()


def orientation_of(along: NDArray[np.float64], across: NDArray[np.float64]) -> Orientation:
    """The orientation from both axes of the accelerometer at rest, shape (k,), m/s^2.

    An accelerometer at rest reads what holds it up against gravity. Two axes do not see gravity that lies in the
    third, so their sum may be anything up to g, but not more.
    """
    known = np.isfinite(along) & np.isfinite(across)
    if not known.any():
        return Orientation(why="the accelerometer tells nothing: the stroke is taken to point straight down")
    x, y = float(along[known].mean()), float(across[known].mean())
    size = math.hypot(x, y)
    if size > GREATEST_GRAVITY_M_S2:
        return Orientation(
            why=f"the accelerometer reads {size:.1f} m/s² at rest, which cannot be: the stroke is taken to point "
            "straight down"
        )
    if size < _LEAST_GRAVITY_M_S2 and float(np.ptp(along[known])) == 0.0:
        return Orientation(why="the accelerometer reads nothing: the stroke is taken to point straight down")
    return Orientation(x, y, measured=True, why="")


def find_orientation(instrument: Instrument, cancelled: Callable[[], bool] = never) -> Orientation:
    """Read the accelerometer for 0.2 s with the coil free.

    Raises:
        CancelledError: ``cancelled`` said so.
    """
    samples = _at_rest(instrument, cancelled)
    return orientation_of(samples["acceleration_x"], samples["acceleration_y"])


def _at_rest(instrument: Instrument, cancelled: Callable[[], bool]) -> NDArray[np.void]:
    """What is read within 0.2 s, shape (k,), while nothing is played; none from an instrument that is silent."""
    wanted = round(QUIET_S * instrument.device.sample_rate_hz)
    blocks: list[NDArray[np.void]] = []
    silent = 0
    for _ in range(_QUIET_POLLS):
        if cancelled() or silent >= _SILENT_POLLS or sum(block.size for block in blocks) >= wanted:
            break
        blocks.append(instrument.poll(POLL_S))
        silent = 0 if blocks[-1].size else silent + 1
    return np.concatenate([*blocks, np.zeros(0, SAMPLE)])


def place_in_air(instrument: Instrument, cancelled: Callable[[], bool] = never) -> Placement:
    """Where the probe lies free in place of a surface. Nothing is there to be felt, so the coil is not driven.

    Raises:
        UnusableInputError: the instrument is not level, nothing says where the probe is, or it is at an end.
        CancelledError: ``cancelled`` said so.
    """
    samples = _at_rest(instrument, cancelled)
    orientation = orientation_of(samples["acceleration_x"], samples["acceleration_y"])
    if orientation.measured and abs(orientation.along_m_s2) > LEVEL_M_S2:
        raise UnusableInputError(
            f"in free air the probe would slide to an end of its stroke: lay the instrument level, it points "
            f"{orientation.tilt_deg:.0f} degrees from straight down"
        )
    position = samples["position"][np.isfinite(samples["position"])]
    if not position.size:
        raise UnusableInputError("the instrument does not tell where the probe is; check the link and try again")
    at = float(np.median(position))
    if not _STROKE_MARGIN_M < at < instrument.device.stroke_m - _STROKE_MARGIN_M:
        raise UnusableInputError(
            f"the probe is at the end of its stroke ({at * 1e3:.1f} mm): push it to the middle and try again"
        )
    return Placement(at, orientation)


def place(
    instrument: Instrument,
    limits: Limits = CLINICAL,
    *,
    progress: Callable[[Progress], None] = ignore,
    cancelled: Callable[[], bool] = never,
) -> Placement:
    """Find how the instrument is held, and where the tissue begins: from two light contacts.

    Between them the coil carries its own weight along the stroke, as the accelerometer tells it: all of it when it
    points down, none when it lies, and upside down it is pushed up by as much. Where gravity has not laid the probe
    onto the tissue already, it is brought there first.

    Raises:
        UnusableInputError: the probe does not rest on anything within its stroke, or does not keep still.
    """
    device = instrument.device
    orientation = find_orientation(instrument, cancelled)
    weight = device.weight_n(orientation.along_m_s2)
    levels = np.array([device.voltage_for_force(force - weight) for force in CONTACT_FORCES_N])
    samples_per_level = round(PLACE_S / levels.size * device.sample_rate_hz)
    blocks: list[NDArray[np.void]] = []

    def take(samples: NDArray[np.void], fraction: float) -> None:
        blocks.append(samples)
        progress(Progress(Phase.PLACE, fraction, samples))

    command = np.repeat(levels, samples_per_level)
    if orientation.along_m_s2 < _LAID_M_S2:
        approach = np.full(
            round(APPROACH_S * device.sample_rate_hz), device.voltage_for_force(APPROACH_FORCE_N - weight)
        )
        command = np.concatenate([approach, command])
    gentle = replace(limits, max_force_n=min(limits.max_force_n, PLACING_FORCE_N))
    play(instrument, command, gentle, on_samples=take, cancelled=cancelled)
    position = np.concatenate([*blocks, np.zeros(0, SAMPLE)])["position"]
    if position.size < command.size:
        raise UnusableInputError("samples were lost while the probe was placed; check the link and try again")
    late = position[-levels.size * samples_per_level :].reshape(levels.size, -1)[
        :, -round(_SETTLED_S * device.sample_rate_hz) :
    ]  # (levels, settled)
    if np.isnan(late).any():
        raise UnusableInputError("samples were lost while the probe was placed; check the link and try again")
    # A straight line through the two depths, taken back to no force at all.
    slope = (late[0].mean() - late[1].mean()) / (CONTACT_FORCES_N[0] - CONTACT_FORCES_N[1])
    surface = float(late[1].mean() - CONTACT_FORCES_N[1] * slope)
    if not _STROKE_MARGIN_M < surface < device.stroke_m - _STROKE_MARGIN_M:
        raise UnusableInputError(
            f"the probe is at the end of its stroke ({surface * 1e3:.1f} mm): place it on the tissue and try again"
        )
    # Creep of the tissue is a slope; what shakes about it is a hand.
    time = np.arange(late.shape[1])
    creep = np.polynomial.polynomial.polyfit(time, late.T, 1)  # (2, levels)
    shaking = (late - creep[0][:, None] - creep[1][:, None] * time).std(axis=1)
    if float(shaking.max()) > _STILL_M:
        raise UnusableInputError("the probe does not keep still: hold the reference surface firmly, and place it again")
    return Placement(surface, orientation)


def find_surface(
    instrument: Instrument,
    limits: Limits = CLINICAL,
    *,
    progress: Callable[[Progress], None] = ignore,
    cancelled: Callable[[], bool] = never,
) -> float:
    """The position, m, where the tissue begins; ``place`` tells the orientation with it.

    Raises:
        UnusableInputError: as ``place``.
    """
    return place(instrument, limits, progress=progress, cancelled=cancelled).surface_m
