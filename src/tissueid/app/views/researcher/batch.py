"""Run engines on tests, in a process of their own. A failure is recorded and the next test is run."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tissueid.analysis import EngineComparison, analyse, specifications
from tissueid.app.user_files import stamp_of
from tissueid.app.views.researcher.engine_outcome import (
    MOST_TESTS,
    AnalysisHistory,
    AnalysisTask,
    EngineOutcome,
    HistoryEntry,
)
from tissueid.app.views.researcher.selected_test import SelectedTest, timestamp_of
from tissueid.app.words import in_words, sentence
from tissueid.errors import CancelledError, TissueIDError, UnusableInputError
from tissueid.formatting import clean, fixed, grouped, subject_text
from tissueid.identification import engine_label
from tissueid.identification.recommendation_messages import ModelStanding
from tissueid.language import _, marked
from tissueid.messages import MISSING, Listing, Message, Verbatim, translated
from tissueid.procedures.control import Control
from tissueid.procedures.identification import compare_engines
from tissueid.sessions import Session, read_session

_SUFFIX = ".h5"
_MOST_DRAWN = 300
"""Maximum number of results with curves; further results are stored without."""
_STEPS = 8.0
"""Work of a comparison after its last engine, in units of one engine."""


@dataclass(frozen=True, eq=False)
class Batch:
    """Result of a task. ``problems`` are texts; ``entry`` is its entry in the history."""

    task: AnalysisTask
    outcomes: tuple[EngineOutcome, ...]
    verdicts: tuple[ComparisonSummary, ...]
    problems: tuple[str, ...]
    cancelled: bool
    entry: HistoryEntry | None


def run(task: AnalysisTask, history: AnalysisHistory, moment: str, control: Control) -> Batch:
    """Run a task and add it to the history; ``moment`` is its start in ISO 8601.

    Raises:
        UnusableInputError: an option is invalid; no test is run, because it would fail for every one.
    """
    if task.kind == "run":
        task.specification()
    groups, done, verdicts, problems = task.groups, list[EngineOutcome](), list[ComparisonSummary](), list[str]()
    read = functools.lru_cache(maxsize=2)(read_session)
    cancelled = False
    try:
        for index, group in enumerate(groups):
            part = _PartControl(control, index, len(groups), clean(group[0].label))
            part.progress(0.0, "")
            part.check()
            stamp = stamp_of(group[0].path)
            try:
                outcomes, verdict = (_run_one if task.kind == "run" else _compare_one)(task, group, read, part)
            except CancelledError:
                raise
            except Exception as error:  # noqa: BLE001 - one test that fails must not cost the others
                problems.append(f"{clean(group[0].label)}: {in_words(error)}")
                done.append(_refused(task, task.engines[0], group, in_words(error)))
                control.finished(done[-1:])
                continue
            outcomes = [replace(outcome, stamp=stamp) for outcome in outcomes]
            done += outcomes if len(done) < _MOST_DRAWN else [outcome.bare() for outcome in outcomes]
            verdicts += verdict
            control.finished(done[len(done) - len(outcomes) :])
    except CancelledError:
        cancelled = True
    entry = HistoryEntry(time=moment, task=task, headline=_headline(done, cancelled))
    try:
        history.add(entry)
    except OSError as error:
        problems.append(
            translated(
                Message(
                    "research.no_history",
                    "The history could not be written: {problem}",
                    problem=Verbatim(in_words(error)),
                )
            )
        )
    return Batch(task, tuple(done), tuple(verdicts), tuple(problems), cancelled, entry)


def refit(outcomes: Sequence[EngineOutcome], control: Control) -> Batch:
    """Refit results that were stored without curves; failures are added to ``problems``."""
    done, problems, cancelled = list[EngineOutcome](), list[str](), False
    read = functools.lru_cache(maxsize=2)(read_session)
    tasks = [_task_of(outcome) for outcome in outcomes]
    for index, (outcome, task) in enumerate(zip(outcomes, tasks, strict=True)):
        part = _PartControl(control, index, len(outcomes), outcome.test_label)
        try:
            part.progress(0.0, "")
            part.check()
            stamp = stamp_of(outcome.tests[0].path)
            ((fitted,), _none) = _run_one(task, outcome.tests, read, part)
            done.append(replace(fitted, options=outcome.options, stamp=stamp, recommended=outcome.recommended))
        except CancelledError:
            cancelled = True
            break
        except Exception as error:  # noqa: BLE001 - one test that fails must not cost the others
            problems.append(f"{outcome.test_label}: {in_words(error)}")
    return Batch(tasks[0], tuple(done), (), tuple(problems), cancelled, None)


def _task_of(outcome: EngineOutcome) -> AnalysisTask:
    into, out = outcome.signals
    return AnalysisTask(
        engines=(outcome.engine,),
        options=outcome.options,
        input_name=into,
        output_name=out,
        preparation=outcome.preparation,
    )


def run_folder(folder: Path, task: AnalysisTask, history: AnalysisHistory, moment: str, control: Control) -> Batch:
    """Run a task on the tests of all sessions in a folder and its subfolders.

    Raises:
        UnusableInputError: the folder holds no test, or an option is refused.
    """
    if task.kind == "run":
        task.specification()
    try:
        tests, problems = find_tests(folder, control)
    except CancelledError:
        return Batch(task, (), (), (), True, None)
    if not tests and problems:
        raise UnusableInputError(problems[0])
    if not tests:
        raise UnusableInputError("research.no_session", "there is no session in {folder}", folder=str(folder))
    named = task.model_copy(update={"tests": tuple(tests)})
    batch = run(named, history, moment, control)
    return replace(batch, problems=(*problems, *batch.problems))


class _PartControl(Control):
    """Control of one of several parts of a task: it shows the completed share of the task."""

    def __init__(self, whole: Control, index: int, count: int, label: str) -> None:
        self._whole, self._index, self._count = whole, index, count
        self._label = (
            _("{place} of {count}: {label}").format(place=index + 1, count=count, label=label) if count > 1 else label
        )

    def progress(self, fraction: float | None, step: str) -> None:
        """Show the part, the step and the completed share of the task."""
        share = (self._index + (fraction or 0.0)) / self._count
        self._whole.progress(share, f"{self._label}, {step}" if step else self._label)

    def cancelled(self) -> bool:
        """Return whether the task should end."""
        return self._whole.cancelled()


class _ComparisonControl(Control):
    """Control of a comparison: it adds the shares of its steps to that of the comparison."""

    def __init__(self, whole: Control, engines: Sequence[str]) -> None:
        self._whole, self._engines = whole, tuple(engines)
        self._begun: list[str] = []

    def progress(self, fraction: float | None, step: str) -> None:
        """Show the engine or the step, and the completed share of the comparison."""
        share, count = fraction or 0.0, len(self._engines)
        if step not in self._begun:
            self._begun.append(step)
        begun = len(self._begun)
        within = min(begun - 1.0, count) + (share if begun <= count else 0.5 * _STEPS * share)
        title = engine_label(step) if step in self._engines else sentence(translated(step)).removesuffix(".")
        self._whole.progress(min(0.95, within / (count + _STEPS)), title)

    def cancelled(self) -> bool:
        """Return whether the comparison should end."""
        return self._whole.cancelled()


def _run_one(
    task: AnalysisTask, group: tuple[SelectedTest, ...], read: Callable[[Path], Session], control: Control
) -> tuple[list[EngineOutcome], list[ComparisonSummary]]:
    alone = task.preparation.tissue_alone
    session, options = read(group[0].path), dict(task.options)
    analysis = analyse(session, task.engines[0], options, tissue_alone=alone, **task.selection(group))
    control.progress(0.8, _("drawing"))
    control.check()
    signals = task.input_name, task.output_name
    return [EngineOutcome.of(analysis, options, group, signals, task.preparation)], []


def _compare_one(
    task: AnalysisTask, group: tuple[SelectedTest, ...], read: Callable[[Path], Session], control: Control
) -> tuple[list[EngineOutcome], list[ComparisonSummary]]:
    shown = _ComparisonControl(control, task.engines)
    specified = specifications(task.engines)
    comparison = compare_engines(read(group[0].path), specified, shown, **task.selection(group)).comparison
    control.progress(0.96, _("drawing"))
    control.check()
    return list(_outcomes(comparison, group, task)), [summary_of(comparison, group)]


def _outcomes(
    comparison: EngineComparison, group: tuple[SelectedTest, ...], task: AnalysisTask
) -> Iterator[EngineOutcome]:
    signals, prepared = (task.input_name, task.output_name), task.preparation.without_actuator
    for entry in comparison.entries:
        if entry.scored is None:
            yield EngineOutcome(
                entry.engine, {}, group, signals, preparation=prepared, refused=entry.refused or marked("refused")
            )
        else:
            best = entry.engine == comparison.recommendation.engine
            outcome = EngineOutcome.of(entry.scored.analysis, {}, group, signals, prepared)
            yield replace(outcome, recommended=best)


def _refused(task: AnalysisTask, engine: str, group: tuple[SelectedTest, ...], reason: str) -> EngineOutcome:
    signals = task.input_name, task.output_name
    return EngineOutcome(engine, dict(task.options), group, signals, preparation=task.preparation, refused=reason)


def _headline(done: list[EngineOutcome], cancelled: bool) -> str:
    """Return the result of a run in a line: number of fits, and their scores on held-out data."""
    reports = [outcome.report for outcome in done if outcome.report is not None]
    held_out = sorted(r.vaf_validation_percent for r in reports if r.vaf_validation_percent is not None)
    parts: list[str] = []
    if len(done) > 1 or not reports:
        parts.append(Message("research.fitted", "{count} of {total} fitted", count=len(reports), total=len(done)))
    if held_out:
        low, high = held_out[0], held_out[-1]
        if fixed(low, 1) == fixed(high, 1):
            parts.append(Message("research.vaf", "VAF held out {percent:.1f} %", percent=low))
        else:
            parts.append(Message("research.vaf_range", "VAF held out {low:.1f} to {high:.1f} %", low=low, high=high))
    if cancelled:
        parts.append(marked("cancelled"))
    return Message("research.headline", "{names}", names=Listing(tuple(parts))) if parts else ""


def find_tests(folder: Path, control: Control) -> tuple[list[SelectedTest], list[str]]:
    """Return the stochastic tests of all sessions in a folder and its subfolders, and a text for each unusable file.

    A session without a stochastic test gives its first one.

    Raises:
        CancelledError: the search was cancelled.
        UnusableInputError: the folder cannot be searched.
    """
    try:
        paths: list[Path] = []
        for path in folder.rglob(f"*{_SUFFIX}"):
            control.progress(None, _("{count} files found").format(count=len(paths)))
            control.check()
            if path.is_file():
                paths.append(path)
    except OSError as error:
        raise UnusableInputError(
            "research.folder_unreadable",
            "{folder} cannot be searched: {reason}",
            folder=str(folder),
            reason=error.strerror or "",
        ) from error
    tests: list[SelectedTest] = []
    problems: list[str] = []
    for index, path in enumerate(sorted(paths)):
        control.progress(index / len(paths), _("reading {name}").format(name=clean(path.name)))
        control.check()
        try:
            session = read_session(path)
            taken = [test for test in session.tests if test.kind == "stochastic"] or [session.test()]
        except (TissueIDError, OSError) as error:
            problems.append(in_words(error))
            continue
        for test in taken:
            label = f"{subject_text(session.subject.pseudonym)[:20]}, {clean(path.stem)[:30]} #{test.number}"
            when = timestamp_of(session.created)
            tests.append(SelectedTest(path, test.number, test.site, session.subject.pseudonym, label, when))
    if len(tests) > MOST_TESTS:
        problems.append(
            _("The folder holds {count} tests; the first {most} are used.").format(count=len(tests), most=MOST_TESTS)
        )
    return tests[:MOST_TESTS], problems


@dataclass(frozen=True)
class ComparisonSummary:
    """The recommendation for one test. ``rows`` are the standings, best first: see ``COLUMNS``."""

    label: str
    headline: str
    judged_on: str
    reasons: tuple[str, ...]
    doubts: tuple[str, ...]
    experiments: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


COLUMNS = (
    marked("Engine"),
    marked("Verdict"),
    marked("VAF held out (%)"),
    marked("VAF fitted (%)"),
    marked("Below the best (points)"),
    "AICc",
    marked("Kind"),
)


def summary_of(comparison: EngineComparison, tests: tuple[SelectedTest, ...]) -> ComparisonSummary:
    """Return the summary of a comparison; refused engines come last, with the reason."""
    said = comparison.recommendation
    recommended = (said.engine, said.second_order)
    rows = [_standing(standing, (standing.engine, standing.second_order) == recommended) for standing in said.standings]
    rows += [
        (engine_label(entry.engine), _("refused"), *[MISSING] * 4, sentence(translated(entry.refused)))
        for entry in comparison.entries
        if entry.refused
    ]
    headline, *reasons = map(translated, said.sentences)
    ceiling = comparison.ceiling
    if ceiling is not None:
        reasons.append(_("Repeats of the test allow {vaf} % at best.").format(vaf=fixed(ceiling.vaf_percent.value, 2)))
    label = (
        clean(tests[0].label)
        if len(tests) == 1
        else _("{first} and {count} more").format(first=clean(tests[0].label), count=len(tests) - 1)
    )
    return ComparisonSummary(
        label,
        sentence(headline),
        sentence(_("judged on {data}").format(data=translated(said.judged_on))),
        tuple(map(sentence, reasons)),
        tuple(sentence(translated(doubt)) for doubt in said.doubts),
        tuple(sentence(translated(experiment)) for experiment in said.experiments),
        tuple(rows),
    )


def _standing(standing: ModelStanding, recommended: bool) -> tuple[str, ...]:
    name = engine_label(standing.engine) + (_(", mass, damping and stiffness") if standing.second_order else "")
    behind = standing.behind
    how = fixed(behind.points, 2) + (f" ± {fixed(behind.std_points, 2)}" if behind.points else "")
    return (
        name,
        _("recommended") if recommended else _("clearly worse") if standing.beaten else _("as good"),
        fixed(standing.vaf_percent, 2),
        fixed(standing.vaf_fitted_percent, 2),
        how,
        grouped(standing.aicc),
        _(str(standing.family)),
    )
