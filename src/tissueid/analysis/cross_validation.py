"""Four-fold cross-validation: every quarter of the tests is held out in turn."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from tissueid.analysis.fitting import timed_fit
from tissueid.analysis.scoring import held_out_error
from tissueid.analysis.split import Split
from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Engine
from tissueid.identification.recommendation import beaten
from tissueid.identification.recommendation_messages import ModelCandidate, difference
from tissueid.language import marked
from tissueid.records import Record, joined

Progress = Callable[[str, float], None]
"""Called with the name of the current step and the completed share of it, 0 to 1."""

_OUT_OF_REACH = 0.001
"""Significance level of a lead on the last quarter beyond which the trailing engine is not fitted to other quarters."""


_STEP = marked("fitting again with each quarter held out")


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
            progress(_STEP, (done + number / len(others)) / len(names))
            _add(engines[name], quarter, candidates, errors)
    progress(_STEP, 1.0)
    quarters = [quarter.unseen.output for quarter in (*others, parts)]
    centred = [_centred_output(error, quarters) for error in errors]
    found = [replace(c, error=e, measured=y) for c, e, y in zip(candidates, errors, centred, strict=True)]
    return found, joined(parts.records)


def _centred_output(error: Array, quarters: Sequence[Array]) -> Array:
    """Return the output (n,) without its mean in each quarter, over the samples where the error (n,) is known."""
    known = [np.where(np.isfinite(error), quarter, np.nan) for quarter in quarters]
    return np.asarray(np.nansum([_without_mean(quarter) for quarter in known], axis=0), dtype=np.float64)


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
            found = _without_mean(held_out_error(model, quarter, second_order=candidate.second_order))
            errors[k] = np.where(np.isfinite(found), found, errors[k])


def _without_mean(error: Array) -> Array:
    known = error[np.isfinite(error)]
    return error - known.mean() if known.size else error
