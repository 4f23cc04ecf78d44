"""Call sites of effects in the compiled chain, and the quantities that effects can read and change there.

A hook is a plain function ``hook(where, bus, p, s, dt)``: the call site, the quantities of this step, the parameters in
the order of their declaration, the effect's own state (zeros at the start of a test), and the step in seconds. It is
compiled and receives addresses: it must not use Python objects, slices or sizes. All quantities are SI.
"""

from __future__ import annotations

# Places, in the order in which one integration step calls them.
AMPLIFIER = 0
"""May change VOLTAGE, the output of an ideal amplifier of known gain and rated limit."""
SURFACE = 1
"""May change SURFACE_POSITION, where the tissue begins, before the depth is computed, and SURFACE_VELOCITY."""
COIL = 2
"""May change RESISTANCE, INDUCTANCE, FORCE_CONSTANT, OPPOSING_VOLTAGE, and add to FORCE."""
MECHANICS = 3
"""May add to FORCE, DAMPING and MASS: effects on the moving part with and without tissue."""
TISSUE = 4
"""May change TISSUE_FORCE, TISSUE_DAMPING and TISSUE_MASS, and set VELOCITY_JUMP and POSITION_SHIFT.

Called on tissue only, never on the calibration spring.
"""
LIFT_OFF = 5
"""Before the tissue's laws: may change DEPTH, VELOCITY and ACCELERATION to those of a surface that the probe has left.
The same effect restores them when it is called at TISSUE, after all others."""
PLACES = 6

# The bus.
TIME = 0
"""Time from the start of the test to the start of this step."""
VOLTAGE = 1
CURRENT = 2
"""Current at the start of the step for coil hooks, its mean over the step afterwards."""
POSITION = 3
"""Position of the probe on the actuator scale, at the middle of the step."""
VELOCITY = 4
"""Velocity of the probe at the start of the step; from LIFT_OFF on relative to the surface."""
SURFACE_POSITION = 5
DEPTH = 6
"""POSITION minus SURFACE_POSITION; negative where the probe is off the surface."""
RESISTANCE = 7
INDUCTANCE = 8
FORCE_CONSTANT = 9
"""Newtons per ampere and, as back-EMF, volts per metre per second."""
OPPOSING_VOLTAGE = 10
"""Voltage that opposes the current in addition to resistance, inductance and back-EMF."""
FORCE = 11
"""Force on the moving part, positive into the tissue, without tissue and viscous damping."""
DAMPING = 12
"""Viscous coefficient without that of the tissue."""
MASS = 13
"""Moving mass without that of the tissue."""
TISSUE_FORCE = 14
"""Force of the tissue without its damping, positive out of the tissue."""
TISSUE_DAMPING = 15
TISSUE_MASS = 16
STIFFNESS = 17
"""The tissue's stiffness at the surface, N/m, for laws that build on it."""
STIFFNESS_GROWTH = 18
"""Exponent of the growth of stiffness with depth, 1/m."""
ACCELERATION = 19
"""Acceleration of the probe in the previous step."""
STROKE = 20
SAMPLE = 21
"""Index of the sample of this step, from 0."""
VOLTAGE_RISE = 22
"""Voltage at the end of the step, which is recorded, minus VOLTAGE, its mean over the step."""
VOLTAGE_TILT = 23
"""Half the rise of a voltage that changes linearly within the step; it affects the current at the end."""
# Numbers once given stay: compiled hooks are cached with them.
SURFACE_VELOCITY = 24
"""Velocity of the surface of tissue that moves as a whole; the laws of the tissue act on the motion relative to it."""
FRAME_ACCELERATION = 25
"""Acceleration of the frame against which the position is read; its inertial force on probe and tissue is in FORCE."""
VELOCITY_JUMP = 26
"""Velocity that an impact adds at the start of the step, for instance when two bodies meet."""
POSITION_SHIFT = 27
"""Correction of the position for an impact after the start of the step."""
SIZE = 28

MOST_EFFECTS = 10
"""Maximum number of simultaneous effects; it determines the size of the compiled loop."""
SLOTS = MOST_EFFECTS + 1
"""Effects in the compiled loop: one more for the end bumpers of a simulated instrument."""
MOST_PARAMETERS = 40
MOST_STATES = 512
"""Size of the state of an effect, sufficient for the last milliseconds of a signal."""
