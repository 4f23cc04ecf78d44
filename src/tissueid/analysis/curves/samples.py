"""Curves of one fit on fixed grids, so that the curves of many tests can be stored and averaged.

Each curve has a flat grid that is the same for all tests. A sampled curve stores the values between its first and its
last known point on the grid.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.analysis import Analysis
from tissueid.analysis.curves.linear import response_curves, spectra_of
from tissueid.analysis.curves.nonlinearity import central_span
from tissueid.analysis.curves.plot import Array, is_mechanical, ratio_unit
from tissueid.errors import UnusableInputError
from tissueid.identification.engines.wiener import WienerModel
from tissueid.identification.partitions.model import PartitionedModel
from tissueid.identification.volterra.structure import VolterraModel

MAGNITUDE, PHASE = "magnitude_m_per_n", "phase_deg"
MASS, DAMPING, STIFFNESS = "mass_kg", "damping_n_s_per_m", "stiffness_n_per_m"
NONLINEARITY = "static_nonlinearity_m"
KERNEL1, KERNEL2, PARTITIONS = "kernel1_m_per_n_s", "kernel2_m_per_n2_s2", "kernel_by_depth_m_per_n_s"
LAGS = 24
"""Number of lags of second-order kernels and of kernels by depth."""
LAG_SPACING_S = 0.002
"""Spacing of the lags, s: that of the automatic grid of kernels for a memory of 60 ms."""
_LAGS_FIRST = 40
"""Number of lags of first-order kernels."""
_FREQUENCIES_HZ = np.geomspace(0.5, 1000.0, 67)
"""Frequencies of a response: 20 per decade, some 40 of which a usual test excites."""
_SHALLOWEST_M, _DEEPEST_M = -0.002, 0.030
_DEPTH_STEP_M, _PARTITION_STEP_M = 1e-4, 2e-4
"""Steps of depth of parameters and of kernels: a default test covers some 1 mm."""
_LARGEST_FORCE_N, _FORCE_STEP_N = 15.0, 0.25
_DIGITS = 5
"""Significant digits that are stored."""
_LARGEST = 1e30
"""Largest value, SI, that is read: its square fits in double precision, itself in single precision."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Points of a curve: ``x`` (n,), and ``y`` (n,) for a surface; names of both carry their unit."""

    x: Array
    x_name: str
    y: Array | None = None
    y_name: str = ""


def _multiples(step: float, first: int, last: int) -> Array:
    return step * np.arange(first, last + 1, dtype=np.float64)


def _depths(step: float) -> Array:
    return _multiples(step, round(_SHALLOWEST_M / step), round(_DEEPEST_M / step))


_LAG_S = _multiples(LAG_SPACING_S, 0, _LAGS_FIRST - 1)
_FORCES = round(_LARGEST_FORCE_N / _FORCE_STEP_N)
_TRIANGLE = np.triu_indices(LAGS)
_PARTITION_DEPTHS = _depths(_PARTITION_STEP_M)
_DEPTHS = Grid(_depths(_DEPTH_STEP_M), "depth_m")
_FREQUENCIES = Grid(_FREQUENCIES_HZ, "frequency_hz")
GRIDS: Mapping[str, Grid] = {
    MAGNITUDE: _FREQUENCIES,
    PHASE: _FREQUENCIES,
    MASS: _DEPTHS,
    DAMPING: _DEPTHS,
    STIFFNESS: _DEPTHS,
    NONLINEARITY: Grid(_multiples(_FORCE_STEP_N, -_FORCES, _FORCES), "force_n"),
    KERNEL1: Grid(_LAG_S, "lag_s"),
    KERNEL2: Grid(_LAG_S[_TRIANGLE[0]], "first_lag_s", _LAG_S[_TRIANGLE[1]], "second_lag_s"),
    PARTITIONS: Grid(
        np.tile(_LAG_S[:LAGS], _PARTITION_DEPTHS.size), "lag_s", np.repeat(_PARTITION_DEPTHS, LAGS), "depth_m"
    ),
}
"""Grid of each curve by its name, which carries the unit of its values."""


@dataclass(frozen=True, eq=False)
class SampledCurve:
    """Values (k,) of a curve from the point ``first`` of its grid on; NaN where it is not known.

    They are single precision where many are kept. ``direction`` is 1 for indentation, -1 for retraction, 0 for both.
    """

    name: str
    first: int
    values: NDArray[np.floating[Any]]
    direction: int = 0

    @property
    def on_grid(self) -> Array:
        """The values on the whole grid, (n,); NaN where the curve is not known."""
        whole = np.full(GRIDS[self.name].x.size, np.nan)
        whole[self.first : self.first + self.values.size] = self.values
        return whole

    def as_json(self) -> list[Any]:
        """Return name, direction, first point and values for JSON, with ``_DIGITS`` significant digits."""
        values = [float(f"{value:.{_DIGITS - 1}e}") if np.isfinite(value) else None for value in self.values.tolist()]
        return [self.name, self.direction, self.first, values]


def from_json(stored: Any) -> SampledCurve:
    """Return the curve that ``as_json`` returned.

    Raises:
        ValueError: it is no such curve.
    """
    name, direction, first, values = stored
    if name not in GRIDS or direction not in (-1, 0, 1) or not isinstance(first, int) or first < 0:
        raise ValueError(name)
    read = np.array(values, dtype=np.float64)  # None becomes NaN
    if read.ndim != 1 or first + read.size > GRIDS[name].x.size or (np.abs(read) > _LARGEST).any():
        raise ValueError(name)
    return SampledCurve(name, first, read.astype(np.float32), direction)


def sampled_curves(analysis: Analysis, surface_position_m: float) -> list[SampledCurve]:
    """Return the curves of a fit of force and position; those that the engine does not have are left out.

    Args:
        analysis: the fit.
        surface_position_m: position of the tissue surface, m, the origin of depth; NaN if unknown: no curve has depths.
    """
    if not is_mechanical(analysis.record):
        return []
    sampled: list[SampledCurve] = []
    samplers: tuple[Callable[[Analysis, float], list[SampledCurve]], ...]
    samplers = _response, _profile, _nonlinearity, _kernels, _partitions
    for sampler in samplers:
        try:
            sampled += sampler(analysis, surface_position_m)
        except UnusableInputError:
            continue
    return [curve for curve in sampled if curve.values.size]


def trimmed(name: str, values: Array, direction: int = 0) -> SampledCurve:
    """Return values (n,) on the whole grid as a curve from the first to the last known one."""
    indices = np.flatnonzero(np.isfinite(values))
    if not indices.size:
        return SampledCurve(name, 0, np.zeros(0), direction)
    return SampledCurve(name, int(indices[0]), values[indices[0] : indices[-1] + 1], direction)


def _response(analysis: Analysis, _surface: float) -> list[SampledCurve]:
    magnitude, phase = response_curves(analysis, spectra_of(analysis))
    scale = ratio_unit(analysis.record)[1]
    at, log_frequency = np.log(_FREQUENCIES_HZ), np.log(magnitude.x)
    outside = {"left": np.nan, "right": np.nan}
    size = np.exp(np.interp(at, log_frequency, np.log(magnitude.y / scale), **outside))
    angle = np.interp(at, log_frequency, phase.y, **outside)
    angle -= 360.0 * np.round(phase.y[0] / 360.0)
    return [trimmed(MAGNITUDE, size), trimmed(PHASE, angle)]


def _profile(analysis: Analysis, surface: float) -> list[SampledCurve]:
    profile = analysis.depth_profile()
    if profile is None:
        return []
    sampled = []
    for name, values in ((MASS, profile.mass), (DAMPING, profile.damping), (STIFFNESS, profile.stiffness)):
        for way in (0, 1, -1):
            rows = (profile.direction == way) & np.isfinite(values)
            sampled.append(trimmed(name, _between(GRIDS[name].x, profile.position[rows] - surface, values[rows]), way))
    return sampled


def _nonlinearity(analysis: Analysis, surface: float) -> list[SampledCurve]:
    model, record = analysis.model, analysis.record[analysis.fit_part]
    if not isinstance(model, WienerModel):
        return []
    force = GRIDS[NONLINEARITY].x
    span = central_span(model.linear_output(record.input))
    inside = (force >= span[0]) & (force <= span[-1])
    values = np.full(force.size, np.nan)
    values[inside] = model.nonlinearity(force[inside]) - surface
    return [trimmed(NONLINEARITY, values)]


def _kernels(analysis: Analysis, _surface: float) -> list[SampledCurve]:
    model = analysis.model
    if not isinstance(model, VolterraModel) or model.kernel1 is None or model.lag_s.size < 2:
        return []
    sampled = [trimmed(KERNEL1, _at_lags(model.kernel1, model.lag_s, _LAGS_FIRST))]
    if model.kernel2 is not None:
        rows = np.stack([_at_lags(row, model.lag_s, LAGS) for row in model.kernel2], axis=1)  # (LAGS, lags)
        whole = np.stack([_at_lags(row, model.lag_s, LAGS) for row in rows])
        sampled.append(trimmed(KERNEL2, whole[_TRIANGLE]))
    return sampled


def _partitions(analysis: Analysis, surface: float) -> list[SampledCurve]:
    model = analysis.model
    if not isinstance(model, PartitionedModel) or model.partitions.depths < 2 or model.lag_s.size < 2:
        return []
    kernels = np.stack([_at_lags(kernel, model.lag_s, LAGS) for kernel in model.operating_kernels])
    cell = np.searchsorted(model.breakpoints_m - surface, _PARTITION_DEPTHS, side="right") - 1
    inside = (cell >= 0) & (cell < len(kernels))
    values = np.full((_PARTITION_DEPTHS.size, LAGS), np.nan)
    if np.isfinite(surface):
        values[inside] = kernels[cell[inside]]
    return [trimmed(PARTITIONS, values.ravel())]


def _at_lags(kernel: Array, lag_s: Array, lags: int) -> Array:
    return _between(_LAG_S[:lags], lag_s, kernel)


def _between(at: Array, x: Array, values: Array) -> Array:
    """Return values (k,) interpolated linearly at ``at`` (n,); NaN outside of ``x`` (k,)."""
    if x.size < 2 or not np.isfinite(x).all():
        return np.full(at.size, np.nan)
    order = np.argsort(x)
    tolerance = 1e-9 * float(np.ptp(x))
    inside = (at >= x.min() - tolerance) & (at <= x.max() + tolerance)
    return np.where(inside, np.interp(at, x[order], values[order]), np.nan)


__all__ = [
    "DAMPING",
    "GRIDS",
    "KERNEL1",
    "KERNEL2",
    "LAGS",
    "MAGNITUDE",
    "MASS",
    "NONLINEARITY",
    "PARTITIONS",
    "PHASE",
    "STIFFNESS",
    "Grid",
    "SampledCurve",
    "from_json",
    "sampled_curves",
    "trimmed",
]
