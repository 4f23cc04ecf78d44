"""Online identification for RTIG, decimation of its samples, and the decision whether its model can control."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tissueid.language import marked
from tissueid.stimuli.base import Array
from tissueid.stimuli.rtig.identified_control import IdentifiedController
from tissueid.stimuli.rtig.local_identification import LocalIdentification
from tissueid.stimuli.rtig.static_map import StaticMap

_MIN_RECEIVED_SHARE = 0.6
"""Minimum share of received samples in an average."""


@dataclass(frozen=True)
class States:
    """Averages over ``every`` samples: force, N, depth, m, and its time derivatives; each (n,), NaN where unknown.

    Speed and acceleration are central differences, so a state lags the newest average by one.
    """

    force: Array
    depth: Array
    speed: Array
    acceleration: Array


class Averages:
    """Average samples in groups of ``every``, independently of how the input is split into calls."""

    def __init__(self, every: int, sample_rate: float) -> None:
        self._every = every
        self._step = every / sample_rate
        self._left = np.empty((2, 0))
        self._last = np.full((2, 2), np.nan)

    def take(self, force: Array, depth: Array) -> States:
        """Process force (k,), N, and depth (k,), m, NaN where a sample was lost; return the new states."""
        signals = np.concatenate([self._left, [force, depth]], axis=1)
        whole = signals.shape[1] // self._every
        cut = whole * self._every
        self._left = signals[:, cut:]
        parts = signals[:, :cut].reshape(2, whole, self._every)
        received = np.isfinite(parts[0])
        enough = received.sum(axis=1) >= _MIN_RECEIVED_SHARE * self._every
        share = received / np.maximum(received.sum(axis=1, keepdims=True), 1)
        averages = np.where(enough, (np.where(received, parts, 0.0) * share).sum(axis=2), np.nan)
        course = np.concatenate([self._last, averages], axis=1)  # (2, 2 + whole)
        self._last = course[:, -2:]
        depth = course[1]
        return States(
            force=course[0, 1:-1],
            depth=depth[1:-1],
            speed=(depth[2:] - depth[:-2]) / (2.0 * self._step),
            acceleration=(depth[2:] - 2.0 * depth[1:-1] + depth[:-2]) / self._step**2,
        )


_JUDGING_TIME_S = 0.5
"""Time constant, s, of the average by which the force prediction is judged."""

_REJECT_SHARE, _ACCEPT_SHARE = 0.4, 0.25
"""Unpredicted share of the force variance above which control by the model stops, and below which it resumes."""

_FAST_FORGETTING = 8.0
"""Factor on the forgetting rate while the model does not predict the force."""

_INITIAL_STD = 0.1
"""Standard deviation of the force assumed at the start, relative to the force range."""

_MIN_STD = 0.02
"""Standard deviation of the force, relative to its range, added so that a constant force is not judged."""


class OnlineIdentification:
    """Static force, local second-order parameters, and the controller that uses them."""

    def __init__(
        self,
        averages: Averages,
        static: StaticMap,
        local: LocalIdentification,
        controller: IdentifiedController,
        force_span: float,
        averages_rate: float,
    ) -> None:
        self.static = static
        self.local = local
        self.controller = controller
        self._averages = averages
        self._keep = 1.0 - 1.0 / (_JUDGING_TIME_S * averages_rate)
        self._least = (_MIN_STD * force_span) ** 2
        credit = _JUDGING_TIME_S * averages_rate
        # Exponentially weighted sums: samples, forces, squared forces, squared errors; initialised as for a good model.
        self._sums = np.array([credit, 0.0, credit * (_INITIAL_STD * force_span) ** 2, 0.0])
        self.good = True
        self.rejections = 0

    def take(self, force: Array, depth: Array, first: int) -> None:
        """Process force (k,), N, and depth (k,), m, NaN where a sample was lost, from sample index ``first`` on."""
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
        if self.good and missed > _REJECT_SHARE * varied:
            self.good = False
            self.rejections += 1
            self.static.forget(_FAST_FORGETTING)
        elif not self.good and missed < _ACCEPT_SHARE * varied:
            self.good = True
            self.static.forget(1.0)

    @property
    def verdict(self) -> str:
        """Text on whether the identified model controlled the input."""
        if not self.good:
            return marked("model rejected: it did not predict the force; controlled without it")
        if self.local.diverged:
            return marked("good, but the local impulse responses diverged: no parameters by depth")
        return marked("good, rejected for part of the test") if self.rejections else marked("good")

    def report(self) -> dict[str, Any]:
        """Return the parameters by depth (Fig. 6.12) and the static force as plain values."""
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
                        "settling_s": system.settling_time_s(),
                    }
                )
        return {
            "verdict": self.verdict,
            "memory_s": self.local.memory_s,
            "levels": levels,
            "static_force": {
                "depth_m": self.static.knots.tolist(),
                "force_n": self.static.force(self.static.knots).tolist(),
            },
        }
