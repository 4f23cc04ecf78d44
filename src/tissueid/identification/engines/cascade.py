"""Cascades of linear and static blocks: a given structure, or the one that the record supports."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Family, Model, option
from tissueid.identification.cascades.blocks import (
    STRUCTURES,
    Blocks,
    CascadeData,
    Structure,
    cascade_data,
    input_levels,
    prepare_cascade,
)
from tissueid.identification.cascades.fit import fit_structures, over_whole_range, refine_until_converged
from tissueid.identification.cascades.normalisation import (
    Normalised,
    Uncertainty,
    fit_linearised,
    has_steady_gains,
    normalise_gains,
    parameters_at_rest,
    uncertainty,
)
from tissueid.identification.cascades.structure_selection import (
    StructureChoice,
    choose,
    structure_findings,
    structure_warnings,
)
from tissueid.identification.impulse_response import memory_warnings
from tissueid.identification.memory import MemoryEngine
from tissueid.identification.preparation import memory_in_samples
from tissueid.identification.registry import engine
from tissueid.identification.second_order_fit import SecondOrderFit
from tissueid.identification.static_nonlinearity import CURVE, DEGREE, Form, StaticNonlinearity, coefficient_count
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Record

_MOST_ROWS = 200_000
"""Largest number of samples that are fitted, for about 1 GB and a few minutes."""
_MOST_ROWS_COMPARED = 40_000
"""Largest number of samples by which structures are compared, for about a minute."""


@dataclass(frozen=True, eq=False)
class CascadeModel(Model):
    """y = offset + second * outer(first * inner(input)); None for blocks that the ``structure`` does not have.

    The kernels (lags,) at ``lag_s`` (lags,) are per sample. ``first_kernel`` and ``second_kernel`` sum to 1 if they
    have a steady-state gain, else their root-sum-square is 1; the last curve carries the unit of the output, or in a
    linear system the kernel does. ``inner`` maps the absolute input and ``outer`` the output of the first kernel; both
    are zero at rest. The ``..._std`` (lags,) include the uncertainty of all other blocks. ``choice`` is the comparison
    of the structures; None if the structure was given.
    """

    structure: Structure
    inner: StaticNonlinearity | None
    first_kernel: Array
    first_kernel_std: Array
    outer: StaticNonlinearity | None
    second_kernel: Array | None
    second_kernel_std: Array | None
    lag_s: Array
    input_mean: float
    offset: float
    choice: StructureChoice | None
    second_order: SecondOrderFit

    def simulate(self, u: Array) -> Array:
        """Simulate in free run: input (n,), output (n,), at rest at the mean input before the first sample."""
        blocks = (self.inner, self.first_kernel, self.outer, self.second_kernel)
        return Normalised(self.structure, *blocks, self.offset, self.input_mean).simulate(u)


@engine
class Cascade(MemoryEngine):
    """Cascade engine.

    All blocks are fitted together by the error of the free run, from several starting points. ``auto`` selects the
    simplest structure that is as good as the best in cross-validation, and reports structures that the record does not
    distinguish, and when none of them is complete.
    """

    name: ClassVar[str] = "cascade"
    label: ClassVar[str] = marked("Cascade")
    title: ClassVar[str] = marked(
        "Block structures: linear, Wiener (LN), Hammerstein (NL), LNL and NLN (Chen 2010, 3.2 and 4.2)."
    )
    family: ClassVar[Family] = Family.STATIC

    structure: Literal["auto", "linear", "wiener", "hammerstein", "lnl", "nln"] = option(
        "auto",
        marked("Structure"),
        marked("Structure of the blocks; auto compares all and takes the one that the record supports"),
    )
    nonlinearity: Form = CURVE
    degree: int = DEGREE

    def fit(self, record: Record, fit_part: slice | None = None) -> CascadeModel:
        """Fit the structure, or all of them, to a record or to a contiguous part of it.

        Raises:
            UnusableInputError: nothing varies, too few samples, or a memory longer than the part (an LNL system has
                nearly twice the ``memory`` of its blocks), or a structure with a curve of the input is given and the
                input has fewer distinct values than the curve has coefficients.
        """
        wanted: tuple[Structure, ...] = STRUCTURES if self.structure == "auto" else (self.structure,)
        lags = memory_in_samples(self.memory_s, record.sample_rate_hz)
        whole = 2 * lags - 1 if "lnl" in wanted else lags
        curve = coefficient_count(self.nonlinearity, self.degree) - 2
        prepared, spacing = prepare_cascade(record, fit_part, lags, whole, lambda q: _largest(wanted, q, curve))
        used = prepared.used
        warnings = list(prepared.warnings)
        levels = input_levels(prepared)
        if levels < curve + 2:
            wanted = tuple(structure for structure in wanted if structure not in ("hammerstein", "nln"))
            if not wanted:
                raise UnusableInputError(
                    "hammerstein.few_levels",
                    "an input of {levels} different values does not determine a curve of {coefficients} "
                    "coefficients: lower the degree, or use lms",
                    levels=levels,
                    coefficients=curve + 2,
                )
            if self.structure == "auto":
                warnings.append(
                    Message(
                        "cascade.not_tried",
                        "an input of {levels} different values does not determine a curve of {coefficients} "
                        "coefficients: hammerstein and nln were not tried",
                        levels=levels,
                        coefficients=curve + 2,
                    )
                )
        data = cascade_data(prepared, lags, spacing).first(_MOST_ROWS)
        compared = data.first(_MOST_ROWS_COMPARED)
        fits = fit_structures(compared, self.nonlinearity, self.degree, wanted)
        choice = choose(fits, compared) if self.structure == "auto" else None
        if data.rows.size < int(used.sum()):
            warnings.append(
                Message(
                    "cascade.part_fitted",
                    "only the first {seconds:.3g} s of the record were fitted, to limit memory and time",
                    seconds=data.input.size / record.sample_rate_hz,
                )
            )
        if compared.rows.size < data.rows.size and choice is not None:
            warnings.append(
                Message(
                    "cascade.part_compared",
                    "the structures were compared on the first {seconds:.3g} s of the record, to limit time",
                    seconds=compared.input.size / record.sample_rate_hz,
                )
            )
        structure = wanted[0] if choice is None else choice.structure
        blocks, data = refine_until_converged(over_whole_range(fits[structure], data), data)
        vector_covariance = uncertainty(blocks, data)
        gains = has_steady_gains(blocks, data, vector_covariance)
        normal = normalise_gains(blocks, data, gains)
        first_std, second_std = _kernel_stds(vector_covariance, data, gains)

        modelled = normal.simulate(np.where(np.isfinite(record.input), record.input, prepared.input_mean))
        residuals = np.where(used, record.output - modelled, np.nan)
        small = fit_linearised(normal, record, used, residuals, self.hold)
        parameters, flat = parameters_at_rest(
            normal, lambda some: normalise_gains(some, data, gains), vector_covariance, small
        )
        warnings += flat or small.warnings
        for kernel in (normal.first, normal.second):
            warnings += [] if kernel is None else memory_warnings(kernel)
        details = {"kernel_functions": float(data.bank.size), "input_edge_hz": data.edge_hz}
        if choice is not None:
            warnings += structure_warnings(choice)
            for candidate in choice.candidates:
                details[f"vaf_held_out_{candidate.structure}_percent"] = candidate.vaf_held_out_percent
                details[f"aicc_{candidate.structure}"] = candidate.aicc
            details["unexplained_percent"] = choice.chosen.unexplained_percent or 0.0
        rate = record.sample_rate_hz
        return CascadeModel(
            report=self.report(
                record,
                used,
                modelled,
                blocks.n_parameters,
                parameters=parameters,
                findings=() if choice is None else structure_findings(choice),
                model=structure,
                warnings=tuple(dict.fromkeys(warnings)),
                details=details,
            ),
            sample_rate_hz=rate,
            memory_samples=2 * lags - 1 if structure == "lnl" else lags,
            structure=structure,
            inner=normal.inner,
            first_kernel=normal.first,
            first_kernel_std=first_std,
            outer=normal.outer,
            second_kernel=normal.second,
            second_kernel_std=second_std,
            lag_s=np.arange(lags) / rate,
            input_mean=prepared.input_mean,
            offset=normal.offset,
            choice=choice,
            second_order=small,
        )


def _largest(wanted: tuple[Structure, ...], basis: int, curve: int) -> int:
    """Return the number of parameters of the largest structure, from the sizes of basis and curve."""
    counts = {
        "linear": basis + 1,
        "wiener": basis + curve + 1,
        "hammerstein": basis + curve + 1,
        "lnl": 2 * basis + curve,
        "nln": basis + 2 * curve + 1,
    }
    return max(counts[structure] for structure in wanted)


def _kernel_stds(
    vector_covariance: Uncertainty, data: CascadeData, gains: tuple[bool, bool]
) -> tuple[Array, Array | None]:
    """Return the standard deviations (lags,) of the reported kernels."""

    def kernels(some: Blocks) -> Array:
        shape = normalise_gains(some, data, gains)
        return shape.first if shape.second is None else np.concatenate([shape.first, shape.second])

    std = np.sqrt(np.maximum(np.diag(vector_covariance.of(kernels)), 0.0))
    lags = data.bank.basis.shape[0]
    return std[:lags], std[lags:] if std.size > lags else None
