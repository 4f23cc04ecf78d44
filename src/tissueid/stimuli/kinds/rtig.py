"""Real-time input generation: force that gives the depth a desired distribution by feedback (Chen 2010, 6.3)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.stimuli.base import MAX_SAMPLES, Array, stimulus
from tissueid.stimuli.feedback import BLOCK, FeedbackKind
from tissueid.stimuli.rtig.histogram import DepthHistogram
from tissueid.stimuli.rtig.identified import Averages, OnlineIdentification
from tissueid.stimuli.rtig.identified_control import IdentifiedController, TargetSweep
from tissueid.stimuli.rtig.local_identification import LocalIdentification
from tissueid.stimuli.rtig.source import RtigSource, SourceParameters, StochasticStream
from tissueid.stimuli.rtig.static_map import StaticMap
from tissueid.stimuli.spectra import check_settling

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
