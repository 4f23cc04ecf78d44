"""Local mass, damping and stiffness of a partitioned record, with what the estimator itself does to them taken out.

The linearised kernels still average: over the width of a partition, over the motion within the memory, over both
directions. How much shows when the same estimator is put to a tissue whose parameters are known: one with the
parameters found, moved by the record's own input. The parameters are moved until what comes back is what came from the
record (indirect inference: Gourieroux, Monfort and Renault 1993).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Mask
from tissueid.identification.partitions.cells import Partitions
from tissueid.identification.partitions.contrast import fit_contrast
from tissueid.identification.partitions.parameters import LocalParameters, local_parameters
from tissueid.identification.partitions.regression import PartitionedKernels, solve_along_lags
from tissueid.identification.partitions.tissue import Contrast, SimulatedTissue
from tissueid.identification.preparation import Prepared
from tissueid.identification.second_order_fit import SecondOrderFit
from tissueid.identification.volterra.smoothing import LagGrid

_ROUNDS = 2
_PROBE = 0.05
"""Change of a logarithm that shows how the estimator answers."""

_LEAST_GAIN = 0.15
"""Share of a change that has to come back; what answers less is corrected as if it answered so much."""

_FARTHEST = np.log(2.0)
"""A correction beyond this factor is not one: the tissue simulated is not like the record."""

_UNCORRECTED = (
    "mass, damping and stiffness are as the kernels show them, uncorrected: a tissue with these parameters could not "
    "be simulated under this record's input"
)


@dataclass(frozen=True, eq=False)
class LocalEstimates:
    """Parameters of K stretches of depth about the operating point.

    ``contrast`` is that of the damping by direction; None where no direction is told apart. ``solved`` holds the
    kernels about the mean input.
    """

    local: LocalParameters
    solved: PartitionedKernels
    contrast: Contrast | None = None
    warnings: tuple[str, ...] = ()

    @property
    def rest(self) -> float:
        """Output under the mean input."""
        return float(self.solved.offsets[0])


@dataclass(frozen=True, eq=False)
class DepthEstimator:
    """From an output to parameters against depth, for one input. ``partitions`` cut depth alone."""

    prepared: Prepared
    used: Mask
    partitions: Partitions
    grid: LagGrid
    linear: SecondOrderFit

    def estimate(self, output: Array) -> LocalEstimates:
        """Parameters from an output (n,) as they come."""
        record, prepared = self.prepared.record, self.prepared
        cells = self.partitions.cells(output)
        solved = solve_along_lags(
            record.input,
            output,
            prepared.input_mean,
            cells,
            self.partitions.count,
            self.used,
            self.grid,
            record.sample_rate_hz,
        )
        x = np.full(output.size, np.nan)
        x[prepared.part] = record.input[prepared.part] - prepared.input_mean
        local = local_parameters(
            solved, self.partitions, output[self.used], cells[self.used], x, self.grid, self.linear
        )
        return LocalEstimates(local, solved)

    def corrected(self, *, contrast: bool) -> LocalEstimates:
        """Parameters from the record's output, less the bias that the estimator shows on a tissue simulated with them.

        Level and slope of each parameter by depth are found by Newton's method: what moves them in the tissue moves
        what comes back, and by how much is found by simulation too. What the cells scatter about such lines is added as
        it came. With ``contrast`` the damping of that tissue may depend on the direction. Where that cannot be had all
        is left as it came, and a warning says so.
        """
        seen = self.estimate(self.prepared.record.output)
        if not self.linear.mechanical or not seen.local.known.any():
            return seen
        if not seen.local.known.all():
            return replace(seen, warnings=(_UNCORRECTED,))
        tissue = SimulatedTissue.through(seen.local, self.prepared, self.partitions, self.linear.hold, seen.rest)
        found = fit_contrast(tissue, seen.local.log_parameters, self.used) if contrast else None
        seen = replace(seen, contrast=found)
        search = _Search.begun(self, seen, tissue) if found is not None or not contrast else None
        local = None if search is None else search.matched(found or Contrast.none(seen.local.position.size))
        return replace(seen, warnings=(_UNCORRECTED,)) if local is None else replace(seen, local=local)


@dataclass(frozen=True, eq=False)
class _Search:
    """The search for the tissue from which the estimator returns what it returned from the record."""

    estimator: DepthEstimator
    seen: LocalEstimates
    tissue: SimulatedTissue
    inverse: Array  # (6, 6), of what the lines of what comes back change with those of what goes in

    @classmethod
    def begun(cls, estimator: DepthEstimator, seen: LocalEstimates, tissue: SimulatedTissue) -> _Search | None:
        """The search, with the estimator's answers to changes known; None where the tissue cannot be simulated."""
        lines = tissue.lines
        search = cls(estimator, seen, tissue, np.eye(3 * lines.basis.shape[1]))
        sought, still = seen.local.log_parameters, Contrast.none(lines.position.size)
        back = search._returned(sought, still)
        if back is None:
            return None
        columns = []
        for change in lines.unit_changes():
            moved = search._returned(sought + _PROBE * change, still)
            if moved is None:
                return None
            columns.append(np.ravel(lines.pick @ (moved - back)) / _PROBE)
        left, gains, right = np.linalg.svd(np.array(columns).T)
        return replace(search, inverse=(right.T / np.maximum(gains, _LEAST_GAIN)) @ left.T)

    def matched(self, contrast: Contrast) -> LocalParameters | None:
        """Parameters of the tissue, whose damping depends on the direction like this; None when that fails."""
        lines, wanted = self.tissue.lines, self.seen.local.log_parameters
        sought = wanted
        back = self._returned(sought, contrast)
        for _ in range(_ROUNDS):
            if back is None:
                return None
            missing = np.ravel(lines.pick @ (wanted - back))
            sought = sought + lines.basis @ (self.inverse @ missing).reshape(-1, 3)
            if not np.all(np.abs(sought - wanted) < _FARTHEST):
                return None
            back = self._returned(sought, contrast)
        if back is None:
            return None
        root = self.seen.local.root
        across = np.einsum("lk,kim->lim", lines.pick, root)  # (lines, 3, m)
        widened = (self.inverse @ across.reshape(self.inverse.shape[0], -1)).reshape(across.shape)
        return replace(
            self.seen.local,
            log_parameters=lines.smooth(sought) + wanted - back,
            root=root + np.einsum("kl,lim->kim", lines.basis, widened - across),
        )

    def _returned(self, values: Array, contrast: Contrast) -> Array | None:
        """What the estimator makes of a tissue with these logarithms (K, 3); None where it cannot be had."""
        simulated = self.tissue.output(self.tissue.lines.coefficients(values), contrast)
        if simulated is None:
            return None
        try:
            back = self.estimator.estimate(simulated).local
        except UnusableInputError:
            return None
        return back.log_parameters if back.known.all() else None
