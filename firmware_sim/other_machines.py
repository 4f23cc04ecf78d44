"""Records of other machines: a servo axis, a hysteretic oscillator, a Duffing circuit and a two-mass drive.

    python -m firmware_sim.other_machines servo_axis --out axis.csv --seed 1

Each machine is integrated in steps much shorter than a sample. The file has the columns ``time`` (s), ``force`` and
``position`` (of the circuit ``input`` and ``output``, V), to be imported by ``tissueid import``.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

_FINE = 20
"""Integration steps in a sample."""


@dataclass(frozen=True)
class MachineRecord:
    """Input and output of a machine, shape (n,) each, with their names and units."""

    input: Array
    output: Array
    sample_rate_hz: float
    names: tuple[str, str] = ("force", "position")
    units: tuple[str, str] = ("N", "m")


@dataclass(frozen=True)
class ServoAxis:
    """A linear axis with ball screw under cascaded position control.

    Janot, Gautier and Brunot, Data Set and Reference Models of EMPS, Workshop on Nonlinear System Identification
    Benchmarks (2019): mass, friction, offset, gains of the drive and of the controller.
    """

    mass_kg: float = 95.1
    viscous_n_s_per_m: float = 203.5
    coulomb_n: float = 20.4
    offset_n: float = 3.2
    coulomb_out_ratio: float = 1.0
    """Coulomb friction in the negative direction relative to the positive one."""
    force_per_volt: float = 35.15
    position_gain_1_s: float = 160.2
    velocity_gain_v_s_per_m: float = 243.5
    limit_v: float = 10.0
    resolution_m: float = 1e-6
    sample_rate_hz: float = 1000.0


@dataclass(frozen=True)
class BoucWen:
    """An oscillator with a Bouc-Wen restoring force.

    Noel and Schoukens, Hysteretic benchmark with a dynamic nonlinearity, Workshop on Nonlinear System Identification
    Benchmarks (2016).
    """

    mass_kg: float = 2.0
    damping_n_s_per_m: float = 10.0
    stiffness_n_per_m: float = 5e4
    alpha_n_per_m: float = 5e4
    beta_1_m: float = 1e3
    gamma: float = 0.8
    delta: float = -1.1
    nu: float = 1.0
    force_n: float = 50.0
    band_hz: tuple[float, float] = (5.0, 150.0)
    noise_m: float = 8e-6
    sample_rate_hz: float = 750.0


@dataclass(frozen=True)
class Duffing:
    """An electronic mass on a spring with square and cubic terms.

    Wigren and Schoukens, Three free data sets for development and benchmarking in nonlinear system identification,
    European Control Conference (2013) 2933-2938: resonance, damping and sample rate.
    """

    natural_hz: float = 68.0
    damping_ratio: float = 0.031
    square_1_v: float = 0.2
    cubic_1_v2: float = 4.0
    input_v: float = 0.035
    band_hz: tuple[float, float] = (1.0, 200.0)
    noise_v: float = 2e-4
    sample_rate_hz: float = 1e7 / 2**14


@dataclass(frozen=True)
class TwoMassDrive:
    """A motor and a load with a flexible coupling, sliding on guides; the position is the motor's.

    Masses and frequencies of a small belt axis; structure after Schroder, Elektrische Antriebe - Regelung von
    Antriebssystemen (2015), ch. 19.
    """

    motor_kg: float = 0.8
    load_kg: float = 1.2
    coupling_n_per_m: float = 3.0e4
    coupling_n_s_per_m: float = 6.0
    motor_n_s_per_m: float = 12.0
    load_n_s_per_m: float = 4.0
    spring_n_per_m: float = 0.0
    """Spring between the motor and the ground."""
    coulomb_n: float = 3.0
    """Dry friction of the motor's guide."""
    force_n: float = 12.0
    band_hz: tuple[float, float] = (0.5, 80.0)
    noise_m: float = 1e-6
    sample_rate_hz: float = 1000.0


@njit(cache=True)  # type: ignore[untyped-decorator]
def _axis(wanted, figures, fine, period, noise):  # type: ignore[no-untyped-def]
    # Coulomb friction by time stepping: the impulse of friction opposes the velocity and cannot reverse it (Moreau).
    mass, viscous, coulomb, offset, ratio, volt, gain, speed_gain, limit, resolution = figures
    force, position = np.empty(wanted.size), np.empty(wanted.size)
    x, v, before = wanted[0], 0.0, wanted[0]
    step = period / fine
    for n in range(wanted.size):
        read = np.round((x + noise[n]) / resolution) * resolution
        speed = (read - before) / period
        before = read
        asked = speed_gain * (gain * (wanted[n] - read) - speed)
        drive = volt * min(max(asked, -limit), limit)
        position[n], force[n] = read, drive
        for _ in range(fine):
            free = (v + step * (drive - offset) / mass) / (1.0 + step * viscous / mass)
            friction = step * coulomb * (1.0 if free > 0.0 else ratio) / mass
            v = max(free - friction, 0.0) if free > 0.0 else min(free + friction, 0.0)
            x += step * v
    return force, position


@njit(cache=True)  # type: ignore[untyped-decorator]
def _bouc_wen_slope(x, v, z, force, p):  # type: ignore[no-untyped-def]
    mass, damping, stiffness, alpha, beta, gamma, delta, nu = p
    size = abs(z)
    rate = alpha * v - beta * (gamma * abs(v) * size ** (nu - 1.0) * z + delta * v * size**nu)
    return v, (force - stiffness * x - damping * v - z) / mass, rate


@njit(cache=True)  # type: ignore[untyped-decorator]
def _bouc_wen(force, p, step):  # type: ignore[no-untyped-def]
    # Classical Runge-Kutta over pairs of fine steps of the force.
    out = np.empty((force.size - 1) // 2 + 1)
    x = v = z = 0.0
    out[0] = x
    for n in range(out.size - 1):
        first, middle, last = force[2 * n], force[2 * n + 1], force[2 * n + 2]
        a = _bouc_wen_slope(x, v, z, first, p)
        b = _bouc_wen_slope(x + step * a[0] / 2, v + step * a[1] / 2, z + step * a[2] / 2, middle, p)
        c = _bouc_wen_slope(x + step * b[0] / 2, v + step * b[1] / 2, z + step * b[2] / 2, middle, p)
        d = _bouc_wen_slope(x + step * c[0], v + step * c[1], z + step * c[2], last, p)
        x += step / 6.0 * (a[0] + 2.0 * b[0] + 2.0 * c[0] + d[0])
        v += step / 6.0 * (a[1] + 2.0 * b[1] + 2.0 * c[1] + d[1])
        z += step / 6.0 * (a[2] + 2.0 * b[2] + 2.0 * c[2] + d[2])
        out[n + 1] = x
    return out


@njit(cache=True)  # type: ignore[untyped-decorator]
def _duffing(force, p, step):  # type: ignore[no-untyped-def]
    # Stormer-Verlet with implicit damping.
    natural, ratio, square, cubic = p
    out = np.empty(force.size)
    x = v = 0.0
    drag = natural * ratio * step
    for n in range(force.size):
        out[n] = x
        x += 0.5 * step * v
        pull = natural * natural * (force[n] - x * (1.0 + square * x + cubic * x * x))
        v = (v * (1.0 - drag) + step * pull) / (1.0 + drag)
        x += 0.5 * step * v
    return out


@njit(cache=True)  # type: ignore[untyped-decorator]
def _two_masses(force, p, step):  # type: ignore[no-untyped-def]
    motor, load, stiffness, loss, motor_drag, load_drag, ground, coulomb = p
    out = np.empty((force.size, 2))
    x = v = y = w = 0.0
    for n in range(force.size):
        out[n, 0], out[n, 1] = x, y
        x += 0.5 * step * v
        y += 0.5 * step * w
        coupling = stiffness * (x - y) + loss * (v - w)
        free = v + step * (force[n] - coupling - motor_drag * v - ground * x) / motor
        friction = step * coulomb / motor
        w += step * (coupling - load_drag * w) / load
        v = max(free - friction, 0.0) if free > 0.0 else min(free + friction, 0.0)
        x += 0.5 * step * v
        y += 0.5 * step * w
    return out


def multisine(size: int, rate_hz: float, band_hz: tuple[float, float], seed: int) -> tuple[Array, Array]:
    """Return a random-phase multisine of standard deviation 1 at the samples, (n,), and ``_FINE`` times finer.

    The fine signal begins at the first sample; its shape is (n * _FINE,).
    """
    random = np.random.default_rng(seed)
    hz = np.fft.rfftfreq(size, 1.0 / rate_hz)
    used = (hz >= band_hz[0]) & (hz <= band_hz[1])
    spectrum = np.where(used, np.exp(2j * np.pi * random.uniform(size=hz.size)), 0.0)
    fine = np.zeros(size * _FINE // 2 + 1, np.complex128)
    fine[: hz.size] = spectrum
    signal = np.fft.irfft(fine, size * _FINE)
    signal /= signal.std()
    return signal[::_FINE], signal


def moves(seconds: float, rate_hz: float, seed: int) -> Array:
    """Return point-to-point moves of an axis, m, shape (n,): trapezoids of speed with pauses, up to 0.24 m."""
    random = np.random.default_rng(seed)
    at, found = 0.02, [np.full(round(0.2 * rate_hz), 0.02)]
    while sum(piece.size for piece in found) < seconds * rate_hz:
        target = random.uniform(0.0, 0.24)
        speed, acceleration = random.uniform(0.05, 0.4), random.uniform(1.0, 4.0)
        distance = abs(target - at)
        speed = min(speed, float(np.sqrt(distance * acceleration)))
        ramp, flat = speed / acceleration, distance / speed - speed / acceleration
        time = np.arange(round((2.0 * ramp + flat) * rate_hz)) / rate_hz
        rates = np.minimum(np.minimum(acceleration * time, speed), acceleration * (2.0 * ramp + flat - time))
        path = np.cumsum(np.maximum(rates, 0.0)) / rate_hz
        found += [at + np.sign(target - at) * path, np.full(round(random.uniform(0.1, 0.4) * rate_hz), 0.0)]
        at = float(found[-2][-1])
        found[-1][:] = at
    return np.concatenate(found)[: round(seconds * rate_hz)]


def servo_axis(seed: int = 1, seconds: float = 16.0, machine: ServoAxis | None = None) -> MachineRecord:
    """Return the force of the drive (N) and the position (m) of a servo axis in closed loop."""
    machine = machine or ServoAxis()
    rate = machine.sample_rate_hz
    wanted = moves(seconds, rate, seed)
    noise = 0.3 * machine.resolution_m * np.random.default_rng(seed + 1000).standard_normal(wanted.size)
    figures = (
        machine.mass_kg,
        machine.viscous_n_s_per_m,
        machine.coulomb_n,
        machine.offset_n,
        machine.coulomb_out_ratio,
        machine.force_per_volt,
        machine.position_gain_1_s,
        machine.velocity_gain_v_s_per_m,
        machine.limit_v,
        machine.resolution_m,
    )
    force, position = _axis(wanted, figures, _FINE, 1.0 / rate, noise)
    return MachineRecord(force, position, rate)


def bouc_wen(seed: int = 1, seconds: float = 10.92, machine: BoucWen | None = None) -> MachineRecord:
    """Return the force (N) and the position (m) of a hysteretic oscillator in steady state."""
    machine = machine or BoucWen()
    rate, size = machine.sample_rate_hz, round(seconds * machine.sample_rate_hz)
    given, fine = multisine(size, rate, machine.band_hz, seed)
    p = (
        machine.mass_kg,
        machine.damping_n_s_per_m,
        machine.stiffness_n_per_m,
        machine.alpha_n_per_m,
        machine.beta_1_m,
        machine.gamma,
        machine.delta,
        machine.nu,
    )
    force = machine.force_n * np.concatenate([fine, fine, fine[:1]])
    motion = _bouc_wen(force, p, 2.0 / (rate * _FINE))[:: _FINE // 2][size : 2 * size]
    noise = machine.noise_m * np.random.default_rng(seed + 1000).standard_normal(size)
    return MachineRecord(machine.force_n * given, motion + noise, rate)


def duffing(seed: int = 1, seconds: float = 16.0, machine: Duffing | None = None) -> MachineRecord:
    """Return input and output (V) of an electronic oscillator with square and cubic stiffness."""
    machine = machine or Duffing()
    rate, size = machine.sample_rate_hz, round(seconds * machine.sample_rate_hz)
    given, fine = multisine(size, rate, machine.band_hz, seed)
    p = (2.0 * np.pi * machine.natural_hz, machine.damping_ratio, machine.square_1_v, machine.cubic_1_v2)
    motion = _duffing(machine.input_v * np.concatenate([fine, fine]), p, 1.0 / (rate * _FINE))[::_FINE][size:]
    noise = machine.noise_v * np.random.default_rng(seed + 1000).standard_normal(size)
    return MachineRecord(machine.input_v * given, motion + noise, rate, ("input", "output"), ("V", "V"))


def two_mass_drive(
    seed: int = 1, seconds: float = 12.0, machine: TwoMassDrive | None = None, *, of_load: bool = False
) -> MachineRecord:
    """Return the force of the motor (N) and the position (m) of the motor or the load of a two-mass drive."""
    machine = machine or TwoMassDrive()
    rate, size = machine.sample_rate_hz, round(seconds * machine.sample_rate_hz)
    given, fine = multisine(size, rate, machine.band_hz, seed)
    p = (
        machine.motor_kg,
        machine.load_kg,
        machine.coupling_n_per_m,
        machine.coupling_n_s_per_m,
        machine.motor_n_s_per_m,
        machine.load_n_s_per_m,
        machine.spring_n_per_m,
        machine.coulomb_n,
    )
    motion = _two_masses(machine.force_n * np.concatenate([fine, fine]), p, 1.0 / (rate * _FINE))
    position = motion[::_FINE, 1 if of_load else 0][size:]
    noise = machine.noise_m * np.random.default_rng(seed + 1000).standard_normal(size)
    return MachineRecord(machine.force_n * given, position + noise, rate)


MACHINES: dict[str, Callable[..., MachineRecord]] = {
    "servo_axis": servo_axis,
    "bouc_wen": bouc_wen,
    "duffing": duffing,
    "two_mass_drive": two_mass_drive,
}
"""Machines by name."""


def write_csv(record: MachineRecord, path: Path) -> None:
    """Write a record as CSV with a header of names and units."""
    time = np.arange(record.input.size) / record.sample_rate_hz
    header = ",".join(
        f"{name} ({unit})" for name, unit in zip(("time", *record.names), ("s", *record.units), strict=True)
    )
    np.savetxt(path, np.column_stack([time, record.input, record.output]), "%.10g", ",", header=header, comments="")


def main(arguments: list[str] | None = None) -> None:
    """Write the record of a machine."""
    parser = argparse.ArgumentParser(prog="python -m firmware_sim.other_machines", description=__doc__.split("\n")[0])
    parser.add_argument("machine", choices=MACHINES)
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.csv", help="file to write")
    parser.add_argument("--seed", type=int, default=1, help="seed of excitation and noise")
    parser.add_argument("--seconds", type=float, help="length of the record")
    chosen = parser.parse_args(arguments)
    more = {} if chosen.seconds is None else {"seconds": chosen.seconds}
    write_csv(MACHINES[chosen.machine](chosen.seed, **more), chosen.out)


if __name__ == "__main__":
    main()
