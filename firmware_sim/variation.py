"""Variation of skin: between people, between placings of the probe, between tests, and before the first test.

Every draw is a function of seeds and numbers only, so the same scenario gives the same tests in any order of calls.
The draws multiply parameters of a tissue of kind ``dpn``; other kinds have no skin to vary.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from firmware_sim.effects.environment import PhysiologicalMotion
from firmware_sim.tissue import Exponential, Tissue

PRESSING_N = 1.0
"""Force, N, above which the probe compresses the skin lastingly; chosen above the contacts that find the surface."""

_COMPRESSING_S = 1.5
"""Time constant of the lasting compression while pressed, s; chosen: one test of 4.5 s completes 95 % of it."""

_RECOVERY_S = 600.0
"""Time constant of the recovery, s; chosen: five tests in a row find the skin compressed (thesis 7.1.2)."""


@dataclass(frozen=True)
class Spread:
    """Standard deviations of the logarithms of a tissue's parameters, and of its surface position, m.

    ``softness`` is for the static curve as a whole: it stretches the depths at constant force. ``sharpness`` is for the
    growth of stiffness with depth, at constant stiffness where skin carries some newtons. ``mass`` is for all of the
    tissue's mass, ``direction`` for the logarithm of the ratio of the dampings in and out.
    """

    softness: float = 0.0
    sharpness: float = 0.0
    damping: float = 0.0
    mass: float = 0.0
    direction: float = 0.0
    surface_m: float = 0.0

    def drawn(self, random: np.random.Generator, size: float) -> NDArray[np.float64]:
        """Draw six deviations, shape (6,): five logarithms and a position, m, ``size`` times as large."""
        return size * np.array(list(vars(self).values())) * random.standard_normal(6)


@dataclass(frozen=True)
class SiteVariation:
    """Variation of one site: between subjects, placings and tests; and the lasting compression by the first test.

    ``compression_m`` is the median depth by which the surface stays compressed, ``compression_spread`` the standard
    deviation of its logarithm between placings; damping falls by ``compression_damping`` with it. ``motion_m`` is the
    height of a breath, which pulse and tremor accompany: it moves the surface during a test.
    """

    subject: Spread
    placing: Spread
    test: Spread
    compression_m: float
    motion_m: float
    compression_spread: float = 0.4
    compression_damping: float = 0.05


@dataclass(frozen=True)
class Variation:
    """Sources of the draws: ``size`` scales placings, tests and the lasting compression; 0 switches them off.

    ``subject`` is the number of a person, or None for the person of the preset. ``seed`` is that of the instrument.

    Raises:
        ValueError: the size is not between 0 and 3.
    """

    seed: int = 0
    size: float = 1.0
    subject: int | None = None

    def __post_init__(self) -> None:
        if not 0.0 <= self.size <= 3.0:
            raise ValueError(f"the variation must be between 0 and 3 times that of skin, not {self.size:g}")

    @property
    def acts(self) -> bool:
        """Whether any draw differs from the preset."""
        return self.size > 0.0 or self.subject is not None

    def tissue(self, preset: Tissue, placing: int, test: int, compressed: float) -> Tissue:
        """Return the tissue that a test meets.

        ``placing`` and ``test`` are counted from 0; ``compressed`` is the share of the lasting compression, 0 to 1.

        Raises:
            ValueError: the tissue is not of kind ``dpn``.
        """
        if preset.kind != "dpn":
            raise ValueError(f"variation is for skin, a tissue of kind dpn; {preset.name} is of kind {preset.kind}")
        site = site_variation(preset.name)
        name = crc32(preset.name.encode())
        deviations = np.zeros(6)
        if self.subject is not None:
            # Half of the variance belongs to the person and half to the site of that person.
            draws = [np.random.default_rng([1, self.subject, part]) for part in (0, name)]
            deviations += sum(site.subject.drawn(random, np.sqrt(0.5)) for random in draws)
        placed = np.random.default_rng([2, self.seed, name, placing])
        deviations += site.placing.drawn(placed, self.size)
        share = float(np.exp(site.compression_spread * placed.standard_normal()))
        deviations += site.test.drawn(np.random.default_rng([3, self.seed, name, placing, test]), self.size)
        varied = _changed(preset, deviations)
        lost = self.size * share * compressed
        return _compressed(varied, site.compression_m * lost, 1.0 - site.compression_damping * min(lost, 2.0))

    def motion(self, preset: Tissue) -> PhysiologicalMotion:
        """Return the motion of the body under the probe."""
        level = self.size * site_variation(preset.name).motion_m
        return PhysiologicalMotion(level=level, pattern=self.seed % _PATTERNS)


_PATTERNS = 10_000
"""Number of different motions of a body."""


def compressed_share(share: float, pressed_s: float, passed_s: float) -> float:
    """Return the share of the lasting compression after some seconds, ``pressed_s`` of them under load."""
    share *= float(np.exp(-max(0.0, passed_s - pressed_s) / _RECOVERY_S))
    return 1.0 - (1.0 - share) * float(np.exp(-pressed_s / _COMPRESSING_S))


def _changed(tissue: Tissue, deviations: NDArray[np.float64]) -> Tissue:
    """Return a tissue with deviations, shape (6,), in the order of ``Spread``."""
    softness, sharpness, damping, mass = (float(np.exp(d)) for d in deviations[:4])
    law = tissue.stiffness
    # At the pivot the elastic force of the preset is some newtons: there a change of the growth leaves the stiffness.
    pivot = _depth_at(tissue, _PIVOT_N)
    growing, constant = law.at(pivot) - law.coefficient * law.offset, law.coefficient * law.offset
    rate = law.rate_per_m * sharpness
    coefficient = growing * float(np.exp(-rate * pivot))
    # Stretching the depth by ``softness`` at constant force divides stiffness and rates by it.
    stiffness = Exponential(coefficient / softness, rate / softness, constant / coefficient if coefficient else 0.0)
    return replace(
        tissue,
        surface_m=tissue.surface_m + float(deviations[5]),
        mass=replace(tissue.mass, coefficient=mass * tissue.mass.coefficient),
        damping=Exponential(
            damping * tissue.damping.coefficient, tissue.damping.rate_per_m / softness, tissue.damping.offset
        ),
        stiffness=stiffness,
        direction_ratio=float(np.tanh(np.arctanh(tissue.direction_ratio) * np.exp(deviations[4]))),
        recruited_mass_kg=mass * tissue.recruited_mass_kg,
        recruitment_depth_m=softness * tissue.recruitment_depth_m,
    )


_PIVOT_N = 6.0
"""Static force, N, at whose depth ``sharpness`` leaves the stiffness coefficient as it is: the mean of a test."""


def _depth_at(tissue: Tissue, force_n: float) -> float:
    """Return the depth, m, at which the relaxed elastic force is ``force_n``."""
    low, high = 0.0, 0.032
    for _ in range(50):
        middle = 0.5 * (low + high)
        if tissue.stiffness.at(middle) * middle < force_n:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def _compressed(tissue: Tissue, depth_m: float, damping_share: float) -> Tissue:
    """Return a tissue whose surface stays ``depth_m`` deeper: layers below keep their laws against position."""
    return replace(
        tissue,
        surface_m=tissue.surface_m + depth_m,
        damping=_deeper(replace(tissue.damping, coefficient=damping_share * tissue.damping.coefficient), depth_m),
        stiffness=_deeper(tissue.stiffness, depth_m),
    )


def _deeper(law: Exponential, depth_m: float) -> Exponential:
    """Return the same law of position for depths from a surface that lies ``depth_m`` deeper."""
    growth = float(np.exp(law.rate_per_m * depth_m))
    return Exponential(law.coefficient * growth, law.rate_per_m, law.offset / growth)


_POSTERIOR = SiteVariation(
    subject=Spread(0.10, 0.13, 0.175, 0.15, 0.4),
    placing=Spread(0.02, 0.03, 0.03, 0.03, 0.05, 0.05e-3),
    test=Spread(0.025, 0.03, 0.05, 0.02, 0.16, 0.02e-3),
    compression_m=0.4e-3,
    motion_m=0.13e-3,
)
_SITES = {
    "anterior": SiteVariation(
        subject=Spread(0.15, 0.14, 0.25, 0.15, 0.16),
        placing=Spread(0.02, 0.03, 0.03, 0.03, 0.05, 0.05e-3),
        test=Spread(0.025, 0.03, 0.05, 0.02, 0.16, 0.02e-3),
        compression_m=0.3e-3,
        motion_m=0.13e-3,
    ),
    "distal": SiteVariation(
        subject=Spread(0.12, 0.15, 0.15, 0.15, 0.16),
        placing=Spread(0.02, 0.03, 0.03, 0.03, 0.05, 0.03e-3),
        test=Spread(0.02, 0.03, 0.03, 0.02, 0.16, 0.02e-3),
        compression_m=0.1e-3,
        motion_m=0.10e-3,
    ),
}
"""Variation by site, chosen for the coefficients of variation of thesis Tables 7.1 and 7.2 in the default guided test.

The distal site is not in those tables: its deviations are those of Table 3.1 and of the posterior forearm.
"""


def site_variation(preset: str) -> SiteVariation:
    """Return the variation of the site in a preset's name; without one, that of the posterior forearm."""
    return next((values for site, values in _SITES.items() if site in preset), _POSTERIOR)
