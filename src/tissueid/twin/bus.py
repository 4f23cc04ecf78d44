"""Where the compiled chain calls effects, and the numbers that they may read and change there.

A hook is a plain function ``hook(where, bus, p, s, dt)``: the place it is called from, the numbers of this step, its
parameters in the order of their declaration, its own state (zeros at the start of a test), and the step in seconds.
It must hold no Python objects, because it is compiled, and takes single elements alone (no slices, no sizes), because
it is given addresses. Every number on the bus is SI.
"""

from __future__ import annotations

# Places, in the order in which one integration step calls them.
AMPLIFIER = 0
"""May change VOLTAGE, which is what an ideal amplifier of known gain and rated limit would give."""
SURFACE = 1
"""May change SURFACE_POSITION, where the tissue begins, before the depth is reckoned."""
COIL = 2
"""May change RESISTANCE, INDUCTANCE, FORCE_CONSTANT, OPPOSING_VOLTAGE, and add to FORCE."""
MECHANICS = 3
"""May add to FORCE, DAMPING and MASS: what acts on the moving part whether there is tissue or not."""
TISSUE = 4
"""May change TISSUE_FORCE, TISSUE_DAMPING and TISSUE_MASS, and give VELOCITY_JUMP and POSITION_SHIFT.

It is called on tissue alone, never on the calibration spring."""
PLACES = 5

# The bus.
TIME = 0
"""From the start of the test, at the start of this step."""
VOLTAGE = 1
CURRENT = 2
"""At the start of the step where the coil is called, and its mean over the step afterwards."""
POSITION = 3
"""Of the probe on the actuator's scale, in the middle of the step."""
VELOCITY = 4
"""Of the probe, at the start of the step."""
SURFACE_POSITION = 5
DEPTH = 6
"""POSITION less SURFACE_POSITION; negative where the probe has left the surface behind."""
RESISTANCE = 7
INDUCTANCE = 8
FORCE_CONSTANT = 9
"""Newtons per ampere and, as back-EMF, volts per metre per second."""
OPPOSING_VOLTAGE = 10
"""What stands against the voltage besides resistance, inductance and back-EMF."""
FORCE = 11
"""On the moving part, positive into the tissue, without tissue and viscous damping."""
DAMPING = 12
"""Viscous coefficient without the tissue's."""
MASS = 13
"""What moves, without the tissue's."""
TISSUE_FORCE = 14
"""What the tissue presses back with apart from its damping, positive out of the tissue."""
TISSUE_DAMPING = 15
TISSUE_MASS = 16
STIFFNESS = 17
"""The tissue's stiffness at the surface, N/m, for laws that build on it."""
STIFFNESS_GROWTH = 18
"""By which exponent it grows with depth, 1/m."""
ACCELERATION = 19
"""Of the probe, in the step before."""
STROKE = 20
SAMPLE = 21
"""Number of the sample that this step belongs to, from 0."""
VOLTAGE_RISE = 22
"""How far the voltage at the end of the step, which a reading meets, is above VOLTAGE, its mean over the step."""
VOLTAGE_TILT = 23
"""Half of what the voltage rises within the step, where it does so steadily; the current at its end answers to it."""
SURFACE_DAMPING = 24
"""The tissue's damping at the surface, N s/m."""
DAMPING_GROWTH = 25
VELOCITY_JUMP = 26
"""What a blow adds to the probe's velocity at the start of the step: two bodies meet, say."""
POSITION_SHIFT = 27
"""What is added to its position besides, where the blow did not fall just at the start of the step."""
SIZE = 28

MOST_EFFECTS = 4
"""Effects of a recording that can act at once."""
SLOTS = MOST_EFFECTS + 1
"""Places for effects in the compiled loop: one more is for the housing of an instrument that is played."""
MOST_PARAMETERS = 40
MOST_STATES = 512
"""Numbers of its own that an effect can keep; the last few thousandths of a second of a signal, for one."""
