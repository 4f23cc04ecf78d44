"""Analyse a saved test in a thread: models, verdict, numbers and curves."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from tissueid.analysis import Analysis
from tissueid.analysis.curves.results import plots_of_test, record_plots
from tissueid.analysis.device_readings import STEP_KIND, recorded_readings
from tissueid.analysis.step_readings import NOT_COMPARABLE
from tissueid.app.findings import Findings, Number
from tissueid.app.words import in_words, sentence
from tissueid.errors import UnusableInputError
from tissueid.formatting import estimate, fixed, label_and_unit, plus_minus
from tissueid.identification import engine_label
from tissueid.identification.engines.wiener import Wiener
from tissueid.language import _, marked
from tissueid.messages import MISSING, translated
from tissueid.procedures.saved_test import analyse_test
from tissueid.reports.page import surface_of
from tissueid.reports.verdict import judge, linear_engine, linear_label, localized_engine, stiffness_range, visited
from tissueid.sessions import Session, Test
from tissueid.sessions.accepted_result import AcceptedResult, result_of
from tissueid.sessions.quality import quality_of
from tissueid.units import display_unit

_OF_WHAT = {
    "mass_kg": marked("coil and tissue"),
    "damping_n_s_per_m": marked("coil and tissue"),
    "stiffness_n_per_m": marked("tissue, at the measured depths"),
}


def identify(path: Path, session: Session, number: int | None) -> Findings:
    """Analyse one test; see :func:`tissueid.app.session_jobs.find`.

    Raises:
        UnusableInputError: the session holds no such test.
    """
    analysed = analyse_test(session, number)
    test, analyses = analysed.test, analysed.analyses
    refusals: dict[str, list[str]] = {}
    for name, why in analysed.refused.items():
        refusals.setdefault(why, []).append(engine_label(name))
    accepted, unread = _accepted(path, test)
    return Findings(
        path=path,
        session=session,
        test=test,
        analyses=analyses,
        quality=quality_of(test),
        verdict=judge(test, analyses),
        numbers=tuple(_numbers(analyses)),
        ended=how_it_ended(test),
        visited=translated(visited(analyses, surface_of(test))),
        cautions=tuple(
            sentence(f"{', '.join(dict.fromkeys(names))}: {translated(text)}") for text, names in refusals.items()
        ),
        unread=unread,
        plots=plots_of_test(analyses, linear_engine(analyses)),
        recorded=record_plots(test, analyses),
        accepted=accepted,
        refused=analysed.refused,
        readings=_readings(test),
    )


_SHOWN_READINGS = ("Ue", "Uv", "Uf", "Ur", "R2", "R5", "R6", "R7", "F", "D")


def _readings(test: Test) -> str:
    """Return the main readings of a step test as a line with what they can be compared with; empty for other tests."""
    if test.kind != STEP_KIND:
        return ""
    try:
        readings = recorded_readings(test)
    except UnusableInputError as error:
        return sentence(translated(error.message))
    shown = []
    for reading in (*readings.step, *readings.decay):
        if reading.definition.symbol in _SHOWN_READINGS and reading.estimate is not None:
            unit, scale = display_unit(reading.definition.si_unit)
            shown.append(f"{reading.definition.symbol} {plus_minus(reading.estimate, scale)} {unit}".rstrip())
    return "\n".join(
        [
            _("Readings for comparison with other probes: {readings}.").format(readings="; ".join(shown)),
            translated(NOT_COMPARABLE),
        ]
    )


def _accepted(path: Path, test: Test) -> tuple[AcceptedResult | None, tuple[str, ...]]:
    """Return the accepted result of the sitting of a test, and why it cannot be read where that is so."""
    try:
        return result_of(path.parent, test), ()
    except (UnusableInputError, OSError) as error:
        return None, (
            _("The accepted result of this sitting cannot be read: {problem}").format(problem=in_words(error)),
        )


def _numbers(analyses: Mapping[str, Analysis]) -> Iterator[Number]:
    """Mass, damping and stiffness of the linear fit; variance accounted for by the linear and the Wiener model."""
    linear = linear_engine(analyses) or ""
    parameters = analyses[linear].model.report.reportable_parameters if linear else {}
    for quantity, note in _OF_WHAT.items():
        if quantity in parameters:
            label, si_unit = label_and_unit(quantity)
            if parameters[quantity].std is None:
                yield Number(_(label), MISSING, "", _("not determined by this test"))
                continue
            unit, scale = display_unit(si_unit)
            value, deviation, power = estimate(parameters[quantity], scale)
            rest = " ".join(filter(None, [deviation and f"± {deviation}", power, unit]))
            said = _(note)
            if quantity == "stiffness_n_per_m" and localized_engine(analyses):
                said = stiffness_range(analyses[linear])
            yield Number(_(label), value, rest, said, parameters[quantity], si_unit, quantity)
    for engine, label in ((linear, linear_label(analyses)), (Wiener.name, _("Motion explained, nonlinear"))):
        if engine in analyses:
            report = analyses[engine].model.report
            note = _("held-out part; {vaf} % of the fitted part").format(vaf=fixed(report.vaf_percent, 1))
            yield Number(label, fixed(report.vaf_validation_percent, 1), "%", note)


def how_it_ended(test: Test) -> str:
    """Return status and completeness of a test as a sentence."""
    seconds = test.samples / test.sample_rate_hz
    lost = int(np.isnan(test.signals["position"]).sum()) if "position" in test.signals else 0
    missing = (
        _("{lost} of {samples} samples lost").format(lost=lost, samples=test.samples) if lost else _("no sample lost")
    )
    if test.status == "completed":
        return _("Completed: {seconds:.1f} s, {missing}.").format(seconds=seconds, missing=missing)
    quality = quality_of(test)
    if quality is not None and any(finding.code == "ended_early" for finding in quality.findings):
        return _("Recorded: {seconds:.1f} s, {missing}.").format(seconds=seconds, missing=missing)  # why is said there
    if test.status == "recovered":
        return _("Recovered after an interruption: {seconds:.1f} s, {missing}.").format(
            seconds=seconds, missing=missing
        )
    reason = sentence(translated(test.reason))
    return (
        _("Ended early after {seconds:.1f} s, {missing}. {reason}")
        .format(seconds=seconds, missing=missing, reason=reason)
        .strip()
    )
