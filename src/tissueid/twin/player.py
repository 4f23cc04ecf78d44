"""Simulation of the chain in pieces, as an instrument plays a command: the state carries over between pieces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tissueid.twin import bus
from tissueid.twin.chain_parameters import InstrumentParameters, Tissue
from tissueid.twin.effect import ActsOn, Effect, FloatArray, Parameter, Readings
from tissueid.twin.simulation import ActiveEffect, PreparedEffects, Start, in_order, prepared, recorded, run

RUBBER_N_PER_M = 1.0e5
RUBBER_N_S_PER_M = 50.0


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Add the force of the bumpers, and keep the tissue from pulling the probe."""
    if where == bus.MECHANICS:
        position, stroke = b[bus.POSITION], b[bus.STROKE]
        beyond = min(position, 0.0) + max(position - stroke, 0.0)
        if beyond != 0.0:
            b[bus.FORCE] -= p[0] * beyond
            b[bus.DAMPING] += p[1]
        return
    if p[2] == 0.0:
        return
    if b[bus.DEPTH] <= 0.0:
        b[bus.TISSUE_FORCE] = 0.0
        b[bus.TISSUE_DAMPING] = 0.0
        return
    velocity = b[bus.VELOCITY] + 0.5 * dt * b[bus.ACCELERATION]
    force = max(b[bus.TISSUE_FORCE], 0.0)
    b[bus.TISSUE_FORCE] = force
    if force + b[bus.TISSUE_DAMPING] * velocity < 0.0:
        # Limit the damping so that the total force does not pull.
        b[bus.TISSUE_DAMPING] = force / -velocity


END_BUMPERS = Effect(
    name="housing",
    stage="mechanics",
    acts_on=ActsOn.CONTACT,
    title="The housing",
    equation="F = -K e - B v at e > 0 beyond an end of the stroke; tissue forces of either sign become at least 0",
    signature="position within the stroke; nothing pulls the probe back to a surface that it has left",
    source="kinematics; Johnson, Contact Mechanics (1985), ch. 4",
    parameters=(
        Parameter("rubber_n_per_m", "N/m", 0.0, 0.0, 1e7, meaning="stiffness of the ends"),
        Parameter("rubber_n_s_per_m", "N s/m", 0.0, 0.0, 1e4, meaning="damping of the ends"),
        Parameter("only_pushes", "1", 0.0, 0.0, 1.0, meaning="1: the tissue does not pull"),
    ),
    starts=((RUBBER_N_PER_M, RUBBER_N_S_PER_M, 1.0),),
    places=(bus.MECHANICS, bus.TISSUE),
    hook=hook,
)
"""Rubber bumpers at both ends of the stroke, and tissue that only pushes.

Neither in the library of effects nor in the baseline, because tests should not contain them. In real time the probe
would leave the housing without them.
"""


SUBSTEPS = 20
"""Integration steps in a sample: 25 us each at 2 kHz. Speed matters less than in a fit."""
HISTORY_SAMPLES = 512
"""Past samples that effects on the recorded numbers (filters, clocks) get with every piece."""


class Player:
    """Running simulation. The result does not depend on how a command is divided into pieces.

    Args:
        instrument: parameters of amplifier, coil and moving part.
        tissue: parameters of the tissue.
        start: initial state.
        acting: effects in any order, at most ``bus.MOST_EFFECTS``; the end bumpers are added.
        sample_rate_hz: sample rate, Hz.
        on_tissue: whether effects of the stage ``tissue`` are active.
        substeps: integration steps per sample.

    Raises:
        ValueError: too many effects.
    """

    def __init__(
        self,
        instrument: InstrumentParameters,
        tissue: Tissue,
        start: Start,
        acting: Sequence[ActiveEffect] = (),
        *,
        sample_rate_hz: float,
        on_tissue: bool = True,
        substeps: int = SUBSTEPS,
    ) -> None:
        one_sided = not any(item.effect.models_lift_off for item in acting)
        rubber = END_BUMPERS.starts[0][:2]
        self._bumpers = ActiveEffect(END_BUMPERS, np.array([*rubber, 1.0 if one_sided else 0.0]))
        self._acting = in_order((*acting, self._bumpers))
        self._instrument, self._tissue = instrument, tissue
        self._rate, self._substeps, self._on_tissue = sample_rate_hz, substeps, on_tissue
        self._prepared: PreparedEffects = prepared(self._acting, on_tissue)
        self._state = np.array([start.current_a, start.position_m, start.velocity_m_s, 0.0])
        self._samples = 0
        self._past = np.empty((3, 0))

    @property
    def state(self) -> Start:
        """The present current, position and velocity."""
        return Start(float(self._state[0]), float(self._state[1]), float(self._state[2]))

    def set_surface(self, surface_m: float) -> None:
        """Set the position of the tissue surface from now on, m."""
        self._tissue = replace(self._tissue, surface_m=surface_m)

    def set_parameters(self, tissue: Tissue, acting: Sequence[ActiveEffect]) -> None:
        """Continue with other parameters of the tissue, at the same surface, and of the same effects.

        Raises:
            ValueError: other effects than those in use.
        """
        then = in_order((*acting, self._bumpers))
        if [item.effect for item in then] != [item.effect for item in self._acting]:
            raise ValueError("only the parameters of effects change under way, not which effects act")
        self._tissue = replace(tissue, surface_m=self._tissue.surface_m)
        self._acting = then
        changed = prepared(then, self._on_tissue)
        self._prepared = replace(changed, states=self._prepared.states)

    def play(self, command_v: FloatArray) -> FloatArray:
        """Return voltage (V), current (A) and position (m) at the end of each sample of a command, shape (3, n)."""
        command = np.ascontiguousarray(command_v, np.float64)
        self._prepared.states[bus.SLOTS, bus.SAMPLE] = self._samples
        out = run(self._prepared, command, self._instrument, self._tissue, self._rate, self._substeps, self._state)
        self._samples += command.size
        raw = np.concatenate([self._past, out[:3]], axis=1)
        self._past = raw[:, -HISTORY_SAMPLES:]
        if not any(item.effect.recording for item in self._acting):
            return raw[:, -command.size :]
        time = np.arange(self._samples - raw.shape[1] + 1, self._samples + 1) / self._rate
        readings = recorded(Readings(time, raw[0], raw[1], raw[2], self._rate), self._acting, self._on_tissue)
        return np.stack([readings.voltage, readings.current, readings.position])[:, -command.size :]
