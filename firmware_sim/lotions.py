"""Skin after a lotion: factors of stiffness and damping (thesis 7.4, Figs 7.21 and 7.22)."""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace

from firmware_sim.tissue import Friction, Tissue


@dataclass(frozen=True)
class Lotion:
    """Factors of stiffness and damping in indentation and along the surface; mass does not change.

    The thesis prints no numbers, only directions: in indentation the stiffness changes at every depth, and mass and
    damping do not; along the surface both fall. It did not test Vaseline along the surface.
    """

    title: str
    indentation_stiffness: float
    surface_stiffness: float
    surface_damping: float


LOTIONS = {
    "chanel": Lotion("Chanel Hydramax + Active", 1.06, 0.75, 0.70),
    "vaseline": Lotion("Vaseline Total Moisture", 0.82, 0.90, 0.85),
}
"""Lotions by name; the size of every factor is chosen."""


def with_lotion(tissue: Tissue, name: str) -> Tissue:
    """Return the skin after the lotion. An external spring keeps its stiffness.

    Raises:
        ValueError: there is no such lotion, or the tissue is not skin under a probe that pushes or slides.
    """
    if name not in LOTIONS:
        raise ValueError(f"there is no lotion {name!r}; there are: {', '.join(LOTIONS)}")
    lotion = LOTIONS[name]
    spring = tissue.external_spring_n_per_m
    if spring and spring < tissue.stiffness.coefficient:
        own = tissue.stiffness.coefficient - spring
        return replace(
            tissue,
            stiffness=replace(tissue.stiffness, coefficient=spring + lotion.surface_stiffness * own),
            damping=replace(tissue.damping, coefficient=lotion.surface_damping * tissue.damping.coefficient),
            friction=tissue.friction
            and Friction(*(lotion.surface_damping * value for value in astuple(tissue.friction))),
        )
    if not tissue.branches or tissue.extension is not None:  # of the presets, only skin relaxes
        raise ValueError(f"tissue {tissue.name}: a lotion is for skin under a probe that pushes or slides")
    factor = lotion.indentation_stiffness
    return replace(
        tissue,
        stiffness=replace(tissue.stiffness, coefficient=factor * tissue.stiffness.coefficient),
        layers=tuple(replace(layer, stiffness_n_per_m=factor * layer.stiffness_n_per_m) for layer in tissue.layers),
    )
