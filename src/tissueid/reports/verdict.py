"""What a report says first: whether the measurement can be used, and the numbers that matter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tissueid.analysis import Analysis
from tissueid.analysis.curves.signals import lost_samples
from tissueid.analysis.split import SURFACE_KNOWN_TO_M
from tissueid.formatting import estimate, fixed, label_and_unit, number
from tissueid.identification import label_of, report_engines
from tissueid.identification.engines.localized import LocalizedModel
from tissueid.identification.engines.wiener import WienerModel
from tissueid.language import _, marked
from tissueid.messages import Listing, Message
from tissueid.reports.page import surface_of
from tissueid.sessions import Test
from tissueid.sessions.quality import HEADLINES, quality_of
from tissueid.sessions.quality import Verdict as QualityVerdict
from tissueid.units import display_unit

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

_SEVERITY: tuple[Level, ...] = ("good", "check", "poor")
_VERDICTS: dict[Level, QualityVerdict] = {"good": "good", "check": "look", "poor": "repeat"}
FROM_ELSEWHERE = marked("Do not rely on this measurement")
"""Headline of a poor test that was imported: it cannot be done again."""
NOT_JUDGED = marked("Not judged")
"""Headline of a test that the quality gate never judged and that has no other problem."""
_KEY_PARAMETERS = (
    "mass_kg",
    "damping_n_s_per_m",
    "stiffness_n_per_m",
    "gain",
    "natural_frequency_rad_per_s",
    "relaxation_time_s",
    "loading_stiffness_n_per_m",
    "unloading_stiffness_n_per_m",
)


_UNCERTAIN = {
    "mass_kg": marked("mass"),
    "damping_n_s_per_m": marked("damping"),
    "stiffness_n_per_m": marked("stiffness"),
}
"""Parameters whose uncertainty counts, by their names within a sentence."""
_Doubt = tuple[Level, str]


@dataclass(frozen=True)
class Verdict:
    """Whether a test can be used, and the reasons against it."""

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
    """Return the verdict on a test, from its end, its lost samples and the held-out scores of the models."""
    doubts = _doubts(test, analyses)
    level: Level = max((level for level, _reason in doubts), key=_SEVERITY.index, default="good")
    imported = level == "poor" and "source_format" in test.notes
    headline = FROM_ELSEWHERE if imported else HEADLINES[_VERDICTS[level]]
    if level == "good" and quality_of(test) is None:
        level, headline = "check", NOT_JUDGED
    return Verdict(level, headline, tuple(dict.fromkeys(reason for _level, reason in doubts)))


def _doubts(test: Test, analyses: Mapping[str, Analysis]) -> list[_Doubt]:
    """Remarks on a test, each with the best verdict that it leaves possible."""
    doubts: list[_Doubt] = []
    if test.status in ENDED_EARLY:
        doubts.append(("poor", _how_it_ended(test)))
    lost = int(lost_samples(test).sum())
    if lost > LOST_SHARE * test.samples:
        values = {"lost": lost, "samples": test.samples, "percent": 100 * lost / test.samples}
        message = Message(
            "verdict.samples_lost", "{lost} of {samples} samples ({percent:.1f} %) were not received.", **values
        )
        doubts.append(("check", message))
    doubts += _quality_doubts(test)
    doubts += _poorly_explained(analyses)
    doubts += _uncertain(analyses)
    leading = linear_engine(analyses) or next(iter(analyses), None)
    if leading is not None:
        label = label_of(leading)
        doubts += [
            ("check", Message("verdict.engine_warning", "{engine}: {warning}.", engine=label, warning=warning))
            for warning in analyses[leading].model.report.warnings
        ]
    return doubts


ENDED_EARLY = {
    "aborted": Message("verdict.aborted", "The test ended early; the analysis uses the recorded part."),
    "recovered": Message(
        "verdict.recovered", "The recording was interrupted; the test was recovered from its journal."
    ),
}
"""Statuses of tests that do not count as a repeat, and what is said of them where the quality gate said nothing."""


def _how_it_ended(test: Test) -> str:
    """Say why a test ended early: in the words of the quality gate, so that a page has them once."""
    quality = quality_of(test)
    findings = quality.findings if quality is not None else ()
    return next((item.message for item in findings if item.code == "ended_early"), ENDED_EARLY[test.status])


_GATE: dict[str, Level] = {"good": "good", "look": "check", "repeat": "poor"}


def _quality_doubts(test: Test) -> list[_Doubt]:
    """Return the doubts of the quality gate; without a stored result, those about contact by the position."""
    quality = quality_of(test)
    if quality is None:
        return _lifted_off(test)
    if quality.verdict == "good":
        return []
    worst = quality.findings[0]
    return [(_GATE[quality.verdict], worst.message)]


def _lifted_off(test: Test) -> list[_Doubt]:
    """Return the doubts about lost contact by the position, where the surface is known."""
    if "position" not in test.signals or not np.isfinite(surface_of(test)):
        return []
    position = test.signals["position"][round(test.preload_s * test.sample_rate_hz) :]
    position = position[np.isfinite(position)]
    above = float(np.mean(position < test.surface_position_m - SURFACE_KNOWN_TO_M)) if position.size else 0.0
    if above <= LIFTED_SHARE:
        return []
    message = Message(
        "verdict.probe_lifted",
        "The probe was above the surface for {percent:.1f} % of the time: it left the tissue.",
        percent=100 * above,
    )
    return [("check", message)]


def _poorly_explained(analyses: Mapping[str, Analysis]) -> list[_Doubt]:
    """Return the doubts about a low held-out score of the best model."""
    scores = {
        name: score
        for name, a in analyses.items()
        if (score := a.model.report.vaf_validation_percent) is not None and np.isfinite(score)
    }
    if not scores:
        return [("poor", Message("verdict.not_validated", "No model could be validated on held-out data."))]
    name = max(scores, key=lambda engine: scores[engine])
    unseen, seen = scores[name], analyses[name].model.report.vaf_percent
    doubts: list[_Doubt] = []
    if unseen <= 0.0:
        doubts.append(("poor", Message("verdict.predicts_nothing", "No model predicts the held-out motion.")))
    elif unseen < POOR_VAF_PERCENT:
        message = Message(
            "verdict.vaf_poor",
            "No model accounts for more than {percent:.0f} % of the held-out motion.",
            percent=unseen,
        )
        doubts.append(("poor", message))
    elif unseen < EXPECTED_VAF_PERCENT:
        message = Message(
            "verdict.vaf_low",
            "The best model accounts for {percent:.0f} % of held-out motion; skin usually gives 70 to 95 %.",
            percent=unseen,
        )
        doubts.append(("check", message))
    both = Message(
        "verdict.both_scores",
        "{engine}: {seen:.0f} % of the fitted motion, {unseen:.0f} % of the held-out motion",
        engine=label_of(name),
        seen=seen,
        unseen=unseen,
    )
    if unseen - seen > UNSTEADY_POINTS:
        message = Message(
            "verdict.drift",
            "The fitted part is harder to explain than the held-out part, which drift can cause ({scores}).",
            scores=both,
        )
        doubts.append(("check", message))
    if seen - unseen > UNSTEADY_POINTS:
        message = Message(
            "verdict.worse_held_out",
            "The models fit the held-out motion worse than the fitted motion ({scores}).",
            scores=both,
        )
        doubts.append(("check", message))
    return doubts


def _uncertain(analyses: Mapping[str, Analysis]) -> list[_Doubt]:
    name = linear_engine(analyses)
    if name is None:
        return []
    wide = []
    for parameter, label in _UNCERTAIN.items():
        fitted = analyses[name].model.report.parameters.get(parameter)
        if fitted is not None and (fitted.std is None or fitted.std > LARGE_UNCERTAINTY * abs(fitted.value)):
            wide.append(label)
    if not wide:
        return []
    values = {"percent": 100 * LARGE_UNCERTAINTY, "names": Listing(tuple(wide))}
    return [("check", Message("verdict.uncertain", "Uncertain by more than {percent:.0f} %: {names}.", **values))]


def localized_engine(analyses: Mapping[str, Analysis]) -> str | None:
    """The engine with a linear fit at each of several levels, if one was run."""
    return next((name for name, a in analyses.items() if isinstance(a.model, LocalizedModel)), None)


def stiffness_range(analysis: Analysis) -> str:
    """Say between which values the stiffness at the levels of a localized test lies, without an external spring."""
    profile = analysis.depth_profile()
    values = np.array([]) if profile is None else profile.stiffness[np.isfinite(profile.stiffness)]
    if values.size == 0:
        return _("tissue, depths visited")
    unit, scale = display_unit("N/m")
    return _("at the middle level; {low} to {high} {unit} over all levels").format(
        low=number(scale * float(values.min()), 3), high=number(scale * float(values.max()), 3), unit=unit
    )


def linear_engine(analyses: Mapping[str, Analysis]) -> str | None:
    """The engine whose second-order parameters lead the report.

    That is the localized one of a localized test, else LMS, or else the first linear one that has any.
    """
    if levels := localized_engine(analyses):
        return levels
    ordered = [name for name in report_engines() if name in analyses] + list(analyses)
    for name in ordered:
        if analyses[name].model.report.parameters and not isinstance(analyses[name].model, WienerModel):
            return name
    return None


def linear_label(analyses: Mapping[str, Analysis]) -> str:
    """Return the label of the score of the engine that leads the report."""
    return _("Motion explained, by level") if localized_engine(analyses) else _("Motion explained, linear")


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
            label, si_unit = label_and_unit(name)
            unit, scale = display_unit(si_unit)
            value, std, power = estimate(parameters[name], scale)
            note = "" if std else _("without an estimate of its uncertainty")
            if name == "stiffness_n_per_m" and localized_engine(analyses):
                note = stiffness_range(analyses[source])
            if name == "stiffness_n_per_m" and (spring := analyses[source].external_spring_n_per_m):
                note = _("external spring of {spring:g} N/m subtracted").format(spring=spring)
            if name == "natural_frequency_rad_per_s" and ratio is not None:
                note = _("damping ratio {value}").format(value=fixed(ratio.value, 2))
            numbers.append(KeyNumber(_(label), value, std, f"{power} {unit}".strip(), note))
    explained = linear_label(analyses)
    for label, engine in ((explained, linear), (_("Motion explained, nonlinear"), wiener)):
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


_VISITED_DEPTH = marked(
    "Averages over {low:.1f} to {high:.1f} {unit} of position, which is {above:.1f} to {below:.1f} {unit} below the "
    "surface."
)


def visited(analyses: Mapping[str, Analysis], surface_position_m: float) -> str:
    """Return the range of the output over which the parameters are averages, as a sentence; "" if it is unknown."""
    analysis = next(iter(analyses.values()), None)
    if analysis is None:
        return ""
    output = analysis.record.output[analysis.fit_part]
    output = output[np.isfinite(output)]
    if output.size == 0:
        return ""
    unit, scale = display_unit(analysis.record.output_unit)
    low, high = (float(scale * np.quantile(output, q)) for q in (0.005, 0.995))
    values = {"low": low, "high": high, "unit": unit, "output": analysis.record.output_name}
    if np.isfinite(surface_position_m) and analysis.record.output_name == "position":
        surface = scale * surface_position_m
        values |= {"above": low - surface, "below": high - surface}
        return Message("verdict.visited_depth", _VISITED_DEPTH, **values)
    return Message("verdict.visited", "Averages over {low:.1f} to {high:.1f} {unit} of {output}.", **values)
