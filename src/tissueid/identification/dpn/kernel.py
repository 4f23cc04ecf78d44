"""Compiled free run of the dynamic parameter nonlinearity, with its sensitivities.

M(y) y'' + k M'(y) y'^2 + B(y) y' + F(y) = u (Chen 2010, Eq. 3.33 with F = K(y) y and k = 0), where damping and force
may depend on the direction of motion (5.4), classical Runge-Kutta of
order four with a fixed number of steps per sample. The sensitivities are the exact derivatives of the Runge-Kutta
steps, not of the differential equation, so that they are consistent with the minimised error.

Curves are tables over equal steps of position, interpolated linearly. Outside the table, mass, damping and direction
keep their end values and the force is extrapolated linearly.
"""

from __future__ import annotations

from math import exp, tanh

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
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
                place = (at - low) / spacing
                cell = int(min(max(place, 0.0), rows - 2.0))
                share = place - cell
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
