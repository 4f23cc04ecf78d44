"""Comparison of engines on one record (Chen 2010, Fig. 8.1 and Table 8.1), with a recommendation."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tissueid.analysis.fitting import (
    Analysis,
    Scored,
    candidates,
    effective_parameters,
    fit_split,
    held_out_error,
    scored,
    timed_fit,
)
from tissueid.analysis.split import FIT_SHARE, Split
from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Engine, Family
from tissueid.identification.memory import MemoryEngine
from tissueid.identification.recommendation import Recommendation, beaten, recommend
from tissueid.identification.recommendation_messages import ModelCandidate, difference
from tissueid.identification.registry import engine_names, get_engine
from tissueid.identification.validation.distortion import Distortion, distortion
from tissueid.identification.validation.repeats import Ceiling, ceiling
from tissueid.language import marked
from tissueid.messages import Listing, Message, Verbatim, joined
from tissueid.records import Record
from tissueid.records import joined as joined_records
from tissueid.sessions import Session, Test
from tissueid.stimuli.kinds.multisine import multisine_from_description

Progress = Callable[[str, float], None]
"""Called with the name of the current step and the completed share of it, 0 to 1."""
Fits = Callable[[Sequence[Engine], Split], "list[Analysis | str]"]
"""Function that fits engines to a split record: an analysis of each, or the reason for which it refused."""


@dataclass(frozen=True)
class ComparisonEntry:
    """One row of the table: an engine with its scores, or the reason why it refused the record."""

    engine: str
    family: Family
    scored: Scored | None = None
    refused: str | None = None


@dataclass(frozen=True)
class EngineComparison:
    """Result of ``tissueid compare``. ``entries`` are in the order of the requested engines."""

    entries: tuple[ComparisonEntry, ...]
    split: Split
    recommendation: Recommendation
    ceiling: Ceiling | None
    memory_sweep: tuple[SweepRow, ...]

    @property
    def analyses(self) -> dict[str, Analysis]:
        """The analyses by engine, without refused engines."""
        return {entry.engine: entry.scored.analysis for entry in self.entries if entry.scored is not None}


def specifications(
    names: Sequence[str] | None = None,
    shared: Mapping[str, Any] | None = None,
    own: Mapping[str, Mapping[str, Any]] | None = None,
) -> tuple[Engine, ...]:
    """Return the specifications of the engines to compare.

    Args:
        names: names of engines; None for all that are installed.
        shared: options for every engine that has them.
        own: options of one engine, by its name.

    Raises:
        UnusableInputError: no engine, an unknown or repeated one, an option that none has or that is out of bounds.
    """
    chosen = engine_names() if names is None else tuple(names)
    if not chosen:
        raise UnusableInputError(
            "compare.no_engine", "no engine is given: choose from {names}", names=joined(map(Verbatim, engine_names()))
        )
    engines = {name: get_engine(name) for name in chosen}
    if len(engines) < len(chosen):
        raise UnusableInputError("compare.repeated_engine", "an engine is given twice")
    for name in own or {}:
        if name not in engines:
            raise UnusableInputError(
                "compare.options_of_other_engine",
                "options are given for '{name}', which is not among the engines to compare",
                name=Verbatim(name),
            )
    for option in shared or {}:
        if not any(option in engine.model_fields for engine in engines.values()):
            raise UnusableInputError(
                "compare.no_such_option", "none of these engines has an option '{option}'", option=Verbatim(option)
            )
    return tuple(
        engine.from_options(
            {option: value for option, value in (shared or {}).items() if option in engine.model_fields}
            | dict((own or {}).get(name, {}))
        )
        for name, engine in engines.items()
    )


def compare(
    engines: Sequence[Engine],
    parts: Split,
    *,
    ceiling: Ceiling | None = None,
    sweep: bool = False,
    progress: Progress = lambda _what, _share: None,
    fits: Fits | None = None,
) -> EngineComparison:
    """Fit engines one after another, or as ``fits`` does it, score them on the same samples, and recommend one.

    An engine that refuses the record gets a row with the reason. ``ceiling`` is the highest VAF that repeats allow,
    from :func:`known_ceiling`. ``sweep`` adds scores against memory. ``progress`` is called with the name of the
    current step and its completed share.

    Raises:
        UnusableInputError: every engine refused the record, or none could be scored on held-out samples.
    """
    done: dict[str, Analysis] = {}
    refused: dict[str, str] = {}
    for engine, outcome in zip(engines, (fits or _fit_each(progress))(engines, parts), strict=True):
        if isinstance(outcome, Analysis):
            done[engine.name] = outcome
        else:
            refused[engine.name] = outcome
    if not done:
        raise UnusableInputError(_no_engine_message(refused))
    if not parts.scorable:
        raise UnusableInputError(
            "compare.nothing_to_predict",
            "the held-out output does not vary above its noise: hold out another test, or a part that varies",
        )
    rows = dict(zip(done, scored(list(done.values()), parts), strict=True))
    specified = {engine.name: engine for engine in engines}
    contenders = candidates(list(rows.values()), [specified[name].family for name in rows], parts)
    contenders, held_out = cross_validated(contenders, specified, parts, progress)
    recommendation = recommend(
        contenders,
        held_out,
        parts.fitted,
        judged_on=marked("every quarter held out in turn") if parts.records else parts.validated_on,
        ceiling_percent=None if ceiling is None else ceiling.vaf_percent.value,
    )
    return EngineComparison(
        entries=tuple(ComparisonEntry(e.name, e.family, rows.get(e.name), refused.get(e.name)) for e in engines),
        split=parts,
        recommendation=sized(recommendation, specified[recommendation.engine], parts, progress),
        ceiling=ceiling,
        memory_sweep=memory_sweep(engines, parts, progress) if sweep else (),
    )


def fit_or_reason(parts: Split, engine: Engine) -> Analysis | str:
    """Fit an engine; return the reason where it refuses the record. It can run in another process."""
    try:
        return fit_split(engine, parts)
    except UnusableInputError as error:
        return error.message


def _fit_each(progress: Progress) -> Fits:
    def fits(engines: Sequence[Engine], parts: Split) -> list[Analysis | str]:
        outcomes: list[Analysis | str] = []
        for engine in engines:
            progress(engine.name, 0.0)
            outcomes.append(fit_or_reason(parts, engine))
            progress(engine.name, 1.0)
        return outcomes

    return fits


def _no_engine_message(refused: Mapping[str, str]) -> str:
    reason, times = Counter(refused.values()).most_common(1)[0]
    if times == len(refused):
        return reason
    return Message(
        "compare.all_refused",
        "none of {engines} engines can be fitted; {times} of them: {reason}",
        engines=len(refused),
        times=times,
        reason=reason,
    )


_OUT_OF_REACH = 0.001
"""Significance level of a lead on the last quarter beyond which the trailing engine is not fitted to other quarters."""


_REFITTING = marked("fitting again with each quarter held out")


def cross_validated(
    candidates: Sequence[ModelCandidate], engines: Mapping[str, Engine], parts: Split, progress: Progress
) -> tuple[list[ModelCandidate], Record]:
    """Return candidates with their errors on every quarter of the tests, and the record (n,) of those errors.

    ``engines`` holds the specifications by name. Each engine is refitted without each of the other quarters. Engines
    far behind on the last quarter are not refitted, and none is when another test is held out. The mean error of each
    quarter is removed, as a constant offset does not count in Eq. 3.13, and the mean output too: no model is credited
    with the differences between quarters.
    """
    others = parts.other_quarters
    if not others:
        return list(candidates), parts.unseen
    errors = [_without_mean(candidate.error) for candidate in candidates]
    names = sorted({c.engine for c in candidates if not _is_far_behind(c, candidates, parts.unseen)})
    for done, name in enumerate(names):
        for number, quarter in enumerate(others):
            progress(_REFITTING, (done + number / len(others)) / len(names))
            _add(engines[name], quarter, candidates, errors)
    progress(_REFITTING, 1.0)
    quarters = [quarter.unseen.output for quarter in (*others, parts)]
    centred = [_centred_output(error, quarters) for error in errors]
    with_errors = [replace(c, error=e, measured=y) for c, e, y in zip(candidates, errors, centred, strict=True)]
    return with_errors, joined_records(parts.records)


def _centred_output(error: Array, quarters: Sequence[Array]) -> Array:
    """Return the output (n,) without its mean in each quarter, over the samples where the error (n,) is known."""
    masked = [np.where(np.isfinite(error), quarter, np.nan) for quarter in quarters]
    return np.asarray(np.nansum([_without_mean(quarter) for quarter in masked], axis=0), dtype=np.float64)


def _is_far_behind(candidate: ModelCandidate, candidates: Sequence[ModelCandidate], unseen: Record) -> bool:
    leads = (difference(c.error, candidate.error, unseen.output, unseen.sample_rate_hz) for c in candidates)
    return any(beaten(lead, _OUT_OF_REACH) for lead in leads)


def _add(specification: Engine, quarter: Split, candidates: Sequence[ModelCandidate], errors: list[Array]) -> None:
    try:
        model, _ = timed_fit(specification, quarter.record, quarter.fit_part)
    except UnusableInputError:
        return
    for k, candidate in enumerate(candidates):
        if candidate.engine == specification.name:
            error = _without_mean(held_out_error(model, quarter, second_order=candidate.second_order))
            errors[k] = np.where(np.isfinite(error), error, errors[k])


def _without_mean(error: Array) -> Array:
    finite = error[np.isfinite(error)]
    return error - finite.mean() if finite.size else error


SWEPT_MEMORY_S = (0.01, 0.02, 0.03, 0.04, 0.06, 0.08, 0.125)
"""Memories of a sweep, s, as in Fig. 8.1."""

_MEMORY_SHARES = (0.125, 0.25, 0.5, 1.0)
"""Shares of the memory in use that are tried to find a sufficient one."""

_FEWEST_LAGS = 8
"""Shortest memory that is tried, samples."""

_TRIED: Mapping[str, Sequence[float]] = {"partitions": (2, 3, 5, 7, 10, 15), "order": (1, 2, 3)}
"""Options that set the size of a model, and the values that are tried in addition to the one in use."""

_SIZING = marked("finding a sufficient size of the recommended model")


@dataclass(frozen=True)
class SweepRow:
    """One engine at one memory, s: its analysis, or why the engine refused."""

    engine: str
    memory: float
    analysis: Analysis | None = None
    parameters: float | None = None
    refused: str | None = None


def memory_sweep(
    specifications: Sequence[Engine], parts: Split, progress: Progress, memories: Sequence[float] = SWEPT_MEMORY_S
) -> tuple[SweepRow, ...]:
    """Fit every engine that has an option ``memory`` at several values. Score all on the samples of the longest.

    ``memories`` are for tissue, s; those of another system are in proportion to the memory of its record.
    """
    rows: list[SweepRow] = []
    done: list[Analysis] = []
    for specification in specifications:
        if not isinstance(specification, MemoryEngine):
            continue
        label = Message("trials.memory", "memory of {engine}", engine=specification.label)
        scale = 1.0
        if specification.memory is None:  # of another system than tissue
            automatic = specification.for_record(parts.record, parts.fit_part).memory_s
            scale = automatic / specification.usual_memory_s
        for number, memory in enumerate(scale * share for share in memories):
            progress(label, number / len(memories))
            try:
                analysis = fit_split(_with(specification, memory=memory), parts)
            except UnusableInputError as error:
                rows.append(SweepRow(specification.name, memory, refused=error.message))
                continue
            done.append(analysis)
            rows.append(SweepRow(specification.name, memory, analysis))
        progress(label, 1.0)
    together = {id(a): row for a, row in zip(done, scored(done, parts) if done else [], strict=True)}
    return tuple(
        row
        if row.analysis is None
        else SweepRow(
            row.engine,
            row.memory,
            together[id(row.analysis)].analysis,
            effective_parameters(row.analysis.model.report),
        )
        for row in rows
    )


def sized(recommendation: Recommendation, specification: Engine, parts: Split, progress: Progress) -> Recommendation:
    """Return the recommendation with the smallest sufficient memory, number of partitions and order.

    Each option that the engine has is varied alone, and scored on held-out samples.
    """
    fields = type(specification).model_fields
    options = specification.for_record(parts.record, parts.fit_part).options()
    for option in ("memory", *_TRIED):
        present = options.get(option)
        if option not in fields or isinstance(present, bool) or not isinstance(present, int | float):
            continue
        shortest = _FEWEST_LAGS / parts.record.sample_rate_hz
        shares = [m * present for m in _MEMORY_SHARES if m * present >= shortest]
        values = shares if option == "memory" else sorted({present, *_TRIED[option]})
        trials: list[tuple[float, Array]] = []
        for number, value in enumerate(values):
            progress(_SIZING, number / len(values))
            try:
                model, _ = timed_fit(_with(specification, **{option: value}), parts.record, parts.fit_part)
            except UnusableInputError:
                continue
            trials.append((float(value), held_out_error(model, parts)))
        if len(trials) > 1:
            recommendation = recommendation.with_choice(option, trials, parts.unseen)
    progress(_SIZING, 1.0)
    return recommendation


def _with(specification: Engine, **changes: Any) -> Engine:
    return specification.from_options(specification.options() | changes)


_USABLE = 0.8
"""Smallest share of the test's samples that a repeat must hold to be used."""


def repeats(session: Session, number: int) -> tuple[Test, ...]:
    """Return a test and the tests of the session that repeat it, or that it repeats; itself first.

    Raises:
        UnusableInputError: there is no such test.
    """
    test = session.test(number)
    first = number if test.repeat_of is None else test.repeat_of
    others = [t for t in session.tests if first in (t.number, t.repeat_of) and t.number != number]
    return (test, *others)


def known_ceiling(session: Session, parts: Split) -> Ceiling | None:
    """Return the highest held-out VAF that a model could reach, from repeats of the held-out test or part.

    None without repeats, and where the fitted tests do not all repeat one another. Repeats that ended early or lost too
    many samples are listed in ``left_out``.

    Raises:
        UnusableInputError: the repeats are not alike, or hold too few samples, or none can be used.
    """
    number = parts.tests[0] if parts.validated is None else parts.validated
    same = repeats(session, number)
    if len(same) < 2 or (parts.validated is None and not {t.number for t in same}.issuperset(parts.tests)):
        return None
    names = parts.record.input_name, parts.record.output_name
    first = same[0].record(*names)
    part = slice(0, len(first)) if parts.validated is not None else slice(round(FIT_SHARE * len(first)), len(first))
    wanted = _received(first, part)
    records = [first]
    left_out: list[Message] = []
    for test in same[1:]:
        if wanted and (reason := _too_little(test, names, part, wanted)):
            left_out.append(
                Message("ceiling.left_out", "test {number} was left out: {reason}", number=test.number, reason=reason)
            )
        else:
            records.append(test.record(*names))
    if len(records) < 2:
        raise UnusableInputError(
            "ceiling.no_repeat", "no other repeat can be used: {left_out}", left_out=Listing(tuple(left_out))
        )
    return replace(ceiling(records, None if parts.validated is not None else part), left_out=tuple(left_out))


def _received(record: Record, part: slice) -> int:
    return int(np.sum(np.isfinite(record.input[part]) & np.isfinite(record.output[part])))


def _too_little(test: Test, names: tuple[str, str], part: slice, wanted: int) -> str:
    """Return why a repeat cannot be used, where ``wanted`` samples are compared; empty where it can."""
    aborted = test.status == "aborted"
    if test.samples <= round(test.preload_s * test.sample_rate_hz):
        if aborted:
            return Message("ceiling.ended_in_preload", "it ended early, within its preload")
        return Message("ceiling.only_preload", "it holds nothing but its preload")
    share = _received(test.record(*names), part) / wanted
    if share >= _USABLE:
        return ""
    if aborted:
        return Message(
            "ceiling.ended_early",
            "it ended early, and holds {percent:.0f} % of the compared samples",
            percent=100.0 * share,
        )
    return Message(
        "ceiling.incomplete",
        "it is short or has gaps, and holds {percent:.0f} % of the compared samples",
        percent=100.0 * share,
    )


def is_multisine(described: Mapping[str, Any]) -> bool:
    """Return whether a session describes a stimulus as a multisine, whichever software made it."""
    return "multisine" in str(described).lower()


def distortion_of(record: Record, described: Mapping[str, Any]) -> Distortion:
    """Return the levels in a record (n,) of a multisine; the driven lines are estimated where none are declared.

    Raises:
        UnusableInputError: all lines were driven, or the record is not that of an odd multisine.
    """
    multisine = multisine_from_description(described)
    if multisine is None:
        return distortion(record)
    if multisine.lines == "full":
        raise UnusableInputError(
            "distortion.all_lines_driven",
            "the multisine drove every line, and distortion shows only on lines that are not driven",
        )
    return distortion(record, multisine.period, multisine.driven_lines().tolist(), multisine.settling_s)


def described_levels(levels: Distortion) -> str:
    """Return noise, even and odd levels relative to the output, as far as they are known; empty where none is."""
    rows = (
        (marked("noise {level:.1f} dB"), levels.noise_rms),
        (marked("even {level:.1f} dB"), levels.even_rms),
        (marked("odd {level:.1f} dB"), levels.odd_rms),
    )
    rows_db = ((template, levels.relative_db(level)) for template, level in rows)
    items = tuple(
        Message("distortion.level", template, level=level) for template, level in rows_db if level is not None
    )
    return Message("distortion.levels", "{levels}", levels=Listing(items)) if items else ""
