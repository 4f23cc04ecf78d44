"""Multistep test: identify, redesign the stimulus for a uniform depth, and repeat (thesis 6.3)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition.background_work import run_while_polling
from tissueid.acquisition.guided import GuidedTest, check_test, run_guided_test
from tissueid.acquisition.playback import Progress
from tissueid.acquisition.recorder import SessionRecorder
from tissueid.acquisition.stimulus_choice import PRELOAD_S
from tissueid.acquisition.surface_detection import Placement, place
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.identification.base import Model
from tissueid.identification.registry import get_engine
from tissueid.identification.validation import validate
from tissueid.instrument import CLINICAL, Instrument, Limits, join_blocks
from tissueid.messages import Message
from tissueid.records import Record, joined
from tissueid.stimuli.base import Array, with_preload
from tissueid.stimuli.depth_uniform import DepthDesign, DepthUniformNoise, design_next_noise, distance_from_uniform
from tissueid.stimuli.kinds.noise import Noise
from tissueid.test_settings import TestSettings

_ENGINES = ("wiener", "dpn")
"""Engines in the order in which they are tried, fastest first."""

_SUFFICIENT_VAF_PERCENT = 99.0
"""Held-out VAF, %, above which no slower engine is tried."""

_FITTED_SHARE = 0.75
"""Share of each record that is fitted; the rest is held out."""

PLACING = Message("test.placing", "placing the probe")


@dataclass(frozen=True)
class Step:
    """Result of one test of a multistep run.

    ``distance`` is the measured Kolmogorov distance of the depth from a uniform distribution over ``depth_min_m`` to
    ``depth_max_m``, the requested range or its reachable part. For the first test ``predicted`` and ``engine`` are
    None.
    """

    number: int
    distance: float
    depth_min_m: float
    depth_max_m: float
    predicted: float | None = None
    engine: str | None = None
    vaf_held_out_percent: float | None = None


@dataclass(frozen=True)
class FittedModel:
    """Model fitted to all tests so far, and its score on held-out data."""

    engine: str
    model: Model
    vaf_held_out_percent: float


@dataclass(frozen=True)
class MultistepTest:
    """Specification of a multistep run: at most ``steps`` tests, fewer when the distance falls to ``target``."""

    design: DepthDesign
    settings: TestSettings
    steps: int = 3
    target: float = 0.05
    seed: int = 1
    limits: Limits = CLINICAL
    preload_s: float = PRELOAD_S

    def guided_test(self, noise: Noise, notes: dict[str, str | float]) -> GuidedTest:
        """Return one of its tests."""
        return GuidedTest(
            with_preload(noise.build(), self.preload_s),
            self.settings,
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
    if not test.settings.has_depth:
        raise UnusableInputError(
            "multistep.no_depth",
            "a multistep test needs a depth, which the configuration {configuration} does not have",
            configuration=test.settings.configuration,
        )
    if test.design.depth_max_m > device.stroke_m:
        raise UnusableInputError(
            "multistep.depth",
            "a depth of {depth:g} mm exceeds the stroke of {stroke:g} mm",
            depth=1e3 * test.design.depth_max_m,
            stroke=1e3 * device.stroke_m,
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

    ``progress`` receives a label of the test and its progress. Between tests the coil is free and the connection to the
    instrument is kept alive.

    Raises:
        UnusableInputError: no part of the depth range is reachable, or no engine could be fitted.
        CancelledError, LimitError, InstrumentError, JournalError: see ``run_guided_test``.
    """
    device, design = instrument.device, test.design
    check_multistep(test, device)
    if surface_m is None:
        surface_m = place(instrument, test.limits, progress=lambda p: progress(PLACING, p), cancelled=cancelled)
    origin_m = surface_m.surface_m if isinstance(surface_m, Placement) else surface_m
    records: list[Record] = []
    steps: list[Step] = []
    fitted: FittedModel | None = None
    designed: DepthUniformNoise | None = None
    while True:
        notes = _notes(design, len(steps) + 1, fitted, designed)
        noise = design.first(test.seed) if designed is None else designed.stimulus
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
            if designed is None
            else (designed.depth_min_m, designed.depth_max_m)
        )
        distance = distance_from_uniform(records[-1].output, low, high)
        recorder.event("depth", distance=distance, depth_min_m=low, depth_max_m=high)
        steps.append(
            Step(
                number,
                distance,
                low,
                high,
                predicted=designed.distance if designed else None,
                engine=fitted.engine if fitted else None,
                vaf_held_out_percent=fitted.vaf_held_out_percent if fitted else None,
            )
        )
        if distance <= test.target or len(steps) == test.steps:
            return tuple(steps)
        seed = test.seed + len(steps)
        fitted, designed = run_while_polling(
            instrument, partial(_design_next, records, design, seed, test.preload_s), cancelled
        )


def fit_best_model(records: Iterable[Record], engines: Iterable[str] = _ENGINES) -> FittedModel:
    """Fit engines to three quarters of each record, select the best on the held-out rest, and refit it to all data.

    A slower engine is tried only if the faster ones do not score well enough.

    Raises:
        UnusableInputError: no engine could be fitted; gives the reason of the last one.
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
        if worst >= _SUFFICIENT_VAF_PERCENT:
            break
    if best is None:
        raise UnusableInputError(
            "multistep.no_fit",
            "no model could be fitted to the tests so far: {reason}",
            reason=refused.message if refused is not None else "",
        )
    return FittedModel(best[1], get_engine(best[1]).from_options({"hold": "zero-order"}).fit(joined(whole)), best[0])


def _design_next(
    records: list[Record], design: DepthDesign, seed: int, preload_s: float
) -> tuple[FittedModel, DepthUniformNoise]:
    fitted = fit_best_model(records)
    return fitted, design_next_noise(fitted.model.simulate, design, seed, preload_s)


def _record(blocks: list[NDArray[np.void]], device: DeviceDescription, surface_m: float, preload_s: float) -> Record:
    """Return a record of the static force of the command and the depth below the surface, without the preload.

    The command is used instead of the measured force because the command is designed: the damping by back-EMF is part
    of the identified response.
    """
    samples = join_blocks(blocks)[round(preload_s * device.sample_rate_hz) :]
    force_n: Array = samples["command"] / device.voltage_for_force(1.0)
    return Record(force_n, samples["position"] - surface_m, device.sample_rate_hz)


def _notes(
    design: DepthDesign, step: int, fitted: FittedModel | None, designed: DepthUniformNoise | None
) -> dict[str, str | float]:
    notes: dict[str, str | float] = {
        "multistep": float(step),
        "depth_asked_min_m": design.depth_min_m,
        "depth_asked_max_m": design.depth_max_m,
    }
    if fitted is not None and designed is not None:
        notes |= {
            "depth_min_m": designed.depth_min_m,
            "depth_max_m": designed.depth_max_m,
            "distance_predicted": designed.distance,
            "designed_by": fitted.engine,
            "vaf_held_out_percent": fitted.vaf_held_out_percent,
        }
    return notes
