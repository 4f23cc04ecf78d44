"""The sitting of a subject in a study, on an instrument; acceptance of the result of a sitting, and its withdrawal.

The tests of a subject are the sessions in the folder of the study that is named by the subject, such as ``P01``. An
acceptance is written to the audit log first, then to the result files.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from tissueid.atomic_write import private_folder, unused_path
from tissueid.audit import AuditTrail
from tissueid.errors import TissueIDError, UnusableInputError
from tissueid.formatting import clean
from tissueid.instrument.discovery import IN_PROCESS
from tissueid.messages import Message, Verbatim, joined
from tissueid.plan_options import Option, Plan
from tissueid.procedures.control import Control, RemainingTime, counted
from tissueid.procedures.output_files import write_text, writing
from tissueid.procedures.study_protocol import (
    PROTOCOL_FILE,
    Condition,
    Protocol,
    RecordedTest,
    SittingStep,
    check_pseudonym,
    check_tests,
    next_step,
    protocol_text,
    read_protocol,
    sitting_steps,
    template,
)
from tissueid.procedures.study_subjects import add_photograph, missing_demographics, save_demographics
from tissueid.procedures.test_plan import MAX_TEXT
from tissueid.test_settings import Circumstances, noted

if TYPE_CHECKING:  # each takes long to import
    from tissueid.instrument import Instrument
    from tissueid.sessions import Outline, Test
    from tissueid.sessions.accepted_result import AcceptedResult


SUFFIX = ".h5"


class ProtocolPlan(Plan):
    """The folder of a study whose protocol is written or checked."""

    folder: Annotated[Path, Option(argument=True, metavar="FOLDER", help="folder of the study")]


class SittingRunPlan(Plan):
    """A whole sitting of one subject."""

    folder: Annotated[Path, Option(argument=True, metavar="FOLDER", help="folder of a study with a protocol")]
    subject: Annotated[str, Option("--subject", metavar="PSEUDONYM", help="pseudonym such as P-001, never a name")]
    url: Annotated[
        str, Option("--device", metavar="URL", help="simulator, such as 'simulated://forearm?variation=1&subject=2'")
    ]
    values: Annotated[
        tuple[str, ...],
        Option("--value", metavar="NAME=VALUE", help="demographic value, such as age_years=30; may be repeated"),
    ] = ()
    photographs: Annotated[
        tuple[str, ...],
        Option("--photograph", metavar="SITE=FILE", help="JPEG or PNG picture of a site; may be repeated"),
    ] = ()
    calibration: Annotated[bool, Option(help="use the newest calibration")] = True


@dataclass
class SittingState:
    """A subject's sitting: the protocol, the recorded tests in their order, and unreadable files with the reason."""

    protocol: Protocol
    subject: str
    folder: Path
    tests: list[RecordedTest] = field(default_factory=list)
    places: dict[tuple[str, Condition], list[tuple[Path, int]]] = field(default_factory=dict)
    """File and number of the tests that count, by site and condition."""
    problems: dict[str, str] = field(default_factory=dict)

    @property
    def step(self) -> SittingStep | None:
        """The next step; None when the sitting is complete."""
        return next_step(self.protocol, self.subject, self.tests)

    @property
    def total(self) -> int:
        """Number of steps."""
        return len(sitting_steps(self.protocol, self.subject))

    @property
    def sessions(self) -> Path:
        """The folder of the subject's sessions."""
        return self.folder / self.subject

    def add(self, path: Path, subject: str, tests: Iterable[Test]) -> None:
        """Add the completed tests of a session of this subject; others are no step of the sitting."""
        for test in tests if subject == self.subject else ():
            if test.status == "completed":
                self._add(path, test)

    def _add(self, path: Path, test: Test) -> None:
        from tissueid.sessions.quality import quality_of

        quality = quality_of(test)
        counts = quality is None or quality.verdict != "repeat"
        condition = condition_of(test.notes)
        self.tests.append(RecordedTest(test.site, condition, counts))
        if counts:
            self.places.setdefault((test.site, condition), []).append((path, test.number))


def condition_of(notes: Mapping[str, Any]) -> Condition:
    """Return the condition of a test from its notes; what cannot be one is left out."""
    return Condition(product=str(notes.get("condition", ""))[:MAX_TEXT], **noted(Circumstances, notes))


def open_sitting(folder: Path, subject: str) -> SittingState:
    """Read the protocol of a study and the tests of a subject that are recorded already.

    Raises:
        UnusableInputError: there is no protocol or it is not valid, or the subject is no pseudonym.
    """
    from tissueid.sessions import read_outline

    state = SittingState(read_protocol(folder), check_pseudonym(subject), folder)
    outlines: list[tuple[str, Path, Outline]] = []
    for path in sorted(state.sessions.glob(f"*{SUFFIX}")):
        try:
            outline = read_outline(path)
        except (TissueIDError, OSError) as error:
            state.problems[path.name] = str(error)
            continue
        outlines.append((outline.head.created, path, outline))
    for _created, path, outline in sorted(outlines, key=lambda entry: entry[:2]):
        state.add(path, outline.head.subject.pseudonym, (entry.test for entry in outline.tests))
    return state


def write_protocol(plan: ProtocolPlan) -> tuple[Protocol, bool]:
    """Return the protocol of a study, and whether it is a template that was written just now.

    Raises:
        UnusableInputError: the protocol is not valid, or the folder cannot be used.
    """
    if (plan.folder / PROTOCOL_FILE).exists():
        return read_protocol(plan.folder), False
    protocol = template()
    save_protocol(plan.folder, protocol)
    return protocol, True


def save_protocol(folder: Path, protocol: Protocol) -> None:
    """Write the protocol of a study into its folder, which is made if it is not there.

    Raises:
        UnusableInputError: the protocol is not valid, or the folder cannot be used.
    """
    path = folder / PROTOCOL_FILE
    check_tests(protocol, str(path))
    with writing(folder):
        private_folder(folder)
    write_text(path, protocol_text(protocol))


def prepare_subject(plan: SittingRunPlan, protocol: Protocol, control: Control) -> None:
    """Store the given demographic values and photographs, and state which values are missing.

    Raises:
        UnusableInputError: a value or a photograph cannot be used.
    """
    pairs = [_pair(text, "--value") for text in plan.values]
    photographs = [_pair(text, "--photograph") for text in plan.photographs]
    sites = [site.site for site in protocol.sites]
    for site, _file in photographs:
        if site not in sites:
            raise UnusableInputError(
                "sitting.site",
                "the protocol has no site '{site}'; it has {known}",
                site=Verbatim(site),
                known=joined(map(Verbatim, sites), between="; "),
            )
    subject = check_pseudonym(plan.subject)
    if pairs:
        save_demographics(plan.folder, subject, dict(pairs))
    for site, file in photographs:
        add_photograph(plan.folder, subject, site, Path(file))
    if missing := missing_demographics(protocol, plan.folder, subject):
        control.notice(
            Message(
                "sitting.demographics",
                "the protocol asks for values of {subject} that are missing: {names}; add them with {option}",
                subject=Verbatim(subject),
                option=Verbatim("--value NAME=VALUE"),
                names=joined(map(Verbatim, missing)),
            )
        )


def run_sitting(
    plan: SittingRunPlan,
    control: Control,
    trail: AuditTrail | None,
    *,
    opener: Callable[[str], Instrument] | None = None,
) -> SittingState:
    """Run all steps of a subject's sitting that are left, each test into a session of its own.

    Raises:
        UnusableInputError: protocol, subject or a value cannot be used, or the address is no simulator.
        CancelledError: it was cancelled; complete tests are kept, and the same call continues.
        TissueIDError, OSError: a test failed; the tests before it are kept.
    """
    from tissueid.procedures.test_run import run_test

    if not plan.url.startswith(IN_PROCESS):
        raise UnusableInputError(
            "sitting.simulated",
            "this command measures on a simulator only, such as simulated://forearm, got '{url}': on a person the "
            "window leads through the sitting, because the probe has to be moved between tests",
            url=Verbatim(clean(plan.url)),
        )
    state = open_sitting(plan.folder, plan.subject)
    for name, reason in state.problems.items():
        control.notice(
            Message("sitting.unreadable", "{file} does not count: {reason}", file=name, reason=Verbatim(reason))
        )
    prepare_subject(plan, state.protocol, control)
    label = Message("sitting.label", "Sitting of {subject}", subject=Verbatim(state.subject))
    remaining, first = RemainingTime(), None
    while (step := state.step) is not None:
        first = first or step.position
        share = (step.position - first) / (step.total - first + 1)
        text = counted(label, step.position - 1, step.total)
        control.progress((step.position - 1) / step.total, remaining.added_to(text, share))
        control.check()
        private_folder(state.sessions)
        test = state.protocol.plan(step, plan.url, _unused(state, step), calibration=plan.calibration)
        outcome = run_test(test, _of_sitting(control), trail, opener=opener, earlier=_earlier(state, step))
        session = outcome.saved()
        state.add(test.out, session.subject.pseudonym, session.tests)
    control.progress(1.0, counted(label, state.total, state.total))
    return state


def _of_sitting(control: Control) -> Any:
    from tissueid.procedures.test_run import TestControl

    class OfSitting(TestControl):
        """Passes notices and cancellation on; the progress is that of the sitting."""

        def notice(self, message: str) -> None:
            control.notice(message)

        def check(self) -> bool:
            return control.check()

        def cancelled(self) -> bool:
            return control.cancelled()

    return OfSitting()


def _earlier(state: SittingState, step: SittingStep) -> list[Test]:
    """Return the tests of this site and condition that count: the quality gate judges the next one against them."""
    from tissueid.sessions import read_test

    return [read_test(path, number) for path, number in state.places.get((step.site, step.condition), ())]


def _unused(state: SittingState, step: SittingStep) -> Path:
    path = state.sessions / f"{state.subject}-{step.position:03d}{SUFFIX}"
    return unused_path(path, taken=lambda path: path.exists() or path.with_name(f"{path.name}.journal").exists())


def _pair(text: str, option: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals or not name.strip():
        raise UnusableInputError(
            "sitting.pair",
            "{option} must be {form}, got '{text}'",
            option=Verbatim(option),
            form=Verbatim("NAME=VALUE"),
            text=Verbatim(clean(text)),
        )
    return name.strip(), value


class SittingPlan(Plan):
    """A sitting: its key, the folders that hold one of its tests, and the number of its tests."""

    key: str
    folders: tuple[Path, ...]
    tests: Annotated[int, Field(ge=0)]


def accept_sitting(plan: SittingPlan, result: AcceptedResult, trail: AuditTrail) -> AcceptedResult:
    """Log and store the accepted result of a sitting in each of its folders; return it.

    Raises:
        AuditError: it cannot be logged; no file is written.
        OSError: it cannot be written; the log says that the sitting goes on.
    """
    from tissueid.sessions.accepted_result import write_result

    trail.record("sitting.accepted", subject=plan.key, new=_logged(plan, result))
    try:
        for folder in plan.folders:
            write_result(folder, result)
    except OSError as error:
        reopen_sitting(plan, result, trail, why=f"the result file cannot be written: {error.strerror or error}")
        raise
    return result


def reopen_sitting(plan: SittingPlan, result: AcceptedResult, trail: AuditTrail, why: str = "by hand") -> None:
    """Log that an accepted sitting goes on, and remove its result files.

    Raises:
        AuditError: it cannot be logged; the files stay.
        OSError: a file cannot be removed.
    """
    from tissueid.sessions.accepted_result import withdraw_result

    trail.record("sitting.reopened", subject=plan.key, old=_logged(plan, result), new={"why": why})
    for folder in plan.folders:
        withdraw_result(folder, plan.key)


def _logged(plan: SittingPlan, result: AcceptedResult) -> dict[str, object]:
    """Return what the log keeps of a result: how many tests count of how many, which, and the values, SI."""
    return {
        "repeats": result.count,
        "tests": plan.tests,
        "accepted": [test.model_dump() for test in result.tests],
        "values": {name: value.model_dump(exclude_none=True) for name, value in result.values.items()},
    }
