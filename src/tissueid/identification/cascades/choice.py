"""Which block structure a record speaks for, and whether any of them says all that the input does.

Every structure is judged by the error of its free run on samples that it was not fitted to: the record is cut into a
few stretches, and each is simulated by the structure as fitted to the others. Two structures meet on the same samples,
so what is tested is the mean difference of their squared errors, with the dependence of neighbours carried along. A
structure is only called by its name when nothing is left in its error that its own signals explain: a system that is
none of them is still fitted best by one of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tissueid.identification.base import Array
from tissueid.identification.cascades.blocks import (
    INSIDE,
    STRUCTURES,
    Blocks,
    CascadeData,
    Structure,
    run,
)
from tissueid.identification.cascades.fit import fit_linear
from tissueid.identification.cascades.refinement import Fitted, refine
from tissueid.identification.cascades.remainder import unexplained
from tissueid.identification.dependence import dependence_samples, long_run_covariance
from tissueid.identification.validation import aicc

NAMES: Mapping[Structure, str] = {
    "linear": "a linear system",
    "wiener": "a Wiener system",
    "hammerstein": "a Hammerstein system",
    "lnl": "an LNL system",
    "nln": "an NLN system",
}
"""What each structure is called where a person reads."""

_ORDERS: Mapping[Structure, str] = {
    "linear": "one kernel",
    "wiener": "linear dynamics and then a static curve",
    "hammerstein": "a static curve and then linear dynamics",
    "lnl": "a static curve between linear dynamics",
    "nln": "linear dynamics between static curves",
}

_FOLDS = 4
_FOLD_STEPS, _FOLD_SETTLED = 8, 1e-5

_CLEAR = 2.33
"""Standard errors by which one structure must lead another: chance does it one time in a hundred."""

_WORTH = 2e-4
"""Share of the output's variance that a lead must be worth beside: curves of finite degree differ by less."""

_FAR = 2.0
"""How many times the best one's squared error sets a structure apart, however widely its errors are spread."""

_LEAST_PERCENT = 10.0
"""VAF on samples it was not fitted to that a structure must reach for its name to mean anything."""

_CHANCE = 0.01
"""Chance at which the error of the right structure is taken to hold more than noise."""


@dataclass(frozen=True)
class Candidate:
    """One structure: VAF of its free run on samples it was not fitted to, and how it compares with the best.

    ``behind`` is by how many standard errors the mean squared error exceeds that of the best structure, and
    ``lost_percent`` by how much of the output's variance; ``alike`` says that this is not enough to tell the two apart.
    ``unexplained_percent`` is how much of its error products of its own signals explain, ``unexplained_p_value`` the
    chance that they explain as much of noise; None where not alike.
    """

    structure: Structure
    vaf_held_out_percent: float
    aicc: float
    behind: float
    lost_percent: float
    alike: bool
    unexplained_percent: float | None = None
    unexplained_p_value: float | None = None

    @property
    def complete(self) -> bool:
        """True when nothing to speak of is left in its error that its own signals explain."""
        if self.unexplained_p_value is None or self.unexplained_percent is None:
            return False
        worth = self.unexplained_percent * (1.0 - 0.01 * self.vaf_held_out_percent)
        return self.unexplained_p_value > _CHANCE or worth < 100.0 * _WORTH


@dataclass(frozen=True)
class Choice:
    """The structure chosen among those that were tried, and what can be said of it.

    ``alike`` are the structures that the record does not tell apart: as good as the best, and with nothing left in
    their errors; the chosen one is the simplest of them. When there is none, the best is chosen, and is not what the
    system is: ``complete`` is False. ``told`` is True when no other of the same rank is alike, the chosen one beats
    those that it holds as special cases, by AICc too, and it explains something at all.
    """

    structure: Structure
    candidates: tuple[Candidate, ...]
    alike: tuple[Structure, ...]
    told: bool
    complete: bool

    @property
    def chosen(self) -> Candidate:
        """The chosen structure's figures."""
        return next(one for one in self.candidates if one.structure == self.structure)

    @property
    def confident(self) -> bool:
        """True when the record may be called by the name of the chosen structure."""
        return self.told and self.complete


def choose(found: Mapping[Structure, Fitted], data: CascadeData) -> Choice:
    """Compare fitted structures on samples that they were not fitted to.

    Args:
        found: the structures, each fitted to all rows of the data.
        data: the record.
    """
    folds = np.array_split(np.arange(data.rows.size), _FOLDS)
    refitted = {structure: _refitted(fitted, data, folds) for structure, fitted in found.items()}
    errors = {structure: _held_out_errors(parts, data, folds) for structure, parts in refitted.items()}
    variance = float(np.var(data.measured))
    sizes = {structure: float(np.mean(error**2)) for structure, error in errors.items()}
    best = min(sizes, key=lambda structure: sizes[structure])
    rate = data.prepared.record.sample_rate_hz
    candidates = []
    for structure in STRUCTURES:
        if structure not in errors:
            continue
        lost = errors[structure] ** 2 - errors[best] ** 2
        behind, share = _ahead(lost, rate), float(np.mean(lost)) / variance
        error = data.measured - run(found[structure].blocks, data).output[data.rows]
        one = Candidate(
            structure=structure,
            vaf_held_out_percent=100.0 * (1.0 - sizes[structure] / variance),
            aicc=aicc(error, found[structure].blocks.n_parameters),
            behind=behind,
            lost_percent=100.0 * share,
            alike=share < _WORTH or (behind < _CLEAR and sizes[structure] < _FAR * sizes[best]),
        )
        if one.alike:
            left = unexplained(found[structure].blocks, data)
            one = replace(one, unexplained_percent=100.0 * left.share, unexplained_p_value=left.p_value)
        candidates.append(one)
    alike = [one for one in candidates if one.alike and one.complete]
    simplest = [one for one in alike if not any(other.structure in INSIDE[one.structure] for other in alike)]
    leading = next(one for one in candidates if one.structure == best)
    chosen = max(simplest, key=lambda one: one.vaf_held_out_percent, default=leading)
    return Choice(
        structure=chosen.structure,
        candidates=tuple(candidates),
        alike=tuple(one.structure for one in alike),
        told=len(simplest) == 1 and chosen.vaf_held_out_percent > _LEAST_PERCENT and not _unbeaten(chosen, candidates),
        complete=bool(alike),
    )


def _unbeaten(chosen: Candidate, candidates: Iterable[Candidate]) -> list[Structure]:
    """Special cases of a structure that it does not beat both on samples it was not fitted to and by AICc."""
    simpler = [one for one in candidates if one.structure in INSIDE[chosen.structure]]
    return [
        one.structure
        for one in simpler
        if one.aicc <= chosen.aicc or one.vaf_held_out_percent >= chosen.vaf_held_out_percent
    ]


def findings_of(choice: Choice) -> tuple[str, ...]:
    """What a choice says, in words: a name only where the record speaks for it."""
    chosen = choice.chosen
    name = NAMES[choice.structure]
    held_out = f"free run on samples it was not fitted to {chosen.vaf_held_out_percent:.1f} %"
    if chosen.vaf_held_out_percent <= _LEAST_PERCENT:
        return (f"no block structure explains this record: {name} comes closest ({held_out})",)
    if not choice.complete:
        return (
            f"none of the block structures: {name} comes closest ({held_out}), but products of its own signals explain "
            f"{chosen.unexplained_percent or 0.0:.0f} % of the error that it leaves",
        )
    if not choice.told:
        level = [NAMES[one] for one in choice.alike if not any(other in INSIDE[one] for other in choice.alike)]
        simpler = [NAMES[one] for one in _unbeaten(chosen, choice.candidates)]
        return (f"the record does not tell {' and '.join(simpler + level)} apart ({held_out})",)
    rivals = [one for one in choice.candidates if one.structure not in choice.alike]
    if not rivals:
        return (f"{name}: no other block structure does better ({held_out})",)
    near = max(rivals, key=lambda one: one.vaf_held_out_percent)
    rival = f"{NAMES[near.structure]} {near.vaf_held_out_percent:.1f} %, {near.behind:.1f} standard errors behind"
    return (f"{name}, {_ORDERS[choice.structure]} ({held_out}; {rival})",)


def doubts_of(choice: Choice) -> tuple[str, ...]:
    """What to know before the chosen structure is taken for the system."""
    if choice.complete:
        return ()
    return (
        f"the error of the {choice.structure} cascade is not noise: the system is none of the block structures; "
        "parameters that vary with depth would look like this",
    )


def _refitted(fitted: Fitted, data: CascadeData, folds: list[NDArray[np.intp]]) -> list[Blocks]:
    """The blocks as fitted to all but each stretch."""
    answers = []
    for fold in folds:
        held_out = np.zeros(data.input.size, dtype=np.bool_)
        held_out[data.rows[fold]] = True
        others = data.without(held_out)
        if fitted.blocks.structure == "linear":
            answers.append(fit_linear(others).blocks)
        else:
            answers.append(refine(fitted.blocks, others, _FOLD_STEPS, _FOLD_SETTLED).blocks)
    return answers


def _held_out_errors(refitted: list[Blocks], data: CascadeData, folds: list[NDArray[np.intp]]) -> Array:
    """Errors (rows,) of the free run, each stretch by the blocks as fitted to the others."""
    errors = np.empty(data.rows.size)
    for fold, blocks in zip(folds, refitted, strict=True):
        errors[fold] = data.measured[fold] - run(blocks, data).output[data.rows[fold]]
    return errors


def _ahead(gains: Array, sample_rate_hz: float) -> float:
    """Mean of dependent gains (n,) in units of its standard error; 0 when there is nothing to compare."""
    spread = float(np.std(gains))
    if spread == 0.0:
        return 0.0
    centred = gains - gains.mean()
    variance = float(long_run_covariance(centred[:, None], dependence_samples(centred, sample_rate_hz))[0, 0])
    return float(gains.sum()) / float(np.sqrt(variance))
