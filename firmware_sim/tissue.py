"""Tissue: mechanical law under the probe, with optional extras of skin."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from firmware_sim import kernel

KINDS = ("linear", "dpn", "wiener", "hammerstein")
EXTRAS = ("contact", "directional_damping", "relaxation", "recruited_mass")
_KIND_CODES = {
    "linear": kernel.PARALLEL,
    "dpn": kernel.PARALLEL,
    "wiener": kernel.WIENER,
    "hammerstein": kernel.HAMMERSTEIN,
}
_SMALLEST_FREE_MASS_KG = 0.002


@dataclass(frozen=True)
class Exponential:
    """coefficient * (exp(rate * depth) + offset): dependence of a parameter on depth (thesis C.1.4)."""

    coefficient: float
    rate_per_m: float = 0.0
    offset: float = 0.0

    def at(self, depth_m: float) -> float:
        """Return the value at a depth in metres, in the units of the coefficient."""
        return self.coefficient * (float(np.exp(self.rate_per_m * depth_m)) + self.offset)

    def slope_at(self, depth_m: float) -> float:
        """Return the derivative with respect to depth, units of the coefficient per metre."""
        return self.coefficient * self.rate_per_m * float(np.exp(self.rate_per_m * depth_m))


@dataclass(frozen=True)
class Branch:
    """One relaxation branch: ``fraction`` of the elastic force, relaxing with ``time_s``."""

    fraction: float
    time_s: float


@dataclass(frozen=True)
class Tissue:
    """Mechanical law under the probe, SI, positive into the tissue.

    Kinds:

    - ``linear`` and ``dpn``: M(y) a + B(y) v + K(y) y, added to the moving part (thesis Eq. 3.33, C.1.4); for
      ``linear`` the three do not depend on depth. Extras are possible.
    - ``wiener``: M z'' + B z' + K z = coil force, y = C1 (1 - exp(-C2 K z)) (thesis Eq. 3.26, 3.31, 3.32). M and B
      include the moving part; the back-EMF follows dy/dt.
    - ``hammerstein``: M y'' + B y' + K y = H1 (1 - exp(-H2 force)). M and B include the moving part.

    Extras, all off unless named in ``extras``:

    - ``contact``: the tissue only pushes. A surface left behind moves by its own mass, damping, elasticity and
      relaxation until the probe meets it again, inelastically.
    - ``directional_damping``: damping times 1 + ratio tanh(v / speed); ``ratio`` > 0 resists indentation more.
    - ``relaxation``: quasi-linear branches, each adding fraction * (T - T low-passed with time) to T = K(y) y.
    - ``recruited_mass``: mass * (1 - exp(-depth / depth scale)).

    Raises:
        ValueError: an unknown kind or extra, an extra on a kind without extras, or an invalid value.
    """

    name: str
    kind: str
    surface_m: float
    mass: Exponential
    damping: Exponential
    stiffness: Exponential
    curve_scale: float = 0.0
    curve_rate: float = 0.0
    extras: frozenset[str] = frozenset()
    direction_ratio: float = 0.0
    direction_speed_m_per_s: float = 0.05
    branches: tuple[Branch, ...] = ()
    recruited_mass_kg: float = 0.0
    recruitment_depth_m: float = 1e-3
    title: str = ""
    sources: dict[str, str] = field(default_factory=dict, compare=False, repr=False)

    def __post_init__(self) -> None:
        _check_names("kind", (self.kind,), KINDS)
        _check_names("extra", self.extras, EXTRAS)
        if self.extras and self.kind not in ("linear", "dpn"):
            raise ValueError(f"tissue {self.name}: extras belong to the kinds linear and dpn, not to {self.kind}")
        for problem in self._problems():
            raise ValueError(f"tissue {self.name}: {problem}")

    def _problems(self) -> Iterable[str]:
        if not 0.0 <= self.surface_m <= 0.032:
            yield f"surface_m must lie on the stroke, 0 to 0.032, not {self.surface_m}"
        if self.mass.coefficient < 0 or self.damping.coefficient < 0 or self.stiffness.coefficient < 0:
            yield "mass, damping and stiffness must not be negative"
        if self.kind in ("wiener", "hammerstein"):
            if not (self.curve_scale > 0 and self.curve_rate > 0):
                yield "the static curve needs a positive scale and rate"
            if not (self.mass.coefficient > 0 and self.stiffness.coefficient > 0):
                yield "the linear block needs mass and stiffness"
        if self.kind != "dpn" and any(e.rate_per_m or e.offset for e in self._exponentials()):
            yield f"rates and offsets belong to the kind dpn, not to {self.kind}"
        if len(self.branches) > kernel.MAX_BRANCHES:
            yield f"at most {kernel.MAX_BRANCHES} relaxation branches, not {len(self.branches)}"
        if any(b.fraction < 0 or b.time_s <= 0 for b in self.branches):
            yield "a relaxation branch needs a fraction of 0 or more and a positive time"
        if not -1.0 < self.direction_ratio < 1.0 or self.direction_speed_m_per_s <= 0:
            yield "directional damping needs a ratio between -1 and 1 and a positive speed"
        if self.recruited_mass_kg < 0 or self.recruitment_depth_m <= 0:
            yield "recruited mass must not be negative and needs a positive depth"
        if "contact" in self.extras and self.mass.at(0.0) < _SMALLEST_FREE_MASS_KG:
            yield f"a surface that can be left alone needs a mass of {_SMALLEST_FREE_MASS_KG} kg or more"

    def _exponentials(self) -> tuple[Exponential, Exponential, Exponential]:
        return self.mass, self.damping, self.stiffness

    def has(self, extra: str) -> bool:
        """Return whether an extra is on."""
        _check_names("extra", (extra,), EXTRAS)
        return extra in self.extras

    def with_extras(self, extras: Iterable[str]) -> Tissue:
        """Return the same tissue with exactly these extras on."""
        return replace(self, extras=frozenset(extras))

    def active_branches(self) -> tuple[Branch, ...]:
        """Return the active relaxation branches."""
        return self.branches if "relaxation" in self.extras else ()

    def to_array(self) -> NDArray[np.float64]:
        """Return the parameters for the compiled loop, shape (kernel.TISSUE_SIZE,)."""
        values = np.zeros(kernel.TISSUE_SIZE)
        values[kernel.KIND] = _KIND_CODES[self.kind]
        values[kernel.REST_SURFACE] = self.surface_m
        values[kernel.CONTACT] = "contact" in self.extras
        for first, law in zip((kernel.MASS, kernel.DAMPING, kernel.STIFFNESS), self._exponentials(), strict=True):
            values[first : first + 3] = law.coefficient, law.rate_per_m, law.offset
        values[kernel.CURVE_SCALE], values[kernel.CURVE_RATE] = self.curve_scale, self.curve_rate
        values[kernel.DIRECTION_SPEED] = self.direction_speed_m_per_s
        if "directional_damping" in self.extras:
            values[kernel.DIRECTION_RATIO] = self.direction_ratio
        values[kernel.RECRUITMENT_DEPTH] = self.recruitment_depth_m
        if "recruited_mass" in self.extras:
            values[kernel.RECRUITED_MASS] = self.recruited_mass_kg
        values[kernel.BRANCH_TIME : kernel.BRANCH_TIME + kernel.MAX_BRANCHES] = 1.0
        for k, branch in enumerate(self.active_branches()):
            values[kernel.BRANCH_GAIN + k] = branch.fraction
            values[kernel.BRANCH_TIME + k] = branch.time_s
        return values


def _check_names(what: str, names: Iterable[str], known: tuple[str, ...]) -> None:
    for name in names:
        if name not in known:
            raise ValueError(f"unknown {what} {name!r}; known: {', '.join(known)}")


FREE_AIR = Tissue(
    name="free air",
    kind="linear",
    surface_m=0.0,
    mass=Exponential(0.0),
    damping=Exponential(0.0),
    stiffness=Exponential(0.0),
    title="Nothing under the probe",
)
"""Nothing under the probe: the coil falls to its stop."""
