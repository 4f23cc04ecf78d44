"""Running RTIG test: takes measured samples, returns blocks of set-points (Chen 2010, Eq. 6.9), partly stochastic."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator
from scipy import signal, special

from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.stimuli.base import BLOCK, MAX_SAMPLES, Array, FeedbackKind, FeedbackSource, stimulus
from tissueid.stimuli.rtig.identified import (
    Averages,
    IdentifiedController,
    LocalIdentification,
    OnlineIdentification,
    TargetSweep,
)
from tissueid.stimuli.rtig.static_map import DepthHistogram, StaticMap
from tissueid.stimuli.spectra import check_settling, settling_samples

Shape = Literal["uniform", "gaussian"]

_GAUSSIAN_CLIP = 3.0
"""Clipping level of Gaussian noise, in standard deviations; scaled to 1."""


class StochasticStream:
    """Generator of low-passed noise within -1 to 1 whose filter state continues from block to block.

    Filtering makes noise Gaussian. The uniform shape is obtained by applying the Gaussian distribution function to the
    filtered noise.
    """

    def __init__(self, shape: Shape, cutoff_hz: float, order: int, sample_rate: float, seed: int) -> None:
        self._shape = shape
        self._random = np.random.Generator(np.random.PCG64(seed))
        self._low_pass = signal.butter(order, cutoff_hz, fs=sample_rate, output="sos")
        settle = settling_samples(cutoff_hz, sample_rate)
        impulse = np.zeros(settle)
        impulse[0] = 1.0
        self._spread = float(np.linalg.norm(signal.sosfilt(self._low_pass, impulse)))
        self._state = np.zeros((self._low_pass.shape[0], 2))
        self.take(settle)

    @staticmethod
    def variance(shape: Shape) -> float:
        """Return the variance of the values for a shape."""
        return 1.0 / 3.0 if shape == "uniform" else 1.0 / _GAUSSIAN_CLIP**2

    def take(self, n: int) -> Array:
        """Return the next n values, shape (n,), from -1 to 1."""
        filtered, self._state = signal.sosfilt(self._low_pass, self._random.standard_normal(n), zi=self._state)
        normal = filtered / self._spread
        if self._shape == "gaussian":
            return np.asarray(np.clip(normal / _GAUSSIAN_CLIP, -1.0, 1.0))
        return np.asarray(special.erf(normal / np.sqrt(2.0)))


_STEP_SHARE = 0.3
"""Share of the distance to the target bin covered per block, away from the edges."""

_EDGE_SHARE = 0.15
"""Share of the range at either end over which the edge modulation applies."""

_LIMIT_BLOCKS = 6
"""Blocks at a limit of the force range after which the current depth counts as the end of the reachable range."""


class FixedGainController:
    """Controller of the offsets by Eq. 6.9 with a fixed gain, block by block.

    Args:
        histogram: of the depths so far.
        gain: change of force for a change of depth, N/m.
        edge_modulation: share of the gain that remains at the edges of the range, 0 to 1.
        force: range of the force, N.
    """

    def __init__(
        self, histogram: DepthHistogram, gain: float, edge_modulation: float, force: tuple[float, float]
    ) -> None:
        self._histogram = histogram
        self._gain = gain
        self._edge_modulation = edge_modulation
        self._force = force
        self._at_end = 0
        self._reach = [float(histogram.edges[0]), float(histogram.edges[-1])]

    def offset(self, last: float, measured: tuple[float, float], pending: Array) -> Array:
        """Return the next offsets, N, shape (BLOCK,).

        Args:
            last: offset at the end of the previous block, N.
            measured: mean depth of the newest samples, m, and their mean offset, N.
            pending: offsets (n,) of the samples generated and not yet measured, N.
        """
        edges, histogram = self._histogram.edges, self._histogram
        low, high = float(edges[0]), float(edges[-1])
        depth, then = measured
        expected = np.clip(depth + (np.append(pending, last) - then) / self._gain, low, high)
        self._update_reach(last, depth)
        centres = 0.5 * (edges[1:] + edges[:-1])
        want = histogram.missing_samples(expected[:-1], BLOCK, (self._reach[0], self._reach[1]))
        want[(centres < self._reach[0]) | (centres > self._reach[1])] = -np.inf
        here = float(expected[-1])
        # Break ties by distance, so that an even histogram gives a sweep instead of jumps.
        target = float(centres[np.lexsort((np.abs(centres - here), -want))[0]])
        from_edge = min(here - low, high - here) / (_EDGE_SHARE * (high - low))
        toward_edge = (target > here) == (here > 0.5 * (low + high))
        modulation = self._edge_modulation + (1.0 - self._edge_modulation) * min(1.0, from_edge)
        change = self._gain * _STEP_SHARE * (modulation if toward_edge else 1.0) * (target - here)
        goal = float(np.clip(last + change, *self._force))  # Eq. 6.9
        return last + (goal - last) * np.arange(1, BLOCK + 1) / BLOCK

    def _update_reach(self, last: float, depth: float) -> None:
        """Exclude depths that the force range does not reach, and include them again when they are reached."""
        edges = self._histogram.edges
        ends = (last <= self._force[0], last >= self._force[1])
        self._at_end = self._at_end + 1 if any(ends) else 0
        bin_width = float(edges[1] - edges[0])
        if self._at_end >= _LIMIT_BLOCKS:
            if ends[1]:
                self._reach[1] = max(self._reach[0] + bin_width, min(self._reach[1], depth))
            else:
                self._reach[0] = min(self._reach[1] - bin_width, max(self._reach[0], depth))
        self._reach[1] = max(self._reach[1], min(depth, float(edges[-1])))
        self._reach[0] = min(self._reach[0], max(depth, float(edges[0])))


_MAX_GAP_S = 0.15
"""Time without samples, s, beyond the lead, after which the offset returns to the preload."""

_RETURN_S = 0.1
"""Duration of that return over the whole force range, s."""

_MIN_STOCHASTIC = 0.2
"""Minimum share of the stochastic part near the ends of the force range, where half of it would be clipped."""

_STEP_FADE = np.maximum(0.0, 1.0 - np.arange(1, BLOCK + 1) / (0.5 * BLOCK))
"""Weights (BLOCK,) that fade out a step between two blocks over half a block."""


@dataclass(frozen=True)
class SourceParameters:
    """Parameters of a source, SI; see the options of the kind."""

    samples: int
    sample_rate: float
    lead: int
    force: tuple[float, float]
    preload: float
    amplitude: float
    gain: float
    edge_modulation: float


class RtigSource(FeedbackSource):
    """State of one RTIG test: offset controllers with and without identification, and the stochastic part."""

    def __init__(
        self,
        setup: SourceParameters,
        surface_m: float,
        histogram: DepthHistogram,
        stream: StochasticStream,
        identified: OnlineIdentification | None,
    ) -> None:
        self._setup = setup
        self._surface = surface_m
        self._histogram = histogram
        self._stream = stream
        self._identified = identified
        self._fixed_gain = FixedGainController(histogram, setup.gain, setup.edge_modulation, setup.force)
        self._offsets = np.full(setup.samples + BLOCK, setup.preload)
        self._last = setup.preload
        self._made = self._identified_blocks = 0
        self._taken = self._worked = 0
        self._begun = False
        self._received_until: int | None = None
        """Index after the newest received sample."""
        self._depth = np.nan
        self._waiting = np.empty((2, 0))

    def take(self, force: Array, position: Array, first: int) -> None:
        """Process measured force (k,), N, and position (k,), m; see :class:`FeedbackSource`.

        Omitted samples count as lost, repeated ones are ignored. Samples are processed in whole blocks, so that the
        result does not depend on how the input is split into calls.
        """
        depth = np.asarray(position, dtype=np.float64) - self._surface
        signals = np.stack([np.asarray(force, dtype=np.float64), depth])
        signals[:, ~np.isfinite(signals).all(axis=0)] = np.nan
        if not self._begun:
            self._taken = self._worked = min(first, 0)
            self._begun = True
        if first > self._taken:
            signals = np.concatenate([np.full((2, first - self._taken), np.nan), signals], axis=1)
        signals = signals[:, max(0, self._taken - first) :]
        self._taken += signals.shape[1]
        self._waiting = np.concatenate([self._waiting, signals], axis=1)
        while (cut := self._next_piece_length()) is not None:
            piece, self._waiting = self._waiting[:, :cut], self._waiting[:, cut:]
            self._process(piece[0], piece[1], self._worked)
            self._worked += cut

    def _next_piece_length(self) -> int | None:
        """Return the length of the next complete piece, which ends at a block boundary or at the end of the test."""
        end = self._worked // BLOCK * BLOCK + BLOCK
        if self._worked < self._histogram.samples <= self._taken:
            end = min(end, self._histogram.samples)
        cut = end - self._worked
        return cut if cut <= self._waiting.shape[1] else None

    def _process(self, force: Array, depth: Array, first: int) -> None:
        received = np.flatnonzero(np.isfinite(depth))
        if received.size:
            self._received_until = first + int(received[-1]) + 1
            self._depth = float(depth[received].mean())
        if self._identified is not None:
            self._identified.take(force, depth, first)
        if first >= 0:
            self._histogram.add(depth)

    def next_block(self) -> Array:
        """Return the next set-points, N, (BLOCK,): Eq. 6.9, within the force range."""
        setup, made = self._setup, self._made
        noise = setup.amplitude * self._stream.take(BLOCK)
        offset, stochastic_share = self._offset(self._last)
        offset = np.clip(offset + (self._last - offset[0]) * _STEP_FADE, *setup.force)
        self._offsets[made : made + BLOCK] = offset[: max(0, self._offsets.size - made)]
        self._last = float(offset[-1])
        self._made += BLOCK
        room = np.minimum(offset - setup.force[0], setup.force[1] - offset)
        stochastic_share = stochastic_share * np.clip(room / max(setup.amplitude, 1e-9), _MIN_STOCHASTIC, 1.0)
        return np.asarray(np.clip(offset + stochastic_share * noise, *setup.force))

    def _offset(self, last: float) -> tuple[Array, Array]:
        """Return the next offsets, N, and the share of the stochastic part to add, each (BLOCK,)."""
        setup, made = self._setup, self._made
        max_gap = setup.lead * BLOCK + _MAX_GAP_S * setup.sample_rate
        if self._received_until is None or made - self._received_until > max_gap:
            step = (setup.force[1] - setup.force[0]) / (_RETURN_S * setup.sample_rate) * np.arange(1, BLOCK + 1)
            return last + np.clip(setup.preload - last, -step, step), np.zeros(BLOCK)
        if self._identified is not None and self._identified.good:
            self._identified_blocks += 1
            return self._identified.controller.offset(made, self._depth)
        if self._identified is not None:
            self._identified.controller.reset()
        newest = self._histogram.seen
        then = self._offsets[max(0, newest - BLOCK) : newest]
        measured = self._depth, float(then.mean()) if then.size else setup.preload
        return self._fixed_gain.offset(last, measured, self._offsets[newest:made]), np.ones(BLOCK)

    def report(self) -> dict[str, Any]:
        """Return depth distribution, cycles and identified parameters so far; see docs/stimuli.md for the fields."""
        histogram, setup = self._histogram, self._setup
        reached = histogram.reached
        answer: dict[str, Any] = {
            "kolmogorov_distance": histogram.distance,
            "samples": histogram.seen,
            "block_s": BLOCK / setup.sample_rate,
            "lost": histogram.lost,
            "edges_m": histogram.edges.tolist(),
            "counts": histogram.counts.tolist(),
            "desired": histogram.shares.tolist(),
            "below": histogram.below,
            "above": histogram.above,
            "cycles": 0.5 * histogram.half_cycles,
            "cover_s": None if histogram.full_coverage_at is None else histogram.full_coverage_at / setup.sample_rate,
            "reached_m": None if reached is None else list(reached),
            "identification": None,
        }
        if self._identified is not None:
            reachable = self._identified.controller.reachable
            answer["reachable_m"] = list(reachable)
            answer["kolmogorov_distance_reachable"] = histogram.distance_between(*reachable)
            answer["identification"] = self._identified.report() | {
                "share": self._identified_blocks * BLOCK / max(1, self._made)
            }
        return answer


_PRELOAD_SHARE = 0.1
"""Preload as a share of the positive force range: a gentle load that soft tissue tolerates too."""

_MIN_RANGE_M = 1e-4
"""Minimum depth range, m."""

_AVERAGES_HZ = (200.0, 2000.0)
"""Bounds of the rate to which measured samples are averaged for identification; otherwise twice the cutoff."""


@stimulus
class Rtig(FeedbackKind):
    """Real-time input generation by feedback of the depth distribution (Chen 2010, Eq. 6.9).

    Each block of set-points is an offset that moves the depth to where samples are missing, plus a stochastic part that
    excites the dynamics. Without ``identify`` the offset targets the emptiest bin with a fixed gain (6.3.1). With it
    the tissue is identified during the test: the static force gives the offset for a depth, adaptive least squares give
    mass, damping and stiffness by depth, and the range is swept so that the final histogram is flat (6.3.2). While the
    identified model does not predict the measured force, blocks are generated without it.

    Depths are measured from the surface, positive into the tissue. The force never leaves its range; unreachable depths
    are left out and reported.
    """

    name: ClassVar[str] = "rtig"
    title: ClassVar[str] = marked("Equal depths, by feedback")
    applies: ClassVar[Mapping[str, tuple[str, tuple[object, ...]]]] = {
        "table": ("distribution", ("table",)),
        "edge_modulation": ("identify", (False,)),
        "memory": ("identify", (True,)),
        "forgetting": ("identify", (True,)),
        "cycle": ("identify", (True,)),
    }

    force_min_n: float = Field(
        -0.6, ge=-100.0, le=100.0, description=marked("Least force, N; below zero the coil lifts its own weight")
    )
    depth_min_m: float = Field(0.001, ge=-0.05, le=0.05, description=marked("Least desired depth from the surface, m"))
    depth_max_m: float = Field(0.004, ge=-0.05, le=0.05, description=marked("Greatest desired depth, m"))
    distribution: Literal["uniform", "triangular", "table"] = Field(
        "uniform", description=marked("Desired distribution of the depth over its range")
    )
    table: tuple[float, ...] = Field(
        (),
        max_length=200,
        description=marked("table: desired time in each of the equal parts of the range, any unit"),
    )
    bins: int = Field(30, ge=4, le=200, description=marked("Bins of the histogram over the range of depth"))
    gain_n_per_m: float = Field(
        1000.0,
        gt=0.0,
        le=1e6,
        description=marked("Assumed stiffness, N/m: change of force for a change of depth"),
    )
    edge_modulation: float = Field(
        0.3,
        ge=0.0,
        le=1.0,
        description=marked("Without identification: share of the gain at the edges of the range"),
    )
    stochastic: Literal["uniform", "gaussian"] = Field(
        "uniform", description=marked("Distribution of the stochastic part")
    )
    stochastic_share: float = Field(
        0.13, ge=0.0, le=0.3, description=marked("Width of the stochastic part relative to the force range")
    )
    cutoff_hz: float = Field(200.0, ge=1.0, description=marked("Cutoff frequency of the stochastic part, Hz"))
    order: int = Field(8, ge=1, le=12, description=marked("Order of its low-pass"))
    identify: bool = Field(True, description=marked("Identify the tissue during the test and control by the model"))
    memory: float = Field(
        0.0625, gt=0.0, le=1.0, description=marked("With identification: length of the local responses, s")
    )
    forgetting: float = Field(
        2.0,
        ge=0.1,
        le=1000.0,
        description=marked("With identification: time constant of forgetting of the static force, s"),
    )
    cycle: float = Field(
        0.5, ge=0.1, le=60.0, description=marked("With identification: length of a sweep in and out, s")
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.depth_max_m - self.depth_min_m < _MIN_RANGE_M:
            raise UnusableInputError(
                "rtig.range",
                "the greatest depth ({depth_max_m:g} mm) must exceed the least depth ({depth_min_m:g} mm) "
                "by at least {least:g} mm",
                depth_max_m=1000.0 * self.depth_max_m,
                least=1000.0 * _MIN_RANGE_M,
                depth_min_m=1000.0 * self.depth_min_m,
            )
        if self.cutoff_hz >= 0.5 * self.sample_rate:
            raise UnusableInputError(
                "rtig.nyquist",
                "a cutoff of {cutoff_hz:g} Hz needs a sample rate above {needed:g} Hz, not {sample_rate:g} Hz",
                cutoff_hz=self.cutoff_hz,
                needed=2 * self.cutoff_hz,
                sample_rate=self.sample_rate,
            )
        check_settling(self.cutoff_hz, self.sample_rate)
        samples = round(self.seconds * self.sample_rate)
        if samples > MAX_SAMPLES:
            raise UnusableInputError(
                "rtig.samples",
                "the test would have {samples:.3g} samples; the maximum is {limit:.3g}: shorten it",
                samples=samples,
                limit=MAX_SAMPLES,
            )
        if samples < BLOCK:
            raise UnusableInputError(
                "rtig.short",
                "{seconds:g} s at {sample_rate:g} Hz is less than one block of {block} samples: lengthen the test",
                seconds=self.seconds,
                sample_rate=self.sample_rate,
                block=BLOCK,
            )
        if self.distribution == "table" and not (len(self.table) > 1 and min(self.table) >= 0.0 < max(self.table)):
            raise UnusableInputError(
                "rtig.table", "a table of the desired distribution needs at least two entries, none negative"
            )
        if self.table and not math.isfinite(sum(self.table)):
            raise UnusableInputError(
                "rtig.table_sum", "the sum of the table of the desired distribution is not finite: give smaller numbers"
            )
        if self.table and self.distribution != "table":
            raise UnusableInputError(
                "rtig.table_distribution", "a table of the desired distribution needs distribution 'table'"
            )
        return self

    @property
    def preload_n(self) -> float:
        """Preload, N: a tenth of the positive part of the force range above its lower end."""
        least = min(max(0.0, self.force_min_n), self.force_max_n)
        return least + _PRELOAD_SHARE * (self.force_max_n - least)

    @property
    def desired(self) -> Array:
        """Desired share of time in each bin, (bins,), with sum 1."""
        edges = np.linspace(0.0, 1.0, self.bins + 1)
        table = np.array({"uniform": (1.0,), "triangular": ()}.get(self.distribution, self.table))
        if self.distribution == "triangular":
            cumulative = np.where(edges < 0.5, 2.0 * edges**2, 1.0 - 2.0 * (1.0 - edges) ** 2)
        else:
            steps = np.linspace(0.0, 1.0, table.size + 1)
            cumulative = np.interp(edges, steps, np.concatenate([[0.0], np.cumsum(table) / table.sum()]))
        return np.diff(cumulative)

    def start(self, surface_m: float) -> RtigSource:
        """Return a source for one test. ``surface_m`` is the position of the tissue surface, m."""
        depth, force = (self.depth_min_m, self.depth_max_m), (self.force_min_n, self.force_max_n)
        amplitude = 0.5 * self.stochastic_share * (force[1] - force[0])
        samples = round(self.seconds * self.sample_rate)
        histogram = DepthHistogram(np.linspace(*depth, self.bins + 1), self.desired, samples)
        setup = SourceParameters(
            samples=samples,
            sample_rate=self.sample_rate,
            lead=self.lead,
            force=force,
            preload=self.preload_n,
            amplitude=amplitude,
            gain=self.gain_n_per_m,
            edge_modulation=self.edge_modulation,
        )
        stream = StochasticStream(self.stochastic, self.cutoff_hz, self.order, self.sample_rate, self.seed)
        identified = self._identified(histogram, amplitude) if self.identify else None
        return RtigSource(setup, surface_m, histogram, stream, identified)

    def _identified(self, histogram: DepthHistogram, amplitude: float) -> OnlineIdentification:
        depth, force = (self.depth_min_m, self.depth_max_m), (self.force_min_n, self.force_max_n)
        usual = float(np.clip(2.0 * self.cutoff_hz, *_AVERAGES_HZ))
        every = max(1, int(self.sample_rate / usual))
        rate = self.sample_rate / every
        static = StaticMap(depth, force, self.gain_n_per_m, 1.0 / (self.forgetting * rate))
        local = LocalIdentification(depth, rate, self.memory, amplitude)
        sweep = TargetSweep(histogram.edges, histogram.shares, 0.5 * self.cycle * self.sample_rate)
        density = amplitude**2 * StochasticStream.variance(self.stochastic) / (2.0 * self.cutoff_hz)
        controller = IdentifiedController(histogram, static, local, sweep, force, self.sample_rate, density)
        return OnlineIdentification(
            Averages(every, self.sample_rate), static, local, controller, force[1] - force[0], rate
        )
