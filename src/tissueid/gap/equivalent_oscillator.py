"""Conversion of an input-output record to force and motion of an equivalent machine, of the size of an indenter.

The machine is a mass on a spring until ``machine_family`` chooses another one.

Input and output are scaled to the range of the effects' bounds and starting points: the output becomes a motion of
about a millimetre, the input a force of about a newton. Time is not scaled. Starting values of mass, damping and
stiffness follow from the frequency response by weighted least squares (Sanathanan and Koerner, IEEE Trans. Automatic
Control 8 (1963) 56-58).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.signal import csd, resample_poly, welch

from tissueid.device import DeviceDescription
from tissueid.language import marked
from tissueid.messages import Message

FloatArray = NDArray[np.float64]
Family = Literal["oscillator", "free_mass", "velocity", "driven_mass", "far_mass"]
"""Family of the machine.

``oscillator``: a mass on a spring with a damper, of first order where the mass is negligible. ``free_mass``: a mass
with viscous friction and no spring. ``velocity``: the same, its output is the velocity. ``driven_mass``, ``far_mass``:
two masses with a flexible coupling; the output is the motion of the driven mass or of the other one.
"""
FAMILY_NAMES: Mapping[Family, str] = {
    "oscillator": marked("a mass on a spring"),
    "free_mass": marked("a mass with viscous friction and without a spring"),
    "velocity": marked("a mass with viscous friction, whose velocity is the output"),
    "driven_mass": marked("two masses with a flexible coupling, of which the driven one is the output"),
    "far_mass": marked("two masses with a flexible coupling, of which the one that is not driven is the output"),
}
"""Displayed names of the families."""

MOTION_M = 7e-4
"""Least standard deviation of the scaled motion, m."""
SPEED_M_S = 0.03
"""Least standard deviation of the scaled velocity, m/s: friction has no scale of its own."""
MOST_MOTION_M = 0.01
FORCE_N = 1.5
"""Standard deviation of the larger of input force and spring force, N."""
VELOCITY_TIME_S = 0.02
"""Motion that stands for a velocity, relative to it, s: a typical velocity of an indenter at its typical motion."""
PEAK_V = 24.0
"""Voltage that stands for the largest input, V, within the bounds of effects of the amplifier."""
CALIBRATION_SPREAD = 0.02
DELAYS = 25
"""Number of delays in the search, over ``MOST_DELAY_SAMPLES`` samples."""
MOST_DELAY_SAMPLES = 2.0
LONGEST_DELAY = 100
"""Longest dead time, samples."""
_FEW_LINES = 300
"""Lines of the frequency response at which every dead time is tried."""
_ROUNDS = 4
_SEGMENTS = 8
_HELD_ERROR_RATIO = 0.7
_LEAST = 1e-6


@dataclass(frozen=True)
class Equivalent:
    """Scales of an input-output record and its oscillator.

    ``input_n`` is the force (N) of one unit of the input, ``output_m`` the motion (m) of one unit of the output.
    ``held`` states that the input is constant between samples; otherwise it is band-limited (Pintelon and Schoukens,
    System Identification, 2nd ed. (2012), 13.2-13.3). ``delay_s`` is the delay of the output.
    """

    input_name: str
    output_name: str
    input_unit: str
    output_unit: str
    input_n: float
    output_m: float
    held: bool
    delay_s: float
    mass_kg: float
    damping_n_s_per_m: float
    stiffness_n_per_m: float
    family: Family = "oscillator"
    restart_s: float | None = None
    """Length of the windows of a prediction, each of which starts from the recorded motion, s; None: a free run."""
    coupling: tuple[float, float, float, float] = (30.0, 0.05, 1.0, 1.0)
    """Start of the coupling of two masses: resonance of the mass of the output against the other one at rest (Hz), its
    damping ratio, the other mass relative to it, and the damping of the other mass by that mass (1/s)."""
    input_middle_n: float = 0.0
    """Mean of the input, which the simulated force does not include, N."""
    volts_per_newton: float = 1.0

    @property
    def output_is_velocity(self) -> bool:
        """Whether the output is the velocity of the mass, times ``VELOCITY_TIME_S``."""
        return self.family == "velocity"

    @property
    def has_spring(self) -> bool:
        """Whether the mass is on a spring to the ground."""
        return self.family not in ("free_mass", "velocity")

    @property
    def has_coupling(self) -> bool:
        """Whether there are two masses."""
        return self.family in ("driven_mass", "far_mass")

    def device(self, sample_rate_hz: float) -> DeviceDescription:
        """Return the oscillator as an instrument, with neutral values of everything else."""
        return DeviceDescription(
            model="equivalent machine",
            coil_resistance_ohm=1.0,
            coil_inductance_h=1e-9,
            force_constant_n_per_a=1.0,
            moving_mass_kg=self.mass_kg,
            bearing_damping_n_s_per_m=self.damping_n_s_per_m,
            amplifier_limit_v=1e9,
            stroke_m=1.0,
            sample_rate_hz=sample_rate_hz,
            calibration_relative_uncertainty=CALIBRATION_SPREAD,
        )

    @property
    def settling_s(self) -> float:
        """Time in which the initial state decays to one percent, s."""
        slow = 2.0 * self.mass_kg / self.damping_n_s_per_m
        creep = self.damping_n_s_per_m / max(self.stiffness_n_per_m, 1e-9)
        return 4.6 * max(slow, min(creep, 1.0))

    @property
    def natural_hz(self) -> float:
        """Undamped natural frequency, Hz."""
        return float(np.sqrt(self.stiffness_n_per_m / self.mass_kg) / (2.0 * np.pi))

    @property
    def remark(self) -> Message:
        """Scales of input and output, for people."""
        return Message(
            "gap.equivalent_oscillator",
            "{input} is treated as a force on a mass and {output} as its motion: 1 {input_unit} is "
            "{newtons:.3g} N and 1 {output_unit} is {millimetres:.4g} mm. Parameters of effects are in these units; "
            "effects that need voltage and current cannot be identified",
            input=_with_unit(self.input_name, self.input_unit),
            output=_with_unit(self.output_name, self.output_unit),
            input_unit=self.input_unit or marked("unit"),
            output_unit=self.output_unit or marked("unit"),
            newtons=self.input_n,
            millimetres=1e3 * self.output_m,
        )


def _with_unit(name: str, unit: str) -> str:
    return f"{name} ({unit})" if unit else name


@dataclass(frozen=True)
class FrequencyResponse:
    """Frequency response from input to output: angular frequency (rad/s), value and weight, shape (lines,) each."""

    omega: FloatArray
    response: NDArray[np.complex128]
    weight: FloatArray

    def every(self, step: int) -> FrequencyResponse:
        """Return every line of a number ``step``."""
        return FrequencyResponse(self.omega[::step], self.response[::step], self.weight[::step])


def equivalent(
    records: Sequence[tuple[FloatArray, FloatArray]],
    sample_rate_hz: float,
    names: tuple[str, str],
    units: tuple[str, str],
) -> Equivalent:
    """Return scales and starting values from records of input and output, shape (n,) each, without gaps.

    Args:
        records: input and output of every test.
        sample_rate_hz: their sample rate.
        names: names of input and output.
        units: units of input and output; "" where unknown.
    """
    motion = float(np.sqrt(np.mean([np.var(output) for _, output in records])))
    force = float(np.sqrt(np.mean([np.var(given) for given, _ in records])))
    speed = float(np.sqrt(np.mean([np.var(np.diff(output)) for _, output in records]))) * sample_rate_hz
    lines = frequency_response(records, sample_rate_hz)
    fits = [(*_fitted(lines, sample_rate_hz, held), held) for held in (False, True)]
    _, delay, figures, held = fits[1] if fits[1][0] < _HELD_ERROR_RATIO * fits[0][0] else fits[0]
    slowness = motion / max(speed, 1e-30)
    output_m = min(max(MOTION_M, SPEED_M_S * slowness), MOST_MOTION_M) / motion
    stiffness, damping, mass = figures
    input_n = FORCE_N / max(force, stiffness * motion)
    scale = input_n / output_m
    # Bound each parameter from below, so that it has a logarithm.
    typical = max(speed / motion, 1.0)
    least = _LEAST * max(stiffness, damping * typical, mass * typical**2)
    return Equivalent(
        *names,
        *units,
        input_n,
        output_m,
        held,
        delay,
        scale * max(mass, least / typical**2),
        scale * max(damping, 100.0 * least / typical),
        scale * max(stiffness, least),
    )


def frequency_response(records: Sequence[tuple[FloatArray, FloatArray]], rate: float) -> FrequencyResponse:
    """Return the frequency response of records of input and output, at the lines with power and coherence."""
    size = min(8192, max(64, min(given.size for given, _ in records) // _SEGMENTS))
    lines = size // 2 + 1
    power, cross, output_power, count = np.zeros(lines), np.zeros(lines, np.complex128), np.zeros(lines), 0
    for given, output in records:
        _, of_input = welch(given - given.mean(), rate, nperseg=size)
        _, of_both = csd(given - given.mean(), output - output.mean(), rate, nperseg=size)
        _, of_output = welch(output - output.mean(), rate, nperseg=size)
        power, cross, output_power = power + of_input, cross + of_both, output_power + of_output
        count += max(1, 2 * given.size // size - 1)
    hz, power = np.fft.rfftfreq(size, 1.0 / rate), np.maximum(power, 1e-300)
    coherence = np.clip(np.abs(cross) ** 2 / (power * np.maximum(output_power, 1e-300)), 0.0, 1.0 - 1e-6)
    # Leave out lines without input power and without coherence.
    used = (hz > 0.0) & (hz < 0.45 * rate) & (power > 1e-4 * np.median(np.sort(power)[-max(8, power.size // 8) :]))
    used &= coherence > min(0.5, 4.0 / max(count, 1) + 0.05)
    if used.sum() < 8:
        used = (hz > 0.0) & (hz < 0.45 * rate)
    response = np.asarray(cross[used] / power[used], np.complex128)
    return FrequencyResponse(np.asarray(2.0 * np.pi * hz[used], np.float64), response, power[used] * coherence[used])


def _fitted(lines: FrequencyResponse, rate: float, held: bool) -> tuple[float, float, tuple[float, float, float]]:
    """Return residual, delay and (stiffness, damping, mass) with the least residual on a grid of delays."""
    short = min(
        (_at_delay(lines, samples / rate, rate, held) for samples in np.linspace(-1.0, MOST_DELAY_SAMPLES, DELAYS)),
        key=itemgetter(0),
    )
    few = lines.every(max(1, lines.omega.size // _FEW_LINES))
    coarse = min((_at_delay(few, samples / rate, rate, held) for samples in range(3, LONGEST_DELAY)), key=itemgetter(0))
    near = coarse[1] * rate + np.linspace(-1.0, 1.0, 9)
    long = min((_at_delay(lines, samples / rate, rate, held) for samples in near), key=itemgetter(0))
    return long if long[0] < _HELD_ERROR_RATIO * short[0] else short


def _at_delay(
    lines: FrequencyResponse, delay: float, rate: float, held: bool
) -> tuple[float, float, tuple[float, float, float]]:
    way = np.exp(-1j * lines.omega * delay)
    if held:
        half = 0.5 * lines.omega / rate
        # A sample is taken at the end of the hold.
        way = way * np.sinc(half / np.pi) * np.exp(1j * half)
    lhs = np.stack([lines.response, 1j * lines.omega * lines.response, -(lines.omega**2) * lines.response], axis=1)
    size = np.maximum(np.sqrt(np.mean(np.abs(lhs) ** 2, axis=0)), 1e-300)
    denominator = np.ones(lines.omega.size)
    figures = np.zeros(3)
    for _ in range(_ROUNDS):
        weight = np.sqrt(lines.weight) / np.maximum(denominator, 1e-300)
        design = weight[:, None] * lhs / size
        target = weight * way
        real = np.concatenate([design.real, design.imag])
        figures = nnls(real, np.concatenate([target.real, target.imag]))[0] / size
        denominator = np.abs(figures[0] - figures[2] * lines.omega**2 + 1j * figures[1] * lines.omega)
        if not denominator.all():
            return np.inf, delay, (0.0, 0.0, 0.0)
    model = way / (figures[0] - figures[2] * lines.omega**2 + 1j * figures[1] * lines.omega + 1e-300)
    error = float(np.sum(lines.weight * np.abs(lines.response - model) ** 2))
    return error, delay, (float(figures[0]), float(figures[1]), float(figures[2]))


def resampled(values: FloatArray, times: int, *, held: bool) -> FloatArray:
    """Return a signal at ``times`` the sample rate, shape (n times,): held or band-limited between samples."""
    if held:
        return np.repeat(values, times)
    middle = float(values.mean())
    fine: FloatArray = resample_poly(values - middle, times, 1, window=("kaiser", 8.0), padtype="line") + middle
    return fine
