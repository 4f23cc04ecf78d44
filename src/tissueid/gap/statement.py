"""The text of a diagnosis: headline, level, candidates, sentences and next steps for window, report and shell."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tissueid.formatting import fixed, number, with_unit
from tissueid.gap.diagnosis import DetectionLimit, Diagnosis, Ranked, parameters_of
from tissueid.gap.next_experiment import KINDS
from tissueid.language import marked
from tissueid.messages import Listing, Message, Verbatim, sentences
from tissueid.twin.catalogue import all_effects
from tissueid.twin.effect import STAGE_NAMES, STAGES, Stage
from tissueid.units import unit_for

Level = Literal["good", "check", "poor"]

CLOSE = 0.5
"""Least probability of a close rival, as a share of the named effect's probability."""
LIKELY = 0.5
"""Probability below which an effect is named with reservation."""
MOST_RIVALS = 3
"""Most close rivals named in a headline."""
_DIRECTIONS = {
    "into": marked("while the probe goes in"),
    "out": marked("while the probe comes out"),
    "both": marked("in both directions"),
}
_AND = marked(" and ")


@dataclass(frozen=True)
class Member:
    """A named effect with its probability (NaN where unknown), and its close rivals, most probable first."""

    effect: str
    probability: float
    rivals: tuple[tuple[str, float], ...]

    @property
    def doubtful(self) -> bool:
        """Whether the effect is named with reservation."""
        return bool(self.rivals) or self.probability < LIKELY


def effect_title(name: str) -> str:
    """Return the title of an effect; its name in plain words where the library has no such effect."""
    effect = all_effects().get(name)
    return name.replace("_", " ") if effect is None else effect.title


def members_of(diagnosis: Diagnosis) -> tuple[Member, ...]:
    """Return the named effects with their probabilities; none where nothing is named."""
    ranked = tuple((item.effect, item.probability) for item in diagnosis.ranking)
    members = []
    for name in diagnosis.combination:
        odds = diagnosis.conditional_odds.get(name, ranked)
        own = dict(odds).get(name, float("nan"))
        rivals = [
            (other, share)
            for other, share in odds
            if other not in diagnosis.combination and share >= max(CLOSE * own, 0.01)
        ]
        members.append(Member(name, own, tuple(rivals[:MOST_RIVALS])))
    return tuple(members)


def alternatives_of(diagnosis: Diagnosis) -> dict[str, tuple[str, ...]]:
    """Return for each named effect those that can stand in its place: close rivals, and effects that this data cannot
    separate from it."""
    alike = {item.effect: item.indistinguishable for item in diagnosis.ranking}
    return {
        member.effect: tuple(
            dict.fromkeys(
                name
                for name in (*(rival for rival, _ in member.rivals), *alike.get(member.effect, ()))
                if name not in diagnosis.combination
            )
        )
        for member in members_of(diagnosis)
    }


def ordered_candidates(diagnosis: Diagnosis) -> tuple[Ranked, ...]:
    """Return the candidates in the order of display.

    Named effects come first. Without a named effect the order is by closed share. Without a gap there are no
    candidates.
    """
    if diagnosis.verdict == "no_gap":
        return ()
    if not diagnosis.combination:
        return tuple(sorted(diagnosis.ranking, key=lambda item: -item.closed if np.isfinite(item.closed) else np.inf))
    ranking = {item.effect: item for item in diagnosis.ranking}
    first = [
        replace(ranking[member.effect], probability=member.probability)
        if member.effect in ranking
        else _unranked(diagnosis, member)
        for member in members_of(diagnosis)
    ]
    return (*first, *(item for item in diagnosis.ranking if item.effect not in diagnosis.combination))


def _unranked(diagnosis: Diagnosis, member: Member) -> Ranked:
    # A second effect can be missing among the single candidates: its closed share alone is unknown.
    nothing = float("nan")
    fitted = diagnosis.best is not None and member.effect in diagnosis.best.effects
    values = parameters_of(diagnosis.best, member.effect) if fitted and diagnosis.best is not None else {}
    stage = all_effects()[member.effect].stage
    return Ranked(member.effect, stage, member.probability, nothing, (nothing, nothing), (), values)


def headline_of(diagnosis: Diagnosis) -> tuple[Message, Level]:
    """Return the verdict in one line, with what each named effect closes and its probability, and its level."""
    if diagnosis.verdict == "no_gap":
        return Message("gap.none", "No gap: the twin explains this recording down to its noise"), "good"
    if diagnosis.verdict == "unexplained":
        if not diagnosis.at_fault:
            return (
                Message(
                    "gap.unexplained_nowhere", "There is a gap that no known effect explains; no single stage shows it"
                ),
                "check",
            )
        return (
            Message(
                "gap.unexplained",
                "There is a gap that no known effect explains; it arises in the stage: {stage}",
                stage=STAGE_NAMES[diagnosis.at_fault[0]],
            ),
            "check",
        )
    members = members_of(diagnosis)
    causes = Listing(tuple(_with_rivals(diagnosis, member) for member in members), "; ", "; ")
    if any(member.doubtful for member in members):
        return Message("gap.probably_explained", "The gap is probably explained: {causes}", causes=causes), "check"
    return Message("gap.explained", "The gap is explained: {causes}", causes=causes), "good"


def shown_probability(diagnosis: Diagnosis, name: str, probability: float) -> float:
    """Return the probability of a candidate as a reader can use it, NaN where there is none.

    The ranking gives the probability of an effect as the only cause. Of a member of a combination that says nothing:
    an effect that closes most of the gap has a small one if it needs a second effect.
    """
    of_single_cause = (
        len(diagnosis.combination) > 1 and name in diagnosis.combination and name not in diagnosis.conditional_odds
    )
    return float("nan") if of_single_cause else probability


def _with_rivals(diagnosis: Diagnosis, member: Member) -> Message:
    names = [described(diagnosis, name, share) for name, share in ((member.effect, member.probability), *member.rivals)]
    return Message("gap.cause", "{names}", names=Listing(tuple(names), marked(" or "), marked(" or ")))


def described(diagnosis: Diagnosis, name: str, probability: float) -> str:
    """Return the title of an effect with the share of the gap that it closes and its probability, if they are known.

    The shares of the members of a combination are those of the budget, in the order of adding: they sum to the whole.
    A rival of the only cause has its own.
    """
    if name in diagnosis.combination and diagnosis.budget is not None:
        closed = next((step.added for step in diagnosis.budget.steps if step.effect == name), float("nan"))
    elif len(diagnosis.combination) == 1:
        closed = next((item.closed for item in diagnosis.ranking if item.effect == name), float("nan"))
    else:
        closed = float("nan")
    probability = shown_probability(diagnosis, name, probability)
    title = effect_title(name)
    share, odds = fixed(100.0 * closed, 0), percent(probability)
    if np.isfinite(closed) and np.isfinite(probability):
        return Message(
            "gap.cause_both",
            "{effect} (closes {share} %; probability {percent} %)",
            effect=title,
            share=share,
            percent=odds,
        )
    if np.isfinite(closed):
        return Message("gap.cause_share", "{effect} (closes {share} %)", effect=title, share=share)
    if np.isfinite(probability):
        return Message("gap.cause_probability", "{effect} (probability {percent} %)", effect=title, percent=odds)
    return title


def percent(share: float) -> str:
    """Return a probability in percent; one that rounds to 0 or 100 as a bound."""
    return "< 1" if share < 0.005 else "> 99" if share >= 0.995 else fixed(100.0 * share, 0)


def sentences_of(diagnosis: Diagnosis) -> Iterator[Message]:
    """Yield the stage and the regions of the gap, and the effects that the data cannot separate from the cause.

    Without a gap, yield what would have been visible.
    """
    if diagnosis.verdict == "no_gap":
        limits = _examples_of_limits(diagnosis)
        if limits:
            yield Message(
                "gap.detection_limits", "Would have been visible: {limits}.", limits=Listing(limits, "; ", "; ")
            )
        return
    yield from _stage_sentences(diagnosis)
    yield from _region_sentences(diagnosis)
    named = [item for item in diagnosis.ranking if item.effect in diagnosis.combination]
    if alike := dict.fromkeys(name for item in named for name in item.indistinguishable):
        names = Listing(tuple(effect_title(name) for name in alike))
        yield Message("gap.alike", "This data cannot separate the cause from: {names}.", names=names)
    if diagnosis.verdict == "unexplained" and diagnosis.ranking:
        best = ordered_candidates(diagnosis)[0]
        yield Message(
            "gap.best_attempt",
            "The best candidate, {effect}, closes {share} of the gap and does not explain it.",
            effect=effect_title(best.effect),
            share=_share(best.closed),
        )


def limit_text(name: str, limit: DetectionLimit) -> Message:
    """Return from which size an effect would have been named."""
    size = size_of(limit)
    if limit.below:
        return Message("gap.limit_below", "{effect} below {size}", effect=effect_title(name), size=size)
    return Message("gap.limit_above", "{effect} above {size}", effect=effect_title(name), size=size)


def size_of(limit: DetectionLimit) -> str:
    """Return a size with its unit."""
    unit, scale = unit_for("" if limit.unit == "1" else limit.unit, limit.value)
    return with_unit(number(scale * limit.value, 2), unit)


def _examples_of_limits(diagnosis: Diagnosis) -> tuple[Message, ...]:
    # One effect of each stage.
    limits = {name: limit for name, limit in diagnosis.detection_limits.items() if limit is not None}
    examples = {all_effects()[name].stage: name for name in limits}
    return tuple(limit_text(name, limits[name]) for name in examples.values())


def _stage_sentences(diagnosis: Diagnosis) -> Iterator[Message]:
    where = diagnosis.where
    if len(diagnosis.at_fault) > 1:
        stages = Listing(tuple(STAGE_NAMES[stage] for stage in diagnosis.at_fault), _AND)
        yield Message(
            "gap.stages", "The gap arises in these stages, to which the causes belong: {stages}.", stages=stages
        )
    elif diagnosis.at_fault and where.above_floor:
        stage = diagnosis.at_fault[0]
        suspected: Stage = max(STAGES, key=where.shares.__getitem__)
        if where.shares[stage] >= where.shares[suspected]:
            yield Message(
                "gap.stage",
                "The gap arises in the stage: {stage}, with {percent:.0f} % of what noise does not explain.",
                stage=STAGE_NAMES[stage],
                percent=100.0 * where.shares[stage],
            )
        else:
            yield Message(
                "gap.stage_of_cause",
                "The gap arises in the stage: {stage}, to which the cause belongs. Without the cause, the stage "
                "analysis suggests: {other}. The residual that the cause leaves looks like a fault there.",
                stage=STAGE_NAMES[stage],
                other=STAGE_NAMES[suspected],
            )


_REGIONS: Mapping[str, tuple[Message, float, str]] = {
    "bands_hz": (Message("gap.at_frequencies", "from {spans}"), 1.0, "Hz"),
    "depth_m": (Message("gap.at_depths", "at depths of {spans}"), 1e3, "mm"),
    "current_a": (Message("gap.at_currents", "at currents of {spans}"), 1.0, "A"),
    "amplitude_n": (
        Message("gap.at_amplitudes", "at an amplitude (of the stimulus over the last 0.1 s) of {spans}"),
        1.0,
        "N",
    ),
    "mains_phase_rad": (
        Message("gap.at_mains_phases", "at phases of the mains ({hertz} Hz) of {spans}"),
        180.0 / np.pi,
        marked("degrees"),
    ),
}
"""Region: its text, factor from SI to its unit, and unit."""


def _region_sentences(diagnosis: Diagnosis) -> Iterator[Message]:
    regions, where = diagnosis.where.regions, []
    for name, (text, scale, unit) in _REGIONS.items():
        if intervals := regions.above[name]:
            mains = {"hertz": number(regions.mains_hz, 3)} if name == "mains_phase_rad" else {}
            where.append(Message(text.code, text.template, spans=_spans(intervals, scale, unit), **mains))
    if where:
        yield Message(
            "gap.shows_most",
            "It shows most in the {channel}, {where}, {direction}.",
            channel=regions.channel,
            where=Listing(tuple(where), _AND),
            direction=_DIRECTIONS[regions.direction],
        )


def next_steps_of(diagnosis: Diagnosis, file: Path | None = None) -> Iterator[str]:
    """Yield what to do next, one text each; with the shell's command where the session's file is given."""
    if diagnosis.verdict == "no_gap":
        yield Message("gap.nothing_to_do", "Nothing needs to be done: the twin can be used as it is.")
        return
    library = all_effects()
    for name in diagnosis.combination:
        if name in library and library[name].remedy:
            yield library[name].remedy
    if diagnosis.next_experiment is not None:
        yield _next_test(
            diagnosis.next_experiment.kind, diagnosis.next_experiment.separates, diagnosis.next_experiment.why
        )
    if diagnosis.verdict == "effect":
        if file is None:
            yield Message(
                "gap.accept", "Add the effect to a named twin, so that simulation and later diagnoses include it."
            )
        else:
            yield Message(
                "gap.accept_file",
                "Add the effect to a named twin, so that simulation and later diagnoses include it: {command}",
                command=f"tissueid gap accept {shlex.quote(str(file))} --out TWIN.toml",
            )
    elif diagnosis.next_experiment is None and diagnosis.at_fault:
        yield Message(
            "gap.look_at_stage",
            "Check the stage: {stage}. The cause is there, and none of the known effects fits it.",
            stage=STAGE_NAMES[diagnosis.at_fault[0]],
        )


def _next_test(kind: str, separates: Sequence[str], why: str) -> Message:
    named = KINDS.get(kind, kind.replace("_", " "))
    if len(separates) < 2:
        return sentences(Message("gap.run_test", "Run a test of the kind “{kind}”.", kind=named), why)
    first, second = map(effect_title, separates[:2])
    return sentences(
        Message(
            "gap.run_separating_test",
            "Run a test of the kind “{kind}”, which separates these causes: {cause}; {rival}.",
            kind=named,
            cause=first,
            rival=second,
        ),
        why,
    )


def _spans(intervals: tuple[tuple[float, float], ...], scale: float, unit: str) -> Listing:
    ends = [(number(scale * low, 2), number(scale * high, 2)) for low, high in intervals]
    items = (Message("gap.interval", "{low} to {high} {unit}", low=low, high=high, unit=unit) for low, high in ends)
    return Listing(tuple(items), _AND)


def _share(share: float) -> str:
    if not np.isfinite(share):
        return marked("an unknown share")
    return Message("gap.share", "{percent:.0f} %", percent=100.0 * share)


@dataclass(frozen=True)
class GapHistoryEntry:
    """One session: its file, its time of recording (ISO 8601; "" where unknown) and its diagnosis.

    ``answer`` is the JSON of ``gap diagnose`` against the twin; None where the session cannot be used, for the
    ``reason``.
    """

    file: str
    created: str
    answer: dict[str, Any] | None
    reason: str = ""

    @property
    def grew(self) -> bool:
        """Whether there is a gap against the twin: more than noise and what the twin is known to leave."""
        return self.answer is not None and self.answer["verdict"] != "no_gap"

    @property
    def combination(self) -> tuple[str, ...]:
        """Named new effects."""
        return () if self.answer is None else tuple(self.answer["combination"])

    @property
    def time(self) -> datetime | None:
        """Time of recording, UTC; None where it is unknown."""
        try:
            parsed = datetime.fromisoformat(self.created)
        except ValueError:
            return None
        return parsed.astimezone(UTC) if parsed.tzinfo is not None else parsed.replace(tzinfo=UTC)

    def gap(self, name: str) -> float:
        """Return a figure of the gap, such as ``before``; NaN where there is none."""
        value = None if self.answer is None else self.answer["gap"][name]
        return float("nan") if value is None else float(value)

    def as_answer(self) -> dict[str, Any]:
        """Return plain values for JSON, SI."""
        if self.answer is None:
            reason = self.reason.as_dict() if isinstance(self.reason, Message) else None
            return {"file": self.file, "created": self.created, "verdict": None, "gap": None, "combination": []} | {
                "error": str(self.reason),
                "message": reason,
            }
        return {"file": self.file, "created": self.created, "grew": self.grew} | self.answer


@dataclass(frozen=True)
class GapHistory:
    """Sessions in order of time; those without a time come last, by name."""

    entries: tuple[GapHistoryEntry, ...]

    @classmethod
    def of(cls, entries: Sequence[GapHistoryEntry]) -> GapHistory:
        """Return the history of sessions in any order."""
        last = datetime.max.replace(tzinfo=UTC)
        return cls(tuple(sorted(entries, key=lambda entry: (entry.time or last, entry.file))))

    @property
    def first_grown(self) -> GapHistoryEntry | None:
        """The first session in which the gap grew; None where it grew in none."""
        return next((entry for entry in self.entries if entry.grew), None)

    def as_answer(self) -> dict[str, Any]:
        """Return the JSON of ``tissueid gap watch``."""
        first = self.first_grown
        return {
            "sessions": [entry.as_answer() for entry in self.entries],
            "first_grown": None if first is None else first.file,
            "grown_effects": [] if first is None else list(first.combination),
        }


def history_headline(history: GapHistory) -> tuple[Message, Level]:
    """Return the first session in which the gap grew, and what grew, in one line, with its level."""
    first = history.first_grown
    if first is None:
        count = sum(entry.answer is not None for entry in history.entries)
        return Message("watch.not_grown", "The gap grew in none of {count} sessions", count=count), "good"
    causes: tuple[str, ...] = tuple(effect_title(name) for name in first.combination) or (marked("cause unexplained"),)
    cause = Listing(causes, marked(" and "))
    return Message(
        "watch.grown", "The gap grew first in {file}: {cause}", file=Verbatim(first.file), cause=cause
    ), "check"
