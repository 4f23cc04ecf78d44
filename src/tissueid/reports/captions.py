"""What stands under the figures: what one should see, and what is seen here. In people's units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from tissueid.analysis import Analysis
from tissueid.identification.engines.spectral import SpectralModel
from tissueid.identification.second_order_fit import SecondOrderFit
from tissueid.records import Record
from tissueid.reports.diagnostics import Prediction, power_edge
from tissueid.reports.signal_figures import lost_samples, skewness
from tissueid.sessions import Test
from tissueid.wording import engine_label, fixed, number, people_unit, with_unit


def signals(test: Test) -> str:
    """Under the signals over time."""
    text = "After a steady preload (shaded) the stimulus should look like noise of even strength"
    text += ", and the position should swing about one level without drifting."
    if "voltage" not in test.signals and "command" not in test.signals:
        text += " The voltage was not recorded."
    lost = int(lost_samples(test).sum())
    if lost:
        return f"{text} {lost} of {test.samples} samples were not received; they are marked, and left out of every fit."
    return f"{text} All {test.samples} samples were received."


def power(model: SpectralModel | None) -> str:
    """Under the power spectra."""
    text = "Voltage and force should be even up to the cut-off of the stimulus, then fall to the sensors’ noise floor."
    if model is not None:
        edge = power_edge(model.spectra.frequency_hz, model.spectra.input_psd)
        text += f" Here 99 % of the input’s power above that floor lies below {number(edge, 3)} Hz."
    return text + " The position falls earlier, by the dynamics of coil and tissue."


def distributions(record: Record) -> str:
    """Under the distributions."""
    skew_in, skew_out = skewness(record.input), skewness(record.output)
    return (
        "A linear system turns a Gaussian input (dashed) into a Gaussian output. Tissue that stiffens with depth leans "
        f"the output over, so that its skewness differs from the input’s: here {fixed(skew_in, 2)} for the "
        f"{record.input_name}, {fixed(skew_out, 2)} for the {record.output_name}."
    )


def prediction(analyses: Mapping[str, Analysis]) -> str:
    """Under the measured and predicted stretch."""
    scores = ", ".join(
        f"{engine_label(name)} {fixed(a.model.report.vaf_validation_percent, 1)} %" for name, a in analyses.items()
    )
    where = next((a.validated_on for a in analyses.values()), "the held-out part")
    return (
        "A stretch of data that was not fitted; the models see the input alone. The lines should run through the dots, "
        f"and the residual should show no pattern. Variance accounted for on {where}: {scores}."
    )


def scatter(predictions: Sequence[Prediction]) -> str:
    """Under the scatter of measured against predicted."""
    text = (
        "All held-out samples. They should hug the diagonal: a bend is a nonlinearity that the model lacks, a shift "
        "along the whole cloud is drift since the fitted part."
    )
    shifts = []
    for item in predictions:
        residual = item.residual[np.isfinite(item.residual)]
        unit, scale = people_unit(item.output_unit)
        if residual.size:
            shifts.append(with_unit(f"{item.label} {fixed(scale * float(residual.mean()), 3)}", unit))
    return f"{text} The mean shift is: {', '.join(shifts)}." if shifts else text


RESIDUALS = (
    "A model that explains everything but measurement noise leaves residuals inside the bands. Autocorrelation outside "
    "its band (shaded, ±1.96/√N) means that something with a memory is unexplained. Correlation with the input at "
    "positive lags means dynamics that the model lacks; those bands (lines) allow for the colour of both signals."
)


def second_order(fit: SecondOrderFit) -> str:
    """What the dashed curve under a linear figure is."""
    frequency_hz = fit.system.natural_frequency_rad_per_s / (2.0 * np.pi)
    return (
        f"The dashed second-order system has a natural frequency of {number(frequency_hz, 3)} Hz and a damping ratio "
        f"of {fixed(fit.system.damping_ratio, 2)}."
    )
