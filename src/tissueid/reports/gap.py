"""The diagnosis of a sim-to-real gap as one self-contained page."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from tissueid import __version__
from tissueid.gap.diagnosis import Diagnosis, Ranked
from tissueid.reports.blocks import FigureGroup
from tissueid.reports.gap_figures import tables_of, times_noise
from tissueid.reports.gap_panels import gap_panels
from tissueid.reports.html import RESEARCH_LINE, template, write_whole
from tissueid.reports.tables import Table, readable_date
from tissueid.sessions import Session
from tissueid.twin.catalogue import all_effects
from tissueid.twin.effect import STAGE_NAMES, STAGES
from tissueid.wording import MISSING, fixed, number

Level = Literal["good", "check", "poor"]

STAGE_WORDS = {stage: f"the {name}" for stage, name in STAGE_NAMES.items()}
"""The stages as they stand in a sentence."""
_DIRECTIONS = {"into": "while the probe goes in", "out": "while the probe comes out", "both": "in both directions"}
_LISTED = 8


@dataclass(frozen=True)
class Origin:
    """What was diagnosed: the session and the file that it was read from."""

    session: Session
    file: Path


def gap_html(found: Diagnosis, title: str = "Simulated and recorded", origin: Origin | None = None) -> str:
    """The page as HTML text: where, which, how far, and what to do next.

    Args:
        found: the diagnosis.
        title: heading of the page.
        origin: what was diagnosed, to be named on the page and in what to type next.
    """
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
        facts=tuple(_facts(found, origin)),
        headline=headline,
        level=level,
        sentences=tuple(sentences_of(found)),
        numbers=tuple(_numbers(found)),
        chain=FigureGroup("g-chain", "", (figures["chain"],)),
        findings=_findings(found),
        groups=tuple(group for group in groups if group.figures),
        ranking=_ranking(found),
        remedies=tuple(next_steps_of(found, origin)),
        tables=tuple(tables_of(found, effect_words)),
        remarks=found.remarks,
    )


def write_gap_report(
    found: Diagnosis, path: Path, title: str = "Simulated and recorded", origin: Origin | None = None
) -> None:
    """Write the page so that ``path`` is whole or untouched.

    Raises:
        OSError: the folder is missing, or the disk is full or not writable; nothing is left behind.
    """
    write_whole(path, gap_html(found, title, origin))


def effect_words(name: str) -> str:
    """What an effect is, as it stands in a sentence."""
    known = all_effects().get(name)
    return name.replace("_", " ") if known is None else known.title[:1].lower() + known.title[1:]


def headline_of(found: Diagnosis) -> tuple[str, Level]:
    """The verdict in a line, and how it is to be taken."""
    if found.verdict == "no_gap":
        return "No gap: the twin explains this recording down to its noise", "good"
    if found.verdict == "unexplained":
        return f"There is a gap that no known effect explains; it arises in {STAGE_WORDS[found.where.stage]}", "check"
    causes = "; ".join(effect_words(name) for name in found.combination)
    return f"The gap is explained: {causes}", "good"


def sentences_of(found: Diagnosis) -> Iterator[str]:
    """Where the gap lies, and what it cannot be told from."""
    where = found.where
    if found.verdict != "no_gap" and where.above_floor:
        share = 100.0 * where.shares[where.stage]
        suspected = max(STAGES, key=where.shares.__getitem__)
        if where.shares[where.stage] >= where.shares[suspected]:
            yield f"It arises in {STAGE_WORDS[where.stage]}: {fixed(share, 0)} % of what noise does not explain."
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
        told.append("at an amplitude (of the stimulus over the last 0.1 s) of " + _spans(regions.amplitude_n, 1.0, "N"))
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
    return _listed([f"{number(scale * low, 2)} to {number(scale * high, 2)} {unit}" for low, high in intervals])


def _percent(share: float) -> str:
    return "nothing that can be told" if not np.isfinite(share) else f"{fixed(100.0 * share, 0)} %"


def _interval(item: tuple[float, float]) -> str:
    low, high = item
    return f"{fixed(100 * low, 0)} to {fixed(100 * high, 0)} %" if np.isfinite(low) and np.isfinite(high) else ""


def _facts(found: Diagnosis, origin: Origin | None) -> Iterator[tuple[str, str]]:
    device, tests = found.observed.instrument, found.observed.tests
    if origin is not None:
        numbers = {test.number for test in tests}
        sites = dict.fromkeys(test.site for test in origin.session.tests if test.number in numbers and test.site)
        yield "Session file", origin.file.name
        yield "Recorded", readable_date(origin.session.created)
        yield "Site", ", ".join(sites) or MISSING
        yield "Subject", origin.session.subject.pseudonym or MISSING
    yield "Instrument", f"{device.model}, {device.serial_number}"
    yield "Tests", ", ".join(f"{test.number} {_kind(test.kind)}" for test in tests)
    yield "Signals", ", ".join(found.observed.channels)
    yield "Took", f"{fixed(found.seconds, 0)} s"


def _kind(kind: str) -> str:
    return "quiet (nothing is played)" if kind == "quiet" else kind.replace("_", " ")


def _numbers(found: Diagnosis) -> Iterator[tuple[str, str, str]]:
    """Label, value and note."""
    gap = found.gap
    yield "Gap before", _share(gap.before), "error over the signal's deviation, on data held out"
    if found.verdict != "no_gap":
        yield "Gap after", _share(gap.after), "with the leading explanation added"
    yield "Noise alone", _share(gap.floor), "what the sensors' noise alone leaves"
    if found.verdict != "no_gap" and np.isfinite(gap.closed):
        note = f"95 %: {_interval(gap.closed_ci)}" if _interval(gap.closed_ci) else "of what noise does not explain"
        chosen_by = f"; {_percent(gap.announced)} predicted on the data used for the choice"
        yield "Closed", _percent(gap.closed), note + (chosen_by if np.isfinite(gap.announced) else "")


def _share(value: float) -> str:
    return f"{number(100.0 * value, 3)} %" if np.isfinite(value) else "unknown"


def _findings(found: Diagnosis) -> Table | None:
    where = found.where
    if not where.findings:
        return None
    rows = tuple(
        (STAGE_NAMES[item.stage], item.what, item.channel, times_noise(item.error / item.floor))
        for item in where.findings[:_LISTED]
    )
    note = "× noise: error as a multiple of the noise, which is what the sensors' noise alone would leave."
    return Table("What speaks against each stage", ("Stage", "Finding", "Signal", "Error"), rows, note)


def _ranking(found: Diagnosis) -> Table | None:
    if not found.ranking:
        return None
    listed = found.ranking[:_LISTED]
    places = {item.effect: str(place) for place, item in enumerate(listed, 1)}
    rows = tuple(_ranked(item, places) for item in listed)
    head = ("", "Effect", "Stage", "Probability", "Closed", "95 %", "Alike")
    # A column that says nothing in any row only makes the others narrow.
    kept = [place for place in range(len(head)) if place == 0 or any(row[place] for row in rows)]
    narrowed = tuple(tuple(row[place] for place in kept) for row in rows)
    shown = tuple(head[place] for place in kept)
    note = "Alike: candidates, by number, that this data cannot tell from it." if "Alike" in shown else ""
    return Table("Candidates", shown, narrowed, note)


def _ranked(item: Ranked, places: Mapping[str, str]) -> tuple[str, ...]:
    alike = ", ".join(places.get(name) or effect_words(name) for name in item.indistinguishable)
    probability = f"{fixed(100.0 * item.probability, 0)} %"
    closed = f"{fixed(100.0 * item.closed, 0)} %" if np.isfinite(item.closed) else ""
    name, stage = effect_words(item.effect), STAGE_NAMES[item.stage]
    return (places[item.effect], name, stage, probability, closed, _interval(item.closed_ci), alike)


def next_steps_of(found: Diagnosis, origin: Origin | None = None) -> Iterator[str]:
    """What to do now, a sentence each; with what to type where it is told which file was diagnosed."""
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
        file = "" if origin is None else shlex.quote(str(origin.file))
        yield f"{named}: tissueid gap accept {file} --out TWIN.toml" if file else f"{named}."
    elif found.next_experiment is None:
        yield f"Look at {STAGE_WORDS[found.where.stage]}: the cause is there, and none of the known effects fits it."
