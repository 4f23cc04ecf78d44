"""Measuring configurations: direction of the force, probe and external spring (thesis 2.2.3)."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from tissueid.errors import UnusableInputError
from tissueid.messages import Message, Verbatim, joined
from tissueid.option_errors import validation_reason

ConfigurationName = Literal["indentation", "extension", "surface"]
CONFIGURATIONS: tuple[ConfigurationName, ...] = get_args(ConfigurationName)

SPRING_NOTE = "external_spring_n_per_m"
"""Note of a test with the stiffness of its external spring."""
STIFFEST_SPRING_N_PER_M = 20_000.0

CouplingName = Literal["none", "tape", "adhesive"]
COUPLINGS: tuple[CouplingName, ...] = get_args(CouplingName)
"""How the probe is attached; ``adhesive`` is glue or liquid bandage."""
DIRECTIONS = {"vertical": 0.0, "horizontal": 90.0}
"""Orientation by name, degrees against the axis of the limb."""
INITIAL_LENGTHS_M = 1e-3, 0.1
"""Shortest and longest initial length of an extension, m."""
MOST_NORMAL_PRELOAD_N = 15.0

Length = Annotated[float, Field(gt=0.0, le=0.05, allow_inf_nan=False)]


class _Specification(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Probe(_Specification):
    """The tip of the instrument, SI: round with ``diameter_m``, or ``width_m`` by ``length_m``. None: unknown."""

    name: Annotated[str, Field(min_length=1, max_length=40, pattern=r"^[\w.-]+$")] = "indenter-4.4mm"
    configuration: ConfigurationName = "indentation"
    diameter_m: Length | None = None
    width_m: Length | None = None
    length_m: Length | None = None
    thickness_m: Length | None = None
    corner_radius_m: Length | None = None
    source: Annotated[str, Field(max_length=200)] = ""

    @model_validator(mode="after")
    def _one_shape(self) -> Self:
        if (self.diameter_m is None) == (self.width_m is None or self.length_m is None):
            raise ValueError(
                Message("configuration.probe_shape", "a probe has either a diameter, or a width and a length")
            )
        return self

    @property
    def words(self) -> Message:
        """The shape of the probe."""
        if self.diameter_m is not None:
            shape = Message("probe.round", "{diameter:g} mm across", diameter=1e3 * self.diameter_m)
        else:
            width, length = 1e3 * (self.width_m or 0.0), 1e3 * (self.length_m or 0.0)
            shape = Message("probe.long", "{width:g} mm by {length:g} mm", width=width, length=length)
        if self.corner_radius_m is None:
            return shape
        radius = 1e3 * self.corner_radius_m
        return Message("probe.corner", "{shape}, corner radius {radius:g} mm", shape=shape, radius=radius)

    def as_notes(self) -> dict[str, str | float]:
        """Return the notes that a session stores with every test."""
        shown = self.model_dump(exclude={"configuration", "source"}, exclude_none=True)
        return {f"probe_{name}": value for name, value in shown.items()}


_LIBRARY = (
    Probe(
        name="indenter-4.4mm",
        diameter_m=4.4e-3,
        thickness_m=1.0e-3,
        source="thesis 2.2.3: a steel disk; its corner radius is not given",
    ),
    Probe(
        name="indenter-4.3mm",
        diameter_m=4.3e-3,
        corner_radius_m=0.4e-3,
        source="thesis 7.2, Fig. 7.11: the small probe with the small corner radius",
    ),
    Probe(
        name="indenter-5mm",
        diameter_m=5.0e-3,
        corner_radius_m=1.3e-3,
        source="thesis 7.2, Fig. 7.12: the large probe with the large corner radius",
    ),
    Probe(
        name="extension-5x16mm",
        configuration="extension",
        width_m=5.0e-3,
        length_m=16.0e-3,
        corner_radius_m=2.0e-3,
        source="thesis 2.2.3",
    ),
    Probe(
        name="slider-5x16mm",
        configuration="surface",
        width_m=5.0e-3,
        length_m=16.0e-3,
        corner_radius_m=1.5e-3,
        source="thesis Fig. 7.22, with a normal preload of 1 N",
    ),
)
PROBES: dict[str, Probe] = {probe.name: probe for probe in _LIBRARY}
"""Known probes by name."""


class Configuration(_Specification):
    """A measuring configuration.

    ``external_spring_n_per_m`` is parallel to the tissue and is subtracted from the identified stiffness: sliding on a
    surface has no stiffness, so the probe needs a spring to stay in place (thesis 2.2.3).

    ``coupling`` is how the probe is attached: in indentation it allows to pull (thesis 2.1). ``orientation_deg`` is the
    direction of the extension against the axis of the limb, and ``initial_length_m`` the length between the faces
    before it (thesis 7.3). ``normal_preload_n`` presses a sliding probe onto the surface (thesis 7.4). None: unknown.
    """

    name: ConfigurationName = "indentation"
    probe: Probe = Field(default_factory=lambda: PROBES["indenter-4.4mm"])
    external_spring_n_per_m: Annotated[float, Field(ge=0.0, le=STIFFEST_SPRING_N_PER_M)] = 0.0
    coupling: CouplingName = "none"
    orientation_deg: Annotated[float | None, Field(ge=-180.0, le=180.0)] = None
    initial_length_m: float | None = None
    normal_preload_n: Annotated[float | None, Field(gt=0.0, le=MOST_NORMAL_PRELOAD_N)] = None

    @model_validator(mode="after")
    def _go_together(self) -> Self:
        if self.probe.configuration != self.name:
            fitting = ", ".join(probe.name for probe in PROBES.values() if probe.configuration == self.name)
            raise ValueError(
                Message(
                    "configuration.wrong_probe",
                    "the probe {probe} is made for {made_for}; for {name}: {fitting}",
                    probe=self.probe.name,
                    made_for=self.probe.configuration,
                    name=self.name,
                    fitting=fitting,
                )
            )
        if self.name == "surface" and self.external_spring_n_per_m == 0.0:
            raise ValueError(
                Message(
                    "configuration.no_spring",
                    "sliding on a surface needs an external spring: give its stiffness in N/m",
                )
            )
        if self.name != "surface" and self.external_spring_n_per_m > 0.0:
            raise ValueError(
                Message(
                    "configuration.spring",
                    "an external spring is used in the configuration surface only, not in {name}",
                    name=self.name,
                )
            )
        shortest, longest = INITIAL_LENGTHS_M
        if self.initial_length_m is not None and not shortest <= self.initial_length_m <= longest:
            raise ValueError(
                Message(
                    "configuration.initial_length_range",
                    "the initial length must be between {shortest:g} and {longest:g} mm, got {length:g} mm",
                    shortest=1e3 * shortest,
                    longest=1e3 * longest,
                    length=1e3 * self.initial_length_m,
                )
            )
        for field, belongs_to in _BELONGS_TO.items():
            if getattr(self, field) not in (None, "none") and self.name not in belongs_to:
                raise ValueError(
                    Message(
                        "configuration.not_here",
                        "{what} goes with {where} only, not with {name}",
                        what=_CALLED[field],
                        where=joined(map(Verbatim, belongs_to)),
                        name=self.name,
                    )
                )
        return self

    @classmethod
    def of(
        cls, name: str = "indentation", probe: str | None = None, external_spring_n_per_m: float = 0.0, **others: Any
    ) -> Self:
        """Return the configuration with these names, and with its first probe if ``probe`` is None.

        Args:
            name: one of CONFIGURATIONS.
            probe: one of PROBES.
            external_spring_n_per_m: stiffness parallel to the tissue.
            others: further fields by name: coupling, orientation_deg, initial_length_m, normal_preload_n.

        Raises:
            UnusableInputError: a name is unknown, a value is not possible, or they do not fit together.
        """
        if name not in CONFIGURATIONS:
            raise UnusableInputError(
                "configuration.unknown",
                "the configuration must be one of {known}, not '{name}'",
                known=joined(map(Verbatim, CONFIGURATIONS)),
                name=Verbatim(name),
            )
        if probe is None:
            probe = next(known.name for known in PROBES.values() if known.configuration == name)
        if probe not in PROBES:
            raise UnusableInputError(
                "configuration.unknown_probe",
                "the probe '{name}' is unknown; available: {known}",
                name=Verbatim(probe),
                known=joined(map(Verbatim, PROBES)),
            )
        try:
            return cls.model_validate(
                {"name": name, "probe": PROBES[probe], "external_spring_n_per_m": external_spring_n_per_m} | others
            )
        except ValidationError as error:
            if error.errors()[0]["type"] == "value_error":
                raise UnusableInputError(validation_reason(error)) from error
            if (field := str(error.errors()[0]["loc"][0])) in _CALLED:
                raise UnusableInputError(
                    "configuration.value", "{what}: {why}", what=_CALLED[field], why=validation_reason(error)
                ) from error
            raise UnusableInputError(
                "configuration.spring_value", "the external spring, in N/m: {why}", why=validation_reason(error)
            ) from error

    @property
    def has_depth(self) -> bool:
        """Whether the position is a depth in the tissue; along the surface it is a displacement."""
        return has_depth(self.name)

    def as_notes(self) -> dict[str, str | float]:
        """Return the notes that a session stores with every test, in addition to the name of the configuration."""
        notes = self.probe.as_notes() | {SPRING_NOTE: self.external_spring_n_per_m}
        if self.coupling != "none" or self.name == "extension":
            notes["coupling"] = self.coupling
        for name in ("orientation_deg", "initial_length_m", "normal_preload_n"):
            if (value := getattr(self, name)) is not None:
                notes[name] = value
        return notes


_BELONGS_TO: dict[str, tuple[ConfigurationName, ...]] = {
    "coupling": ("indentation", "extension"),
    "orientation_deg": ("extension",),
    "initial_length_m": ("extension",),
    "normal_preload_n": ("surface",),
}
_CALLED = {
    "coupling": Message("configuration.coupling", "the coupling"),
    "orientation_deg": Message("configuration.orientation", "the orientation (degrees against the limb)"),
    "initial_length_m": Message("configuration.initial_length", "the initial length"),
    "normal_preload_n": Message("configuration.normal_preload", "the normal preload (N)"),
}


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


def placement(notes: dict[str, str | float]) -> tuple[str | float, ...]:
    """Return how the probe meets the tissue by the notes of a test: what must be equal for tests to be comparable."""
    return notes.get("coupling", "none"), *(
        notes.get(name, "") for name in ("orientation_deg", "initial_length_m", "normal_preload_n")
    )


def is_attached(notes: dict[str, str | float]) -> bool:
    """Return whether the probe is attached to the tissue, which it can then pull, by the notes of a test."""
    return notes.get("coupling") in ("tape", "adhesive")


def has_depth(name: str) -> bool:
    """Return whether the position of a test in this configuration is a depth in the tissue."""
    return name not in ("extension", "surface")


def travel_word(name: str) -> str:
    """Return the name of the probe's travel in a configuration: ``depth`` or ``displacement``."""
    return "depth" if has_depth(name) else "displacement"


def spring_of(notes: dict[str, str | float]) -> float:
    """Return the stiffness of the external spring in the notes of a test, N/m; 0 without a valid value."""
    value = notes.get(SPRING_NOTE, 0.0)
    return float(value) if isinstance(value, int | float) and 0.0 <= value <= STIFFEST_SPRING_N_PER_M else 0.0
