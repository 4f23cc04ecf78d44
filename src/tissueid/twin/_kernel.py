"""Compiled integration loop of the chain. Private to ``simulation``."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

from tissueid.twin import bus as b


@intrinsic  # type: ignore[untyped-decorator]
def address(typing_context: Any, array: Any, offset: Any) -> Any:
    """Return the address of an element of a contiguous float64 array; the caller keeps the array alive."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        held = context.make_array(signature.args[0])(context, builder, arguments[0])
        return builder.gep(held.data, [arguments[1]])

    return types.CPointer(types.float64)(array, types.int64), generate


@intrinsic  # type: ignore[untyped-decorator]
def offset(typing_context: Any, pointer: Any, count: Any) -> Any:
    """Return the address ``count`` numbers after an address."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.gep(arguments[0], [arguments[1]])

    return pointer(pointer, types.int64), generate


@intrinsic  # type: ignore[untyped-decorator]
def call_hook(  # type: ignore[no-untyped-def]
    typing_context, hook, where, bus, p, s, dt
):
    """Call the compiled hook at an address."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        hook_type = ir.FunctionType(ir.VoidType(), [argument.type for argument in arguments[1:]])
        builder.call(builder.inttoptr(arguments[0], hook_type.as_pointer()), arguments[1:])
        return context.get_dummy_value()

    numbers = types.CPointer(types.float64)
    return types.void(types.int64, types.int64, numbers, numbers, numbers, types.float64), generate


# Parameters of the instrument, in the order of ``Instrument``.
GAIN, LIMIT, RESISTANCE, INDUCTANCE, FORCE_CONSTANT, MASS, DAMPING, WEIGHT, STROKE, FILTER_TIME = range(10)
# Parameters of the tissue, in the order of ``Tissue``.
SURFACE_M, TISSUE_MASS, TISSUE_DAMPING, DAMPING_GROWTH, STIFFNESS, STIFFNESS_GROWTH = range(6)
# The state; the acceleration is that of the previous step.
CURRENT, POSITION, VELOCITY, ACCELERATION = range(4)
# Measured signals that replace simulated ones.
VOLTAGE_GIVEN, CURRENT_GIVEN, MOTION_GIVEN = range(3)
# Rows of the output.
OUT_VOLTAGE, OUT_CURRENT, OUT_POSITION, OUT_VELOCITY = range(4)

MOST_EXPONENT = 12.0
"""Bound of the exponent of growth with depth, which prevents overflow."""


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def grown(value, growth, depth):  # type: ignore[no-untyped-def]
    """Return a coefficient that grows exponentially with depth."""
    exponent = growth * depth
    if exponent == 0.0:
        return value
    return value * math.exp(min(max(exponent, -MOST_EXPONENT), MOST_EXPONENT))


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _call(where, effects, called, bus, p, wide, s, deep, step):  # type: ignore[no-untyped-def]
    for j in range(called[where, b.SLOTS]):
        k = called[where, j]
        call_hook(effects[k], where, bus, offset(p, k * wide), offset(s, k * deep), step)


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _calls(places):  # type: ignore[no-untyped-def]
    # The effects at each place, and their number in the last column.
    called = np.zeros((b.PLACES, b.SLOTS + 1), np.int64)
    for where in range(b.PLACES):
        for k in range(b.SLOTS):
            if places[k, where]:
                called[where, called[where, b.SLOTS]] = k
                called[where, b.SLOTS] += 1
    return called


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def integrate(  # type: ignore[no-untyped-def]
    command,
    measured,
    given,
    figures,
    tissue,
    period,
    substeps,
    state,
    effects,
    places,
    parameters,
    states,
    out,
    tracking,
):
    """Simulate commands that are held over each sample; fill ``out``, shape (4, n), with readings at the end of each.

    The current is solved exactly within a step and viscous motion implicitly; both are of second order in the step.
    With ``tracking``, rad/s, an observer of this bandwidth pulls the motion towards the measured position; 0: free run.
    ``measured``, shape (4, n), holds voltage, current, position and velocity for the signals that are ``given``.
    """
    step = period / substeps
    bus = states[b.SLOTS]
    at_bus = address(bus, 0)
    wide, deep = parameters.shape[1], states.shape[1]
    at_parameters = address(parameters, 0)
    at_states = address(states, 0)
    called = _calls(places)
    used = called[:, b.SLOTS] > 0
    current, position, velocity, acceleration = state
    known_decay, kept, mean_kept = 0.0, 1.0, 1.0
    # Anti-alias filters of the readings; measured signals are filtered already.
    filtered = figures[FILTER_TIME] > 0.0 and not (given[VOLTAGE_GIVEN] or given[CURRENT_GIVEN] or given[MOTION_GIVEN])
    filter_ratio = step / figures[FILTER_TIME] if filtered else 1.0
    filter_kept = math.exp(-filter_ratio)
    read_voltage, read_current, read_position = figures[RESISTANCE] * current, current, position
    # Samples of earlier pieces of the command.
    first = bus[b.SAMPLE]
    for n in range(command.size):
        target = min(max(figures[GAIN] * command[n], -figures[LIMIT]), figures[LIMIT])
        before = max(n - 1, 0)
        for m in range(substeps):
            bus[b.TIME] = (first + n) * period + m * step
            bus[b.SAMPLE] = first + n
            bus[b.VOLTAGE] = target
            bus[b.CURRENT] = current
            bus[b.VELOCITY] = velocity
            bus[b.ACCELERATION] = acceleration
            bus[b.STROKE] = figures[STROKE]
            bus[b.VOLTAGE_RISE] = 0.0
            bus[b.VOLTAGE_TILT] = 0.0
            if given[VOLTAGE_GIVEN]:
                bus[b.VOLTAGE] = measured[0, n]
            else:
                if used[b.AMPLIFIER]:
                    _call(b.AMPLIFIER, effects, called, at_bus, at_parameters, wide, at_states, deep, step)

            if given[MOTION_GIVEN]:
                share = (m + 0.5) / substeps
                half = measured[2, before] + share * (measured[2, n] - measured[2, before])
                velocity = measured[3, before] + share * (measured[3, n] - measured[3, before])
                acceleration = 0.0
                bus[b.VELOCITY] = velocity
            else:
                if tracking > 0.0:
                    share = m / substeps
                    error = measured[2, before] + share * (measured[2, n] - measured[2, before]) - position
                    position += step * 2.0 * tracking * error
                    velocity += step * tracking * tracking * error
                half = position + 0.5 * step * velocity
            bus[b.POSITION] = half
            bus[b.SURFACE_POSITION] = tissue[SURFACE_M]
            bus[b.SURFACE_VELOCITY] = 0.0
            bus[b.FRAME_ACCELERATION] = 0.0
            if used[b.SURFACE]:
                _call(b.SURFACE, effects, called, at_bus, at_parameters, wide, at_states, deep, step)
            depth = half - bus[b.SURFACE_POSITION]
            bus[b.DEPTH] = depth

            bus[b.RESISTANCE] = figures[RESISTANCE]
            bus[b.INDUCTANCE] = figures[INDUCTANCE]
            bus[b.FORCE_CONSTANT] = figures[FORCE_CONSTANT]
            bus[b.OPPOSING_VOLTAGE] = 0.0
            bus[b.FORCE] = figures[WEIGHT]
            if used[b.COIL]:
                _call(b.COIL, effects, called, at_bus, at_parameters, wide, at_states, deep, step)
            decay = bus[b.RESISTANCE] * step / bus[b.INDUCTANCE]
            if decay != known_decay:
                known_decay, kept = decay, math.exp(-decay)
                mean_kept = (1.0 - kept) / decay
            if given[CURRENT_GIVEN]:
                # Between two readings the current settles with the coil's time constant, well within the interval.
                transient = (measured[1, before] - measured[1, n]) * math.exp(-decay * m)
                mean = measured[1, n] + transient * mean_kept
                current = measured[1, n] + transient * kept
            else:
                middle = velocity + 0.5 * step * acceleration
                before_step = current
                driving = bus[b.VOLTAGE] - bus[b.OPPOSING_VOLTAGE] - bus[b.FORCE_CONSTANT] * middle
                settled = driving / bus[b.RESISTANCE]
                mean = settled + (current - settled) * mean_kept
                current = settled + (current - settled) * kept
                # A ramp around the mean voltage changes the current at the end of the step, and its mean inversely.
                tilted = bus[b.VOLTAGE_TILT] / bus[b.RESISTANCE] * (1.0 + kept - 2.0 * mean_kept)
                current += tilted
                mean -= tilted / decay
                if filtered:
                    difference = filter_ratio - decay
                    if abs(difference) < 1e-6:
                        share = filter_ratio * filter_kept
                    else:
                        share = filter_ratio * (kept - filter_kept) / difference
                    read_current = (
                        settled + (read_current - settled) * filter_kept + (before_step - settled) * share + tilted
                    )
                    read_voltage = bus[b.VOLTAGE] + (read_voltage - bus[b.VOLTAGE]) * filter_kept
            bus[b.CURRENT] = mean

            if not given[MOTION_GIVEN]:
                bus[b.FORCE] += bus[b.FORCE_CONSTANT] * mean
                bus[b.DAMPING] = figures[DAMPING]
                bus[b.MASS] = figures[MASS]
                if used[b.MECHANICS]:
                    _call(b.MECHANICS, effects, called, at_bus, at_parameters, wide, at_states, deep, step)
                bus[b.STIFFNESS] = tissue[STIFFNESS]
                bus[b.STIFFNESS_GROWTH] = tissue[STIFFNESS_GROWTH]
                bus[b.VELOCITY] -= bus[b.SURFACE_VELOCITY]
                if used[b.LIFT_OFF]:
                    _call(b.LIFT_OFF, effects, called, at_bus, at_parameters, wide, at_states, deep, step)
                    depth = bus[b.DEPTH]
                bus[b.TISSUE_FORCE] = grown(tissue[STIFFNESS], tissue[STIFFNESS_GROWTH], depth) * depth
                bus[b.TISSUE_DAMPING] = grown(tissue[TISSUE_DAMPING], tissue[DAMPING_GROWTH], depth)
                bus[b.TISSUE_MASS] = tissue[TISSUE_MASS]
                if used[b.TISSUE]:
                    bus[b.VELOCITY_JUMP] = 0.0
                    bus[b.POSITION_SHIFT] = 0.0
                    _call(b.TISSUE, effects, called, at_bus, at_parameters, wide, at_states, deep, step)
                    velocity += bus[b.VELOCITY_JUMP]
                    half += 0.5 * step * bus[b.VELOCITY_JUMP] + bus[b.POSITION_SHIFT]
                mass = bus[b.MASS] + bus[b.TISSUE_MASS]
                drag = 0.5 * step * (bus[b.DAMPING] + bus[b.TISSUE_DAMPING]) / mass
                carried = bus[b.TISSUE_DAMPING] * bus[b.SURFACE_VELOCITY]
                push = step * (bus[b.FORCE] - bus[b.TISSUE_FORCE] + carried) / mass
                then = (velocity * (1.0 - drag) + push) / (1.0 + drag)
                acceleration = (then - velocity) / step
                velocity = then
                earlier = position
                position = half + 0.5 * step * velocity
                if filtered:
                    # The position as a ramp over the step.
                    late = (position - earlier) / filter_ratio
                    read_position = position - late + (read_position - earlier + late) * filter_kept
        out[OUT_VOLTAGE, n] = bus[b.VOLTAGE] + bus[b.VOLTAGE_RISE]
        out[OUT_CURRENT, n] = current
        out[OUT_POSITION, n] = measured[2, n] if given[MOTION_GIVEN] else position
        out[OUT_VELOCITY, n] = velocity
        if filtered:
            out[OUT_VOLTAGE, n] = read_voltage
            out[OUT_CURRENT, n] = read_current
            out[OUT_POSITION, n] = read_position
    state[CURRENT] = current
    state[POSITION] = position
    state[VELOCITY] = velocity
    state[ACCELERATION] = acceleration
