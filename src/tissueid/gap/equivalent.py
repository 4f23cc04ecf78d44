"""A record of nothing but an input and an output, seen as a mass on a spring of the size of an indenter.

Input and output are scaled so that the bounds and starting points of the effects make sense: the output becomes a
motion of a millimetre or so, the input a force of a newton or so. Time is left alone. Mass, damping and stiffness to
start with follow from the frequency response by weighted least squares (Sanathanan and Koerner, IEEE Trans. Automatic
Control 8 (1963) 56-58).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.signal import csd, resample_poly, welch

from tissueid.device import DeviceDescription

FloatArray = NDArray[np.float64]

MOTION_M = 7e-4
"""Standard deviation of the motion that the output becomes ..."""
SPEED_M_S = 0.03
"""... or more, where that is a crawl: friction has no scale but its own."""
MOST_MOTION_M = 0.01
FORCE_N = 1.5
"""Standard deviation of the force, the input's or the spring's, whichever is greater."""
CALIBRATION_SPREAD = 0.02
DELAYS = 25
"""So many delays are tried, over this many samples either way:"""
MOST_DELAY_SAMPLES = 2.0
_ROUNDS = 4
_SEGMENTS = 8
_HELD_IS_BETTER = 0.7
_LEAST = 1e-6


@dataclass(frozen=True)
class Equivalent:
    """How a record of input and output becomes force and motion, and the mass on a spring that it starts from.

    ``input_n`` is the force (N) of one unit of the input, ``output_m`` the motion (m) of one unit of the output.
    ``held`` says that the input stays between samples; else it is taken as band-limited (Pintelon and Schoukens,
    System Identification, 2nd ed. (2012), 13.2-13.3). ``delay_s`` is by how much the output comes late.
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

    def device(self, sample_rate_hz: float) -> DeviceDescription:
        """The mass as an instrument: what there is no trace of in the record stands aside."""
        return DeviceDescription(
            model="equivalent mass on a spring",
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
        """Time in which what was before the record dies away to a hundredth."""
        slow = 2.0 * self.mass_kg / self.damping_n_s_per_m
        creep = self.damping_n_s_per_m / max(self.stiffness_n_per_m, 1e-9)
        return 4.6 * max(slow, min(creep, 1.0))

    @property
    def natural_hz(self) -> float:
        """Undamped natural frequency, Hz."""
        return float(np.sqrt(self.stiffness_n_per_m / self.mass_kg) / (2.0 * np.pi))

    @property
    def words(self) -> str:
        """What a person should know of it."""
        given, taken = _with_unit(self.input_name, self.input_unit), _with_unit(self.output_name, self.output_unit)
        return (
            f"{given} is seen as a force and {taken} as a motion of a mass on a spring, 1 {self.input_unit or 'unit'} "
            f"as {self.input_n:.3g} N and 1 {self.output_unit or 'unit'} as {1e3 * self.output_m:.3g} mm: parameters "
            "of effects are in these; what needs voltage and current cannot be asked"
        )


def _with_unit(name: str, unit: str) -> str:
    return f"{name} ({unit})" if unit else name


@dataclass(frozen=True)
class _Line:
    """Frequency response as spectra: shape (lines,)."""

    omega: FloatArray
    response: NDArray[np.complex128]
    weight: FloatArray


def equivalent(
    records: Sequence[tuple[FloatArray, FloatArray]],
    sample_rate_hz: float,
    names: tuple[str, str],
    units: tuple[str, str],
) -> Equivalent:
    """Scales and starting point from records of input and output, shape (n,) each, without gaps.

    Args:
        records: input and output of every test.
        sample_rate_hz: of all of them.
        names: of input and output.
        units: of input and output; "" where there is none.
    """
    motion = float(np.sqrt(np.mean([np.var(output) for _, output in records])))
    force = float(np.sqrt(np.mean([np.var(given) for given, _ in records])))
    speed = float(np.sqrt(np.mean([np.var(np.diff(output)) for _, output in records]))) * sample_rate_hz
    lines = _response(records, sample_rate_hz)
    found = [(*_fitted(lines, sample_rate_hz, held), held) for held in (False, True)]
    left, delay, figures, held = found[1] if found[1][0] < _HELD_IS_BETTER * found[0][0] else found[0]
    del left
    slowness = motion / max(speed, 1e-30)
    output_m = min(max(MOTION_M, SPEED_M_S * slowness), MOST_MOTION_M) / motion
    stiffness, damping, mass = figures
    input_n = FORCE_N / max(force, stiffness * motion)
    scale = input_n / output_m
    # Each is at least so much that what is not there still has a logarithm.
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


def _response(records: Sequence[tuple[FloatArray, FloatArray]], rate: float) -> _Line:
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
    # Lines that the input hardly holds, and those where the output does not follow it, say nothing.
    used = (hz > 0.0) & (hz < 0.45 * rate) & (power > 1e-4 * np.median(np.sort(power)[-max(8, power.size // 8) :]))
    used &= coherence > min(0.5, 4.0 / max(count, 1) + 0.05)
    if used.sum() < 8:
        used = (hz > 0.0) & (hz < 0.45 * rate)
    response = np.asarray(cross[used] / power[used], np.complex128)
    return _Line(np.asarray(2.0 * np.pi * hz[used], np.float64), response, power[used] * coherence[used])


def _fitted(lines: _Line, rate: float, held: bool) -> tuple[float, float, tuple[float, float, float]]:
    """What is left, the delay and (stiffness, damping, mass) with the least left over a grid of delays."""
    return min(
        (_at_delay(lines, samples / rate, rate, held) for samples in np.linspace(-1.0, MOST_DELAY_SAMPLES, DELAYS)),
        key=lambda item: item[0],
    )


def _at_delay(lines: _Line, delay: float, rate: float, held: bool) -> tuple[float, float, tuple[float, float, float]]:
    way = np.exp(-1j * lines.omega * delay)
    if held:
        half = 0.5 * lines.omega / rate
        # A reading is taken at the end of the hold.
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
        if not denominator.any():
            break
    model = way / (figures[0] - figures[2] * lines.omega**2 + 1j * figures[1] * lines.omega + 1e-300)
    left = float(np.sum(lines.weight * np.abs(lines.response - model) ** 2))
    return left, delay, (float(figures[0]), float(figures[1]), float(figures[2]))


def finely(values: FloatArray, times: int, *, held: bool) -> FloatArray:
    """A signal at ``times`` as many samples, shape (n times,): each held, or band-limited in between."""
    if held:
        return np.repeat(values, times)
    middle = float(values.mean())
    fine: FloatArray = resample_poly(values - middle, times, 1, window=("kaiser", 8.0), padtype="line") + middle
    return fine
