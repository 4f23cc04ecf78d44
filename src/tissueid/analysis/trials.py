"""The same engine with other values of an option: memory against scores (Chen 2010, Fig. 8.1), and what suffices."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tissueid.analysis.fitting import Analysis, fit_split, timed_fit
from tissueid.analysis.scoring import effective_parameters, held_out_error, scored
from tissueid.analysis.split import Split
from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Engine
from tissueid.identification.recommendation import Recommendation

Progress = Callable[[str, float], None]
"""Called with what is being done and how much of it is done, 0 to 1."""

SWEPT_MEMORY_S = (0.01, 0.02, 0.03, 0.04, 0.06, 0.08, 0.125)

_MEMORY_SHARES = (0.125, 0.25, 0.5, 1.0)
_FEWEST_LAGS = 8
"""A memory of fewer samples is not worth trying."""

_TRIED: Mapping[str, Sequence[float]] = {"partitions": (2, 3, 5, 7, 10, 15), "order": (1, 2, 3)}
"""Options by which a description is sized, wherever an engine has them, and what is tried beside the value in use."""


@dataclass(frozen=True)
class SweepRow:
    """One engine at one memory (s): what it found, or why it was refused."""

    engine: str
    memory: float
    analysis: Analysis | None = None
    parameters: float | None = None
    refused: str | None = None


def memory_sweep(
    specifications: Sequence[Engine], parts: Split, progress: Progress, memories: Sequence[float] = SWEPT_MEMORY_S
) -> tuple[SweepRow, ...]:
    """Every engine whose memory is an option, at several; all are scored on the same samples, those of the longest."""
    rows: list[SweepRow] = []
    done: list[Analysis] = []
    for specification in specifications:
        if specification.options().get("memory") is None:  # it has none, or finds its own
            continue
        label = f"memory of {specification.name}"
        for number, memory in enumerate(memories):
            progress(label, number / len(memories))
            try:
                analysis = fit_split(_with(specification, memory=memory), parts)
            except UnusableInputError as error:
                rows.append(SweepRow(specification.name, memory, refused=str(error)))
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
    """Add to a recommendation the smallest memory, number of partitions and order that do as well as larger ones.

    Each is tried by itself, the other options as they are, on the held-out samples.
    """
    fields = type(specification).model_fields
    options = specification.options()
    for option in ("memory", *_TRIED):
        present = options.get(option)
        if option not in fields or isinstance(present, bool) or not isinstance(present, int | float):
            continue
        shortest = _FEWEST_LAGS / parts.record.sample_rate_hz
        shares = [m * present for m in _MEMORY_SHARES if m * present >= shortest]
        values = shares if option == "memory" else sorted({present, *_TRIED[option]})
        trials: list[tuple[float, Array]] = []
        for number, value in enumerate(values):
            progress("sizing the recommended one", number / len(values))
            try:
                model, _ = timed_fit(_with(specification, **{option: value}), parts.record, parts.fit_part)
            except UnusableInputError:
                continue
            trials.append((float(value), held_out_error(model, parts)))
        if len(trials) > 1:
            found = found.with_choice(option, trials, parts.unseen)
    progress("sizing the recommended one", 1.0)
    return found


def _with(specification: Engine, **changes: Any) -> Engine:
    return specification.from_options(specification.options() | changes)
