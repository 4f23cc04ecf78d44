"""What is set for a test: one declaration of its properties, with unit, bounds, default, label and names.

A property is a field of ``SetUp`` (the same for all tests of a protocol) or of ``Circumstances`` (of each condition of
a protocol). From it follow the option of ``tissueid test``, the row of the form, the entry of a protocol, the note in
journal, HDF5 and export, the keys of JSON, the column of the table of a study, and the line of the report::

    hydration: Annotated[
        float | None,
        Setting("--hydration", metavar="SHARE", help="water of the skin, 0 to 1", choices=NOT_RECORDED),
        Field(title=marked("Hydration"), description=marked("Water content of the skin"), ge=0.0, le=1.0),
    ] = None

Only the German catalogue needs the new texts. The name of the field ends in its SI unit, if it has one.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Self, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from tissueid.configuration import (
    CONFIGURATIONS,
    PROBES,
    SPRING_NOTE,
    STIFFEST_SPRING_N_PER_M,
    ConfigurationName,
    CouplingName,
    Probe,
    has_depth,
)
from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.messages import Message, Verbatim, joined
from tissueid.plan_options import Option, Plan, option_of

DIRECTIONS = {"vertical": 0.0, "horizontal": 90.0}
"""Orientation by name, degrees against the axis of the limb."""


def orientation(text: str) -> float:
    """Return the angle against the axis of the limb, degrees, from a number or one of DIRECTIONS.

    Raises:
        UnusableInputError: the text is neither.
    """
    if text in DIRECTIONS:
        return DIRECTIONS[text]
    try:
        return float(text)
    except ValueError:
        raise UnusableInputError(
            "configuration.direction",
            "the orientation must be an angle in degrees, or one of {known}, got '{text}'",
            known=joined(map(Verbatim, DIRECTIONS)),
            text=Verbatim(text),
        ) from None


@dataclass(frozen=True)
class Setting(Option):
    """Option of a test that its session stores.

    Args:
        only: configurations that have it; empty for all.
        choices: label in a form by value, marked for translation. With None alone, any number or "not recorded".
        compared: whether tests that differ in it cannot be analysed together.
        usual: value that a form shows where the default leaves it to the stimulus.
        offered: bounds of a number in a form where they are narrower than those of the field.
        step: of a number in a form, which then has two decimals; 0 for a step that follows the value.
        shown: the value as part of a condition, with the field "{value}"; "" for label and value.
    """

    only: tuple[ConfigurationName, ...] = ()
    choices: Mapping[Any, str] = field(default_factory=dict)
    compared: bool = False
    usual: Any = None
    offered: tuple[float, float] | None = None
    step: float = 0.0
    shown: str = ""


NOT_RECORDED = {None: marked("not recorded")}
_ANGLES = {float(angle): f"{angle}°" for angle in (0, 15, 30, 45, 60, 75, 90, -75, -60, -45, -30, -15)}
_NAMED_ANGLES = {0.0: marked("0° vertical, along the limb"), 90.0: marked("90° horizontal, across the limb")}


class _Settings(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Circumstances(_Settings):
    """What may differ between the conditions of a protocol. None: unknown."""

    minutes_since_application: Annotated[
        float | None,
        Setting(
            "--minutes-since",
            metavar="MIN",
            help="minutes since the product was applied",
            choices=NOT_RECORDED,
            shown=marked("after {value:g} min"),
        ),
        Field(title=marked("Minutes since the application"), ge=0.0, le=1e6, allow_inf_nan=False),
    ] = None
    orientation_deg: Annotated[
        float | None,
        Setting(
            "--orientation",
            metavar="DEG",
            help="extension: angle to the axis of the limb, or vertical (along it), horizontal",
            read=orientation,
            only=("extension",),
            choices=NOT_RECORDED | _ANGLES | _NAMED_ANGLES,
            compared=True,
            shown="{value:g}°",
        ),
        Field(
            title=marked("Orientation"),
            description=marked("Direction of the extension against the axis of the limb"),
            ge=-180.0,
            le=180.0,
            allow_inf_nan=False,
        ),
    ] = None


class SetUp(_Settings):
    """How the instrument meets the tissue (thesis 2.2.3): the same for all tests of a protocol.

    The external spring is parallel to the tissue and is subtracted from the identified stiffness: sliding on a surface
    has no stiffness, so the probe needs a spring to stay in place. An attached probe can pull (thesis 2.1). The initial
    length is that between the faces before an extension (thesis 7.3), the normal preload presses a sliding probe onto
    the surface (thesis 7.4). Without ``probe`` it is the first one of the configuration.
    """

    configuration: Annotated[
        str,
        Setting(
            "--configuration",
            metavar="NAME",
            help="indentation, extension or surface",
            choices={
                "indentation": marked("Indentation"),
                "extension": marked("Extension"),
                "surface": marked("Surface (sliding)"),
            },
        ),
        Field(title=marked("Configuration")),
    ] = "indentation"
    probe: Annotated[
        str | None,
        Setting("--probe", metavar="NAME", help="probe tip; an unknown name lists all"),
        Field(title=marked("&Probe")),
    ] = None
    coupling: Annotated[
        CouplingName,
        Setting(
            "--coupling",
            metavar="NAME",
            help="none, tape, or adhesive (glue, liquid bandage)",
            only=("indentation", "extension"),
            choices={
                "none": marked("not attached"),
                "tape": marked("Double-sided tape"),
                "adhesive": marked("Glue or liquid bandage"),
            },
            compared=True,
        ),
        Field(
            title=marked("Coupling"),
            description=marked("What attaches the probe to the skin: only an attached probe can pull"),
        ),
    ] = "none"
    initial_length_m: Annotated[
        float | None,
        Setting(
            "--initial-length",
            metavar="MM",
            scale=1e-3,
            help="extension: length between the faces before it",
            only=("extension",),
            choices=NOT_RECORDED,
            compared=True,
        ),
        Field(title=marked("Initial length"), ge=1e-3, le=0.1, allow_inf_nan=False),
    ] = None
    external_spring_n_per_m: Annotated[
        float,
        Setting(
            "--external-spring",
            metavar="N/M",
            help="stiffness parallel to the tissue, subtracted; for surface",
            only=("surface",),
        ),
        Field(title=marked("E&xternal spring"), ge=0.0, le=STIFFEST_SPRING_N_PER_M, allow_inf_nan=False),
    ] = 0.0
    normal_preload_n: Annotated[
        float | None,
        Setting(
            "--normal-preload",
            metavar="N",
            help="surface: force that presses the probe on",
            only=("surface",),
            choices=NOT_RECORDED,
            compared=True,
        ),
        Field(title=marked("Normal preload"), gt=0.0, le=15.0, allow_inf_nan=False),
    ] = None


USUAL_FORCE_N = 0.5, 10.5
"""Range of force of noise that keeps the probe on the skin throughout, N."""
USUAL_SECONDS = 4.0
USUAL_SEED = 1
SECONDS = 0.5, 29.5
"""Shortest and longest stimulus of a form or protocol, s."""


class StimulusSettings(_Settings):
    """The stimulus, as far as all kinds share it; None leaves a value to the stimulus.

    ``kind`` is that of a test without tissue, or None for tissue or a sample.
    """

    stimulus: Annotated[
        str | None, Option("--stimulus", metavar="NAME", help="default: noise; 'tissueid stimulus' lists all")
    ] = None
    distribution: Annotated[
        str | None,
        Option("--distribution", help="distribution of amplitudes, such as gaussian (noise) or uniform"),
    ] = None
    min_force_n: Annotated[
        float | None,
        Setting(
            "--min-force",
            metavar="NEWTON",
            help=f"lower end of the force range; noise: {USUAL_FORCE_N[0]:g}",
            usual=USUAL_FORCE_N[0],
            offered=(-15.0, 14.5),
            step=0.5,
        ),
        Field(
            title=marked("Lo&west force"),
            description=marked("Below zero the coil pulls: tissue that is not attached to the probe is left"),
        ),
    ] = None
    max_force_n: Annotated[
        float | None,
        Setting(
            "--max-force",
            metavar="NEWTON",
            help=f"upper end of the force range; noise: {USUAL_FORCE_N[1]:g}",
            usual=USUAL_FORCE_N[1],
            offered=(0.5, 15.0),
            step=0.5,
        ),
        Field(title=marked("Hi&ghest force")),
    ] = None
    seconds: Annotated[
        float | None,
        Setting(
            "--seconds",
            metavar="SECONDS",
            help=f"length after 0.5 s of preload; noise: {USUAL_SECONDS:g}",
            usual=USUAL_SECONDS,
            offered=SECONDS,
            step=1.0,
        ),
        Field(title=marked("Dur&ation")),
    ] = None
    seed: Annotated[
        int | None,
        Setting("--seed", help="seed of the stimulus", usual=USUAL_SEED),
        Field(title=marked("Seed"), ge=0, le=2**31 - 1),
    ] = None
    kind: Annotated[
        str | None,
        Setting(
            "--kind",
            metavar="NAME",
            help="spring or free_air: a test without tissue",
            choices={
                None: marked("Tissue or sample"),
                "spring": marked("Calibration spring"),
                "free_air": marked("Nothing: free air"),
            },
        ),
        Field(title=marked("Under the probe")),
    ] = None


LARGEST_SCALE = 1e6
LARGEST_OFFSET = 1000.0
FILE_RATES_HZ = 1.0, 1e6
"""Lowest and highest sample rate of a file with a waveform, Hz."""
_AS_IT_IS = {None: marked("as in the file")}


class FilePlayback(_Settings):
    """How a stimulus from a file is played.

    ``scale`` and ``offset``, in the unit of the stimulus, apply to every sample; None for 1 and 0. ``file_rate_hz`` is
    the sample rate of a waveform without times; None for that of the instrument.
    """

    scale: Annotated[
        float | None,
        Setting("--scale", help="of a file: factor of the whole stimulus", choices=_AS_IT_IS),
        Field(ge=-LARGEST_SCALE, le=LARGEST_SCALE, description=marked("Factor of the whole stimulus")),
    ] = None
    offset: Annotated[
        float | None,
        Setting("--offset", metavar="NEWTON", help="of a file: added to the whole stimulus", choices=_AS_IT_IS),
        Field(
            title=marked("Offset (N)"),
            ge=-LARGEST_OFFSET,
            le=LARGEST_OFFSET,
            description=marked("Added to the whole stimulus, N"),
        ),
    ] = None
    file_rate_hz: Annotated[
        float | None,
        Setting("--file-rate", metavar="HZ", help="sample rate of a waveform without times; default: the instrument's"),
        Field(ge=FILE_RATES_HZ[0], le=FILE_RATES_HZ[1], description=marked("Sample rate of a file without times, Hz")),
    ] = None

    @property
    def file_options(self) -> list[str]:
        """Names on the command line of the options that are given."""
        given = (field for name, field in FilePlayback.model_fields.items() if getattr(self, name) is not None)
        return [option.name for field in given if (option := option_of(field)) is not None]


PROPERTIES = tuple(
    name for name in (*SetUp.model_fields, *Circumstances.model_fields) if name not in ("configuration", "probe")
)
"""Names of the properties as notes of a test, in JSON and in tables."""
_FIELDS = {**SetUp.model_fields, **Circumstances.model_fields}
NUMBERS = tuple(name for name in PROPERTIES if float in (_FIELDS[name].annotation, *get_args(_FIELDS[name].annotation)))
"""Those that are numbers."""


def setting_of(name: str) -> Setting:
    """Return the declaration of a property."""
    declared = option_of(_FIELDS[name])
    assert isinstance(declared, Setting)
    return declared


def label_of(name: str) -> str:
    """Return the label of a setting in a form, in English, with the mark of its key."""
    return _FIELDS[name].title or name


COMPARED_CIRCUMSTANCES = tuple(name for name in Circumstances.model_fields if setting_of(name).compared)
"""Names of the circumstances in which tests under one condition differ too much for one group."""


def circumstance_text(name: str, value: Any) -> Message:
    """Return a circumstance as part of a condition, such as "after 60 min"."""
    if shown := setting_of(name).shown:
        return Message("setting.circumstance", shown, value=value)
    text = setting_of(name).choices.get(value, value)
    return Message("setting.named", "{label}: {value}", label=label_of(name).replace("&", ""), value=text)


class TestSettings(StimulusSettings, Circumstances, SetUp, Plan):
    """Everything that is set for a test. Its session stores the stimulus and all other settings.

    ``sitting`` is the key shared by the tests of one sitting that are in several files, and ``repeat`` their number,
    from 1.

    Raises:
        UnusableInputError: a value is not possible, or they do not go together.
    """

    __test__ = False  # not a test case for pytest

    site: Annotated[str, Option("--site", metavar="TEXT", help="site on the body, or material")] = ""
    condition: Annotated[
        str, Option("--condition", metavar="TEXT", help="condition in a study, such as the product on the skin")
    ] = ""
    sitting: str = ""
    repeat: int = 0

    @model_validator(mode="after")
    def _go_together(self) -> Self:
        name = self.configuration
        if name not in CONFIGURATIONS:
            raise ValueError(
                Message(
                    "configuration.unknown",
                    "the configuration must be one of {known}, not '{name}'",
                    known=joined(map(Verbatim, CONFIGURATIONS)),
                    name=Verbatim(name),
                )
            )
        if self.probe is not None and self.probe not in PROBES:
            raise ValueError(
                Message(
                    "configuration.unknown_probe",
                    "the probe '{name}' is unknown; available: {known}",
                    name=Verbatim(self.probe),
                    known=joined(map(Verbatim, PROBES)),
                )
            )
        if self.tip.configuration != name:
            raise ValueError(
                Message(
                    "configuration.wrong_probe",
                    "the probe {probe} is made for {made_for}; for {name}: {fitting}",
                    probe=self.tip.name,
                    made_for=self.tip.configuration,
                    name=name,
                    fitting=", ".join(probe.name for probe in PROBES.values() if probe.configuration == name),
                )
            )
        if name == "surface" and not self.external_spring_n_per_m:
            raise ValueError(
                Message(
                    "configuration.no_spring",
                    "sliding on a surface needs an external spring: give its stiffness in N/m",
                )
            )
        for property_name in PROPERTIES:
            only = setting_of(property_name).only
            if getattr(self, property_name) == _FIELDS[property_name].default or not only or name in only:
                continue
            raise ValueError(
                Message(
                    "configuration.not_here",
                    "{what} goes with {where} only, not with {name}",
                    what=Message("configuration.property", label_of(property_name).replace("&", "")),
                    where=joined(map(Verbatim, only)),
                    name=name,
                )
            )
        return self

    @property
    def tip(self) -> Probe:
        """The probe tip."""
        first = next(probe.name for probe in PROBES.values() if probe.configuration == self.configuration)
        return PROBES[self.probe or first]

    @property
    def has_depth(self) -> bool:
        """Whether the position is a depth in the tissue; along the surface it is a displacement."""
        return has_depth(self.configuration)

    def as_notes(self) -> dict[str, str | float]:
        """Return the notes that a session stores with every test, in addition to site and configuration."""
        notes = self.tip.as_notes() | {SPRING_NOTE: self.external_spring_n_per_m}
        if self.configuration == "extension":
            notes["coupling"] = self.coupling
        for name in (*PROPERTIES, "condition"):
            if (value := getattr(self, name)) != TestSettings.model_fields[name].default:
                notes[name] = value
        return notes | ({"sitting": self.sitting, "repeat": float(self.repeat)} if self.sitting else {})


_Model = TypeVar("_Model", bound=BaseModel)


def noted(model: type[_Model], notes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a model of settings that the notes of a test hold with possible values."""
    values = {}
    for name in model.model_fields.keys() & notes.keys():
        with contextlib.suppress(ValidationError):
            values[name] = getattr(model.model_validate({name: notes[name]}, strict=True), name)
    return values


def placement(notes: Mapping[str, str | float]) -> tuple[str | float | None, ...]:
    """Return how the probe meets the tissue by the notes of a test: what must be equal for tests to be comparable."""
    return tuple(notes.get(name, _FIELDS[name].default) for name in PROPERTIES if setting_of(name).compared)
