"""How the instrument meets the tissue: which way it acts, with which probe, and what moves with it (thesis 2.2.3)."""

from __future__ import annotations

from typing import Annotated, Literal, Self, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from tissueid.errors import UnusableInputError

ConfigurationName = Literal["indentation", "extension", "surface"]
CONFIGURATIONS: tuple[ConfigurationName, ...] = get_args(ConfigurationName)

SPRING_NOTE = "external_spring_n_per_m"
"""The note of a test that holds the stiffness of its external spring."""
STIFFEST_SPRING_N_PER_M = 20_000.0

Length = Annotated[float, Field(gt=0.0, le=0.05, allow_inf_nan=False)]


class _Specification(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Probe(_Specification):
    """The tip, SI. ``diameter_m`` of a round one, ``width_m`` by ``length_m`` of a long one; None: not known."""

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
            raise ValueError("a probe has either a diameter, or a width and a length")
        return self

    @property
    def words(self) -> str:
        """Its shape in a few words."""
        if self.diameter_m is not None:
            shape = f"{1e3 * self.diameter_m:g} mm across"
        else:
            shape = f"{1e3 * (self.width_m or 0.0):g} mm by {1e3 * (self.length_m or 0.0):g} mm"
        return shape if self.corner_radius_m is None else f"{shape}, corner radius {1e3 * self.corner_radius_m:g} mm"

    def as_notes(self) -> dict[str, str | float]:
        """What a session keeps of it with every test."""
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
        corner_radius_m=2.5e-3,
        source="chosen: the extension probe with fully rounded edges; thesis 2.2.3 says more rounded, and no figure",
    ),
)
PROBES: dict[str, Probe] = {probe.name: probe for probe in _LIBRARY}
"""The probes that are known by name."""


class Configuration(_Specification):
    """One way of using the instrument.

    ``external_spring_n_per_m`` stands in parallel to the tissue and is subtracted from what is identified: sliding on a
    surface has no stiffness of its own, and needs one to stay where it is (thesis 2.2.3).
    """

    name: ConfigurationName = "indentation"
    probe: Probe = Field(default_factory=lambda: PROBES["indenter-4.4mm"])
    external_spring_n_per_m: Annotated[float, Field(ge=0.0, le=STIFFEST_SPRING_N_PER_M)] = 0.0

    @model_validator(mode="after")
    def _go_together(self) -> Self:
        if self.probe.configuration != self.name:
            fitting = ", ".join(probe.name for probe in PROBES.values() if probe.configuration == self.name)
            raise ValueError(
                f"the probe {self.probe.name} is made for {self.probe.configuration}; for {self.name}: {fitting}"
            )
        if self.name == "surface" and self.external_spring_n_per_m == 0.0:
            raise ValueError("sliding on a surface needs an external spring: give its stiffness in N/m")
        if self.name != "surface" and self.external_spring_n_per_m > 0.0:
            raise ValueError(f"an external spring belongs to the configuration surface, not to {self.name}")
        return self

    @classmethod
    def of(cls, name: str = "indentation", probe: str | None = None, external_spring_n_per_m: float = 0.0) -> Self:
        """A configuration by names, as a command line or a form gives them; the first probe that fits without one.

        Raises:
            UnusableInputError: no such configuration or probe, or what does not go together.
        """
        if name not in CONFIGURATIONS:
            raise UnusableInputError(f"a configuration is {', '.join(CONFIGURATIONS)}, not {name!r}")
        if probe is None:
            probe = next(known.name for known in PROBES.values() if known.configuration == name)
        if probe not in PROBES:
            raise UnusableInputError(f"no probe {probe!r} is known; there are: {', '.join(PROBES)}")
        try:
            return cls.model_validate(
                {"name": name, "probe": PROBES[probe], "external_spring_n_per_m": external_spring_n_per_m}
            )
        except ValidationError as error:
            first = error.errors()[0]
            if first["type"] == "value_error":
                raise UnusableInputError(str(first["ctx"]["error"])) from error
            words = str(first["msg"]).replace("Input should be", "it must be")
            raise UnusableInputError(f"the external spring: {words}, in N/m") from error

    @property
    def has_depth(self) -> bool:
        """Whether the position goes into the tissue; along its surface there is a displacement and no depth."""
        return has_depth(self.name)

    def as_notes(self) -> dict[str, str | float]:
        """What a session keeps with every test, beside the name of the configuration."""
        return self.probe.as_notes() | {SPRING_NOTE: self.external_spring_n_per_m}


def has_depth(name: str) -> bool:
    """Whether the position of a test in the configuration of this name goes into the tissue."""
    return name not in ("extension", "surface")


def travel_word(name: str) -> str:
    """What the way of the probe is called in a configuration: ``depth`` or ``displacement``."""
    return "depth" if has_depth(name) else "displacement"


def spring_of(notes: dict[str, str | float]) -> float:
    """The external spring that the notes of a test tell of, N/m; none where they tell nothing that can be."""
    value = notes.get(SPRING_NOTE, 0.0)
    return float(value) if isinstance(value, int | float) and 0.0 <= value <= STIFFEST_SPRING_N_PER_M else 0.0
