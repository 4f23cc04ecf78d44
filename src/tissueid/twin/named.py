"""A twin with a name: what is believed of one instrument on one tissue, with the effects that a diagnosis accepted."""

from __future__ import annotations

from dataclasses import dataclass, field

from tissueid.twin.figures import Instrument, Tissue
from tissueid.twin.simulation import Acting


@dataclass(frozen=True)
class NamedTwin:
    """Figures with their standard deviations where known, SI, and effects.

    ``stds`` is by figure: ``force_constant_n_per_a``, ``tissue_stiffness_n_per_m``, ``dry_friction.coulomb_n``.
    ``sample_rate_hz`` is that of the tests that it was fitted to.
    """

    name: str
    version: int
    instrument: Instrument
    tissue: Tissue
    acting: tuple[Acting, ...]
    sample_rate_hz: float
    stds: dict[str, float] = field(default_factory=dict)

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of its effects."""
        return tuple(item.effect.name for item in self.acting)
