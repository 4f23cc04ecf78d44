"""Build the content of the page for a diagnosis: texts, shares, and curves in display units."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from tissueid.app.views.gap.next_test import proposal_of
from tissueid.app.views.gap.page_content import Fitted, PageContent, Rival, StageContent
from tissueid.errors import UnusableInputError
from tissueid.formatting import number
from tissueid.gap.diagnosis import Diagnosis, Ranked, parameters_of
from tissueid.gap.diagnosis_curves import GapSpectrum, SignalOverlay
from tissueid.gap.diagnosis_plots import budget_rows, overlays_of, profile_values, spectrum_lines
from tissueid.gap.error_regions import ErrorSpectrum
from tissueid.gap.noise import MARGIN
from tissueid.gap.statement import (
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
from tissueid.messages import MISSING, Listing, Message, sentences
from tissueid.records import Estimate
from tissueid.sessions import Session
from tissueid.twin.catalogue import all_effects
from tissueid.twin.effect import STAGES, Stage

_PROFILES = ("depth_m", "velocity_m_s", "time_s")
_LEAST_HZ = 0.1
"""Lowest frequency on the logarithmic axis, Hz."""


def page_content_of(found: Diagnosis, session: Session) -> PageContent:
    """Return the content of the page for a diagnosis. Its texts are messages, or constants to be translated."""
    regions = found.where.regions
    headline, level = headline_of(found)
    spectra = [item for item in regions.spectra if item.channel == regions.channel]
    profiles = {name: profile_values(name, regions.profiles[name]) for name in _PROFILES if name in regions.profiles}
    return PageContent(
        found.verdict,
        _titles(found.combination),
        headline,
        level,
        tuple(sentences_of(found)),
        tuple(next_steps_of(found)),
        found.remarks,
        tuple(_stage(found, stage) for stage in STAGES),
        found.at_fault,
        _spectrum(spectra[0], regions.bands_hz) if spectra else None,
        profiles,
        tuple(_rival(found, item) for item in ordered_candidates(found)),
        _closing(found),
        _overlays(found),
        proposal_of(found, session),
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
    nearest = found.where.evidence.nearest
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


def _spectrum(found: ErrorSpectrum, bands_hz: tuple[tuple[float, float], ...]) -> GapSpectrum:
    bands = tuple((max(low, _LEAST_HZ), max(high, _LEAST_HZ)) for low, high in bands_hz)
    return GapSpectrum(found.channel, np.maximum(found.frequency_hz, _LEAST_HZ), spectrum_lines(found), bands)


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
