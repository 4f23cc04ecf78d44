"""Least squares: a finite impulse response from correlations, and a second-order system."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from tissueid.identification.base import Array, Family, option
from tissueid.identification.impulse_response import (
    convolve_at_rest,
    factor_input,
    kernel_std,
    memory_warnings,
    segment_average,
    with_extra_memory,
)
from tissueid.identification.memory import FirModel, MemoryEngine
from tissueid.identification.preparation import prepare
from tissueid.identification.registry import engine
from tissueid.identification.second_order_fit import fit_second_order
from tissueid.language import marked
from tissueid.records import Record


@dataclass(frozen=True, eq=False)
class LmsModel(FirModel):
    """The response with its standard deviations ``impulse_response_std`` (lags,)."""

    impulse_response_std: Array


@engine
class Lms(MemoryEngine):
    """LMS engine.

    Assumes a linear system whose response decays within ``memory``, and output noise that is independent of the input.
    """

    name: ClassVar[str] = "lms"
    label: ClassVar[str] = "LMS"
    title: ClassVar[str] = marked(
        "Least-squares finite impulse response (Chen 2010, 3.1.3), with mass, damping and stiffness."
    )
    family: ClassVar[Family] = Family.LINEAR
    in_report: ClassVar[bool] = True

    method: Literal["toeplitz", "svd"] = option(
        "toeplitz",
        marked("Method"),
        marked("Levinson's recursion (toeplitz), or the pseudo-inverse of the correlation matrix (svd)"),
    )
    tolerance: float = option(
        1e-12,
        marked("Tolerance"),
        marked("With svd: singular values below this share of the largest are dropped"),
        ge=0.0,
        lt=1.0,
    )
    taper: float = option(
        0.05,
        marked("Taper"),
        marked("Share of the samples over which both signals fade in and out (C.1.1)"),
        ge=0.0,
        le=1.0,
    )
    segment: float | None = option(
        None,
        marked("Segments"),
        marked("Length of segments, s, whose responses are averaged as in C.1.1; the whole record if not given"),
        gt=0.0,
        le=100.0,
    )
    most_condition: float = option(
        1e7,
        marked("Largest condition number"),
        marked("With segments: those with a larger condition number are rejected"),
        gt=1.0,
        le=1e18,
    )

    def fit(self, record: Record, fit_part: slice | None = None) -> LmsModel:
        """Fit the impulse response and the second-order system to a record, or to a contiguous part of it.

        Raises:
            UnusableInputError: nothing varies, too few samples, or a memory longer than the part.
        """
        prepared = prepare(record, fit_part, self.memory_s)
        lags = prepared.memory_samples
        solved = factor_input(
            prepared if self.taper == 0.0 else with_extra_memory(prepared),
            pseudo_inverse=self.method == "svd",
            tolerance=self.tolerance,
            taper=self.taper,
        )
        kernel = solved.kernel(record.output)[:lags]
        details: dict[str, float] = {}
        if self.segment is not None:
            segments = segment_average(prepared, self.segment, self.most_condition, self.tolerance)
            kernel = segments.kernel
            details = {"segments": float(segments.accepted), "rejected_segments": float(segments.rejected)}
        modelled = prepared.output_mean + convolve_at_rest(kernel, solved.input)
        residuals = np.where(prepared.used, record.output - modelled, np.nan)
        if self.segment is not None:
            std = segments.std
        else:
            std = kernel_std(solved.inverse, solved.input[prepared.part], residuals[prepared.part])[:lags]
        second_order = fit_second_order(record, prepared.used, self.hold)

        rate = record.sample_rate_hz
        return LmsModel(
            report=self.report(
                record,
                prepared.used,
                modelled,
                lags + 1,
                parameters=second_order.parameters | second_order.impulse_coefficients,
                warnings=(*prepared.warnings, *solved.warnings, *memory_warnings(kernel), *second_order.warnings),
                details={
                    "condition_number": solved.condition,
                    "vaf_parametric_percent": second_order.vaf_percent,
                }
                | details,
            ),
            sample_rate_hz=rate,
            memory_samples=lags,
            impulse_response=kernel * rate,
            impulse_response_std=std * rate,
            lag_s=np.arange(lags) / rate,
            input_mean=prepared.input_mean,
            output_mean=prepared.output_mean,
            second_order=second_order,
        )
