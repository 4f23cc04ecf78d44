"""``tissueid test``: place the probe once and run one or several tests into one session."""

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
from tissueid.acquisition.background_work import run_while_polling
from tissueid.acquisition.guided import check_test
from tissueid.acquisition.rest_periods import predict_heating, rest, temperature_c
from tissueid.acquisition.stimulus_choice import playable, playable_file, test_kind
from tissueid.acquisition.surface_detection import Placement, place, place_in_air
from tissueid.calibration import calibrated, in_words, warnings_of
from tissueid.cli.audit_records import audit_trail, print_audit_problems
from tissueid.cli.output import console, human_output, progress_bars, write_json
from tissueid.cli.quality import recorded_findings
from tissueid.cli.stimulus import designed
from tissueid.cli.stimulus_options import specified
from tissueid.cli.stop_key import stop_key
from tissueid.cli.test_monitor import LiveMonitor
from tissueid.cli.test_plan import TestPlan
from tissueid.cli.test_summary import answer_of, out_of_reach, tests_table
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.identification.live.stopping import StopRule
from tissueid.instrument import PROFILES, Instrument, Limits, SimulatedInstrument, open_instrument
from tissueid.sessions import Session, Subject
from tissueid.stimuli import FeedbackKind, Stimulus
from tissueid.stimuli.depth_uniform import DepthDesign
from tissueid.stimuli.kinds.noise import Noise

_DEFAULTS = NoiseChoice()
"""Default options of the noise stimulus; other kinds have their own defaults."""
_Runner = Callable[[SessionRecorder, Callable[[], bool]], tuple[Step, ...]]
"""A function that runs all tests into a recorder until it is cancelled."""


def show_progress(show: Callable[[str, float], None], label: str) -> Callable[[Progress], None]:
    """Return a progress callback that shows a test as one bar."""
    return lambda progress: show(label, progress.fraction)


def run_tests(plan: TestPlan) -> None:
    """Place the probe once, then run all tests into one session."""
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
        own = audit_trail()
        own.note("calibration.in_force", subject=instrument.device.serial_number, new=in_force.words)
        recorder = run_while_polling(
            instrument, lambda: SessionRecorder(plan.out, instrument.device, Subject(plan.subject), trail=own)
        )
        try:
            with stop_key() as key:
                steps = run(recorder, key.check)
        except BaseException as error:
            _keep(recorder, plan, error)
            print_audit_problems(own)
            raise
        session = recorder.finish()
        print_audit_problems(own)
    finally:
        instrument.close()
    _print_result(plan, session)
    _answer(plan, session, steps)


def _answer(plan: TestPlan, session: Session, steps: tuple[Step, ...] = ()) -> None:
    """Write the JSON output if it was requested.

    Raises:
        UnusableInputError: the JSON cannot be written.
    """
    if plan.json_file is not None:
        tests = [answer_of(test, plan.depth_range_m, _step(steps, test.number)) for test in session.tests]
        write_json(plan.json_file, {"session": str(plan.out), "session_id": session.session_id, "tests": tests})


def _repeats(plan: TestPlan, instrument: Instrument, limits: Limits, rule: StopRule | None) -> _Runner:
    """Check a test and return a function that runs its repeats."""
    test = run_while_polling(instrument, lambda: _prepared(plan, instrument.device, limits))
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
                with LiveMonitor(instrument, preload_s, rule, plan.live, plan.external_spring_n_per_m) as monitor:
                    if placement is None:
                        placing = show_progress(show, "placing the probe")
                        placement = (
                            place_in_air(instrument, cancelled)
                            if test.kind == "free_air"
                            else place(instrument, limits, progress=placing, cancelled=cancelled)
                        )
                    # A feedback stimulus depends on the measured depth: a second run is not a repeat.
                    same = repeat > 0 and isinstance(test.stimulus, Stimulus)
                    run_guided_test(
                        instrument,
                        replace(test, repeat_of=1 if same else None),
                        recorder,
                        surface_m=placement,
                        progress=monitor.with_progress(show_progress(show, f"test {repeat + 1} of {plan.repeats}")),
                        cancelled=cancelled,
                        enough=monitor.enough,
                        why=monitor.why,
                    )
        return ()

    return run


def _too_warm(plan: TestPlan, instrument: Instrument, test: GuidedTest) -> str:
    """Return a warning if the repeats will heat the coil too much; "" otherwise, or if that is not known.

    A simulation in this process has no coil, and the force of a feedback stimulus is not known in advance.
    """
    if isinstance(instrument, SimulatedInstrument) or not isinstance(test.stimulus, Stimulus):
        return ""
    begin_c = temperature_c(instrument)
    if math.isnan(begin_c):
        return ""
    command = check_test(test, instrument.device)
    return predict_heating(
        command,
        instrument.nominal,
        repeats=plan.repeats,
        rest_s=plan.rest_s,
        begin_c=begin_c,
        limit_c=test.limits.max_temperature_c,
    ).warning


def _default_forces(plan: TestPlan, device: DeviceDescription, limits: Limits) -> dict[str, float]:
    """Return the default range of force, N; print a message if the instrument limits it."""
    greatest = min(device.greatest_force_n, math.floor(10.0 * limits.max_force_n) / 10.0)
    forces = {"force_min_n": _DEFAULTS.min_force_n, "force_max_n": _DEFAULTS.max_force_n}
    own = any(option.partition("=")[0].strip() == "force_max_n" for option in plan.options)
    if greatest < _DEFAULTS.max_force_n and plan.common.max_force is None and not own:
        forces["force_max_n"] = greatest
        console.print(
            f"the highest force is {greatest:g} N instead of {_DEFAULTS.max_force_n:g} N, the limit of this instrument "
            "(--max-force sets a lower one)",
            markup=False,
            soft_wrap=True,
        )
    return forces


def _prepared(plan: TestPlan, device: DeviceDescription, limits: Limits) -> GuidedTest:
    """Return the test after its limits were checked.

    Raises:
        LimitError, UnusableInputError: the test cannot be played.
    """
    stimulus = _stimulus(plan, device, limits)
    kind = plan.kind or test_kind(stimulus)
    test = GuidedTest(stimulus, plan.site, kind, plan.instrument_configuration(), limits)
    check_test(test, device)
    return test


def _multistep(plan: TestPlan, instrument: Instrument, limits: Limits) -> _Runner:
    """Check a multistep test and return a function that runs it."""
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
    """Return the stimulus with its preload, or a feedback stimulus.

    Raises:
        UnusableInputError: the options are not valid.
    """
    if plan.stimulus_file is not None:
        return playable_file(plan.stimulus_file)
    name = plan.stimulus or Noise.name
    defaults: dict[str, object] = {"sample_rate": device.sample_rate_hz}
    if name == Noise.name:
        defaults |= _default_forces(plan, device, limits) | {"seconds": _DEFAULTS.seconds, "seed": _DEFAULTS.seed}
    specification = specified(name, plan.common, plan.all_options(), defaults)
    if isinstance(specification, Noise):  # needs no progress bar
        return playable(specification)
    return playable(specification, lambda kind: designed(kind)[0])


def _step(steps: tuple[Step, ...], number: int) -> Step | None:
    return next((step for step in steps if step.number == number), None)


def _keep(recorder: SessionRecorder, plan: TestPlan, error: BaseException) -> None:
    """Save the tests recorded before an error as a session; without tests, leave no file.

    Raises:
        JournalError: the disk failed too; the message contains both errors.
    """
    try:
        session = recorder.finish_or_discard(error)
    except JournalError as trouble:
        recorder.abandon()
        if isinstance(error, JournalError):
            return  # its message says what is kept and where
        raise JournalError(f"{error or 'interrupted'}; and {trouble}") from error
    if session is not None:
        _print_result(plan, session)
        try:
            _answer(plan, session)
        except UnusableInputError as trouble:  # the error of the test is more important and is printed last
            console.print(str(trouble), markup=False, soft_wrap=True)


def _print_result(plan: TestPlan, session: Session) -> None:
    console = human_output(plan.json_file)
    if not console.is_terminal:
        console.width = 120
    console.print(f"session: {plan.out}", markup=False)
    console.print(f"instrument: {in_words(session.instrument)}", markup=False)
    for warning in warnings_of(session.instrument):
        console.print(f"calibration: {warning}", markup=False)
    console.print(tests_table(session.tests, plan.depth_range_m))
    for test in session.tests:
        if short := out_of_reach(test):
            console.print(f"test {test.number}: {short}", markup=False)
        if lost := test.notes.get("samples_lost"):
            console.print(
                f"test {test.number}: {lost:.0f} samples were lost; they are marked in the session", markup=False
            )
        if reason := test.notes.get("reason"):
            console.print(f"test {test.number}: {reason}", markup=False)
        for line in recorded_findings(test):
            console.print(line, markup=False)
