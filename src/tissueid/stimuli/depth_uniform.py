"""Design of the next stimulus of a multistep test: noise with a uniform depth distribution, predicted by a fitted model
(6.3).

The spectrum is fixed: slow noise that covers the depth range, and fast noise up to the cutoff for the identification of
the dynamics. The force distribution is found iteratively: each round simulates the depth and maps every quantile of the
force to the quantile of depth that it should reach; the best round is kept. This compensates in advance for the
tendency of a linear system to make any distribution more Gaussian (3.1.1).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.plan_options import option_error
from tissueid.stimuli.base import Array, check_range_order, with_preload
from tissueid.stimuli.distributions import kolmogorov_distance
from tissueid.stimuli.kinds.noise import Noise

Simulation = Callable[[Array], Array]
"""Function from a force, N, shape (n,), to the depth from the surface, m, shape (n,), starting from rest."""

_ROUNDS = 12
"""Rounds of simulation for each range."""
_LEVELS = 33
"""Number of quantiles of the force: 3 % of the samples lie between two of them."""

_SETTLE_S = 0.5
"""Simulated time, s, after which the depth under a constant force is read."""
_RESERVED_SHARES = (0.0, 0.01, 0.02, 0.05)
"""Shares of the force range reserved at both ends for reversing the motion, tried in this order."""

_GOOD_DISTANCE = 0.02
"""Predicted Kolmogorov distance below which no larger reserve is tried."""

_TABLE_HZ = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0, 9.0, 14.0)
"""Frequencies of the spectrum table, relative to the cutoff of the slow part."""


class DepthDesign(BaseModel):
    """Specification of a multistep test: depth and force ranges, length and spectrum, shared by its tests except the
    seed.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    depth_min_m: float = Field(ge=-0.05, le=0.05, description=marked("Least depth, m, from the surface"))
    depth_max_m: float = Field(ge=-0.05, le=0.05, description=marked("Greatest depth, m, from the surface"))
    force_min_n: float = Field(0.0, ge=-100.0, le=100.0, description=marked("Least force, N"))
    force_max_n: float = Field(10.5, ge=-100.0, le=100.0, description=marked("Greatest force, N"))
    seconds: float = Field(3.0, ge=0.5, le=60.0, description=marked("Length of each test without its preload, s"))
    sample_rate: float = Field(2000.0, gt=0.0, le=1e6, description=marked("Sample rate, Hz"))
    slow_hz: float = Field(8.0, gt=0.0, le=100.0, description=marked("Cutoff frequency of the slow part, Hz"))
    fast_share: float = Field(0.15, ge=0.0, le=1.0, description=marked("Share of the power in the fast part"))
    cutoff_hz: float = Field(200.0, gt=0.0, description=marked("Cutoff frequency of the fast part, Hz"))

    @model_validator(mode="after")
    def _check_ranges(self) -> Self:
        check_range_order("depth", 1e3 * self.depth_min_m, 1e3 * self.depth_max_m, "mm")
        check_range_order("force", self.force_min_n, self.force_max_n, "N")
        return self

    @classmethod
    def from_options(cls, options: Mapping[str, Any]) -> Self:
        """Build the specification from named options.

        Raises:
            UnusableInputError: an option is unknown, out of bounds, or inconsistent with another option.
        """
        try:
            return cls.model_validate(dict(options))
        except ValidationError as error:
            raise UnusableInputError(option_error("multistep", cls.model_fields, error)) from error

    def first(self, seed: int) -> Noise:
        """Return the first test, without a model: Gaussian noise over the lower half of the force range."""
        middle = 0.5 * (self.force_min_n + self.force_max_n)
        return self._noise(seed, force_min_n=self.force_min_n, force_max_n=middle, distribution="gaussian")

    def with_quantiles(self, force: Array, seed: int) -> Noise:
        """Return noise whose force has the quantiles (m,), N, at evenly spaced probabilities."""
        low, high = float(force[0]), float(force[-1])
        table = tuple(float(value) for value in force)
        return self._noise(seed, force_min_n=low, force_max_n=high, distribution="quantiles", quantiles=table)

    def _noise(self, seed: int, **options: float | str | tuple[float, ...]) -> Noise:
        below = [f * self.slow_hz for f in _TABLE_HZ if f * self.slow_hz < self.cutoff_hz]
        frequencies = np.array([0.0, *below, self.cutoff_hz])
        slow = (1.0 - self.fast_share) / self.slow_hz / (1.0 + (frequencies / self.slow_hz) ** 4)
        densities = slow + self.fast_share / self.cutoff_hz
        return Noise.from_options(
            {
                "spectrum": "power",
                "frequencies_hz": tuple(frequencies.tolist()),
                "densities": tuple((densities / densities[0]).tolist()),
                "seconds": self.seconds,
                "sample_rate": self.sample_rate,
                "seed": seed,
            }
            | options
        )


@dataclass(frozen=True)
class DepthUniformNoise:
    """Designed noise and the depth distribution that the model predicts for it.

    ``depth_min_m`` and ``depth_max_m`` are the design range: the requested range, limited to what the forces can reach.
    ``distance`` is the predicted Kolmogorov distance from uniform, ``history`` that of each round.
    """

    stimulus: Noise
    depth_min_m: float
    depth_max_m: float
    distance: float
    history: tuple[float, ...]


def distance_from_uniform(depth: Array, low: float, high: float) -> float:
    """Return the Kolmogorov distance of depths (n,) from a uniform distribution over a range; NaN are ignored.

    Raises:
        UnusableInputError: all depths are NaN.
    """
    received = depth[np.isfinite(depth)]
    if not received.size:
        raise UnusableInputError("depth.lost", "no sample of the depth was received: repeat the test")
    return kolmogorov_distance(received, np.linspace(low, high, received.size))


def design_next_noise(simulate: Simulation, design: DepthDesign, seed: int, preload_s: float) -> DepthUniformNoise:
    """Design noise whose simulated depth is uniform over the requested range, or over the reachable part of it.

    Args:
        simulate: the fitted model.
        design: specification.
        seed: of the noise.
        preload_s: length of the preload at the mean load, s.

    Raises:
        UnusableInputError: no part of the range is reachable, or the simulated depth does not rise with force.
    """
    curve = _static_curve(simulate, design)
    best: DepthUniformNoise | None = None
    for edge in _RESERVED_SHARES:
        low, high = _reachable(curve, design, edge)
        if best is not None and (low, high) == (best.depth_min_m, best.depth_max_m):
            continue  # the range is not limited by force
        candidate = _design_for_range(simulate, design, seed, preload_s, curve, low, high)
        if best is None or candidate.distance < best.distance:
            best = candidate
        if best.distance <= _GOOD_DISTANCE:
            break
    assert best is not None
    return best


def _design_for_range(
    simulate: Simulation, design: DepthDesign, seed: int, preload_s: float, curve: _Curve, low: float, high: float
) -> DepthUniformNoise:
    """Design noise for a reachable range by rounds of simulation."""
    wanted = np.linspace(low, high, _LEVELS)
    held = round(preload_s * design.sample_rate)
    quantiles = _bounded(curve.force(wanted), design)
    best: tuple[float, Noise] | None = None
    history: list[float] = []
    for _ in range(_ROUNDS):
        tried = design.with_quantiles(quantiles, seed)
        depth = simulate(with_preload(tried.build(), preload_s).values)[held:]
        history.append(distance_from_uniform(depth, low, high))
        if best is None or history[-1] < best[0]:
            best = history[-1], tried
        reached = np.quantile(depth, np.linspace(0.0, 1.0, _LEVELS))
        quantiles = _bounded(_forces_for(wanted, reached, quantiles), design)
    assert best is not None
    return DepthUniformNoise(best[1], low, high, best[0], tuple(history))


@dataclass(frozen=True, eq=False)
class _Curve:
    """Static curve: depths (m,), m, at constant forces (m,), N, both rising."""

    forces: Array
    depths: Array

    def force(self, depth: Array) -> Array:
        """Return the force, N, for each depth (k,), m."""
        return np.interp(depth, self.depths, self.forces)

    def depth(self, force: float) -> float:
        """Return the depth, m, at a force, N."""
        return float(np.interp(force, self.forces, self.depths))


def _static_curve(simulate: Simulation, design: DepthDesign) -> _Curve:
    forces = np.linspace(design.force_min_n, design.force_max_n, _LEVELS)
    n = round(_SETTLE_S * design.sample_rate)
    depths = np.array([simulate(np.full(n, force))[-1] for force in forces])
    if not np.isfinite(depths).all() or not depths[-1] > depths[0]:
        raise UnusableInputError(
            "depth.no_response",
            "in the fitted model depth does not grow with force, so no stimulus can be designed: record another test",
        )
    return _Curve(forces, np.maximum.accumulate(depths))


def _reachable(curve: _Curve, design: DepthDesign, edge: float) -> tuple[float, float]:
    """Return the part of the depth range, m, that is reachable with a share ``edge`` of the force reserved at both
    ends.

    Raises:
        UnusableInputError: no part is reachable; the message gives the reachable range.
    """
    low, high = design.force_min_n, design.force_max_n
    kept = edge * (high - low)
    ends = curve.depth(low + kept), curve.depth(high - kept)
    least, most = max(design.depth_min_m, ends[0]), min(design.depth_max_m, ends[1])
    if not least < most:
        raise UnusableInputError(
            "depth.out_of_reach",
            "depths from {depth_min_m:.2f} to {depth_max_m:.2f} mm are out of reach: forces from {low:g} "
            "to {high:g} N reach {lowest:.2f} to {highest:.2f} mm here",
            depth_min_m=1000.0 * design.depth_min_m,
            depth_max_m=1000.0 * design.depth_max_m,
            low=low,
            high=high,
            lowest=1000.0 * ends[0],
            highest=1000.0 * ends[1],
        )
    return least, most


def _forces_for(wanted: Array, reached: Array, forces: Array) -> Array:
    """Return forces for the wanted depths from forces (m,) and the depths (m,) they reached; extrapolates linearly."""
    rising = reached + 1e-9 * np.arange(reached.size)
    interpolated = np.interp(wanted, rising, forces)
    for beyond, end, inner in ((wanted < rising[0], 0, 3), (wanted > rising[-1], -1, -4)):
        slope = (forces[end] - forces[inner]) / (rising[end] - rising[inner])
        interpolated[beyond] = forces[end] + slope * (wanted[beyond] - rising[end])
    return interpolated


def _bounded(forces: Array, design: DepthDesign) -> Array:
    """Return forces (m,) clipped to the force range and made non-decreasing."""
    rising = np.maximum.accumulate(np.clip(forces, design.force_min_n, design.force_max_n))
    if not rising[-1] > rising[0]:
        raise UnusableInputError(
            "depth.one_force",
            "the fitted model gives the same force at every depth, so no stimulus can be designed: "
            "record a test over more depth",
        )
    return np.asarray(rising, dtype=np.float64)
