"""What the page shows of a diagnosis: words, shares and curves in the units that people read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tissueid.app.views.gap.overlay import Overlay, overlays_of
from tissueid.app.views.gap.proposal import Proposal, proposal_of
from tissueid.app.words import sentence
from tissueid.core_words import for_window, said_by_core
from tissueid.errors import UnusableInputError
from tissueid.gap.diagnosis import Diagnosis, Ranked, parameters_of
from tissueid.gap.evidence import MARGIN
from tissueid.gap.named import twin_of
from tissueid.gap.regions import Profile, Spectrum
from tissueid.gap.statement import (
    effect_words,
    headline_of,
    judged_alone,
    listed,
    members_of,
    next_steps_of,
    percent,
    sentences_of,
)
from tissueid.language import _
from tissueid.records import Estimate
from tissueid.sessions import Session
from tissueid.twin.catalogue import all_effects
from tissueid.twin.effect import STAGES, Stage
from tissueid.wording import clean, fixed, number

Array = NDArray[np.float64]

FINE_UNITS = {"voltage": ("mV", 1e3), "current": ("mA", 1e3), "position": ("µm", 1e6)}
_PROFILES = (("depth_m", 1e3), ("velocity_m_s", 1e3), ("time_s", 1.0))
_LEAST_ERROR = 0.01


@dataclass(frozen=True)
class StageStory:
    """One stage of the chain: its share of what noise does not explain, 0 to 1, and what speaks against it."""

    stage: Stage
    share: float
    lit: bool
    evidence: tuple[str, ...]


@dataclass(frozen=True)
class SpectrumStory:
    """Amplitude densities of a signal and of what the baseline leaves of it; all of them decimal logarithms.

    ``frequency`` (of Hz) and every array of ``lines`` (of ``unit``/√Hz), by its name, are of shape (n,); NaN is not
    drawn.
    """

    channel: str
    unit: str
    frequency: Array
    lines: Mapping[str, Array]
    bands: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class ProfileStory:
    """Error along something: ``middle`` of each bin, decimal logarithm of ``error`` over noise, shape (bins,)."""

    middle: Array
    error: Array
    above: NDArray[np.bool_]


@dataclass(frozen=True)
class Fitted:
    """A fitted parameter: what it means, and its value, in SI."""

    meaning: str
    value: Estimate
    si_unit: str


@dataclass(frozen=True)
class Rival:
    """One candidate of the ranking, in words; ``figures`` are its fitted parameters."""

    title: str
    stage: Stage
    named: bool
    probability: float
    odds: str
    closed: str
    alike: str
    signature: str
    remedy: str
    figures: tuple[Fitted, ...]


@dataclass(frozen=True)
class Story:
    """A diagnosis as the page tells it. ``gap`` is before, after (None without a candidate) and noise, as shares."""

    verdict: Literal["effect", "no_gap", "unexplained"]
    effect: str
    headline: str
    level: Literal["good", "check", "poor"]
    means: tuple[str, ...]
    todo: tuple[str, ...]
    remarks: tuple[str, ...]
    stages: tuple[StageStory, ...]
    at_fault: tuple[Stage, ...]
    spectrum: SpectrumStory | None
    profiles: Mapping[str, ProfileStory]
    ranking: tuple[Rival, ...]
    gap: tuple[float, float | None, float]
    closing: str
    overlays: tuple[Overlay, ...]
    proposal: Proposal | None
    offered: tuple[tuple[str, str, bool], ...]
    """Effects to accept: name, title with its odds, and whether the diagnosis names it."""


def story_of(found: Diagnosis, session: Session) -> Story:
    """Tell a diagnosis."""
    regions = found.where.regions
    headline, level = headline_of(found, said_by_core)
    spectra = [item for item in regions.spectra if item.channel == regions.channel]
    profiles = {name: _profile(regions.profiles[name], scale) for name, scale in _PROFILES if name in regions.profiles}
    return Story(
        found.verdict,
        ", ".join(_cause(name) for name in found.combination),
        headline,
        level,
        tuple(for_window(line) for line in sentences_of(found)),
        tuple(for_window(line) for line in next_steps_of(found)),
        tuple(sentence(said_by_core(clean(remark))) for remark in found.remarks),
        tuple(_stage(found, stage) for stage in STAGES),
        found.at_fault,
        _spectrum(spectra[0], regions.bands_hz) if spectra else None,
        profiles,
        tuple(_rival(found, item) for item in listed(found)),
        (found.gap.before, None if found.verdict == "no_gap" else found.gap.after, found.gap.floor),
        _closing(found),
        overlays_of(found),
        proposal_of(found, session),
        tuple(_offered(found)),
    )


def _offered(found: Diagnosis) -> Iterator[tuple[str, str, bool]]:
    for member in members_of(found):
        for name, share in ((member.effect, member.probability), *member.rivals):
            odds = f" ({percent(share)} %)" if np.isfinite(share) else ""
            yield name, sentence(_cause(name)).rstrip(".") + odds, name == member.effect


def _stage(found: Diagnosis, stage: Stage) -> StageStory:
    where = found.where
    if found.verdict == "no_gap":
        return StageStory(
            stage, 0.0, False, (_("The simulation as a whole leaves only noise: nothing speaks against it."),)
        )
    lines = [
        _("{finding}: {error} times the noise of the {channel}.").format(
            finding=sentence(said_by_core(item.what)).rstrip("."),
            error=number(item.error / item.floor, 3),
            channel=_(item.channel),
        )
        for item in where.findings
        if item.stage == stage
    ]
    lines += [
        _("The effect that explains the gap belongs here: {name}.").format(name=_cause(name))
        for name in found.combination
        if name in all_effects() and all_effects()[name].stage == stage
    ]
    if not lines and stage in where.evidence.nearest:
        times = where.evidence.nearest[stage]
        left = _("what it leaves is {times} times the noise").format(times=number(times, 3))
        lines.append(
            (
                _("Nothing speaks against it: {left}.")
                if times <= MARGIN
                else _("Nothing speaks against it: {left}, which is put down to another stage.")
            ).format(left=left)
        )
    return StageStory(
        stage, where.shares[stage], stage in found.at_fault, tuple(lines) or (_("Nothing speaks against it."),)
    )


def _spectrum(found: Spectrum, bands_hz: tuple[tuple[float, float], ...]) -> SpectrumStory:
    unit, scale = FINE_UNITS[found.channel]
    least = 0.1 * scale * float(np.sqrt(found.noise[0]))
    lines = {}
    for name in ("recorded", "residual", "linear", "even", "odd", "noise"):
        values = scale * np.sqrt(getattr(found, name))
        lines[name] = np.log10(np.where(values >= least, values, np.nan))
    bands = tuple((float(np.log10(max(low, 0.1))), float(np.log10(max(high, 0.1)))) for low, high in bands_hz)
    return SpectrumStory(found.channel, unit, np.log10(np.maximum(found.frequency_hz, 0.1)), lines, bands)


def _profile(found: Profile, scale: float) -> ProfileStory:
    known = np.isfinite(found.error)
    middle = 0.5 * scale * (found.edges[1:] + found.edges[:-1])
    error = np.log10(np.maximum(found.error[known], _LEAST_ERROR))
    return ProfileStory(middle[known], error, np.asarray(found.above[known]))


def _rival(found: Diagnosis, item: Ranked) -> Rival:
    known = all_effects().get(item.effect)
    low, high = item.closed_ci
    interval = (
        _(" ({low} to {high} %)").format(low=_percent(low), high=_percent(high))
        if np.isfinite(low) and np.isfinite(high)
        else ""
    )
    together = item.effect in found.combination and not np.isfinite(item.closed) and np.isfinite(found.gap.closed)
    closed = f"{_percent(item.closed)} %{interval}" if np.isfinite(item.closed) else _("cannot be told")
    if together:
        closed = _("{closed} % together").format(closed=_percent(found.gap.closed))
    return Rival(
        sentence(_cause(item.effect)).rstrip("."),
        item.stage,
        item.effect in found.combination,
        item.probability,
        _odds(found, item) if np.isfinite(item.probability) else "",
        closed,
        ", ".join(_cause(name) for name in item.indistinguishable),
        "" if known is None else sentence(said_by_core(known.signature)),
        "" if known is None else sentence(said_by_core(known.remedy)),
        _figures(found, item),
    )


def _odds(found: Diagnosis, item: Ranked) -> str:
    share = percent(item.probability)
    return _("{share} % alone").format(share=share) if judged_alone(found, item.effect) else f"{share} %"


def _figures(found: Diagnosis, item: Ranked) -> tuple[Fitted, ...]:
    values, stds = item.parameters, {}
    if item.effect in found.combination and found.best is not None:
        values = parameters_of(found.best, item.effect)
        try:
            stds = twin_of(found.best, "").stds
        except UnusableInputError:
            stds = {}
    known = all_effects().get(item.effect)
    about: dict[str, Any] = {} if known is None else {parameter.name: parameter for parameter in known.parameters}
    rows = []
    for name, value in values.items():
        meaning = about[name].meaning if name in about else ""
        label = sentence(said_by_core(meaning) or name.replace("_", " ")).rstrip(".")
        std = stds.get(f"{item.effect}.{name}")
        rows.append(Fitted(label, Estimate(value, std), about[name].unit if name in about else ""))
    return tuple(rows)


def _closing(found: Diagnosis) -> str:
    gap = found.gap
    if found.verdict == "no_gap":
        return _("There is no gap to close: what is left is the noise.")
    if not np.isfinite(gap.closed):
        return _("No candidate was fitted to it.")
    low, high = gap.closed_ci
    words = _("Closed: {closed}\u00a0% of what noise does not explain").format(closed=_percent(gap.closed))
    if np.isfinite(low) and np.isfinite(high):
        words += _(" (95 %: {low} to {high}\u00a0%)").format(low=_percent(low), high=_percent(high))
    words += _("; {predicted}\u00a0% predicted on the data used for the choice.").format(
        predicted=_percent(gap.announced)
    )
    if np.isfinite(found.ceiling):
        words += _(" The most that any model closed, physical or not: {ceiling}\u00a0%.").format(
            ceiling=_percent(found.ceiling)
        )
    return words


def _cause(name: str) -> str:
    return said_by_core(effect_words(name))


def _percent(share: float) -> str:
    return fixed(100.0 * share, 0)
