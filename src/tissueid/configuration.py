"""How the instrument meets the tissue: which way it acts, with which probe, and what else moves with it (thesis 2.2.3)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

ConfigurationName = Literal["indentation", "extension", "surface"]


@dataclass(frozen=True)
class Probe:
    """The tip, SI. ``diameter_m`` of a round one; ``width_m`` by ``length_m`` of the extension probe."""

    name: str = "indenter-4.4mm"
    diameter_m: float | None = 4.4e-3
    width_m: float | None = None
    length_m: float | None = None
    corner_radius_m: float | None = None


@dataclass(frozen=True)
class Configuration:
    """One way of using the instrument.

    ``external_spring_n_per_m`` stands in parallel to the tissue and is subtracted from what is identified: sliding on a
    surface has no stiffness of its own, and needs one (thesis 2.2.3).
    """

    name: ConfigurationName = "indentation"
    probe: Probe = field(default_factory=Probe)
    external_spring_n_per_m: float = 0.0
