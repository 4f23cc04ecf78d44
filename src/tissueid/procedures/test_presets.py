"""Tests that are offered by name: in the form of a test, and in the protocol of a study."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tissueid.language import marked
from tissueid.procedures.demo import LARGE_CLIPPED, LARGE_N
from tissueid.stimuli.kinds.noise import Noise
from tissueid.test_settings import USUAL_FORCE_N, USUAL_SECONDS


@dataclass(frozen=True)
class Preset:
    """A test that is chosen in one step.

    ``force_n`` are its lowest and highest force; the highest is lowered to that of the instrument if ``lowered``. Else
    the test is offered only where the limits and the instrument allow its forces.
    """

    name: str
    title: str
    kind: str
    force_n: tuple[float, float]
    seconds: float
    options: tuple[tuple[str, Any], ...] = ()
    lowered: bool = True

    @property
    def needed_n(self) -> float:
        """Force that the limits must allow, N."""
        return 0.0 if self.lowered else max(map(abs, self.force_n))

    def plan_values(self, seconds: float | None = None) -> dict[str, Any]:
        """Return the fields of a ``TestPlan`` for this test, with another length, s, if one is given."""
        return {
            "stimulus": self.kind,
            "options": self.options,
            "min_force_n": self.force_n[0],
            "max_force_n": self.force_n[1],
            "seconds": self.seconds if seconds is None else seconds,
            "lower_force": self.lowered,
        }


PRESETS = (
    Preset(
        "standard",
        marked("Standard skin test"),
        Noise.name,
        USUAL_FORCE_N,
        USUAL_SECONDS,
    ),
    Preset(
        "thesis",
        marked("Thesis test, −5 to 12 N"),
        Noise.name,
        LARGE_N,
        USUAL_SECONDS,
        (("clipped", LARGE_CLIPPED),),
        lowered=False,
    ),
    Preset("depths", marked("Equal depths"), "rtig", (-0.6, 10.0), 5.0),
)
"""Tests that are offered by name; the thesis test is that of the demonstration (thesis 3.1.3 and Fig. 3.8)."""
