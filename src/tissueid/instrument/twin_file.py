"""Files of named twins: TOML with the parameters of instrument, tissue and effects, and the source session."""

from __future__ import annotations

import math
import re
from dataclasses import asdict, fields
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from tissueid.atomic_write import atomic_file
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.formatting import clean
from tissueid.instrument.twin_list import FORMAT, MOST_BYTES, SUFFIX, twin_model
from tissueid.messages import Message, Verbatim, joined
from tissueid.plan_options import validation_reason
from tissueid.twin.bus import MOST_EFFECTS
from tissueid.twin.catalogue import all_effects
from tissueid.twin.chain_parameters import InstrumentParameters, Tissue
from tissueid.twin.player import SUBSTEPS
from tissueid.twin.simulation import ActiveEffect, NamedTwin, values_by_name
from tissueid.untrusted_input import toml_table

MOST_NAMED = MOST_EFFECTS
"""Maximum number of effects of a named twin."""

_Finite = Annotated[float, Field(allow_inf_nan=False, ge=-1e12, le=1e12)]
_Figure = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
_Std = Annotated[float, Field(ge=0.0, le=1e12, allow_inf_nan=False)]
_Share = Annotated[float, Field(ge=0.0, le=1e3, allow_inf_nan=False)]
_Line = Annotated[str, Field(max_length=200, pattern=r"^[^\x00-\x1f\x7f]*$")]
_NAME = r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,79}"
_POSITIVE = ("resistance_ohm", "inductance_h", "force_constant_n_per_a", "moving_mass_kg", "amplifier_gain", "stroke_m")
_LEAST = 1e-9
_MOST = {"resistance_ohm": 1e4, "inductance_h": 10.0, "force_constant_n_per_a": 1e4, "moving_mass_kg": 1e3}
_MOST_FILTER_S = 1.0
_TISSUE_BOUNDS = {
    "surface_m": (-1.0, 1.0),
    "mass_kg": (0.0, 1e3),
    "damping_n_s_per_m": (0.0, 1e5),
    "damping_growth_per_m": (-1e4, 1e4),
    "stiffness_n_per_m": (0.0, 1e7),
    "stiffness_growth_per_m": (-1e4, 1e4),
}
_MOST_RADIANS = 1.5 * SUBSTEPS
"""Maximum phase of the mass on the surface stiffness per sample, rad; from 2 per step the simulation is unstable."""


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class TwinSource(_Part):
    """Diagnosis from which a twin was accepted."""

    session_id: _Line = ""
    tests: Annotated[tuple[int, ...], Field(max_length=1000)] = ()
    verdict: _Line = ""
    closed: _Finite | None = None
    """Fraction of the gap that its effects close on held-out data."""
    probability: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    improves: _Line = ""
    """Name and version of the twin that it extends."""
    serial_number: _Line = ""
    """Serial number of the instrument; empty where it is unknown or the instrument is simulated."""


class EffectPart(_Part):
    """An effect with its parameters and their standard deviations, SI."""

    name: _Figure
    title: _Line = ""
    """What the effect is, in words; for readers of the file."""
    parameters: Annotated[dict[_Figure, _Finite], Field(max_length=64)]
    stds: Annotated[dict[_Figure, _Std], Field(max_length=64)] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _is_known(self) -> EffectPart:
        effect = all_effects().get(self.name)
        if effect is None:
            raise ValueError(Message("twin.unknown_effect", "there is no effect {name}", name=self.name))
        for parameter, value in zip(effect.parameters, values_by_name(effect, self.parameters).tolist(), strict=True):
            slack = 1e-6 * (parameter.high - parameter.low)
            if not parameter.low - slack <= value <= parameter.high + slack:
                raise ValueError(_outside(f"{self.name}: {parameter.name}", parameter.low, parameter.high, value))
        return self


class TwinFile(_Part):
    """Content of the file of a named twin."""

    format: Literal["tissueid-twin"] = FORMAT
    format_version: Literal["1.0"] = "1.0"
    name: Annotated[str, Field(pattern=rf"^{_NAME}$")]
    version: Annotated[int, Field(ge=1, le=1_000_000)] = 1
    created: _Line = ""
    software: _Line = ""
    sample_rate_hz: Annotated[float, Field(gt=0.0, le=1e6, allow_inf_nan=False)]
    source: TwinSource = TwinSource()
    instrument: dict[_Figure, _Finite]
    tissue: dict[_Figure, _Finite]
    stds: Annotated[dict[_Figure, _Std], Field(max_length=64)] = Field(default_factory=dict)
    effects: Annotated[tuple[EffectPart, ...], Field(max_length=MOST_NAMED)] = ()
    unmodelled: Annotated[dict[_Figure, _Share], Field(max_length=16)] = Field(default_factory=dict)
    """Error that the twin leaves of each signal beyond the sensor noise, as a share of its standard deviation."""

    @field_validator("instrument")
    @classmethod
    def _is_an_instrument(cls, figures: dict[str, float]) -> dict[str, float]:
        _complete("instrument", figures, {item.name for item in fields(InstrumentParameters)})
        for name in _POSITIVE:
            if not _LEAST <= figures[name] <= _MOST.get(name, 1e6):
                raise ValueError(_outside(name, _LEAST, _MOST.get(name, 1e6), figures[name]))
        if not (figures["filter_time_s"] == 0.0 or _LEAST <= figures["filter_time_s"] <= _MOST_FILTER_S):
            raise ValueError(_outside("filter_time_s", 0.0, _MOST_FILTER_S, figures["filter_time_s"]))
        for name in ("amplifier_limit_v", "bearing_damping_n_s_per_m"):
            if figures[name] < 0.0:
                raise ValueError(
                    Message("twin.negative", "{name} must be 0 or more, not {value:g}", name=name, value=figures[name])
                )
        return figures

    @field_validator("tissue")
    @classmethod
    def _is_tissue(cls, figures: dict[str, float]) -> dict[str, float]:
        _complete("tissue", figures, set(_TISSUE_BOUNDS))
        for name, (low, high) in _TISSUE_BOUNDS.items():
            if not low <= figures[name] <= high:
                raise ValueError(_outside(name, low, high, figures[name]))
        return figures

    @model_validator(mode="after")
    def _can_be_played(self) -> TwinFile:
        mass = self.instrument["moving_mass_kg"] + self.tissue["mass_kg"]
        if self.tissue["stiffness_n_per_m"] / mass > (_MOST_RADIANS * self.sample_rate_hz) ** 2:
            raise ValueError(
                Message("twin.too_stiff", "the tissue is too stiff for its mass: the simulation would be unstable")
            )
        names = [item.name for item in self.effects]
        if len(set(names)) < len(names):
            raise ValueError(Message("twin.effect_twice", "an effect occurs twice"))
        return self

    @property
    def twin(self) -> NamedTwin:
        """Return the twin as the player takes it."""
        stds = dict(self.stds)
        for item in self.effects:
            stds |= {f"{item.name}.{name}": value for name, value in item.stds.items()}
        return NamedTwin(
            self.name,
            self.version,
            InstrumentParameters(**self.instrument),
            Tissue(**self.tissue),
            tuple(_acting(item) for item in self.effects),
            self.sample_rate_hz,
            stds,
            dict(self.unmodelled),
        )


def _complete(what: str, figures: dict[str, float], wanted: set[str]) -> None:
    if missing := wanted - set(figures):
        raise ValueError(
            Message(
                "twin.missing",
                "values are missing in {part}: {names}",
                part=what,
                names=joined(map(Verbatim, sorted(missing))),
            )
        )
    if unknown := set(figures) - wanted:
        raise ValueError(
            Message(
                "twin.unknown",
                "unknown values in {part}: {names}",
                part=what,
                names=joined(map(Verbatim, sorted(unknown))),
            )
        )


def _outside(name: str, low: float, high: float, value: float) -> Message:
    return Message(
        "twin.out_of_range",
        "{name} must be between {low:g} and {high:g}, not {value:g}",
        name=name,
        low=low,
        high=high,
        value=value,
    )


def _acting(part: EffectPart) -> ActiveEffect:
    effect = all_effects()[part.name]
    values = values_by_name(effect, part.parameters)
    low, high = (np.array([getattr(item, end) for item in effect.parameters]) for end in ("low", "high"))
    return ActiveEffect(effect, np.clip(values, low, high))


def content_of(twin: NamedTwin, source: TwinSource, created: str, software: str) -> TwinFile:
    """Return the content of the file of a twin.

    Raises:
        UnusableInputError: the twin has more than ``MOST_NAMED`` effects, or cannot be simulated.
    """
    if len(twin.acting) > MOST_NAMED:
        raise UnusableInputError(
            "twin.too_many_effects",
            "a twin can have at most {most} effects, not {count}",
            most=MOST_NAMED,
            count=len(twin.acting),
        )
    effects = tuple(
        EffectPart(
            name=item.effect.name,
            title=item.effect.title,
            parameters={p.name: float(v) for p, v in zip(item.effect.parameters, item.values, strict=True)},
            stds={
                p.name: twin.stds[f"{item.effect.name}.{p.name}"]
                for p in item.effect.parameters
                if f"{item.effect.name}.{p.name}" in twin.stds
            },
        )
        for item in twin.acting
    )
    try:
        return TwinFile(
            name=twin.name,
            version=twin.version,
            created=created,
            software=software,
            sample_rate_hz=twin.sample_rate_hz,
            source=source,
            instrument=asdict(twin.instrument),
            tissue=asdict(twin.tissue),
            stds={name: value for name, value in twin.stds.items() if "." not in name},
            effects=effects,
            unmodelled=twin.unmodelled,
        )
    except ValidationError as error:
        raise UnusableInputError(validation_reason(error)) from error


def read_twin(path: Path) -> TwinFile:
    """Read a twin from a file, whose content is validated.

    Raises:
        UnusableInputError: the file cannot be read, is too large, is not a twin, or has an invalid field.
    """
    if path.exists() and not path.is_file():
        raise UnusableInputError("twin.no_file", "{path} is not a file", path=str(path))
    try:
        with path.open("rb") as file:
            data = file.read(MOST_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise UnusableInputError("twin.unreadable", "cannot read {path}: {why}", path=str(path), why=reason) from error
    if len(data) > MOST_BYTES:
        raise UnusableInputError(
            "twin.too_large",
            "{path} is too large for a twin: at most {most} KiB",
            path=str(path),
            most=MOST_BYTES // 1024,
        )
    try:
        content = toml_table(data)
    except ValueError as error:
        raise UnusableInputError("twin.no_toml", "{path} is not a twin: it is not TOML", path=str(path)) from error
    if content.get("format") != FORMAT:
        raise UnusableInputError(
            "twin.format", "{path} is not a twin: its format is not {format}", path=str(path), format=FORMAT
        )
    try:
        return TwinFile.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"]) or "content"
        raise UnusableInputError(
            "twin.field",
            "{path}: the field {field} is invalid: {why}",
            path=str(path),
            field=where[:100],
            why=validation_reason(error),
        ) from error


def check_twin_name(name: str) -> None:
    """Check the name of a new twin.

    Raises:
        UnusableInputError: it is empty, too long, or has characters that are not permitted.
    """
    if re.fullmatch(_NAME, name) is None:
        raise UnusableInputError(
            "twin.name",
            "the name of a twin (that of its file, unless another is given) must begin with a letter or digit and "
            "have only letters of the English alphabet, digits, blanks, dots, dashes and underscores, not {name}",
            name=Verbatim(f"“{clean(name)[:40]}”"),
        )


def check_twin_writable(path: Path) -> None:
    """Check that a twin can be written to ``path``, before any computation.

    Raises:
        UnusableInputError: a folder, a missing folder, another suffix, or an existing file that is not a twin.
    """
    if path.is_dir():
        raise UnusableInputError("twin.folder", "{path} is a folder; name a file", path=str(path))
    if path.suffix != SUFFIX:
        raise UnusableInputError(
            "twin.suffix", "the name of a twin file must end in {suffix}: {name}", suffix=SUFFIX, name=path.name
        )
    if not path.parent.is_dir():
        raise UnusableInputError("file.no_folder", "there is no folder {folder}", folder=str(path.parent))
    if path.exists():
        try:
            read_twin(path)
        except UnusableInputError:
            raise UnusableInputError(
                "twin.exists", "{path} exists already and is not a twin; it is not overwritten", path=str(path)
            ) from None


def write_twin(path: Path, content: TwinFile) -> None:
    """Write a twin atomically; only another twin is overwritten.

    Raises:
        UnusableInputError: the path is not permitted (``check_twin_writable``), or writing fails.
    """
    check_twin_writable(path)
    try:
        with atomic_file(path, synced=True, shared=True) as partial:
            partial.write_text(tomli_w.dumps(content.model_dump(mode="python", exclude_none=True)), encoding="utf-8")
    except OSError as error:
        raise UnusableInputError(
            "file.unwritable", "cannot write {path}: {why}", path=str(path), why=str(error.strerror)
        ) from error


def device_of(content: TwinFile) -> DeviceDescription:
    """Return the device description of a twin."""
    figures = content.instrument
    filter_time_s = figures["filter_time_s"]
    return DeviceDescription(
        model=twin_model(content.name, content.version),
        coil_resistance_ohm=figures["resistance_ohm"],
        coil_inductance_h=figures["inductance_h"],
        force_constant_n_per_a=figures["force_constant_n_per_a"],
        moving_mass_kg=figures["moving_mass_kg"],
        bearing_damping_n_s_per_m=figures["bearing_damping_n_s_per_m"],
        amplifier_gain=figures["amplifier_gain"],
        amplifier_limit_v=figures["amplifier_limit_v"],
        stroke_m=figures["stroke_m"],
        sample_rate_hz=content.sample_rate_hz,
        filter_corner_hz=0.5 / (math.pi * filter_time_s) if filter_time_s > 0.0 else 0.0,
    )
