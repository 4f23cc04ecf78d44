"""The next stimulus of a multistep test: the one that a fitted description says will spread the depth evenly (6.3).

The spectrum is given: slow noise that goes through the depths, and under it fast noise up to the cut-off, by which the
dynamics are identified. The distribution of the force is sought. Each round simulates what the stimulus would do, and
gives every force the place in the distribution at which the simulated depth is due; the round that comes nearest is
kept. What a linear system would do to a distribution (bring it nearer to a Gaussian, 3.1.1) is so undone beforehand.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.option_errors import option_error
from tissueid.stimuli.base import Array, check_rising, guided
from tissueid.stimuli.distributions import kolmogorov_distance
from tissueid.stimuli.kinds.noise import Noise

Simulation = Callable[[Array], Array]
"""Depth from the surface, m, shape (n,), for a force, N, shape (n,), from rest."""

_ROUNDS = 12
_LEVELS = 33
"""Quantiles of the force: 3 % of the samples lie between two of them."""

_SETTLE_S = 0.5
_EDGES = (0.0, 0.01, 0.02, 0.05)
"""Shares of the force range that are kept at either end to turn the motion round in: no more than is needed."""

_EVEN = 0.02
"""Predicted distance at which no more is kept."""

_TABLE_HZ = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0, 9.0, 14.0)
"""Frequencies of the table of the spectrum, in cut-offs of its slow part."""


class DepthDesign(BaseModel):
    """What a multistep test is to reach, and with what: the same for each of its tests but for the seed."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    depth_min_m: float = Field(ge=-0.05, le=0.05, description=marked("Least depth, m, from the surface"))
    depth_max_m: float = Field(ge=-0.05, le=0.05, description=marked("Greatest depth, m, from the surface"))
    force_min_n: float = Field(0.0, ge=-100.0, le=100.0, description=marked("Least force, N"))
    force_max_n: float = Field(10.5, ge=-100.0, le=100.0, description=marked("Greatest force, N"))
    seconds: float = Field(
        3.0, ge=0.5, le=60.0, description=marked("Length of each test, s; its preload comes before it")
    )
    sample_rate: float = Field(2000.0, gt=0.0, le=1e6, description=marked("Samples a second"))
    slow_hz: float = Field(8.0, gt=0.0, le=100.0, description=marked("Cut-off of the slow part, Hz"))
    fast_share: float = Field(0.15, ge=0.0, le=1.0, description=marked("Share of the power in the fast part"))
    cutoff_hz: float = Field(200.0, gt=0.0, description=marked("Cut-off of the fast part, Hz"))

    @model_validator(mode="after")
    def _ranges_hold(self) -> Self:
        check_rising("depth", 1e3 * self.depth_min_m, 1e3 * self.depth_max_m, "mm")
        check_rising("force", self.force_min_n, self.force_max_n, "N")
        return self

    @classmethod
    def from_options(cls, options: Mapping[str, Any]) -> Self:
        """Build it from named options.

        Raises:
            UnusableInputError: an option is unknown, out of its bounds, or at odds with another.
        """
        try:
            return cls.model_validate(dict(options))
        except ValidationError as error:
            raise UnusableInputError(option_error("multistep", cls.model_fields, error)) from error

    def first(self, seed: int) -> Noise:
        """The test before anything is known: Gaussian, and gentle, over the lower half of the force range."""
        middle = 0.5 * (self.force_min_n + self.force_max_n)
        return self._noise(seed, force_min_n=self.force_min_n, force_max_n=middle, distribution="gaussian")

    def with_quantiles(self, force: Array, seed: int) -> Noise:
        """Noise whose force has these quantiles (m,), N, at evenly spaced probabilities."""
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
class Redesign:
    """The next stimulus, and what the description says that it will do.

    ``depth_min_m`` and ``depth_max_m`` are the range that it is designed for: the one asked, or what of it the forces
    can reach. ``distance`` is the Kolmogorov distance from uniform that is predicted, and ``history`` that of each
    round.
    """

    stimulus: Noise
    depth_min_m: float
    depth_max_m: float
    distance: float
    history: tuple[float, ...]


def uniform_distance(depth: Array, low: float, high: float) -> float:
    """Kolmogorov distance of depths (n,) from a uniform distribution between two depths; NaN are left out.

    Raises:
        UnusableInputError: no depth was received.
    """
    received = depth[np.isfinite(depth)]
    if not received.size:
        raise UnusableInputError(Message("depth.lost", "no sample of the depth was received"))
    return kolmogorov_distance(received, np.linspace(low, high, received.size))


def redesign(simulate: Simulation, design: DepthDesign, seed: int, preload_s: float) -> Redesign:
    """Find the noise whose simulated depth is uniform over the range, or over what of it can be reached.

    Args:
        simulate: the fitted description.
        design: what is to be reached.
        seed: of the noise.
        preload_s: how long the mean load is held before it.

    Raises:
        UnusableInputError: nothing of the range can be reached, or the description does not answer the force.
    """
    curve = _static_curve(simulate, design)
    best: Redesign | None = None
    for edge in _EDGES:
        low, high = _reachable(curve, design, edge)
        if best is not None and (low, high) == (best.depth_min_m, best.depth_max_m):
            continue  # the forces are not what keeps it from being even
        found = _over_range(simulate, design, seed, preload_s, curve, low, high)
        if best is None or found.distance < best.distance:
            best = found
        if best.distance <= _EVEN:
            break
    assert best is not None
    return best


def _over_range(
    simulate: Simulation, design: DepthDesign, seed: int, preload_s: float, curve: _Curve, low: float, high: float
) -> Redesign:
    """The noise for a range that is within reach, by rounds of simulation."""
    wanted = np.linspace(low, high, _LEVELS)
    held = round(preload_s * design.sample_rate)
    quantiles = _bounded(curve.force(wanted), design)
    best: tuple[float, Noise] | None = None
    history: list[float] = []
    for _ in range(_ROUNDS):
        tried = design.with_quantiles(quantiles, seed)
        depth = simulate(guided(tried.build(), preload_s).values)[held:]
        history.append(uniform_distance(depth, low, high))
        if best is None or history[-1] < best[0]:
            best = history[-1], tried
        reached = np.quantile(depth, np.linspace(0.0, 1.0, _LEVELS))
        quantiles = _bounded(_forces_for(wanted, reached, quantiles), design)
    assert best is not None
    return Redesign(best[1], low, high, best[0], tuple(history))


@dataclass(frozen=True, eq=False)
class _Curve:
    """Depths (m,), m, that forces (m,), N, hold at rest, both rising."""

    forces: Array
    depths: Array

    def force(self, depth: Array) -> Array:
        """Force, N, that holds each depth (k,)."""
        return np.interp(depth, self.depths, self.forces)

    def depth(self, force: float) -> float:
        """Depth, m, at a force."""
        return float(np.interp(force, self.forces, self.depths))


def _static_curve(simulate: Simulation, design: DepthDesign) -> _Curve:
    forces = np.linspace(design.force_min_n, design.force_max_n, _LEVELS)
    n = round(_SETTLE_S * design.sample_rate)
    depths = np.array([simulate(np.full(n, force))[-1] for force in forces])
    if not np.isfinite(depths).all() or not depths[-1] > depths[0]:
        raise UnusableInputError(
            Message(
                "depth.no_response",
                "the fitted description does not go deeper with more force: nothing can be designed",
            )
        )
    return _Curve(forces, np.maximum.accumulate(depths))


def _reachable(curve: _Curve, design: DepthDesign, edge: float) -> tuple[float, float]:
    """The part of the depth range, m, that is within reach when a share of the force is kept at either end.

    Raises:
        UnusableInputError: none of it; the line says what is within reach.
    """
    low, high = design.force_min_n, design.force_max_n
    kept = edge * (high - low)
    ends = curve.depth(low + kept), curve.depth(high - kept)
    least, most = max(design.depth_min_m, ends[0]), min(design.depth_max_m, ends[1])
    if not least < most:
        raise UnusableInputError(
            Message(
                "depth.out_of_reach",
                "depths from {depth_min_m:.2f} to {depth_max_m:.2f} mm are out of reach: forces from "
                "{low:g} to {high:g} N go from {lowest:.2f} to {highest:.2f} mm here",
                depth_min_m=1000.0 * design.depth_min_m,
                depth_max_m=1000.0 * design.depth_max_m,
                low=low,
                high=high,
                lowest=1000.0 * ends[0],
                highest=1000.0 * ends[1],
            )
        )
    return least, most


def _forces_for(wanted: Array, reached: Array, forces: Array) -> Array:
    """Forces for the wanted depths, when these forces (m,) reached these depths (m,); straight on beyond the ends."""
    rising = reached + 1e-9 * np.arange(reached.size)
    found = np.interp(wanted, rising, forces)
    for beyond, end, inner in ((wanted < rising[0], 0, 3), (wanted > rising[-1], -1, -4)):
        slope = (forces[end] - forces[inner]) / (rising[end] - rising[inner])
        found[beyond] = forces[end] + slope * (wanted[beyond] - rising[end])
    return found


def _bounded(forces: Array, design: DepthDesign) -> Array:
    """Forces (m,) within their range, rising, and never all the same."""
    rising = np.maximum.accumulate(np.clip(forces, design.force_min_n, design.force_max_n))
    if not rising[-1] > rising[0]:
        raise UnusableInputError(
            Message(
                "depth.one_force",
                "the fitted model gives the same force at every depth, so no stimulus can be designed: "
                "record a test over more depth",
            )
        )
    return np.asarray(rising, dtype=np.float64)
