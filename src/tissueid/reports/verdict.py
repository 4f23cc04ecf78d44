"""What a report says first: whether the measurement can be used, and the numbers that matter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tissueid.analysis import Analysis
from tissueid.identification.engines.wiener import WienerModel
from tissueid.language import _
from tissueid.reports.configured import surface_of
from tissueid.reports.signal_figures import lost_samples
from tissueid.sessions import Test
from tissueid.sessions.quality import HEADLINES, quality_of
from tissueid.sessions.quality import Verdict as QualityVerdict
from tissueid.wording import (
    engine_label,
    estimate,
    fixed,
    named_unit,
    people_unit,
)

Level = Literal["good", "check", "poor"]

EXPECTED_VAF_PERCENT = 70.0
"""The least that skin gives in a sound test (Chen 2010, Table 2.1: 70 to 95 %)."""
POOR_VAF_PERCENT = 50.0
LARGE_UNCERTAINTY = 0.10
"""Standard deviation over value beyond which mass, damping or stiffness is called uncertain."""
UNSTEADY_POINTS = 10.0
"""Points of VAF by which fitted and held-out parts may differ before the test is called unsteady."""
LOST_SHARE = 0.01
LIFTED_SHARE = 0.001
SURFACE_KNOWN_TO_M = 0.3e-3
"""How far the surface found at placing may be off."""

_SEVERITY: tuple[Level, ...] = ("good", "check", "poor")
_VERDICTS: dict[Level, QualityVerdict] = {"good": "good", "check": "look", "poor": "repeat"}
FROM_ELSEWHERE = "Do not rely on this measurement"
"""Headline of a poor test that was imported: it cannot be done again."""
NOT_JUDGED = "Not judged"
"""Headline of a test that the quality gate never saw and of which nothing else is doubtful."""
_LINEAR_FIRST = ("lms", "spectral")
_KEY_PARAMETERS = ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m", "gain", "natural_frequency_rad_per_s")


_Doubt = tuple[Level, str]


@dataclass(frozen=True)
class Verdict:
    """Whether a test can be used, and why not; a good one has remarks at most."""

    level: Level
    headline: str
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class KeyNumber:
    """One number of the verdict box, ready to be shown. ``std`` is "" where there is none."""

    label: str
    value: str
    std: str
    unit: str
    note: str


def judge(test: Test, analyses: Mapping[str, Analysis]) -> Verdict:
    """Judge a test by facts: how it ended, what was lost, how models do on data that they have not seen."""
    doubts = _doubts(test, analyses)
    level: Level = max((level for level, _reason in doubts), key=_SEVERITY.index, default="good")
    imported = level == "poor" and "source_format" in test.notes
    headline = FROM_ELSEWHERE if imported else HEADLINES[_VERDICTS[level]]
    if level == "good" and quality_of(test) is None:
        level, headline = "check", NOT_JUDGED
    return Verdict(level, headline, tuple(dict.fromkeys(reason for _level, reason in doubts)))


def _doubts(test: Test, analyses: Mapping[str, Analysis]) -> list[_Doubt]:
    """Remarks on a test, each with the best verdict that it leaves possible."""
    found: list[_Doubt] = []
    if test.status in ENDED_EARLY:
        found.append(("poor", _how_it_ended(test)))
    lost = int(lost_samples(test).sum())
    if lost > LOST_SHARE * test.samples:
        share = f"{100 * lost / test.samples:.1f} %"
        found.append(("check", f"{lost} of {test.samples} samples ({share}) were not received."))
    found += _gate(test)
    found += _poorly_explained(analyses)
    found += _uncertain(analyses)
    leading = linear_engine(analyses) or next(iter(analyses), None)
    if leading is not None:
        label = engine_label(leading)
        found += [("check", _sentence(f"{label}: {words}")) for words in analyses[leading].model.report.warnings]
    return found


ENDED_EARLY = {
    "aborted": "The test was ended early; only what was recorded until then is analysed.",
    "recovered": "The test was recovered after its recording was interrupted.",
}
"""Statuses of tests that do not count as a repeat, and what is said of them where the quality gate said nothing."""


def _how_it_ended(test: Test) -> str:
    """Say why a test ended early: in the words of the quality gate, so that a page has them once."""
    quality = quality_of(test)
    findings = quality.findings if quality is not None else ()
    return next((item.words for item in findings if item.code == "ended_early"), ENDED_EARLY[test.status])


def _sentence(text: str) -> str:
    return text if text.endswith((".", "!", "?")) else f"{text}."


_GATE: dict[str, Level] = {"good": "good", "look": "check", "repeat": "poor"}


def _gate(test: Test) -> list[_Doubt]:
    """What the quality gate said when the test ended; of a test that it never saw, what the position says."""
    quality = quality_of(test)
    if quality is None:
        return _lifted_off(test)
    if quality.verdict == "good":
        return []
    worst = quality.findings[0]
    return [(_GATE[quality.verdict], worst.words)]


def _lifted_off(test: Test) -> list[_Doubt]:
    """What the position says of contact, where the surface is known."""
    if "position" not in test.signals or not np.isfinite(surface_of(test)):
        return []
    position = test.signals["position"][round(test.preload_s * test.sample_rate_hz) :]
    position = position[np.isfinite(position)]
    above = float(np.mean(position < test.surface_position_m - SURFACE_KNOWN_TO_M)) if position.size else 0.0
    if above <= LIFTED_SHARE:
        return []
    return [("check", f"The probe stood above the surface for {100 * above:.1f} % of the time: it left the tissue.")]


def _poorly_explained(analyses: Mapping[str, Analysis]) -> list[_Doubt]:
    """What the best model on unseen data says of the test."""
    scores = {
        name: score
        for name, a in analyses.items()
        if (score := a.model.report.vaf_validation_percent) is not None and np.isfinite(score)
    }
    if not scores:
        return [("poor", "No model could be tried on data that it had not seen.")]
    name = max(scores, key=lambda engine: scores[engine])
    unseen, seen = scores[name], analyses[name].model.report.vaf_percent
    found: list[_Doubt] = []
    if unseen < POOR_VAF_PERCENT:
        found.append(("poor", f"No model accounts for more than {fixed(unseen, 0)} % of motion that it had not seen."))
    elif unseen < EXPECTED_VAF_PERCENT:
        usual = "skin usually gives 70 to 95 %"
        found.append(("check", f"The best model accounts for {fixed(unseen, 0)} % of unseen motion; {usual}."))
    both = f"({engine_label(name)}: {fixed(seen, 0)} % of the fitted motion, {fixed(unseen, 0)} % of the unseen)"
    if unseen - seen > UNSTEADY_POINTS:
        found.append(("check", f"The fitted part is harder to explain than the held-out part, as under drift {both}."))
    if seen - unseen > UNSTEADY_POINTS:
        found.append(("check", f"The models do worse on unseen motion than on what they were fitted to {both}."))
    return found


def _uncertain(analyses: Mapping[str, Analysis]) -> list[_Doubt]:
    name = linear_engine(analyses)
    if name is None:
        return []
    wide = []
    for parameter in ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m"):
        found = analyses[name].model.report.parameters.get(parameter)
        if found is not None and (found.std is None or found.std > LARGE_UNCERTAINTY * abs(found.value)):
            wide.append(named_unit(parameter)[0].lower())
    if not wide:
        return []
    return [("check", f"Uncertain by more than {100 * LARGE_UNCERTAINTY:.0f} %: {', '.join(wide)}.")]


def linear_engine(analyses: Mapping[str, Analysis]) -> str | None:
    """The engine whose second-order parameters lead the report: LMS, or else the first linear one that has any."""
    ordered = [name for name in _LINEAR_FIRST if name in analyses] + list(analyses)
    for name in ordered:
        if analyses[name].model.report.parameters and not isinstance(analyses[name].model, WienerModel):
            return name
    return None


def key_numbers(analyses: Mapping[str, Analysis]) -> tuple[KeyNumber, ...]:
    """Mass, damping and stiffness of the linear fit, and the scores of the linear and the Wiener model."""
    numbers: list[KeyNumber] = []
    linear = linear_engine(analyses)
    wiener = next((name for name, a in analyses.items() if isinstance(a.model, WienerModel)), None)
    source = linear or wiener
    if source is not None:
        parameters = analyses[source].model.report.reportable_parameters
        ratio = parameters.get("damping_ratio")
        for name in _KEY_PARAMETERS:
            if name not in parameters:
                continue
            label, si_unit = named_unit(name)
            unit, scale = people_unit(si_unit)
            value, std, power = estimate(parameters[name], scale)
            note = "" if std else _("without an estimate of its uncertainty")
            if name == "stiffness_n_per_m" and (spring := analyses[source].external_spring_n_per_m):
                note = _("external spring of {spring:g} N/m subtracted").format(spring=spring)
            if name == "natural_frequency_rad_per_s" and ratio is not None:
                note = _("damping ratio {value}").format(value=fixed(ratio.value, 2))
            numbers.append(KeyNumber(_(label), value, std, f"{power} {unit}".strip(), note))
    for label, engine in ((_("Motion explained, linear"), linear), (_("Motion explained, nonlinear"), wiener)):
        if engine is None:
            continue
        report = analyses[engine].model.report
        numbers.append(
            KeyNumber(
                label,
                fixed(report.vaf_validation_percent, 1),
                "",
                "%" if report.vaf_validation_percent is not None else "",
                _("of the check part; {percent} % of the rest").format(percent=fixed(report.vaf_percent, 1)),
            )
        )
    return tuple(numbers)


def visited(analyses: Mapping[str, Analysis], surface_position_m: float) -> str:
    """Over which output range the numbers are averages, as a sentence; empty when nobody knows."""
    analysis = next(iter(analyses.values()), None)
    if analysis is None:
        return ""
    output = analysis.record.output[analysis.fit_part]
    output = output[np.isfinite(output)]
    if output.size == 0:
        return ""
    unit, scale = people_unit(analysis.record.output_unit)
    low, high = (float(scale * np.quantile(output, q)) for q in (0.005, 0.995))
    text = f"Averages over {fixed(low, 1)} to {fixed(high, 1)} {unit} of {analysis.record.output_name}"
    if np.isfinite(surface_position_m) and analysis.record.output_name == "position":
        surface = scale * surface_position_m
        text += f", which is {fixed(low - surface, 1)} to {fixed(high - surface, 1)} {unit} below the surface"
    return f"{text}."
