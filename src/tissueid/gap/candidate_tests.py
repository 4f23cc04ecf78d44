"""The candidates for the next test, as they would be run on the instrument of a session."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tissueid.gap.dataset import Dataset, DatasetTest, Fixture
from tissueid.language import marked
from tissueid.stimuli.kinds import slow_ramp, step_hold
from tissueid.stimuli.kinds.slow_ramp import ramp
from tissueid.stimuli.kinds.step_hold import steps

FloatArray = NDArray[np.float64]

QUIET_S, AIR_S = 1.5, 0.6
"""Durations of the quiet test and of the test in free air, s."""
STEPS_FROM = 0.2
"""First and last step as a share of the highest step."""
SPRING_SHARE = 0.5
"""Command on the spring as a share of that on tissue: a spring is softer than tissue at depth."""
AMPLITUDES = (0.5, 1.4)
"""Amplitudes of the smaller and the larger test, relative to the recorded one."""
DEPTHS = (0.6, 1.3)
"""Mean loads of the shallower and the deeper test, relative to the recorded one."""
LIMIT_SHARE = 0.9
"""Largest command as a share of the amplifier's limit."""
KINDS = {
    "quiet": marked("quiet"),
    "slow_ramp": marked("slow ramp"),
    "step_hold": marked("step hold"),
    "spring": marked("spring"),
    "free_air": marked("free air"),
    "smaller_amplitude": marked("smaller amplitude"),
    "larger_amplitude": marked("larger amplitude"),
    "shallower": marked("shallower"),
    "deeper": marked("deeper"),
}
"""Names of the kinds of tests."""
_INSTRUCTIONS = {
    "quiet": marked("hold the probe on the tissue without a command"),
    "slow_ramp": marked("press slowly and release"),
    "step_hold": marked("press in steps and hold each"),
    "spring": marked("put the calibration spring in place of the tissue and run the stimulus"),
    "free_air": marked("run the stimulus in free air"),
    "smaller_amplitude": marked("the same test with the same mean and a smaller amplitude"),
    "larger_amplitude": marked("the same test with the same mean and a larger amplitude"),
    "shallower": marked("the same test with a smaller mean load"),
    "deeper": marked("the same test with a larger mean load"),
}


@dataclass(frozen=True)
class CandidateTest:
    """A test that could be run next: its kind, what the operator does, and the test with its command (V)."""

    kind: str
    instruction: str
    test: DatasetTest


def candidate_tests(dataset: Dataset) -> tuple[CandidateTest, ...]:
    """Return the tests that could be run next; none where the drive or the amplifier of the session is unknown."""
    model = _model_test(dataset)
    if model is None or not (dataset.instrument.amplifier_gain > 0.0 and dataset.instrument.amplifier_limit_v > 0.0):
        return ()
    if model.driven_by == "voltage":
        # A command goes into the amplifier, the recorded voltage comes out of it.
        model = replace(model, command=model.command / dataset.instrument.amplifier_gain, driven_by="command")
    rate = model.sample_rate_hz
    mean, swing = float(np.mean(model.command)), model.command - np.mean(model.command)
    spread = float(np.std(model.command))
    device = dataset.instrument
    most = LIMIT_SHARE * min(
        device.amplifier_limit_v / device.amplifier_gain, 1.2 * float(np.max(np.abs(model.command)))
    )
    level = min(mean + 2.0 * spread, most)
    pressed = level * ramp(round(slow_ramp.SECONDS * rate))
    hold = round(step_hold.SECONDS / len(step_hold.LEVELS) * rate)
    stepped = level * (STEPS_FROM + (1.0 - STEPS_FROM) * steps(hold, step_hold.RISE_S * rate))
    spring = next((test for test in dataset.tests if test.fixture == "spring"), None)
    items = [
        _item("quiet", model, np.zeros(round(QUIET_S * rate))),
        _item("slow_ramp", model, pressed),
        _item("step_hold", model, stepped),
        _item(
            "spring",
            spring or model,
            SPRING_SHARE * swing,
            "spring",
            surface_m=0.4 * device.stroke_m,
        ),
        _item(
            "free_air",
            model,
            SPRING_SHARE * swing[: round(AIR_S * rate)],
            "air",
            surface_m=0.5 * device.stroke_m,
        ),
        _item(
            "smaller_amplitude",
            model,
            mean + AMPLITUDES[0] * swing,
        ),
        _item(
            "larger_amplitude",
            model,
            mean + AMPLITUDES[1] * swing,
        ),
        _item("shallower", model, DEPTHS[0] * mean + DEPTHS[0] * swing),
        _item("deeper", model, DEPTHS[1] * mean + swing),
    ]
    clipped = [replace(item.test, command=np.clip(item.test.command, -most, most)) for item in items]
    return tuple(CandidateTest(item.kind, item.instruction, test) for item, test in zip(items, clipped, strict=True))


def _model_test(dataset: Dataset) -> DatasetTest | None:
    if dataset.equivalent is not None:
        return None
    usable = [test for test in dataset.tests if test.driven_by in ("command", "voltage") and np.ptp(test.command) > 0.0]
    on_tissue = [test for test in usable if test.fixture == "tissue"]
    stochastic = [test for test in on_tissue if test.kind == "stochastic"]
    return next(iter([*stochastic, *on_tissue]), None)


def _item(
    kind: str,
    model: DatasetTest,
    command: FloatArray,
    fixture: Fixture = "tissue",
    surface_m: float | None = None,
) -> CandidateTest:
    # Per-test parameters, such as a phase, are those of the model test.
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
    return CandidateTest(kind, _INSTRUCTIONS[kind], test)
