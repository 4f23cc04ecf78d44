"""Free run of M(y) y'' + B(y) y' + F(y) = u with tabulated curves (Chen 2010, Eq. 3.33, F = K(y) y).

Classical Runge-Kutta with enough steps per sample that the fastest local dynamics turn by at most a quarter of a radian
per step. The force between samples is band-limited or held. A motion that diverges far from the tables is stopped and
reported.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from math import exp, tanh

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import fft, interpolate

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array
from tissueid.identification.preparation import finite_runs
from tissueid.identification.second_order import Hold

Owners = NDArray[np.int64]

MASS, DAMPING, FORCE, DIRECTION, INERTIA = range(5)
"""Kinds of parameters; the first four are also columns of the table of curves."""

_KINDS = 5
_TURNED = 4
"""Column of the table with the force that is added inwards and subtracted outwards."""


@njit(cache=True)
def free_run(
    push: Array,
    step: float,
    low: float,
    spacing: float,
    curves: Array,
    slopes: Array,
    owner: Owners,
    speed_scale: float,
    inertia: float,
    start: Array,
    bounds: Array,
) -> tuple[Array, Array, Array, int]:
    """Simulate one uninterrupted stretch of input.

    Args:
        push: input over each interval between two samples at every half step, shape (n - 1, 2 steps + 1).
        step: length of an integration step, s.
        low: position of the first row of the tables, m.
        spacing: distance of the rows, m.
        curves: mass, damping, force, direction, and the force that is added inwards and subtracted outwards, shape
            (rows, 5).
        slopes: derivative of each parameter's curve with respect to it, shape (rows, p); for mass, damping and
            direction of the curve's logarithm, for k one. Sensitivities are not computed if ``owner`` is empty.
        owner: the curve of each parameter, shape (p,).
        speed_scale: speed, m/s, over which the direction takes effect; 0 if nothing depends on direction.
        inertia: k, the share of M'(y) y'^2 that acts as a resisting force.
        start: position and speed at the first sample, shape (2,).
        bounds: lowest and highest position and largest speed of a valid motion, shape (3,).

    Returns:
        Position (n,), speed (n,), sensitivities of the position to the p parameters and the two initial values
        (n, p + 2), or (0, 0), and the number of samples done: less than n if the state left the bounds.
    """
    intervals, columns = push.shape
    steps = (columns - 1) // 2
    rows = curves.shape[0]
    p = owner.size
    position = np.empty(intervals + 1)
    speed = np.empty(intervals + 1)
    sensitivity = np.zeros((intervals + 1, p + 2)) if p > 0 else np.zeros((0, 0))
    by_position = np.zeros(p + 2)  # sensitivities of the present position and speed
    by_speed = np.zeros(p + 2)
    by_position[p] = 1.0
    by_speed[p + 1] = 1.0
    if p > 0:
        sensitivity[0, p] = 1.0

    row = np.zeros(4, np.int64)  # per Runge-Kutta stage: row in the table, and terms of the sensitivity equations
    inside = np.zeros(4)
    beyond = np.zeros(4)
    pull = np.zeros(4)
    drag = np.zeros(4)
    weight = np.zeros((4, _KINDS))
    squared = np.zeros(4)
    rate = np.zeros(4)
    velocity = np.zeros(4)
    reach = (0.0, 0.5 * step, 0.5 * step, step)
    moment = (0, 1, 1, 2)

    y, v = start[0], start[1]
    position[0], speed[0] = y, v
    for n in range(intervals):
        for part in range(steps):
            for stage in range(4):
                at, moving = y, v
                if stage > 0:
                    at += reach[stage] * velocity[stage - 1]
                    moving += reach[stage] * rate[stage - 1]
                coordinate = (at - low) / spacing
                cell = int(min(max(coordinate, 0.0), rows - 2.0))
                share = coordinate - cell
                held = min(max(share, 0.0), 1.0)
                by_depth = held == share
                more_mass = curves[cell + 1, MASS] - curves[cell, MASS]
                more_damping = curves[cell + 1, DAMPING] - curves[cell, DAMPING]
                more_force = curves[cell + 1, FORCE] - curves[cell, FORCE]
                mass = curves[cell, MASS] + held * more_mass
                damping = curves[cell, DAMPING] + held * more_damping
                force = curves[cell, FORCE] + share * more_force
                mass_slope = more_mass / spacing if by_depth else 0.0
                damping_slope = more_damping / spacing if by_depth else 0.0
                turned = 0.0
                log_slope = 0.0  # derivative of log damping with respect to speed
                turned_slope = 0.0  # derivatives of the directional force with respect to position and speed
                turned_drag = 0.0
                if speed_scale > 0.0:
                    turned = tanh(moving / speed_scale)
                    more_bias = curves[cell + 1, DIRECTION] - curves[cell, DIRECTION]
                    bias = curves[cell, DIRECTION] + held * more_bias
                    factor = exp(bias * turned)
                    damping *= factor
                    damping_slope *= factor
                    if by_depth:
                        damping_slope += damping * turned * more_bias / spacing
                    log_slope = bias * (1.0 - turned * turned) / speed_scale
                    more_turned = curves[cell + 1, _TURNED] - curves[cell, _TURNED]
                    turned_force = curves[cell, _TURNED] + held * more_turned
                    force += turned_force * turned
                    turned_drag = turned_force * (1.0 - turned * turned) / speed_scale
                    if by_depth:
                        turned_slope = turned * more_turned / spacing
                resisted = damping * moving
                shed = mass_slope * moving * moving
                acceleration = (push[n, 2 * part + moment[stage]] - resisted - force - inertia * shed) / mass
                velocity[stage] = moving
                rate[stage] = acceleration
                if p > 0:
                    row[stage], inside[stage], beyond[stage] = cell, held, share
                    stiffness = more_force / spacing + damping_slope * moving + mass_slope * acceleration
                    stiffness += turned_slope
                    if inertia != 0.0 and by_depth and 0 < cell < rows - 2:
                        more_rise = curves[cell + 2, MASS] - curves[cell + 1, MASS]
                        more_rise -= curves[cell, MASS] - curves[cell - 1, MASS]
                        stiffness += inertia * moving * moving * more_rise / (2.0 * spacing * spacing)
                    pull[stage] = -stiffness / mass
                    resistance = damping * (1.0 + log_slope * moving) + turned_drag
                    drag[stage] = -(resistance + 2.0 * inertia * mass_slope * moving) / mass
                    squared[stage] = inertia * moving * moving / spacing if by_depth else 0.0
                    weight[stage, MASS] = -acceleration - inertia * shed / mass
                    weight[stage, INERTIA] = -shed / mass
                    weight[stage, DAMPING] = -resisted / mass
                    weight[stage, FORCE] = -1.0 / mass
                    weight[stage, DIRECTION] = -resisted * turned / mass
            y += step / 6.0 * (velocity[0] + 2.0 * (velocity[1] + velocity[2]) + velocity[3])
            v += step / 6.0 * (rate[0] + 2.0 * (rate[1] + rate[2]) + rate[3])
            if not (bounds[0] < y < bounds[1] and abs(v) < bounds[2]):  # also true for NaN
                return position, speed, sensitivity, n + 1
            if p > 0:
                for j in range(p + 2):
                    a, b = by_position[j], by_speed[j]
                    sum_a = sum_b = 0.0
                    last_a = last_b = 0.0
                    for stage in range(4):
                        forcing = 0.0
                        if j < p:
                            kind = owner[j]
                            first = slopes[row[stage], j]
                            more = slopes[row[stage] + 1, j] - first
                            share = beyond[stage] if kind == FORCE else inside[stage]
                            forcing = weight[stage, kind] * (first + share * more)
                            if kind == MASS:
                                forcing -= squared[stage] * more
                        at = a + reach[stage] * last_a
                        moving = b + reach[stage] * last_b
                        last_a = moving
                        last_b = pull[stage] * at + drag[stage] * moving + forcing
                        times = 1.0 if stage == 0 or stage == 3 else 2.0
                        sum_a += times * last_a
                        sum_b += times * last_b
                    by_position[j] = a + step / 6.0 * sum_a
                    by_speed[j] = b + step / 6.0 * sum_b
        position[n + 1], speed[n + 1] = y, v
        if p > 0:
            sensitivity[n + 1] = by_position
    return position, speed, sensitivity, intervals + 1


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
        position = self.position
        last = position.size - 1
        if force < self.force[0]:
            return float(position[0] + (force - self.force[0]) * self.spacing / (self.force[1] - self.force[0]))
        if force > self.force[last]:
            rise = self.force[last] - self.force[last - 1]
            return float(position[last] + (force - self.force[last]) * self.spacing / rise)
        return float(np.interp(force, self.force, position))

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
    """Simulate one run of input by the compiled loop; arguments and return values as :func:`free_run`."""
    steps = (push.shape[1] - 1) // 2
    position, speed, sensitivity, done = free_run(
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
