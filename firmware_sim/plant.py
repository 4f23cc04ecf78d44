"""Plant: amplifier, coil, moving part and tissue, integrated in time.

Conventions: SI; position increases into the tissue on the actuator scale, 0 to the stroke; a positive voltage pushes
into the tissue. A command is held for one sample interval. Reading ``k`` is taken at the end of interval ``k``, just
before command ``k + 1`` takes effect.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from firmware_sim import kernel
from firmware_sim.coil import IDEAL, CoilProfile
from firmware_sim.effects.active_effects import ActiveEffects
from firmware_sim.effects.base import Effect
from firmware_sim.tissue import Tissue

STANDARD_GRAVITY = 9.80665
SAMPLE_RATE_HZ = 2000.0
SUBSTEPS = 12

TRACE = np.dtype(
    [
        (name, np.float64)
        for name in (
            "voltage",
            "current",
            "position",
            "velocity",
            "temperature",
            "acceleration",
            "touching",
            "filtered_voltage",
            "filtered_current",
            "filtered_position",
            "filtered_temperature",
        )
    ]
)
"""Noise-free signals (V, A, m, m/s, degC, m/s^2, 0 or 1) and the outputs of the anti-alias filters.

``temperature`` is that of the winding; ``filtered_temperature`` is that of its sensor, which lags.
"""


@dataclass(frozen=True)
class PlantParameters:
    """Parameters of the desktop research device (thesis 2.2.1, 2.3, Table 2.1), SI, in the order of the compiled loop.

    The thermal parameters and the end stops are estimates, because the thesis gives none: 56 m of 28 gage copper (12
    ohm) weigh 40 g and have a heat capacity of 16 J/K, plus a few J/K of the bobbin; about 50 cm^2 of coil surface in
    moving air transfer about 0.12 W/K. Resistance does not depend on temperature. The temperature sensor on the outside
    of the winding has an estimated time constant of 2.5 s.

    Raises:
        ValueError: a parameter that must be positive is not, or is not finite.
    """

    resistance_ohm: float = 12.0
    inductance_h: float = 1.00e-3
    force_constant_n_per_a: float = 3.0
    moving_mass_kg: float = 0.060
    bearing_damping_n_s_per_m: float = 3.5
    gravity_force_n: float = 0.060 * STANDARD_GRAVITY  # 0.59 N into the tissue (Fig. 3.8); negative upside down
    amplifier_gain: float = 1.0
    amplifier_limit_v: float = 48.0
    stroke_m: float = 0.032
    stop_stiffness_n_per_m: float = 2.0e5
    stop_damping_s_per_m: float = 5.0
    thermal_resistance_k_per_w: float = 8.0
    heat_capacity_j_per_k: float = 18.0
    ambient_degc: float = 23.0
    filter_cutoff_hz: float = 2000.0
    sensor_lag_s: float = 2.5

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            free = item.name in ("gravity_force_n", "ambient_degc", "bearing_damping_n_s_per_m")
            if not np.isfinite(value) or not (free or value > 0):
                raise ValueError(f"plant parameter {item.name} must be finite and positive, not {value}")

    def to_array(self) -> NDArray[np.float64]:
        """Return all parameters in order, shape (16,)."""
        return np.array([getattr(self, item.name) for item in fields(self)], dtype=np.float64)


class Plant:
    """Amplifier, coil, moving part and tissue with their state.

    ``substeps`` is the number of integration steps per sample interval. The plant has no randomness: the same commands
    from the same state give the same trace for any division into blocks.

    ``coil`` is the profile of the force constant along the stroke, also for the back-EMF. Two faults can be set at any
    time: with ``coil_open`` the coil is disconnected, without current and electrical damping; ``supply_share`` is the
    supply voltage of the amplifier relative to normal, which scales its limit. ``effects`` are added; without any, the
    plain compiled loop is used. ``start_s`` is the session time at the start, which determines the phase of hum and
    body motion.

    Raises:
        ValueError: no sub-steps, an effect that is given twice, or an effect of tissue on a kind without depth.
    """

    def __init__(
        self,
        parameters: PlantParameters,
        tissue: Tissue,
        *,
        sample_rate_hz: float = SAMPLE_RATE_HZ,
        substeps: int = SUBSTEPS,
        energised: bool = True,
        coil: CoilProfile = IDEAL,
        effects: Iterable[Effect] = (),
        start_s: float = 0.0,
    ) -> None:
        if substeps < 1:
            raise ValueError(f"substeps must be 1 or more, not {substeps}")
        self.parameters = parameters
        self.coil = coil
        self.energised = energised
        self.coil_open = False
        self.supply_share = 1.0
        self.substeps = substeps
        self._interval_s = 1.0 / sample_rate_hz
        self.plant_row = np.concatenate([parameters.to_array(), [0.0], coil.to_array()])
        self._acting = ActiveEffects(effects, start_s)
        self.tissue = tissue
        self.state: NDArray[np.float64] = np.zeros(kernel.STATE_SIZE)
        self.rest()

    @property
    def tissue(self) -> Tissue:
        """Tissue under the probe. A new one acts on the present state: see ``settle``."""
        return self._met

    @tissue.setter
    def tissue(self, tissue: Tissue) -> None:
        if self._acting.needs_depth and tissue.kind not in ("linear", "dpn"):
            raise ValueError(f"effects of tissue and body need a tissue of kind linear or dpn, not {tissue.kind}")
        if self._acting.needs_depth and (tissue.layers or tissue.probe is not None):
            raise ValueError("effects of tissue and body need a tissue without layers, under the reference probe")
        self._met = tissue
        self.tissue_row = tissue.to_array()

    @property
    def amplifier_limit_v(self) -> float:
        """Largest output voltage of the amplifier at the present supply, V."""
        return self.parameters.amplifier_limit_v * self.supply_share

    def advance(self, voltage: NDArray[np.float64]) -> NDArray[np.void]:
        """Play commands, shape (n,), volts, one per sample, and return a TRACE array, shape (n,).

        While ``energised`` is false the commands are ignored and the amplifier shorts the coil: the current decays with
        L/R and the moving coil is damped electrically, unless it is disconnected.

        Raises:
            ValueError: the commands have more than one dimension or are not finite.
        """
        commands = np.ascontiguousarray(voltage, dtype=np.float64)
        if commands.ndim != 1 or not np.all(np.isfinite(commands)):
            raise ValueError("commands must be finite volts in one dimension")
        if not self.energised:
            commands = np.zeros_like(commands)
        self.plant_row[kernel.AMPLIFIER_LIMIT] = self.amplifier_limit_v
        self.plant_row[kernel.COIL_OPEN] = float(self.coil_open)
        if self._acting:
            out, _ = self._acting.advance(
                commands, self.state, self.plant_row, self.tissue_row, self._interval_s, self.substeps
            )
        else:
            out = np.empty((commands.size, kernel.OUT_COLUMNS))
            kernel.advance(commands, self.state, self.plant_row, self.tissue_row, self._interval_s, self.substeps, out)
        return out.view(TRACE).reshape(commands.size)

    def rest(self, voltage: float = 0.0) -> None:
        """Set the state to static equilibrium under a steady command in volts, fully relaxed, with a cold coil.

        The state of the effects is reset.
        """
        self._acting.reset()
        limit = self.amplifier_limit_v
        volts = float(np.clip(self.parameters.amplifier_gain * voltage, -limit, limit)) if self.energised else 0.0
        current = 0.0 if self.coil_open else volts / self.parameters.resistance_ohm
        position = self._balance(lambda at: self.force_constant_at(at) * current + self.parameters.gravity_force_n)
        tissue = self.tissue
        held = "contact" in tissue.extras and position < tissue.surface_m
        surface = tissue.surface_m if held else position
        state = np.zeros(kernel.STATE_SIZE)
        state[kernel.CURRENT] = current
        state[kernel.POSITION] = position
        state[kernel.SURFACE] = surface
        state[kernel.TEMPERATURE] = state[kernel.SENSOR] = self.parameters.ambient_degc
        state[kernel.TOUCHING] = 0.0 if held else 1.0
        if tissue.kind == "wiener":
            state[kernel.LATENT] = _latent(tissue, position)
        elif tissue.kind != "hammerstein":
            depth = surface - tissue.surface_m
            state[kernel.BRANCH : kernel.BRANCH + kernel.MAX_BRANCHES] = tissue.elastic_force(depth)
        state[kernel.FILTER : kernel.FILTER + 4] = volts, current, position, state[kernel.TEMPERATURE]
        self.state = state

    @property
    def memory(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """State of the effects; with ``state`` the complete state of the plant."""
        return self._acting.memory

    @memory.setter
    def memory(self, memory: tuple[NDArray[np.float64], NDArray[np.float64]]) -> None:
        self._acting.memory = memory

    def settle(self) -> None:
        """Set the state to rest without command, as ``rest``, but keep the temperature of the coil."""
        heat = [kernel.TEMPERATURE, kernel.SENSOR, kernel.FILTER + 3]
        warm = self.state[heat]
        self.rest()
        self.state[heat] = warm

    def force_constant_at(self, position_m: float) -> float:
        """Return N/A, equal to V s/m, at a position in metres."""
        return self.parameters.force_constant_n_per_a * self.coil.at(position_m)

    def static_position(self, force_n: float) -> float:
        """Return the equilibrium position, metres, under a steady force, newtons including gravity, fully relaxed."""
        return self._balance(lambda _: force_n)

    def _balance(self, force_n: Callable[[float], float]) -> float:
        # Equilibrium position of a force, N, that may depend on position, m.
        low, high = -1e-3, self.parameters.stroke_m + 1e-3
        for _ in range(60):
            middle = 0.5 * (low + high)
            if self._surplus(force_n(middle), middle) > 0:
                low = middle
            else:
                high = middle
        return 0.5 * (low + high)

    def _surplus(self, force_n: float, position: float) -> float:
        # Net steady force into the tissue; decreases with position.
        tissue, depth = self.tissue, position - self.tissue.surface_m
        stop = self.parameters.stop_stiffness_n_per_m * (
            max(0.0, -position) - max(0.0, position - self.parameters.stroke_m)
        )
        if tissue.kind == "wiener":
            return force_n + stop - tissue.stiffness.coefficient * _latent(tissue, position)
        if tissue.kind == "hammerstein":
            pushed = tissue.curve_scale * (1.0 - float(np.exp(-tissue.curve_rate * force_n)))
            return pushed + stop - tissue.stiffness.coefficient * depth
        elastic = tissue.elastic_force(depth)
        if "contact" in tissue.extras:
            elastic = max(0.0, elastic)
        return force_n + stop - elastic


def _latent(tissue: Tissue, position: float) -> float:
    # State of the linear block before the static curve; limited where the curve saturates.
    share = min((position - tissue.surface_m) / tissue.curve_scale, 1.0 - 1e-12)
    return -float(np.log1p(-share)) / (tissue.curve_rate * tissue.stiffness.coefficient)
