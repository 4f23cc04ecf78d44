"""Output of ``tissueid study protocol`` and ``tissueid study sitting``."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path

from tissueid.cli.output import ConsoleControl, check_json, human_output, progress_bars, table, write_json
from tissueid.cli.stop_key import StopKey, stop_key
from tissueid.messages import MISSING
from tissueid.procedures.instrument_access import audit_trail
from tissueid.procedures.study_protocol import PROTOCOL_FILE, Condition, sitting_steps
from tissueid.procedures.study_sitting import (
    ProtocolPlan,
    SittingRunPlan,
    SittingState,
    open_sitting,
    run_sitting,
    write_protocol,
)


def print_protocol(plan: ProtocolPlan, json_file: Path | None) -> None:
    """Check or write a protocol and print its order.

    Raises:
        UnusableInputError: it is not valid, or cannot be written.
    """
    check_json(json_file)
    protocol, written = write_protocol(plan)
    console = human_output(json_file)
    path = plan.folder / PROTOCOL_FILE
    console.print(f"{'template written' if written else 'protocol'}: {path}", markup=False, soft_wrap=True)
    steps = sitting_steps(protocol, "P01")
    order = "fixed" if protocol.order == "fixed" else "randomised by subject; shown for P01"
    shown = table(f"{protocol.name}: {len(steps)} tests for each subject, order {order}", "Site", "Condition", "Tests")
    for step in steps:
        if step.repeat == 1:
            shown.add_row(step.site, condition_text(step.condition), str(step.repeats))
    console.print(shown)
    console.print(f"asks for: {', '.join(protocol.demographics) or 'nothing'}", markup=False, soft_wrap=True)
    if json_file is not None:
        write_json(json_file, {"protocol": protocol.model_dump(mode="json"), "written": written, "tests": len(steps)})


def print_sitting(plan: SittingRunPlan, json_file: Path | None) -> None:
    """Run what is left of a sitting and print where it stands, also if it ends early.

    Raises:
        TissueIDError: it could not start, or a test failed or was stopped.
    """
    check_json(json_file)
    try:
        with contextlib.ExitStack() as stack:
            control = _SittingControl(stack.enter_context(progress_bars()), stack.enter_context(stop_key()))
            state = run_sitting(plan, control, audit_trail())
    except BaseException:
        with contextlib.suppress(Exception):  # the first error is the one that is shown
            if (state := open_sitting(plan.folder, plan.subject)).tests:
                _print_state(state, json_file)
        raise
    _print_state(state, json_file)
    if json_file is not None:
        write_json(json_file, _answer(state))


def condition_text(condition: Condition) -> str:
    """Return a condition in one line."""
    words = [condition.product] if condition.product else []
    if condition.minutes_since_application is not None:
        words.append(f"after {condition.minutes_since_application:g} min")
    if condition.orientation_deg is not None:
        words.append(f"{condition.orientation_deg:g}°")
    return ", ".join(words) or MISSING


class _SittingControl(ConsoleControl):
    """Shows progress and notices; the stop keys end the sitting."""

    def __init__(self, show: Callable[[str, float | None], None], key: StopKey) -> None:
        super().__init__(show)
        self._key = key

    def check(self) -> bool:
        """Return False, or raise if a stop key was pressed."""
        return self._key.check()


def _print_state(state: SittingState, json_file: Path | None) -> None:
    console, step = human_output(json_file), state.step
    done = state.total if step is None else step.place - 1
    console.print(f"{state.subject}: {done} of {state.total} steps done", markup=False)
    if poor := sum(not test.counts for test in state.tests):
        console.print(f"{poor} tests do not count: their quality is 'repeat'", markup=False)
    if step is not None:
        where = f"{step.site}, test {step.repeat} of {step.repeats}"
        console.print(f"next: {where}; the same command continues", markup=False, soft_wrap=True)
    console.print(f"sessions: {state.sessions}", markup=False, soft_wrap=True)


def _answer(state: SittingState) -> dict[str, object]:
    step = state.step
    return {
        "subject": state.subject,
        "steps": state.total,
        "done": state.total if step is None else step.place - 1,
        "tests": [test.condition.model_dump() | {"site": test.site, "counts": test.counts} for test in state.tests],
        "problems": dict(state.problems),
    }
