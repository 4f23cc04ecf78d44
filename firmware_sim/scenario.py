"""Scenario of a simulated instrument: device, tissue, true parameters and faults, read from a TOML file."""

from __future__ import annotations

import errno
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from firmware_sim.bench import Bench
from firmware_sim.converters import CHANNELS, ChannelError
from firmware_sim.device_models import MODELS
from firmware_sim.effects import in_order, read_effects
from firmware_sim.effects.base import Effect
from firmware_sim.faults import PlannedFault
from firmware_sim.identity import Identity
from firmware_sim.lotions import with_lotion
from firmware_sim.plant import SAMPLE_RATE_HZ, STANDARD_GRAVITY, PlantParameters
from firmware_sim.presets import DEFAULT, load_preset, preset_names
from firmware_sim.probe import read_probe
from firmware_sim.tissue import Tissue
from firmware_sim.validation_reason import validation_reason
from firmware_sim.variation import Variation


def _between(low: float, high: float) -> object:
    return Field(ge=low, le=high, allow_inf_nan=False)


class TrueParameters(BaseModel):
    """True parameters of the device where they differ from the announced ones, by the names of the plant, SI.

    The weight is that of the moving mass unless it is given as well.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    resistance_ohm: Annotated[float | None, _between(1.0, 100.0)] = None
    inductance_h: Annotated[float | None, _between(1e-5, 1e-2)] = None
    force_constant_n_per_a: Annotated[float | None, _between(0.1, 30.0)] = None
    moving_mass_kg: Annotated[float | None, _between(0.005, 1.0)] = None
    bearing_damping_n_s_per_m: Annotated[float | None, _between(0.0, 100.0)] = None
    gravity_force_n: Annotated[float | None, _between(-10.0, 10.0)] = None
    amplifier_gain: Annotated[float | None, _between(0.5, 2.0)] = None
    amplifier_limit_v: Annotated[float | None, _between(1.0, 60.0)] = None
    stroke_m: Annotated[float | None, _between(0.020, 0.0325)] = None
    stop_stiffness_n_per_m: Annotated[float | None, _between(1e4, 1e6)] = None
    stop_damping_s_per_m: Annotated[float | None, _between(0.1, 50.0)] = None
    thermal_resistance_k_per_w: Annotated[float | None, _between(0.1, 100.0)] = None
    heat_capacity_j_per_k: Annotated[float | None, _between(0.1, 1000.0)] = None
    ambient_degc: Annotated[float | None, _between(-20.0, 60.0)] = None
    filter_cutoff_hz: Annotated[float | None, _between(100.0, 5000.0)] = None
    sensor_lag_s: Annotated[float | None, _between(0.05, 30.0)] = None

    def over(self, nominal: PlantParameters) -> PlantParameters:
        """Return the nominal parameters with these replaced."""
        given = self.model_dump(exclude_none=True)
        if "moving_mass_kg" in given:
            given.setdefault("gravity_force_n", given["moving_mass_kg"] * STANDARD_GRAVITY)
        return replace(nominal, **given)


class TrueChannel(BaseModel):
    """Error of a channel's scale against the announced one; the offset in the unit of the channel."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    gain_error: Annotated[float, _between(-0.2, 0.2)] = 0.0
    offset: Annotated[float, Field(allow_inf_nan=False)] = 0.0


class Scenario(BaseModel):
    """Definition of one simulated instrument; the same scenario is reproducible."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    model: Literal["desktop", "handheld"] = "desktop"
    preset: str = DEFAULT
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    speed: Annotated[float, Field(gt=0, le=1000)] = 1.0
    """Device seconds per second; the clock of the watchdog is never accelerated."""
    serial_number: Annotated[str, Field(pattern=r"^[\x20-\x7e]{1,16}$")] = "SIM-0001"
    sample_rate_hz: Annotated[float, Field(ge=500, le=10_000)] = SAMPLE_RATE_HZ
    protocol: tuple[Annotated[int, Field(ge=0, le=255)], Annotated[int, Field(ge=0, le=255)]] = (1, 1)
    tilt_deg: Annotated[float, _between(-180.0, 180.0)] = 0.0
    """Angle of the stroke from straight down."""
    coil: Literal["ideal", "finite"] = "ideal"
    """Force constant constant along the stroke, or decreasing towards its ends."""
    probe: str | None = None
    """Round probe by name, or DIAMETER:CORNER in mm; by default that of the preset."""
    orientation_deg: Annotated[float | None, _between(-180.0, 180.0)] = None
    """Angle of a strip in extension against the limb's axis."""
    initial_length_m: Annotated[float | None, _between(1e-3, 0.1)] = None
    """Initial length of a strip in extension."""
    normal_preload_n: Annotated[float | None, Field(gt=0.0, le=15.0, allow_inf_nan=False)] = None
    """Force that presses a slider onto the skin: its friction is then dry, and proportional to this force."""
    lotion: str | None = None
    """Lotion on the skin."""
    stage: bool | None = None
    """A motorised stage that positions the fixture; by default only a desktop device has one."""
    truth: TrueParameters = TrueParameters()
    channels: dict[str, TrueChannel] = Field(default_factory=dict)
    sensor_supply_share: Annotated[float, _between(0.8, 1.2)] = 1.0
    """Supply voltage of the sensors relative to nominal, which scales the potentiometer's reading."""
    effects: dict[str, dict[str, bool | int | float | str]] = Field(default_factory=dict)
    """Effects added to the plant: parameters by name of the effect."""
    faults: tuple[PlannedFault, ...] = ()
    variation: Annotated[float, _between(0.0, 3.0)] = 0.0
    """Variation of skin between placings and tests relative to that of people (thesis Table 7.1); 0: none."""
    subject: Annotated[int | None, Field(ge=0, lt=2**32)] = None
    """Number of the person under the probe; without one, the person of the preset."""

    @model_validator(mode="after")
    def _effects_exist(self) -> Self:
        read_effects(self.effects)
        return self

    @property
    def acting(self) -> tuple[Effect, ...]:
        """The effects, in the order of the plant, with the friction of a slider under a normal preload."""
        own = read_effects(self.effects)
        return own if self.normal_preload_n is None else in_order([*own, self._skin.pressed(self.normal_preload_n)[1]])

    @model_validator(mode="after")
    def _channels_exist(self) -> Self:
        known = {channel.name: channel for channel in CHANNELS}
        for name, item in self.channels.items():
            if name not in known:
                raise ValueError(f"channels has no {name!r}; there are: {', '.join(known)}")
            furthest = 0.1 * 65536 * known[name].gain
            if abs(item.offset) > furthest:
                raise ValueError(
                    f"channels.{name}.offset must be within a tenth of the converter's range, "
                    f"{furthest:.3g} {known[name].unit}"
                )
        return self

    @property
    def nominal(self) -> PlantParameters:
        """The announced parameters of the device."""
        return MODELS[self.model].plant

    @property
    def real(self) -> PlantParameters:
        """The true parameters of the device, without tilt."""
        return self.truth.over(self.nominal)

    @property
    def tissue(self) -> Tissue:
        """The tissue of the preset with lotion, normal preload, orientation, length and probe.

        Raises:
            ValueError: one of them does not go with the preset.
        """
        tissue = self._skin
        if self.normal_preload_n is not None:
            tissue = tissue.pressed(self.normal_preload_n)[0]
        if self.orientation_deg is not None or self.initial_length_m is not None:
            tissue = tissue.stretched(self.orientation_deg, self.initial_length_m)
        return tissue if self.probe is None else tissue.with_probe(read_probe(self.probe))

    @property
    def _skin(self) -> Tissue:
        tissue = load_preset(self.preset)
        return tissue if self.lotion is None else with_lotion(tissue, self.lotion)

    def bench(self) -> Bench:
        """Return the bench of this scenario."""
        return Bench(
            self.tissue,
            seed=self.seed,
            parameters=self.real,
            nominal=self.nominal,
            tilt_deg=self.tilt_deg,
            sample_rate_hz=self.sample_rate_hz,
            coil=self.coil,
            channel_errors={name: ChannelError(**item.model_dump()) for name, item in self.channels.items()},
            sensor_supply_share=self.sensor_supply_share,
            frame_mass_kg=MODELS[self.model].frame_mass_kg,
            effects=self.acting,
            variation=Variation(self.seed, self.variation, self.subject),
        )

    def identity(self) -> Identity:
        """Return the identity of the device in the handshake."""
        return Identity(
            model=MODELS[self.model].title,
            serial_number=self.serial_number,
            protocol_min=self.protocol[0],
            protocol_max=self.protocol[1],
            max_force_n=MODELS[self.model].max_force_n,
            stage=self.model == "desktop" if self.stage is None else self.stage,
        )


MOST_BYTES = 16 * 1024
"""Largest size of a scenario: in the worst case the TOML parser needs memory proportional to its square, 0.3 GB."""


def _text(path: Path) -> str:
    """Return the text of a scenario.

    Raises:
        OSError: it cannot be read, is not an ordinary file (a pipe may never end), or is too large.
        UnicodeDecodeError: it is not text.
    """
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "it is not an ordinary file", str(path))
    with path.open("rb") as file:
        data = file.read(MOST_BYTES + 1)
    if len(data) > MOST_BYTES:
        raise OSError(errno.EFBIG, f"it has more than {MOST_BYTES} bytes", str(path))
    return data.decode("utf-8")


def load_scenario(path: Path | None, **overrides: object) -> Scenario:
    """Return a scenario from a file, with options of the command line taking precedence.

    Raises:
        ValueError: the file or an option is invalid; one line.
    """
    values: dict[str, object] = {}
    if path is not None:
        try:
            values = tomllib.loads(_text(path))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
            reason = getattr(error, "strerror", None) or error
            if isinstance(error, UnicodeError | RecursionError):
                reason = "not text" if isinstance(error, UnicodeError) else "nested too deeply"
            raise ValueError(f"cannot read the scenario {path}: {reason}") from error
    values |= {name: value for name, value in overrides.items() if value is not None}
    try:
        scenario = Scenario.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        known = Scenario.model_fields if len(first["loc"]) == 1 else ()
        raise ValueError(
            f"the scenario's {where or 'figures'} cannot be used: {validation_reason(first, known)}"
        ) from error
    if scenario.preset not in preset_names():
        raise ValueError(f"no preset {scenario.preset!r}; there are: {', '.join(preset_names())}")
    scenario.tissue  # noqa: B018 - raises for options that do not go with the preset
    kind = load_preset(scenario.preset).kind
    if (scenario.variation > 0.0 or scenario.subject is not None) and kind != "dpn":
        raise ValueError(f"variation and subject are for skin, a tissue of kind dpn; {scenario.preset} is {kind}")
    return scenario
