"""The figures of a diagnosis as tables: shares of the stages, parameters of the cause, errors by question."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from tissueid.errors import UnusableInputError
from tissueid.formatting import fixed, label_and_unit, number, with_unit
from tissueid.gap.diagnosis import Diagnosis, effect_in, parameters_of
from tissueid.gap.scoring import Candidate
from tissueid.gap.twin_export import twin_of
from tissueid.language import _, marked
from tissueid.messages import Message, translated
from tissueid.reports.tables import Table
from tissueid.twin.catalogue import all_effects
from tissueid.twin.effect import STAGE_NAMES, STAGES
from tissueid.units import display_unit, unit_for

_TASKS = {
    "drive": marked("command to voltage"),
    "coil": marked("voltage to current and force"),
    "mechanics": marked("force to motion, without tissue"),
    "tissue": marked("what the probe presses on"),
    "sensing": marked("motion to recorded number"),
    "environment": marked("disturbances"),
}
_QUESTIONS = {
    "drive": marked("Voltage, from the command"),
    "coil": marked("Current, from voltage and motion"),
    "free current": marked("Current, from the voltage alone"),
    "spring": marked("Motion off the tissue (spring or air), from the current"),
    "tissue": marked("Motion on tissue, from the current"),
    "quiet": marked("Motion while nothing is played (quiet test)"),
}
_WIDEST_STD = 1e5
"""A standard deviation above this, SI, means that the data does not hold the parameter at all."""


def times_noise(ratio: float) -> str:
    """An error as a multiple of the noise floor."""
    return _("{ratio} × noise").format(ratio=number(ratio, 3))


def tables_of(found: Diagnosis, called: Callable[[str], str]) -> Iterator[Table]:
    """The figures of a diagnosis.

    Args:
        found: the diagnosis.
        called: what an effect is called in a sentence, by its name.
    """
    where = found.where
    shares = tuple(
        (f"{_(STAGE_NAMES[item])}: {_(_TASKS[item])}", f"{fixed(100.0 * where.shares[item], 0)} %") for item in STAGES
    )
    if found.verdict != "no_gap":
        yield Table(
            _("Stages"), (), shares, _("Shares of what noise does not explain, as logarithms of error over noise.")
        )
    for name in found.combination:
        # parameters of the accepted combination; they differ from those of single effects in the ranking
        if found.best is not None and (table := _parameters(found.best, name, called(name))):
            yield table
    if found.detection_limits:
        yield _limits(found, called)
    if where.evidence.errors:
        unasked = set() if any(test.quiet for test in found.dataset.tests) else {"quiet"}
        asked = {name: times for name, times in where.evidence.errors.items() if name not in unasked}
        errors = tuple((_(_QUESTIONS.get(name, name)), times_noise(times)) for name, times in asked.items())
        whole = ""
        if found.verdict == "no_gap":
            whole = _(
                "The simulation of the whole chain leaves only noise. An error here is no gap: noise of "
                "the measured signals causes it in a single stage."
            )
        note = Message(
            "report.gap.not_shares",
            "How far one signal is missed when everything upstream of it is as measured; 1 × noise is what "
            "noise alone leaves. These are not the shares of the stages: an error counts there only by its logarithm, "
            "only above the noise, and for the stage whose kind of force explains it, so motion on tissue may speak "
            "against the moving part.",
        )
        yield Table(_("Errors by question"), (), errors, " ".join(filter(None, [whole, translated(note)])))


def _limits(found: Diagnosis, called: Callable[[str], str]) -> Table:
    rows = []
    for name, limit in found.detection_limits.items():
        if limit is None:
            rows.append((called(name), _("not visible at any size, or estimated from the record"), ""))
            continue
        unit, scale = unit_for("" if limit.unit == "1" else limit.unit, limit.value)
        size = with_unit(number(scale * limit.value, 2), unit)
        words = _("below {size}") if limit.below else _("above {size}")
        meanings = {item.name: item.meaning for item in all_effects()[name].parameters}
        rows.append((called(name), words.format(size=size), translated(meanings[limit.parameter])))
    note = _("Size from which an effect that is not named would have been named in this session, at its usual form.")
    return Table(_("Detection limits"), (_("Effect"), _("Visible"), _("Meaning")), tuple(rows), note)


def _parameters(best: Candidate, name: str, words: str) -> Table | None:
    values = parameters_of(best, name)
    known = {item.name: item for item in effect_in(best, name).parameters}
    try:
        stds = twin_of(best, "twin").stds
    except UnusableInputError:
        stds = {}  # a bare record of input and output makes no twin
    rows = []
    for key, value in values.items():
        unit, scale = display_unit("" if known[key].unit == "1" else known[key].unit)
        std = stds.get(f"{name}.{key}", 0.0)
        text = number(scale * value, 3)
        if 0.0 < std < _WIDEST_STD and np.isfinite(std):
            text += f" ± {number(scale * std, 2)}"
        rows.append((_(label_and_unit(key)[0]), with_unit(text, unit), translated(known[key].meaning)))
    if not rows:
        return None
    head = (_("Parameter"), _("Value"), _("Meaning"))
    return Table(
        _("Parameters of {effect}").format(effect=words),
        head,
        tuple(rows),
        _("± is one standard deviation, where the fit has one."),
    )
