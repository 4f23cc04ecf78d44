"""Choice of the baseline of an input-output record: the family of machines that predicts held-out samples best.

First the kind of prediction. A machine without a spring integrates its input, and a free run of it drifts: it is
predicted over windows that restart from the recorded motion. The families are then compared with the same prediction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.signal import savgol_filter

from tissueid.gap.dataset import Dataset, DatasetTest, Purpose, interpolated
from tissueid.gap.decision import score_candidate
from tissueid.gap.equivalent_oscillator import (
    FAMILY_NAMES,
    VELOCITY_TIME_S,
    Equivalent,
    Family,
    FrequencyResponse,
    frequency_response,
)
from tissueid.gap.fitting import Fit, fit
from tissueid.gap.forward_model import recorded_state, restarts, velocity_error
from tissueid.messages import Message
from tissueid.twin.machine_effects import friction_starts, machine_effects

FloatArray = NDArray[np.float64]

SPRING_GAIN = 0.1
"""Least decrease of the score over windows by a spring, nats: below it the machine integrates its input."""
SLOW_WINDOWS = 1.0
"""Time constant of damper and spring, in windows, above which the spring is too soft to hold the mass in place."""
SPRING_SHARE = 0.3
"""Natural angular frequency times the typical time of the motion above which the mass is on a spring for certain."""
COUPLING_GAIN = 0.3
"""Least decrease of the score by a second mass, nats, with dry friction in both baselines."""
WORTH_FRICTION = 0.05
"""Least decrease without friction, nats, for the comparison with friction."""
COUPLING_RESPONSE = 0.7
"""Largest residual of the frequency response with a second mass, relative to one mass, that is fitted to the record."""
WINDOW_NOISE = 2e-3
"""Least noise as a share of the motion within the windows: sampling and filters are unknown."""
LEAST_WINDOW = 60
"""Least samples of a window."""
LEAST_WINDOWS = 16
_SLOWNESSES = 4.0
"""Length of a window in typical times of the motion (standard deviation of position over that of velocity)."""
_POSITION_UNITS = ("m", "mm", "um", "µm", "rad", "deg", "°", "rev")
_RESONANCES = 40
_RATIOS = (0.01, 0.05, 0.2)
_MOST_LINES = 1500
_FEW_STEPS = 25


def with_best_family(dataset: Dataset) -> Dataset:
    """Return the dataset with the family of machines that predicts the samples for the choice best.

    A dataset of a known instrument is returned unchanged.
    """
    about = dataset.equivalent
    if about is None:
        return dataset
    base = _integrating(dataset, about) or _free_running(dataset, about)
    best = _with_second_mass(*base)
    chosen = best.equivalent
    if chosen is None or chosen.family == "oscillator":
        return best
    remark = Message("gap.machine_family", "the baseline is {family}", family=FAMILY_NAMES[chosen.family])
    return replace(best, remarks=(*best.remarks, remark))


def _integrating(dataset: Dataset, about: Equivalent) -> tuple[Dataset, Fit] | None:
    # The dataset over windows, if a spring does not predict better there or is so slow that a free run drifts.
    windows = in_windows(dataset, about)
    if windows is None:
        return None
    starts = _regressed(windows)
    with_spring = _fit(windows, _started(windows, "oscillator", starts))
    without = _fit(windows, _started(windows, "free_mass", starts))
    gained = score_candidate(without).score - score_candidate(with_spring).score
    device, theta = with_spring.parameters.instrument(with_spring.theta), with_spring.theta
    stiffness = with_spring.parameters.tissue_of(theta, windows.tests[0]).stiffness_n_per_m
    restart = windows.equivalent.restart_s if windows.equivalent is not None else None
    slow = device.bearing_damping_n_s_per_m / stiffness > SLOW_WINDOWS * (restart or 0.0)
    if gained >= SPRING_GAIN and not slow:
        return None
    integrating = without.parameters.dataset
    chosen = integrating.equivalent
    assert chosen is not None
    assert chosen.restart_s is not None
    remark = Message(
        "gap.restarted",
        "the machine integrates its input, and a simulation of the whole record drifts: every {seconds:.3g} s the "
        "prediction starts again from the recorded motion",
        seconds=chosen.restart_s,
    )
    return replace(integrating, remarks=(*integrating.remarks, remark)), without


def _free_running(dataset: Dataset, about: Equivalent) -> tuple[Dataset, Fit]:
    fitted = _fit(dataset, about)
    if about.output_unit in _POSITION_UNITS or about.output_name == "position":
        return dataset, fitted
    damping, mass = _residual(_lines(dataset), about, 2)[1]
    moved = replace(
        about,
        family="velocity",
        damping_n_s_per_m=max(damping * VELOCITY_TIME_S, 1e-9),
        mass_kg=max(mass * VELOCITY_TIME_S, 1e-9),
    )
    other = _fit(dataset, moved)
    better = score_candidate(other).score <= score_candidate(fitted).score + SPRING_GAIN
    return (_of(dataset, moved), other) if better else (dataset, fitted)


def _with_second_mass(dataset: Dataset, fitted: Fit) -> Dataset:
    about = dataset.equivalent
    assert about is not None
    if about.output_is_velocity:
        return dataset
    lines = _lines(dataset)
    single_mass_residual = _residual(lines, about, 3)[0]
    before = score_candidate(fitted).score
    best, least = dataset, np.inf
    families: tuple[Family, ...] = ("driven_mass", "far_mass")
    for family in families:
        residual, start = _two_masses(lines, about, family)
        if residual > COUPLING_RESPONSE * single_mass_residual:
            continue
        other = _fit(dataset, start)
        if score_candidate(other).score > before - WORTH_FRICTION:
            continue
        # Friction, which a second mass can imitate, must not explain the difference.
        least = _with_friction(fitted) - COUPLING_GAIN if least == np.inf else least
        improved = _with_friction(other)
        if improved < least:
            best, least = _of(dataset, start), improved
    return best


def _with_friction(fitted: Fit) -> float:
    friction = machine_effects()["dry_friction"]
    dataset = fitted.parameters.dataset
    signals = [test.signals for test in dataset.tests]
    starts = friction_starts(signals, dataset.tests[0].sample_rate_hz)
    fits = [fit(dataset, (friction,), (start,), near=fitted, most_steps=_FEW_STEPS) for start in starts]
    return min(score_candidate(item).score for item in fits)


def _fit(dataset: Dataset, about: Equivalent) -> Fit:
    return fit(_of(dataset, about), most_steps=_FEW_STEPS)


def _of(dataset: Dataset, about: Equivalent) -> Dataset:
    return replace(dataset, equivalent=about, instrument=about.device(dataset.tests[0].sample_rate_hz))


def in_windows(dataset: Dataset, about: Equivalent) -> Dataset | None:
    """Return the dataset with a prediction over windows; blocks of purposes are whole windows.

    None where a spring certainly holds the mass, or where the record is too short.
    """
    states = [recorded_state(test) for test in dataset.tests]
    spread = float(np.sqrt(np.mean([np.var(position) for position, _ in states])))
    speed = float(np.sqrt(np.mean([np.var(velocity) for _, velocity in states])))
    rate = dataset.tests[0].sample_rate_hz
    shortest = min(test.command.size for test in dataset.tests) / rate
    typical = spread / max(speed, 1e-30)
    length = min(max(_SLOWNESSES * typical, LEAST_WINDOW / rate), shortest / LEAST_WINDOWS)
    creep = about.damping_n_s_per_m / about.stiffness_n_per_m
    held = 2.0 * np.pi * about.natural_hz * typical > SPRING_SHARE and creep < SLOW_WINDOWS * length
    if held or length * rate < LEAST_WINDOW:
        return None
    about = replace(about, restart_s=length)
    tests = tuple(replace(test, purpose=_purposes(test, restarts(test, about))) for test in dataset.tests)
    moved = []
    for test, (position, _) in zip(tests, states, strict=True):
        edges = (*restarts(test, about), test.command.size)
        moved += [np.var(position[a:b]) for a, b in pairwise(edges)]
    least = WINDOW_NOISE * float(np.sqrt(np.mean(moved)))
    # White noise of the output from third differences, which leave little of the motion.
    third = [np.abs(np.diff(interpolated(test.signals["position"]), 3) / np.sqrt(20.0)) for test in tests]
    white = float(np.mean([1.4826 * np.median(differences) for differences in third]))
    # The velocity at a restart is uncertain, and its error grows to that over half a window. Corners exaggerate it.
    begun = float(np.sqrt(np.mean([velocity_error(test, about) ** 2 for test in tests])))
    noise = dataset.noise | {"position": float(np.hypot(max(least, white), min(0.5 * length * begun, 2.0 * least)))}
    return replace(dataset, tests=tests, noise=noise, equivalent=about)


def _purposes(test: DatasetTest, starts: Sequence[int]) -> NDArray[np.int8]:
    # The same pattern of purposes, by windows. States that are not recorded are unknown in the first window.
    used = {int(item) for item in np.unique(test.purpose)} - {int(Purpose.NOTHING)}
    if len(used) < 2:
        purposes = np.where(test.purpose == Purpose.NOTHING, min(used, default=0), test.purpose).astype(np.int8)
        purposes[: starts[1] if len(starts) > 1 else 0] = Purpose.NOTHING
        return purposes
    turns = [Purpose.FIT, Purpose.CHOICE, Purpose.FIT, Purpose.CHECK]
    if int(Purpose.FIT) not in used:
        turns = [Purpose.CHOICE, Purpose.CHECK]
    purposes = np.zeros(test.purpose.size, np.int8)
    for k, (first, end) in enumerate(zip(starts, (*starts[1:], test.purpose.size), strict=True)):
        purposes[first:end] = turns[(k - 1) % len(turns)] if k else Purpose.NOTHING
    return purposes


def _regressed(dataset: Dataset) -> FloatArray:
    """Return mass, damping and stiffness by regression of the force on the recorded motion and on dry friction."""
    rows, forces = [], []
    for test in dataset.tests:
        fitted = test.serving(Purpose.FIT)
        if not fitted.any():
            continue
        _, velocity = recorded_state(test)
        rate = test.sample_rate_hz
        width = 15 if test.command.size > 60 else 5
        smooth = [savgol_filter(values, width, 2) for values in (interpolated(test.signals["position"]), velocity)]
        acceleration = savgol_filter(velocity, width, 2, deriv=1, delta=1.0 / rate)
        sign = np.tanh(smooth[1] / max(0.05 * float(np.std(velocity)), 1e-30))
        columns = np.stack([acceleration, smooth[1], smooth[0], sign, np.ones(velocity.size)], axis=1)
        rows.append(columns[fitted])
        forces.append(savgol_filter(test.command, width, 2)[fitted])
    design, force = np.concatenate(rows), np.concatenate(forces)
    size = np.maximum(np.sqrt(np.mean(design**2, axis=0)), 1e-30)
    coefficients, *_ = np.linalg.lstsq(design / size, force, rcond=1e-10)
    return np.asarray(coefficients / size)[:3]


def _started(dataset: Dataset, family: Family, figures: FloatArray) -> Equivalent:
    about = dataset.equivalent
    assert about is not None
    spread = float(np.std(np.concatenate([interpolated(test.signals["position"]) for test in dataset.tests])))
    typical = np.array([1.0, 1.0, 1.0]) * float(np.std(np.concatenate([test.command for test in dataset.tests])))
    speed = float(np.std(np.concatenate([recorded_state(test)[1] for test in dataset.tests])))
    least = 0.01 * typical / np.array([speed**2 / spread, speed, spread])
    mass, damping, stiffness = np.maximum(figures, least)
    return replace(
        about, family=family, mass_kg=float(mass), damping_n_s_per_m=float(damping), stiffness_n_per_m=float(stiffness)
    )


def _lines(dataset: Dataset) -> FrequencyResponse:
    tests = [test for test in dataset.tests if test.serving(Purpose.FIT).any()]
    records = [(test.command, interpolated(test.signals["position"])) for test in tests]
    response = frequency_response(records, tests[0].sample_rate_hz)
    return response.every(max(1, response.omega.size // _MOST_LINES))


def _residual(
    lines: FrequencyResponse, about: Equivalent, order: int, *more: NDArray[np.complex128]
) -> tuple[float, FloatArray]:
    """Return the relative residual of a frequency response and the coefficients of its inverse, all positive.

    The coefficients are those of 1, s, ... up to ``order`` powers, and of the functions ``more`` of s.
    """
    s = 1j * lines.omega
    basis = [s**k for k in range(order)] + list(more)
    design = np.stack([lines.response * column for column in basis], axis=1)
    # Relative errors of the inverse, which resonances and antiresonances share.
    weight = np.sqrt(lines.weight / np.maximum(lines.weight.max(), 1e-300))
    weight = np.sqrt(np.minimum(weight, 1.0)) * np.ones_like(lines.omega)
    size = np.maximum(np.sqrt(np.mean(np.abs(design) ** 2, axis=0)), 1e-300)
    rows = weight[:, None] * design / size
    target = weight * np.exp(-1j * lines.omega * about.delay_s)
    coefficients, residual = nnls(np.concatenate([rows.real, rows.imag]), np.concatenate([target.real, target.imag]))
    return float(residual**2), np.asarray(coefficients / size)


def _two_masses(lines: FrequencyResponse, about: Equivalent, family: Family) -> tuple[float, Equivalent]:
    """Return the residual of the frequency response of two masses and its parameters, best on a grid of resonances."""
    s = 1j * lines.omega
    best, start = np.inf, about
    for omega in np.geomspace(lines.omega[0], lines.omega[-1], _RESONANCES):
        for ratio in _RATIOS:
            coupling = omega**2 + 2.0 * ratio * omega * s
            shape = s**2 * coupling / (s**2 + coupling) if family == "driven_mass" else s**4 / coupling
            residual, (stiffness, damping, mass, other) = _residual(lines, about, 3, shape)
            own = mass if family == "driven_mass" else mass - other
            if residual >= best or other <= 0.0 or own <= 0.02 * other:
                continue
            # The declared resonance is that of the mass of the output against the other one at rest.
            share = other / own
            hz = omega / (2.0 * np.pi) * (np.sqrt(share) if family == "driven_mass" else 1.0)
            scale = np.sqrt(share) if family == "driven_mass" else 1.0
            best = residual
            start = replace(
                about,
                family=family,
                mass_kg=own,
                damping_n_s_per_m=max(0.5 * damping, 1e-3 * own * omega),
                stiffness_n_per_m=max(stiffness, 1e-6 * own * omega**2),
                coupling=(float(hz), float(ratio * scale), float(share), 0.5 * damping / own + 1e-3 * omega),
            )
    return best, start
