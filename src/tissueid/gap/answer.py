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


def as_answer(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the JSON of ``tissueid gap diagnose``."""
    figures = diagnosis.gap
    return {
        "verdict": diagnosis.verdict,
        "gap": {
            "before": figures.before,
            "after": figures.after,
            "floor": figures.floor,
            "closed": figures.closed,
            "closed_ci": list(figures.closed_ci),
            "announced": figures.predicted_closed,
        },
        "where": diagnosis.where.as_answer(),
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
            for item in (ordered_candidates(diagnosis) if diagnosis.combination else diagnosis.ranking)
        ],
        "combination": list(diagnosis.combination),
        "budget": _budget(diagnosis),
        "remains": None
        if diagnosis.budget is None
        else {"share": diagnosis.budget.remains, "stage": diagnosis.budget.remains_in},
        "detection_limits": {
            name: None if limit is None else dict(vars(limit)) for name, limit in diagnosis.detection_limits.items()
        },
        "members": [
            {
                "effect": item.effect,
                "probability": item.probability,
                "rivals": [{"effect": name, "probability": share} for name, share in item.rivals],
            }
            for item in members_of(diagnosis)
        ],
        "next_experiment": None
        if diagnosis.next_experiment is None
        else {
            "kind": diagnosis.next_experiment.kind,
            "why": str(diagnosis.next_experiment.why),
            "message": stored(diagnosis.next_experiment.why),
            "separates": list(diagnosis.next_experiment.separates),
            "gain_nats": diagnosis.next_experiment.gain_nats,
            "separation": diagnosis.next_experiment.separation,
            "gains": diagnosis.next_experiment.gains,
            "command_line": diagnosis.next_experiment.command_line,
        },
        "ceiling": diagnosis.ceiling,
        "without": list(diagnosis.without),
        "not_tried": list(diagnosis.not_tried),
        "remarks": [str(remark) for remark in diagnosis.remarks],
        "remark_messages": list(map(stored, diagnosis.remarks)),
        "statement": stored(headline_of(diagnosis)[0]),
        "seconds": diagnosis.seconds,
    }


def _budget(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    # In the order of adding; empty where nothing is named.
    alternatives = alternatives_of(diagnosis)
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
        for step in (() if diagnosis.budget is None else diagnosis.budget.steps)
    ]


def content_of(diagnosis: Diagnosis, file: Path | None = None) -> DiagnosisContent:
    """Return what page and report show of a diagnosis; with the shell's command where the session's file is given."""
    regions = diagnosis.where.regions
    headline, level = headline_of(diagnosis)
    spectrum = next((item for item in regions.spectra if item.channel == regions.channel), None)
    return DiagnosisContent(
        diagnosis.verdict,
        _titles(diagnosis.combination),
        headline,
        level,
        tuple(sentences_of(diagnosis)),
        tuple(next_steps_of(diagnosis, file)),
        diagnosis.remarks,
        tuple(_stage(diagnosis, stage) for stage in STAGES),
        diagnosis.at_fault,
        None if spectrum is None else gap_spectrum(spectrum, regions.above["bands_hz"]),
        {name: profile_values(name, regions.profiles[name]) for name in PROFILES if name in regions.profiles},
        tuple(_rival(diagnosis, item) for item in ordered_candidates(diagnosis)),
        _closing(diagnosis),
        _overlays(diagnosis),
        tuple(_offered(diagnosis)),
        budget_rows(diagnosis),
    )


def _titles(names: Sequence[str]) -> str:
    if not names:
        return ""
    return Message("gap.effects", "{names}", names=Listing(tuple(effect_title(name) for name in names)))


def _offered(diagnosis: Diagnosis) -> Iterator[tuple[str, str, bool]]:
    for member in members_of(diagnosis):
        for name, share in ((member.effect, member.probability), *member.rivals):
            yield name, described(diagnosis, name, share), name == member.effect


def _stage(diagnosis: Diagnosis, stage: Stage) -> StageContent:
    where = diagnosis.where
    if diagnosis.verdict == "no_gap":
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
        effect_title(name)
        for name in diagnosis.combination
        if name in all_effects() and all_effects()[name].stage == stage
    ]
    if named:
        causes = Listing(tuple(named), "; ", "; ")
        lines.append(Message("gap.stage_of_effect", "Named effects of this stage: {names}.", names=causes))
    return StageContent(
        stage, where.shares[stage], stage in diagnosis.at_fault, tuple(lines) or (_no_evidence(diagnosis, stage),)
    )


def _no_evidence(diagnosis: Diagnosis, stage: Stage) -> str:
    nearest = diagnosis.where.nearest
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


def _rival(diagnosis: Diagnosis, item: Ranked) -> Rival:
    effect = all_effects().get(item.effect)
    probability = shown_probability(diagnosis, item.effect, item.probability)
    return Rival(
        effect_title(item.effect),
        item.stage,
        item.effect in diagnosis.combination,
        probability,
        f"{percent(probability)} %" if np.isfinite(probability) else MISSING,
        _closed(diagnosis, item),
        _titles(item.indistinguishable),
        "" if effect is None else effect.signature,
        "" if effect is None else effect.remedy,
        _figures(diagnosis, item),
    )


def _closed(diagnosis: Diagnosis, item: Ranked) -> str:
    low, high = item.closed_ci
    if np.isfinite(item.closed) and np.isfinite(low) and np.isfinite(high):
        values = {"percent": 100.0 * item.closed, "low": 100.0 * low, "high": 100.0 * high}
        return Message("gap.closed_interval", "{percent:.0f} % ({low:.0f} to {high:.0f} %)", **values)
    if np.isfinite(item.closed):
        return Message("gap.share", "{percent:.0f} %", percent=100.0 * item.closed)
    if item.effect in diagnosis.combination and np.isfinite(diagnosis.gap.closed):
        return Message("gap.closed_together", "{percent:.0f} % together", percent=100.0 * diagnosis.gap.closed)
    return marked("not determined")


def _figures(diagnosis: Diagnosis, item: Ranked) -> tuple[Fitted, ...]:
    values, stds = item.parameters, {}
    if item.effect in diagnosis.combination and diagnosis.best is not None:
        values, stds = parameters_of(diagnosis.best, item.effect), stds_of(diagnosis.best)
    effect = all_effects().get(item.effect)
    about: dict[str, Any] = {} if effect is None else {parameter.name: parameter for parameter in effect.parameters}
    rows = []
    for name, value in values.items():
        meaning = (about[name].meaning if name in about else "") or name.replace("_", " ")
        std = stds.get(f"{item.effect}.{name}")
        rows.append(Fitted(meaning, Estimate(value, std), about[name].unit if name in about else ""))
    return tuple(rows)


def _closing(diagnosis: Diagnosis) -> str:
    gap = diagnosis.gap
    if diagnosis.verdict == "no_gap":
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
    if not np.isfinite(diagnosis.ceiling):
        return closed
    ceiling = Message(
        "gap.ceiling",
        "The most that any model closed, physical or not: {percent:.0f}\u00a0%.",
        percent=100.0 * diagnosis.ceiling,
    )
    return sentences(closed, ceiling)


def _overlays(diagnosis: Diagnosis) -> tuple[SignalOverlay, ...]:
    """Return every signal, the one with the largest gap first; none if every sample was fitted."""
    if diagnosis.where.regions.channel not in diagnosis.dataset.channels:
        return ()
    try:
        return overlays_of(diagnosis)
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
    content = stored_content(folder, key)
    if content is not None and not content.keys() >= _KEYS:
        raise _unreadable(answer_path(folder, key))
    return content


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
        document = json.loads(path.read_text(encoding="utf-8")) if usable else None
        content, digest = (
            (document.get("content"), document.get("sha256")) if isinstance(document, dict) else (None, None)
        )
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
