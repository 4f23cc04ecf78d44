"""Free run of M(y) y'' + B(y) y' + F(y) = u with tabulated curves (Chen 2010, Eq. 3.33, F = K(y) y).

Classical Runge-Kutta with enough steps per sample that the fastest local dynamics turn by at most a quarter of a radian
per step. The force between samples is band-limited or held. A motion that diverges far from the tables is stopped and
reported.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, interpolate

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array
from tissueid.identification.dpn import kernel
from tissueid.identification.preparation import finite_runs
from tissueid.identification.second_order import Hold

STEP_RADIANS = 0.25
"""Largest phase of the fastest local dynamics per step, rad.

At 2 kHz, half of it changes the motion by less than 3e-5 of its spread for a force up to 200 Hz, and 4e-4 up to 600 Hz.
"""

STABLE_RADIANS = 2.0
"""The same limit in the extrapolated range of the curves, where the steps only have to be stable."""

MOST_STEPS = 32
"""Largest number of steps per sample; stiffer curves are not integrated."""

_EXTENSION = 64
"""Samples by which a run is extended at both ends, so that its Fourier series is smooth."""

_ROWS = 2049
_DIVERGED_WIDTHS = 20.0
"""Distance from the table, in its widths, beyond which a motion counts as diverged."""


@dataclass(frozen=True, eq=False)
class Curves:
    """Mass (kg), damping (N s/m) and force (N) at equal steps of position, each of shape (rows,).

    ``low`` is the position (m) of the first row and ``spacing`` the distance of the rows. Outside the rows, mass and
    damping are constant and the force is extrapolated linearly. With ``direction`` (rows,) and a ``speed_scale`` (m/s),
    the damping is multiplied by exp(direction * tanh(speed / speed_scale)); ``turned_force`` (rows,), N, times that
    tanh is added to the force. ``inertia`` is the share of M'(y) y'^2 that
    acts as a resisting force: 0 in Eq. 3.33, 0.5 if recruited mass keeps its energy, 1 in a Wiener system written as
    this equation. The rows within ``margin`` (m) of either end are extrapolated.
    """

    low: float
    spacing: float
    mass: Array
    damping: Array
    force: Array
    direction: Array | None = None
    speed_scale: float = 0.0
    inertia: float = 0.0
    margin: float = 0.0
    turned_force: Array | None = None

    @property
    def position(self) -> Array:
        """Position of each row, m, shape (rows,)."""
        return np.asarray(self.low + self.spacing * np.arange(self.mass.size), dtype=np.float64)

    @property
    def stiffness(self) -> Array:
        """Slope of the force, N/m, shape (rows,)."""
        return np.gradient(self.force, self.spacing)

    def table(self) -> Array:
        """Return the columns of the compiled loop's table, shape (rows, 5)."""
        none = np.zeros_like(self.mass)
        direction = none if self.direction is None else self.direction
        turned = none if self.turned_force is None else self.turned_force
        return np.ascontiguousarray(np.column_stack([self.mass, self.damping, self.force, direction, turned]))

    def rest(self, force: float) -> float:
        """Return the equilibrium position, m, under a steady force, N."""
        place = self.position
        last = place.size - 1
        if force < self.force[0]:
            return float(place[0] + (force - self.force[0]) * self.spacing / (self.force[1] - self.force[0]))
        if force > self.force[last]:
            rise = self.force[last] - self.force[last - 1]
            return float(place[last] + (force - self.force[last]) * self.spacing / rise)
        return float(np.interp(force, self.force, place))

    def steps(self, sample_rate_hz: float) -> int:
        """Return the Runge-Kutta steps per sample; above :data:`MOST_STEPS` for curves too stiff to integrate."""
        damping = self.damping if self.direction is None else self.damping * np.exp(np.abs(self.direction))
        with np.errstate(over="ignore", invalid="ignore"):
            local = np.maximum(damping / self.mass, np.sqrt(np.maximum(0.0, self.stiffness / self.mass)))  # rad/s
        visited = (self.position >= self.low + self.margin) & (self.position <= self.position[-1] - self.margin)
        radians = max(float(np.max(local[visited])) / STEP_RADIANS, float(np.max(local)) / STABLE_RADIANS)
        needed = radians / sample_rate_hz
        return max(1, math.ceil(needed)) if needed <= MOST_STEPS else MOST_STEPS + 1

    def bounds(self) -> Array:
        """Return the lowest and highest position (m) and largest speed (m/s) of a valid motion, shape (3,)."""
        width = self.spacing * (self.mass.size - 1)
        fastest = math.sqrt(float(np.max(self.stiffness / self.mass)))
        return np.array(
            [
                self.low - _DIVERGED_WIDTHS * width,
                self.low + (1.0 + _DIVERGED_WIDTHS) * width,
                10.0 * _DIVERGED_WIDTHS * width * max(fastest, 1.0),
            ]
        )


@dataclass(frozen=True, eq=False)
class FreeRun:
    """A simulated motion: position (n,), m, and speed (n,), m/s; NaN where the input is NaN.

    ``diverged_at`` is the first sample at which the motion left all bounds, None if it never did. From there to the end
    of that run of input, the position stays at the bound: finite, and far enough off for a very poor score.
    """

    position: Array
    speed: Array
    diverged_at: int | None


def tabulate_curves(position: Array, mass: Array, damping: Array, force: Array) -> Curves:
    """Return curves through points at increasing positions (k,), m, with mass (kg), damping (N s/m) and force (N), each
    (k,).

    The interpolation is the shape-preserving cubic of Fritsch and Carlson (1980), so that the force stays monotone.

    Raises:
        UnusableInputError: fewer than two points, positions or forces that do not increase, a mass that is not
            positive, or a negative damping.
    """
    if position.size < 2 or not np.all(np.diff(position) > 0.0):
        raise UnusableInputError(
            "dpn.bad_positions", "curves against depth need at least two points, at increasing positions"
        )
    if not np.all(np.diff(force) > 0.0):
        raise UnusableInputError(
            "dpn.falling_force", "the force must increase with the position: remove the points where it does not"
        )
    if not (np.all(mass > 0.0) and np.all(damping >= 0.0)):
        raise UnusableInputError(
            "dpn.bad_mass", "mass must be positive and damping not negative at every point of a curve"
        )
    grid = np.linspace(position[0], position[-1], _ROWS)
    m, b, f = (
        np.asarray(interpolate.PchipInterpolator(position, values)(grid), dtype=np.float64)
        for values in (mass, damping, force)
    )
    return Curves(float(grid[0]), float(grid[1] - grid[0]), m, b, f)


def simulate_dpn(
    curves: Curves, u: Array, sample_rate_hz: float, *, rest_input: float | None = None, hold: Hold = "band-limited"
) -> FreeRun:
    """Return the free run of tabulated curves for the input u (n,), N.

    Every uninterrupted run of input starts at rest, in equilibrium with ``rest_input``.

    Args:
        curves: see :func:`tabulate_curves`.
        u: force, N, shape (n,); where it is NaN, the motion is NaN too.
        sample_rate_hz: of u.
        rest_input: steady force, N, before every run; None for the mean of the received input.
        hold: course of the force between samples.

    Raises:
        UnusableInputError: the curves are too stiff to integrate at this sample rate, or no input was received.
    """
    u = np.asarray(u, dtype=np.float64)
    received = np.isfinite(u)
    if not received.any():
        raise UnusableInputError("dpn.no_input", "the input has no received sample to simulate from")
    steps = curves.steps(sample_rate_hz)
    if steps > MOST_STEPS:
        raise UnusableInputError(
            "dpn.too_stiff",
            (
                "the fitted mass is so small for its damping that a simulation needs {steps} steps per "
                "sample, which is too many: use fewer functions or a longer record"
            ),
            steps=steps,
        )
    start = np.array([curves.rest(float(u[received].mean()) if rest_input is None else rest_input), 0.0])
    position, speed = np.full(u.size, np.nan), np.full(u.size, np.nan)
    diverged_at: int | None = None
    table, bounds = curves.table(), curves.bounds()
    for first, end in finite_runs(received):
        push = intersample(u[first:end], steps, hold)
        y, v, _, done = integrate(curves, table, NO_SLOPES, NO_OWNERS, push, sample_rate_hz, start, bounds)
        if done < end - first:
            y[done:], v[done:] = (bounds[0] if y[done - 1] < start[0] else bounds[1]), 0.0
            diverged_at = int(first) + done if diverged_at is None else diverged_at
        position[first:end], speed[first:end] = y, v
    return FreeRun(position, speed, diverged_at)


NO_SLOPES = np.zeros((_ROWS, 0))
NO_OWNERS: NDArray[np.int64] = np.zeros(0, dtype=np.int64)


def integrate(
    curves: Curves,
    table: Array,
    slopes: Array,
    owner: NDArray[np.int64],
    push: Array,
    sample_rate_hz: float,
    start: Array,
    bounds: Array,
) -> tuple[Array, Array, Array, int]:
    """Simulate one run of input by the compiled loop; arguments and return values as :func:`kernel.free_run`."""
    steps = (push.shape[1] - 1) // 2
    position, speed, sensitivity, done = kernel.free_run(
        push,
        1.0 / (sample_rate_hz * steps),
        curves.low,
        curves.spacing,
        table,
        slopes,
        owner,
        curves.speed_scale,
        curves.inertia,
        start,
        bounds,
    )
    return position, speed, sensitivity, int(done)


def intersample(u: Array, steps: int, hold: Hold) -> Array:
    """Return the input u (n,) at every half step between samples, shape (n - 1, 2 steps + 1).

    A band-limited input is interpolated by its Fourier series. Before its first and after its last sample it is
    extended by its point reflection about that sample, which keeps the slope, faded to a constant.
    """
    halves = 2 * steps
    if hold == "zero-order" or u.size < 3:
        return np.ascontiguousarray(np.repeat(u[:-1, None], halves + 1, axis=1))
    reach = min(_EXTENSION, u.size - 1)
    length = fft.next_fast_len(u.size + 2 * reach, real=True)
    middle = 0.5 * (u[0] + u[-1])
    fade = 0.5 + 0.5 * np.cos(np.pi * np.arange(1, reach + 1) / (reach + 1))
    after = middle + (2.0 * u[-1] - u[-2 : -2 - reach : -1] - middle) * fade
    before = middle + (2.0 * u[0] - u[1 : 1 + reach] - middle) * fade
    flat = np.full(length - u.size - 2 * reach, middle)
    periodic = np.concatenate([u, after, flat, before[::-1]])
    spectrum = fft.rfft(periodic)
    if length % 2 == 0:
        spectrum[-1] *= 0.5  # upsampling divides the Nyquist bin between positive and negative frequency
    fine = fft.irfft(spectrum, length * halves) * halves  # (length * halves,)
    windows = np.lib.stride_tricks.sliding_window_view(fine, halves + 1)[::halves]
    return np.ascontiguousarray(windows[: u.size - 1], dtype=np.float64)
