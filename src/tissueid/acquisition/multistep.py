"""The multistep test: identify, redesign the stimulus for a uniform depth, and repeat (thesis 6.3)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition.background_work import run_while_polling
from tissueid.acquisition.guided import GuidedTest, check_test, run_guided_test
from tissueid.acquisition.playback import Progress
from tissueid.acquisition.recorder import SessionRecorder
from tissueid.acquisition.stimulus_choice import PRELOAD_S
from tissueid.acquisition.surface_detection import Placement, place
from tissueid.configuration import Configuration
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.identification.base import Model
from tissueid.identification.registry import get_engine
from tissueid.identification.validation import validate
from tissueid.instrument import CLINICAL, SAMPLE, Instrument, Limits
from tissueid.messages import Message
from tissueid.records import Record, joined
from tissueid.stimuli.base import Array, with_preload
from tissueid.stimuli.depth_uniform import DepthDesign, DepthUniformNoise, design_next_noise, distance_from_uniform
from tissueid.stimuli.kinds.noise import Noise

_ENGINES = ("wiener", "dpn")
"""Engines in the order in which they are tried, fastest first."""

_WELL_ENOUGH_PERCENT = 99.0
"""Held-out VAF, %, from which no slower engine is tried."""

_FITTED_SHARE = 0.75
"""Share of each record that is fitted; the rest is held out."""

PLACING = Message("test.placing", "placing the probe")


@dataclass(frozen=True)
class Step:
    """One test of a multistep run.

    ``distance`` is the measured Kolmogorov distance of the depth from a uniform distribution over ``depth_min_m`` to
    ``depth_max_m``, the requested range or its part within reach of the forces. For the first test ``predicted`` and
    ``engine`` are None.
    """

    number: int
    distance: float
    depth_min_m: float
    depth_max_m: float
    predicted: float | None = None
    engine: str | None = None
    vaf_held_out_percent: float | None = None


@dataclass(frozen=True)
class Described:
    """A model fitted to all tests so far, and its score on held-out data."""

    engine: str
    model: Model
    vaf_held_out_percent: float


@dataclass(frozen=True)
class MultistepTest:
    """Specification of a multistep run: at most ``steps`` tests, fewer if the distance falls to ``target``."""

    design: DepthDesign
    site: str
    steps: int = 3
    target: float = 0.05
    seed: int = 1
    limits: Limits = CLINICAL
    preload_s: float = PRELOAD_S
    configuration: Configuration = field(default_factory=Configuration)

    def guided_test(self, noise: Noise, notes: dict[str, str | float]) -> GuidedTest:
        """Return one of its tests."""
        return GuidedTest(
            with_preload(noise.build(), self.preload_s),
            self.site,
            configuration=self.configuration,
            limits=self.limits,
            notes=notes,
        )


def check_multistep(test: MultistepTest, device: DeviceDescription) -> None:
    """Check, before the first test, that the run can be played.

    Raises:
        LimitError: the force range or the length exceeds the limits.
        UnusableInputError: the sample rate differs from the device's, the depth exceeds its stroke, or the
            configuration has no depth.
    """
    if not test.configuration.has_depth:
        raise UnusableInputError(
            Message(
                "multistep.no_depth",
                "a multistep test needs a depth, which the configuration {configuration} does not have",
                configuration=test.configuration.name,
            )
        )
    if test.design.depth_max_m > device.stroke_m:
        raise UnusableInputError(
            Message(
                "multistep.depth",
                "a depth of {depth:g} mm exceeds the stroke of {stroke:g} mm",
                depth=1e3 * test.design.depth_max_m,
                stroke=1e3 * device.stroke_m,
            )
        )
    ends = np.array([test.design.force_min_n, test.design.force_max_n])
    check_test(test.guided_test(test.design.with_quantiles(ends, test.seed), {}), device)


def run_multistep(
    instrument: Instrument,
    test: MultistepTest,
    recorder: SessionRecorder,
    *,
    surface_m: float | Placement | None = None,
    progress: Callable[[str, Progress], None] = lambda _label, _progress: None,
    cancelled: Callable[[], bool] = lambda: False,
) -> tuple[Step, ...]:
    """Run and record the tests; return the steps. Each test has notes about its design.

    ``progress`` receives a label of the test and its progress. Between tests the coil is free and the connection to
    the instrument is kept alive.

    Raises:
        UnusableInputError: no part of the depth range is within reach, or no engine could be fitted.
        CancelledError, LimitError, InstrumentError, JournalError: as for one test.
    """
    device, design = instrument.device, test.design
    check_multistep(test, device)
    if surface_m is None:
        surface_m = place(instrument, test.limits, progress=lambda p: progress(PLACING, p), cancelled=cancelled)
    origin_m = surface_m.surface_m if isinstance(surface_m, Placement) else surface_m
    records: list[Record] = []
    steps: list[Step] = []
    described: Described | None = None
    redesigned: DepthUniformNoise | None = None
    while True:
        notes = _notes(design, len(steps) + 1, described, redesigned)
        noise = design.first(test.seed) if redesigned is None else redesigned.stimulus
        label = Message("multistep.step", "step {step} of {steps}", step=len(steps) + 1, steps=test.steps)
        blocks: list[NDArray[np.void]] = []

        def take(p: Progress, label: str = label, blocks: list[NDArray[np.void]] = blocks) -> None:
            blocks.append(p.samples)
            progress(label, p)

        number = run_guided_test(
            instrument,
            test.guided_test(noise, notes),
            recorder,
            surface_m=surface_m,
            progress=take,
            cancelled=cancelled,
        )
        records.append(_record(blocks, device, origin_m, test.preload_s))
        low, high = (
            (design.depth_min_m, design.depth_max_m)
            if redesigned is None
            else (redesigned.depth_min_m, redesigned.depth_max_m)
        )
        distance = distance_from_uniform(records[-1].output, low, high)
        recorder.event("depth", distance=distance, depth_min_m=low, depth_max_m=high)
        steps.append(
            Step(
                number,
                distance,
                low,
                high,
                predicted=redesigned.distance if redesigned else None,
                engine=described.engine if described else None,
                vaf_held_out_percent=described.vaf_held_out_percent if described else None,
            )
        )
        if distance <= test.target or len(steps) == test.steps:
            return tuple(steps)
        seed = test.seed + len(steps)
        described, redesigned = run_while_polling(
            instrument, partial(_next, records, design, seed, test.preload_s), cancelled
        )


def describe_system(records: Iterable[Record], engines: Iterable[str] = _ENGINES) -> Described:
    """Fit engines to three quarters of each record, choose the best on the held-out rest, and fit it to all.

    A slower engine is tried only if the faster ones do not score well enough.

    Raises:
        UnusableInputError: no engine could be fitted; with the reason of the last one.
    """
    whole = tuple(records)
    cuts = [round(_FITTED_SHARE * len(record)) for record in whole]
    fitted = joined([record[:cut] for record, cut in zip(whole, cuts, strict=True)])
    best: tuple[float, str] | None = None
    refused: UnusableInputError | None = None
    for name in engines:
        specification = get_engine(name).from_options({"hold": "zero-order"})
        try:
            model = specification.fit(fitted)
            scores = [
                validate(model, record, slice(cut, None)).vaf_percent for record, cut in zip(whole, cuts, strict=True)
            ]
        except UnusableInputError as error:
            refused = error
            continue
        worst = min(scores)
        if best is None or worst > best[0]:
            best = worst, name
        if worst >= _WELL_ENOUGH_PERCENT:
            break
    if best is None:
        raise UnusableInputError(
            Message(
                "multistep.no_fit",
                "no model could be fitted to the tests so far: {reason}",
                reason=refused.message if refused is not None else "",
            )
        )
    return Described(best[1], get_engine(best[1]).from_options({"hold": "zero-order"}).fit(joined(whole)), best[0])


def _next(
    records: list[Record], design: DepthDesign, seed: int, preload_s: float
) -> tuple[Described, DepthUniformNoise]:
    described = describe_system(records)
    return described, design_next_noise(described.model.simulate, design, seed, preload_s)


def _record(blocks: list[NDArray[np.void]], device: DeviceDescription, surface_m: float, preload_s: float) -> Record:
    """Return command, as the static force it gives, and depth below the surface, after the preload.

    The command is used instead of the measured force because a command is designed: the damping by the coil's motion
    belongs to the response.
    """
    samples = np.concatenate([*blocks, np.zeros(0, SAMPLE)])[round(preload_s * device.sample_rate_hz) :]
    force_n: Array = samples["command"] / device.voltage_for_force(1.0)
    return Record(force_n, samples["position"] - surface_m, device.sample_rate_hz)


def _notes(
    design: DepthDesign, step: int, described: Described | None, redesigned: DepthUniformNoise | None
) -> dict[str, str | float]:
    notes: dict[str, str | float] = {
        "multistep": float(step),
        "depth_asked_min_m": design.depth_min_m,
        "depth_asked_max_m": design.depth_max_m,
    }
    if described is not None and redesigned is not None:
        notes |= {
            "depth_min_m": redesigned.depth_min_m,
            "depth_max_m": redesigned.depth_max_m,
            "distance_predicted": redesigned.distance,
            "designed_by": described.engine,
            "vaf_held_out_percent": described.vaf_held_out_percent,
        }
    return notes
