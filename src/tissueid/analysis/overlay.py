"""Fits of several tests, from one session or several, that are drawn in one figure or averaged in one table."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from tissueid.analysis.fitting import Analysis, fit_split, fit_whole, scheduled_scores
from tissueid.analysis.split import Split, split, split_records
from tissueid.errors import UnusableInputError
from tissueid.formatting import label_and_unit
from tissueid.identification.base import Engine
from tissueid.identification.depth_profile import DepthProfile
from tissueid.language import marked
from tissueid.messages import Message, Verbatim
from tissueid.records import Estimate, Record
from tissueid.sessions import Session

Progress = Callable[[str, float], None]
_SYSTEM = ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m")
_ENDS = (0.025, 0.975)
"""Quantiles of the output that a linear test counts as its range of depths."""


@dataclass(frozen=True)
class NamedFit:
    """An engine with its options under a label, such as "raw" and "filtered" for two fits of one engine."""

    label: str
    engine: Engine


@dataclass(frozen=True, eq=False)
class TestSource:
    """Tests of a session that are fitted together. Sources with the same label belong to one series.

    ``fits`` are the labels of the fits that are run on it; empty for all.
    """

    __test__ = False

    label: str
    session: Session
    tests: tuple[int, ...]
    fits: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class OverlayEntry:
    """One fit of one source. ``swept`` is the value of the swept option; None without a sweep.

    ``scheduled_percent`` and ``scheduled_aicc`` are the scores of the run that is scheduled by the measured output, on
    the fitted samples; None for models without a schedule.
    """

    source: str
    fit: NamedFit
    analysis: Analysis
    surface_position_m: float
    scheduled_percent: float | None = None
    scheduled_aicc: float | None = None
    swept: float | None = None

    @property
    def shown_percent(self) -> float:
        """VAF of the fitted samples, percent: of the scheduled run where the model has a schedule."""
        return self.analysis.model.report.vaf_percent if self.scheduled_percent is None else self.scheduled_percent

    @property
    def profile(self) -> DepthProfile | None:
        """Mass, damping and stiffness against depth: of the model, or one row at the mean depth of a linear system."""
        return self.analysis.depth_profile() or linear_row(self.analysis)


@dataclass(frozen=True, eq=False)
class Overlay:
    """Fits in the order of the sources. ``refused`` says of each source and fit that failed why."""

    entries: tuple[OverlayEntry, ...]
    refused: tuple[str, ...] = ()
    swept: str = ""
    records: Mapping[str, Record] = field(default_factory=dict)

    @property
    def sources(self) -> tuple[str, ...]:
        """Labels of the sources, each once."""
        return tuple(dict.fromkeys(entry.source for entry in self.entries))

    @property
    def fits(self) -> tuple[str, ...]:
        """Labels of the fits, each once."""
        return tuple(dict.fromkeys(entry.fit.label for entry in self.entries))

    def label(self, entry: OverlayEntry) -> str:
        """Return what distinguishes an entry: its source, its fit, or both."""
        if len(self.fits) == 1:
            return entry.source
        return entry.fit.label if len(self.sources) == 1 else f"{entry.source}, {entry.fit.label}"


def overlay(
    sources: Sequence[TestSource],
    fits: Sequence[NamedFit],
    *,
    whole: bool = False,
    downsample: int = 1,
    sweep: tuple[str, Sequence[float]] = ("", ()),
    input_name: str = "force",
    output_name: str = "position",
    progress: Progress = lambda _what, _share: None,
) -> Overlay:
    """Run every fit on every source that asks for it.

    Args:
        sources: tests.
        fits: engines with their options.
        whole: fit whole tests: nothing is held out, and all scores are those of fitted samples, as in the thesis.
        downsample: keep every ``downsample``-th sample of the tests, without a filter, as in the thesis (4.3.1).
        sweep: name of an option and the values that are tried one after the other in every fit that has it.
        input_name: signal that is the input.
        output_name: signal that is the output.
        progress: called with a step and its completed share.

    Raises:
        UnusableInputError: no fit has the swept option, a source asks for an unknown fit, or every fit failed.
    """
    option, values = sweep
    if option and not any(option in type(fit.engine).model_fields for fit in fits):
        raise UnusableInputError(
            "compare.no_such_option", "none of these engines has an option '{option}'", option=Verbatim(option)
        )
    fit_labels = {fit.label for fit in fits}
    for source in sources:
        if unknown := [label for label in source.fits if label not in fit_labels]:
            raise UnusableInputError(
                "overlay.unknown_fit", "there is no fit '{name}' among the fits", name=Verbatim(unknown[0])
            )
    entries: list[OverlayEntry] = []
    refused: list[str] = []
    records: dict[str, Record] = {}
    jobs = [(s, f) for s in sources for f in fits if not s.fits or f.label in s.fits]
    for index, (source, fit) in enumerate(jobs):
        progress(f"{source.label}, {fit.label}", index / len(jobs))
        parts = _parts(source, downsample, input_name, output_name)
        records.setdefault(source.label, parts.records[0])
        for engine, value in _swept(fit.engine, option, values):
            try:
                analysis = fit_whole(engine, parts) if whole else fit_split(engine, parts)
            except UnusableInputError as error:
                refused.append(
                    Message(
                        "overlay.refused",
                        "{source}, {fit}: {why}",
                        source=Verbatim(source.label),
                        fit=Verbatim(fit.label),
                        why=error.message,
                    )
                )
                continue
            surface = source.session.test(source.tests[0]).surface_position_m
            scheduled, criterion = scheduled_scores(analysis)
            entries.append(
                OverlayEntry(source.label, replace(fit, engine=engine), analysis, surface, scheduled, criterion, value)
            )
    if not entries:
        raise UnusableInputError(refused[0] if refused else Message("overlay.nothing", "no fit is asked for"))
    return Overlay(tuple(entries), tuple(refused), option if values else "", records)


def _swept(engine: Engine, option: str, values: Sequence[float]) -> Iterable[tuple[Engine, float | None]]:
    """Yield the engine at each value of an option and the value; the engine alone where it has no such option."""
    if not option or option not in type(engine).model_fields:
        yield engine, None
        return
    for value in values:
        yield engine.from_options(engine.options() | {option: value}), value


def _parts(source: TestSource, downsample: int, input_name: str, output_name: str) -> Split:
    """Return the split of a source, with every ``downsample``-th sample of its tests."""
    first, *others = source.tests
    parts = split(source.session, test=first, also=others, input_name=input_name, output_name=output_name)
    if downsample == 1:
        return parts
    kept = split_records([every(record, downsample) for record in parts.records], parts.tests)
    return replace(
        parts,
        record=kept.record,
        fit_part=kept.fit_part,
        held_out_record=kept.held_out_record,
        held_out=kept.held_out,
        records=kept.records,
    )


def every(record: Record, step: int) -> Record:
    """Return every ``step``-th sample of a record, without a filter."""
    rate = record.sample_rate_hz / step
    return replace(record, input=record.input[::step], output=record.output[::step], sample_rate_hz=rate, joints=())


def linear_row(analysis: Analysis) -> DepthProfile | None:
    """Return mass, damping and stiffness of a linear fit as one row at the mean output; None if it has none.

    A series of small tests about several loads gives the localized linear parameters (Chen 2010, 3.4).
    """
    record, parameters = analysis.record[analysis.fit_part], analysis.model.report.reportable_parameters
    if (record.output_unit, record.input_unit) != ("m", "N") or not all(name in parameters for name in _SYSTEM):
        return None
    output = record.output[np.isfinite(record.output)]
    ends = np.quantile(output, _ENDS)
    columns: dict[str, Any] = {}
    for name, key in zip(_SYSTEM, ("mass", "damping", "stiffness"), strict=True):
        std = parameters[name].std
        columns |= {key: np.array([parameters[name].value]), f"{key}_std": np.array([np.nan if std is None else std])}
    return DepthProfile(
        position=np.array([float(output.mean())]),
        low=ends[:1],
        high=ends[1:],
        direction=np.zeros(1, dtype=np.int_),
        support=np.array([output.size], dtype=np.int_),
        **columns,
    )


def joined_profile(rows: Sequence[DepthProfile]) -> DepthProfile:
    """Return profiles as one, in the order of position."""
    order = np.argsort(np.concatenate([profile.position for profile in rows]), kind="stable")
    return DepthProfile(
        **{
            name.name: np.concatenate([getattr(profile, name.name) for profile in rows])[order]
            for name in fields(DepthProfile)
        }
    )


def series_profiles(overlay: Overlay, *, from_surface: bool = False) -> dict[tuple[str, str], DepthProfile]:
    """Return the profile of each series, by source and fit.

    The single rows of linear tests with the same source label and fit are joined; other entries are one series each,
    which are numbered where their labels are the same. ``from_surface`` counts positions from the surface of each test.
    """
    made: dict[tuple[str, str], DepthProfile] = {}
    for entry in overlay.entries:
        profile = entry.profile
        if profile is None or not np.isfinite(profile.stiffness).any():
            continue
        if from_surface:
            by = entry.surface_position_m
            profile = replace(profile, position=profile.position - by, low=profile.low - by, high=profile.high - by)
        key = entry.source, entry.fit.label
        if key in made and len(profile) == 1:
            made[key] = joined_profile([made[key], profile])
            continue
        number = 2
        while key in made:
            key, number = (f"{entry.source} ({number})", entry.fit.label), number + 1
        made[key] = profile
    return made


@dataclass(frozen=True)
class RepeatedValue:
    """Mean and standard deviation of a quantity over ``count`` tests; ``std`` and ``cv`` are NaN for a single one.

    ``cv`` is the coefficient of variation, standard deviation over magnitude of the mean.
    """

    source: str
    fit: str
    quantity: str
    count: int
    mean: float
    std: float

    @property
    def cv(self) -> float:
        """Coefficient of variation."""
        return self.std / abs(self.mean) if self.mean else float("nan")


SCORES = {
    "vaf_percent": marked("VAF, fitted"),
    "vaf_validation_percent": marked("VAF, held out"),
    "vaf_scheduled_percent": marked("VAF, held out, scheduled"),
}
"""Scores that are averaged along with the parameters, and their labels."""


def quantity_label(name: str) -> tuple[str, str]:
    """Return the English label and the SI unit of a score or parameter."""
    return (SCORES[name], "%") if name in SCORES else label_and_unit(name)


def repeated_values(overlay: Overlay) -> tuple[RepeatedValue, ...]:
    """Return mean and standard deviation of every score and parameter over the tests of each source label.

    Chen 2010, Table 3.1. A parameter of a fit that predicts nothing is left out. Fits with different models of one
    engine, whose parameters are not comparable, are not averaged together.
    """
    columns: dict[tuple[str, str, str], list[float]] = {}
    models: dict[tuple[str, str], set[str]] = {}
    for entry in overlay.entries:
        models.setdefault((entry.source, entry.fit.label), set()).add(entry.analysis.model.report.model)
    for entry in overlay.entries:
        several = len(models[entry.source, entry.fit.label]) > 1
        model = entry.analysis.model.report.model if several else ""
        label = f"{entry.fit.label} ({model})" if model else entry.fit.label
        for quantity, value in quantities(entry).items():
            columns.setdefault((entry.source, label, quantity), []).append(value.value)
    made = []
    for (source, fit, quantity), values in columns.items():
        finite = np.array([value for value in values if np.isfinite(value)])
        if finite.size:
            std = float(finite.std(ddof=1)) if finite.size > 1 else float("nan")
            made.append(RepeatedValue(source, fit, quantity, int(finite.size), float(finite.mean()), std))
    return tuple(made)


def quantities(entry: OverlayEntry) -> dict[str, Estimate]:
    """Return scores and parameters of an entry by name, SI."""
    report = entry.analysis.model.report
    scores = {name: getattr(report, name) for name in SCORES}
    estimates = {name: Estimate(float(value)) for name, value in scores.items() if value is not None}
    return estimates | report.reportable_parameters


__all__ = [
    "NamedFit",
    "Overlay",
    "OverlayEntry",
    "RepeatedValue",
    "TestSource",
    "every",
    "joined_profile",
    "linear_row",
    "overlay",
    "quantities",
    "quantity_label",
    "repeated_values",
    "series_profiles",
]
