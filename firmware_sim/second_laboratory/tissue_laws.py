"""Compiled laws of the tissue: the baseline with exponential stiffness and damping, and what effects add to it."""

from __future__ import annotations

from math import log1p, sin, tanh
from typing import Any

from numba import njit

from firmware_sim.second_laboratory.coil_laws import bounded_exp, table_value
from firmware_sim.second_laboratory.mechanics_laws import stretched
from firmware_sim.second_laboratory.parameters import (
    BRANCH,
    LATERAL,
    LAYER,
    LOOP,
    TISSUE_SLIP,
    TOUCHING,
    TWITCH,
    TWITCH_RATE,
    WORKED,
    Floats,
)


@njit
def stiffness_factor(p: Any, y: Floats, time: float) -> float:
    """Return the relative stiffness, which falls as the tissue is worked and may follow a slow wave."""
    factor = 1.0
    if p.soften_share > 0.0:
        worked = y[WORKED] / p.soften_scale
        if p.soften_kind == 2.0:
            factor -= p.soften_share * min(log1p(worked), 1.0 / p.soften_share * 0.9)
        else:
            factor -= p.soften_share * (1.0 - bounded_exp(-worked))
    if p.wave_share > 0.0:
        angle = p.wave_rad_s * time + p.wave_phase_rad
        factor *= 1.0 + p.wave_share * (sin(angle) + 0.4 * sin(2.3 * angle))
    return factor


@njit
def recruited_mass(p: Any, depth: float) -> tuple[float, float]:
    """Return the mass recruited with depth, kg, and its slope, kg/m."""
    if p.added_kg_per_m == 0.0 or depth <= 0.0:
        return 0.0, 0.0
    if p.added_length_m == 0.0:
        return p.added_kg_per_m * depth, p.added_kg_per_m
    fade = bounded_exp(-depth / p.added_length_m)
    return p.added_kg_per_m * p.added_length_m * (1.0 - fade), p.added_kg_per_m * fade


@njit
def relaxing_force(p: Any, y: Floats, rates: Floats, depth: float, elastic: float) -> float:
    """Return the force of the branches: q_j' = (e - q_j) / t_j, F = sum_j g_j (e - q_j)."""
    driving = elastic if p.branch_exponential == 1.0 else p.stiffness_n_per_m * depth
    force = 0.0
    for k in range(p.branches):
        rates[BRANCH + k] = p.branch_rate_hz[k] * (driving - y[BRANCH + k])
        force += p.branch_share[k] * (driving - y[BRANCH + k])
    return force


@njit
def hysteretic_force(p: Any, y: Floats, rates: Floats, memory: Floats, depth: float, speed: float) -> float:
    """Return the rate-independent force: Bouc-Wen loop, play elements, and sideways stick."""
    force = 0.0
    if p.loop_n > 0.0:
        loop = y[LOOP]
        sense = 1.0 if speed * loop > 0.0 else -1.0
        grown = abs(loop) ** p.loop_power * (p.loop_gamma * sense + 1.0 - p.loop_gamma)
        rates[LOOP] = speed / p.loop_yield_m * (1.0 - grown)
        force += p.loop_n * loop
    for k in range(p.tissue_slips):
        force += p.tissue_n_per_m[k] * stretched(depth, memory[TISSUE_SLIP + k], p.tissue_slip_m[k], p.tissue_slip_m[k])
    return force


@njit
def lateral_force(p: Any, memory: Floats, depth: float, elastic: float) -> float:
    """Return the force of skin that sticks to the probe sideways, limited by static friction times normal force."""
    most = p.lateral_static * max(elastic, 0.0)
    return min(max(p.lateral_n_per_m * (depth - memory[LATERAL]), -most), most)


@njit
def reflex_force(p: Any, y: Floats, rates: Floats, stretch_speed: float) -> float:
    """Return the active force of a critically damped twitch, driven by the delayed speed above its threshold."""
    drive = max(stretch_speed - p.reflex_threshold_m_s, 0.0)
    rate = p.reflex_rate_hz
    rates[TWITCH] = y[TWITCH_RATE]
    rates[TWITCH_RATE] = rate * rate * (drive - y[TWITCH]) - 2.0 * rate * y[TWITCH_RATE]
    return p.reflex_n_s_per_m * max(y[TWITCH], 0.0)


@njit
def elastic_force(p: Any, y: Floats, time: float, depth: float) -> float:
    """Return K0 exp(gK d) d with its relative stiffness, N."""
    factor = stiffness_factor(p, y, time)
    return p.stiffness_n_per_m * factor * bounded_exp(p.stiffness_rate_per_m * depth) * depth


@njit
def direction(p: Any, speed: float) -> float:
    """Return the direction of motion, -1 to 1: switched, or smooth."""
    if p.direction_speed_m_s > 0.0:
        return tanh(speed / p.direction_speed_m_s)
    return 1.0 if speed >= 0.0 else -1.0


@njit
def tissue_force(
    p: Any,
    tables: Floats,
    y: Floats,
    rates: Floats,
    memory: Floats,
    time: float,
    depth: float,
    speed: float,
    stretch_speed: float,
) -> float:
    """Return the force of the tissue against the probe, N, and set the rates of its states."""
    elastic = elastic_force(p, y, time, depth)
    viscous = p.tissue_damping_n_s_per_m * bounded_exp(p.damping_rate_per_m * depth) * speed
    if p.direction_share != 0.0:
        viscous *= 1.0 + p.direction_share * direction(p, speed)
    if p.contact_share > 0.0 and depth > 0.0:
        viscous *= 1.0 - p.contact_share * bounded_exp(-depth / p.contact_length_m)
    force = elastic + viscous
    if p.tabled[LAYER] == 1:
        force += table_value(p, tables, LAYER, depth)
    if p.branches > 0:
        force += relaxing_force(p, y, rates, depth, elastic)
    force += hysteretic_force(p, y, rates, memory, depth, speed)
    if p.lateral_n_per_m > 0.0:
        force += lateral_force(p, memory, depth, elastic)
    if p.reflex_n_s_per_m > 0.0:
        force += reflex_force(p, y, rates, stretch_speed)
    if p.soften_share > 0.0:
        rates[WORKED] = 1.0 if p.soften_kind == 1.0 else abs(speed)
    if p.contact_share > 0.0:
        force = unilateral(p, memory, depth, force)
    return force


@njit
def unilateral(p: Any, memory: Floats, depth: float, force: float) -> float:
    """Return the force of a contact that only pushes, with an adhesive pull while it lasts."""
    pulled = depth <= 0.0 or force < 0.0
    found = force * (1.0 - p.contact_share) if pulled else force
    if p.adhesion_n > 0.0 and memory[TOUCHING] > 0.0:
        found -= p.adhesion_n * min(max(1.0 + depth / p.adhesion_reach_m, 0.0), 1.0)
    return found


@njit
def remember_tissue(p: Any, y: Floats, memory: Floats, time: float, depth: float) -> None:
    """Move the slipping elements of the tissue and its contact after a step."""
    for k in range(p.tissue_slips):
        held = stretched(depth, memory[TISSUE_SLIP + k], p.tissue_slip_m[k], p.tissue_slip_m[k])
        memory[TISSUE_SLIP + k] = depth - held
    if p.lateral_n_per_m > 0.0:
        normal = max(elastic_force(p, y, time, depth), 0.0)
        held = p.lateral_n_per_m * (depth - memory[LATERAL])
        if abs(held) > p.lateral_static * normal:
            left = p.lateral_kinetic * normal
            memory[LATERAL] = depth - (left if held > 0.0 else -left) / p.lateral_n_per_m
    if p.contact_share > 0.0:
        if depth >= 0.0:
            memory[TOUCHING] = 1.0
        elif depth < -p.adhesion_reach_m:
            memory[TOUCHING] = 0.0
