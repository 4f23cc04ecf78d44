"""True mass, damping and stiffness of the plant at a depth, which a small-signal test should find."""

from __future__ import annotations

from math import exp, sqrt
from typing import Any

from firmware_sim.plant import PlantParameters
from firmware_sim.presets import load_preset
from firmware_sim.tissue import Tissue


def local_values(preset: str | Tissue, position_m: float, parameters: PlantParameters | None = None) -> dict[str, Any]:
    """Return mass, damping and stiffness from coil force to position, linearised at a position on the actuator scale,
    for JSON.

    Electrical damping by back-EMF is not included, because the force is that of the measured current. The main values
    apply at the natural frequency: ``mass_kg`` and ``damping_n_s_per_m`` include moving part and bearing,
    ``stiffness_n_per_m`` is the tangent of the static force plus the part of relaxation at that frequency. The
    coefficients of the law, both directions of damping, and the relaxed and unrelaxed stiffness are also included.

    Raises:
        ValueError: there is no such preset, or the tissue cannot be at the position.
    """
    tissue = load_preset(preset) if isinstance(preset, str) else preset
    plant = parameters or PlantParameters()
    if not 0.0 <= position_m <= plant.stroke_m:
        raise ValueError(f"position must lie on the stroke, 0 to {plant.stroke_m:g} m, not {position_m:g}")
    depth = position_m - tissue.surface_m
    answer: dict[str, Any] = {
        "preset": tissue.name,
        "kind": tissue.kind,
        "position_m": position_m,
        "depth_m": depth,
        "in_contact": depth >= 0.0 or "contact" not in tissue.extras,
        "extras": sorted(tissue.extras),
    }
    if tissue.kind in ("wiener", "hammerstein"):
        return answer | _cascade(tissue, depth)
    if not answer["in_contact"]:
        return answer | _free(plant)
    return answer | _parallel(tissue, plant, depth)


def _free(plant: PlantParameters) -> dict[str, Any]:
    return {
        "mass_kg": plant.moving_mass_kg,
        "damping_n_s_per_m": plant.bearing_damping_n_s_per_m,
        "stiffness_n_per_m": 0.0,
    }


def _cascade(tissue: Tissue, depth: float) -> dict[str, Any]:
    """Return mass, damping and stiffness of the linear block, over the slope of the static curve (Eq. 3.27-3.29)."""
    mass, damping, stiffness = tissue.mass.at(0), tissue.damping.at(0), tissue.stiffness.at(0)
    limit = tissue.curve_scale if tissue.kind == "wiener" else tissue.curve_scale / stiffness
    if depth >= limit:
        raise ValueError(f"{tissue.name} saturates at a depth of {limit:g} m and is never as deep as {depth:g} m")
    slope = tissue.curve_scale * tissue.curve_rate * (1.0 - depth / limit)
    if tissue.kind == "wiener":
        slope *= stiffness  # the argument of the curve is the force K z of the linear block
    return {
        "mass_kg": mass / slope,
        "damping_n_s_per_m": damping / slope,
        "stiffness_n_per_m": stiffness / slope,
        "linear_block": {"mass_kg": mass, "damping_n_s_per_m": damping, "stiffness_n_per_m": stiffness},
        "static_curve": {"scale": tissue.curve_scale, "rate": tissue.curve_rate, "local_gain": slope},
    }


def _parallel(tissue: Tissue, plant: PlantParameters, depth: float) -> dict[str, Any]:
    recruited = 0.0
    if tissue.has("recruited_mass") and depth > 0.0:
        recruited = tissue.recruited_mass_kg * (1.0 - exp(-depth / tissue.recruitment_depth_m))
    mass = plant.moving_mass_kg + tissue.mass_at(depth) + recruited
    coefficient = tissue.law_at(depth)[2].at(depth)
    if tissue.layers or tissue.probe is not None:
        coefficient = tissue.elastic_force(depth) / depth if depth else tissue.tangent_stiffness(depth)
    relaxed = tissue.tangent_stiffness(depth)
    branches = tissue.active_branches()
    unrelaxed = relaxed * (1.0 + sum(branch.fraction for branch in branches))
    frequency = sqrt(max(unrelaxed, 0.0) / mass)
    # A branch is a spring of fraction * tangent in series with a damper: its storage and loss parts at this frequency.
    stored = lost = 0.0
    for branch in branches:
        turn = frequency * branch.time_s
        stored += branch.fraction * turn**2 / (1.0 + turn**2)
        lost += branch.fraction * branch.time_s / (1.0 + turn**2)
    damping = plant.bearing_damping_n_s_per_m + tissue.damping_at(depth) + relaxed * lost
    applies = "none"
    if branches:
        applies = "unrelaxed" if stored > 0.5 * sum(branch.fraction for branch in branches) else "relaxed"
    ratio = tissue.direction_ratio if tissue.has("directional_damping") else 0.0
    return {
        "mass_kg": mass,
        "damping_n_s_per_m": damping,
        "stiffness_n_per_m": relaxed * (1.0 + stored),
        "natural_frequency_rad_per_s": frequency,
        "parts": {
            "moving_mass_kg": plant.moving_mass_kg,
            "tissue_mass_kg": tissue.mass_at(depth),
            "recruited_mass_kg": recruited,
            "bearing_damping_n_s_per_m": plant.bearing_damping_n_s_per_m,
            "tissue_damping_n_s_per_m": tissue.damping_at(depth),
            "relaxation_damping_n_s_per_m": relaxed * lost,
        },
        "coefficients": {
            "mass_kg": tissue.mass_at(depth),
            "damping_n_s_per_m": tissue.damping_at(depth),
            "stiffness_n_per_m": coefficient,
        },
        "direction": {
            "pushing_damping_n_s_per_m": damping + ratio * tissue.damping_at(depth),
            "pulling_damping_n_s_per_m": damping - ratio * tissue.damping_at(depth),
            "changeover_speed_m_per_s": tissue.direction_speed_m_per_s if ratio else None,
        },
        "relaxation": {
            "relaxed_stiffness_n_per_m": relaxed,
            "unrelaxed_stiffness_n_per_m": unrelaxed,
            "times_s": [branch.time_s for branch in branches],
            "applies": applies,
        },
    }
