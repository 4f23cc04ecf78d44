"""``tissueid test``: place the probe once and run one or several tests into one session."""

from __future__ import annotations

import contextlib
from pathlib import Path

from tissueid.acquisition.journal import JournalError
from tissueid.acquisition.live import LiveIdentification
from tissueid.acquisition.playback import Progress
from tissueid.calibration.active import in_words, warnings_of
from tissueid.cli.audit_records import audit_trail
from tissueid.cli.output import ConsoleControl, check_json, console, human_output, progress_bars, write_json
from tissueid.cli.quality import recorded_findings
from tissueid.cli.stop_key import StopKey, stop_key
from tissueid.cli.test_summary import answer_of, out_of_reach, tests_table
from tissueid.errors import UnusableInputError
from tissueid.formatting import fixed, plus_minus
from tissueid.identification.live.live_view import LiveView
from tissueid.identification.live.stopping import StopRule
from tissueid.instrument import Instrument, Limits, SimulatedInstrument
from tissueid.messages import Message
from tissueid.procedures.output_files import check_different
from tissueid.procedures.test_plan import TestPlan
from tissueid.procedures.test_run import TestControl, TestOutcome, TestStep, run_test
from tissueid.sessions import Session
from tissueid.stimuli import FeedbackKind, Stimulus
from tissueid.stimuli.depth_uniform import DepthDesign
from tissueid.stimuli.kinds.noise import Noise

_UNITS = {"mass": ("g", 1e3), "damping": ("N·s/m", 1.0), "stiffness": ("N/m", 1.0)}


def run_tests(plan: TestPlan, json_file: Path | None) -> None:
    """Run the tests of a plan and print the result.

    Raises:
        TissueIDError: the test could not start, ended early, or could not be saved.
    """
    check_json(json_file)
    check_different(plan.out, json_file)
    with contextlib.ExitStack() as stack:
        control = _TerminalControl(plan, stack)
        outcome = run_test(plan, control, audit_trail())
    _show(plan, outcome, json_file)
    error, not_saved = outcome.error, outcome.not_saved
    if not_saved is not None and error is not None and not isinstance(error, JournalError):
        raise JournalError(f"{error or 'interrupted'}; and {not_saved}") from error
    if (failure := error or not_saved) is not None:
        raise failure


def _show(plan: TestPlan, outcome: TestOutcome, json_file: Path | None) -> None:
    """Print the saved tests and write the JSON output if it was requested.

    Raises:
        UnusableInputError: the JSON of a test without errors cannot be written.
    """
    if outcome.session is None:
        return
    _print_result(plan, outcome.session, json_file)
    try:
        _answer(plan, outcome.session, outcome.steps, json_file)
    except UnusableInputError as trouble:
        if outcome.error is None:
            raise
        console.print(str(trouble), markup=False, soft_wrap=True)  # the error of the test is printed last


def _answer(plan: TestPlan, session: Session, steps: tuple[TestStep, ...], json_file: Path | None) -> None:
    """Write the JSON output if it was requested.

    Raises:
        UnusableInputError: the JSON cannot be written.
    """
    if json_file is not None:
        tests = [
            answer_of(test, plan.depth_range_m, next((step for step in steps if step.number == test.number), None))
            for test in session.tests
        ]
        write_json(json_file, {"session": str(plan.out), "session_id": session.session_id, "tests": tests})


def _print_result(plan: TestPlan, session: Session, json_file: Path | None) -> None:
    console = human_output(json_file)


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
            Message(
                "test.force_limited",
                "the highest force is {force:g} N instead of {usual:g} N, the limit of this instrument (--max-force "
                "sets a lower one)",
                force=greatest,
                usual=_DEFAULTS.max_force_n,
            ),
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


class _TerminalControl(ConsoleControl, TestControl):
    """Shows progress, notices and converging parameters; the stop keys end the test."""

    def __init__(self, plan: TestPlan, stack: contextlib.ExitStack) -> None:
        super().__init__(stack.enter_context(progress_bars()))
        self._plan = plan
        self._stack = stack
        self._key: StopKey | None = None
        self._identification: LiveIdentification | None = None
        self._shown_s = 0.0

    def opened(self, instrument: Instrument, limits: Limits) -> None:
        """Read the stop keys from now on."""
        self._key = self._stack.enter_context(stop_key())

    def check(self) -> bool:
        """Return False, or raise if a stop key was pressed."""
        return self._key is not None and self._key.check()

    def identifying(self, identification: LiveIdentification) -> None:
        """Print the estimates of the next test."""
        self._identification, self._shown_s = identification, 0.0

    def received(self, progress: Progress) -> None:
        """Print a new estimate."""
        if self._identification is not None:
            self._print_latest(self._identification)

    def identified(self, identification: LiveIdentification) -> None:
        """Print the last estimate, and what the stop rule lacks."""
        self._print_latest(identification)
        rule = self._plan.stop_rule()
        if rule is not None and not identification.enough():
            console.print(_not_enough(rule, identification.latest()), markup=False)
        if identification.problem:
            console.print(f"live identification: {identification.problem}", markup=False)

    def _print_latest(self, identification: LiveIdentification) -> None:
        latest = identification.latest() if self._plan.live else None
        if latest is not None and latest.seconds > self._shown_s and (latest.parameters or latest.missing):
            self._shown_s = latest.seconds
            console.print(view_line(latest), markup=False)


def _not_enough(rule: StopRule, view: LiveView | None) -> str:
    """Return how well the parameters of a stop rule are known at the end of a test that it did not end."""
    words = []
    for name, target in rule.targets.items():
        found = None if view is None else view.parameters.get(name)
        spread = None if found is None or not found.std else found.std / abs(found.value)
        known = "is not known" if spread is None else f"has an uncertainty of {fixed(100.0 * spread, 1)} %"
        words.append(f"{name} {known} (target {fixed(100.0 * target, 1)} %)")
    return f"the test was too short for the requested uncertainty: {', '.join(words)}"


def view_line(view: LiveView) -> str:
    """Return the current state of a running test as one line."""
    words = [f"{fixed(view.seconds, 2)} s"]
    for name, found in view.parameters.items():
        unit, scale = _UNITS[name]
        words.append(f"{name} {plus_minus(found, scale)} {unit}")
    if view.vaf_percent is not None:
        words.append(f"VAF {fixed(view.vaf_percent, 1)} %")
    return ", ".join(words if view.parameters else [*words, view.missing])
