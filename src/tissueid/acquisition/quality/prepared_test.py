"""The signals of a finished test for the quality checks, filled and filtered once, and texts by kind of contact."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from tissueid.device import GRAVITY_M_S2, DeviceDescription
from tissueid.language import marked
from tissueid.sessions import Test


@dataclass(frozen=True)
class ContactTexts:
    """Templates and advice for one kind of contact.

    Templates: ``no_contact_force`` and ``above`` for loss of contact, ``position_jump`` and ``position_drift`` for a
    shifted reference, ``incoherent`` for motion that the force does not explain, ``deeper`` and ``higher`` for a
    changed surface position, ``settling`` for a mean depth that changes from test to test. Each ``*_advice`` says what
    to do about the finding of that name.
    """

    no_contact_force: str
    above: str
    position_jump: str
    position_drift: str
    incoherent: str
    deeper: str
    higher: str
    settling: str
    contact_advice: str
    reference_advice: str
    knock_advice: str
    orientation_advice: str
    coherence_advice: str
    stroke_advice: str
    unusual_advice: str
    surface_advice: str
    settling_advice: str


TISSUE = ContactTexts(
    no_contact_force=marked(
        "The probe left the skin for {percent:.1f} % of the test: no force pressed it onto the tissue."
    ),
    above=marked("The probe left the skin for {percent:.1f} % of the test: it was above the surface."),
    position_jump=marked(
        "The reference surface moved: the position jumped by {size:.2f} mm at {seconds:.1f} s, more than force and "
        "creep explain."
    ),
    position_drift=marked(
        "The reference surface moved: the position drifted by {size:.2f} mm, more than force and creep explain."
    ),
    incoherent=marked(
        "The force explains only {percent:.0f} % of the motion (coherence): something else moved the probe, or the "
        "tissue is strongly nonlinear."
    ),
    deeper=marked(
        "The surface is {size:.2f} mm deeper than in the earlier tests at this site: the instrument was moved."
    ),
    higher=marked(
        "The surface is {size:.2f} mm higher than in the earlier tests at this site: the instrument was moved."
    ),
    settling=marked(
        "The tissue is still settling: under the same force the mean probe position was {size:.2f} mm {direction} than "
        "in {earlier}."
    ),
    contact_advice=marked(
        "Raise the lowest force, or place the probe deeper and hold the reference surface firmly. If the probe is "
        "meant to lift off, use a nonlinear model."
    ),
    reference_advice=marked(
        "Hold the reference surface firmly against the tissue, rest the arm, and run the test again."
    ),
    knock_advice=marked("If the reference surface may have moved, run the test again."),
    orientation_advice=marked(
        "Hold it still and place it again: the weight of the moving part loads the tissue differently."
    ),
    coherence_advice=marked(
        "Rest the arm, hold the reference surface firmly, and run the test again. Also try a nonlinear model."
    ),
    stroke_advice=marked(
        "Place the instrument so that the surface is near the middle of the stroke, and run the test again."
    ),
    unusual_advice=marked(
        "Check whether the arm or the instrument moved, and repeat the test to see which result is right."
    ),
    surface_advice=marked(
        "Compare only tests with the same placement, or repeat the series without lifting the instrument."
    ),
    settling_advice=marked("Repeat the test until two agree, and leave out the first test at this site."),
)
SPRING = ContactTexts(
    no_contact_force=marked(
        "The probe left the calibration spring for {percent:.1f} % of the test: no force pressed it onto the spring."
    ),
    above=marked("The probe left the calibration spring for {percent:.1f} % of the test: it was above the surface."),
    position_jump=marked(
        "The base of the spring moved: the position jumped by {size:.2f} mm at {seconds:.1f} s, more than force and "
        "creep explain."
    ),
    position_drift=marked(
        "The base of the spring moved: the position drifted by {size:.2f} mm, more than force and creep explain."
    ),
    incoherent=marked(
        "The force explains only {percent:.0f} % of the motion (coherence): something else moved the probe, or the "
        "spring rubs or strikes something."
    ),
    deeper=marked(
        "The spring is {size:.2f} mm deeper than in the earlier tests at this site: the instrument was moved."
    ),
    higher=marked(
        "The spring is {size:.2f} mm higher than in the earlier tests at this site: the instrument was moved."
    ),
    settling=marked(
        "The spring does not return to its position: under the same force the mean probe position was {size:.2f} mm "
        "{direction} than in {earlier}."
    ),
    contact_advice=marked(
        "Fix both ends of the spring, or place it deeper under the probe so that it stays compressed: a spring that is "
        "not fixed loses contact when the probe swings back."
    ),
    reference_advice=marked(
        "Screw the instrument and the base of the spring to the same table, and run the test again."
    ),
    knock_advice=marked("If the spring or the instrument may have moved, run the test again."),
    orientation_advice=marked(
        "Screw it down and repeat the calibration: the weight of the moving part stretches the spring differently."
    ),
    coherence_advice=marked(
        "Check that the spring touches only the probe and its base, screw both down, and run the test again."
    ),
    stroke_advice=marked(
        "Place the spring so that the probe is near the middle of the stroke, and run the test again."
    ),
    unusual_advice=marked(
        "Check whether the spring or the instrument moved, and repeat the test to see which result is right."
    ),
    surface_advice=marked("Compare only tests with the spring in the same place, or repeat the series."),
    settling_advice=marked("Check for friction and a loose base, and repeat the test until two agree."),
)
AIR = replace(
    SPRING,
    deeper=TISSUE.deeper,
    higher=TISSUE.higher,
    settling=marked(
        "The free probe does not return to its position: under the same force the mean probe position was {size:.2f} "
        "mm {direction} than in {earlier}."
    ),
    knock_advice=marked("Screw the instrument down, and run the test again without touching the table."),
    orientation_advice=marked(
        "Screw it down and run the test again: the component of gravity along the stroke changed."
    ),
    unusual_advice=marked(
        "Check whether something touched the probe or the instrument was turned, and repeat the test to see which "
        "result is right."
    ),
    surface_advice=marked("Compare only tests with the same orientation of the instrument, or repeat the series."),
    settling_advice=marked("Check for friction and a dragging cable, and repeat the test until two agree."),
)
"""Texts for a free probe, whose contact is not judged."""
_BY_KIND = {"spring": SPRING, "free_air": AIR}


def texts_for(kind: str) -> ContactTexts:
    """Return the texts for a kind of test: those of tissue unless the kind is a fixture."""
    return _BY_KIND.get(kind, TISSUE)


Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

CUT_OFF_HZ = 120.0
"""Cutoff, Hz, above which sensor noise dominates: 1 um at 120 Hz is 0.6 m/s^2, or 0.03 N for 60 g."""

_EDGE_S = 0.01
"""Distance, s, from a gap or an end of the record within which filtered signals are not used."""
_MIN_SAMPLES = 200
"""Minimum number of usable samples of a stimulus for a judgement."""


@dataclass(frozen=True, eq=False)
class PreparedTest:
    """A test, its device and its filtered signals. Arrays have shape (n,), the samples of the whole test."""

    test: Test
    device: DeviceDescription

    @property
    def texts(self) -> ContactTexts:
        """Texts for the contact: tissue, spring or air."""
        return texts_for(self.test.kind)

    @property
    def rate(self) -> float:
        """Sample rate, Hz."""
        return self.test.sample_rate_hz

    @cached_property
    def first(self) -> int:
        """Index of the first sample after the preload."""
        return min(round(self.test.preload_s * self.rate), self.test.samples)

    @property
    def mechanical(self) -> bool:
        """Whether there are enough samples with force and position."""
        return int(self.valid.sum()) >= _MIN_SAMPLES

    def signal(self, name: str) -> Array | None:
        """Return a signal, NaN for samples not received; None if the test has no sample of it."""
        values = self.test.signals.get(name)
        return values if values is not None and bool(np.isfinite(values).any()) else None

    def stimulus(self, name: str) -> Array:
        """Return the received samples of a signal after the preload, shape (k,)."""
        values = self.signal(name)
        if values is None:
            return np.zeros(0)
        values = values[self.first :]
        return values[np.isfinite(values)]

    @cached_property
    def received(self) -> Mask:
        """Mask of the samples with force and position."""
        force, position = self.signal("force"), self.signal("position")
        if force is None or position is None:
            return np.zeros(self.test.samples, dtype=np.bool_)
        return np.asarray(np.isfinite(force) & np.isfinite(position))

    @cached_property
    def valid(self) -> Mask:
        """Mask of the stimulus samples with valid filtered signals: more than 10 ms from gaps and ends."""
        edge = round(_EDGE_S * self.rate)
        lost = np.concatenate([[0], np.cumsum(~self.received)])
        index = np.arange(self.test.samples)
        low, high = np.maximum(index - edge, 0), np.minimum(index + edge + 1, self.test.samples)
        inside = (index >= max(edge, self.first)) & (index < self.test.samples - edge)
        return np.asarray(inside & (lost[high] == lost[low]))

    @cached_property
    def force(self) -> Array:
        """Low-pass filtered coil force, N."""
        return self._filtered("force", 0)

    @cached_property
    def position(self) -> Array:
        """Low-pass filtered position, m."""
        return self._filtered("position", 0)

    @cached_property
    def velocity(self) -> Array:
        """First derivative of the filtered position, m/s."""
        return self._filtered("position", 1)

    @cached_property
    def acceleration(self) -> Array:
        """Second derivative of the filtered position, m/s^2."""
        return self._filtered("position", 2)

    @cached_property
    def weight_n(self) -> float:
        """Weight of the moving part along the stroke, N into the tissue; without a note, of an upright instrument."""
        along = self.test.notes.get("gravity_along_stroke_m_s2")
        gravity = along if isinstance(along, int | float) and abs(along) < 2.0 * GRAVITY_M_S2 else GRAVITY_M_S2
        return self.device.moving_mass_kg * float(gravity)

    @cached_property
    def contact_force(self) -> Array:
        """Force on the tissue, N: coil force and weight minus inertia and friction of the moving part."""
        own = self.device.moving_mass_kg * self.acceleration + self.device.bearing_damping_n_s_per_m * self.velocity
        return self.force + self.weight_n - own

    def _filtered(self, name: str, derivative: int) -> Array:
        spectrum, frequency, length, trend = self._spectra[name]
        shaped = spectrum * np.exp(-0.5 * (frequency / CUT_OFF_HZ) ** 2) * (2j * np.pi * frequency) ** derivative
        values = np.asarray(fft.irfft(shaped, length)[: self.test.samples], dtype=np.float64)
        first, slope = trend
        if derivative == 0:
            return values + first + slope * np.arange(self.test.samples)
        return values + slope * self.rate if derivative == 1 else values

    @cached_property
    def _spectra(self) -> dict[str, tuple[NDArray[np.complex128], Array, int, tuple[float, float]]]:
        """Spectra of the signals, interpolated across gaps, detrended by the line between their ends, and mirrored."""
        spectra = {}
        index = np.arange(self.test.samples)
        for name in ("force", "position"):
            values = self.test.signals[name]
            values = np.interp(index, index[self.received], values[self.received])
            slope = (values[-1] - values[0]) / max(1, values.size - 1)
            level = values - values[0] - slope * index
            # An odd extension keeps value and slope continuous at the ends.
            length = fft.next_fast_len(2 * values.size, real=True)
            closed = np.zeros(length)
            closed[: values.size] = level
            closed[length - values.size + 1 :] = -level[:0:-1]
            frequency = fft.rfftfreq(length, 1.0 / self.rate)
            spectra[name] = (fft.rfft(closed), frequency, length, (float(values[0]), float(slope)))
        return spectra


def true_runs(mask: Mask) -> list[tuple[int, int]]:
    """Return first and one-past-last index of every run of True in a mask of shape (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return [(int(first), int(end)) for first, end in edges.reshape(-1, 2)]


def longest_run(mask: Mask) -> int:
    """Return the length of the longest run of True."""
    return max((end - first for first, end in true_runs(mask)), default=0)
