"""Tissue: mechanical law under the probe, with optional extras of skin."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from firmware_sim import kernel
from firmware_sim.effects.mechanics import DryFriction
from firmware_sim.layers import LAYER_VALUES, Layer, layer_problem, layer_values
from firmware_sim.probe import FOUNDATION_SHARE, REFERENCE, Probe

KINDS = ("linear", "dpn", "wiener", "hammerstein")
EXTRAS = ("contact", "directional_damping", "relaxation", "recruited_mass")
_KIND_CODES = {
    "linear": kernel.PARALLEL,
    "dpn": kernel.PARALLEL,
    "wiener": kernel.WIENER,
    "hammerstein": kernel.HAMMERSTEIN,
}
_SMALLEST_FREE_MASS_KG = 0.002
PRESLIDING_M = 1e-4
"""Displacement before a slider slips over skin, m; an estimate."""


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
class Pulled:
    """Rates of the exponential laws with distance when an attached tissue is pulled (thesis 2.1), 1/m."""

    stiffness_rate_per_m: float
    damping_rate_per_m: float = 0.0


@dataclass(frozen=True)
class Extension:
    """Strip of tissue that is stretched along the surface: orientation and length (thesis 7.3).

    The laws of the tissue hold along the fibres and for ``reference_length_m``. Across, the rate of the stiffness is
    ``across_rate_per_m``; in between it follows the squared cosine of the angle. Angles are those against the limb's
    axis: 0 is vertical, 90 horizontal. Strains and not displacements count: coefficients and rates of stiffness and
    damping go with the inverse of the length, the moving mass with the length.
    """

    fibre_deg: float
    across_rate_per_m: float
    reference_length_m: float
    orientation_deg: float = 0.0
    length_m: float | None = None

    def applied(self, mass: Exponential, damping: Exponential, stiffness: Exponential) -> tuple[Exponential, ...]:
        """Return the laws of mass, damping and stiffness at this orientation and length."""
        along = float(np.cos(np.radians(self.orientation_deg - self.fibre_deg))) ** 2
        rate = self.across_rate_per_m + along * (stiffness.rate_per_m - self.across_rate_per_m)
        ratio = self.reference_length_m / (self.length_m or self.reference_length_m)

        def scaled(law: Exponential, rate_per_m: float) -> Exponential:
            return replace(law, coefficient=ratio * law.coefficient, rate_per_m=ratio * rate_per_m)

        lighter = replace(mass, coefficient=mass.coefficient / ratio)
        return lighter, scaled(damping, damping.rate_per_m), scaled(stiffness, rate)


@dataclass(frozen=True)
class Friction:
    """Dry friction of a slider on skin, proportional to the force that presses it on, and the damping that remains."""

    coefficient: float
    damping_n_s_per_m: float


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

    Further parts of the kinds ``linear`` and ``dpn``, None or empty by default:

    - ``pulled``: the tissue is attached to the probe, and has other rates at negative depths. Not with ``contact``.
    - ``layers``: layers in series, in parallel with the law above (``firmware_sim.layers``).
    - ``extension``: orientation and length of a stretched strip.
    - ``external_spring_n_per_m``: part of the constant stiffness of the kind ``linear`` that is not the tissue's.
    - ``friction``: dry friction instead of the constant damping under a known normal preload; see ``pressed``.
    - ``probe``: a round probe other than the reference probe (``firmware_sim.probe``); see ``with_probe``.

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
    pulled: Pulled | None = None
    layers: tuple[Layer, ...] = ()
    extension: Extension | None = None
    external_spring_n_per_m: float = 0.0
    friction: Friction | None = None
    probe: Probe | None = None
    title: str = ""
    sources: dict[str, str] = field(default_factory=dict, compare=False, repr=False)

    def __post_init__(self) -> None:
        _check_names("kind", (self.kind,), KINDS)
        _check_names("extra", self.extras, EXTRAS)
        if self.extras and self.kind not in ("linear", "dpn"):
            raise ValueError(f"tissue {self.name}: extras belong to the kinds linear and dpn, not to {self.kind}")
        for problem in (*self._problems(), *self._part_problems()):
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

    def _part_problems(self) -> Iterable[str]:
        parts = (self.pulled, self.extension, self.probe)
        if self.kind not in ("linear", "dpn") and (self.layers or any(part is not None for part in parts)):
            yield f"layers, pulling, extension and probes belong to the kinds linear and dpn, not to {self.kind}"
        if self.pulled is not None:
            if "contact" in self.extras:
                yield "an attached tissue is not left behind: it has no contact"
            if min(self.pulled.stiffness_rate_per_m, self.pulled.damping_rate_per_m) < 0:
                yield "the rates of a pulled tissue must not be negative"
        if problem := layer_problem(self.layers):
            yield problem
        if (strip := self.extension) is not None:
            if not 1e-3 <= (strip.length_m or strip.reference_length_m) <= 0.1:
                yield "the initial length of a strip must be between 1 and 100 mm"
            if not -180.0 <= strip.orientation_deg <= 180.0:
                yield "the orientation of a strip must be between -180 and 180 degrees"
        if not 0.0 <= self.external_spring_n_per_m <= self.stiffness.coefficient and self.kind == "linear":
            yield "the external spring must be a part of the stiffness"
        if self.friction is not None and min(self.friction.coefficient, self.friction.damping_n_s_per_m) < 0:
            yield "friction and its damping must not be negative"

    def _exponentials(self) -> tuple[Exponential, ...]:
        laws = self.mass, self.damping, self.stiffness
        return laws if self.extension is None else self.extension.applied(*laws)

    def _pulled(self, law: Exponential, rate_per_m: float | None) -> Exponential:
        return law if rate_per_m is None else replace(law, rate_per_m=-rate_per_m)

    def law_at(self, depth_m: float) -> tuple[Exponential, Exponential, Exponential]:
        """Return the exponential laws of mass, damping and stiffness that hold at a depth, without probe and layers."""
        mass, damping, stiffness = self._exponentials()
        if depth_m < 0.0 and self.pulled is not None:
            damping = self._pulled(damping, self.pulled.damping_rate_per_m or None)
            stiffness = self._pulled(stiffness, self.pulled.stiffness_rate_per_m or None)
        return mass, damping, stiffness

    def layer_values(self, depth_m: float) -> tuple[float, float, float, float]:
        """Return force (N), damping (N s/m), mass (kg) and its slope (kg/m) of the layers at a depth."""
        if not self.layers:
            return 0.0, 0.0, 0.0, 0.0
        values = np.concatenate([layer.to_array() for layer in self.layers])
        force, damping, mass, slope = layer_values(values, 0, len(self.layers), depth_m)
        return force, damping, mass, slope

    def elastic_force(self, depth_m: float) -> float:
        """Return the relaxed elastic force at a depth, N."""
        force = self.law_at(depth_m)[2].at(depth_m) * depth_m
        if self.layers:
            force += self.layer_values(depth_m)[0]
        return force if self.probe is None else force * self.probe.factor(depth_m)

    def damping_at(self, depth_m: float) -> float:
        """Return the damping at a depth, N s/m, the mean of both directions."""
        damping = self.law_at(depth_m)[1].at(depth_m)
        if self.layers:
            damping += self.layer_values(depth_m)[1]
        return damping if self.probe is None else damping * self.probe.factor(depth_m)

    def mass_at(self, depth_m: float) -> float:
        """Return the mass at a depth, kg, without that of the extra ``recruited_mass``."""
        mass = self.law_at(depth_m)[0].at(depth_m)
        return mass + self.layer_values(depth_m)[2] if self.layers else mass

    def tangent_stiffness(self, depth_m: float) -> float:
        """Return the derivative of the relaxed elastic force with respect to depth, N/m."""
        law = self.law_at(depth_m)[2]
        tangent = law.at(depth_m) + law.slope_at(depth_m) * depth_m
        if not self.layers and self.probe is None:
            return tangent
        change = 1e-7
        return (self.elastic_force(depth_m + change) - self.elastic_force(depth_m - change)) / (2.0 * change)

    def with_probe(self, probe: Probe) -> Tissue:
        """Return the same tissue under another round probe; the reference probe changes nothing.

        Raises:
            ValueError: the tissue already has another probe, is stretched, or slides.
        """
        if self.probe is not None or self.extension is not None or self.external_spring_n_per_m:
            raise ValueError(f"tissue {self.name}: a round probe is for indentation with the preset's own laws")
        if probe == REFERENCE:
            return self
        share = probe.radius_ratio**3
        lightest = min(self.mass.coefficient, _SMALLEST_FREE_MASS_KG if "contact" in self.extras else 0.0)
        return replace(
            self,
            probe=probe,
            mass=replace(self.mass, coefficient=max(share * self.mass.coefficient, lightest)),
            recruited_mass_kg=share * self.recruited_mass_kg,
            layers=tuple(replace(layer, mass_kg=share * layer.mass_kg) for layer in self.layers),
        )

    def stretched(self, orientation_deg: float | None = None, length_m: float | None = None) -> Tissue:
        """Return the same strip at another orientation, degrees against the limb's axis, or initial length, m.

        Raises:
            ValueError: the tissue is not a strip in extension, or a value is not possible.
        """
        if self.extension is None:
            raise ValueError(f"tissue {self.name}: orientation and initial length belong to tissues in extension")
        given = {"orientation_deg": orientation_deg, "length_m": length_m}
        return replace(
            self, extension=replace(self.extension, **{name: v for name, v in given.items() if v is not None})
        )

    def pressed(self, normal_preload_n: float) -> tuple[Tissue, DryFriction]:
        """Return the tissue under a slider that is pressed on with a force, N, and its friction.

        The friction is dry: proportional to that force, against the motion, after a displacement of presliding.

        Raises:
            ValueError: the tissue has no friction.
        """
        if self.friction is None:
            raise ValueError(f"tissue {self.name}: a normal preload is for a tissue that has friction")
        friction = DryFriction(
            level=self.friction.coefficient * normal_preload_n, breakaway_share=0.0, presliding_m=PRESLIDING_M
        )
        damping = Exponential(self.friction.damping_n_s_per_m)
        return replace(self, damping=damping), friction

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
        if self.pulled is not None:
            values[kernel.PULLED + 1 : kernel.PULLED + 3] = (
                self.pulled.damping_rate_per_m,
                self.pulled.stiffness_rate_per_m,
            )
        if self.probe is not None:
            values[kernel.PROBE_RADIUS] = self.probe.radius_ratio
            values[kernel.PROBE_CORNER] = self.probe.corner_ratio
            values[kernel.PROBE_DEPTH] = self.probe.corner_depth_m
            values[kernel.FOUNDATION] = FOUNDATION_SHARE
        values[kernel.LAYER_COUNT] = len(self.layers)
        for k, layer in enumerate(self.layers):
            first = kernel.LAYERS + LAYER_VALUES * k
            values[first : first + LAYER_VALUES] = layer.to_array()
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
