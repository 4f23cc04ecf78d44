"""Compiled part of the plant: equations of motion, contact events and the integration loop.

One call of :func:`advance` integrates a block of samples. Each hold interval is divided into equal sub-steps of
classical Runge-Kutta of order four. If contact is made or lost within a sub-step, the event is located in time and the
sub-step is continued from there, so that the order of the method is kept. Units are SI; positions increase into the
tissue on the actuator scale.
"""

from __future__ import annotations

from math import exp, pi, tanh

import numpy as np
from numba import njit
from numpy.typing import NDArray

from firmware_sim.layers import LAYER_VALUES, MAX_LAYERS, layer_values

Array = NDArray[np.float64]

MAX_BRANCHES = 3
"""Largest number of relaxation branches of a tissue."""

# State vector.
CURRENT, POSITION, VELOCITY, SURFACE, SURFACE_VELOCITY, TEMPERATURE = range(6)
LATENT, LATENT_VELOCITY = 6, 7  # Wiener kind: state of the linear block before the static curve
BRANCH = 8  # MAX_BRANCHES low-passed elastic forces, N
FILTER = BRANCH + MAX_BRANCHES  # first-order anti-alias filters of voltage, current, position, temperature
SENSOR = FILTER + 4  # temperature of the sensor, which lags the winding
TOUCHING = SENSOR + 1  # 1 while probe and tissue move together; switched, not integrated
STATE_SIZE = TOUCHING + 1

# Kinds of tissue.
PARALLEL, WIENER, HAMMERSTEIN = 0, 1, 2

# Plant parameters, in the order of plant.PlantParameters.
(
    RESISTANCE,
    INDUCTANCE,
    FORCE_CONSTANT,
    MOVING_MASS,
    BEARING_DAMPING,
    GRAVITY_FORCE,
    AMPLIFIER_GAIN,
    AMPLIFIER_LIMIT,
    STROKE,
    STOP_STIFFNESS,
    STOP_DAMPING,
    THERMAL_RESISTANCE,
    HEAT_CAPACITY,
    AMBIENT,
    FILTER_CUTOFF,
    SENSOR_LAG,
) = range(16)
# Followed by the state of the wire, and the relative force constant along the stroke as pairs of value and slope (per
# node spacing) at equal distances. Without nodes it is constant.
COIL_OPEN, PROFILE_NODES, PROFILE_START, PROFILE_SPACING, PROFILE = 16, 17, 18, 19, 20

# Tissue parameters, in the order of tissue.Tissue.to_array.
KIND, REST_SURFACE, CONTACT = 0, 1, 2
MASS, DAMPING, STIFFNESS = 3, 6, 9  # coefficient, rate (1/m), offset of coefficient * (exp(rate * depth) + offset)
CURVE_SCALE, CURVE_RATE = 12, 13  # Wiener C1 (m), C2 (1/N); Hammerstein H1 (N), H2 (1/N)
DIRECTION_RATIO, DIRECTION_SPEED = 14, 15
RECRUITED_MASS, RECRUITMENT_DEPTH = 16, 17
BRANCH_GAIN, BRANCH_TIME = 18, 18 + MAX_BRANCHES
PULLED = 18 + 2 * MAX_BRANCHES  # rates (1/m) of mass, damping, stiffness when the tissue is pulled; 0: as pushed
PROBE_RADIUS, PROBE_CORNER, PROBE_DEPTH, FOUNDATION = range(PULLED + 3, PULLED + 7)  # see firmware_sim.probe
LAYER_COUNT, LAYERS = PULLED + 7, PULLED + 8  # MAX_LAYERS layers, see firmware_sim.layers
REST_VELOCITY = LAYERS + LAYER_VALUES * MAX_LAYERS  # speed of the rest surface against the frame, m/s
FRAME_ACCELERATION = REST_VELOCITY + 1  # acceleration of the frame, m/s^2; the probe's own inertia is a force on it
TISSUE_SIZE = FRAME_ACCELERATION + 1

# Columns of the output of advance.
OUT_COLUMNS = 11
_EVENTS_PER_STEP = 6
_LOCATE_ITERATIONS = 40

# Divisors are never zero, so checks for it are disabled, and calls are inlined. This saves 40 % of the time without any
# change of the result.
_swift = njit(error_model="numpy", forceinline=True)


@_swift
def _exponential(tissue: Array, first: int, depth: float) -> float:
    # The exponential is skipped for a constant law, which is exact: exp(0) is 1.
    rate = tissue[first + 1]
    if depth < 0.0 and tissue[PULLED + (first - MASS) // 3] != 0.0:
        rate = -tissue[PULLED + (first - MASS) // 3]
    return tissue[first] * ((1.0 if rate == 0.0 else exp(rate * depth)) + tissue[first + 2])


@_swift
def _probe_factor(tissue: Array, depth: float) -> float:
    # Factor of stiffness and damping of a probe other than the reference probe (firmware_sim.probe).
    ratio = tissue[PROBE_RADIUS]
    if ratio == 0.0:
        return 1.0
    scale = tissue[PROBE_DEPTH]
    if scale > 0.0:
        ratio -= tissue[PROBE_CORNER] * scale / (max(depth, 0.0) ** 1.5 + scale**1.5) ** (2.0 / 3.0)
    return (1.0 - tissue[FOUNDATION]) * ratio + tissue[FOUNDATION] * ratio * ratio


@_swift
def _layered(tissue: Array, depth: float) -> tuple[float, float, float, float]:
    # Force, damping, mass and slope of mass of the layers; the caller checks that there are any.
    return layer_values(tissue, LAYERS, int(tissue[LAYER_COUNT]), depth)


@_swift
def elastic_force(tissue: Array, depth: float) -> float:
    """Return the relaxed elastic force, newtons, at a depth in metres: K(y) y (thesis Eq. 3.33), and the layers'."""
    force = _exponential(tissue, STIFFNESS, depth) * depth
    if tissue[LAYER_COUNT] > 0.0:
        force += _layered(tissue, depth)[0]
    return force * _probe_factor(tissue, depth)


@_swift
def tissue_mass(tissue: Array, depth: float) -> float:
    """Return the mass of tissue that moves with its surface, kilograms, including recruited mass."""
    mass = _exponential(tissue, MASS, depth)
    if depth > 0.0 and tissue[RECRUITED_MASS] != 0.0:
        mass += tissue[RECRUITED_MASS] * (1.0 - exp(-depth / tissue[RECRUITMENT_DEPTH]))
    if tissue[LAYER_COUNT] > 0.0:
        mass += _layered(tissue, depth)[2]
    return mass


@_swift
def tissue_resistance(state: Array, tissue: Array, depth: float, speed: float) -> tuple[float, float]:
    """Return the resisting and the elastic force of the tissue, N, at a depth, m, and a speed, m/s."""
    # Total resisting force of the tissue at this depth and speed against the frame, without inertia, and its relaxed
    # elastic part, N.
    velocity = speed - tissue[REST_VELOCITY]
    elastic = _exponential(tissue, STIFFNESS, depth) * depth
    damping = _exponential(tissue, DAMPING, depth)
    mass_slope = 0.0
    if depth > 0.0 and tissue[RECRUITED_MASS] != 0.0:
        mass_slope = tissue[RECRUITED_MASS] / tissue[RECRUITMENT_DEPTH] * exp(-depth / tissue[RECRUITMENT_DEPTH])
    if tissue[LAYER_COUNT] > 0.0:
        pressed, lossy, _, rising = _layered(tissue, depth)
        elastic += pressed
        damping += lossy
        mass_slope += rising
    factor = _probe_factor(tissue, depth)
    elastic *= factor
    # Half of dM/dy v^2 conserves kinetic energy when mass is recruited or released.
    force = elastic + 0.5 * mass_slope * velocity * velocity
    direction = 1.0
    if tissue[DIRECTION_RATIO] != 0.0:
        direction += tissue[DIRECTION_RATIO] * tanh(velocity / tissue[DIRECTION_SPEED])
    force += factor * damping * direction * velocity
    for k in range(MAX_BRANCHES):
        force += tissue[BRANCH_GAIN + k] * (elastic - state[BRANCH + k])
    return force, elastic


@_swift
def _end_stop(plant: Array, position: float, velocity: float) -> float:
    # One-sided springs beyond either end; the damping grows with penetration and never pulls.
    over = position - plant[STROKE]
    if over > 0.0:
        return -plant[STOP_STIFFNESS] * over * max(0.0, 1.0 + plant[STOP_DAMPING] * velocity)
    if position < 0.0:
        return -plant[STOP_STIFFNESS] * position * max(0.0, 1.0 - plant[STOP_DAMPING] * velocity)
    return 0.0


@_swift
def _wiener_output(tissue: Array, latent: float, latent_velocity: float) -> tuple[float, float]:
    # Position and velocity of the probe after the static curve.
    decay = exp(-tissue[CURVE_RATE] * tissue[STIFFNESS] * latent)
    position = tissue[REST_SURFACE] + tissue[CURVE_SCALE] * (1.0 - decay)
    return position, tissue[CURVE_SCALE] * tissue[CURVE_RATE] * tissue[STIFFNESS] * decay * latent_velocity


@_swift
def _contact_force(state: Array, plant: Array, tissue: Array) -> float:
    # Force of the tissue on the probe while in contact, N.
    velocity = state[VELOCITY]
    depth = state[POSITION] - tissue[REST_SURFACE]
    resistance, _ = tissue_resistance(state, tissue, depth, velocity)
    probe = _probe_force(state, plant)
    mass = tissue_mass(tissue, depth)
    together = (probe - resistance) / (plant[MOVING_MASS] + mass) + tissue[FRAME_ACCELERATION]
    return resistance + mass * together


@_swift
def _force_constant(plant: Array, position: float) -> float:
    # N/A, which is V s/m as well, at a position: cubic Hermite between the nodes, constant beyond them.
    nodes = int(plant[PROFILE_NODES])
    if nodes == 0:
        return plant[FORCE_CONSTANT]
    along = (position - plant[PROFILE_START]) / plant[PROFILE_SPACING]
    along = min(max(along, 0.0), nodes - 1.0)
    k = min(int(along), nodes - 2)
    t = along - k
    first = PROFILE + 2 * k
    value, slope = plant[first], plant[first + 1]
    rise = plant[first + 2] - value
    bend = 3.0 * rise - 2.0 * slope - plant[first + 3]
    twist = slope + plant[first + 3] - 2.0 * rise
    return plant[FORCE_CONSTANT] * (value + t * (slope + t * (bend + t * twist)))


@_swift
def _probe_force(state: Array, plant: Array) -> float:
    # Sum of all forces on the moving part except that of the tissue, N.
    return (
        _force_constant(plant, state[POSITION]) * state[CURRENT]
        + plant[GRAVITY_FORCE]
        - plant[BEARING_DAMPING] * state[VELOCITY]
        + _end_stop(plant, state[POSITION], state[VELOCITY])
    )


@_swift
def _derivative(state: Array, rate: Array, row: int, volts: float, plant: Array, tissue: Array) -> None:
    # Written into a row of ``rate``: creating a view each time would cost reference counting.
    current = state[CURRENT]
    kind = tissue[KIND]
    if kind == WIENER:
        state[POSITION], state[VELOCITY] = _wiener_output(tissue, state[LATENT], state[LATENT_VELOCITY])
    position, velocity = state[POSITION], state[VELOCITY]
    depth = position - tissue[REST_SURFACE]
    force_constant = _force_constant(plant, position)
    back_emf = force_constant * velocity
    rate[row, CURRENT] = (volts - plant[RESISTANCE] * current - back_emf) / plant[INDUCTANCE]
    if plant[COIL_OPEN] > 0.0:
        rate[row, CURRENT] = 0.0
    heating = plant[RESISTANCE] * current * current
    cooling = (state[TEMPERATURE] - plant[AMBIENT]) / plant[THERMAL_RESISTANCE]
    rate[row, TEMPERATURE] = (heating - cooling) / plant[HEAT_CAPACITY]
    rate[row, POSITION] = velocity
    corner = 2.0 * pi * plant[FILTER_CUTOFF]
    rate[row, FILTER] = corner * (volts - state[FILTER])
    rate[row, FILTER + 1] = corner * (current - state[FILTER + 1])
    rate[row, FILTER + 2] = corner * (position - state[FILTER + 2])
    rate[row, FILTER + 3] = corner * (state[SENSOR] - state[FILTER + 3])
    rate[row, SENSOR] = (state[TEMPERATURE] - state[SENSOR]) / plant[SENSOR_LAG]
    stop = _end_stop(plant, position, velocity)
    if kind == WIENER:
        drive = force_constant * current + plant[GRAVITY_FORCE] + stop
        rate[row, LATENT] = state[LATENT_VELOCITY]
        opposing = tissue[DAMPING] * state[LATENT_VELOCITY] + tissue[STIFFNESS] * state[LATENT]
        rate[row, LATENT_VELOCITY] = (drive - opposing) / tissue[MASS]
        return
    if kind == HAMMERSTEIN:
        drive = force_constant * current + plant[GRAVITY_FORCE]
        drive = tissue[CURVE_SCALE] * (1.0 - exp(-tissue[CURVE_RATE] * drive))
        opposing = tissue[DAMPING] * velocity + tissue[STIFFNESS] * depth
        rate[row, VELOCITY] = (drive + stop - opposing) / tissue[MASS]
        return
    probe = _probe_force(state, plant)
    if state[TOUCHING] > 0.0:
        resistance, elastic = tissue_resistance(state, tissue, depth, velocity)
        rate[row, VELOCITY] = (probe - resistance) / (plant[MOVING_MASS] + tissue_mass(tissue, depth))
        rate[row, SURFACE] = velocity
        rate[row, SURFACE_VELOCITY] = rate[row, VELOCITY]
    else:
        depth = state[SURFACE] - tissue[REST_SURFACE]
        rate[row, VELOCITY] = probe / plant[MOVING_MASS]
        rate[row, SURFACE] = state[SURFACE_VELOCITY]
        resistance, elastic = tissue_resistance(state, tissue, depth, state[SURFACE_VELOCITY])
        rate[row, SURFACE_VELOCITY] = -resistance / tissue_mass(tissue, depth) - tissue[FRAME_ACCELERATION]
    for k in range(MAX_BRANCHES):
        rate[row, BRANCH + k] = (elastic - state[BRANCH + k]) / tissue[BRANCH_TIME + k]


@_swift
def _copy(source: Array, target: Array) -> None:
    # Element by element: with a slice, numba spends seconds compiling an error message that cannot occur.
    for j in range(STATE_SIZE):
        target[j] = source[j]


@_swift
def _runge_kutta(
    state: Array, after: Array, step: float, volts: float, plant: Array, tissue: Array, work: Array
) -> None:
    # work has shape (5, STATE_SIZE): four slopes and a stage.
    stage = work[4]
    _copy(state, after)
    _copy(state, stage)
    _derivative(stage, work, 0, volts, plant, tissue)
    for k in range(3):
        fraction = step if k == 2 else 0.5 * step
        for j in range(TOUCHING):
            stage[j] = state[j] + fraction * work[k, j]
        _derivative(stage, work, k + 1, volts, plant, tissue)
    for j in range(TOUCHING):
        after[j] = state[j] + step / 6.0 * (work[0, j] + 2.0 * work[1, j] + 2.0 * work[2, j] + work[3, j])
    if tissue[KIND] == WIENER:
        after[POSITION], after[VELOCITY] = _wiener_output(tissue, after[LATENT], after[LATENT_VELOCITY])


@_swift
def _overdue(state: Array, plant: Array, tissue: Array) -> float:
    # Positive if the present contact state has ended: the tissue would pull, or the probe is inside it.
    if state[TOUCHING] > 0.0:
        return -_contact_force(state, plant, tissue)
    return state[POSITION] - state[SURFACE]


@_swift
def _switch_contact(state: Array, plant: Array, tissue: Array) -> None:
    if state[TOUCHING] > 0.0:
        state[TOUCHING] = 0.0
        return
    # Inelastic collision of probe and surface: momentum is conserved.
    mass = tissue_mass(tissue, state[SURFACE] - tissue[REST_SURFACE])
    momentum = plant[MOVING_MASS] * state[VELOCITY] + mass * state[SURFACE_VELOCITY]
    state[TOUCHING] = 1.0
    state[VELOCITY] = momentum / (plant[MOVING_MASS] + mass)
    state[SURFACE_VELOCITY] = state[VELOCITY]
    state[SURFACE] = state[POSITION]


@_swift
def _step(state: Array, step: float, volts: float, plant: Array, tissue: Array, work: Array, after: Array) -> None:
    remaining = step
    if tissue[CONTACT] > 0.0:
        for event in range(_EVENTS_PER_STEP):
            if event > 0 and state[TOUCHING] > 0.0 and _overdue(state, plant, tissue) > 0.0:
                _switch_contact(state, plant, tissue)
            _runge_kutta(state, after, remaining, volts, plant, tissue, work)
            high = _overdue(after, plant, tissue)
            if high <= 0.0:
                _copy(after, state)
                return
            low = min(_overdue(state, plant, tissue), 0.0)
            left, right = 0.0, remaining
            for _ in range(_LOCATE_ITERATIONS):  # false position with the Illinois correction
                middle = 0.5 * (left + right) if low == 0.0 else (left * high - right * low) / (high - low)
                _runge_kutta(state, after, middle, volts, plant, tissue, work)
                value = _overdue(after, plant, tissue)
                if value > 0.0:
                    right, high, low = middle, value, 0.5 * low
                else:
                    left, low, high = middle, value, 0.5 * high
                if right - left < 1e-7 * step or value == 0.0:
                    break
            _runge_kutta(state, after, right, volts, plant, tissue, work)
            _copy(after, state)
            _switch_contact(state, plant, tissue)
            remaining -= right
            if remaining <= 0.0:
                return
    _runge_kutta(state, after, remaining, volts, plant, tissue, work)
    _copy(after, state)


@njit(cache=True, error_model="numpy")
def advance(
    commands: Array, state: Array, plant: Array, tissue: Array, interval: float, substeps: int, out: Array
) -> None:
    """Integrate one block of zero-order-hold commands in place.

    ``commands`` has shape (n,), volts at the amplifier's input; ``state`` (STATE_SIZE,) is updated; ``out`` has shape
    (n, OUT_COLUMNS) and receives, at the end of each hold interval: voltage, current, position, velocity, winding
    temperature, mean acceleration over the interval, contact, and the four filtered readings (voltage, current,
    position, sensor temperature). ``plant`` holds plant.PlantParameters followed by the entries from COIL_OPEN on.
    """
    step = interval / substeps
    work = np.zeros((5, STATE_SIZE))
    after = np.zeros(STATE_SIZE)
    if plant[COIL_OPEN] > 0.0:
        state[CURRENT] = 0.0
    for n in range(commands.shape[0]):
        volts = plant[AMPLIFIER_GAIN] * commands[n]
        volts = min(max(volts, -plant[AMPLIFIER_LIMIT]), plant[AMPLIFIER_LIMIT])
        before = state[VELOCITY]
        for _ in range(substeps):
            _step(state, step, volts, plant, tissue, work, after)
        out[n, 0] = volts
        out[n, 1] = state[CURRENT]
        out[n, 2] = state[POSITION]
        out[n, 3] = state[VELOCITY]
        out[n, 4] = state[TEMPERATURE]
        out[n, 5] = (state[VELOCITY] - before) / interval
        out[n, 6] = state[TOUCHING]
        for k in range(4):
            out[n, 7 + k] = state[FILTER + k]
