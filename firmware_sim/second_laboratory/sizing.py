"""Size of an effect by the gap that it makes: the change of the signals that no refit of the baseline absorbs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from firmware_sim.second_laboratory.effect import Effect, TestMotion
from firmware_sim.second_laboratory.integrator import LONGEST_STEP_S, DivergedError
from firmware_sim.second_laboratory.parameters import Floats
from firmware_sim.second_laboratory.recording import READINGS, Laboratory, PlannedTest

REFITTED = (
    "resistance_ohm",
    "inductance_h",
    "force_constant_n_per_a",
    "mass_kg",
    "damping_n_s_per_m",
    "gain",
    "stiffness_n_per_m",
    "stiffness_rate_per_m",
    "tissue_damping_n_s_per_m",
    "damping_rate_per_m",
)
"""Parameters by whose relative change a refit can absorb part of an effect, besides weight and tissue mass."""
LEAST_GAP, MOST_GAP = 0.01, 0.30
TRIALS = 5
CLOSE = 0.15
"""Relative distance from the wanted gap at which the search ends."""


class Sizer:
    """Gaps of effects in one test, with a step of the integration twice as long as that of the record."""

    def __init__(self, laboratory: Laboratory, test: PlannedTest) -> None:
        self._laboratory = replace(laboratory, effects=(), longest_step_s=2.0 * LONGEST_STEP_S)
        self._test = test
        self.base = self._laboratory.record(test)
        self._scales = {name: float(np.std(self.base[name])) for name in READINGS}
        self._basis = self._absorbed()

    def motion(self) -> TestMotion:
        """Return the scales of the test without effects."""
        machine, truth = self._laboratory.machine, self._laboratory.truth
        played = self.base["time"] >= self._test.preload_s
        place, current = self.base["position"][played], self.base["current"][played]
        volts = self.base["command"][played]
        speed = np.gradient(place, 1.0 / machine.sample_rate_hz)
        return TestMotion(
            duration_s=float(self.base["time"][-1]),
            sample_rate_hz=machine.sample_rate_hz,
            surface_m=self._test.surface_m,
            mean_m=float(place.mean()),
            swing_m=float(place.std()),
            speed_m_s=float(speed.std()),
            current_a=float(current.std()),
            current_mean_a=float(current.mean()),
            volts_mean=float(volts.mean()),
            volts=float(volts.std()),
            volts_rate=float(np.std(np.diff(volts))) * machine.sample_rate_hz,
            force_n=truth["force_constant_n_per_a"] * float(current.std()),
            plant=dict(truth),
        )

    def gap(self, effect: Effect) -> float:
        """Return the root-mean-square change by an effect, in deviations, without what a refit absorbs.

        Raises:
            DivergedError: the motion with the effect is not finite.
        """
        changed = self._change(replace(self._laboratory, effects=(effect,)))
        left = changed - self._basis @ (self._basis.T @ changed)
        return float(np.sqrt(np.mean(left**2)))

    def sized(self, effect: Effect, wanted: float) -> tuple[Effect, float]:
        """Return the effect at the size at which its gap is as wanted, or at its largest; and its gap."""
        if effect.fixed_size:
            return effect, self.gap(effect)
        best, best_gap, size, power = effect.sized(0.0), 0.0, 1.0, 1.0
        earlier: tuple[float, float] | None = None
        for _ in range(TRIALS):
            try:
                found = max(self.gap(effect.sized(size)), 1e-9)
            except DivergedError:
                size /= 4.0
                continue
            if abs(np.log(found / wanted)) < abs(np.log(max(best_gap, 1e-9) / wanted)):
                best, best_gap = effect.sized(size), found
            if abs(found / wanted - 1.0) < CLOSE:
                break
            if earlier is not None and size != earlier[0]:
                # The gap grows with a power of the size.
                power = float(np.clip(np.log(found / earlier[1]) / np.log(size / earlier[0]), 0.4, 4.0))
            earlier = size, found
            size *= float(np.clip((wanted / found) ** (1.0 / power), 0.05, 20.0))
            size = float(np.clip(size, 1e-4, effect.largest))
        return best, best_gap

    def _absorbed(self) -> Floats:
        columns = []
        truth = self._laboratory.truth
        for name in (*REFITTED, "weight_n", "tissue_mass_kg"):
            step = 0.01 * truth[name]
            if name == "weight_n":
                step = 0.01 * truth["force_n"]
            elif name == "tissue_mass_kg":
                step = 0.01 * truth["mass_kg"]
            columns.append(self._change(replace(self._laboratory, truth=truth | {name: truth[name] + step})))
        return np.asarray(np.linalg.qr(np.stack(columns, axis=1))[0])

    def _change(self, laboratory: Laboratory) -> Floats:
        found = laboratory.record(self._test)
        changes = [np.nan_to_num((found[name] - self.base[name]) / self._scales[name]) for name in READINGS]
        return np.concatenate(changes)
