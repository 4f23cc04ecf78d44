"""Scores of an engine at several values of an option: memory (Chen 2010, Fig. 8.1), partitions, order."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tissueid.analysis.fitting import Analysis, fit_split, timed_fit
from tissueid.analysis.scoring import effective_parameters, held_out_error, scored
from tissueid.analysis.split import Split
from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Engine
from tissueid.identification.memory import MemoryEngine
from tissueid.identification.recommendation import Recommendation
from tissueid.language import marked
from tissueid.messages import Message

Progress = Callable[[str, float], None]
"""Called with the name of the current step and the completed share of it, 0 to 1."""

SWEPT_MEMORY_S = (0.01, 0.02, 0.03, 0.04, 0.06, 0.08, 0.125)
"""Memories of a sweep, s, as in Fig. 8.1."""

_MEMORY_SHARES = (0.125, 0.25, 0.5, 1.0)
"""Shares of the memory in use that are tried to find a sufficient one."""

_FEWEST_LAGS = 8
"""Shortest memory that is tried, samples."""

_TRIED: Mapping[str, Sequence[float]] = {"partitions": (2, 3, 5, 7, 10, 15), "order": (1, 2, 3)}
"""Options that set the size of a model, and the values that are tried in addition to the one in use."""

_STEP = marked("finding a sufficient size of the recommended model")


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


def sized(found: Recommendation, specification: Engine, parts: Split, progress: Progress) -> Recommendation:
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
            progress(_STEP, number / len(values))
            try:
                model, _ = timed_fit(_with(specification, **{option: value}), parts.record, parts.fit_part)
            except UnusableInputError:
                continue
            trials.append((float(value), held_out_error(model, parts)))
        if len(trials) > 1:
            found = found.with_choice(option, trials, parts.unseen)
    progress(_STEP, 1.0)
    return found


def _with(specification: Engine, **changes: Any) -> Engine:
    return specification.from_options(specification.options() | changes)
