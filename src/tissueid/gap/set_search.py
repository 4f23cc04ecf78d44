"""Search for the set of effects that explains a gap: single effects, those of tissue, forward-backward selection."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from tissueid.gap.decision import THRESHOLDS, Tried, contributes, cost, grows
from tissueid.gap.scoring import Candidate, closed, floor, gap, misfit, quiet_tests
from tissueid.gap.search import Search, SearchResult
from tissueid.twin.catalogue import effect
from tissueid.twin.effect import nested

Keep = Callable[[Sequence[Candidate]], Sequence[Candidate]]
TOP_CANDIDATES = 2
"""Number of top single effects that are tried with a second effect."""
MOST_MEMBERS = 6
"""Most effects of a set, in addition to those of the baseline."""
REPLACED = 2
"""Members of a set that are replaced by others, those whose removal costs least."""
LARGE_REMAINDER = 1.0
"""Score from which a set is completed with the effects of tissue that it lacks, nats."""


def search_sets(search: Search, baseline: Candidate) -> tuple[SearchResult, Candidate | None]:
    """Return everything that was fitted, and the best set of effects; None where no effect applies."""
    found = search.singles(baseline)
    best = min(found.candidates, key=cost, default=None)
    if best is None:
        return found, None
    together: tuple[Candidate, ...] = ()
    if not _settled(baseline, best):
        together = search.tissue_set(baseline)
        if together and _closed(baseline, together[0]) < THRESHOLDS.structural:
            # An effect of the instrument can conceal those of the tissue.
            together = (min((*together, *search.tissue_set(_leaders(found)[0])), key=misfit),)
        together = tuple(search.tissue_set_again(baseline, item) for item in together)
        if not together or not grows(_leaders(found)[0], together[0]):
            found = search.further(found)
            best = min(found.candidates, key=cost)
    return _with_sets(search, found, best, together)


def added(found: Candidate, baseline: Candidate) -> list[str]:
    """Return the effects of a candidate that the baseline does not have."""
    return [name for name in found.effects if name not in baseline.effects]


def tried(baseline: Candidate, item: Candidate, strict: bool = False) -> Tried:
    """Return a fitted set as the decision needs it."""
    return Tried(tuple(added(item, baseline)), item.score, cost(item), _closed(baseline, item), strict)


def _closed(baseline: Candidate, item: Candidate) -> float:
    # What an effect leaves however well it is known, such as rounding, counts as closed.
    quiet = quiet_tests(baseline.fit.parameters.dataset.tests)
    least = floor(baseline.chosen_by, quiet)
    own = floor(item.chosen_by, quiet) ** 2 - least**2
    after = math.sqrt(max(gap(item.chosen_by, quiet) ** 2 - own, 0.0))
    return closed(gap(baseline.chosen_by, quiet), after, least)


def _settled(baseline: Candidate, best: Candidate) -> bool:
    # The residual does not justify a longer search. Against a twin, whose effects are accepted, one new effect is
    # expected, and what it leaves is its structural error.
    enough = THRESHOLDS.structural if baseline.effects else THRESHOLDS.nearly_all
    return best.score <= THRESHOLDS.at_the_floor or _closed(baseline, best) >= enough


def _with_sets(
    search: Search, found: SearchResult, best: Candidate, together: Sequence[Candidate]
) -> tuple[SearchResult, Candidate]:
    """Find a set of effects that is better than the best single one, by forward-backward selection.

    It starts from the effects of the tissue ``together`` or from the best single effect, whichever leaves less.
    """
    baseline = found.baseline
    if cost(best) <= THRESHOLDS.set_gain or (baseline.effects and _settled(baseline, best)):
        return found, best
    fitted: dict[frozenset[str], Candidate] = {frozenset(item.effects): item for item in found.candidates}

    def keep(items: Sequence[Candidate]) -> Sequence[Candidate]:
        for item in items:
            held = fitted.get(frozenset(item.effects))
            if held is None or misfit(item) < misfit(held):
                fitted[frozenset(item.effects)] = item
        return items

    leaders = _leaders(found)
    for item in keep(together):
        if grows(leaders[0], item):
            leaders = [_without_needless(search, baseline, item, keep)]
    for again in (False, True):
        top = _grown(search, baseline, leaders, keep)
        if again or len(added(top, baseline)) < 2 or _closed(baseline, top) >= THRESHOLDS.structural:
            break
        # A member can be wrong, most likely one whose removal costs little: try others in its place.
        smaller = sorted(keep(search.remove_from(top, added(top, baseline))), key=cost)[:REPLACED]
        other = min(keep(search.replace_in(top, smaller)), key=misfit, default=None)
        if other is None or not grows(top, other):
            break
        leaders = [search.nested_with(baseline, other)]
    while len(added(top, baseline)) > 1:
        (polished,) = keep([search.polish(baseline, top)])
        gained, top = misfit(top) - misfit(polished), polished
        if gained < THRESHOLDS.set_gain:
            break
        # At another minimum others can show.
        larger = _grown(search, baseline, [top], keep)
        if set(larger.effects) == set(top.effects):
            break
        top = larger
    if len(names := added(top, baseline)) > 1:
        # The decision compares the set with those without each member.
        keep(search.remove_from(top, names))
        best = top
    return SearchResult(baseline, found.signatures, tuple(sorted(fitted.values(), key=cost))), best


def _grown(search: Search, baseline: Candidate, leaders: Sequence[Candidate], keep: Keep) -> Candidate:
    # Add to the leaders while the misfit falls and more is left than a needed member must gain, then remove what is not
    # needed.
    top = leaders[0]
    while len(added(top, baseline)) < MOST_MEMBERS and top.score > THRESHOLDS.set_gain:
        grown = min(keep(search.add_to(leaders)), key=misfit, default=None)
        if grown is None or not grows(top, grown):
            break
        top = _with_all_of_tissue(search, baseline, search.nested_with(baseline, grown), keep)
        leaders = [top]
    return _without_needless(search, baseline, top, keep)


def _with_all_of_tissue(search: Search, baseline: Candidate, top: Candidate, keep: Keep) -> Candidate:
    # A set with some effects of tissue can conceal the others, as single effects do: fit them all together with the
    # other members.
    in_tissue = [name for name in added(top, baseline) if effect(name).in_living_tissue]
    if not in_tissue or len(in_tissue) == len(added(top, baseline)) or top.score <= LARGE_REMAINDER:
        return top
    whole = min(keep([search.tissue_set_again(top, item) for item in search.tissue_set(top)]), key=misfit, default=top)
    return _without_needless(search, baseline, whole, keep) if grows(top, whole) else top


def _without_needless(search: Search, baseline: Candidate, top: Candidate, keep: Keep) -> Candidate:
    # Remove all members that contribute nothing, then one at a time the least needed.
    while len(added(top, baseline)) > 1:
        names = search.perhaps_needless(top, added(top, baseline))
        smaller = keep(search.remove_from(top, names, briefly=True))
        idle = [name for name, without in zip(names, smaller, strict=True) if not grows(without, top)]
        if len(idle) > 1:
            without = keep(search.remove_all_from(top, idle))[0]
            if not grows(without, top):
                top = without
                continue
        least = min(smaller, key=cost, default=None)
        if least is None or contributes(tried(baseline, least), tried(baseline, top)):
            break
        top = least
    return top


def _leaders(found: SearchResult) -> list[Candidate]:
    # Of nested effects only the better one: both have the same partners, and nested effects of a set are tried later.
    leaders: list[Candidate] = []
    for item in (min(found.candidates, key=misfit), *sorted(found.candidates, key=cost)):
        if all(
            item is not other and not nested(effect(item.effects[-1]), effect(other.effects[-1])) for other in leaders
        ):
            leaders.append(item)
    return leaders[:TOP_CANDIDATES]
