"""Tests that are offered by name: in the form of a test, and in the protocol of a study."""

from __future__ import annotations

from typing import Any

from tissueid.language import _, marked
from tissueid.messages import Message
from tissueid.procedures.demo import LARGE_CLIPPED, LARGE_N
from tissueid.stimuli.kinds.noise import Noise
from tissueid.test_settings import USUAL_FORCE_N, USUAL_SECONDS, StimulusSettings


class Preset(StimulusSettings):
    """A test that is chosen in one step, as fields of a ``TestPlan``.

    With ``lower_force`` the highest force is lowered to that of the instrument. Else the test is offered only where the
    limits and the instrument allow its forces.
    """

    name: str
    title: str
    stimulus: str
    min_force_n: float
    max_force_n: float
    seconds: float = USUAL_SECONDS
    options: tuple[tuple[str, Any], ...] = ()
    lower_force: bool = True

    def plan_values(self, seconds: float | None = None) -> dict[str, Any]:
        """Return the fields of a ``TestPlan`` for this test, with another length, s, if one is given."""
        values = self.model_dump(exclude={"name", "title"}, exclude_none=True)
        return values if seconds is None else values | {"seconds": seconds}

    def why_not(self, most_n: float) -> Message | None:
        """Return why the test is not offered where limits and instrument allow ``most_n``, N; None where it is."""
        needed_n = 0.0 if self.lower_force else max(abs(self.min_force_n), abs(self.max_force_n))
        if needed_n <= most_n:
            return None
        return Message(
            "form.preset_force",
            "{title} is not offered: it needs {needed:g} N, and limits and instrument allow {most:g} N.",
            title=_(self.title),
            needed=needed_n,
            most=most_n,
        )


PRESETS = (
    Preset(
        name="standard",
        title=marked("Standard skin test"),
        stimulus=Noise.name,
        min_force_n=USUAL_FORCE_N[0],
        max_force_n=USUAL_FORCE_N[1],
    ),
    Preset(
        name="thesis",
        title=marked("Thesis test, −5 to 12 N"),
        stimulus=Noise.name,
        min_force_n=LARGE_N[0],
        max_force_n=LARGE_N[1],
        options=(("clipped", LARGE_CLIPPED),),
        lower_force=False,
    ),
    Preset(
        name="depths", title=marked("Equal depths"), stimulus="rtig", min_force_n=-0.6, max_force_n=10.0, seconds=5.0
    ),
)
"""Tests that are offered by name; the thesis test is that of the demonstration (thesis 3.1.3 and Fig. 3.8)."""
