"""What a diagnosis says: the content of page and report, its JSON, and stored answers.

Answers are stored so that long work on many sessions can be interrupted and resumed: ``answers/NAME.json`` in a folder
holds one each, written atomically by the process that computed it. Each file has the SHA-256 of its content, so that a
changed one is never scored or reported.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tissueid.atomic_write import atomic_file, private_folder
from tissueid.errors import UnusableInputError
from tissueid.formatting import number
from tissueid.gap.diagnosis import Diagnosis, Ranked, parameters_of
from tissueid.gap.diagnosis_content import DiagnosisContent, Fitted, Rival, SignalOverlay, StageContent
from tissueid.gap.diagnosis_plots import PROFILES, budget_rows, gap_spectrum, overlays_of, profile_values
from tissueid.gap.noise import MARGIN
from tissueid.gap.statement import (
    alternatives_of,
    described,
    effect_title,
    headline_of,
    members_of,
    next_steps_of,
    ordered_candidates,
    percent,
    sentences_of,
    shown_probability,
)
from tissueid.gap.twin_export import stds_of
from tissueid.language import marked
from tissueid.messages import MISSING, Listing, Message, sentences, stored
from tissueid.records import Estimate
from tissueid.twin.catalogue import all_effects
from tissueid.twin.effect import STAGES, Stage


def as_answer(found: Diagnosis) -> dict[str, Any]:
    """Return the JSON of ``tissueid gap diagnose``."""
    figures = found.gap
    return {
        "verdict": found.verdict,
        "gap": {
            "before": figures.before,
            "after": figures.after,
            "floor": figures.floor,
            "closed": figures.closed,
            "closed_ci": list(figures.closed_ci),
            "announced": figures.predicted_closed,
        },
        "where": found.where.as_answer(),
        "ranking": [
            {
                "effect": item.effect,
                "stage": item.stage,
                "probability": item.probability,
                "closed": item.closed,
                "closed_ci": list(item.closed_ci),
                "indistinguishable": list(item.indistinguishable),
                "parameters": item.parameters,
            }
            for item in (ordered_candidates(found) if found.combination else found.ranking)
        ],
        "combination": list(found.combination),
        "budget": _budget(found),
        "remains": None if found.budget is None else {"share": found.budget.remains, "stage": found.budget.remains_in},
        "detection_limits": {
            name: None if limit is None else dict(vars(limit)) for name, limit in found.detection_limits.items()
        },
        "members": [
            {
                "effect": item.effect,
                "probability": item.probability,
                "rivals": [{"effect": name, "probability": share} for name, share in item.rivals],
            }
            for item in members_of(found)
        ],
        "next_experiment": None
        if found.next_experiment is None
        else {
            "kind": found.next_experiment.kind,
            "why": str(found.next_experiment.why),
            "message": stored(found.next_experiment.why),
            "separates": list(found.next_experiment.separates),
            "gain_nats": found.next_experiment.gain_nats,
            "separation": found.next_experiment.separation,
            "gains": found.next_experiment.gains,
            "command_line": found.next_experiment.command_line,
        },
        "ceiling": found.ceiling,
        "without": list(found.without),
        "not_tried": list(found.not_tried),
        "remarks": [str(remark) for remark in found.remarks],
        "remark_messages": list(map(stored, found.remarks)),
        "statement": stored(headline_of(found)[0]),
        "seconds": found.seconds,
    }


def _budget(found: Diagnosis) -> list[dict[str, Any]]:
    # In the order of adding; empty where nothing is named.
    alternatives = alternatives_of(found)
    return [
        {
            "effect": step.effect,
            "stage": step.stage,
            "closed_when_added": step.added,
            "closed_when_added_ci": list(step.added_ci),
            "closed_when_removed": step.removed,
            "closed_when_removed_ci": list(step.removed_ci),
            "gap_after": step.gap_after,
            "alternatives": list(alternatives[step.effect]),
        }
        for step in (() if found.budget is None else found.budget.steps)
    ]


def content_of(found: Diagnosis, file: Path | None = None) -> DiagnosisContent:
    """Return what page and report show of a diagnosis; with the shell's command where the session's file is given."""
    regions = found.where.regions
    headline, level = headline_of(found)
    spectrum = next((item for item in regions.spectra if item.channel == regions.channel), None)
    return DiagnosisContent(
        found.verdict,
        _titles(found.combination),
        headline,
        level,
        tuple(sentences_of(found)),
        tuple(next_steps_of(found, file)),
        found.remarks,
        tuple(_stage(found, stage) for stage in STAGES),
        found.at_fault,
        None if spectrum is None else gap_spectrum(spectrum, regions.above["bands_hz"]),
        {name: profile_values(name, regions.profiles[name]) for name in PROFILES if name in regions.profiles},
        tuple(_rival(found, item) for item in ordered_candidates(found)),
        _closing(found),
        _overlays(found),
        tuple(_offered(found)),
        budget_rows(found),
    )


def _titles(names: Sequence[str]) -> str:
    if not names:
        return ""
    return Message("gap.effects", "{names}", names=Listing(tuple(effect_title(name) for name in names)))


def _offered(found: Diagnosis) -> Iterator[tuple[str, str, bool]]:
    for member in members_of(found):
        for name, share in ((member.effect, member.probability), *member.rivals):
            yield name, described(found, name, share), name == member.effect


def _stage(found: Diagnosis, stage: Stage) -> StageContent:
    where = found.where
    if found.verdict == "no_gap":
        only_noise = marked("The residual of the simulation is noise: there is no evidence against this stage.")
        return StageContent(stage, 0.0, False, (only_noise,))
    lines: list[str] = [
        Message(
            "gap.stage_finding",
            "{finding}: {error} times the noise of the {channel}.",
            finding=item.what,
            error=number(item.error / item.floor, 3),
            channel=item.channel,
        )
        for item in where.findings
        if item.stage == stage
    ]
    named = [
        effect_title(name) for name in found.combination if name in all_effects() and all_effects()[name].stage == stage
    ]
    if named:
        causes = Listing(tuple(named), "; ", "; ")
        lines.append(Message("gap.stage_of_effect", "Named effects of this stage: {names}.", names=causes))
    return StageContent(
        stage, where.shares[stage], stage in found.at_fault, tuple(lines) or (_no_evidence(found, stage),)
    )


def _no_evidence(found: Diagnosis, stage: Stage) -> str:
    nearest = found.where.nearest
    if stage not in nearest:
        return marked("There is no evidence against this stage.")
    times = number(nearest[stage], 3)
    if nearest[stage] <= MARGIN:
        return Message(
            "gap.stage_within_noise",
            "There is no evidence against this stage: its residual is {times} times the noise.",
            times=times,
        )
    return Message(
        "gap.stage_elsewhere",
        "There is no evidence against this stage: its residual is {times} times the noise, which another stage "
        "explains.",
        times=times,
    )


def _rival(found: Diagnosis, item: Ranked) -> Rival:
    known = all_effects().get(item.effect)
    probability = shown_probability(found, item.effect, item.probability)
    return Rival(
        effect_title(item.effect),
        item.stage,
        item.effect in found.combination,
        probability,
        f"{percent(probability)} %" if np.isfinite(probability) else MISSING,
        _closed(found, item),
        _titles(item.indistinguishable),
        "" if known is None else known.signature,
        "" if known is None else known.remedy,
        _figures(found, item),
    )


def _closed(found: Diagnosis, item: Ranked) -> str:
    low, high = item.closed_ci
    if np.isfinite(item.closed) and np.isfinite(low) and np.isfinite(high):
        values = {"percent": 100.0 * item.closed, "low": 100.0 * low, "high": 100.0 * high}
        return Message("gap.closed_interval", "{percent:.0f} % ({low:.0f} to {high:.0f} %)", **values)
    if np.isfinite(item.closed):
        return Message("gap.share", "{percent:.0f} %", percent=100.0 * item.closed)
    if item.effect in found.combination and np.isfinite(found.gap.closed):
        return Message("gap.closed_together", "{percent:.0f} % together", percent=100.0 * found.gap.closed)
    return marked("not determined")


def _figures(found: Diagnosis, item: Ranked) -> tuple[Fitted, ...]:
    values, stds = item.parameters, {}
    if item.effect in found.combination and found.best is not None:
        values, stds = parameters_of(found.best, item.effect), stds_of(found.best)
    known = all_effects().get(item.effect)
    about: dict[str, Any] = {} if known is None else {parameter.name: parameter for parameter in known.parameters}
    rows = []
    for name, value in values.items():
        meaning = (about[name].meaning if name in about else "") or name.replace("_", " ")
        std = stds.get(f"{item.effect}.{name}")
        rows.append(Fitted(meaning, Estimate(value, std), about[name].unit if name in about else ""))
    return tuple(rows)


def _closing(found: Diagnosis) -> str:
    gap = found.gap
    if found.verdict == "no_gap":
        return Message("gap.nothing_to_close", "There is no gap to close: the residual is noise.")
    if not np.isfinite(gap.closed):
        return marked("No candidate was fitted to the gap.")
    low, high = gap.closed_ci
    values = {"percent": 100.0 * gap.closed, "predicted": 100.0 * gap.predicted_closed}
    if np.isfinite(low) and np.isfinite(high):
        closed = Message(
            "gap.closed_percent_interval",
            "Closed: {percent:.0f}\u00a0% of what noise does not explain (95 %: {low:.0f} to {high:.0f}\u00a0%); "
            "{predicted:.0f}\u00a0% predicted on the data used for the choice.",
            low=100.0 * low,
            high=100.0 * high,
            **values,
        )
    else:
        closed = Message(
            "gap.closed_percent",
            "Closed: {percent:.0f}\u00a0% of what noise does not explain; "
            "{predicted:.0f}\u00a0% predicted on the data used for the choice.",
            **values,
        )
    if not np.isfinite(found.ceiling):
        return closed
    ceiling = Message(
        "gap.ceiling",
        "The most that any model closed, physical or not: {percent:.0f}\u00a0%.",
        percent=100.0 * found.ceiling,
    )
    return sentences(closed, ceiling)


def _overlays(found: Diagnosis) -> tuple[SignalOverlay, ...]:
    """Return every signal, the one with the largest gap first; none if every sample was fitted."""
    if found.where.regions.channel not in found.dataset.channels:
        return ()
    try:
        return overlays_of(found)
    except UnusableInputError:
        return ()


FOLDER = "answers"
_MOST_BYTES = 20_000_000
_KEYS = {"verdict", "gap", "where", "ranking", "combination"}


def store_answer(folder: Path, key: str, answer: dict[str, Any]) -> None:
    """Store an answer; raise UnusableInputError where it cannot be written."""
    path = answer_path(folder, key)
    try:
        private_folder(path.parent)
        with atomic_file(path) as partial:
            # NaN is kept, so that stored answers score exactly as fresh ones.
            body = json.dumps(answer, default=lambda item: item.item())
            partial.write_text(f'{{"sha256": "{_digest(body)}", "content": {body}}}', encoding="utf-8")
    except OSError as error:
        reason = error.strerror or ""
        raise UnusableInputError(
            "blind.unwritable", "cannot write {path}: {reason}", path=str(path), reason=reason
        ) from error


def stored_answer(folder: Path, key: str) -> dict[str, Any] | None:
    """Return a stored answer or None; raise UnusableInputError where the file holds something else."""
    found = stored_content(folder, key)
    if found is not None and not found.keys() >= _KEYS:
        raise _unreadable(answer_path(folder, key))
    return found


def answer_path(folder: Path, key: str) -> Path:
    """Return the file of an answer."""
    return folder / FOLDER / f"{key}.json"


def stored_content(folder: Path, key: str) -> dict[str, Any] | None:
    """Return what ``store_answer`` stored or None; raise UnusableInputError where the file holds something else."""
    path = answer_path(folder, key)
    if not path.exists():
        return None
    try:
        usable = path.is_file() and path.stat().st_size <= _MOST_BYTES
        found = json.loads(path.read_text(encoding="utf-8")) if usable else None
        content, digest = (found.get("content"), found.get("sha256")) if isinstance(found, dict) else (None, None)
        if isinstance(content, dict) and digest == _digest(json.dumps(content)):
            return content
    except (OSError, ValueError, RecursionError) as error:
        raise _unreadable(path) from error
    raise _unreadable(path)


def _digest(body: str) -> str:
    return hashlib.sha256(body.encode()).hexdigest()


def _unreadable(path: Path) -> UnusableInputError:
    return UnusableInputError(
        "blind.unreadable_answer", "{path} holds no answer: delete it to diagnose again", path=str(path)
    )
