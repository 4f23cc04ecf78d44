"""What a diagnosis states: one headline, level and list of candidates for the window, the report and the shell."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from tissueid.gap.diagnosis import Diagnosis, Ranked, parameters_of
from tissueid.twin.catalogue import all_effects
from tissueid.twin.effect import STAGE_NAMES, STAGES
from tissueid.wording import fixed, number

Level = Literal["good", "check", "poor"]
Translate = Callable[[str], str]

STAGE_WORDS = {stage: f"the {name}" for stage, name in STAGE_NAMES.items()}
"""The stages as they stand in a sentence."""
CLOSE = 0.5
"""A rival is close when its probability is at least this share of the named effect's."""
LIKELY = 0.5
"""Below this probability an effect is named with reservation."""
MOST_RIVALS = 3
"""Close rivals named in a headline."""
_DIRECTIONS = {"into": "while the probe goes in", "out": "while the probe comes out", "both": "in both directions"}


@dataclass(frozen=True)
class Member:
    """A named effect with its probability (NaN where unknown), and its close rivals with theirs, likeliest first."""

    effect: str
    probability: float
    rivals: tuple[tuple[str, float], ...]

    @property
    def doubtful(self) -> bool:
        """Whether the effect is named with reservation."""
        return bool(self.rivals) or self.probability < LIKELY


def effect_words(name: str) -> str:
    """Return the title of an effect as it stands in a sentence."""
    known = all_effects().get(name)
    return name.replace("_", " ") if known is None else known.title[:1].lower() + known.title[1:]


def members_of(found: Diagnosis) -> tuple[Member, ...]:
    """Return the named effects with their odds; none where nothing is named."""
    ranked = tuple((item.effect, item.probability) for item in found.ranking)
    members = []
    for name in found.combination:
        odds = found.beside.get(name, ranked)
        own = dict(odds).get(name, float("nan"))
        rivals = [
            (other, share)
            for other, share in odds
            if other not in found.combination and share >= max(CLOSE * own, 0.01)
        ]
        members.append(Member(name, own, tuple(rivals[:MOST_RIVALS])))
    return tuple(members)


def listed(found: Diagnosis) -> tuple[Ranked, ...]:
    """Return the candidates in the order in which they are shown.

    The named effects come first. Where nothing is named the order is by what each candidate closes. Where there is no
    gap there is nothing to explain, and no candidate is shown.
    """
    if found.verdict == "no_gap":
        return ()
    if not found.combination:
        return tuple(sorted(found.ranking, key=lambda item: -item.closed if np.isfinite(item.closed) else np.inf))
    ranking = {item.effect: item for item in found.ranking}
    first = [
        replace(ranking[member.effect], probability=member.probability)
        if member.effect in ranking
        else _unranked(found, member)
        for member in members_of(found)
    ]
    return (*first, *(item for item in found.ranking if item.effect not in found.combination))


def _unranked(found: Diagnosis, member: Member) -> Ranked:
    # A second effect need not be among the single candidates: what it closes alone is not known.
    nothing = float("nan")
    fitted = found.best is not None and member.effect in found.best.effects
    values = parameters_of(found.best, member.effect) if fitted and found.best is not None else {}
    stage = all_effects()[member.effect].stage
    return Ranked(member.effect, stage, member.probability, nothing, (nothing, nothing), (), values)


def headline_of(found: Diagnosis, say: Translate = str) -> tuple[str, Level]:
    """Return the verdict in a line, with the odds of what is named, and its level.

    Args:
        found: the diagnosis.
        say: translates a template or the title of an effect.
    """
    if found.verdict == "no_gap":
        return say("No gap: the twin explains this recording down to its noise"), "good"
    if found.verdict == "unexplained":
        if not found.at_fault:
            return say("There is a gap that no known effect explains; no single stage shows it"), "check"
        stage = say(STAGE_WORDS[found.at_fault[0]])
        words = say("There is a gap that no known effect explains; it arises in {stage}")
        return words.format(stage=stage), "check"
    members = members_of(found)
    doubtful = any(member.doubtful for member in members)
    causes = "; ".join(_with_odds(member, say, alone=judged_alone(found, member.effect)) for member in members)
    words = "The gap is probably explained: {causes}" if doubtful else "The gap is explained: {causes}"
    return say(words).format(causes=causes), "check" if doubtful else "good"


def judged_alone(found: Diagnosis, name: str) -> bool:
    """Return whether a named effect of a combination has the odds of the ranking of single effects."""
    return len(found.combination) > 1 and name in found.combination and name not in found.beside


def _with_odds(member: Member, say: Translate, *, alone: bool) -> str:
    words = []
    for name, share in ((member.effect, member.probability), *member.rivals):
        odds = f"{percent(share)} %"
        if alone and name == member.effect:
            odds = say("{share} % as a single cause").format(share=percent(share))
        title = say(effect_words(name))
        words.append(f"{title} ({odds})" if np.isfinite(share) else title)
    return say(" or ").join(words)


def percent(share: float) -> str:
    """Return a probability in percent; what rounds to 0 or 100 as a bound."""
    return "< 1" if share < 0.005 else "> 99" if share >= 0.995 else fixed(100.0 * share, 0)


def sentences_of(found: Diagnosis) -> Iterator[str]:
    """Yield where the gap lies, and what the cause cannot be told from."""
    if found.verdict == "no_gap":
        return
    yield from _stage_sentences(found)
    yield from _region_sentences(found)
    alike = _alike(found)
    if alike:
        names = ", ".join(effect_words(name) for name in alike)
        yield f"This data cannot tell it from: {names}."
    if found.verdict == "unexplained" and found.ranking:
        best = listed(found)[0]
        yield f"The best attempt, {effect_words(best.effect)}, closes {_share(best.closed)} and does not explain it."


def _stage_sentences(found: Diagnosis) -> Iterator[str]:
    where = found.where
    if len(found.at_fault) > 1:
        stages = _listed([STAGE_WORDS[stage] for stage in found.at_fault])
        yield f"It arises in {stages}, where the causes belong."
    elif found.at_fault and where.above_floor:
        stage = found.at_fault[0]
        suspected = max(STAGES, key=where.shares.__getitem__)
        if where.shares[stage] >= where.shares[suspected]:
            share = fixed(100.0 * where.shares[stage], 0)
            yield f"It arises in {STAGE_WORDS[stage]}: {share} % of what noise does not explain."
        else:
            yield (
                f"It arises in {STAGE_WORDS[stage]}, where the cause belongs. The stages alone would have "
                f"suspected {STAGE_WORDS[suspected]}: what the cause leaves looks like a fault there."
            )


def _region_sentences(found: Diagnosis) -> Iterator[str]:
    regions = found.where.regions
    told = []
    if regions.bands_hz:
        told.append("from " + _spans(regions.bands_hz, 1.0, "Hz"))
    if regions.depth_m:
        told.append("at depths of " + _spans(regions.depth_m, 1e3, "mm"))
    if regions.current_a:
        told.append("at currents of " + _spans(regions.current_a, 1.0, "A"))
    if regions.amplitude_n:
        told.append("at an amplitude (of the stimulus over the last 0.1 s) of " + _spans(regions.amplitude_n, 1.0, "N"))
    if regions.mains_phase_rad:
        told.append(
            f"at phases of the mains ({number(regions.mains_hz, 3)} Hz) of "
            + _spans(regions.mains_phase_rad, 180.0 / np.pi, "degrees")
        )
    if told:
        words = _listed(told)
        yield f"It shows most in the {regions.channel}, {words}, {_DIRECTIONS[regions.direction]}."


def next_steps_of(found: Diagnosis, file: Path | None = None) -> Iterator[str]:
    """Yield what to do now, a sentence each; with what to type at a shell where the session's file is given."""
    if found.verdict == "no_gap":
        yield "Nothing needs to be done: the twin may be used as it is."
        return
    known = all_effects()
    for name in found.combination:
        if name in known and known[name].remedy:
            yield known[name].remedy
    if found.next_experiment is not None:
        step = found.next_experiment
        separates = " from ".join(effect_words(name) for name in step.separates[:2])
        words = f", which tells {separates}" if len(step.separates) > 1 else ""
        yield f"Play a test of the kind “{step.kind.replace('_', ' ')}”{words}: {step.why.rstrip('.')}."
    if found.verdict == "effect":
        named = "Add the effect to a named twin, so that simulation and later diagnoses have it"
        quoted = "" if file is None else shlex.quote(str(file))
        yield f"{named}: tissueid gap accept {quoted} --out TWIN.toml" if quoted else f"{named}."
    elif found.next_experiment is None and found.at_fault:
        yield f"Look at {STAGE_WORDS[found.at_fault[0]]}: the cause is there, and none of the known effects fits it."


def _listed(parts: list[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def _alike(found: Diagnosis) -> tuple[str, ...]:
    named = [item for item in found.ranking if item.effect in found.combination]
    return tuple(dict.fromkeys(name for item in named for name in item.indistinguishable))


def _spans(intervals: tuple[tuple[float, float], ...], scale: float, unit: str) -> str:
    return _listed([f"{number(scale * low, 2)} to {number(scale * high, 2)} {unit}" for low, high in intervals])


def _share(share: float) -> str:
    return "nothing that can be told" if not np.isfinite(share) else f"{fixed(100.0 * share, 0)} %"
