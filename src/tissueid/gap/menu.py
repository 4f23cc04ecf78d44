"""The tests among which the next one is chosen, as they would be played on the instrument of a session."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tissueid.gap.observed import Fixture, Observed, ObservedTest
from tissueid.stimuli.kinds import slow_ramp, step_hold
from tissueid.stimuli.kinds.slow_ramp import ramp
from tissueid.stimuli.kinds.step_hold import steps

FloatArray = NDArray[np.float64]

QUIET_S, AIR_S = 1.5, 0.6
STEPS_FROM = 0.2
"""Of the highest step: where steps begin and end."""
SPRING_SHARE = 0.5
"""Of the command's swing: a spring is softer than tissue at depth."""
AMPLITUDES = (0.5, 1.4)
DEPTHS = (0.6, 1.3)
LIMIT_SHARE = 0.9
"""Of what the amplifier gives."""


@dataclass(frozen=True)
class MenuItem:
    """One test that could be run: its name, what a person does, and the command (V) with what is under the probe."""

    kind: str
    words: str
    test: ObservedTest


def menu(observed: Observed) -> tuple[MenuItem, ...]:
    """Tests that could be run next; none where the session does not say what drove it, or nothing of its amplifier."""
    model = _model_test(observed)
    if model is None or not (observed.instrument.amplifier_gain > 0.0 and observed.instrument.amplifier_limit_v > 0.0):
        return ()
    if model.driven_by == "voltage":
        # What was recorded lies behind the amplifier; what is to be asked for lies before it.
        model = replace(model, command=model.command / observed.instrument.amplifier_gain, driven_by="command")
    rate = model.sample_rate_hz
    mean, swing = float(np.mean(model.command)), model.command - np.mean(model.command)
    spread = float(np.std(model.command))
    device = observed.instrument
    most = LIMIT_SHARE * min(
        device.amplifier_limit_v / device.amplifier_gain, 1.2 * float(np.max(np.abs(model.command)))
    )
    level = min(mean + 2.0 * spread, most)
    pressed = level * ramp(round(slow_ramp.SECONDS * rate))
    hold = round(step_hold.SECONDS / len(step_hold.LEVELS) * rate)
    stepped = level * (STEPS_FROM + (1.0 - STEPS_FROM) * steps(hold, step_hold.RISE_S * rate))
    spring = next((test for test in observed.tests if test.fixture == "spring"), None)
    items = [
        _item("quiet", "hold the probe on the tissue without a command", model, np.zeros(round(QUIET_S * rate))),
        _item("slow_ramp", "press slowly and let go again", model, pressed),
        _item("step_hold", "press in steps and hold each", model, stepped),
        _item(
            "spring",
            "put the calibration spring in place of the tissue and shake it",
            spring or model,
            SPRING_SHARE * swing,
            "spring",
            surface_m=0.4 * device.stroke_m,
        ),
        _item(
            "free_air",
            "shake the probe in free air",
            model,
            SPRING_SHARE * swing[: round(AIR_S * rate)],
            "air",
            surface_m=0.5 * device.stroke_m,
        ),
        _item("smaller_amplitude", "the same about the same mean, smaller", model, mean + AMPLITUDES[0] * swing),
        _item("larger_amplitude", "the same about the same mean, larger", model, mean + AMPLITUDES[1] * swing),
        _item("shallower", "the same with a smaller mean load", model, DEPTHS[0] * mean + DEPTHS[0] * swing),
        _item("deeper", "the same with a greater mean load", model, DEPTHS[1] * mean + swing),
    ]
    clipped = [replace(item.test, command=np.clip(item.test.command, -most, most)) for item in items]
    return tuple(MenuItem(item.kind, item.words, test) for item, test in zip(items, clipped, strict=True))


def _model_test(observed: Observed) -> ObservedTest | None:
    if observed.equivalent is not None:
        return None
    usable = [
        test for test in observed.tests if test.driven_by in ("command", "voltage") and np.ptp(test.command) > 0.0
    ]
    on_tissue = [test for test in usable if test.fixture == "tissue"]
    stochastic = [test for test in on_tissue if test.kind == "stochastic"]
    return next(iter([*stochastic, *on_tissue]), None)


def _item(
    kind: str,
    words: str,
    model: ObservedTest,
    command: FloatArray,
    fixture: Fixture = "tissue",
    surface_m: float | None = None,
) -> MenuItem:
    # What every test has for itself (a phase) is as in the test that it is modelled on.
    surface = model.surface_m if surface_m is None or model.fixture == fixture else surface_m
    test = replace(
        model,
        kind=kind,
        fixture=fixture,
        command=np.ascontiguousarray(command),
        signals={name: np.full(command.size, surface) for name in model.signals},
        purpose=np.zeros(command.size, np.int8),
        surface_m=surface,
        repeat_of=None,
        driven_by="command",
    )
    return MenuItem(kind, words, test)
