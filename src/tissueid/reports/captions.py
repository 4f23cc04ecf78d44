"""Captions of the figures: what to expect, and the values of this test in display units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from tissueid.analysis import Analysis
from tissueid.analysis.curves.plot import Array
from tissueid.analysis.curves.signals import lost_samples
from tissueid.analysis.curves.validation import Prediction, power_edge
from tissueid.formatting import fixed, number, with_unit
from tissueid.identification import engine_label
from tissueid.identification.engines.spectral import SpectralModel
from tissueid.identification.second_order_fit import SecondOrderFit
from tissueid.language import _, marked
from tissueid.messages import Message, translated
from tissueid.records import Record
from tissueid.sessions import Test
from tissueid.units import display_unit

NO_HELD_OUT_OUTPUT = Message("report.no_held_out_output", "no held-out output was received")


def joined(*parts: str) -> str:
    """Return the parts of a caption that are not empty as one text."""
    return " ".join(part for part in parts if part)


def findings(texts: Sequence[str]) -> str:
    """Return the findings of an engine as sentences in the active language."""
    said = [translated(text) for text in texts]
    return joined(*(f"{text[:1].upper()}{text[1:].rstrip('.')}." for text in said))


def signals(test: Test) -> str:
    """Return the caption of the signals over time."""
    text = [
        _(
            "After a steady preload (shaded) the stimulus should look like noise of even strength, and the position "
            "should swing about one level without drifting."
        )
    ]
    if "voltage" not in test.signals and "command" not in test.signals:
        text.append(translated(Message("record.no_voltage", "The voltage was not recorded.")))
    lost = int(lost_samples(test).sum())
    received = _("All {samples} samples were received.")
    if lost:
        received = _("{lost} of {samples} samples were not received; they are marked, and left out of every fit.")
    return " ".join([*text, received.format(lost=lost, samples=test.samples)])


CORRELATIONS = marked(
    "Normalised. The autocorrelation of a white input is zero at every other lag, and its cross-correlation with the "
    "output is the impulse response."
)


def power(model: SpectralModel | None) -> str:
    """Return the caption of the power spectra."""
    text = [
        _("Voltage and force should be even up to the cut-off of the stimulus, then fall to the sensors’ noise floor.")
    ]
    if model is not None:
        edge = power_edge(model.spectra.frequency_hz, model.spectra.input_psd)
        inside = _("Here 99 % of the input’s power above that floor lies below {hertz} Hz.")
        text.append(inside.format(hertz=number(edge, 3)))
    return " ".join([*text, _("The position falls earlier, by the dynamics of coil and tissue.")])


def distributions(record: Record) -> str:
    """Return the caption of the distributions."""
    skew_in, skew_out = _skewness(record.input), _skewness(record.output)
    return _(
        "A linear system turns a Gaussian input (dashed) into a Gaussian output. Tissue that stiffens with depth leans "
        "the output over, so that its skewness differs from the input’s: here {skew_in} for the {input}, {skew_out} "
        "for the {output}."
    ).format(
        skew_in=fixed(skew_in, 2),
        input=_(record.input_name),
        skew_out=fixed(skew_out, 2),
        output=_(record.output_name),
    )


def _skewness(values: Array) -> float:
    centred = values[np.isfinite(values)]
    centred = centred - centred.mean()
    return float(np.mean(centred**3) / np.mean(centred**2) ** 1.5)


def prediction(analyses: Mapping[str, Analysis]) -> str:
    """Return the caption of the measured and predicted output."""
    scores = ", ".join(
        f"{engine_label(name)} {fixed(a.model.report.vaf_validation_percent, 1)} %" for name, a in analyses.items()
    )
    where = next((translated(a.validated_on) for a in analyses.values()), _("the held-out part"))
    return _(
        "A stretch of data that was not fitted; the models see the input alone. The lines should run through the dots, "
        "and the residual should show no pattern. Variance accounted for on {where}: {scores}."
    ).format(where=where, scores=scores)


def scatter(predictions: Sequence[Prediction]) -> str:
    """Return the caption of measured against predicted output."""
    text = _(
        "All held-out samples. They should hug the diagonal: a bend is a nonlinearity that the model lacks, a shift "
        "along the whole cloud is drift since the fitted part."
    )
    shifts = []
    for item in predictions:
        residual = item.residual[np.isfinite(item.residual)]
        unit, scale = display_unit(item.output_unit)
        if residual.size:
            shifts.append(with_unit(f"{item.label} {fixed(scale * float(residual.mean()), 3)}", unit))
    return " ".join([text, _("The mean shift is: {shifts}.").format(shifts=", ".join(shifts))]) if shifts else text


RESIDUALS = marked(
    "A model that explains everything but measurement noise leaves residuals inside the bands. Autocorrelation outside "
    "its band (shaded, ±1.96/√N) means that something with a memory is unexplained. Correlation with the input at "
    "positive lags means dynamics that the model lacks; those bands (lines) allow for the colour of both signals."
)


def second_order(fit: SecondOrderFit) -> str:
    """Return natural frequency and damping ratio of the dashed second-order curve as a sentence."""
    frequency_hz = fit.system.natural_frequency_rad_per_s / (2.0 * np.pi)
    return _(
        "The dashed second-order system has a natural frequency of {hertz} Hz and a damping ratio of {ratio}."
    ).format(hertz=number(frequency_hz, 3), ratio=fixed(fit.system.damping_ratio, 2))
