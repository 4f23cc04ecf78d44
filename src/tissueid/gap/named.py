"""Named twins: an accepted diagnosis becomes a twin that is saved, played, and built upon by the next diagnosis."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from tissueid import __version__
from tissueid.errors import UnusableInputError
from tissueid.gap.fitting import Fit
from tissueid.gap.observed import Belief, Observed
from tissueid.gap.parameters import INSTRUMENT_COORDINATES, LOGARITHMIC_TISSUE, TISSUE_COORDINATES
from tissueid.gap.scoring import Candidate
from tissueid.instrument.twin_file import Source, TwinFile, content_of
from tissueid.twin.effect import Effect
from tissueid.twin.named import NamedTwin

DOUBT = 0.1
"""An accepted parameter may be another by this share, or by this share of its range, the next time."""
_MOST_STD = 1e6


def twin_of(candidate: Candidate, name: str, version: int = 1) -> NamedTwin:
    """The fitted twin of a candidate, with the standard deviations of its figures.

    Parameters that every test has for itself (phases) are those of the first test.

    Raises:
        UnusableInputError: the candidate was fitted to a bare record of input and output, which is no instrument.
    """
    parameters, theta = candidate.fit.parameters, candidate.fit.theta
    observed = parameters.observed
    if observed.equivalent is not None:
        raise UnusableInputError("a record of input and output alone says nothing of an instrument: it makes no twin")
    test = next((item for item in observed.tests if item.fixture == "tissue"), observed.tests[0])
    instrument, tissue = parameters.instrument(theta), parameters.met(theta, test)
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
    # From the curvature of the cost at its least, widened by what the residuals exceed the noise.
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


def file_of(
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
    """The content of the file of an accepted candidate; of the next version where it builds on a twin of that name.

    Raises:
        UnusableInputError: it makes no twin that can be played.
    """
    version = before.version + 1 if before is not None and before.name == name else 1
    source = Source(
        session_id=session_id,
        tests=tuple(test.number for test in candidate.fit.parameters.observed.tests),
        verdict=verdict,
        closed=closed if closed is not None and np.isfinite(closed) else None,
        probability=probability,
        improves="" if before is None else f"{before.name}, version {before.version}",
    )
    created = (now or datetime.now(UTC)).astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    return content_of(twin_of(candidate, name, version), source, created, f"tissueid {__version__}")


def believing(observed: Observed, twin: NamedTwin) -> Observed:
    """The same tests, with a saved twin as what is believed before: its instrument, its tissue and its effects.

    What the twin knows of the instrument holds within its uncertainty, and no looser than the calibration's. Tissue is
    refitted to every session: the twin's is where that starts.

    Raises:
        UnusableInputError: the record is one of input and output alone.
    """
    if observed.equivalent is not None:
        raise UnusableInputError("a twin is of an instrument: a record of input and output alone has none")
    beliefs: dict[str, Belief] = {}
    for ours, theirs in INSTRUMENT_COORDINATES.items():
        value, nominal = getattr(twin.instrument, ours), getattr(observed.instrument, theirs)
        std = twin.stds.get(ours)
        beliefs[ours] = Belief(float(np.log(value / nominal)), None if std is None else max(std / value, 1e-4))
    beliefs["weight_n"] = Belief(twin.instrument.weight_n)
    for ours, theirs in TISSUE_COORDINATES.items():
        value = getattr(twin.tissue, theirs)
        beliefs[ours] = Belief(float(np.log(max(value, 1e-9))) if ours in LOGARITHMIC_TISSUE else value)
    for item in twin.acting:
        beliefs |= _of_effect(item.effect, item.values, twin.stds)
    return replace(observed, beliefs=beliefs)


def _of_effect(effect: Effect, values: NDArray[np.float64], stds: dict[str, float]) -> dict[str, Belief]:
    found = {}
    for parameter, value in zip(effect.parameters, values, strict=True):
        name = f"{effect.name}.{parameter.name}"
        if parameter.per_test:
            continue
        if parameter.fixed:
            found[name] = Belief(float(value))
            continue
        std = stds.get(name, 0.0)
        if parameter.logarithmic:
            found[name] = Belief(float(np.log(value)), float(np.hypot(std / value, DOUBT)))
        else:
            found[name] = Belief(float(value), float(np.hypot(std, DOUBT * max(abs(value), 0.01 * parameter.high))))
    return found
