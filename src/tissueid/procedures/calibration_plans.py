"""Plans of the static calibration and of the dynamic sweep."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

from tissueid.calibration.plans import Spring, StaticPlan, SweepPlan
from tissueid.errors import UnusableInputError
from tissueid.plan_options import Option, Plan

if TYPE_CHECKING:
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


class StaticCalibrationPlan(StaticPlan, CalibrationPlan):
    """A static calibration and its files. Without ``steps`` all steps are run."""

    kind: ClassVar[Kind] = "static"

    def on(self, device: DeviceDescription) -> Self:
        """Return the plan with the calibration spring of a device, where no other is given.

        Raises:
            UnusableInputError: the spring is not usable for calibration.
        """
        spring = Spring(*self._stiffness(device))
        spring.check()
        return self.model_copy(update={"spring": spring})


class DynamicSweepPlan(SweepPlan, CalibrationPlan):
    """A dynamic sweep with an instrument, or the analysis of the recording ``kept``."""

    kind: ClassVar[Kind] = "sweep"

    spring_kg: Annotated[float, Option("--spring-mass", metavar="GRAMS", scale=1e-3, help="mass of the spring")] = 0.018
    session: Annotated[Path | None, Option("--session", metavar="FILE", help="save all recordings as a session")] = None
    kept: Annotated[
        Path | None, Option("--kept", metavar="SESSION", help="analyse a saved sweep, without a device")
    ] = None

    @property
    def outputs(self) -> tuple[Path | None, ...]:
        """Files that are named for output, and the recording that is read."""
        return self.out, self.report, self.session, self.kept

    def spring_of(self, device: DeviceDescription) -> SpringMass:
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
