"""Export of an accepted diagnosis to a named twin, and its use as the prior of the next diagnosis."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from tissueid import __version__
from tissueid.errors import UnusableInputError
from tissueid.gap.dataset import Dataset, Prior
from tissueid.gap.fitting import Fit
from tissueid.gap.parameters import INSTRUMENT_COORDINATES, LOGARITHMIC_TISSUE, TISSUE_COORDINATES
from tissueid.gap.scoring import Candidate
from tissueid.instrument.twin_file import Source, TwinFile, content_of
from tissueid.messages import Message
from tissueid.twin.effect import Effect
from tissueid.twin.named_twin import NamedTwin

RELATIVE_STD = 0.1
"""Standard deviation of an accepted parameter in the next diagnosis, relative to its value or range."""
_MOST_STD = 1e6


def twin_of(candidate: Candidate, name: str, version: int = 1) -> NamedTwin:
    """Return the fitted twin of a candidate with the standard deviations of its parameters.

    Per-test parameters (phases) are those of the first test.

    Raises:
        UnusableInputError: the candidate was fitted to an input-output record, which holds no instrument.
    """
    parameters, theta = candidate.fit.parameters, candidate.fit.theta
    dataset = parameters.dataset
    if dataset.equivalent is not None:
        raise UnusableInputError(
            Message("gap.no_twin", "an input-output record holds no instrument: a twin cannot be made of it")
        )
    test = next((item for item in dataset.tests if item.fixture == "tissue"), dataset.tests[0])
    instrument, tissue = parameters.instrument(theta), parameters.tissue_of(theta, test)
    return NamedTwin(
        name,
        version,
        instrument,
        tissue,
        tuple(parameters.acting(theta, test)),
        test.sample_rate_hz,
        _stds(candidate.fit, test.number),
    )


def _stds(fitted: Fit, test: int) -> dict[str, float]:
    # From the curvature of the cost, widened by the ratio of residuals to noise.
    parameters = fitted.parameters
    normal = fitted.jacobian.T @ fitted.jacobian + np.diag(parameters.array("prior_std") ** -2.0)
    excess = max(1.0, float(fitted.residuals @ fitted.residuals) / max(fitted.residuals.size, 1))
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-30))
    covariance = np.linalg.pinv(normal / np.outer(scale, scale), hermitian=True)
    stds = np.sqrt(np.maximum(np.diag(covariance), 0.0) * excess) / scale
    found: dict[str, float] = {}
    instrument = parameters.instrument(fitted.theta)
    for ours in INSTRUMENT_COORDINATES:
        if ours in parameters.index:
            found[ours] = float(stds[parameters.index[ours]]) * getattr(instrument, ours)
    if "weight_n" in parameters.index:
        found["weight_n"] = float(stds[parameters.index["weight_n"]])
    for ours in TISSUE_COORDINATES:
        if ours in parameters.index:
            k = parameters.index[ours]
            found[ours] = float(stds[k]) * (float(np.exp(fitted.theta[k])) if ours in LOGARITHMIC_TISSUE else 1.0)
    for effect in parameters.effects:
        values = parameters.effect_values(fitted.theta, effect, test)
        for parameter, value in zip(effect.parameters, values, strict=True):
            place = parameters.index.get(f"{effect.name}.{parameter.name}")
            if place is not None and not parameter.per_test:
                factor = float(value) if parameter.logarithmic else 1.0
                found[f"{effect.name}.{parameter.name}"] = float(stds[place]) * factor
    return {name: min(value, _MOST_STD) for name, value in found.items()}


def twin_file_of(
    candidate: Candidate,
    name: str,
    *,
    session_id: str = "",
    verdict: str = "",
    closed: float | None = None,
    probability: float | None = None,
    before: TwinFile | None = None,
    now: datetime | None = None,
) -> TwinFile:
    """Return the content of the twin file of a candidate; the next version where it improves a twin of that name.

    Raises:
        UnusableInputError: the twin cannot be simulated.
    """
    source = Source(
        session_id=session_id,
        tests=tuple(test.number for test in candidate.fit.parameters.dataset.tests),
        verdict=verdict,
        closed=closed if closed is not None and np.isfinite(closed) else None,
        probability=probability,
        improves="" if before is None else f"{before.name}, version {before.version}",
    )
    twin = twin_of(candidate, name, next_version(name, before))
    return content_of(twin, source, time_of_creation(now), f"tissueid {__version__}")


def next_version(name: str, before: TwinFile | None) -> int:
    """Return the version of a twin that extends another one: the next one where the name stays."""
    return before.version + 1 if before is not None and before.name == name else 1


def time_of_creation(now: datetime | None = None) -> str:
    """Return a time, UTC, as the file of a twin states it."""
    return (now or datetime.now(UTC)).astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def with_prior_twin(dataset: Dataset, twin: NamedTwin) -> Dataset:
    """Return the same tests with a saved twin as prior: its instrument, its tissue and its effects.

    Parameters of the instrument have the twin's uncertainty, at most the calibration's. The tissue is refitted in every
    session, from the twin's values.

    Raises:
        UnusableInputError: the record is an input-output record.
    """
    if dataset.equivalent is not None:
        raise UnusableInputError(
            Message("gap.twin_without_instrument", "a twin needs an instrument, and an input-output record holds none")
        )
    priors: dict[str, Prior] = {}
    for ours, theirs in INSTRUMENT_COORDINATES.items():
        value, nominal = getattr(twin.instrument, ours), getattr(dataset.instrument, theirs)
        std = twin.stds.get(ours)
        priors[ours] = Prior(float(np.log(value / nominal)), None if std is None else max(std / value, 1e-4))
    priors["weight_n"] = Prior(twin.instrument.weight_n)
    for ours, theirs in TISSUE_COORDINATES.items():
        value = getattr(twin.tissue, theirs)
        priors[ours] = Prior(float(np.log(max(value, 1e-9))) if ours in LOGARITHMIC_TISSUE else value)
    for item in twin.acting:
        priors |= _of_effect(item.effect, item.values, twin.stds)
    return replace(dataset, priors=priors)


def _of_effect(effect: Effect, values: NDArray[np.float64], stds: dict[str, float]) -> dict[str, Prior]:
    found = {}
    for parameter, value in zip(effect.parameters, values, strict=True):
        name = f"{effect.name}.{parameter.name}"
        if parameter.per_test:
            continue
        if parameter.fixed:
            found[name] = Prior(float(value))
            continue
        std = stds.get(name, 0.0)
        if parameter.logarithmic:
            found[name] = Prior(float(np.log(value)), float(np.hypot(std / value, RELATIVE_STD)))
        else:
            found[name] = Prior(
                float(value), float(np.hypot(std, RELATIVE_STD * max(abs(value), 0.01 * parameter.high)))
            )
    return found
