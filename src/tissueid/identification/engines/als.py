"""Adaptive least squares: a time-varying impulse response, its average, and its dependence on depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tissueid.errors import UnusableInputError
from tissueid.identification import adaptive_least_squares as adaptation
from tissueid.identification.base import Array, Family, option
from tissueid.identification.impulse_response import convolve_at_rest, memory_warnings
from tissueid.identification.online_identifier import Identifier, OnlineEngine, OnlineModel
from tissueid.identification.preparation import PreparedRecord, prepare
from tissueid.identification.registry import engine
from tissueid.identification.second_order_fit import fit_second_order
from tissueid.identification.validation import vaf_percent
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Record

_FLOOR = 0.01
"""Constant added to the denominator of a normalised step, relative to the mean energy of the input over a memory.

It reduces the step in quiet parts of the input, where the samples are mostly noise.
"""


@dataclass(frozen=True, eq=False)
class AlsModel(OnlineModel):
    """Average over time of the impulse responses (Fig. 6.3), their trajectory, and their averages by depth (Fig. 6.4b).

    ``depth_response`` (levels, lags) averages the responses for outputs between neighbours of ``depth_edges`` (levels -
    1,); ``depth_position`` (levels,) is the mean output there and ``depth_support`` (levels,) the number of samples.

    There are no standard deviations, because adaptation errors exceed the noise; use ``rls`` or ``lms`` for those.
    There is no depth profile of mass, damping and stiffness either: the response lags behind the depth by the
    adaptation time, so that responses at one depth were partly learned at others.
    """

    depth_response: Array
    depth_edges: Array
    depth_position: Array
    depth_support: Array

    def simulate_scheduled(self, record: Record) -> Array:
        """Simulate with the response of the measured depth, shape (n,); NaN where the depth is unknown."""
        self.check_rate(record)
        x = record.input - self.input_mean
        level = np.searchsorted(self.depth_edges, record.output)
        scheduled = np.full(len(record), np.nan)
        for k, response in enumerate(self.depth_response):
            there = np.isfinite(record.output) & (level == k)
            if there.any():
                scheduled[there] = convolve_at_rest(response / self.sample_rate_hz, x)[there]
        return self.output_mean + scheduled


class AlsIdentifier(Identifier):
    """State of adaptive least squares during a record; created by :meth:`Als.start`."""

    options: Als

    def __init__(
        self,
        options: Als,
        sample_rate_hz: float,
        input_std: float,
        operating_point: tuple[float | None, float | None],
        units: tuple[str, str] = ("N", "m"),
        begin: int = 0,
        depth_edges: Array | None = None,
    ) -> None:
        super().__init__(options, sample_rate_hz, operating_point, units, begin)
        self.depth_edges = np.zeros(0) if depth_edges is None else depth_edges
        if options.change_factor is None:
            step, floor = options.step, _FLOOR * self.lags * input_std**2
        else:
            step, floor = options.change_factor, -1.0
        self._work, self._scalars = adaptation.start(self.lags, step, floor, centred=None in operating_point)
        self._sums_at = np.zeros((self.depth_edges.size + 1, self.lags))
        self._counts_at = np.zeros((self.depth_edges.size + 1, 2))  # number of samples, and sum of their outputs

    def _advance(self, u: Array, y: Array, errors: Array) -> None:
        edges = self.depth_edges - self.output_mean
        adaptation.advance(self._work, self._scalars, self._sums_at, self._counts_at, edges, u, y, errors)

    @property
    def centre(self) -> float:
        """Input about which the response is estimated: the operating point, or the mean of all inputs if none was
        given.
        """
        return self.input_mean + float(self._scalars[adaptation.INPUT_MEAN])

    def _response(self) -> Array:
        return np.asarray(self._work[adaptation.RESPONSE])

    @property
    def average_response(self) -> Array:
        """Average of the responses after each update, (lags,), in the unit of the impulse response."""
        samples = max(1.0, float(self._counts_at[:, 0].sum()))
        return np.asarray(self._sums_at.sum(axis=0) / samples * self.sample_rate_hz)

    @property
    def updates(self) -> int:
        """Number of samples used for updates."""
        return int(self._scalars[adaptation.UPDATES])

    @property
    def warning(self) -> str | None:
        """Warning after the response diverged; it is then reset and adaptation stops. None before."""
        update = int(self._scalars[adaptation.DIVERGED])
        if update == 0:
            return None
        factor = self.options.change_factor
        return Message(
            "als.diverged",
            "unstable ALS step: with {which} = {step:g} the response diverged after {seconds:.3g} s and was reset; "
            "use a "
            "tenth of that",
            which="step" if factor is None else "change_factor",
            step=self.options.step if factor is None else factor,
            seconds=update / self.sample_rate_hz,
        )

    def by_depth(self) -> tuple[Array, Array, Array]:
        """Return responses (levels, lags), mean outputs (levels,) and numbers of samples (levels,)."""
        counts = self._counts_at[:, 0]
        there = np.maximum(counts, 1.0)
        responses = self._sums_at / there[:, None] * self.sample_rate_hz
        responses[counts == 0.0] = self.average_response
        return responses, self.output_mean + self._counts_at[:, 1] / there, counts.copy()


@engine
class Als(OnlineEngine):
    """ALS engine.

    At each sample the response is moved along the regressor by a share of the error. ``step`` is that share,
    dimensionless: 1 removes the whole error, and from 2 on the adaptation is unstable. ``change_factor`` is the
    unnormalised step of the thesis, in one over the squared unit of the input; it is unstable above about 2 / (lags x
    input power). Simulations use the average response. ``vaf_tracking_percent`` scores predictions by the present
    response, which are not a free run.
    """

    name: ClassVar[str] = "als"
    label: ClassVar[str] = "ALS"
    title: ClassVar[str] = marked("Adaptive least-squares finite impulse response (Chen 2010, Eqs. 6.6-6.8).")
    family: ClassVar[Family] = Family.LINEAR
    identifier: ClassVar[type[AlsIdentifier]] = AlsIdentifier

    step: float = option(
        0.2, marked("Step"), marked("Share of the error that one sample corrects; unstable above 2"), gt=0.0, lt=2.0
    )
    change_factor: float | None = option(
        None,
        marked("Change factor"),
        marked("Change factor of Eq. 6.8, in one over the input's unit squared; replaces the step"),
        gt=0.0,
        le=1e12,
    )
    levels: int = option(
        8,
        marked("Levels"),
        marked("Number of depth ranges, with equal counts of samples, for which responses are averaged"),
        ge=1,
        le=50,
    )

    def fit(self, record: Record, fit_part: slice | None = None) -> AlsModel:
        """Run the adaptation over a record, or over a contiguous part of it.

        Raises:
            UnusableInputError: nothing varies, too few samples, a memory longer than the part, or an unstable step.
        """
        prepared = prepare(record, fit_part, self.memory_s)
        self._check_step(prepared)
        outputs = record.output[prepared.used]
        edges = np.unique(np.quantile(outputs, np.linspace(0.0, 1.0, self.levels + 1)[1:-1]))
        identifier: AlsIdentifier = self.run(prepared, depth_edges=edges)
        if identifier.warning is not None:
            raise UnusableInputError(identifier.warning)
        return self.model_of(identifier, prepared)

    def model_of(self, identifier: AlsIdentifier, prepared: PreparedRecord) -> AlsModel:
        """Return the model of an identifier, scored on a prepared record."""
        record, used = prepared.record, prepared.used
        lags, rate = identifier.lags, identifier.sample_rate_hz
        kernel = identifier.average_response / rate
        modelled = convolve_at_rest(kernel, record.input - identifier.centre)
        offset = float(np.mean(record.output[used] - modelled[used]))
        second_order = fit_second_order(record, used, self.hold)
        trajectory, trajectory_s, trajectory_position = identifier.trajectory
        depth_response, depth_position, depth_support = identifier.by_depth()
        unstable = () if identifier.warning is None else (identifier.warning,)
        model = AlsModel(
            report=self.report(
                record,
                used,
                modelled,
                lags + 1,
                offset=offset,
                parameters=second_order.parameters,
                warnings=(*prepared.warnings, *unstable, *memory_warnings(kernel), *second_order.warnings),
                details={
                    "vaf_tracking_percent": identifier.tracking_vaf_percent,
                    "n_parameters_tracking": float(lags * identifier.updates),
                    "vaf_parametric_percent": second_order.vaf_percent,
                },
            ),
            sample_rate_hz=rate,
            memory_samples=lags,
            impulse_response=kernel * rate,
            lag_s=identifier.lag_s,
            input_mean=identifier.centre,
            output_mean=offset,
            trajectory=trajectory,
            trajectory_s=trajectory_s,
            trajectory_position=trajectory_position,
            second_order=second_order,
            depth_response=depth_response,
            depth_edges=identifier.depth_edges,
            depth_position=depth_position,
            depth_support=depth_support,
        )
        scheduled = model.simulate_scheduled(record)[used]
        return model.with_report(vaf_scheduled_percent=vaf_percent(record.output[used], scheduled))

    def _check_step(self, prepared: PreparedRecord) -> None:
        """Raise for a change factor that is unstable for the input of the fitted part.

        Raises:
            UnusableInputError: the factor is at least 2 / (lags x input power), where the mean square correction
                exceeds twice the error.
        """
        power = float(np.nanvar(prepared.record.input[prepared.part]))
        bound = 2.0 / (prepared.memory_samples * power)
        if self.change_factor is not None and self.change_factor >= bound:
            raise UnusableInputError(
                "als.unstable_factor",
                "unstable ALS step: the change factor {factor:g} is above 2 / (lags x input power) = "
                "{bound:.3g}; use a tenth of that, or the normalised step",
                factor=self.change_factor,
                bound=bound,
            )
