"""Compiled laws of the coil: lossy inductance, heating, and tables by position and current."""

from __future__ import annotations

from math import exp
from typing import Any

from numba import njit

from firmware_sim.second_laboratory.parameters import (
    BODY_HEAT,
    CELL_CURRENT,
    COIL_HEAT,
    CURRENT,
    FORCE_CURVE,
    INDUCTANCE_CURVE,
    NODES,
    RELUCTANCE,
    SATURATION,
    Floats,
)


@njit
def table_value(p: Any, tables: Floats, row: int, place: float) -> float:
    """Return the value of a table at ``place``; constant outside."""
    where = (place - p.table_low[row]) / p.table_step[row]
    if where <= 0.0:
        return tables[row, 0]
    if where >= NODES - 1:
        return tables[row, NODES - 1]
    node = int(where)
    return tables[row, node] + (where - node) * (tables[row, node + 1] - tables[row, node])


@njit
def table_slope(p: Any, tables: Floats, row: int, place: float) -> float:
    """Return the slope of a table at ``place``; zero outside."""
    where = (place - p.table_low[row]) / p.table_step[row]
    if where <= 0.0 or where >= NODES - 1:
        return 0.0
    node = int(where)
    return (tables[row, node + 1] - tables[row, node]) / p.table_step[row]


@njit
def force_constant(p: Any, tables: Floats, y: Floats, place: float) -> float:
    """Return force per current, N/A, which is also the voltage per speed."""
    found = p.force_constant_n_per_a
    if p.tabled[FORCE_CURVE] == 1:
        found *= table_value(p, tables, FORCE_CURVE, place)
    if p.tabled[SATURATION] == 1:
        found *= table_value(p, tables, SATURATION, y[CURRENT])
    return found


@njit
def motor_force(p: Any, tables: Floats, y: Floats, constant: float, place: float) -> float:
    """Return the force of the coil on the moving mass, N."""
    force = constant * y[CURRENT]
    if p.tabled[RELUCTANCE] == 1:
        force += table_value(p, tables, RELUCTANCE, place) * y[CURRENT] ** 2
    return force


@njit
def coil_rates(
    p: Any, tables: Floats, y: Floats, rates: Floats, volts: float, constant: float, place: float, speed: float
) -> None:
    """Set the rates of the current, of the cells and of the heat.

    u = R (1 + h) i + sum_c R_c (i - j_c) + d(L i)/dt + k v, with L_c j_c' = R_c (i - j_c).
    """
    current = y[CURRENT]
    resistance = p.resistance_ohm * (1.0 + y[COIL_HEAT])
    left = volts - resistance * current - constant * speed
    for cell in range(p.cells):
        drop = p.cell_ohm[cell] * (current - y[CELL_CURRENT + cell])
        rates[CELL_CURRENT + cell] = drop / p.cell_h[cell]
        left -= drop
    inductance = p.inductance_h
    if p.tabled[INDUCTANCE_CURVE] == 1:
        left -= p.inductance_h * table_slope(p, tables, INDUCTANCE_CURVE, place) * speed * current
        inductance *= table_value(p, tables, INDUCTANCE_CURVE, place)
    rates[CURRENT] = left / inductance
    if p.heat_per_j > 0.0:
        flow = p.heat_rate_hz * (y[COIL_HEAT] - y[BODY_HEAT])
        rates[COIL_HEAT] = p.heat_per_j * resistance * current * current - flow
        rates[BODY_HEAT] = p.heat_share * flow


@njit
def bounded_exp(value: float) -> float:
    """Return exp(value), with the exponent limited to +-20 so that it stays finite."""
    return exp(min(max(value, -20.0), 20.0))
