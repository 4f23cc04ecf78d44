"""``tissueid test``: place the probe once and run one or several tests into one session."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Sequence
from typing import Any

from rich.table import Table

from tissueid.acquisition.journal import JournalError
from tissueid.acquisition.live import LiveIdentification
from tissueid.acquisition.playback import Progress
from tissueid.acquisition.quality import quality_of
from tissueid.calibration.active import calibration_summary
from tissueid.cli.output import ConsoleControl, Output, console, progress_bars, table
from tissueid.cli.saved_tests import recorded_findings
from tissueid.cli.stop_key import StopKey, stop_key
from tissueid.errors import UnusableInputError
from tissueid.formatting import fixed, grouped, plus_minus
from tissueid.identification.live.live_view import LiveView
from tissueid.identification.live.stopping import StopRule
from tissueid.instrument import Instrument, Limits
from tissueid.messages import MISSING, Message, joined
from tissueid.procedures.depth_coverage import (
    DepthRange,
    depth_range_of,
    kolmogorov_distance,
    out_of_reach,
    stimulus_of,
)
from tissueid.procedures.instruments import audit_trail
from tissueid.procedures.output_files import check_different
from tissueid.procedures.test_plan import LIVE_METHODS, TestPlan
from tissueid.procedures.test_run import TestControl, TestOutcome, TestStep, run_test
from tissueid.sessions import Session, Test
from tissueid.sessions.quality import verdict_of
from tissueid.test_settings import PROPERTIES

_UNITS = {"mass": ("g", 1e3), "damping": ("N·s/m", 1.0), "stiffness": ("N/m", 1.0)}


def run_tests(plan: TestPlan, out: Output) -> None:
    """Run the tests of a plan and print the result.

    Raises:
        TissueIDError: the test could not start, ended early, or could not be saved.
    """
    check_different(plan.out, out.json_file)
    with contextlib.ExitStack() as stack:
        control = _TerminalControl(plan, stack)
        outcome = run_test(plan, control, audit_trail())
    _show(plan, outcome, out, control.views)
    error, not_saved = outcome.error, outcome.not_saved
    if not_saved is not None and error is not None and not isinstance(error, JournalError):
        raise JournalError(f"{error or 'interrupted'}; and {not_saved}") from error
    if (failure := error or not_saved) is not None:
        raise failure


def _show(plan: TestPlan, outcome: TestOutcome, out: Output, views: Sequence[LiveView | None]) -> None:
    """Print the saved tests and write the JSON output if it was requested.

    Raises:
        UnusableInputError: the JSON of a test without errors cannot be written.
    """
    if outcome.session is None:
        return
    _print_result(plan, outcome.session, out)
    try:
        if out.json_file is not None:
            out.write_json(_answer(plan, outcome.session, outcome.steps, views))
    except UnusableInputError as trouble:
        if outcome.error is None:
            raise
        console.print(str(trouble), soft_wrap=True)  # the error of the test is printed last


def _answer(
    plan: TestPlan, session: Session, steps: tuple[TestStep, ...], views: Sequence[LiveView | None]
) -> dict[str, Any]:
    by_number = {step.number: step for step in steps}
    tests = [
        answer_of(test, plan.depth_range_m, by_number.get(test.number)) | {"live": live_answer(view)}
        for test, view in itertools.zip_longest(session.tests, views[: len(session.tests)])
    ]
    return {"session": str(plan.out), "session_id": session.session_id, "tests": tests}


def _print_result(plan: TestPlan, session: Session, out: Output) -> None:
    out.widen(120)
    out.print(f"session: {plan.out}")
    out.print(f"instrument: {calibration_summary(session.instrument)}")
    out.print_lines(f"calibration: {warning}" for warning in session.instrument.calibration_warnings)
    out.print(tests_table(session.tests, plan.depth_range_m))
    for test in session.tests:
        lost = test.notes.get("samples_lost")
        said = (
            out_of_reach(test),
            f"{lost:.0f} samples were lost; they are marked in the session" if lost else "",
            test.notes.get("reason"),
        )
        out.print_lines(f"test {test.number}: {text}" for text in said if text)
        out.print_lines(recorded_findings(test))


class _TerminalControl(ConsoleControl, TestControl):
    """Shows progress, notices and converging parameters; the stop keys end the test."""

    def __init__(self, plan: TestPlan, stack: contextlib.ExitStack) -> None:
        super().__init__(stack.enter_context(progress_bars()))
        self._plan = plan
        self._stack = stack
        self._key: StopKey | None = None
        self._identification: LiveIdentification | None = None
        self._identifications: list[LiveIdentification] = []
        self._shown_s = 0.0

    @property
    def views(self) -> list[LiveView | None]:
        """The last live estimates of each test, in their order; none without ``--live``."""
        return [identification.latest() for identification in self._identifications if self._plan.live]

    def ready(self, instrument: Instrument, limits: Limits) -> None:
        """Read the stop keys from now on."""
        self._key = self._stack.enter_context(stop_key())

    def check(self) -> bool:
        """Return False, or raise if a stop key was pressed."""
        return self._key is not None and self._key.check()

    def identifying(self, identification: LiveIdentification) -> None:
        """Print the estimates of the next test."""
        self._identification, self._shown_s = identification, 0.0
        self._identifications.append(identification)
        if self._plan.live:
            method = self._plan.shown_method
            console.print(f"live identification: {method}, {LIVE_METHODS[method]}")

    def received(self, progress: Progress) -> None:
        """Print a new estimate."""
        if self._identification is not None:
            self._print_latest(self._identification)

    def identified(self, identification: LiveIdentification) -> None:
        """Print the last estimate, and what the stop rule lacks."""
        self._print_latest(identification)
        rule = self._plan.stop_rule()
        if rule is not None and not identification.enough():
            console.print(_not_enough(rule, identification.latest()))
        if identification.problem:
            console.print(f"live identification: {identification.problem}")

    def _print_latest(self, identification: LiveIdentification) -> None:
        latest = identification.latest() if self._plan.live else None
        if latest is not None and latest.seconds > self._shown_s and (latest.parameters or latest.missing):
            self._shown_s = latest.seconds
            console.print(view_line(latest), soft_wrap=True)


def _not_enough(rule: StopRule, view: LiveView | None) -> str:
    """Return how well the parameters of a stop rule are known at the end of a test that it did not end."""
    uncertain = []
    for name, target in rule.targets.items():
        estimate = None if view is None else view.parameters.get(name)
        values = {"name": name, "target": 100.0 * target}
        if estimate is None or not estimate.std:
            uncertain.append(Message("test.parameter_unknown", "{name} is not known (target {target:.1f} %)", **values))
            continue
        uncertain.append(
            Message(
                "test.parameter_uncertain",
                "{name} has an uncertainty of {percent:.1f} % (target {target:.1f} %)",
                percent=100.0 * estimate.std / abs(estimate.value),
                **values,
            )
        )
    return Message(
        "test.too_short", "the test was too short for the requested uncertainty: {known}", known=joined(uncertain)
    )


def view_line(view: LiveView) -> str:
    """Return the current state of a running test as one line."""
    parts = [f"{fixed(view.seconds, 2)} s"]
    for name, estimate in view.parameters.items():
        unit, scale = _UNITS[name]
        parts.append(f"{name} {plus_minus(estimate, scale)} {unit}")
    if view.vaf_percent is not None:
        parts.append(f"VAF {fixed(view.vaf_percent, 1)} % ({view.method})")
    return ", ".join(parts if view.parameters else [*parts, view.missing])


def answer_of(test: Test, asked: DepthRange | None, step: TestStep | None) -> dict[str, Any]:
    """Return one test for JSON; values that do not apply to its kind of stimulus are None."""
    depths = depth_range_of(test, asked)
    answer: dict[str, Any] = {
        "test": test.number,
        "status": test.status,
        "samples": test.samples,
        "stimulus": stimulus_of(test).get("type"),
        "depth_min_m": None if depths is None else depths[0],
        "depth_max_m": None if depths is None else depths[1],
        "kolmogorov_distance": kolmogorov_distance(test, depths),
    }
    for note in ("late_blocks", "held_samples"):
        count = test.notes.get(note)
        answer[note] = int(count) if isinstance(count, float) else None
    for note in ("generating_share", "generating_longest_s", "ended_early_s", "reason"):
        answer[note] = test.notes.get(note)
    quality = quality_of(test)
    answer |= {"configuration": test.configuration} | {name: test.notes.get(name) for name in PROPERTIES}
    answer |= {"verdict": verdict_of(test), "quality": None if quality is None else quality.as_dict()["findings"]}
    if step is not None:
        answer |= {
            "kolmogorov_distance_predicted": step.predicted,
            "designed_by": step.engine,
            "vaf_held_out_percent": step.vaf_held_out_percent,
        }
    return answer


_SI = {"mass": "mass_kg", "damping": "damping_n_s_per_m", "stiffness": "stiffness_n_per_m"}


def live_answer(view: LiveView | None) -> dict[str, Any] | None:
    """Return the last live estimates of a test for JSON, SI; None without any."""
    if view is None:
        return None
    return {
        "method": view.method,
        "seconds": view.seconds,
        "vaf_percent": view.vaf_percent,
        "parameters": {
            _SI[name]: {"value": estimate.value, "std": estimate.std} for name, estimate in view.parameters.items()
        },
    }


def tests_table(tests: Sequence[Test], asked: DepthRange | None) -> Table:
    """Return a table with one row per test, without empty columns."""
    answers = [answer_of(test, asked, None) | {"depths": depth_range_of(test, asked)} for test in tests]
    cells: dict[str, tuple[str, Callable[[Any], str]]] = {
        "test": ("test", str),
        "stimulus": ("stimulus", str),
        "status": ("status", str),
        "samples": ("samples", grouped),
        "depth mm": ("depths", lambda depths: " to ".join(fixed(1e3 * depth, 2) for depth in depths)),
        "distance from target": ("kolmogorov_distance", lambda distance: fixed(distance, 3)),
        "computing %": ("generating_share", lambda share: fixed(100.0 * share, 1)),
        "late blocks": ("late_blocks", grouped),
        "held samples": ("held_samples", grouped),
        "quality": ("verdict", str),
    }
    shown = {name: cell for name, cell in cells.items() if any(answer[cell[0]] is not None for answer in answers)}
    rows = [
        [MISSING if answer[key] is None else text(answer[key]) for key, text in shown.values()] for answer in answers
    ]
    return table("Tests", *shown, rows=rows)
