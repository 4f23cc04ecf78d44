"""Measuring configurations and their probes (thesis 2.2.3)."""

from __future__ import annotations

from typing import Annotated, Literal, Self, get_args

from pydantic import BaseModel, ConfigDict, Field, model_validator

from tissueid.messages import Message

ConfigurationName = Literal["indentation", "extension", "surface"]
CONFIGURATIONS: tuple[ConfigurationName, ...] = get_args(ConfigurationName)

SPRING_NOTE = "external_spring_n_per_m"
"""Note of a test with the stiffness of its external spring."""
STIFFEST_SPRING_N_PER_M = 20_000.0

CouplingName = Literal["none", "tape", "adhesive"]
"""How the probe is attached; ``adhesive`` is glue or liquid bandage."""
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
