"""Scores of a blind check on scenarios with sets of effects: the preset's own and hidden ones of the instrument.

Precision, recall and F1 are those of all named effects over all scenarios of one kind of session.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from tissueid.language import marked
from tissueid.twin.catalogue import all_effects
from tissueid_lab.blind_check.scoring import (
    Answered,
    BlindScore,
    Measured,
    f1,
    f1_of,
    has_gap,
    mean,
    quantile,
    rate,
    set_counts,
    unexplained,
)

NEW_EFFECT, FALSE_ALARM = 0.95, 0.02
"""Targets of sessions against an accepted twin: least share of new effects in the first place, most false alarms."""
_BY_HIDDEN = (
    (0, marked("F1 of the named set without a hidden effect")),
    (1, marked("F1 of the named set with one hidden effect")),
    (2, marked("F1 of the named set with two hidden effects")),
)


def score_of_sets(cases: Sequence[Answered]) -> BlindScore:
    """Score answers against sets of true effects.

    A scenario whose gap survives the refit and for which no effect is named has closed nothing. There are no targets.
    """
    named = [case.named for case in cases]
    true = [set(case.label.effects) for case in cases]
    hits, said, there = set_counts(named, true)
    closed = [value for case in cases if (value := _relative_closed(case)) is not None]
    wrong = [len(names - truth) for names, truth in zip(named, true, strict=True)]
    count, nan = len(cases), float("nan")
    figures = [
        Measured(marked("precision of the named set"), hits / said if said else nan, count),
        Measured(marked("recall of the named set"), hits / there if there else nan, count),
        Measured(marked("F1 of the named set"), f1(named, true), count),
        *(_by_hidden(cases, number, what) for number, what in _BY_HIDDEN),
        Measured(marked("F1 of the hidden effects alone"), _hidden_f1(cases), count),
        Measured(marked("named effects that are not there, per scenario"), mean(wrong), count),
        Measured(marked("closed share relative to the true set, median"), quantile(closed, 0.5), len(closed)),
        Measured(marked("closed share relative to the true set, 10th percentile"), quantile(closed, 0.1), len(closed)),
    ]
    return BlindScore((), tuple(figures), {}, (), tuple(failure for case in cases if (failure := _failure(case))))


def score_of_later_sessions(cases: Sequence[Answered]) -> BlindScore:
    """Score answers of sessions that were diagnosed against the twin of an earlier session.

    A session has 0 or 1 new effect. The first place is scored where the gap against the twin survives the refit.
    """
    new = [case for case in cases if case.label.hidden]
    visible = [case for case in new if case.survives]
    same = [case for case in cases if not case.label.hidden]
    rates = (
        rate(marked("new effect: top-1"), visible, _new_is_first, NEW_EFFECT),
        rate(marked("nothing new: false alarms"), same, has_gap, FALSE_ALARM, at_least=False),
    )
    figures = (
        _share(marked("new effect, also without a surviving gap: top-1"), new, _new_is_first),
        _share(
            marked("new effect: named, and nothing else"), visible, lambda case: case.named == set(case.label.hidden)
        ),
        _share(marked("new effect: unexplained"), visible, unexplained),
        _share(marked("new effect: no gap"), new, lambda case: not has_gap(case)),
        Measured(
            marked("accepted effects that are not there, per session"),
            mean([len(_accepted(case) - (set(case.label.effects) - set(case.label.hidden))) for case in cases]),
            len(cases),
        ),
    )
    return BlindScore(rates, figures, {}, (), tuple(failure for case in cases if (failure := _failure_of_twin(case))))


def _share(what: str, cases: Sequence[Answered], hit: Callable[[Answered], bool]) -> Measured:
    return Measured(what, mean([hit(case) for case in cases]), len(cases))


def _new_is_first(case: Answered) -> bool:
    first = case.ranking[0]["effect"] if case.ranking else ""
    return has_gap(case) and first in case.label.hidden


def _accepted(case: Answered) -> set[str]:
    return set(case.answer.get("accepted") or ())


def _failure_of_twin(case: Answered) -> str:
    new = set(case.label.hidden)
    if case.named == new and (new or not has_gap(case)):
        return ""
    said = " + ".join(sorted(case.named)) or case.verdict
    true = " + ".join(sorted(new)) or "nothing new"
    twin = " + ".join(sorted(_accepted(case))) or "no effect"
    return f"{case.name} ({case.label.preset}), {true}: diagnosed as {said}; accepted twin: {twin}"


def _by_hidden(cases: Sequence[Answered], number: int, what: str) -> Measured:
    chosen = [case for case in cases if len(case.label.hidden) == number]
    return Measured(what, f1_of(chosen), len(chosen))


def _hidden_f1(cases: Sequence[Answered]) -> float:
    # Effects of tissue are left out on both sides.
    library = all_effects()
    named = [{name for name in case.named if name not in library or library[name].stage != "tissue"} for case in cases]
    return f1(named, [set(case.label.hidden) for case in cases])


def _relative_closed(case: Answered) -> float | None:
    # Relative to the closed share of the true signals, which is that of the complete true set.
    best = case.best_closed
    if not case.survives or best is None or best <= 0.05:
        return None
    return (case.closed or 0.0) / best if case.named else 0.0


def _failure(case: Answered) -> str:
    true = set(case.label.effects)
    if case.named == true:
        return ""
    missing, wrong = sorted(true - case.named), sorted(case.named - true)
    parts = [f"missing {' + '.join(missing)}"] if missing else []
    parts += [f"not there {' + '.join(wrong)}"] if wrong else []
    said = " + ".join(sorted(case.named)) or case.verdict
    return f"{case.name} ({case.label.preset}): diagnosed as {said}; {'; '.join(parts)}"
