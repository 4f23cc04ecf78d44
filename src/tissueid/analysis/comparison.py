"""Comparison of engines on one record (Chen 2010, Fig. 8.1 and Table 8.1), with a recommendation."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tissueid.analysis.cross_validation import cross_validated
from tissueid.analysis.fitting import Analysis, fit_split
from tissueid.analysis.option_sweeps import Progress, SweepRow, memory_sweep, sized
from tissueid.analysis.scoring import Scored, candidates, scored
from tissueid.analysis.split import Split
from tissueid.errors import UnusableInputError
from tissueid.identification.base import Engine, Family
from tissueid.identification.recommendation import Recommendation, recommend
from tissueid.identification.registry import engine_names, get_engine
from tissueid.identification.validation.repeats import Ceiling
from tissueid.language import marked
from tissueid.messages import Message, Verbatim, joined

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
    found = recommend(
        contenders,
        held_out,
        parts.fitted,
        judged_on=marked("every quarter held out in turn") if parts.records else parts.validated_on,
        ceiling_percent=None if ceiling is None else ceiling.vaf_percent.value,
    )
    return EngineComparison(
        entries=tuple(ComparisonEntry(e.name, e.family, rows.get(e.name), refused.get(e.name)) for e in engines),
        split=parts,
        recommendation=sized(found, specified[found.engine], parts, progress),
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
        found: list[Analysis | str] = []
        for engine in engines:
            progress(engine.name, 0.0)
            found.append(fit_or_reason(parts, engine))
            progress(engine.name, 1.0)
        return found

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
