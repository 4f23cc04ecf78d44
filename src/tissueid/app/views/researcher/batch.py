"""The work itself, off the window's thread: engines on one test after another, each failure costing only itself."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tissueid.analysis import EngineComparison, analyse, compare, known_ceiling, specifications, split
from tissueid.app.views.researcher.chosen import Chosen, time_of
from tissueid.app.views.researcher.history import Entry, History
from tissueid.app.views.researcher.outcome import Outcome, stamp_of
from tissueid.app.views.researcher.progress import Progress
from tissueid.app.views.researcher.task import MOST_TESTS, Task, TestRef
from tissueid.app.views.researcher.verdict import Verdict, verdict_of
from tissueid.app.words import in_words, sentence
from tissueid.errors import CancelledError, TissueIDError, UnusableInputError
from tissueid.sessions import Session, read_session
from tissueid.wording import clean, engine_label, fixed

_SUFFIX = ".h5"
_MOST_DRAWN = 300
"""Results that keep their curves; of further ones only the figures are kept."""
_STEPS = 8.0
"""How many further engines' worth of work a comparison does after its last engine."""


@dataclass(frozen=True, eq=False)
class Batch:
    """What a task came to. ``problems`` are in words; ``entry`` is its line in the history."""

    task: Task
    outcomes: tuple[Outcome, ...]
    verdicts: tuple[Verdict, ...]
    problems: tuple[str, ...]
    cancelled: bool
    entry: Entry | None


def run(task: Task, progress: Progress, history: History, moment: str) -> Batch:
    """Do a task, and write its line into the history; ``moment`` is when it began, in ISO 8601.

    Raises:
        UnusableInputError: an option is refused, which costs all tests alike.
    """
    if task.kind == "run":
        task.specification()
    groups, done, verdicts, problems = task.groups, list[Outcome](), list[Verdict](), list[str]()
    read = functools.lru_cache(maxsize=2)(read_session)
    cancelled = False
    try:
        for place, group in enumerate(groups):
            tell = _part(progress, place, len(groups), clean(group[0].label))
            tell("", 0.0)
            stamp = stamp_of(group[0].path)
            try:
                found, verdict = (_run_one if task.kind == "run" else _compare_one)(task, group, read, tell)
            except CancelledError:
                raise
            except Exception as error:  # noqa: BLE001 - one test that fails must not cost the others
                problems.append(f"{clean(group[0].label)}: {in_words(error)}")
                done += [_refused(task, name, group, in_words(error)) for name in task.engines[:1]]
                continue
            found = [replace(outcome, stamp=stamp) for outcome in found]
            done += found if len(done) < _MOST_DRAWN else [outcome.bare() for outcome in found]
            verdicts += verdict
    except CancelledError:
        cancelled = True
    entry = Entry(time=moment, task=task, headline=_headline(done, cancelled))
    try:
        history.add(entry)
    except OSError as error:
        problems.append(f"The history could not be written: {in_words(error)}")
    return Batch(task, tuple(done), tuple(verdicts), tuple(problems), cancelled, entry)


def refit(outcomes: Sequence[Outcome], progress: Progress) -> Batch:
    """Fit results again whose curves were not kept; one that fails is left out and said in ``problems``."""
    done, problems, cancelled = list[Outcome](), list[str](), False
    read = functools.lru_cache(maxsize=2)(read_session)
    tasks = [_task_of(outcome) for outcome in outcomes]
    for place, (outcome, task) in enumerate(zip(outcomes, tasks, strict=True)):
        tell = _part(progress, place, len(outcomes), outcome.test_label)
        try:
            tell("", 0.0)
            stamp = stamp_of(outcome.tests[0].path)
            ((found,), _none) = _run_one(task, outcome.tests, read, tell)
            done.append(replace(found, options=outcome.options, stamp=stamp, recommended=outcome.recommended))
        except CancelledError:
            cancelled = True
            break
        except Exception as error:  # noqa: BLE001 - one test that fails must not cost the others
            problems.append(f"{outcome.test_label}: {in_words(error)}")
    return Batch(tasks[0], tuple(done), (), tuple(problems), cancelled, None)


def _task_of(outcome: Outcome) -> Task:
    into, out = outcome.signals
    return Task(engines=(outcome.engine,), options=outcome.options, input_name=into, output_name=out)


def run_folder(folder: Path, task: Task, progress: Progress, history: History, moment: str) -> Batch:
    """Do a task on the tests of all sessions below a folder; files that are of no use are told.

    Raises:
        UnusableInputError: the folder holds no test, or an option is refused.
    """
    if task.kind == "run":
        task.specification()
    try:
        tests, problems = find_tests(folder, progress)
    except CancelledError:
        return Batch(task, (), (), (), True, None)
    if not tests:
        raise UnusableInputError(problems[0] if problems else f"there is no session below {folder}")
    named = task.model_copy(update={"tests": tuple(TestRef.of(test) for test in tests)})
    found = run(named, progress, history, moment)
    return replace(found, problems=(*problems, *found.problems))


def _part(progress: Progress, place: int, count: int, label: str) -> Callable[[str, float], None]:
    which = f"{place + 1} of {count}: {label}" if count > 1 else label

    def tell(what: str, share: float) -> None:
        progress.tell(f"{which}, {what}" if what else which, (place + share) / count)

    return tell


def _run_one(
    task: Task, group: tuple[Chosen, ...], read: Callable[[Path], Session], tell: Callable[[str, float], None]
) -> tuple[list[Outcome], list[Verdict]]:
    first, *others = group
    signals = task.input_name, task.output_name
    analysis = analyse(
        read(first.path),
        task.engines[0],
        dict(task.options),
        test=first.number,
        also=[test.number for test in others],
        input_name=signals[0],
        output_name=signals[1],
    )
    tell("drawing", 0.8)
    return [Outcome.of(analysis, dict(task.options), group, signals)], []


def _compare_one(
    task: Task, group: tuple[Chosen, ...], read: Callable[[Path], Session], tell: Callable[[str, float], None]
) -> tuple[list[Outcome], list[Verdict]]:
    first, *others = group
    engines = specifications(task.engines)
    session = read(first.path)
    also = [test.number for test in others]
    signals = task.input_name, task.output_name
    parts = split(session, test=first.number, also=also, input_name=signals[0], output_name=signals[1])
    try:
        ceiling = known_ceiling(session, parts)
    except UnusableInputError:
        ceiling = None
    heard: list[str] = []
    total = len(engines) + _STEPS

    def advance(what: str, share: float) -> None:
        if what not in heard:
            heard.append(what)
        within = min(len(heard) - 1.0, len(engines)) + (share if len(heard) <= len(engines) else 0.5 * _STEPS * share)
        tell(engine_label(what), min(0.95, within / total))

    found = compare(engines, parts, ceiling=ceiling, progress=advance)
    tell("drawing", 0.96)
    return list(_outcomes(found, group, signals)), [verdict_of(found, group)]


def _outcomes(found: EngineComparison, group: tuple[Chosen, ...], signals: tuple[str, str]) -> Iterator[Outcome]:
    for entry in found.entries:
        if entry.scored is None:
            yield Outcome(entry.engine, {}, group, signals, refused=sentence(entry.refused or "refused"))
        else:
            best = entry.engine == found.recommendation.engine
            yield replace(Outcome.of(entry.scored.analysis, {}, group, signals), recommended=best)


def _refused(task: Task, engine: str, group: tuple[Chosen, ...], words: str) -> Outcome:
    signals = task.input_name, task.output_name
    return Outcome(engine, dict(task.options), group, signals, refused=words)


def _headline(done: list[Outcome], cancelled: bool) -> str:
    """The figures of a run in a line: the one that there is, or how many, and how well."""
    reports = [outcome.report for outcome in done if outcome.report is not None]
    held_out = sorted(r.vaf_validation_percent for r in reports if r.vaf_validation_percent is not None)
    words = []
    if len(done) > 1 or not reports:
        words.append(f"{len(reports)} of {len(done)} fitted")
    if held_out:
        low, high = fixed(held_out[0], 1), fixed(held_out[-1], 1)
        words.append(f"VAF held out {low} %" if low == high else f"VAF held out {low} to {high} %")
    if cancelled:
        words.append("cancelled")
    return ", ".join(words)


def find_tests(folder: Path, progress: Progress) -> tuple[list[Chosen], list[str]]:
    """The stochastic tests of all sessions below a folder, and in words which files are of no use.

    A session without a stochastic test gives its first one.

    Raises:
        CancelledError: nobody wants them any more.
        UnusableInputError: the folder cannot be searched.
    """
    try:
        paths: list[Path] = []
        for path in folder.rglob(f"*{_SUFFIX}"):
            progress.tell(f"{len(paths)} files found", 0.0)
            if path.is_file():
                paths.append(path)
    except OSError as error:
        raise UnusableInputError(f"{folder}: {error.strerror}") from error
    tests: list[Chosen] = []
    problems: list[str] = []
    for place, path in enumerate(sorted(paths)):
        progress.tell(f"reading {clean(path.name)}", place / len(paths))
        try:
            session = read_session(path)
            taken = [test for test in session.tests if test.kind == "stochastic"] or [session.test()]
        except (TissueIDError, OSError) as error:
            problems.append(in_words(error))
            continue
        for test in taken:
            label = f"{clean(session.subject.pseudonym)[:20]}, {clean(path.stem)[:30]} #{test.number}"
            when = time_of(session.created)
            tests.append(Chosen(path, test.number, test.site, session.subject.pseudonym, label, when))
    if len(tests) > MOST_TESTS:
        problems.append(f"The folder holds {len(tests)} tests; the first {MOST_TESTS} are taken.")
    return tests[:MOST_TESTS], problems
