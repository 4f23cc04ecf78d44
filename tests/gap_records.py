"""Sessions of the simulated laboratory, which shares nothing with the twin, cut short for quick tests."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from coded import coded, says

from firmware_sim.effects import LISTED
from firmware_sim.laboratory import Recording
from firmware_sim.laboratory.scenario_generation import NOMINAL, DrawnScenario, draw_scenario
from tissueid.device import DeviceDescription
from tissueid.gap.dataset import Dataset
from tissueid.gap.preparation import prepare
from tissueid.sessions import Session, Test

RATE_HZ = 2000.0
SIGNALS = ("time", "command", "voltage", "current", "position")
DEVICE = DeviceDescription(**NOMINAL)


@cache
def scenario(effect: str = "", seed: int = 3, *, full: bool = False) -> DrawnScenario:
    """Return a scenario with an effect, with several joined by a plus, or with none."""
    wanted = effect.split("+") if effect else []
    others = tuple(name for name in LISTED if name not in wanted)
    return draw_scenario(seed, effects=len(wanted), without=others if wanted else (), full=full)


@cache
def _whole(effect: str, seed: int, full: bool) -> tuple[Recording, ...]:
    return scenario(effect, seed, full=full).record()


@cache
def recorded(effect: str = "", seed: int = 3, samples: int = 4000, *, full: bool = False) -> Session:
    """Return its session with the first samples of every test; do not change it."""
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
        for number, (plan, recording) in enumerate(zip(drawn.tests, _whole(effect, seed, full), strict=True), 1)
    )
    return Session(DEVICE, tests=tests)


@cache
def observed(effect: str = "", seed: int = 3, samples: int = 4000, *, full: bool = False) -> Dataset:
    """Return the dataset of a diagnosis."""
    return prepare(recorded(effect, seed, samples, full=full))


def changed(session: Session, **signals: object) -> Session:
    """Return the session's first test with changed signals; None removes one."""
    first = session.tests[0]
    kept = {name: values for name, values in (first.signals | signals).items() if values is not None}
    test = Test(1, first.kind, kept, first.sample_rate_hz, preload_s=0.5, surface_position_m=first.surface_position_m)  # type: ignore[arg-type]
    return Session(session.instrument, tests=(test,))


def not_usable(code: str, **values: Any) -> Callable[[BaseException], bool]:
    """Return a check for the error that a session's only test is left out, for a reason of this code and values."""

    def check(error: BaseException) -> bool:
        assert coded("gap.not_usable")(error)
        left_out = error.message.values["reason"]  # type: ignore[attr-defined]
        return says(left_out, "gap.test_left_out", number=1) and says(left_out.values["reason"], code, **values)

    return check
