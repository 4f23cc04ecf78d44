"""Simulation of commands through the chain, with effects, from simulated or measured upstream signals."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numba
import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissueid.twin import _kernel, bus
from tissueid.twin.chain_parameters import InstrumentParameters, Tissue
from tissueid.twin.effect import Effect, Hook, Readings

SUBSTEPS = 5
"""Integration steps in a sample: 0.1 ms each at 2 kHz. Half of it changes free-run signals by less than 0.02 % of their
standard deviation."""

_NUMBERS = numba.types.CPointer(numba.types.float64)
_HOOK = numba.types.void(numba.types.int64, _NUMBERS, _NUMBERS, _NUMBERS, numba.types.float64)


@dataclass(frozen=True)
class Start:
    """State at the start of a test: coil current (A), position (m), velocity (m/s)."""

    current_a: float
    position_m: float
    velocity_m_s: float = 0.0


@dataclass(frozen=True)
class ActiveEffect:
    """An effect with the values of its parameters, shape (parameters,), SI, in the order of their declaration."""

    effect: Effect
    values: NDArray[np.float64]

    def __post_init__(self) -> None:
        values = np.ascontiguousarray(self.values, np.float64)
        if values.shape != (len(self.effect.parameters),) or np.isnan(values).any():
            raise ValueError(f"{self.effect.name} takes {len(self.effect.parameters)} parameters, not {self.values}")
        object.__setattr__(self, "values", values)


@dataclass(frozen=True)
class MeasuredSignals:
    """Measured signals that replace simulated ones, each of shape (n,), SI, without gaps.

    ``voltage`` replaces the amplifier, ``current`` the coil, and ``position`` with ``velocity`` the moving part.
    """

    voltage: NDArray[np.float64] | None = None
    current: NDArray[np.float64] | None = None
    position: NDArray[np.float64] | None = None
    velocity: NDArray[np.float64] | None = None
    tracking_rad_s: float = 0.0
    """Bandwidth of an observer that pulls the simulated motion towards ``position``, in place of replacing it."""


NOTHING_MEASURED = MeasuredSignals()


@dataclass(frozen=True)
class Simulated:
    """Result of a simulation: readings, and the velocity of the probe (m/s), all of shape (n,)."""

    readings: Readings
    velocity: NDArray[np.float64] = field(repr=False)


def simulate(
    command_v: NDArray[np.float64],
    sample_rate_hz: float,
    instrument: InstrumentParameters,
    tissue: Tissue,
    start: Start,
    acting: Sequence[ActiveEffect] = (),
    *,
    given: MeasuredSignals = NOTHING_MEASURED,
    on_tissue: bool = True,
    substeps: int = SUBSTEPS,
) -> Simulated:
    """Simulate a command, shape (n,), V, held over each sample; readings are those at the end of each sample.

    Args:
        command_v: the command of the host.
        sample_rate_hz: samples a second.
        instrument: parameters of amplifier, coil and moving part.
        tissue: parameters of the tissue, or ``chain_parameters.spring`` or ``nothing``.
        start: state at the start.
        acting: effects in any order, at most ``bus.SLOTS``.
        given: measured signals that replace simulated ones.
        on_tissue: whether effects of the stage ``tissue`` take part; False on the calibration spring and in free air.
        substeps: integration steps in a sample.

    Raises:
        ValueError: too many effects, or arrays of different lengths.
    """
    met = simulated_motion(
        command_v,
        sample_rate_hz,
        instrument,
        tissue,
        start,
        acting,
        given=given,
        on_tissue=on_tissue,
        substeps=substeps,
    )
    return Simulated(recorded(met.readings, acting, on_tissue), met.velocity)


def simulated_motion(
    command_v: NDArray[np.float64],
    sample_rate_hz: float,
    instrument: InstrumentParameters,
    tissue: Tissue,
    start: Start,
    acting: Sequence[ActiveEffect] = (),
    *,
    given: MeasuredSignals = NOTHING_MEASURED,
    on_tissue: bool = True,
    substeps: int = SUBSTEPS,
) -> Simulated:
    """Simulate as ``simulate``, without effects on the recorded numbers."""
    command = np.ascontiguousarray(command_v, np.float64)
    state = np.array([start.current_a, start.position_m, start.velocity_m_s, 0.0])
    out = run(prepared(acting, on_tissue), command, instrument, tissue, sample_rate_hz, substeps, state, given)
    times = np.arange(1, command.size + 1) / sample_rate_hz
    return Simulated(Readings(times, out[0], out[1], out[2], sample_rate_hz), out[3])


def recorded(met: Readings, acting: Sequence[ActiveEffect], on_tissue: bool = True) -> Readings:
    """Apply effects on the recorded numbers. A motion that diverges, which a fit can try, gives no warning."""
    readings = met
    with np.errstate(invalid="ignore", over="ignore"):
        for item in in_order(acting):
            if item.effect.recording is not None and (on_tissue or item.effect.on_spring):
                readings = item.effect.recording(readings, item.values)
    return readings


@dataclass(frozen=True)
class PreparedEffects:
    """Effects ``in_order``, in the form of the compiled loop: addresses of their hooks, shape (bus.SLOTS,), where each
    is called, their parameters, and in ``states`` their states and the bus."""

    hooks: NDArray[np.int64]
    places: NDArray[np.bool_]
    parameters: NDArray[np.float64]
    states: NDArray[np.float64]


def in_order(acting: Iterable[ActiveEffect]) -> list[ActiveEffect]:
    """Return effects in the order in which they are evaluated."""
    return sorted(acting, key=lambda item: item.effect.evaluation)


def prepared(acting: Sequence[ActiveEffect], on_tissue: bool) -> PreparedEffects:
    """Return effects in the form of the compiled loop, at the start of a test.

    Raises:
        ValueError: too many effects.
    """
    if len(acting) > bus.SLOTS:
        raise ValueError(f"at most {bus.SLOTS} effects act at once, not {len(acting)}")
    hooks = np.zeros(bus.SLOTS, np.int64)
    places = np.zeros((bus.SLOTS, bus.PLACES), np.bool_)
    parameters = np.zeros((bus.SLOTS, bus.MOST_PARAMETERS))
    for k, item in enumerate(in_order(acting)):
        if _is_active(item, on_tissue):
            places[k, list(item.effect.places)] = True
            parameters[k, : item.values.size] = item.values
            hooks[k] = compiled(item.effect.hook).address
    states = np.zeros((bus.SLOTS + 1, bus.MOST_STATES))
    return PreparedEffects(hooks, places, parameters, states)


def run(
    effects: PreparedEffects,
    command: NDArray[np.float64],
    instrument: InstrumentParameters,
    tissue: Tissue,
    sample_rate_hz: float,
    substeps: int,
    state: NDArray[np.float64],
    given: MeasuredSignals = NOTHING_MEASURED,
) -> NDArray[np.float64]:
    """Simulate one piece of a command, shape (n,): voltage, current, position and velocity, shape (4, n).

    ``state``, shape (4,), and the states of the effects are updated in place.
    """
    size = command.size
    measured = np.zeros((4, size if _any(given) else 1))
    for row, values in enumerate((given.voltage, given.current, given.position, given.velocity)):
        if values is not None:
            measured[row] = values
    replaced = given.position is not None and given.tracking_rad_s == 0.0
    flags = np.array([given.voltage is not None, given.current is not None, replaced])
    out = np.empty((4, size))
    _kernel.integrate(
        command,
        measured,
        flags,
        instrument.to_array(),
        tissue.to_array(),
        1.0 / sample_rate_hz,
        substeps,
        state,
        effects.hooks,
        effects.places,
        effects.parameters,
        effects.states,
        out,
        given.tracking_rad_s,
    )
    return out


def _any(given: MeasuredSignals) -> bool:
    return given.voltage is not None or given.current is not None or given.position is not None


def _is_active(item: ActiveEffect, on_tissue: bool) -> bool:
    effect = item.effect
    return effect.hook is not None and (on_tissue or (effect.stage != "tissue" and effect.on_spring))


@cache
def compiled(hook: Hook) -> Any:
    """Return the hook compiled to a C function, so that one compiled loop serves every effect.

    It is kept: the loop calls it by its address. A division by zero gives an infinite value or NaN, as everywhere in
    the loop: an exception could not leave it, and Python would print each.
    """
    return numba.cfunc(_HOOK, cache=True, error_model="numpy")(hook)


def values_by_name(effect: Effect, values: Mapping[str, float]) -> NDArray[np.float64]:
    """Return parameters in the order of their declaration from a mapping by name.

    Raises:
        ValueError: a parameter without a default is missing, or one is unknown.
    """
    names = [parameter.name for parameter in effect.parameters]
    given = {item.name: item.default for item in effect.parameters if item.default is not None} | dict(values)
    if set(names) != set(given):
        raise ValueError(f"{effect.name} takes {', '.join(names)}, not {', '.join(values) or 'nothing'}")
    return np.array([given[name] for name in names], np.float64)


FloatArray = NDArray[np.float64]

_GIVEN = np.array([False, True, False])
"""Of voltage, current and motion only the current is given: the force at a force constant of 1 N/A."""


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _integrate(  # type: ignore[no-untyped-def]
    edges, starts, follows, force, given, figures, tissue, period, substeps, effects, places, parameters, states, out
):
    state = np.zeros(4)
    for k in range(edges.size - 1):
        first, end = edges[k], edges[k + 1]
        if follows:
            # The second mass keeps its motion relative to the first one.
            states[0, 0] += starts[k, 0] - state[1]
            states[0, 1] += starts[k, 1] - state[2]
        state[1] = starts[k, 0]
        state[2] = starts[k, 1]
        states[bus.SLOTS, bus.SAMPLE] = first
        piece = force[first:end].copy()
        measured = np.zeros((4, piece.size))
        measured[1] = piece
        readings = np.empty((4, piece.size))
        _kernel.integrate(
            piece,
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
            readings,
            0.0,
        )
        out[:, first:end] = readings


def simulate_windows(
    effects: PreparedEffects,
    force_n: FloatArray,
    sample_rate_hz: float,
    instrument: InstrumentParameters,
    tissue: Tissue,
    edges: NDArray[np.int64],
    starts: FloatArray,
    substeps: int,
    *,
    second_mass: bool = False,
) -> FloatArray:
    """Return voltage, current, position and velocity at the end of each sample, shape (4, n).

    Args:
        effects: effects at the start; their states are updated in place and continue from window to window.
        force_n: the force, shape (n,), held over each sample.
        sample_rate_hz: its sample rate.
        instrument: parameters of the mass, with a force constant of 1 N/A.
        tissue: the spring, or nothing.
        edges: first sample of each window, and n, shape (windows + 1,).
        starts: position (m) and velocity (m/s) at the start of each window, shape (windows, 2).
        substeps: integration steps in a sample.
        second_mass: whether the first effect is a second mass, whose state begins with its position and velocity.
    """
    out = np.empty((4, force_n.size))
    common: tuple[Any, ...] = (instrument.to_array(), tissue.to_array(), 1.0 / sample_rate_hz, substeps)
    _integrate(
        edges,
        starts,
        second_mass,
        force_n,
        _GIVEN,
        *common,
        effects.hooks,
        effects.places,
        effects.parameters,
        effects.states,
        out,
    )
    return out


@dataclass(frozen=True)
class NamedTwin:
    """Parameters with standard deviations where known, SI, and effects.

    ``stds`` is by name: ``force_constant_n_per_a``, ``tissue_stiffness_n_per_m``, ``dry_friction.coulomb_n``.
    ``sample_rate_hz`` is that of the tests that the twin was fitted to. ``unmodelled`` is the error that the twin left
    of each signal there, without the sensor noise, as a share of the signal's standard deviation.
    """

    name: str
    version: int
    instrument: InstrumentParameters
    tissue: Tissue
    acting: tuple[ActiveEffect, ...]
    sample_rate_hz: float
    stds: dict[str, float] = field(default_factory=dict)
    unmodelled: dict[str, float] = field(default_factory=dict)

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(item.effect.name for item in self.acting)
