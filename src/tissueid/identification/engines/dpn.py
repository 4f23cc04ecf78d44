"""Dynamic parameter nonlinearity: mass, damping and stiffness that depend on depth, fitted by simulation error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal, Self

import numpy as np

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Engine, Family, Model, option
from tissueid.identification.depth_profile import DepthProfile
from tissueid.identification.dpn.curves import LogCurves
from tissueid.identification.dpn.fit import DpnData, EstimatedCurves, FittedDpn, coefficient_covariance
from tissueid.identification.dpn.selection import (
    curve_warnings,
    dpn_parameters,
    findings,
    score_gains,
    select_degrees,
    settling_samples,
)
from tissueid.identification.dpn.simulation import FreeRun, simulate_dpn
from tissueid.identification.preparation import (
    SAMPLES_PER_PARAMETER,
    PreparedRecord,
    complete_after_rest,
    prepare,
    scored_samples,
    typical_samples,
)
from tissueid.identification.registry import engine
from tissueid.identification.second_order import HOLD, Hold
from tissueid.identification.second_order_fit import fit_second_order, hold_of
from tissueid.language import marked
from tissueid.messages import Message, code_of
from tissueid.records import Record

_MEMORY_S = 0.125
"""Shortest record that is fitted if no memory is given, s."""

_LEAST_PARAMETERS = 7
"""Parameters of the simplest fit: level of the force, and a constant and a growth of each curve."""

_LONGEST_SHARE = 0.25
"""Share of the record after which initial conditions must have decayed; otherwise a warning is given."""

_DIRECTION_SPEED_SHARE = 0.1
"""Speed over which the damping changes between directions, relative to the typical speed."""

_LARGEST_DAMPING = 4.0
"""Largest initial damping, relative to mass over sample period."""


@dataclass(frozen=True, eq=False)
class DpnModel(Model):
    """M(y) y'' + B(y) y' + F(y) = u, with F the integral of the tangent stiffness K(y).

    ``estimated`` holds the curves with their bands, such as ``model.estimated.stiffness(position)``. ``degrees`` is the
    selected degree of each free series, before spare degrees; -1 for a series that is left out. ``rest_position`` is
    the equilibrium under the mean input of the fit, where a simulation starts.
    """

    estimated: EstimatedCurves
    degrees: dict[str, int]
    input_mean: float
    rest_position: float
    hold: Hold
    surface_position_m: float | None
    mechanical: bool

    def free_run(self, u: Array) -> FreeRun:
        """Return position and speed for an input u (n,); each uninterrupted run starts at rest under the mean input of
        the fit.

        The result includes whether and where the motion diverged. Samples whose memory contains a gap are not masked.
        """
        return simulate_dpn(
            self.estimated.curves.tables, u, self.sample_rate_hz, rest_input=self.input_mean, hold=self.hold
        )

    def simulate(self, u: Array) -> Array:
        """Simulate in free run: input (n,), output (n,), at rest at the mean input before the first sample.

        A motion that diverges stays at the bound that it reached; :meth:`free_run` returns the sample.
        """
        u = np.asarray(u, dtype=np.float64)
        position = self.free_run(u).position
        position[~complete_after_rest(np.isfinite(u), self.memory_samples)] = np.nan
        return position

    def depth_profile(self) -> DepthProfile | None:
        """Return the profile over the central 98 % of the visited positions; None unless the units are N and m."""
        return self.estimated.profile() if self.mechanical else None


_SWITCHES = (marked("auto"), marked("on"), marked("off"))
"""Choices of the options as a form shows them, for translation."""


@engine
class Dpn(Engine):
    """DPN engine.

    Assumes that position and speed are the whole state: no relaxation, no creep, no history. The logarithms of the
    curves are Legendre series of the position; degrees that are not given are selected from the record.
    """

    name: ClassVar[str] = "dpn"
    label: ClassVar[str] = "DPN"
    title: ClassVar[str] = marked(
        "Mass, damping and stiffness as functions of depth (Chen 2010, Eq. 3.33), by the free run's error."
    )
    family: ClassVar[Family] = Family.PARAMETRIC

    memory: float | None = option(
        None,
        marked("Memory"),
        marked("Duration of initial conditions, s; from the slower time constant if not given"),
        gt=0.0,
        le=1e7,
    )
    mass_degree: int | None = option(
        None,
        marked("Degree of mass"),
        marked("Degree of log M(y): 0 constant, 1 exponential; selected if not given"),
        ge=0,
        le=12,
    )
    damping_degree: int | None = option(
        None,
        marked("Degree of damping"),
        marked("Degree of log B(y): 0 constant, 1 exponential; selected if not given"),
        ge=0,
        le=12,
    )
    stiffness_degree: int | None = option(
        None,
        marked("Degree of stiffness"),
        marked("Degree of log dF/dy: 0 constant, 1 exponential; selected if not given"),
        ge=0,
        le=12,
    )
    max_degree: int = option(6, marked("Largest degree"), marked("Largest degree that is selected"), ge=0, le=12)
    spare_degree: int = option(
        2,
        marked("Spare degree"),
        marked("Degrees above the selected ones, so that the confidence bands include changes below the noise"),
        ge=0,
        le=3,
    )
    direction: Literal["auto", "on", "off"] = option(
        "auto", marked("Direction"), marked("Different damping of inward and outward motion")
    )
    inertia: Literal["auto", "on", "off"] = option(
        "auto", marked("Inertia"), marked("Term with the squared speed where the mass changes; Eq. 3.33 has none")
    )
    surface_position_m: float | None = option(
        None,
        marked("Surface"),
        marked("Position of the tissue surface, m; if given, the stiffness of Eq. 3.33 is also reported"),
        ge=-1.0,
        le=1.0,
    )
    hold: Hold = HOLD

    def for_record(self, record: Record, fit_part: slice | None) -> Self:
        """Return the specification with the hold that the record shows."""
        return self if self.hold != "auto" else self.model_copy(update={"hold": hold_of(record, fit_part)})

    def fit(self, record: Record, fit_part: slice | None = None) -> DpnModel:
        """Fit the curves to a record, or to a contiguous part of it.

        Raises:
            UnusableInputError: nothing varies, too few samples, a memory longer than the part, or an output that
                decreases with increasing input.
        """
        rate = record.sample_rate_hz
        prepared = prepare(record, fit_part, self.memory or typical_samples(_MEMORY_S, rate) / rate, _LEAST_PARAMETERS)
        data = DpnData(record, prepared.part, self.hold)
        if data.samples.size < _LEAST_PARAMETERS:
            raise UnusableInputError(
                "dpn.no_stretch", "the record has no stretch without gaps that is long enough to simulate"
            )
        start, late = _constant_curves(prepared, self.hold)
        degrees, free, off = self._series()
        most = min(self.max_degree, int(data.samples.size) // (4 * SAMPLES_PER_PARAMETER))
        selected = select_degrees(data, start, degrees, free, most, self.spare_degree)
        if selected is None:
            raise UnusableInputError(
                "dpn.diverged_at_once", "not even constant mass, damping and stiffness can be simulated: use lms"
            )
        fitted, selected_degrees = selected
        estimated = EstimatedCurves(
            fitted.curves,
            coefficient_covariance(data, fitted),
            record.output[data.samples],
            data.speeds(fitted),
        )
        gains = score_gains(data, fitted, {name: 1 for name in off if name != "inertia" or fitted.curves.mass.size > 1})
        model = self._model(
            prepared, fitted, selected_degrees, estimated, {name: gain for (name, _), gain in gains.items()}
        )
        return model.with_report(warnings=(*model.report.warnings, *late))

    def _series(self) -> tuple[dict[str, int], list[str], list[str]]:
        """Return the given degrees, the free series, and the terms that are switched off."""
        given = {"mass": self.mass_degree, "damping": self.damping_degree, "stiffness": self.stiffness_degree}
        switched = {"direction": self.direction, "inertia": self.inertia}
        degrees = {name: degree for name, degree in given.items() if degree is not None}
        degrees |= {name: 0 for name, switch in switched.items() if switch == "on"}
        free = [name for name, degree in given.items() if degree is None]
        free += [name for name, switch in switched.items() if switch == "auto"]
        return degrees, free, [name for name, switch in switched.items() if switch == "off"]

    def _model(
        self,
        prepared: PreparedRecord,
        fitted: FittedDpn,
        degrees: dict[str, int],
        estimated: EstimatedCurves,
        gains: dict[str, tuple[float, float]],
    ) -> DpnModel:
        record = prepared.record
        rate = record.sample_rate_hz
        mechanical = (record.input_unit, record.output_unit) == ("N", "m")
        warnings = [*prepared.warnings, *curve_warnings(estimated)]
        length = prepared.part.stop - prepared.part.start
        memory = prepared.memory_samples if self.memory is not None else settling_samples(estimated, rate)
        if memory > _LONGEST_SHARE * length:
            warnings.append(
                Message(
                    "dpn.short",
                    "initial conditions last for {settling:.2g} s of the fitted {seconds:.2g} s: record longer",
                    settling=memory / rate,
                    seconds=length / rate,
                )
            )
            if self.memory is None:
                memory = max(1, int(_LONGEST_SHARE * length))
        used = scored_samples(record, memory, prepared.part)
        run = simulate_dpn(fitted.curves.tables, record.input, rate, rest_input=prepared.input_mean, hold=self.hold)
        if run.diverged_at is not None:
            warnings.append(
                Message(
                    "dpn.diverged",
                    "the free run diverged {seconds:.3g} s after the start of the record: do not use the curves",
                    seconds=run.diverged_at / rate,
                )
            )
        p = int(fitted.curves.theta.size)
        if used.sum() < SAMPLES_PER_PARAMETER * p and "record.few_samples" not in map(code_of, warnings):
            warnings.append(
                Message(
                    "record.few_samples",
                    "{count} usable samples for {parameters} parameters are fewer than {fewest} for each: record "
                    "longer, or shorten the memory",
                    count=int(used.sum()),
                    parameters=p,
                    fewest=SAMPLES_PER_PARAMETER,
                )
            )
        return DpnModel(
            report=self.report(
                record,
                used,
                run.position,
                p,
                parameters=dpn_parameters(estimated, self.surface_position_m, mechanical),
                warnings=tuple(warnings),
                findings=tuple(findings(estimated, gains)) if mechanical else (),
                details={
                    f"{name}_degree": float(getattr(fitted.curves, name).size - 1)
                    for name in ("mass", "damping", "stiffness", "direction", "inertia")
                }
                | {
                    "fitted_samples": float(fitted.evaluation.error.size),
                    "steps_per_sample": float(fitted.curves.tables.steps(rate)),
                    "memory_s": memory / rate,
                },
            ),
            sample_rate_hz=rate,
            memory_samples=memory,
            estimated=estimated,
            degrees=degrees,
            input_mean=prepared.input_mean,
            rest_position=fitted.curves.tables.rest(prepared.input_mean),
            hold=self.hold,
            surface_position_m=self.surface_position_m,
            mechanical=mechanical,
        )


def _constant_curves(prepared: PreparedRecord, hold: Hold) -> tuple[LogCurves, tuple[str, ...]]:
    """Return the linear second-order system of the record as curves that do not depend on depth, and warnings.

    Raises:
        UnusableInputError: the output decreases with increasing input.
    """
    record = prepared.record
    linear = fit_second_order(record, prepared.used, hold)
    if linear.sign < 0.0:
        raise UnusableInputError(
            "dpn.falling",
            "the output ({output}) falls as the input ({input}) rises: reverse the sign of one of them",
            output=record.output_name,
            input=record.input_name,
        )
    output = record.output[prepared.part]
    received = output[np.isfinite(output)]
    low, high = float(received.min()), float(received.max())
    system = linear.system
    damping = abs(system.damping)
    mass = max(system.mass, damping / (_LARGEST_DAMPING * record.sample_rate_hz))
    speed = float(np.nanstd(np.diff(output))) * record.sample_rate_hz
    middle = 0.5 * (low + high)
    curves = LogCurves(
        low=low,
        high=high,
        mass=np.log([mass]),
        damping=np.log([damping]),
        stiffness=np.log([system.stiffness]),
        level=prepared.input_mean + system.stiffness * (middle - prepared.output_mean),
        direction=np.zeros(0),
        speed_scale=_DIRECTION_SPEED_SHARE * speed,
        inertia=np.zeros(0),
    )
    return curves, linear.left_out
