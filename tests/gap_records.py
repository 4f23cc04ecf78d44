"""Sessions as the simulated laboratory records them, which shares nothing with the twin, cut short for quick tests."""

from __future__ import annotations

from functools import cache

from firmware_sim.drawing import NOMINAL, DrawnScenario, draw_scenario
from firmware_sim.effects import LISTED
from tissueid.device import DeviceDescription
from tissueid.gap.observed import Observed
from tissueid.gap.observing import observe
from tissueid.sessions import Session, Test

RATE_HZ = 2000.0
SIGNALS = ("time", "command", "voltage", "current", "position")
DEVICE = DeviceDescription(**NOMINAL)


@cache
def scenario(effect: str = "", seed: int = 3, *, full: bool = False) -> DrawnScenario:
    """A scenario with that effect alone, with several joined by a plus, or with none."""
    wanted = effect.split("+") if effect else []
    others = tuple(name for name in LISTED if name not in wanted)
    return draw_scenario(seed, effects=len(wanted), without=others if wanted else (), full=full)


@cache
def recorded(effect: str = "", seed: int = 3, samples: int = 4000, *, full: bool = False) -> Session:
    """Its session, with the first samples of every test; nobody may change it."""
    drawn = scenario(effect, seed, full=full)
    tests = tuple(
        Test(
            number,
            plan.kind,
            {name: getattr(recording, name)[:samples] for name in SIGNALS},
            RATE_HZ,
            preload_s=0.5,
            surface_position_m=recording.surface_m,
            repeat_of=plan.repeats,
        )
        for number, (plan, recording) in enumerate(zip(drawn.tests, drawn.record(), strict=True), 1)
    )
    return Session(DEVICE, tests=tests)


@cache
def observed(effect: str = "", seed: int = 3, samples: int = 4000, *, full: bool = False) -> Observed:
    """Prepared for the diagnosis."""
    return observe(recorded(effect, seed, samples, full=full))


def changed(session: Session, **signals: object) -> Session:
    """The session's first test alone, with other signals in it; None takes one out."""
    first = session.tests[0]
    kept = {name: values for name, values in (first.signals | signals).items() if values is not None}
    test = Test(1, first.kind, kept, first.sample_rate_hz, preload_s=0.5, surface_position_m=first.surface_position_m)  # type: ignore[arg-type]
    return Session(session.instrument, tests=(test,))
