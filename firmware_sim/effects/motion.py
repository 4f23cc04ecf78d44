"""Compiled loop of a plant with effects: the plant's own sub-steps with the changes by each stage between them.

Before each sub-step of ``kernel``, the effects change a copy of the plant's parameters, the additional force, the
voltage and the tissue's law, evaluated at the extrapolated mid-step position, speed and current. The sub-step itself is
that of the plant, so that no equation is duplicated.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from math import exp, pi
from pathlib import Path

import numpy as np
from numba import njit

from firmware_sim import kernel
from firmware_sim.effects import base, coil, drive, environment, mechanics, sensing, tissue
from firmware_sim.effects.base import Array
from firmware_sim.kernel import _exponential, _step, elastic_force, tissue_mass

SEEN_COLUMNS = 3
_PLANT_FIGURES = kernel.PROFILE

Advance = Callable[[Array, Array, Array, Array, float, int, Array, Array, Array, Array, Array, float], None]


def _sources() -> int:
    # numba only checks the file of a cached function for changes: this number includes all files that it calls.
    here = Path(__file__)
    compiled = ("base", "drive", "coil", "mechanics", "tissue", "sensing", "environment")
    files = [Path(str(kernel.__file__)), *(here.with_name(f"{name}.py") for name in compiled)]
    return zlib.crc32(b"".join(file.read_bytes() for file in files))


def _build(sources: int) -> Advance:
    @njit(cache=True, error_model="numpy")
    def advance(
        commands: Array,
        state: Array,
        plant_figures: Array,
        tissue_figures: Array,
        interval: float,
        substeps: int,
        out: Array,
        seen: Array,
        figures: Array,
        memory: Array,
        rings: Array,
        start: float,
    ) -> None:
        if sources < 0:
            return
        step = interval / substeps
        work = np.zeros((5, kernel.STATE_SIZE))
        after = np.zeros(kernel.STATE_SIZE)
        plant = plant_figures.copy()
        law = tissue_figures.copy()
        clock = memory[base.CLOCK]
        share = 1.0 - exp(-2.0 * pi * plant_figures[kernel.FILTER_CUTOFF] * step)
        limit = plant_figures[kernel.AMPLIFIER_LIMIT]
        parallel = tissue_figures[kernel.KIND] == kernel.PARALLEL
        lifting = figures[base.CONTACT_LOSS, 0] != 0.0 and parallel
        moving = figures[base.PHYSIOLOGICAL_MOTION, 0] != 0.0
        mounted = figures[base.MOUNT_RESONANCE, 0] != 0.0
        humming = figures[base.MAINS_HUM, 0] != 0.0
        mass = plant_figures[kernel.MOVING_MASS]
        if plant_figures[kernel.COIL_OPEN] > 0.0:
            state[kernel.CURRENT] = 0.0
        # Clock row: 0 number of sub-steps, 1 acceleration, 2 previous current, 3 initial and 4 present surface,
        # 5 to 7 displacement, speed and acceleration of the frame.
        for n in range(commands.shape[0]):
            commanded = plant_figures[kernel.AMPLIFIER_GAIN] * commands[n]
            before = state[kernel.VELOCITY]
            volts = commanded
            for part in range(substeps):
                first = clock[0] == 0.0
                t = clock[0] * step
                current, speed = state[kernel.CURRENT], state[kernel.VELOCITY]
                position = state[kernel.POSITION] + step * (0.5 * speed + 0.125 * step * clock[1])
                velocity = speed + 0.5 * step * clock[1]
                halfway = current if part == 0 else current + 0.5 * (current - clock[2])
                clock[2] = current
                volts = min(max(drive.drive(commanded, t, step, first, figures, memory, rings), -limit), limit)
                for k in range(_PLANT_FIGURES):
                    plant[k] = plant_figures[k]
                for k in range(law.size):
                    law[k] = tissue_figures[k]
                left = coil.coil(volts, halfway, position, velocity, step, plant, figures, memory)
                force = mechanics.mechanics(position, velocity, plant[kernel.BEARING_DAMPING], step, figures, memory)
                if mounted:
                    pushing = plant[kernel.FORCE_CONSTANT] * halfway - plant[kernel.BEARING_DAMPING] * velocity
                    clock[5], clock[6], clock[7] = mechanics.frame(
                        -pushing - force, step, figures[base.MOUNT_RESONANCE], memory[base.MOUNT_RESONANCE], mass
                    )
                raised, rising = 0.0, 0.0
                if moving:
                    now = environment.surface(start + t + 0.5 * step, figures[base.PHYSIOLOGICAL_MOTION])
                    if first:
                        clock[3] = now
                        clock[4] = now
                    raised, rising = now - clock[3], (now - clock[4]) / step
                    clock[4] = now
                # The displacement in the middle of the step; speed and acceleration are means over it.
                law[kernel.REST_SURFACE] += -raised - clock[5] + 0.5 * step * clock[6]
                law[kernel.REST_VELOCITY] = -rising - clock[6]
                law[kernel.FRAME_ACCELERATION] = clock[7]
                if parallel:
                    depth = position - law[kernel.REST_SURFACE]
                    against = velocity + clock[6] + rising
                    off = lifting and memory[base.CONTACT_LOSS, 0] != 0.0
                    if off:
                        depth_met, speed_met = memory[base.CONTACT_LOSS, 1], memory[base.CONTACT_LOSS, 2]
                    else:
                        depth_met, speed_met = depth, against
                    if figures[base.PRECONDITIONING, 0] != 0.0:
                        pressed = elastic_force(law, depth_met)
                        tissue.soften(step, pressed, speed_met, law, figures, memory)
                    elastic = elastic_force(law, depth_met)
                    damping = _exponential(law, kernel.DAMPING, depth_met)
                    added = 0.0
                    if figures[base.ADDED_MASS, 0] != 0.0:
                        added += tissue.recruit(depth_met, speed_met, figures[base.ADDED_MASS], law)
                    added += tissue.tissue(depth_met, speed_met, elastic, damping, step, first, figures, memory, rings)
                    taken_along = tissue_mass(law, depth_met)
                    if lifting:
                        pushing = plant[kernel.FORCE_CONSTANT] * halfway + plant[kernel.GRAVITY_FORCE] + force
                        pushing -= plant[kernel.BEARING_DAMPING] * velocity
                        resisting = elastic + damping * against - added
                        kept = memory[base.CONTACT_LOSS]
                        kept[4] = mass
                        together = resisting + taken_along / (mass + taken_along) * (pushing - resisting)
                        state[kernel.VELOCITY] += tissue.lifts(
                            depth, against, together, step, law, figures[base.CONTACT_LOSS], kept
                        )
                        off = kept[0] != 0.0
                    if off:
                        law[kernel.STIFFNESS] = 0.0
                        law[kernel.DAMPING] = 0.0
                        law[kernel.MASS] = 0.0
                        taken_along = 0.0
                        force += memory[base.CONTACT_LOSS, 3]
                    elif state[kernel.TOUCHING] > 0.0:
                        force += added
                    else:
                        taken_along = 0.0
                    force -= taken_along * clock[7]
                plant[kernel.GRAVITY_FORCE] += force - mass * clock[7]
                filtered_voltage = state[kernel.FILTER]
                filtered_position = state[kernel.FILTER + 2]
                entering = state[kernel.VELOCITY]
                _step(state, step, left, plant, law, work, after)
                clock[1] = (state[kernel.VELOCITY] - entering) / step
                reading = sensing.sense(
                    state[kernel.POSITION], state[kernel.CURRENT], t + step, step, first, figures, memory, rings
                )
                if left != volts:
                    state[kernel.FILTER] = filtered_voltage + share * (volts - filtered_voltage)
                if reading != state[kernel.POSITION]:
                    state[kernel.FILTER + 2] = filtered_position + share * (reading - filtered_position)
                clock[0] += 1.0
            out[n, 0] = volts
            out[n, 1] = state[kernel.CURRENT]
            out[n, 2] = state[kernel.POSITION]
            out[n, 3] = state[kernel.VELOCITY]
            out[n, 4] = state[kernel.TEMPERATURE]
            out[n, 5] = (state[kernel.VELOCITY] - before) / interval
            out[n, 6] = state[kernel.TOUCHING]
            for k in range(4):
                out[n, 7 + k] = state[kernel.FILTER + k]
            seen[n, 0], seen[n, 1], seen[n, 2] = volts, state[kernel.CURRENT], reading
            if humming:
                row = figures[base.MAINS_HUM]
                for k in range(SEEN_COLUMNS):
                    measure = 1.0 if k == 0 else row[4 + k]
                    picked_up = measure * environment.hum(start + clock[0] * step, k, row)
                    out[n, 7 + k] += picked_up
                    seen[n, k] += picked_up

    return advance  # type: ignore[no-any-return]


advance: Advance = _build(_sources())
"""Integrate one block of commands in place, as ``kernel.advance`` does, with effects.

Additional arguments: ``seen`` (n, 3) receives voltage, current and position before the anti-alias filters; ``figures``
and ``memory`` hold a row for each effect, ``rings`` the delay lines; ``start`` is the session time at the start of the
test, s, which determines the phase of hum and body motion.
"""
