"""Placement of the probe: contact, orientation, and position of the tissue surface (thesis 2.2.2, Fig. 2.7)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition.playback import POLL_S, Phase, Progress, ignore_progress, never_stop, play
from tissueid.device import GRAVITY_M_S2, DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.instrument import CLINICAL, Instrument, Limits, join_blocks
from tissueid.language import marked
from tissueid.messages import Message

MARGIN_M = 1.0e-3
"""Distance from an end of the stroke that counts as the end, m; as in the placement of a test."""
MOVING_M = 0.5e-3
"""Motion within a quarter of a second above which the probe is moving, m."""
RECENT_S = 0.25
_LAID = 0.5 * GRAVITY_M_S2
"""Smallest component of gravity along the stroke that rests a released probe on the skin, m/s²."""


class Contact(Enum):
    """State of contact; the value is its English text."""

    UNWATCHED = marked("Contact is not watched")
    FINDING = marked("Finding the skin")
    OFF = marked("Off the skin: bring the probe down onto it")
    ON = marked("On the skin")
    TOO_FAR = marked("Pressed too far: lift the instrument a little")
    TOO_DEEP = marked("Pressed too far: the probe is near the end of its stroke")
    MOVING = marked("Moving: hold still")
    UNTOLD = marked("Held so that gravity does not lay the probe down: the test finds the skin")

    @property
    def level(self) -> str:
        """Level of its colour: "good", "check" or ""."""
        if self is Contact.ON:
            return "good"
        return "" if self in (Contact.UNWATCHED, Contact.FINDING, Contact.UNTOLD) else "check"


def contact_of_free(samples: NDArray[np.void], device: DeviceDescription) -> Contact:
    """Return the contact with a released coil from the newest samples, shape (k,) of SAMPLE."""
    position = finite(samples["position"])
    along = finite(samples["acceleration_x"])
    if not position.size:
        return Contact.FINDING
    where = contact_at(position, device.stroke_m)
    if along.size and float(along.mean()) < _LAID and where is not Contact.ON:
        return Contact.UNTOLD
    return where


def contact_at(position: NDArray[np.float64], stroke_m: float) -> Contact:
    """Return the contact by positions, shape (k,), m, which grow into the tissue: a free probe is at the far end."""
    middle = float(np.median(position))
    if middle > stroke_m - MARGIN_M:
        return Contact.OFF
    if middle < MARGIN_M:
        return Contact.TOO_FAR
    return Contact.MOVING if float(np.ptp(position)) > MOVING_M else Contact.ON


def finite(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the finite values."""
    return np.asarray(values[np.isfinite(values)], np.float64)


CONTACT_FORCES_N = (0.10, 0.05)
"""Net forces, N, of the two contacts, in addition to the current that carries the coil's weight."""
PLACE_S = 1.2
"""Total duration of the two contacts, s."""
APPROACH_FORCE_N, APPROACH_S = 0.25, 1.0
"""Net force, N, and time, s, for moving the probe to the tissue against gravity; the full stroke takes 0.6 s."""
_RESTING_M_S2 = 0.5 * GRAVITY_M_S2
"""Gravity along the stroke, m/s^2, above which the probe already rests on the tissue."""
PLACING_FORCE_N = 2.0
"""Force limit during placement, N; at this low force the probe may start at an end of its stroke."""

QUIET_S = 0.2
"""Time for which the accelerometer is read before the coil is driven, s."""
_QUIET_POLLS = 60
"""Maximum number of polls for these readings."""
_SILENT_POLLS = 4
"""Number of polls without a sample after which the readings end."""
MAX_GRAVITY_M_S2 = 10.5
"""Largest plausible reading at rest, m/s^2: above it the accelerometer is uncalibrated or moving."""
_MIN_GRAVITY_M_S2 = 0.05
"""Constant readings below this value, m/s^2, indicate a missing accelerometer."""
_IN_PLANE_M_S2 = 0.3
"""Difference from g, m/s^2, up to which gravity counts as lying in the plane of both axes."""

LEVEL_M_S2 = 0.5
"""Largest gravity along the stroke in free air, m/s^2: at 3 degrees the probe slides centimetres in a second."""

_SETTLED_S = 0.2
"""Seconds at the end of each contact that are evaluated."""
_STILL_M = 50e-6
"""Largest standard deviation of the position, m, of a probe at rest."""
_STROKE_MARGIN_M = 1.0e-3
"""Minimum distance of the surface from the ends of the stroke, m."""
_SAMPLES_LOST = Message(
    "placing.samples_lost", "samples were lost while the probe was placed; check the connection and try again"
)
_ASSUMED_DOWN = marked("the stroke is assumed to point straight down")


@dataclass(frozen=True)
class Orientation:
    """Gravity measured by the accelerometer, m/s^2: ``along`` the stroke into the tissue, and ``across`` it.

    ``measured`` is False without a plausible reading: the stroke is then assumed to point straight down, and ``why``
    gives the reason.
    """

    along_m_s2: float = GRAVITY_M_S2
    across_m_s2: float = 0.0
    measured: bool = False
    why: str = Message("placing.not_measured", "the orientation was not measured: {assumed}", assumed=_ASSUMED_DOWN)

    @property
    def tilt_deg(self) -> float:
        """Angle between the stroke and straight down, degrees from 0 to 180.

        Both axes are used if gravity lies in their plane; otherwise the axis along the stroke alone, which is accurate
        to some degrees only near 0 and 180 degrees.
        """
        if self.measured and abs(math.hypot(self.along_m_s2, self.across_m_s2) - GRAVITY_M_S2) < _IN_PLANE_M_S2:
            return math.degrees(math.atan2(abs(self.across_m_s2), self.along_m_s2))
        return math.degrees(math.acos(max(-1.0, min(1.0, self.along_m_s2 / GRAVITY_M_S2))))

    def as_notes(self) -> dict[str, str | float]:
        """Return the orientation as notes of a test."""
        notes: dict[str, str | float] = {"gravity_along_stroke_m_s2": self.along_m_s2, "tilt_deg": self.tilt_deg}
        if self.measured:
            notes["gravity_across_stroke_m_s2"] = self.across_m_s2
        else:
            notes["orientation"] = str(self.why)
        return notes


@dataclass(frozen=True)
class Placement:
    """Position of the tissue surface on the actuator, m, and orientation of the instrument at that time."""

    surface_m: float
    orientation: Orientation = Orientation()


def orientation_of(along: NDArray[np.float64], across: NDArray[np.float64]) -> Orientation:
    """Return the orientation from both axes of the accelerometer at rest, shape (k,), m/s^2.

    Two axes do not measure the component of gravity along the third, so their vector sum is at most g.
    """
    finite = np.isfinite(along) & np.isfinite(across)
    if not finite.any():
        return Orientation(
            why=Message(
                "placing.no_acceleration", "the accelerometer gives no reading: {assumed}", assumed=_ASSUMED_DOWN
            )
        )
    x, y = float(along[finite].mean()), float(across[finite].mean())
    size = math.hypot(x, y)
    if size > MAX_GRAVITY_M_S2:
        return Orientation(
            why=Message(
                "placing.implausible",
                "the accelerometer reads {size:.1f} m/s² at rest, which is impossible: {assumed}",
                size=size,
                assumed=_ASSUMED_DOWN,
            )
        )
    if size < _MIN_GRAVITY_M_S2 and float(np.ptp(along[finite])) == 0.0:
        return Orientation(
            why=Message(
                "placing.zero",
                "the accelerometer reads 0 m/s² on both axes, so the tilt is unknown: {assumed}",
                assumed=_ASSUMED_DOWN,
            )
        )
    return Orientation(x, y, measured=True, why="")


def find_orientation(instrument: Instrument, cancelled: Callable[[], bool] = never_stop) -> Orientation:
    """Read the accelerometer for 0.2 s with the coil free.

    Raises:
        CancelledError: ``cancelled`` returned True.
    """
    samples = _read_at_rest(instrument, cancelled)
    return orientation_of(samples["acceleration_x"], samples["acceleration_y"])


def _read_at_rest(instrument: Instrument, cancelled: Callable[[], bool]) -> NDArray[np.void]:
    """Return the samples of 0.2 s, shape (k,), while nothing is played; empty for a silent instrument."""
    wanted = round(QUIET_S * instrument.device.sample_rate_hz)
    blocks: list[NDArray[np.void]] = []
    silent = 0
    for _ in range(_QUIET_POLLS):
        if cancelled() or silent >= _SILENT_POLLS or sum(block.size for block in blocks) >= wanted:
            break
        blocks.append(instrument.poll(POLL_S))
        silent = 0 if blocks[-1].size else silent + 1
    return join_blocks(blocks)


def place_in_air(instrument: Instrument, cancelled: Callable[[], bool] = never_stop) -> Placement:
    """Return the rest position of a free probe as the surface; the coil is not driven.

    Raises:
        UnusableInputError: the instrument is not level, the position is unknown, or the probe is at an end.
        CancelledError: ``cancelled`` returned True.
    """
    samples = _read_at_rest(instrument, cancelled)
    orientation = orientation_of(samples["acceleration_x"], samples["acceleration_y"])
    if orientation.measured and abs(orientation.along_m_s2) > LEVEL_M_S2:
        raise UnusableInputError(
            "placing.not_level",
            "in free air the probe would slide to an end of its stroke: lay the instrument level; it points "
            "{tilt:.0f}° from straight down",
            tilt=orientation.tilt_deg,
        )
    position = samples["position"][np.isfinite(samples["position"])]
    if not position.size:
        raise UnusableInputError(
            "placing.no_position", "the instrument sends no probe position; check the connection and try again"
        )
    at = float(np.median(position))
    if not _STROKE_MARGIN_M < at < instrument.device.stroke_m - _STROKE_MARGIN_M:
        raise UnusableInputError(
            "placing.at_end_in_air",
            "the probe is at the end of its stroke ({place:.1f} mm): push it to the middle and try again",
            place=at * 1e3,
        )
    return Placement(at, orientation)


def place(
    instrument: Instrument,
    limits: Limits = CLINICAL,
    *,
    progress: Callable[[Progress], None] = ignore_progress,
    cancelled: Callable[[], bool] = never_stop,
) -> Placement:
    """Measure the orientation of the instrument and find the tissue surface by two light contacts.

    The coil carries the weight of the moving part along the stroke, as measured by the accelerometer, so that only the
    contact force remains. If gravity does not press the probe onto the tissue, the coil moves it there first.

    Raises:
        UnusableInputError: the probe finds no contact within its stroke, or is not held still.
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
    if orientation.along_m_s2 < _RESTING_M_S2:
        approach = np.full(
            round(APPROACH_S * device.sample_rate_hz), device.voltage_for_force(APPROACH_FORCE_N - weight)
        )
        command = np.concatenate([approach, command])
    gentle = replace(limits, max_force_n=min(limits.max_force_n, PLACING_FORCE_N))
    play(instrument, command, gentle, on_samples=take, cancelled=cancelled)
    position = join_blocks(blocks)["position"]
    if position.size < command.size:
        raise UnusableInputError(_SAMPLES_LOST)
    late = position[-levels.size * samples_per_level :].reshape(levels.size, -1)[
        :, -round(_SETTLED_S * device.sample_rate_hz) :
    ]  # (levels, settled)
    if np.isnan(late).any():
        raise UnusableInputError(_SAMPLES_LOST)
    # Extrapolate the line through the two depths to zero force.
    slope = (late[0].mean() - late[1].mean()) / (CONTACT_FORCES_N[0] - CONTACT_FORCES_N[1])
    surface = float(late[1].mean() - CONTACT_FORCES_N[1] * slope)
    if not _STROKE_MARGIN_M < surface < device.stroke_m - _STROKE_MARGIN_M:
        raise UnusableInputError(
            "placing.at_end",
            "the probe is at the end of its stroke ({place:.1f} mm): place it on the tissue and try again",
            place=surface * 1e3,
        )
    # Creep of the tissue appears as a slope; the residual is hand motion.
    time = np.arange(late.shape[1])
    creep = np.polynomial.polynomial.polyfit(time, late.T, 1)  # (2, levels)
    shaking = (late - creep[0][:, None] - creep[1][:, None] * time).std(axis=1)
    if float(shaking.max()) > _STILL_M:
        raise UnusableInputError(
            "placing.not_still", "the probe is not held still: hold the reference surface firmly and place it again"
        )
    return Placement(surface, orientation)


def find_surface(
    instrument: Instrument,
    limits: Limits = CLINICAL,
    *,
    progress: Callable[[Progress], None] = ignore_progress,
    cancelled: Callable[[], bool] = never_stop,
) -> float:
    """Return the position of the surface, m; ``place`` also returns the orientation.

    Raises:
        UnusableInputError: as ``place``.
    """
    return place(instrument, limits, progress=progress, cancelled=cancelled).surface_m
