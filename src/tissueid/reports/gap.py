"""The diagnosis of a sim-to-real gap as one self-contained page."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np

from tissueid import __version__
from tissueid.gap.diagnosis import Diagnosis, Ranked, parameters_of
from tissueid.reports.blocks import FigureGroup
from tissueid.reports.gap_panels import gap_panels
from tissueid.reports.html import RESEARCH_LINE, template, write_whole
from tissueid.reports.tables import Table
from tissueid.twin.catalogue import all_effects
from tissueid.twin.effect import STAGES
from tissueid.wording import fixed, named_value, number

Level = Literal["good", "check", "poor"]

STAGE_WORDS = {
    "drive": "the amplifier (command to voltage)",
    "coil": "the coil (voltage to current and force)",
    "mechanics": "the moving part (force to motion, without tissue)",
    "tissue": "the tissue",
    "sensing": "the sensors (motion to recorded number)",
    "environment": "the surroundings",
}
_DIRECTIONS = {"into": "while the probe goes in", "out": "while the probe comes out", "both": "in both directions"}
_LISTED = 8


def gap_html(found: Diagnosis, title: str = "Simulated and recorded") -> str:
    """The page as HTML text: where, which, how far, and what to do next."""
    figures = {panel.key: panel.picture().block for panel in gap_panels(found)}
    places = ("frequency", "depth", "speed", "surface", "time", "current", "amplitude", "mains", "where")
    groups = (
        FigureGroup("g-where", "Where it lies", tuple(figures[key] for key in places if key in figures)),
        FigureGroup("g-which", "Which cause", tuple(figures[key] for key in ("ranking",) if key in figures)),
        FigureGroup("g-far", "How far it closes", tuple(figures[key] for key in ("overlay",) if key in figures)),
    )
    headline, level = headline_of(found)
    return template("gap.html.j2").render(
        title=title,
        research_line=RESEARCH_LINE,
        software=f"tissueid {__version__}",
        facts=_facts(found),
        headline=headline,
        level=level,
        sentences=tuple(sentences_of(found)),
        numbers=tuple(_numbers(found)),
        chain=FigureGroup("g-chain", "", (figures["chain"],)),
        findings=_findings(found),
        groups=tuple(group for group in groups if group.figures),
        ranking=_ranking(found),
        remedies=tuple(next_steps_of(found)),
        tables=tuple(_tables(found)),
        remarks=found.remarks,
    )


def write_gap_report(found: Diagnosis, path: Path, title: str = "Simulated and recorded") -> None:
    """Write the page so that ``path`` is whole or untouched.

    Raises:
        OSError: the folder is missing, or the disk is full or not writable; nothing is left behind.
    """
    write_whole(path, gap_html(found, title))


def effect_words(name: str) -> str:
    """What an effect is, as it stands in a sentence."""
    known = all_effects().get(name)
    return name.replace("_", " ") if known is None else known.title[:1].lower() + known.title[1:]


def headline_of(found: Diagnosis) -> tuple[str, Level]:
    """The verdict in a line, and how it is to be taken."""
    if found.verdict == "no_gap":
        return "No gap: the twin explains this recording down to its noise", "good"
    if found.verdict == "unexplained":
        return f"There is a gap that no known effect explains; it arises in {STAGE_WORDS[found.where.stage]}", "poor"
    causes = "; ".join(effect_words(name) for name in found.combination)
    return f"The gap is explained: {causes}", "check"


def sentences_of(found: Diagnosis) -> Iterator[str]:
    """Where the gap lies, and what it cannot be told from."""
    where = found.where
    if found.verdict != "no_gap" and where.above_floor:
        share = 100.0 * where.shares[where.stage]
        suspected = max(STAGES, key=where.shares.__getitem__)
        if where.shares[where.stage] >= where.shares[suspected]:
            yield f"It arises in {STAGE_WORDS[where.stage]}: {fixed(share, 0)} % of what stands above the floor."
        else:
            yield (
                f"It arises in {STAGE_WORDS[where.stage]}, where the cause belongs. The stages alone would have "
                f"suspected {STAGE_WORDS[suspected]}: what the cause leaves looks like a fault there."
            )
    regions = where.regions
    told = []
    if regions.bands_hz:
        told.append("from " + _spans(regions.bands_hz, 1.0, "Hz"))
    if regions.depth_m:
        told.append("at depths of " + _spans(regions.depth_m, 1e3, "mm"))
    if regions.current_a:
        told.append("at currents of " + _spans(regions.current_a, 1.0, "A"))
    if regions.amplitude_n:
        told.append("where the last 0.1 s of the stimulus had a size of " + _spans(regions.amplitude_n, 1.0, "N"))
    if regions.mains_phase_rad:
        told.append(
            f"at phases of the mains ({number(regions.mains_hz, 3)} Hz) of "
            + _spans(regions.mains_phase_rad, 180.0 / np.pi, "degrees")
        )
    if told:
        words = _listed(told)
        yield f"It shows most in the {regions.channel}, {words}, {_DIRECTIONS[regions.direction]}."
    alike = _alike(found)
    if alike:
        names = ", ".join(effect_words(name) for name in alike)
        yield f"This data cannot tell it from: {names}."
    if found.verdict == "unexplained" and found.ranking:
        best = found.ranking[0]
        yield f"The best attempt, {effect_words(best.effect)}, closes {_percent(best.closed)} and does not explain it."


def _listed(parts: list[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def _alike(found: Diagnosis) -> tuple[str, ...]:
    named = [item for item in found.ranking if item.effect in found.combination]
    return tuple(dict.fromkeys(name for item in named for name in item.indistinguishable))


def _spans(intervals: tuple[tuple[float, float], ...], scale: float, unit: str) -> str:
    return ", ".join(f"{number(scale * low, 2)} to {number(scale * high, 2)}" for low, high in intervals) + f" {unit}"


def _percent(share: float) -> str:
    return "nothing that can be told" if not np.isfinite(share) else f"{fixed(100.0 * share, 0)} %"


def _interval(item: tuple[float, float]) -> str:
    low, high = item
    return f"{fixed(100 * low, 0)} to {fixed(100 * high, 0)} %" if np.isfinite(low) and np.isfinite(high) else ""


def _facts(found: Diagnosis) -> tuple[tuple[str, str], ...]:
    device = found.observed.instrument
    kinds = ", ".join(f"{test.number} {test.kind.replace('_', ' ')}" for test in found.observed.tests)
    return (
        ("Instrument", f"{device.model}, {device.serial_number}"),
        ("Tests", kinds),
        ("Signals", ", ".join(found.observed.channels)),
        ("Took", f"{fixed(found.seconds, 0)} s"),
    )


def _numbers(found: Diagnosis) -> Iterator[tuple[str, str, str]]:
    """Label, value and note."""
    gap = found.gap
    yield "Gap before", _share(gap.before), "error over the signal's deviation, held out"
    if found.verdict != "no_gap":
        yield "Gap after", _share(gap.after), "with the leading explanation added"
    yield "Floor", _share(gap.floor), "what noise leaves to anyone"
    if found.verdict != "no_gap" and np.isfinite(gap.closed):
        note = f"95 %: {_interval(gap.closed_ci)}" if _interval(gap.closed_ci) else "of what stands above the floor"
        yield "Closed", _percent(gap.closed), f"{note}; announced {_percent(gap.announced)}"


def _share(value: float) -> str:
    return f"{number(100.0 * value, 3)} %" if np.isfinite(value) else "unknown"


def _findings(found: Diagnosis) -> Table | None:
    where = found.where
    if not where.findings:
        return None
    rows = tuple(
        (item.stage, item.what, item.channel, f"{number(item.error / item.floor, 3)} floors")
        for item in where.findings[:_LISTED]
    )
    return Table("What speaks against each stage", ("Stage", "Finding", "Signal", "Error"), rows)


def _ranking(found: Diagnosis) -> Table | None:
    if not found.ranking:
        return None
    rows = tuple(_ranked(place, item) for place, item in enumerate(found.ranking[:_LISTED], 1))
    head = ("", "Effect", "Stage", "Probability", "Closed", "95 %", "Cannot be told from")
    return Table("Candidates", head, rows)


def _ranked(place: int, item: Ranked) -> tuple[str, ...]:
    alike = ", ".join(effect_words(name) for name in item.indistinguishable)
    probability = f"{fixed(100.0 * item.probability, 0)} %"
    closed = f"{fixed(100.0 * item.closed, 0)} %" if np.isfinite(item.closed) else ""
    return (str(place), effect_words(item.effect), item.stage, probability, closed, _interval(item.closed_ci), alike)


def next_steps_of(found: Diagnosis) -> Iterator[str]:
    """What to do now, a sentence each."""
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
        yield "Add the effect to a named twin, so that simulation and later diagnoses have it."
    elif found.next_experiment is None:
        yield f"Look at {STAGE_WORDS[found.where.stage]}: the cause is there, and none of the known effects fits it."


def _tables(found: Diagnosis) -> Iterator[Table]:
    rows = tuple((stage, f"{fixed(100.0 * found.where.shares[stage], 0)} %") for stage in STAGES)
    yield Table("Stages", (), rows, "Shares of what stands above the floor.")
    for effect in found.combination:
        # Of the accepted explanation: beside a second effect they are others than in the ranking of single ones.
        if found.best is not None and (parameters := parameters_of(found.best, effect)):
            values = tuple(named_value(name, value) for name, value in parameters.items())
            yield Table(f"Parameters of {effect_words(effect)}", (), values)
    if found.where.evidence.errors:
        errors = tuple((name, f"{number(value, 3)} floors") for name, value in found.where.evidence.errors.items())
        note = "Each with everything upstream measured; 1 is the floor. Free current: from the voltage alone."
        yield Table("Errors by question", (), errors, note)
