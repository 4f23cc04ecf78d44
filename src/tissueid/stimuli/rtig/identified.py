"""What is identified while the input is being made, and whether it is good enough to steer by."""

from __future__ import annotations

from typing import Any

import numpy as np

from tissueid.language import marked
from tissueid.stimuli.base import Array
from tissueid.stimuli.rtig.averages import Averages
from tissueid.stimuli.rtig.identified_control import Scheduled
from tissueid.stimuli.rtig.local_identification import LocalIdentification
from tissueid.stimuli.rtig.static_map import StaticMap

_TRUST_S = 0.5
"""Time over which the predictions of the force are judged."""

_LEAVE, _RETURN = 0.4, 0.25
"""Share of the force's variance that is not predicted from which it is made without identification, and with again."""

_HASTE = 8.0
"""How much faster is forgotten what does not predict."""

_CREDIT = 0.1
"""Standard deviation of the force, in its range, that is taken for granted at the start."""

_NOTHING = 0.02
"""Standard deviation of the force, in its range, under which nothing can be judged."""


class Identified:
    """The static force, the local parameters, and the controller that goes by them."""

    def __init__(
        self,
        averages: Averages,
        static: StaticMap,
        local: LocalIdentification,
        controller: Scheduled,
        force_span: float,
        averages_rate: float,
    ) -> None:
        self.static = static
        self.local = local
        self.controller = controller
        self._averages = averages
        self._keep = 1.0 - 1.0 / (_TRUST_S * averages_rate)
        self._least = (_NOTHING * force_span) ** 2
        credit = _TRUST_S * averages_rate
        # Samples, forces, their squares, squared errors; faded. They begin with what a fair start would have given.
        self._sums = np.array([credit, 0.0, credit * (_CREDIT * force_span) ** 2, 0.0])
        self.good = True
        self.times_left = 0

    def take(self, force: Array, depth: Array, first: int) -> None:
        """Take force (k,), N, and depth (k,), m, NaN where one was lost, from sample ``first`` on."""
        states = self._averages.take(force, depth)
        self.local.learn(states.force, states.depth)
        known = np.isfinite(states.acceleration) & np.isfinite(states.force)
        if known.any():
            at = tuple(part[known] for part in (states.force, states.depth, states.speed, states.acceleration))
            errors = self.static.learn(*at)
            if first >= 0:
                self._judge(at[0], errors)
        if first + depth.size > 0:
            self.controller.learn(depth[max(0, -first) :], max(0, first))

    def _judge(self, force: Array, errors: Array) -> None:
        new = np.array([force.size, force.sum(), force @ force, errors @ errors])
        self._sums = self._keep**force.size * self._sums + new
        samples, forces, squares, missed = self._sums.tolist()
        varied = squares - forces**2 / samples + samples * self._least
        if self.good and missed > _LEAVE * varied:
            self.good = False
            self.times_left += 1
            self.static.forget(_HASTE)
        elif not self.good and missed < _RETURN * varied:
            self.good = True
            self.static.forget(1.0)

    @property
    def verdict(self) -> str:
        """One line: whether the input went by what was identified."""
        if not self.good:
            return marked("the force was not predicted: made without identification")
        if self.local.diverged:
            return marked("good, but the local responses ran away: no parameters by depth")
        return marked("good, after a time without") if self.times_left else marked("good")

    def report(self) -> dict[str, Any]:
        """Parameters by depth (Fig. 6.12) and the static force, plain values."""
        levels = []
        for level in range(self.local.updates.size):
            system, depth = self.local.system(level), self.local.depth(level)
            if system is not None and depth is not None:
                levels.append(
                    {
                        "depth_m": depth,
                        "mass_kg": system.mass,
                        "damping_n_s_per_m": system.damping,
                        "stiffness_n_per_m": system.stiffness,
                        "samples": int(self.local.updates[level]),
                    }
                )
        return {
            "verdict": self.verdict,
            "levels": levels,
            "static_force": {
                "depth_m": self.static.knots.tolist(),
                "force_n": self.static.force(self.static.knots).tolist(),
            },
        }
