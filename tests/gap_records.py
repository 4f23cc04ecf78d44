"""Sessions of the simulated laboratory, which shares nothing with the twin, cut short for quick tests."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from coded import coded, says

from firmware_sim.effects import LISTED
from firmware_sim.laboratory import Recording
from firmware_sim.laboratory.scenario_generation import NOMINAL, DrawnScenario, draw_scenario
from tissueid.device import DeviceDescription
from tissueid.gap.dataset import Dataset
from tissueid.gap.diagnosis import Diagnosis, diagnose
from tissueid.gap.preparation import prepare
from tissueid.gap.workers import SerialExecutor
from tissueid.sessions import Session, Test
from tissueid.twin.catalogue import effect
from tissueid.twin.chain_parameters import InstrumentParameters, Tissue
from tissueid.twin.simulation import ActiveEffect, Start, simulate

RATE_HZ = 2000.0
SURFACE_M = 0.010
SIGNALS = ("time", "command", "voltage", "current", "position")
DEVICE = DeviceDescription(**NOMINAL)


@cache
def scenario(name: str = "", seed: int = 3, *, full: bool = False) -> DrawnScenario:
    """Return a scenario with an effect, with several joined by a plus, or with none."""
    wanted = name.split("+") if name else []
    others = tuple(name for name in LISTED if name not in wanted)
    return draw_scenario(seed, effects=len(wanted), without=others if wanted else (), full=full)


@cache
def _whole(name: str, seed: int, full: bool) -> tuple[Recording, ...]:
    return scenario(name, seed, full=full).record()


@cache
def recorded(name: str = "", seed: int = 3, samples: int = 4000, *, full: bool = False) -> Session:
    """Return its session with the first samples of every test; do not change it."""
    drawn = scenario(name, seed, full=full)
    tests = tuple(
        Test(
            number,
            plan.kind,
            {key: getattr(recording, key)[:samples] for key in SIGNALS},
            RATE_HZ,
            preload_s=0.5,
            surface_position_m=recording.surface_m,
            repeat_of=plan.repeats,
        )
        for number, (plan, recording) in enumerate(zip(drawn.tests, _whole(name, seed, full), strict=True), 1)
    )
    return Session(DEVICE, tests=tests)


@cache
def observed(name: str = "", seed: int = 3, samples: int = 4000, *, full: bool = False) -> Dataset:
    """Return the dataset of a diagnosis."""
    return prepare(recorded(name, seed, samples, full=full))


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


@cache
def with_friction(samples: int, weight_n: float = 0.0, resistance_ohm: float = 12.0) -> Dataset:
    """Return the dataset of a test that the twin simulates with dry friction, with white noise."""
    random = np.random.default_rng(5)
    command = 14.0 + 14.0 * np.convolve(random.uniform(-1, 1, samples), np.ones(5) / 5, "same")
    acting = [ActiveEffect(effect("dry_friction"), np.array([0.25, 3e-5, 0.2, 0.0, 1.0]))]
    device = InstrumentParameters(weight_n=weight_n, resistance_ohm=resistance_ohm)
    start = Start(14.0 / resistance_ohm, SURFACE_M)
    read = simulate(command, RATE_HZ, device, Tissue(SURFACE_M), start, acting).readings
    signals = {"command": command}
    noise = random.standard_normal((3, samples))
    for name, level, white in zip(("voltage", "current", "position"), (2e-3, 1e-3, 2e-6), noise, strict=True):
        signals[name] = getattr(read, name) + level * white
    test = Test(1, "stochastic", signals, RATE_HZ, surface_position_m=SURFACE_M)
    return prepare(Session(DeviceDescription(), tests=(test,)))


FEW = ("dry_friction", "directional_damping")
SAMPLES = 3000


@cache
def friction_diagnosis() -> Diagnosis:
    """Return the diagnosis of a short session with dry friction, between two candidates."""
    return diagnose(observed("dry_friction", samples=SAMPLES), SerialExecutor(), candidates=FEW)
