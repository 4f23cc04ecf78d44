"""Compiled laws of the moving part without the tissue: friction, drag, bumper, cable and frame."""

from __future__ import annotations

from math import cos
from typing import Any

from numba import njit

from firmware_sim.second_laboratory.coil_laws import bounded_exp, table_value
from firmware_sim.second_laboratory.parameters import (
    BEARING_SLIP,
    BRISTLE,
    FRAME,
    FRAME_SPEED,
    POSITION_FORCE,
    Floats,
)


@njit
def stretched(place: float, anchor: float, push: float, pull: float) -> float:
    """Return the stretch of a slipping element, which holds between ``-pull`` and ``push``."""
    return min(max(place - anchor, -pull), push)


@njit
def bristle_force(p: Any, y: Floats, rates: Floats, speed: float) -> float:
    """Return the force of the bristles, and set their rate: z' = v - s0 |v| z / g(v), F = s0 z + s1 z'."""
    pushing = speed >= 0.0
    level = p.coulomb_n[0] if pushing else p.coulomb_n[1]
    if p.stribeck_m_s > 0.0:
        ratio = speed / p.stribeck_m_s
        level *= 1.0 + (p.static_ratio - 1.0) * bounded_exp(-ratio * ratio)
    bend = y[BRISTLE]
    rate = speed - p.bristle_n_per_m * abs(speed) * bend / level
    rates[BRISTLE] = rate
    return p.bristle_n_per_m * bend + p.bristle_n_s_per_m * rate


@njit
def mechanical_resistance(
    p: Any, tables: Floats, y: Floats, rates: Floats, memory: Floats, place: float, speed: float
) -> float:
    """Return the force against motion of the moving part relative to the frame, N, and set the bristle's rate."""
    force = p.damping_n_s_per_m * speed
    if p.bristle_n_per_m > 0.0:
        force += bristle_force(p, y, rates, speed)
    for k in range(p.bearing_slips):
        force += p.bearing_n_per_m[k] * stretched(
            place, memory[BEARING_SLIP + k], p.bearing_push_m[k], p.bearing_pull_m[k]
        )
    if p.drag_n > 0.0 and speed != 0.0:
        drag = p.drag_n * abs(speed) ** p.drag_power
        force += drag if speed > 0.0 else -drag
    if p.stop_n_per_m > 0.0:
        depth = p.stop_side * (place - p.stop_m)
        if depth > 0.0:
            pressed = p.stop_n_per_m * depth + p.stop_n_per_m3 * depth**3
            force += p.stop_side * max(pressed + p.stop_n_s_per_m * p.stop_side * speed, 0.0)
    if p.tabled[POSITION_FORCE] == 1:
        force -= table_value(p, tables, POSITION_FORCE, place)
    if p.cable_n_per_m > 0.0:
        away = place - p.cable_middle_m
        slack = p.cable_slack_m
        if away > slack:
            force += p.cable_n_per_m * (away - slack) + p.cable_n_s_per_m * speed
        elif away < -slack:
            force += p.cable_n_per_m * (away + slack) + p.cable_n_s_per_m * speed
    if p.periodic_drag_n_s_per_m > 0.0:
        wave = cos(p.periodic_drag_rad_per_m * place + p.periodic_drag_phase_rad)
        force += p.periodic_drag_n_s_per_m * (1.0 + wave) * speed
    return force


@njit
def frame_rates(p: Any, y: Floats, rates: Floats, inner: float) -> None:
    """Set the rates of the frame, on which ``inner`` (motor less resistance, N) acts in the opposite direction."""
    if p.frame_ratio > 0.0:
        rates[FRAME] = y[FRAME_SPEED]
        rates[FRAME_SPEED] = (
            -inner * p.frame_ratio / p.mass_kg
            - p.frame_rad_s**2 * y[FRAME]
            - 2.0 * p.frame_damping_ratio * p.frame_rad_s * y[FRAME_SPEED]
        )


@njit
def remember_bearing(p: Any, memory: Floats, place: float) -> None:
    """Move the slipping elements of the bearing after a step."""
    for k in range(p.bearing_slips):
        held = stretched(place, memory[BEARING_SLIP + k], p.bearing_push_m[k], p.bearing_pull_m[k])
        memory[BEARING_SLIP + k] = place - held
