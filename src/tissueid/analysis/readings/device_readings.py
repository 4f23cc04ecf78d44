"""All readings of a session: from the recorded step, and from a model of a stochastic test."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissueid.analysis.fitting import Analysis
from tissueid.analysis.readings.decay_readings import DECAY_DEFINITIONS, Release, recorded_release
from tissueid.analysis.readings.model_readings import DRAWS, ModelReadings, model_readings
from tissueid.analysis.readings.reading import NOT_COMPARABLE, Reading, as_answer
from tissueid.analysis.readings.step_course import Array, StepCourse, find_steps
from tissueid.analysis.readings.step_readings import DEFINITIONS, StepPoints, recorded_points, step_readings
from tissueid.configuration import spring_of
from tissueid.errors import UnusableInputError
from tissueid.identification.base import Engine
from tissueid.messages import Message, stored
from tissueid.sessions import Session, Test
from tissueid.stimuli.kinds.step_hold import StepHold

STEP_KIND = "step_hold"
"""Kind of the tests that hold steps."""
_STANDARD_S = 1.0
"""Length of each hold of a step that is simulated without a recorded one, s."""
_STANDARD_SHARE = 0.05
"""Share of the fitted force below and above such a step."""

NO_STEP_TEST = Message(
    "readings.no_step_test",
    "the session holds no step test: record one with the stimulus {stimulus}",
    stimulus="step_hold",
)
NO_STOCHASTIC_TEST = Message(
    "readings.no_stochastic_test", "the session holds no stochastic test to identify a model from"
)


@dataclass(frozen=True, eq=False)
class RecordedReadings:
    """Readings of a recorded step; ``release`` is None, for the reason ``no_release``, without a free decay.

    ``time_s`` and ``displacement_m`` (n,) are the recording, from the middle of the first step and from the position
    before it.
    """

    test: Test
    course: StepCourse
    step: tuple[Reading, ...]
    decay: tuple[Reading, ...]
    points: StepPoints
    time_s: Array
    displacement_m: Array
    release: Release | None
    no_release: str = ""


@dataclass(frozen=True, eq=False)
class DeviceReadings:
    """The readings of a session; a part that is None is missing for the reason in the field after it."""

    recorded: RecordedReadings | None
    no_recorded: str
    analysis: Analysis | None
    model: ModelReadings | None
    no_model: str
    course: StepCourse | None
    notes: tuple[str, ...]

    def rows(self) -> list[tuple[Reading, Reading]]:
        """Return each reading of the recorded step and of the model, with a reason where a part is missing."""
        definitions = [one[0] for one in DEFINITIONS] + list(DECAY_DEFINITIONS)
        recorded = [Reading(one, None, self.no_recorded) for one in definitions]
        if self.recorded is not None:
            recorded = [*self.recorded.step, *self.recorded.decay]
        model = [Reading(one, None, self.no_model) for one in definitions]
        if self.model is not None:
            model = [*self.model.step, *self.model.decay]
        return list(zip(recorded, model, strict=True))

    def as_answer(self) -> dict[str, Any]:
        """Return everything for JSON, SI units."""
        rows = self.rows()
        course, recorded, analysis = self.course, self.recorded, self.analysis
        return {
            "step": None
            if course is None
            else {
                "force_low_n": course.low_n,
                "force_high_n": course.high_n,
                "hold_s": course.hold_s,
                "cycles": len(course.cycles),
                "recorded": recorded is not None,
            },
            "recorded": {
                "test": None if recorded is None else recorded.test.number,
                "readings": as_answer(one for one, _ in rows),
            },
            "model": {
                "engine": None if analysis is None else analysis.model.report.engine,
                "options": None if analysis is None else analysis.model.report.options,
                "test": None if analysis is None else analysis.test,
                "vaf_validation_percent": None if analysis is None else analysis.model.report.vaf_validation_percent,
                "readings": as_answer(one for _, one in rows),
            },
            "notes": [str(note) for note in self.notes],
            "note_messages": [stored(note) for note in self.notes],
        }


def recorded_readings(test: Test) -> RecordedReadings:
    """Compute the readings of a recorded step test.

    Raises:
        UnusableInputError: the test holds no step of a force in N, or no position in m.
    """
    record = test.record()
    if (record.input_unit, record.output_unit) != ("N", "m"):
        raise UnusableInputError("readings.no_mechanics", "readings need a force in N and a position in m")
    course = find_steps(record.input, record.sample_rate_hz)
    points = recorded_points(record.output, course)
    release, reason = None, ""
    try:
        release = recorded_release(record.input, record.output, course)
        decay = release.readings
    except UnusableInputError as error:
        reason = error.message
        decay = tuple(Reading(one, None, reason) for one in DECAY_DEFINITIONS)
    start = points.values[0] if math.isfinite(points.values[0]) else float(np.nanmean(record.output[:10]))
    return RecordedReadings(
        test=test,
        course=course,
        step=step_readings(points, direction=math.copysign(1.0, course.step_n)),
        decay=decay,
        points=points,
        time_s=(np.arange(len(record), dtype=np.float64) - course.cycles[0].rise) / record.sample_rate_hz,
        displacement_m=record.output - start,
        release=release,
        no_release=reason,
    )


def step_test(session: Session, number: int | None = None) -> Test | None:
    """Return the step test of a session: that of a number, or the first of its kind; None if there is none."""
    if number is not None:
        return session.test(number)
    return next((test for test in session.tests if test.kind == STEP_KIND), None)


def device_readings(
    test: Test | None,
    fit: Callable[[], Analysis] | None,
    engine: Engine,
    *,
    draws: int = DRAWS,
    progress: Callable[[int, int], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> DeviceReadings:
    """Compute all readings that a step test and a fit give.

    Args:
        test: the step test; None to simulate a step over the fitted forces instead.
        fit: fits the model; None without a stochastic test.
        engine: specification of the model.
        draws: number of refits for the uncertainty of the model's step.
        progress: called with the number of draws done, and the total.
        cancelled: called before each draw; the work ends if it returns True.

    Raises:
        UnusableInputError: neither the step nor the model gives readings.
        CancelledError: ``cancelled`` returned True.
    """
    recorded: RecordedReadings | None = None
    no_recorded: str = NO_STEP_TEST
    if test is not None:
        try:
            recorded = recorded_readings(test)
        except UnusableInputError as error:
            no_recorded = error.message
    analysis: Analysis | None = None
    model: ModelReadings | None = None
    no_model: str = NO_STOCHASTIC_TEST
    course = None if recorded is None else recorded.course
    if fit is not None:
        try:
            analysis = fit()
            rate = analysis.record.sample_rate_hz
            force = _standard_step(analysis) if recorded is None else _resampled(recorded.test, rate)
            played = find_steps(force, rate)
            course = course or played
            model = model_readings(analysis, engine, force, played, draws=draws, progress=progress, cancelled=cancelled)
        except UnusableInputError as error:
            no_model = error.message
    if recorded is None and model is None:
        raise UnusableInputError(no_recorded if test is not None else no_model if fit is not None else no_recorded)
    notes: list[str] = [NOT_COMPARABLE, *(() if model is None else model.notes)]
    spring = max((spring_of(one.notes) for one in (test,) if one is not None), default=0.0)
    spring = spring or (0.0 if analysis is None else analysis.external_spring_n_per_m)
    if spring:
        notes.append(
            Message("readings.spring", "all readings include the external spring of {spring:g} N/m", spring=spring)
        )
    return DeviceReadings(recorded, no_recorded, analysis, model, no_model, course, tuple(notes))


def _resampled(test: Test, rate: float) -> Array:
    """Return the force of a step test at the sample rate of the model, N, shape (n,); linear between samples."""
    record = test.record()
    if math.isclose(record.sample_rate_hz, rate, rel_tol=1e-6):
        return record.input
    known = np.isfinite(record.input)
    times = np.arange(int(len(record) * rate / record.sample_rate_hz)) / rate
    return np.asarray(np.interp(times, record.time[known], record.input[known]), dtype=np.float64)


def _standard_step(analysis: Analysis) -> Array:
    """Return a step over nearly all of the fitted forces, N, shape (n,), at the sample rate of the fit.

    Raises:
        UnusableInputError: the force does not vary.
    """
    fitted = analysis.record.input[analysis.fit_part]
    fitted = fitted[np.isfinite(fitted)]
    low, high = (float(np.quantile(fitted, share)) for share in (_STANDARD_SHARE, 1.0 - _STANDARD_SHARE))
    if high <= low:
        raise UnusableInputError("readings.constant_force", "the force of the fitted test does not vary")
    rate = analysis.record.sample_rate_hz
    values = StepHold(cycles=1, seconds=3.0 * _STANDARD_S, sample_rate=rate, force_min_n=0.0, force_max_n=1.0).build()
    return low + (high - low) * values.values
