"""Simulation of each stage alone: upstream signals measured, its own few parameters refitted, its output compared.

Stage-wise substitution: a model of subsystems in series is validated one subsystem at a time, each driven by the
measured output of the one before (MIL/HIL practice; Oberkampf and Roy, Verification and Validation in Scientific
Computing, 2010, ch. 12). An error that a refit within the calibration's uncertainty removes is not a fault of the
stage.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.signal import firwin

from tissueid.gap.dataset import LEAST_NOISE, DatasetTest, interpolated
from tissueid.gap.fitting import Fit
from tissueid.gap.forward_model import STEP_S, simulate_test
from tissueid.identification.levenberg_marquardt import Bounds, SecantProblem, minimise
from tissueid.twin.simulation import NOTHING_MEASURED, MeasuredSignals

FloatArray = NDArray[np.float64]

DRIVE = ("amplifier_gain",)
COIL = ("resistance_ohm", "inductance_h", "force_constant_n_per_a")
MOVING = ("force_constant_n_per_a", "moving_mass_kg", "bearing_damping_n_s_per_m", "weight_n")
TISSUE = (
    "tissue_mass_kg",
    "tissue_damping_n_s_per_m",
    "tissue_damping_growth_per_m",
    "tissue_stiffness_n_per_m",
    "tissue_stiffness_growth_per_m",
)
SPRING = ("spring_mass_kg", "spring_damping_n_s_per_m", "spring_stiffness_ratio")

MOTION_HZ = 350.0
"""Frequency above which motion is below the position's noise, because force decreases and the load is a mass."""
_TAPS = 61
_STEPS = 14
_TOLERANCE = 1e-4
_DRAWS = 3
"""Number of noise realisations simulated by the baseline."""


@dataclass(frozen=True)
class StageSimulation:
    """Result of one stage: its simulation from measured upstream signals after a refit.

    ``predicted`` and ``residual`` (recorded minus predicted) hold, by test number, arrays of shape (n,), SI, NaN where
    not received. ``theta`` is the whole vector of coordinates, with those of the stage refitted.
    """

    channel: str
    tests: tuple[DatasetTest, ...]
    theta: FloatArray
    predicted: dict[int, dict[str, FloatArray]] = field(repr=False)

    def residual(self, test: DatasetTest, channel: str = "") -> FloatArray:
        """Return recorded minus predicted in a test, shape (n,), SI."""
        name = channel or self.channel
        return np.asarray(test.signals[name] - self.predicted[test.number][name], np.float64)


def _only(name: str, values: FloatArray) -> MeasuredSignals:
    return MeasuredSignals(voltage=values) if name == "voltage" else MeasuredSignals(current=values)


def upstream(test: DatasetTest, *names: str) -> MeasuredSignals:
    """Return measured signals of a test without gaps: ``voltage``, ``current``, and ``motion`` for position and
    velocity."""
    if not names:
        return NOTHING_MEASURED
    position, velocity = motion(test) if "motion" in names else (None, None)
    return MeasuredSignals(
        interpolated(test.signals["voltage"]) if "voltage" in names else None,
        interpolated(test.signals["current"]) if "current" in names else None,
        position,
        velocity,
    )


def motion(test: DatasetTest, instead: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Return position (m) and velocity (m/s) below ``MOTION_HZ``, shape (n,) each, of the reading or of ``instead``."""
    position = interpolated(test.signals["position"] if instead is None else instead)
    taps = min(_TAPS, 2 * (position.size // 8) + 1)
    kernel = firwin(taps, min(MOTION_HZ, 0.4 * test.sample_rate_hz), fs=test.sample_rate_hz)
    half = taps // 2
    # Odd reflection at both ends keeps level and slope continuous.
    padded = np.concatenate(
        [2 * position[0] - position[half:0:-1], position, 2 * position[-1] - position[-2 : -half - 2 : -1]]
    )
    smooth = np.convolve(padded, kernel, "valid")
    # Spectral differentiation would ring at the ends; a long antisymmetric kernel is as exact below the cutoff.
    rate = differentiator(taps, test.sample_rate_hz, kernel)
    return smooth, np.convolve(padded, rate, "valid")


def motion_noise(hz: FloatArray, noise_m: float, rate_hz: float) -> FloatArray:
    """Return the power of the velocity's noise per sample at frequencies, shape as ``hz``, (m/s)^2."""
    kernel = firwin(_TAPS, min(MOTION_HZ, 0.4 * rate_hz), fs=rate_hz)
    passed = np.abs(np.fft.rfft(kernel, 4096))
    passed = np.interp(hz, np.fft.rfftfreq(4096, 1.0 / rate_hz), passed)
    return np.asarray((2.0 * np.pi * hz * passed * noise_m) ** 2)


def velocity_noise(noise_m: float, rate_hz: float) -> float:
    """Return the standard deviation of the velocity from white noise of the position, m/s."""
    hz = np.linspace(0.0, rate_hz / 2.0, 2049)
    return float(np.sqrt(np.mean(motion_noise(hz, noise_m, rate_hz))))


def differentiator(taps: int, rate_hz: float, smoothing: FloatArray) -> FloatArray:
    """Return a kernel, shape (taps,), that smooths and differentiates; exact in the passband of ``smoothing``."""
    spectrum = np.fft.rfft(smoothing, 16 * taps)
    hz = np.fft.rfftfreq(16 * taps, 1.0 / rate_hz)
    turned = np.fft.irfft(spectrum * 2j * np.pi * hz * np.exp(2j * np.pi * hz / rate_hz * (taps // 2)), 16 * taps)
    return np.roll(turned, taps // 2)[:taps]


def simulate_stage(
    baseline: Fit,
    tests: Sequence[DatasetTest],
    names: tuple[str, ...],
    channel: str,
    free: Sequence[str],
    noise: float,
    keep: Sequence[str] = (),
    theta: FloatArray | None = None,
    most_steps: int = _STEPS,
) -> StageSimulation:
    """Refit the coordinates ``free`` so that ``channel`` follows from measured upstream signals ``names``.

    Args:
        baseline: the baseline, whose other coordinates are kept.
        tests: tests to fit together.
        names: measured upstream signals, as for ``upstream``.
        channel: the signal to predict and compare.
        free: names of coordinates; unknown ones are ignored.
        noise: standard deviation of that channel, SI.
        keep: further channels whose prediction is kept.
        theta: starting values; the baseline's by default.
        most_steps: most accepted steps.
    """
    parameters = baseline.parameters
    places = [parameters.index[name] for name in free if name in parameters.index]
    low, high = parameters.array("low")[places], parameters.array("high")[places]
    prior, std = parameters.array("prior")[places], parameters.array("prior_std")[places]
    start = (baseline.theta if theta is None else theta).copy()
    givens = [upstream(test, *names) for test in tests]
    masks = [(test.purpose > 0) & np.isfinite(test.signals[channel]) for test in tests]
    sigma = max(noise, LEAST_NOISE[channel])

    def simulated(values: FloatArray) -> list[dict[str, FloatArray]]:
        whole = start.copy()
        whole[places] = values
        simulations = []
        for test, given in zip(tests, givens, strict=True):
            readings = simulate_test(parameters, whole, test, given, _substeps(test, names, bool(parameters.effects)))
            simulations.append({name: np.asarray(getattr(readings, name)) for name in (channel, *keep)})
        return simulations

    def residuals(values: FloatArray) -> tuple[FloatArray, None]:
        rows = [
            np.clip(np.nan_to_num((prediction[channel] - test.signals[channel])[mask] / sigma, nan=1e6), -1e6, 1e6)
            for prediction, test, mask in zip(simulated(values), tests, masks, strict=True)
        ]
        return np.concatenate(rows), None

    def derivatives(values: FloatArray, here: FloatArray) -> FloatArray:
        columns = []
        for k, step in enumerate(steps):
            signed = step if values[k] + step <= high[k] else -step
            other = values.copy()
            other[k] += signed
            columns.append((residuals(other)[0] - here) / signed)
        return np.stack(columns, axis=1)

    if places:
        steps = parameters.array("step")[places]
        bounds = Bounds(low, high, parameters.array("reach")[places])
        problem = SecantProblem(residuals, derivatives, steps, bounds, (prior, std))
        at = problem.start(np.clip(start[places], low, high))
        start[places] = minimise(problem, at, most_steps=most_steps, tolerance=_TOLERANCE, bounds=bounds).point.theta
    predictions = {test.number: prediction for test, prediction in zip(tests, simulated(start[places]), strict=True)}
    return StageSimulation(channel, tuple(tests), start, predictions)


def _substeps(test: DatasetTest, names: tuple[str, ...], has_effects: bool) -> int:
    # Motion is slower than current: half as many steps suffice with a measured current, unless the twin has an effect.
    # Friction is stiff, and half the steps would leave errors above the noise.
    finest = int(np.ceil(1.0 / (test.sample_rate_hz * STEP_S)))
    coarse = not has_effects and ("current" in names or "motion" in names)
    return max(1, finest // 2 if coarse else finest)


def propagated_noise(baseline: Fit, tests: Sequence[DatasetTest], name: str, noise: float) -> float:
    """Return the standard deviation of the position that noise of a measured upstream signal causes, m.

    The baseline is simulated with and without white noise in the upstream signal.

    Args:
        baseline: the baseline.
        tests: some of its tests.
        name: the upstream signal, ``current`` or ``voltage``.
        noise: its standard deviation, SI.
    """
    parameters = baseline.parameters
    predicted = {
        test.number: prediction for test, prediction in zip(parameters.dataset.tests, baseline.predictions, strict=True)
    }
    squares = []
    for test in tests:
        clean = interpolated(predicted[test.number][name])
        quiet = simulate_test(parameters, baseline.theta, test, _only(name, clean)).position
        for seed in range(_DRAWS):
            noisy = clean + np.random.default_rng(seed).normal(0.0, noise, clean.size)
            moved = simulate_test(parameters, baseline.theta, test, _only(name, noisy)).position
            squares.append(float(np.nanvar(moved - quiet)))
    return float(np.sqrt(np.mean(squares))) if squares else 0.0
