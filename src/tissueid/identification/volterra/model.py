"""Volterra model: simulation, and kernels in physical units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissueid.identification.base import Array, Model
from tissueid.identification.preparation import complete_windows
from tissueid.identification.second_order_fit import SecondOrderFit
from tissueid.identification.volterra.kernel_regression import simulate_third
from tissueid.identification.volterra.regressors import Kernels

_ENTRIES_AT_ONCE = 1 << 16
"""Number of lagged inputs processed at a time, so that they fit the processor cache."""


@dataclass(frozen=True, eq=False)
class ImpulseResponse:
    """Response to an input sample of ``height`` about the operating point, order by order (Eq. 4.15).

    ``zeroth`` is a level, the others have shape (lags,); all are in the unit of the output.
    """

    lag_s: Array
    height: float
    zeroth: float
    first: Array
    second: Array
    third: Array

    @property
    def total(self) -> Array:
        """h0 + h1(t) + h2(t, t) + h3(t, t, t) times powers of the height, (lags,)."""
        return self.zeroth + self.first + self.second + self.third


@dataclass(frozen=True, eq=False)
class VolterraModel(Model):
    """Eq. 4.1 about an operating point: the kernels act on the input minus ``input_mean``.

    ``kernel0`` is the level of the output there (not its mean, to which even kernels contribute), ``kernel1`` (lags,)
    is in output units per input unit and second, ``kernel2`` (lags, lags) per input unit squared and second squared,
    ``kernel3`` (lags, lags, lags) per input unit cubed and second cubed; all are symmetric, and None above ``order``.
    ``lag_s`` (lags,) are the times of their lags, ``lag_spacing`` samples apart. ``kernel1_std`` and ``kernel2_std``
    have the shapes of the kernels; None if unknown. ``unfiltered`` is the model before its second-order kernel was
    smoothed.
    """

    order: int
    kernel0: float
    kernel1: Array | None
    kernel2: Array | None
    kernel3: Array | None
    kernel1_std: Array | None
    kernel2_std: Array | None
    lag_s: Array
    lag_spacing: int
    input_mean: float
    second_order: SecondOrderFit | None
    unfiltered: VolterraModel | None = None

    @property
    def per_lag(self) -> Kernels:
        """The kernels as factors of samples: in output units per power of the input unit."""
        step = self.lag_spacing / self.sample_rate_hz
        return Kernels(
            self.kernel0,
            None if self.kernel1 is None else self.kernel1 * step,
            None if self.kernel2 is None else self.kernel2 * step**2,
            None if self.kernel3 is None else self.kernel3 * step**3,
        )

    def simulate(self, u: Array) -> Array:
        """Simulate in free run: input (n,), output (n,), at rest at the mean input before the first sample."""
        return np.asarray(np.sum(self.contributions(u), axis=0), dtype=np.float64)

    def contributions(self, u: Array) -> tuple[Array, ...]:
        """Return the contribution of each order, from 0 on, to the simulation of an input (n,): arrays (n,)."""
        x = np.asarray(u, dtype=np.float64) - self.input_mean
        finite = np.isfinite(x)
        parts = np.vstack(
            [
                np.full((1, x.size), self.kernel0),
                kernel_outputs(self.per_lag, np.where(finite, x, 0.0), self.lag_spacing, self.order),
            ]
        )
        if not finite.all():
            known = np.concatenate([np.ones(self.memory_samples - 1, dtype=np.bool_), finite])
            parts[:, ~complete_windows(known, self.memory_samples)[self.memory_samples - 1 :]] = np.nan
        return tuple(parts)

    def impulse_response(self, height: float = 1.0) -> ImpulseResponse:
        """Return the response to an input of ``height`` for one lag, relative to the operating point."""
        kernels = self.per_lag
        nothing = np.zeros(self.lag_s.size)
        lag = np.arange(self.lag_s.size)
        return ImpulseResponse(
            lag_s=self.lag_s,
            height=height,
            zeroth=kernels.zeroth,
            first=nothing if kernels.first is None else height * kernels.first,
            second=nothing if kernels.second is None else height**2 * kernels.second[lag, lag],
            third=nothing if kernels.third is None else height**3 * kernels.third[lag, lag, lag],
        )


def kernel_outputs(kernels: Kernels, x: Array, spacing: int, order: int) -> Array:
    """Return the outputs (order, n) of the kernels of order 1 to ``order`` for an input (n,), at rest before it."""
    first, second, third = kernels.first, kernels.second, kernels.third
    outputs = np.zeros((order, x.size))
    if first is None:
        return outputs
    lags = first.size
    padded = np.concatenate([np.zeros((lags - 1) * spacing), x])
    windows = np.lib.stride_tricks.sliding_window_view(padded, (lags - 1) * spacing + 1)[:, ::-spacing]  # (n, lags)
    rows = max(1, _ENTRIES_AT_ONCE // lags)
    for begin in range(0, x.size, rows):
        some = slice(begin, begin + rows)
        window = np.ascontiguousarray(windows[some])  # (rows, lags)
        outputs[0, some] = window @ first
        if second is not None:
            outputs[1, some] = np.einsum("ij,ij->i", window @ second, window)
    if third is not None:
        outputs[2] = simulate_third(third, x, spacing)
    return outputs
