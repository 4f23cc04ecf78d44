"""Each stage by itself: everything upstream measured, its few own figures refitted, its own output compared.

Stage-wise substitution: a simulation model of subsystems in series is judged one subsystem at a time by driving each
with the measured output of the one before (MIL/HIL practice; Oberkampf and Roy, Verification and Validation in
Scientific Computing, 2010, ch. 12). What a refit within the calibration's uncertainty takes away is no fault of the
stage.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.signal import firwin

from tissueid.gap.driving import bridged
from tissueid.gap.fitting import Fit
from tissueid.gap.observed import LEAST_NOISE, ObservedTest
from tissueid.gap.playing import STEP_S, played
from tissueid.twin.simulation import NOTHING_GIVEN, Given

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
"""Motion above this is below the position's noise: force falls off, and what moves is a mass."""
_TAPS = 61
_STEPS = 14
_TOLERANCE = 1e-4
_DRAWS = 3
"""Realisations of the noise that are carried through the baseline."""


@dataclass(frozen=True)
class Substituted:
    """One question put to some tests: what a stage makes of measured upstream signals, after its own refit.

    ``predicted`` and ``residual`` (recorded less predicted) hold, by test number, arrays of shape (n,), SI, NaN where
    nothing was recorded. ``theta`` is the whole vector of coordinates, with those of the stage refitted.
    """

    channel: str
    tests: tuple[ObservedTest, ...]
    theta: FloatArray
    predicted: dict[int, dict[str, FloatArray]] = field(repr=False)

    def residual(self, test: ObservedTest, channel: str = "") -> FloatArray:
        """Recorded less predicted in a test, shape (n,), SI."""
        name = channel or self.channel
        return np.asarray(test.signals[name] - self.predicted[test.number][name], np.float64)


def upstream(test: ObservedTest, *names: str) -> Given:
    """Measured signals of a test without gaps: ``voltage``, ``current``, and ``motion`` for position and velocity."""
    if not names:
        return NOTHING_GIVEN
    position, velocity = motion(test) if "motion" in names else (None, None)
    return Given(
        bridged(test.signals["voltage"]) if "voltage" in names else None,
        bridged(test.signals["current"]) if "current" in names else None,
        position,
        velocity,
    )


def motion(test: ObservedTest, instead: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Position (m) and velocity (m/s) below ``MOTION_HZ``, shape (n,) each: of the reading, or of one ``instead``."""
    position = bridged(test.signals["position"] if instead is None else instead)
    taps = min(_TAPS, 2 * (position.size // 8) + 1)
    kernel = firwin(taps, min(MOTION_HZ, 0.4 * test.sample_rate_hz), fs=test.sample_rate_hz)
    half = taps // 2
    # Both ends continue by odd reflection, so that neither level nor slope jumps there.
    padded = np.concatenate(
        [2 * position[0] - position[half:0:-1], position, 2 * position[-1] - position[-2 : -half - 2 : -1]]
    )
    smooth = np.convolve(padded, kernel, "valid")
    # Differences by the spectrum would ring at the ends; a long antisymmetric kernel is as exact below the cut.
    rate = differentiator(taps, test.sample_rate_hz, kernel)
    return smooth, np.convolve(padded, rate, "valid")


def motion_noise(hz: FloatArray, noise_m: float, rate_hz: float) -> FloatArray:
    """Power of the velocity's noise a sample at frequencies, shape as ``hz``, (m/s)^2: white noise differentiated."""
    kernel = firwin(_TAPS, min(MOTION_HZ, 0.4 * rate_hz), fs=rate_hz)
    passed = np.abs(np.fft.rfft(kernel, 4096))
    passed = np.interp(hz, np.fft.rfftfreq(4096, 1.0 / rate_hz), passed)
    return np.asarray((2.0 * np.pi * hz * passed * noise_m) ** 2)


def velocity_noise(noise_m: float, rate_hz: float) -> float:
    """Standard deviation of the velocity that white noise of the position makes, m/s."""
    hz = np.linspace(0.0, rate_hz / 2.0, 2049)
    return float(np.sqrt(np.mean(motion_noise(hz, noise_m, rate_hz))))


def differentiator(taps: int, rate_hz: float, smoothing: FloatArray) -> FloatArray:
    """A kernel, shape (taps,), that smooths and differentiates: exact where ``smoothing`` passes."""
    spectrum = np.fft.rfft(smoothing, 16 * taps)
    hz = np.fft.rfftfreq(16 * taps, 1.0 / rate_hz)
    turned = np.fft.irfft(spectrum * 2j * np.pi * hz * np.exp(2j * np.pi * hz / rate_hz * (taps // 2)), 16 * taps)
    return np.roll(turned, taps // 2)[:taps]


def substitute(
    baseline: Fit,
    tests: Sequence[ObservedTest],
    names: tuple[str, ...],
    channel: str,
    free: Sequence[str],
    noise: float,
    keep: Sequence[str] = (),
    theta: FloatArray | None = None,
    most_steps: int = _STEPS,
) -> Substituted:
    """Refit the coordinates ``free`` so that ``channel`` follows from measured upstream signals ``names``.

    Args:
        baseline: whose other coordinates stay.
        tests: to be explained together.
        names: what is measured upstream, as ``upstream`` takes it.
        channel: the signal that is predicted and compared.
        free: names of coordinates; those that the baseline does not have are ignored.
        noise: standard deviation of that channel, SI.
        keep: further channels whose prediction is kept.
        theta: where to start; the baseline's by default.
        most_steps: most accepted steps.
    """
    parameters = baseline.parameters
    places = [parameters.index[name] for name in free if name in parameters.index]
    low, high = parameters.array("low")[places], parameters.array("high")[places]
    prior, std = parameters.array("prior")[places], parameters.array("prior_std")[places]
    start = (baseline.theta if theta is None else theta).copy()
    givens = [upstream(test, *names) for test in tests]
    masks = [_used(test, channel) for test in tests]
    sigma = max(noise, LEAST_NOISE[channel])

    def simulated(values: FloatArray) -> list[dict[str, FloatArray]]:
        whole = start.copy()
        whole[places] = values
        found = []
        for test, given in zip(tests, givens, strict=True):
            readings = played(parameters, whole, test, given, _substeps(test, names, bool(parameters.effects)))
            found.append({name: np.asarray(getattr(readings, name)) for name in (channel, *keep)})
        return found

    def residuals(values: FloatArray) -> FloatArray:
        rows = [
            np.clip(np.nan_to_num((one[channel] - test.signals[channel])[mask] / sigma, nan=1e6), -1e6, 1e6)
            for one, test, mask in zip(simulated(values), tests, masks, strict=True)
        ]
        return np.concatenate([*rows, (values - prior) / std])

    if places:
        steps = parameters.array("step")[places]
        start[places] = bounded_least_squares(
            residuals, np.clip(start[places], low, high), low, high, steps, most_steps
        )
    predictions = {test.number: one for test, one in zip(tests, simulated(start[places]), strict=True)}
    return Substituted(channel, tuple(tests), start, predictions)


def _used(test: ObservedTest, channel: str) -> NDArray[np.bool_]:
    return (test.purpose > 0) & np.isfinite(test.signals[channel])


def _substeps(test: ObservedTest, names: tuple[str, ...], has_effects: bool) -> int:
    # What moves is slower than the coil: where the current is measured half as many steps serve, unless the twin has
    # an effect. Friction that sticks is stiff, and half the steps leave errors above the noise.
    finest = int(np.ceil(1.0 / (test.sample_rate_hz * STEP_S)))
    coarse = not has_effects and ("current" in names or "motion" in names)
    return max(1, finest // 2 if coarse else finest)


def carried_noise(baseline: Fit, tests: Sequence[ObservedTest], name: str, noise: float) -> float:
    """Return the standard deviation of the position that noise of a measured upstream signal causes, m.

    The simulated signal is played through the baseline with and without white noise added.

    Args:
        baseline: whose predictions and coordinates are used.
        tests: some of the baseline's.
        name: the upstream signal, ``current`` or ``voltage``.
        noise: its standard deviation, SI.
    """
    parameters = baseline.parameters
    predicted = {test.number: one for test, one in zip(parameters.observed.tests, baseline.predictions, strict=True)}
    squares = []
    for test in tests:
        clean = bridged(predicted[test.number][name])
        quiet = played(parameters, baseline.theta, test, Given(**{name: clean})).position
        for seed in range(_DRAWS):
            noisy = clean + np.random.default_rng(seed).normal(0.0, noise, clean.size)
            moved = played(parameters, baseline.theta, test, Given(**{name: noisy})).position
            squares.append(float(np.nanvar(moved - quiet)))
    return float(np.sqrt(np.mean(squares))) if squares else 0.0


def bounded_least_squares(
    residuals: Callable[[FloatArray], FloatArray],
    start: FloatArray,
    low: FloatArray,
    high: FloatArray,
    steps: FloatArray,
    most_steps: int = _STEPS,
) -> FloatArray:
    """Where a sum of squares is least within bounds, shape (n,): Levenberg-Marquardt with secants (Broyden 1965).

    Args:
        residuals: of a vector, shape (m,).
        start: where to begin, shape (n,).
        low: lower bounds.
        high: upper bounds.
        steps: of the derivatives.
        most_steps: most accepted steps.
    """

    def derivatives(at: FloatArray, here: FloatArray) -> FloatArray:
        columns = []
        for k, step in enumerate(steps):
            signed = step if at[k] + step <= high[k] else -step
            other = at.copy()
            other[k] += signed
            columns.append((residuals(other) - here) / signed)
        return np.stack(columns, axis=1)

    theta = start.copy()
    here = residuals(theta)
    jacobian, fresh = derivatives(theta, here), True
    cost, damping, taken = float(here @ here), 1e-4, 0
    while taken < most_steps and damping < 1e4:
        slope = jacobian.T @ here
        free = ~(((theta <= low) & (slope > 0.0)) | ((theta >= high) & (slope < 0.0)))
        if not free.any():
            break
        inner = (jacobian.T @ jacobian)[np.ix_(free, free)]
        moved = np.zeros_like(theta)
        moved[free] = -np.linalg.solve(inner + damping * np.diag(np.maximum(np.diag(inner), 1e-12)), slope[free])
        trial = np.clip(theta + moved, low, high)
        moved = trial - theta
        then = residuals(trial)
        gain = cost - float(then @ then)
        if gain > 0.0:
            expected = here + jacobian @ moved
            scaled = moved / steps
            jacobian = jacobian + np.outer(then - expected, scaled / steps) / float(scaled @ scaled)
            poor = gain < 0.5 * (cost - float(expected @ expected))
            theta, here, cost, taken, damping = trial, then, cost - gain, taken + 1, max(damping / 5.0, 1e-9)
            small = gain < _TOLERANCE * (cost + gain)
            if small and fresh:
                break
            fresh = small or poor
            if fresh and taken < most_steps:
                jacobian = derivatives(theta, here)
        elif not fresh:
            jacobian, fresh = derivatives(theta, here), True
        else:
            damping *= 10.0
    return theta
