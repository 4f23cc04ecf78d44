"""Fits that a search runs in worker processes: what is tried, its screening, and the starting points.

Effects are those of the library, or those of an equivalent machine. Screening is the alignment of their signatures with
the residual of the baseline.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tissueid.device import DeviceDescription
from tissueid.gap.dataset import Dataset, Purpose
from tissueid.gap.decision import Candidate, score_candidate
from tissueid.gap.fitting import ESTIMATES, Differences, Fit, LinearRefit, fit, re_estimate
from tissueid.gap.parameters import SURFACE_SHIFT, starts_of
from tissueid.gap.thresholds import LIMITS
from tissueid.twin.catalogue import all_effects
from tissueid.twin.effect import SCALES, Effect
from tissueid.twin.machine_effects import machine_effects

_DRIVE = frozenset({"amplifier_clipping", "amplifier_deadband"})
_OF_POSITION = frozenset({"end_stop", "mount_resonance", "cogging", "sensor_backlash"})
"""Effects outside the tissue that depend on the position, or on a record of it."""
_OF_VELOCITY = frozenset({"directional_damping"})
"""Effects on the tissue that do not depend on the position."""


def effects_of(dataset: Dataset) -> Mapping[str, Effect]:
    """Return the effects of the library by name, with bounds and starts for the instrument, or with those for an
    equivalent machine in an input-output record."""
    if dataset.equivalent is not None:
        return all_effects() | machine_effects()
    ratios = {name: getattr(dataset.instrument, name) / getattr(DeviceDescription, name) for name in SCALES}
    return {name: item.scaled(ratios) for name, item in all_effects().items()}


def acts_on_machine(dataset: Dataset, item: Effect) -> bool:
    """Return whether an effect can be identified in an input-output record."""
    about = dataset.equivalent
    if about is None:
        return False
    if about.output_is_velocity and (item.name in _OF_POSITION or item.stage == "tissue"):
        return item.name in _OF_VELOCITY
    if item.stage == "drive":
        return item.name in _DRIVE
    return item.stage in ("mechanics", "tissue", "sensing") and item.needs <= {"position", "command"}


FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Signature:
    """How far the change of the residuals by an effect at a starting point, after a refit of everything else, explains
    the residual of the baseline.

    ``alignment`` is the squared cosine between that residual and the closest combination of the effect and its
    derivatives by its parameters: the share that a linear effect would explain.
    """

    effect: str
    start: tuple[float, ...]
    alignment: float


class Screen:
    """Signatures on the residuals of a fit."""

    def __init__(self, baseline: Fit) -> None:
        self._baseline = baseline
        self._differences = Differences(baseline)
        self._refit = LinearRefit(baseline)
        self._left = self.surviving(baseline.residuals)
        self._size = float(self._left @ self._left)

    def signatures(self, effect: Effect, starts: Sequence[tuple[float, ...]] = ()) -> list[Signature]:
        """Return the signature of an effect at each of the starts and at the most visible point of its grid; at all its
        starting points without ``starts``."""
        declared = starts or starts_of(self._baseline.parameters.dataset, effect, self._baseline.predictions)
        signatures = []
        for start in dict.fromkeys((*declared, *self._most_visible_starts(effect))):
            added, slopes = self._differences.at(effect, start)
            span = self.surviving(np.column_stack([added, slopes]))
            sizes = np.linalg.norm(span, axis=0)
            span = span[:, sizes > 1e-9 * max(float(sizes.max()), 1e-300)]
            if not span.shape[1]:
                signatures.append(Signature(effect.name, start, 0.0))
                continue
            shares, *_ = np.linalg.lstsq(span / np.linalg.norm(span, axis=0), self._left, rcond=1e-6)
            surviving = (span / np.linalg.norm(span, axis=0)) @ shares
            along = float(surviving @ surviving) / self._size if self._size > 0.0 else 0.0
            signatures.append(Signature(effect.name, start, along))
        return signatures

    def _most_visible_starts(self, effect: Effect) -> list[tuple[float, ...]]:
        # The point of the grid at which the effect, at any size, is closest to the residual of the baseline, for each
        # combination of fixed parameters.
        kinds: dict[tuple[float, ...], list[tuple[float, ...]]] = {}
        for start in effect.scan:
            fixed = (value for item, value in zip(effect.parameters, start, strict=True) if item.fixed)
            kinds.setdefault(tuple(fixed), []).append(start)

        def seen(start: tuple[float, ...]) -> float:
            return cosine(self.surviving_change(effect, start), self._left)

        return [max(grid, key=seen) for grid in kinds.values()]

    def surviving_change(self, effect: Effect, start: Sequence[float]) -> FloatArray:
        """Return the change by an effect at a starting point that a refit cannot absorb, shape (residuals,)."""
        return self.surviving(self._differences.at(effect, start, slopes=False)[0])

    def surviving(self, values: FloatArray) -> FloatArray:
        """Return the part of a change of the residuals that a refit of everything else cannot absorb, shape
        (residuals,)."""
        return self._refit.surviving(values)


def cosine(first: FloatArray, second: FloatArray) -> float:
    """Return the absolute cosine between two signatures; 0 where one is zero."""
    size = float(np.linalg.norm(first) * np.linalg.norm(second))
    return abs(float(first @ second)) / size if size > 0.0 else 0.0


def best_aligned(signatures: Sequence[Signature], most_starts: int = 2) -> list[Signature]:
    """Return the best aligned start of every effect and, up to ``most_starts``, those nearly as well aligned; best
    first."""
    by_effect: dict[str, list[Signature]] = {}
    for item in sorted(signatures, key=lambda item: -item.alignment):
        of_effect = by_effect.setdefault(item.effect, [])
        near_best = not of_effect or item.alignment >= LIMITS.second_start * of_effect[0].alignment
        if near_best and len(of_effect) < most_starts:
            of_effect.append(item)
    return sorted((item for items in by_effect.values() for item in items), key=lambda item: -item.alignment)


ESTIMATES_IN_A_SHORT_FIT = 1
"""Re-estimates of an effect from the record in a short fit; a full fit repeats them."""


@dataclass(frozen=True)
class Task:
    """A fit to run: effects with their starting points, near another fit."""

    dataset: Dataset
    names: tuple[str, ...]
    starts: tuple[tuple[float, ...], ...]
    near: Fit
    most_steps: int
    tracking_rad_s: tuple[float, ...] = ()
    """Bandwidths of an observer of the motion in first fits, from which the fit of the free run starts."""

    def __str__(self) -> str:
        return " + ".join(self.names)


def refit(task: Task) -> Candidate:
    """Run one fit; called in a worker process."""
    library = effects_of(task.dataset)
    effects = [library[name] for name in task.names]
    near, starts = task.near, task.starts
    if task.tracking_rad_s and task.dataset.equivalent is None:
        near, starts = _tracked(task, effects)
    fitted = fit(task.dataset, effects, starts, near=near, most_steps=task.most_steps)
    return score_candidate(re_estimate(fitted, task.most_steps, _readings(task, effects)))


def _readings(task: Task, effects: Sequence[Effect]) -> int:
    # A short fit keeps the estimates of the fit from which it starts.
    if task.most_steps == LIMITS.most_steps:
        return ESTIMATES
    already_estimated = all(item in task.near.parameters.effects for item in effects if item.re_estimate)
    return 0 if already_estimated and task.most_steps < LIMITS.steps_to_re_estimate else ESTIMATES_IN_A_SHORT_FIT


def _tracked(task: Task, effects: Sequence[Effect]) -> tuple[Fit, tuple[tuple[float, ...], ...]]:
    # The fit from which that of the free run starts, and the start of each effect.
    part = _liveliest(task.dataset)
    near, starts = task.near, task.starts
    for bandwidth in task.tracking_rad_s:
        # Its slopes are a first guess for the next fit, recomputed after the first step that gains less than predicted.
        near = fit(
            replace(part, tracking_rad_s=bandwidth), effects, starts, near=near, most_steps=LIMITS.steps_of_tracking
        )
    if part is task.dataset:
        return near, starts
    fitted = fit(part, effects, starts, near=near, most_steps=task.most_steps)
    values = [fitted.parameters.effect_values(fitted.theta, held, part.tests[0].number) for held in effects]
    near = _with_values(task.near, {name: fitted.value(name) for name in fitted.parameters.index})
    return near, tuple(tuple(map(float, of_effect)) for of_effect in values)


def _liveliest(dataset: Dataset) -> Dataset:
    """Return the dataset with only its fitted test on tissue of the fastest motion; itself where one test is fitted.

    A fit to one test costs a fraction of a fit to all, has fewer minima, and determines most of tissue and instrument.
    """
    fitted = [test for test in dataset.tests if test.serving(Purpose.FIT).any()]
    if len(fitted) < 2:
        return dataset
    speeds = [test.sample_rate_hz * float(np.nanstd(np.diff(test.signals["position"]))) for test in fitted]
    on_tissue = [k for k, test in enumerate(fitted) if test.fixture == "tissue"] or list(range(len(fitted)))
    return replace(dataset, tests=(fitted[max(on_tissue, key=speeds.__getitem__)],))


def _with_values(fitted: Fit, values: Mapping[str, float]) -> Fit:
    # A fit with other values of some coordinates, from which another fit can start.
    theta = fitted.theta.copy()
    for name, value in values.items():
        if name in fitted.parameters.index:
            theta[fitted.parameters.index[name]] = value
    return replace(fitted, theta=theta)


def screen(near: Fit, items: Sequence[tuple[str, Sequence[tuple[float, ...]]]]) -> list[Signature]:
    """Return the signatures of effects on the residual of a fit, at the given starting points of each, or at all where
    none are given; called in a worker process."""
    screening, library = Screen(near), effects_of(near.parameters.dataset)
    return [signature for name, starts in items for signature in screening.signatures(library[name], starts)]


def best_starts(near: Fit, name: str) -> list[tuple[float, ...]]:
    """Return the starting points of an effect that are best aligned with the residual of a fit, best first."""
    signatures = sorted(screen(near, [(name, ())]), key=lambda item: -item.alignment)
    return [item.start for item in signatures[: LIMITS.beam]]


def other_minima(fitted: Fit) -> list[Fit]:
    """Return the fit with some values of one of its effects replaced by those of another minimum, for each of them."""
    return [
        _with_values(
            fitted,
            {
                f"{held.name}.{item.name}": float(np.log(values[item.name])) if item.logarithmic else values[item.name]
                for item in held.parameters
                if item.name in values
            },
        )
        for held in fitted.parameters.effects
        for values in held.other_minima
    ]


def from_twin(baseline: Fit) -> Fit:
    """Return a refitted baseline with the values of its twin, where there is one, from which candidates are fitted.

    The baseline absorbs what it can of a new effect: it moves the parameters of the accepted effects, and from there a
    fit with the new effect ends in another minimum. The weight is that of the new session.
    """
    parameters = baseline.parameters
    priors = parameters.dataset.priors
    values = {item.name: item.start for item in parameters.coordinates if item.name in priors}
    return _with_values(baseline, {name: value for name, value in values.items() if name != "weight_n"})


def on_found_surface(baseline: Fit) -> Fit:
    """Return a baseline with the surface that was found.

    The shift of its fit stands for missing effects. It moves little in further fits, and contact ends at a wrong place.
    """
    priors = {item.name: item.prior for item in baseline.parameters.coordinates if item.name == SURFACE_SHIFT}
    return _with_values(baseline, priors)
