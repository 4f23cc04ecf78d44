"""Machines of the second laboratory: what their data sheets say, and what they and the tissue truly are."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from firmware_sim.second_laboratory.effect import chosen, log_uniform

Truth = dict[str, float]

CALIBRATED = (
    "resistance_ohm",
    "inductance_h",
    "force_constant_n_per_a",
    "mass_kg",
    "damping_n_s_per_m",
    "gain",
    "spring_n_per_m",
)
"""True parameters that differ from the data sheet by the uncertainty of its calibration."""

GRAVITY_M_S2 = 9.81


@dataclass(frozen=True)
class Machine:
    """Data sheet of a machine, SI, with the deviations of its noise and the steps of its converters."""

    model: str
    sample_rate_hz: float
    stroke_m: float
    resistance_ohm: float
    inductance_h: float
    force_constant_n_per_a: float
    mass_kg: float
    damping_n_s_per_m: float
    limit_v: float
    spring_n_per_m: float
    uncertainty: float
    depth_m: float
    """Typical depth of a test."""
    force_n: float
    """Typical force on the tissue at that depth."""
    surface_m: float
    tilt_rad: float
    noise_v: float
    noise_a: float
    noise_m: float
    duration_s: float
    preload_s: float

    @property
    def steps(self) -> dict[str, float]:
        """Converter steps by signal: 0.4 of the noise."""
        return {name: 0.4 * noise for name, noise in self.noise.items()}

    @property
    def noise(self) -> dict[str, float]:
        """Deviation of the noise by signal."""
        return {"voltage": self.noise_v, "current": self.noise_a, "position": self.noise_m}

    def description(self) -> dict[str, Any]:
        """Return the attributes of the instrument in a scenario."""
        return {
            "model": self.model,
            "sample_rate_hz": self.sample_rate_hz,
            "coil_resistance_ohm": self.resistance_ohm,
            "coil_inductance_h": self.inductance_h,
            "force_constant_n_per_a": self.force_constant_n_per_a,
            "moving_mass_kg": self.mass_kg,
            "bearing_damping_n_s_per_m": self.damping_n_s_per_m,
            "amplifier_gain": 1.0,
            "amplifier_limit_v": self.limit_v,
            "stroke_m": self.stroke_m,
            "calibration_relative_uncertainty": self.uncertainty,
            "calibration_spring_n_per_m": self.spring_n_per_m,
        }


def _rounded(value: float) -> float:
    # A data sheet has three digits.
    return float(f"{value:.3g}")


def draw_machine(random: np.random.Generator) -> Machine:
    """Draw a desktop, a handheld or a bench machine."""
    kind = chosen(random, "desktop", "handheld", "bench")
    u = random.uniform
    if kind == "desktop":
        rate, stroke, limit = 2000.0, 0.032, float(u(32.0, 56.0))
        mass, constant, resistance = u(0.04, 0.09), log_uniform(random, 2.0, 12.0), u(6.0, 16.0)
        bearing, depth, force, surface, duration = u(2.0, 6.0), u(2e-3, 6e-3), u(1.5, 4.0), u(6e-3, 18e-3), 4.5
        tilt = u(0.0, 0.2)
    elif kind == "handheld":
        rate, stroke, limit = 1000.0, float(u(0.012, 0.020)), float(u(18.0, 32.0))
        mass, constant, resistance = u(0.015, 0.035), u(1.5, 4.0), u(5.0, 10.0)
        bearing, depth, force, surface, duration = u(0.6, 2.5), u(1e-3, 3e-3), u(0.8, 2.2), u(3e-3, 7e-3), 5.0
        tilt = u(0.3, np.pi)
    else:
        rate, stroke, limit = 5000.0, float(u(0.034, 0.045)), float(u(18.0, 36.0))
        mass, constant, resistance = u(0.15, 0.4), u(8.0, 20.0), u(3.0, 8.0)
        bearing, depth, force, surface, duration = u(5.0, 15.0), u(2e-3, 7e-3), u(5.0, 14.0), u(12e-3, 25e-3), 3.0
        tilt = np.pi / 2.0 * float(random.choice([0.0, 1.0])) + u(0.0, 0.05)
    force_range = constant * limit / resistance
    return Machine(
        model=f"{kind} indenter",
        sample_rate_hz=rate,
        stroke_m=_rounded(stroke),
        resistance_ohm=_rounded(resistance),
        inductance_h=_rounded(resistance * log_uniform(random, 8e-5, 4e-4)),
        force_constant_n_per_a=_rounded(constant),
        mass_kg=_rounded(mass),
        damping_n_s_per_m=_rounded(bearing),
        limit_v=_rounded(limit),
        spring_n_per_m=_rounded(force / depth * u(0.6, 1.6)),
        uncertainty=float(random.choice([0.01, 0.015, 0.02, 0.03])),
        depth_m=float(depth),
        force_n=float(min(force, 0.3 * force_range)),
        surface_m=float(surface),
        tilt_rad=float(tilt),
        noise_v=limit * log_uniform(random, 2e-5, 6e-5),
        noise_a=limit / resistance * log_uniform(random, 8e-5, 3e-4),
        noise_m=stroke * log_uniform(random, 1e-5, 3e-5),
        duration_s=duration,
        preload_s=float(random.choice([0.3, 0.4, 0.5])),
    )


def draw_truth(random: np.random.Generator, machine: Machine, *, shallow: bool) -> Truth:
    """Draw the true parameters of a machine and of the tissue under it, so that its typical force makes its depth.

    Args:
        random: generator of the scenario.
        machine: the machine.
        shallow: whether the tissue is met softly, so that the probe can lift off.
    """
    sheet = asdict(machine) | {"gain": 1.0}
    truth = {
        name: float(sheet[name]) * (1.0 + machine.uncertainty * float(np.clip(random.standard_normal(), -2.0, 2.0)))
        for name in CALIBRATED
    }
    depth = machine.depth_m * (0.5 if shallow else 1.0)
    force = machine.force_n * (0.35 if shallow else 1.0)
    growth = log_uniform(random, 1.2, 3.0)
    stiffness = force / (growth * depth)
    local = stiffness * growth * (1.0 + np.log(growth))
    tissue_mass = machine.mass_kg * float(random.uniform(0.0, 0.3))
    damping = 2.0 * float(random.uniform(0.08, 0.35)) * np.sqrt(local * (truth["mass_kg"] + tissue_mass))
    weight = truth["mass_kg"] * GRAVITY_M_S2 * float(np.cos(machine.tilt_rad))
    return truth | {
        "weight_n": float(np.clip(weight, -0.6 * force, 0.8 * force)),
        "stiffness_n_per_m": stiffness,
        "stiffness_rate_per_m": float(np.log(growth)) / depth,
        "tissue_damping_n_s_per_m": float(damping),
        "damping_rate_per_m": float(random.uniform(0.1, 0.6)) / depth,
        "tissue_mass_kg": tissue_mass,
        "surface_m": machine.surface_m,
        "spring_mass_kg": machine.mass_kg * float(random.uniform(0.03, 0.12)),
        "spring_damping_n_s_per_m": float(random.uniform(0.2, 0.8)),
        "depth_m": depth,
        "force_n": force,
        "local_stiffness_n_per_m": float(local),
    }
