"""Analyse a saved test in a thread: models, verdict, numbers and curves."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np

from tissueid.analysis import Analysis
from tissueid.app.findings import Curves, Findings, Number
from tissueid.app.words import in_words, sentence
from tissueid.errors import UnusableInputError
from tissueid.formatting import estimate, fixed, label_and_unit
from tissueid.identification import engine_label
from tissueid.identification.base import Mask
from tissueid.identification.engines.lms import Lms, LmsModel
from tissueid.identification.engines.spectral import SpectralModel
from tissueid.identification.engines.wiener import Wiener, WienerModel
from tissueid.language import _, marked
from tissueid.messages import Message, translated
from tissueid.procedures.report import analyse_test
from tissueid.reports.configured import surface_of
from tissueid.reports.verdict import judge, linear_engine, visited
from tissueid.sessions import Session, Test
from tissueid.sessions.accepted_result import AcceptedResult, result_of
from tissueid.sessions.quality import quality_of
from tissueid.units import display_unit

MM = 1e3
MS = 1e3
_OF_WHAT = {
    "mass_kg": marked("coil and tissue"),
    "damping_n_s_per_m": marked("coil and tissue"),
    "stiffness_n_per_m": marked("tissue, depths visited"),
}
_CONFIDENCE = 1.96
_EXCITED = 0.03
"""Smallest power density of an excited frequency, as a share of the input's maximum."""
_FINE = 300
_MOST_DOTS = 2000
_STRETCH_S = 0.4
"""Length of the held-out motion that is plotted, s: enough periods to judge by eye, few enough to distinguish."""


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
        cautions=(
            *(sentence(f"{', '.join(dict.fromkeys(names))}: {translated(text)}") for text, names in refusals.items()),
            *unread,
        ),
        impulse=_drawn(_impulse, analyses),
        bode=_drawn(_bode, analyses),
        phase=_drawn(_phase, analyses),
        nonlinearity=_drawn(_nonlinearity, analyses),
        prediction=_drawn(_prediction, analyses),
        accepted=accepted,
        refused=analysed.refused,
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
            unit, scale = display_unit(si_unit)
            value, deviation, power = estimate(parameters[quantity], scale)
            rest = " ".join(filter(None, [deviation and f"± {deviation}", power, unit]))
            yield Number(_(label), value, rest, _(note), parameters[quantity], si_unit, quantity)
    for engine, label in ((linear, _("Motion explained, linear")), (Wiener.name, _("Motion explained, nonlinear"))):
        if engine in analyses:
            report = analyses[engine].model.report
            note = _("of the check part; {vaf} % of the rest").format(vaf=fixed(report.vaf_percent, 1))
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


def _drawn(draw: Callable[[Mapping[str, Analysis]], Curves], analyses: Mapping[str, Analysis]) -> Curves:
    try:
        return draw(analyses)
    except UnusableInputError as error:
        nothing = np.zeros(0)
        return Curves(nothing, nothing, nothing, nothing, missing=sentence(translated(error.message)))


def _impulse(analyses: Mapping[str, Analysis]) -> Curves:
    """Lag in ms, response in mm/(N s), with one standard deviation to either side."""
    model = next((a.model for a in analyses.values() if isinstance(a.model, LmsModel)), None)
    if model is None:
        raise UnusableInputError(Message("result.no_impulse_response", "no impulse response could be estimated"))
    response, std = MM * model.impulse_response, MM * model.impulse_response_std
    fine_s = np.linspace(0.0, float(model.lag_s[-1]), _FINE)
    fitted = MM * model.second_order.sign * model.second_order.system.impulse_response(fine_s)
    return Curves(MS * model.lag_s, response, MS * fine_s, fitted, response - std, response + std)


def _excited(analyses: Mapping[str, Analysis]) -> tuple[SpectralModel, Mask]:
    """Return the spectral model, and a mask of the frequencies at which its input has power."""
    model = next((a.model for a in analyses.values() if isinstance(a.model, SpectralModel)), None)
    if model is None:
        raise UnusableInputError(Message("result.no_transfer_function", "no transfer function could be estimated"))
    spectra = model.spectra
    shown = (spectra.frequency_hz > 0.0) & (spectra.input_psd > _EXCITED * spectra.input_psd[1:].max())
    shown &= (spectra.magnitude > 0.0) & np.isfinite(spectra.magnitude_std)
    if shown.sum() < 3:
        raise UnusableInputError(
            Message(
                "result.few_frequencies",
                "the input has power at fewer than three frequencies: use noise or a multisine",
            )
        )
    return model, shown


def _phase(analyses: Mapping[str, Analysis]) -> Curves:
    """Decimal logarithm of frequency in Hz against phase in degrees, with a 95 % band, where there is input."""
    model, shown = _excited(analyses)
    spectra = model.spectra
    frequency = np.log10(spectra.frequency_hz[shown])
    phase = np.degrees(spectra.phase_rad[shown])
    spread = _CONFIDENCE * np.degrees(spectra.phase_std_rad[shown])
    fine = np.linspace(frequency[0], frequency[-1], _FINE)
    response = model.second_order.sign * model.second_order.system.frequency_response(10.0**fine)
    fitted = np.degrees(np.unwrap(np.angle(response)))
    fitted += 360.0 * round((phase[0] - fitted[0]) / 360.0)
    return Curves(frequency, phase, fine, fitted, phase - spread, phase + spread)


def _bode(analyses: Mapping[str, Analysis]) -> Curves:
    """Decimal logarithms of frequency in Hz and compliance in mm/N, with a 95 % band, where there is input."""
    model, shown = _excited(analyses)
    spectra = model.spectra
    frequency = np.log10(spectra.frequency_hz[shown])
    magnitude = np.log10(MM * spectra.magnitude[shown])
    spread = np.log10(1.0 + _CONFIDENCE * spectra.magnitude_std[shown] / spectra.magnitude[shown])
    fine = np.linspace(frequency[0], frequency[-1], _FINE)
    fitted = np.log10(MM * np.abs(model.second_order.system.frequency_response(10.0**fine)))
    return Curves(frequency, magnitude, fine, fitted, magnitude - spread, magnitude + spread)


def _nonlinearity(analyses: Mapping[str, Analysis]) -> Curves:
    """Return the static nonlinearity: position in mm against the output of the linear stage in N."""
    analysis = analyses.get(Wiener.name)
    if analysis is None or not isinstance(analysis.model, WienerModel):
        raise UnusableInputError(Message("result.no_nonlinearity", "no static nonlinearity could be estimated"))
    model, record = analysis.model, analysis.record[analysis.fit_part]
    z = model.linear_output(record.input)
    known = np.isfinite(z) & np.isfinite(record.output)
    if known.sum() < 2:
        raise UnusableInputError(
            Message(
                "result.no_samples",
                "the Wiener model cannot be simulated: no sample has an uninterrupted input over the memory",
            )
        )
    z, measured = z[known], record.output[known]
    some = slice(None, None, max(1, -(-z.size // _MOST_DOTS)))
    fine = np.linspace(z.min(), z.max(), _FINE)
    return Curves(z[some], MM * measured[some], fine, MM * model.nonlinearity(fine))


def _prediction(analyses: Mapping[str, Analysis]) -> Curves:
    """Time in s against position in mm: a stretch of unseen motion, and what the Wiener model says of it."""
    analysis = analyses.get(Wiener.name) or analyses.get(Lms.name)
    if analysis is None:
        raise UnusableInputError(Message("result.no_prediction", "no model could be simulated on held-out data"))
    record = analysis.held_out_record
    shown = slice(analysis.held_out.start, analysis.held_out.start + round(_STRETCH_S * record.sample_rate_hz))
    measured, predicted = record.output[shown], analysis.model.simulate(record.input)[shown]
    time_s = np.arange(measured.size) / record.sample_rate_hz
    return Curves(time_s, MM * measured, time_s, MM * predicted)
