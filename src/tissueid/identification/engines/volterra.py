"""Volterra kernels: plain least squares as in the thesis, regularised, or in a Laguerre basis."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar, Literal

import numpy as np

from tissueid.errors import UnusableInputError
from tissueid.identification.base import PARAMETRIC, Array, Family, option
from tissueid.identification.impulse_response import memory_warnings
from tissueid.identification.memory import MemoryEngine
from tissueid.identification.preparation import SAMPLES_PER_PARAMETER, PreparedRecord, memory_in_samples, prepare
from tissueid.identification.registry import engine
from tissueid.identification.second_order_fit import fit_second_order
from tissueid.identification.volterra.methods import (
    Solved,
    VolterraStimulus,
    exact_least_squares,
    factor_stimulus,
    laguerre_least_squares,
    regularised_least_squares,
)
from tissueid.identification.volterra.regressors import (
    LagGrid,
    VolterraRegressors,
    automatic_grid,
    coefficient_count,
    lag_grid,
    shortened,
    smoothed,
    whiteness,
)
from tissueid.identification.volterra.structure import VolterraModel, kernel_structure
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Record

_MOST_COEFFICIENTS = 6000
"""Largest number of coefficients of the method exact, which needs a square matrix of this size."""

_SAMPLES_PER_COEFFICIENT = 2
"""Fewest samples per coefficient of the method exact on an automatic grid."""

_MOST_LAGS = {1: 2048, 2: 384, 3: 64}
"""Largest number of lags of an automatic grid by the order of the kernels: about a minute, or 1 GB."""

_MOST_LAGS_DRAWN = 64
"""Number of lags above which the bands of the structure signature are not computed, because they take longer than the
fit.
"""

_WHITE_ENOUGH = 0.1
"""Whiteness below which the standard deviations of a raw second-order kernel are more than ten times those for white
input.
"""


_CHOICES = (marked("regularised"), marked("exact"), marked("every"), marked("downsampled"))
"""Choices of the options as a form shows them, for translation."""


@engine
class Volterra(MemoryEngine):
    """Volterra engine.

    Assumes a response that decays within ``memory`` and output noise independent of the input; no block structure.
    """

    name: ClassVar[str] = "volterra"
    label: ClassVar[str] = marked("Volterra")
    title: ClassVar[str] = marked(
        "Kernels of order 0 to 3 (Chen 2010, chapter 4): any nonlinearity with fading memory, for small enough inputs."
    )
    family: ClassVar[Family] = Family.KERNELS
    usual_memory_s: ClassVar[float] = 0.06
    memory_margin: ClassVar[float] = 1.0

    order: int = option(2, marked("Order"), marked("Highest order of the kernels"), ge=0, le=3)
    method: Literal["regularised", "exact", "laguerre"] = option(
        "regularised",
        marked("Method"),
        marked(
            "Smooth, decaying kernels by regularisation (regularised), plain least squares (exact), or sums of "
            "Laguerre functions (laguerre)"
        ),
    )
    downsample: int | None = option(
        None,
        marked("Downsampling"),
        marked("Samples between the lags of the kernels; from the input if not given"),
        ge=1,
        le=1000,
    )
    rows: Literal["every", "downsampled"] = option(
        "every", marked("Rows"), marked("Fit every sample, or only one sample per lag, as in the thesis")
    )
    smoothing: float | None = option(
        None,
        marked("Smoothing"),
        marked("Standard deviation of the Gaussian filter of the second-order kernel, lags; thesis: 1"),
        gt=0.0,
        le=10.0,
    )

    def fit(
        self, record: Record, fit_part: slice | None = None, *, stimulus: VolterraStimulus | None = None
    ) -> VolterraModel:
        """Fit the kernels to a record, or to a contiguous part of it.

        Args:
            record: the data.
            fit_part: the part to fit; None for all of it.
            stimulus: result of :meth:`factored` for the same input; an exact fit then only needs to solve.

        Raises:
            UnusableInputError: nothing varies, too few samples, a memory longer than the part, more coefficients than
                the method exact supports, or the stimulus of another input.
        """
        grid, prepared, cut = self._prepared(record, fit_part)
        x = record.input - prepared.input_mean
        solved = self._solved(x, record.output, record.sample_rate_hz, prepared, grid, stimulus)
        white = self._whiteness(x, prepared, grid)
        warnings = [*prepared.warnings, *cut, *solved.warnings, *self._warnings(solved, white, prepared, grid)]
        second_order = fit_second_order(record, prepared.used, self.hold) if self.order else None
        if second_order is not None:
            warnings += second_order.warnings
        per_second = record.sample_rate_hz / grid.spacing
        model = VolterraModel(
            report=self.unscored(
                int(prepared.used.sum()),
                math.ceil(solved.parameters),
                parameters={} if second_order is None else second_order.parameters,
                warnings=tuple(warnings),
                findings=self._signature(solved),
                details=({} if second_order is None else {PARAMETRIC: second_order.vaf_percent})
                | solved.details
                | {"lags": float(grid.lags), "lag_spacing": float(grid.spacing)}
                | ({} if white is None else {"input_whiteness": white}),
            ),
            sample_rate_hz=record.sample_rate_hz,
            memory_samples=grid.memory_samples,
            order=self.order,
            kernel0=solved.kernels.zeroth,
            kernel1=_scaled(solved.kernels.first, per_second),
            kernel2=_scaled(solved.kernels.second, per_second**2),
            kernel3=_scaled(solved.kernels.third, per_second**3),
            kernel1_std=_scaled(solved.kernel1_std, per_second),
            kernel2_std=_scaled(solved.kernel2_std, per_second**2),
            lag_s=np.arange(grid.lags) * grid.spacing / record.sample_rate_hz,
            lag_spacing=grid.spacing,
            input_mean=prepared.input_mean,
            second_order=second_order,
        )
        model = _scored(model, record, prepared)
        if self.smoothing is None or model.kernel2 is None:
            return model
        filtered = replace(model, kernel2=smoothed(model.kernel2, self.smoothing), kernel2_std=None, unfiltered=model)
        filtered = _scored(filtered, record, prepared)
        unfiltered_vaf = {"vaf_unfiltered_percent": model.report.vaf_percent}
        return filtered.with_report(details=filtered.report.details | unfiltered_vaf)

    def factored(self, record: Record, fit_part: slice | None = None) -> VolterraStimulus:
        """Factor the input side once, for any number of outputs of the same input (4.1.2).

        Raises:
            UnusableInputError: as :meth:`fit`.
        """
        specification = self.for_record(record, fit_part)
        grid, prepared, _ = specification._prepared(record, fit_part)
        return specification._factored(record.input - prepared.input_mean, prepared, grid)

    def _prepared(self, record: Record, fit_part: slice | None) -> tuple[LagGrid, PreparedRecord, tuple[str, ...]]:
        """Return the lags, the record prepared for the number of samples that they need, and warnings."""
        rate = record.sample_rate_hz
        first = prepare(record, fit_part, 1.0 / rate, 1)  # checks that the input varies
        inside = record.input[first.part] - first.input_mean
        if memory_in_samples(self.memory_s, rate) > inside.size:
            raise UnusableInputError(
                "record.shorter_than_memory",
                "the memory of {memory:g} s is longer than the {seconds:g} s of record to fit",
                memory=self.memory_s,
                seconds=inside.size / rate,
            )
        cut: tuple[str, ...] = ()
        if self.downsample is None:
            grid, cut = shortened(automatic_grid(self.memory_s, inside, rate), self._most_lags(inside.size), rate)
        else:
            grid = lag_grid(self.memory_s, rate, self.downsample)
        least = coefficient_count(grid.lags, self.order if self._exact else min(self.order, 1))
        prepared = prepare(record, fit_part, grid.memory_samples / rate, least)
        rows = self._rows(prepared, grid)
        if rows < least:
            raise UnusableInputError(
                "volterra.too_few_rows",
                "{rows} downsampled rows are too few for {parameters} parameters: fit every sample, record "
                "longer, or shorten the memory",
                rows=rows,
                parameters=least,
            )
        return grid, prepared, cut

    def _most_lags(self, samples: int) -> int:
        """Return the number of lags of an automatic grid above which the kernels cannot be estimated."""
        if not self._exact:
            return _MOST_LAGS[self.order]
        lags, most = 1, min(_MOST_COEFFICIENTS, samples // _SAMPLES_PER_COEFFICIENT)
        while coefficient_count(lags + 1, self.order) <= most and lags < _MOST_LAGS[1]:
            lags += 1
        return lags

    def _step(self, grid: LagGrid) -> int:
        """Return the distance of the rows in samples."""
        return 1 if self.rows == "every" else grid.spacing

    def _rows(self, prepared: PreparedRecord, grid: LagGrid) -> int:
        return int(prepared.used[:: self._step(grid)].sum())

    @property
    def _exact(self) -> bool:
        return self.method == "exact" or self.order == 0

    def _factored(self, x: Array, prepared: PreparedRecord, grid: LagGrid) -> VolterraStimulus:
        coefficients = coefficient_count(grid.lags, self.order)
        if coefficients > _MOST_COEFFICIENTS:
            raise UnusableInputError(
                "volterra.too_many_coefficients",
                "{coefficients} coefficients are too many for the method exact: shorten the memory, downsample, "
                "or use the method regularised",
                coefficients=coefficients,
            )
        step = self._step(grid)
        return factor_stimulus(x[::step], prepared.used[::step], grid.lags, grid.spacing // step, self.order)

    def _solved(
        self,
        x: Array,
        y: Array,
        rate: float,
        prepared: PreparedRecord,
        grid: LagGrid,
        stimulus: VolterraStimulus | None,
    ) -> Solved:
        step = self._step(grid)
        if not self._exact:
            regressors = VolterraRegressors(
                x[::step], prepared.used[::step], grid.lags, grid.spacing // step, self.order
            )
            solve = regularised_least_squares if self.method == "regularised" else laguerre_least_squares
            return solve(regressors, y[::step])
        if stimulus is None:
            stimulus = self._factored(x, prepared, grid)
        elif not stimulus.matches(x[::step], prepared.used[::step], grid.lags, grid.spacing // step, self.order):
            raise UnusableInputError(
                "volterra.other_stimulus", "the factored stimulus belongs to another input, part or set of options"
            )
        return exact_least_squares(stimulus, y[::step], rate / step)

    def _whiteness(self, x: Array, prepared: PreparedRecord, grid: LagGrid) -> float | None:
        if self.order == 0:
            return None
        products = VolterraRegressors(x, prepared.used, grid.lags, grid.spacing, 1).gram()
        return whiteness(products[1:, 1:] / products[0, 0])

    def _signature(self, solved: Solved) -> tuple[str, ...]:
        """Return the structure that the second-order kernel indicates; empty for raw kernels, which are too rough."""
        kernels = solved.kernels
        if self.method != "regularised" or kernels.first is None or kernels.second is None:
            return ()
        std = solved.kernel2_std
        if std is not None and (kernels.first.size > _MOST_LAGS_DRAWN or not np.all(np.isfinite(std))):
            std = None
        return (kernel_structure(kernels.first, kernels.second, solved.kernel1_std, std).sentence,)

    def _warnings(self, solved: Solved, white: float | None, prepared: PreparedRecord, grid: LagGrid) -> list[str]:
        """Return warnings about the kernels."""
        doubts: list[str] = []
        rows, spent = self._rows(prepared, grid), math.ceil(solved.parameters)
        has_warning = (self._exact and self.rows == "every") or self.method == "laguerre"
        if rows < SAMPLES_PER_PARAMETER * spent and not has_warning:
            doubts.append(
                Message(
                    "volterra.few_rows",
                    "{rows} rows for {parameters} parameters are fewer than {fewest} for each: record longer, or "
                    "shorten the memory",
                    rows=rows,
                    parameters=spent,
                    fewest=SAMPLES_PER_PARAMETER,
                )
            )
        if solved.kernels.first is not None:
            doubts += memory_warnings(solved.kernels.first)
        raw = self._exact and self.order >= 2 and self.smoothing is None
        if raw and white is not None and white < _WHITE_ENOUGH:
            doubts.append(
                Message(
                    "volterra.coloured_input",
                    "the input is far from white at these lags: the second-order kernel is about {times:.0f} times "
                    "noisier than with a white input and cannot be interpreted; use the method regularised, "
                    "smoothing, or a wider spacing of the lags",
                    times=1.0 / white,
                )
            )
        return doubts


def _scaled(values: Array | None, factor: float) -> Array | None:
    return None if values is None else values * factor


def _scored(model: VolterraModel, record: Record, prepared: PreparedRecord) -> VolterraModel:
    """Return the model with its scores on the fitted samples."""
    scored = model.with_fit_scores(record, prepared.used)
    return scored if model.order else scored.with_report(vaf_percent=0.0)
