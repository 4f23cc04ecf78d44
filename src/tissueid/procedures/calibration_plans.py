"""Plans of the static calibration and of the dynamic sweep."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field

from tissueid.errors import UnusableInputError
from tissueid.plan_options import Option, Plan

if TYPE_CHECKING:
    from tissueid.calibration.static_procedure import StaticPlan
    from tissueid.calibration.sweep import SweepPlan
    from tissueid.calibration.sweep_analysis import SpringMass
    from tissueid.device import DeviceDescription

Kind = Literal["static", "sweep"]
_MOST_SPRING_KG = 0.2
"""Largest mass of the spring, kg."""


class CalibrationPlan(Plan):
    """What both calibrations have. ``folder`` None is the calibration folder of the user.

    With ``all_files`` the report, and the recording of a sweep, are written next to the calibration, with its name.
    """

    kind: ClassVar[Kind]

    device: Annotated[str | None, Option("--device", metavar="URL", help="see 'tissueid devices'")] = None
    out: Annotated[
        Path | None,
        Option("--out", metavar="FILE", help="new calibration file, TOML; default: one in the calibration folder"),
    ] = None
    report: Annotated[Path | None, Option("--report", metavar="FILE", help="write the report, one HTML page")] = None
    overwrite: Annotated[bool, Option("--overwrite", help="replace the files of --out and --report if they exist")] = (
        False
    )
    folder: Annotated[
        Path | None,
        Option("--calibrations", metavar="DIR", help="calibration folder; default: your own (see 'list')"),
    ] = None
    all_files: bool = False
    spring_n_per_m: Annotated[
        float | None,
        Option("--spring", metavar="N/M", help="stiffness of the calibration spring; default: the value of the device"),
    ] = None
    spring_relative_std: Annotated[
        float | None,
        Option("--spring-uncertainty", metavar="PERCENT", scale=1e-2, help="relative uncertainty of the stiffness"),
    ] = None
    repeats: Annotated[int, Option("--repeats", metavar="N", help="number of runs"), Field(ge=1, le=100)] = 1
    valid_days: Annotated[
        int, Option("--valid-days", metavar="DAYS", help="validity in days"), Field(ge=1, le=3650)
    ] = 90

    @property
    def outputs(self) -> tuple[Path | None, ...]:
        """Files that are named for output, and the recording that is read."""
        return self.out, self.report

    def _stiffness(self, device: DeviceDescription) -> tuple[float, float]:
        """Return the stiffness of the spring, N/m, and its relative uncertainty; default: those of the device."""
        stiffness, relative = self.spring_n_per_m, self.spring_relative_std
        return (
            device.calibration_spring_n_per_m if stiffness is None else stiffness,
            device.calibration_relative_uncertainty if relative is None else relative,
        )


class StaticCalibrationPlan(CalibrationPlan):
    """A static calibration. Without ``steps`` all steps are run."""

    kind: ClassVar[Kind] = "static"

    steps: Annotated[
        tuple[str, ...],
        Option("--steps", metavar="A,B", separator=",", help="only these steps; an unknown name lists all"),
    ] = ()
    weights_kg: Annotated[
        tuple[float, ...],
        Option("--weight", metavar="GRAMS", scale=1e-3, help="a known weight; may be repeated"),
    ] = ()
    gauges_m: Annotated[
        tuple[float, ...],
        Option(
            "--gauge", metavar="MM", scale=1e-3, help="height of a gauge block, if there is no stage; three or more"
        ),
    ] = ()
    ambient_c: Annotated[float | None, Option("--ambient", metavar="DEGC", help="room temperature")] = None
    orientations: Annotated[
        int,
        Option("--orientations", metavar="N", help="2: also upside down, for the zero of the accelerometer"),
        Field(ge=1, le=2),
    ] = 1
    in_place: Annotated[
        bool, Option("--in-place", help="the spring is under the probe; skip steps that need a person")
    ] = False
    push_only: Annotated[bool, Option("--push-only", help="the probe pushes on the spring and is not fixed to it")] = (
        False
    )

    def calibration(self, device: DeviceDescription) -> StaticPlan:
        """Return steps and references for a device.

        Raises:
            UnusableInputError: an option cannot be used.
        """
        from tissueid.calibration.coil import Spring
        from tissueid.calibration.static_procedure import STEPS, StaticPlan

        if self.in_place and (self.weights_kg or self.gauges_m or self.orientations > 1):
            raise UnusableInputError(
                "calibration.in_place",
                "--in-place runs without a person: leave out --weight, --gauge and --orientations",
            )
        return StaticPlan(
            steps=self.steps or STEPS,
            spring=Spring(*self._stiffness(device)),
            weights_kg=self.weights_kg,
            gauges_m=self.gauges_m,
            ambient_c=self.ambient_c,
            turn_over=self.orientations > 1,
            in_place=self.in_place,
            push_only=self.push_only,
            repeats=self.repeats,
            valid_days=self.valid_days,
        )


class DynamicSweepPlan(CalibrationPlan):
    """A dynamic sweep with an instrument, or the analysis of the recording ``kept``."""

    kind: ClassVar[Kind] = "sweep"

    from_m: Annotated[float, Option("--from", metavar="MM", scale=1e-3, help="first position on the stroke")] = 0.002
    to_m: Annotated[float, Option("--to", metavar="MM", scale=1e-3, help="last position")] = 0.030
    step_m: Annotated[float, Option("--step", metavar="MM", scale=1e-3, help="distance between positions")] = 0.002
    seconds: Annotated[float, Option("--seconds", metavar="S", help="length of the test at each position")] = 4.0
    swing_m: Annotated[float, Option("--swing", metavar="MM", scale=1e-3, help="largest amplitude to either side")] = (
        2.5e-3
    )
    seed: Annotated[int, Option("--seed", help="seed of the noise"), Field(ge=0, le=2**31 - 1)] = 1
    spring_kg: Annotated[float, Option("--spring-mass", metavar="GRAMS", scale=1e-3, help="mass of the spring")] = 0.018
    session: Annotated[Path | None, Option("--session", metavar="FILE", help="save all recordings as a session")] = None
    kept: Annotated[
        Path | None, Option("--kept", metavar="SESSION", help="analyse a saved sweep, without a device")
    ] = None

    @property
    def outputs(self) -> tuple[Path | None, ...]:
        """Files that are named for output, and the recording that is read."""
        return self.out, self.report, self.session, self.kept

    def sweep(self) -> SweepPlan:
        """Return positions, duration and amplitude.

        Raises:
            UnusableInputError: an option cannot be used.
        """
        from tissueid.calibration.sweep import SweepPlan

        return SweepPlan(
            from_m=self.from_m,
            to_m=self.to_m,
            step_m=self.step_m,
            seconds=self.seconds,
            swing_m=self.swing_m,
            repeats=self.repeats,
            seed=self.seed,
        )

    def spring(self, device: DeviceDescription) -> SpringMass:
        """Return the calibration spring.

        Raises:
            UnusableInputError: a value is out of bounds.
        """
        from tissueid.calibration.sweep_analysis import SpringMass

        spring = SpringMass(*self._stiffness(device), self.spring_kg)
        spring.check()
        if not 0.0 <= self.spring_kg <= _MOST_SPRING_KG:
            raise UnusableInputError(
                "sweep.spring_mass", "the mass of the spring must be 0 to {limit:g} g", limit=1e3 * _MOST_SPRING_KG
            )
        return spring
