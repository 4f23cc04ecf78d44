"""``tissueid test``: place once, run one test or several into one session, and tell what came of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from tissueid.acquisition import (
    GuidedTest,
    JournalError,
    MultistepTest,
    NoiseChoice,
    Progress,
    SessionRecorder,
    Step,
    check_multistep,
    run_guided_test,
    run_multistep,
)
from tissueid.acquisition.choice import playable, playable_file, test_kind
from tissueid.acquisition.guided import check_test
from tissueid.acquisition.placing import Placement, place, place_in_air
from tissueid.acquisition.resting import foresee, rest, temperature_c
from tissueid.acquisition.waiting import meanwhile
from tissueid.calibration import calibrated, in_words, warnings_of
from tissueid.cli.logged import tell, trail
from tissueid.cli.output import console, people_read, progress_bars, write_json
from tissueid.cli.played import answer_of, out_of_reach, tests_table
from tissueid.cli.quality import findings_lines
from tissueid.cli.stimulus import designed
from tissueid.cli.stimulus_options import specified
from tissueid.cli.stop_key import stop_key
from tissueid.cli.test_plan import TestPlan
from tissueid.cli.watching import Watch
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.identification.online.stopping import StopRule
from tissueid.instrument import PROFILES, Instrument, Limits, SimulatedInstrument, open_instrument
from tissueid.sessions import Session, Subject
from tissueid.stimuli import FeedbackKind, Stimulus
from tissueid.stimuli.kinds.noise import Noise
from tissueid.stimuli.redesign import DepthDesign

_DEFAULTS = NoiseChoice()
"""What the ordinary noise is without options; other kinds have defaults of their own."""
_Runner = Callable[[SessionRecorder, Callable[[], bool]], tuple[Step, ...]]
"""Runs all tests into a recorder until it is told to stop."""


def show_progress(show: Callable[[str, float], None], label: str) -> Callable[[Progress], None]:
    """Progress of a test as one bar."""
    return lambda progress: show(label, progress.fraction)


def run_tests(plan: TestPlan) -> None:
    """Place once, then run what is asked for, all into one session."""
    plan.check()
    rule = StopRule.from_words(plan.stop_when) if plan.stop_when else None
    steps: tuple[Step, ...] = ()
    instrument = open_instrument(plan.url)
    try:
        limits = instrument.narrowed(PROFILES[plan.limits])
        in_force = calibrated(instrument, plan.calibrations, wanted=plan.calibration)
        run: _Runner
        if plan.multistep is not None:
            run = _multistep(plan, instrument, limits)
        else:
            run = _repeats(plan, instrument, limits, rule)
        own = trail()
        own.note("calibration.in_force", subject=instrument.device.serial_number, new=in_force.words)
        recorder = meanwhile(
            instrument, lambda: SessionRecorder(plan.out, instrument.device, Subject(plan.subject), trail=own)
        )
        try:
            with stop_key() as key:
                steps = run(recorder, key.check)
        except BaseException as error:
            _keep(recorder, plan, error)
            tell(own)
            raise
        session = recorder.finish()
        tell(own)
    finally:
        instrument.close()
    _tell(plan, session)
    _answer(plan, session, steps)


def _answer(plan: TestPlan, session: Session, steps: tuple[Step, ...] = ()) -> None:
    """The answer as JSON, where it is asked for.

    Raises:
        UnusableInputError: it cannot be written.
    """
    if plan.json_file is not None:
        tests = [answer_of(test, plan.depth_range_m, _step(steps, test.number)) for test in session.tests]
        write_json(plan.json_file, {"session": str(plan.out), "session_id": session.session_id, "tests": tests})


def _repeats(plan: TestPlan, instrument: Instrument, limits: Limits, rule: StopRule | None) -> _Runner:
    """The same test as often as asked, checked and ready to be run."""
    test = meanwhile(instrument, lambda: _prepared(plan, instrument.device, limits))
    preload_s = test.opening.preload_s
    if words := _too_warm(plan, instrument, test):
        console.print(f"warning: {words}", markup=False, soft_wrap=True)

    def run(recorder: SessionRecorder, cancelled: Callable[[], bool]) -> tuple[Step, ...]:
        placement: Placement | None = None
        with progress_bars() as show:
            for repeat in range(plan.repeats):
                if repeat and plan.rest_s:
                    resting = f"rest before test {repeat + 1} of {plan.repeats}"
                    rest(instrument, plan.rest_s, progress=partial(show, resting), cancelled=cancelled)
                with Watch(instrument, preload_s, rule, plan.live, plan.external_spring_n_per_m) as watch:
                    if placement is None:
                        placing = show_progress(show, "placing the probe")
                        placement = (
                            place_in_air(instrument, cancelled)
                            if test.kind == "free_air"
                            else place(instrument, limits, progress=placing, cancelled=cancelled)
                        )
                    # What a feedback stimulus played is played once: the next run answers what it measures itself.
                    same = repeat > 0 and isinstance(test.stimulus, Stimulus)
                    run_guided_test(
                        instrument,
                        replace(test, repeat_of=1 if same else None),
                        recorder,
                        surface_m=placement,
                        progress=watch.beside(show_progress(show, f"test {repeat + 1} of {plan.repeats}")),
                        cancelled=cancelled,
                        enough=watch.enough,
                        why=watch.why,
                    )
        return ()

    return run


def _too_warm(plan: TestPlan, instrument: Instrument, test: GuidedTest) -> str:
    """What the repeats make of the coil, in a line; empty where they leave it cool enough, or nobody knows.

    A simulation in this process has no coil, and of what a feedback stimulus will play nothing is known.
    """
    if isinstance(instrument, SimulatedInstrument) or not isinstance(test.stimulus, Stimulus):
        return ""
    begin_c = temperature_c(instrument)
    if math.isnan(begin_c):
        return ""
    command = check_test(test, instrument.device)
    return foresee(
        command,
        instrument.nominal,
        repeats=plan.repeats,
        rest_s=plan.rest_s,
        begin_c=begin_c,
        limit_c=test.limits.max_temperature_c,
    ).words


def _default_forces(plan: TestPlan, device: DeviceDescription, limits: Limits) -> dict[str, float]:
    """The range of force that nobody gave, N; where the instrument cannot give all of it, less, and it is said."""
    greatest = min(device.greatest_force_n, math.floor(10.0 * limits.max_force_n) / 10.0)
    forces = {"force_min_n": _DEFAULTS.min_force_n, "force_max_n": _DEFAULTS.max_force_n}
    own = any(option.partition("=")[0].strip() == "force_max_n" for option in plan.options)
    if greatest < _DEFAULTS.max_force_n and plan.common.max_force is None and not own:
        forces["force_max_n"] = greatest
        console.print(
            f"the highest force is {greatest:g} N, not {_DEFAULTS.max_force_n:g}: this instrument gives no more "
            "(--max-force chooses a lower one)",
            markup=False,
            soft_wrap=True,
        )
    return forces


def _prepared(plan: TestPlan, device: DeviceDescription, limits: Limits) -> GuidedTest:
    """The test, which could be played.

    Raises:
        LimitError, UnusableInputError: it could not.
    """
    stimulus = _stimulus(plan, device, limits)
    kind = plan.kind or test_kind(stimulus)
    test = GuidedTest(stimulus, plan.site, kind, plan.instrument_configuration(), limits)
    check_test(test, device)
    return test


def _multistep(plan: TestPlan, instrument: Instrument, limits: Limits) -> _Runner:
    """The multistep test, checked and ready to be run."""
    assert plan.multistep is not None
    assert plan.depth_range_m is not None
    given = {name: value for name, (_, value) in plan.common.given().items()}
    seed = int(given.pop("seed", _DEFAULTS.seed))
    options = _default_forces(plan, instrument.device, limits) | given
    design = DepthDesign.from_options(
        {
            "depth_min_m": plan.depth_range_m[0],
            "depth_max_m": plan.depth_range_m[1],
            "sample_rate": instrument.device.sample_rate_hz,
        }
        | options
    )
    target = {} if plan.target is None else {"target": plan.target}
    test = MultistepTest(
        design,
        plan.site,
        steps=plan.multistep,
        seed=seed,
        limits=limits,
        configuration=plan.instrument_configuration(),
        **target,
    )
    check_multistep(test, instrument.device)

    def run(recorder: SessionRecorder, cancelled: Callable[[], bool]) -> tuple[Step, ...]:
        with progress_bars() as show:
            return run_multistep(
                instrument,
                test,
                recorder,
                progress=lambda label, progress: show(label, progress.fraction),
                cancelled=cancelled,
            )

    return run


def _stimulus(plan: TestPlan, device: DeviceDescription, limits: Limits) -> Stimulus | FeedbackKind:
    """What is to be played, with its preload, or generated.

    Raises:
        UnusableInputError: the options do not make one.
    """
    if plan.stimulus_file is not None:
        return playable_file(plan.stimulus_file)
    name = plan.stimulus or Noise.name
    defaults: dict[str, object] = {"sample_rate": device.sample_rate_hz}
    if name == Noise.name:
        defaults |= _default_forces(plan, device, limits) | {"seconds": _DEFAULTS.seconds, "seed": _DEFAULTS.seed}
    specification = specified(name, plan.common, plan.all_options(), defaults)
    if isinstance(specification, Noise):  # built in no time
        return playable(specification)
    return playable(specification, lambda kind: designed(kind)[0])


def _step(steps: tuple[Step, ...], number: int) -> Step | None:
    return next((step for step in steps if step.number == number), None)


def _keep(recorder: SessionRecorder, plan: TestPlan, error: BaseException) -> None:
    """Whatever was recorded before it went wrong becomes a session; an empty one leaves nothing.

    Raises:
        JournalError: the disk failed as well; it says both.
    """
    try:
        session = recorder.finish_or_discard(error)
    except JournalError as trouble:
        recorder.abandon()
        if isinstance(error, JournalError):
            return  # it says already what is kept, and where
        raise JournalError(f"{error or 'interrupted'}; and {trouble}") from error
    if session is not None:
        _tell(plan, session)
        try:
            _answer(plan, session)
        except UnusableInputError as trouble:  # why the test ended is said last, and counts for more
            console.print(str(trouble), markup=False, soft_wrap=True)


def _tell(plan: TestPlan, session: Session) -> None:
    people = people_read(plan.json_file)
    if not people.is_terminal:
        people.width = 120
    people.print(f"session: {plan.out}", markup=False)
    people.print(f"instrument: {in_words(session.instrument)}", markup=False)
    for warning in warnings_of(session.instrument):
        people.print(f"calibration: {warning}", markup=False)
    people.print(tests_table(session.tests, plan.depth_range_m))
    for test in session.tests:
        if short := out_of_reach(test):
            people.print(f"test {test.number}: {short}", markup=False)
        if lost := test.notes.get("samples_lost"):
            people.print(f"test {test.number}: {lost:.0f} samples were lost and are marked as such", markup=False)
        if reason := test.notes.get("reason"):
            people.print(f"test {test.number}: {reason}", markup=False)
        for line in findings_lines(test):
            people.print(line, markup=False)
