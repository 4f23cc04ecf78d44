"""Export of an accepted diagnosis to a named twin, and its use as the prior of the next diagnosis."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.gap.dataset import Dataset, Prior, Purpose
from tissueid.gap.decision import Candidate, errors
from tissueid.gap.diagnosis import Diagnosis
from tissueid.gap.fitting import Fit
from tissueid.gap.parameters import INSTRUMENT_COORDINATES, LOGARITHMIC_TISSUE, TISSUE_COORDINATES, WITHIN_STDS
from tissueid.gap.preparation import prepare
from tissueid.gap.search import Search, SearchProgress, applicable
from tissueid.gap.workers import Executor
from tissueid.instrument.twin_file import MOST_NAMED, TwinFile, TwinSource, content_of
from tissueid.language import marked
from tissueid.messages import Action, Message, Verbatim
from tissueid.sessions import read_session
from tissueid.twin.catalogue import effect
from tissueid.twin.effect import Effect
from tissueid.twin.simulation import NamedTwin
from tissueid.version import SOFTWARE

RELATIVE_STD = 0.1
"""Standard deviation of an accepted parameter in the next diagnosis, relative to its value or range."""
CHANGE_OF_THE_INSTRUMENT = {
    "resistance_ohm": 0.02,
    "force_constant_n_per_a": 0.006,
    "bearing_damping_n_s_per_m": 0.05,
}
"""Relative standard deviation of a parameter from one session to the next, for 5 K: 0.39 %/K for copper, 0.12 %/K for
neodymium magnets, 1 %/K for the viscosity of a lubricant."""
_MOST_STD = 1e6
_SAME = 1e-6
"""Relative difference of two equal parameters."""


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
            "gap.no_twin", "an input-output record holds no instrument: a twin cannot be made of it"
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
        _unmodelled(candidate.fit),
    )


def stds_of(candidate: Candidate) -> dict[str, float]:
    """Return the standard deviations of a fitted twin's parameters; none for a bare record of input and output."""
    return {} if candidate.fit.parameters.dataset.equivalent is not None else twin_of(candidate, "").stds


def _unmodelled(fitted: Fit) -> dict[str, float]:
    # The larger error of both held-out parts: in a later session each of them alone can show a gap, and a rare event,
    # such as lift-off, can be absent from one. Effects' own irreducible errors are part of the twin already.
    dataset = fitted.parameters.dataset
    alone = replace(fitted, parameters=replace(fitted.parameters, dataset=replace(dataset, unmodelled={})))
    on_tissue = {test.number for test in dataset.tests if test.fixture == "tissue" and not test.quiet}
    shares: dict[str, float] = {}
    for purpose in (Purpose.CHOICE, Purpose.CHECK):
        channel_errors = [item for item in errors(alone, purpose) if item.test in on_tissue and item.spread > 0.0]
        for name in dataset.channels:
            of_channel = [item for item in channel_errors if item.channel == name]
            if not of_channel:
                continue
            unexplained = sum((item.square - item.noise**2 - item.irreducible**2) * item.samples for item in of_channel)
            whole = sum(item.spread**2 * item.samples for item in of_channel)
            shares[name] = max(shares.get(name, 0.0), float(np.sqrt(max(unexplained, 0.0) / whole)))
    return shares


def _stds(fitted: Fit, test: int) -> dict[str, float]:
    # From the curvature of the cost, widened by the ratio of residuals to noise.
    parameters = fitted.parameters
    normal = fitted.normal + np.diag(parameters.array("prior_std") ** -2.0)
    excess = max(1.0, float(fitted.residuals @ fitted.residuals) / max(fitted.residuals.size, 1))
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-30))
    covariance = np.linalg.pinv(normal / np.outer(scale, scale), hermitian=True)
    stds = np.sqrt(np.maximum(np.diag(covariance), 0.0) * excess) / scale
    instrument = parameters.instrument(fitted.theta)
    factors = {name: float(getattr(instrument, name)) for name in INSTRUMENT_COORDINATES} | {"weight_n": 1.0}
    for name in TISSUE_COORDINATES:
        factors[name] = float(np.exp(fitted.value(name))) if name in LOGARITHMIC_TISSUE else 1.0
    for held in parameters.effects:
        values = parameters.effect_values(fitted.theta, held, test)
        for parameter, value in zip(held.parameters, values, strict=True):
            if not parameter.per_test:
                factors[f"{held.name}.{parameter.name}"] = float(value) if parameter.logarithmic else 1.0
    places = parameters.index
    return {
        name: min(float(stds[places[name]]) * factor, _MOST_STD) for name, factor in factors.items() if name in places
    }


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
    source = TwinSource(
        session_id=session_id,
        tests=tuple(test.number for test in candidate.fit.parameters.dataset.tests),
        verdict=verdict,
        closed=closed if closed is not None and np.isfinite(closed) else None,
        probability=probability,
        improves="" if before is None else f"{before.name}, version {before.version}",
        serial_number=_serial_number(candidate.fit.parameters.dataset.instrument),
    )
    twin = twin_of(candidate, name, next_version(name, before))
    return content_of(twin, source, time_of_creation(now), SOFTWARE)


def next_version(name: str, before: TwinFile | None) -> int:
    """Return the version of a twin that extends another one: the next one where the name stays."""
    return before.version + 1 if before is not None and before.name == name else 1


def time_of_creation(now: datetime | None = None) -> str:
    """Return a time, UTC, as the file of a twin states it."""
    return (now or datetime.now(UTC)).astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def _serial_number(device: DeviceDescription) -> str:
    return "" if device.simulated or device.serial_number == "unknown" else device.serial_number


def check_same_instrument(device: DeviceDescription, twin: TwinFile) -> None:
    """Check that a twin can describe the instrument of a session.

    The serial numbers agree where both are known, and the twin's parameters lie within the bounds of the fit around the
    nominal ones.

    Raises:
        UnusableInputError: it is another instrument.
    """
    serial, theirs = _serial_number(device), twin.source.serial_number
    if serial and theirs and serial != theirs:
        raise UnusableInputError(
            "gap.other_serial",
            "the twin {twin} is of another instrument: serial number {theirs}, that of the session is {ours}",
            twin=twin.name,
            theirs=Verbatim(theirs),
            ours=Verbatim(serial),
        )
    reach = WITHIN_STDS * device.calibration_relative_uncertainty + _SAME
    wide = dict.fromkeys(INSTRUMENT_COORDINATES, reach) | {"stroke_m": _SAME, "amplifier_limit_v": _SAME}
    for ours, reach in wide.items():
        value, nominal = twin.instrument[ours], getattr(device, INSTRUMENT_COORDINATES.get(ours, ours))
        least, most = float(nominal * np.exp(-reach)), float(nominal * np.exp(reach))
        if not least <= value <= most:
            raise UnusableInputError(
                "gap.other_instrument",
                "the twin {twin} is of another instrument: its {name} is {value:.4g}, that of the session {least:.4g} "
                "to {most:.4g}",
                twin=twin.name,
                name=Verbatim(ours),
                value=value,
                least=least,
                most=most,
            )


def against_twin(dataset: Dataset, twin: TwinFile | None) -> tuple[Dataset, tuple[str, ...]]:
    """Return the tests with a saved twin as prior, and its effects; the tests alone where there is no twin.

    Raises:
        UnusableInputError: the twin is of another instrument, or the record is an input-output record.
    """
    if twin is None:
        return dataset, ()
    prior = with_prior_twin(dataset, twin.twin)
    check_same_instrument(dataset.instrument, twin)
    return prior, twin.twin.effects


def with_prior_twin(dataset: Dataset, twin: NamedTwin) -> Dataset:
    """Return the same tests with a saved twin as prior: its instrument, its tissue, its effects and its errors.

    Parameters of the instrument have the twin's uncertainty, at most the calibration's. The tissue is refitted in every
    session, from the twin's values. What the twin left unmodelled in its session is part of the noise floor.

    Raises:
        UnusableInputError: the record is an input-output record.
    """
    if dataset.equivalent is not None:
        raise UnusableInputError(
            "gap.twin_without_instrument", "a twin needs an instrument, and an input-output record holds none"
        )
    priors: dict[str, Prior] = {}
    for ours, theirs in INSTRUMENT_COORDINATES.items():
        value, nominal = getattr(twin.instrument, ours), getattr(dataset.instrument, theirs)
        std = twin.stds.get(ours)
        spread = None if std is None else max(np.hypot(std / value, CHANGE_OF_THE_INSTRUMENT.get(ours, 0.0)), 1e-4)
        priors[ours] = Prior(float(np.log(value / nominal)), spread)
    priors["weight_n"] = Prior(twin.instrument.weight_n)
    for ours, theirs in TISSUE_COORDINATES.items():
        value = getattr(twin.tissue, theirs)
        priors[ours] = Prior(float(np.log(max(value, 1e-9))) if ours in LOGARITHMIC_TISSUE else value)
    for item in twin.acting:
        priors |= _of_effect(item.effect, item.values, twin.stds)
    return replace(dataset, priors=priors, unmodelled=twin.unmodelled)


def _of_effect(effect: Effect, values: NDArray[np.float64], stds: dict[str, float]) -> dict[str, Prior]:
    priors = {}
    for parameter, value in zip(effect.parameters, values, strict=True):
        name = f"{effect.name}.{parameter.name}"
        if parameter.per_test:
            continue
        if parameter.fixed:
            priors[name] = Prior(float(value))
            continue
        std = stds.get(name, 0.0)
        if parameter.logarithmic:
            priors[name] = Prior(float(np.log(value)), float(np.hypot(std / value, RELATIVE_STD)))
        else:
            priors[name] = Prior(
                float(value), float(np.hypot(std, RELATIVE_STD * max(abs(value), 0.01 * parameter.high)))
            )
    return priors


_CHOOSE = Action("accept.choose", "--effect NAME", marked("choose it on the page Gap"))
_NO_GAP = Message("accept.no_gap", "nothing to accept: there is no gap. To accept an effect: {choose}", choose=_CHOOSE)
_UNEXPLAINED = Message(
    "accept.unexplained",
    "nothing to accept: no candidate explains the gap. To accept an effect: {choose}",
    choose=_CHOOSE,
)


@dataclass(frozen=True)
class NamedEffects:
    """The effects that a diagnosis names, and the twin that has them.

    ``twin`` is None where there is no such twin, and ``refused`` says why. ``baseline`` is the twin that it extends;
    None is the nominal one.
    """

    effects: tuple[str, ...]
    twin: TwinFile | None
    refused: str = ""
    baseline: TwinFile | None = None

    def twin_called(self, name: str, now: datetime | None = None) -> TwinFile:
        """Return the twin under another name; the next version where it extends a twin of that name.

        Raises:
            UnusableInputError: there is no twin.
        """
        if self.twin is None:
            raise UnusableInputError(self.refused)
        changes = {"name": name, "version": next_version(name, self.baseline), "created": time_of_creation(now)}
        return TwinFile(**self.twin.model_dump() | changes)


def named_effects(diagnosis: Diagnosis, session_id: str, baseline: TwinFile | None) -> NamedEffects:
    """Return the effects that a diagnosis names, with the twin that has them."""
    if diagnosis.verdict != "effect" or diagnosis.best is None:
        return NamedEffects((), None, _NO_GAP if diagnosis.verdict == "no_gap" else _UNEXPLAINED, baseline)
    try:
        twin = twin_file_of(
            diagnosis.best,
            "twin" if baseline is None else baseline.name,
            session_id=session_id,
            verdict=diagnosis.verdict,
            closed=diagnosis.gap.closed,
            probability=diagnosis.ranking[0].probability if diagnosis.ranking else None,
            before=baseline,
        )
    except UnusableInputError as error:
        return NamedEffects(diagnosis.combination, None, error.message, baseline)
    return NamedEffects(diagnosis.combination, twin, baseline=baseline)


def accept_named(
    path: Path,
    names: Sequence[str],
    twin_name: str,
    before: TwinFile | None,
    pool: Executor,
    progress: Callable[[SearchProgress], None],
    fit: Sequence[int] = (),
    check: Sequence[int] = (),
    cancelled: Callable[[], bool] = lambda: False,
) -> TwinFile:
    """Fit a session with chosen effects, and return the twin file.

    Raises:
        UnusableInputError: an effect does not exist, needs signals that were not recorded, or is not in the records.
    """
    if twice := [name for index, name in enumerate(names) if name in names[:index]]:
        raise UnusableInputError("accept.twice", "the effect {effect} is named twice", effect=twice[0])
    count = len(names) + (0 if before is None else len(before.effects))
    if count > MOST_NAMED:
        raise UnusableInputError(
            "accept.too_many", "a twin holds at most {most} effects, not {count}", most=MOST_NAMED, count=count
        )
    session = read_session(path)
    dataset, accepted = against_twin(prepare(session, fit, check), before)
    for name in names:
        if name in accepted:
            raise UnusableInputError("accept.known", "the twin has the effect {effect} already", effect=name)
        if not applicable(dataset, effect(name)):
            raise UnusableInputError(
                "accept.signals", "these records cannot show the effect {effect}: it needs other signals", effect=name
            )
    search = Search(dataset, pool, names, progress, cancelled)
    baseline = best = search.baseline(accepted)
    dataset = baseline.fit.parameters.dataset
    for name in names:
        tried = Search(dataset, pool, [name], progress, cancelled).add_to([best])
        if not tried:
            raise UnusableInputError(
                "accept.no_trace", "these records hold no trace of the effect {effect}", effect=name
            )
        best = tried[0]
    return twin_file_of(
        best, twin_name, session_id=session.session_id, verdict="by hand", closed=best.closed(baseline), before=before
    )
