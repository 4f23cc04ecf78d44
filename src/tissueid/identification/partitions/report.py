"""Report of a partitioned fit: profile, named parameters, figures, findings and warnings."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from tissueid.formatting import number
from tissueid.identification.base import Array, Mask
from tissueid.identification.depth_profile import DepthProfile
from tissueid.identification.partitions.cells import Cells, Partitions
from tissueid.identification.partitions.estimation import LocalEstimates
from tissueid.identification.partitions.model import PartitionedModel
from tissueid.identification.partitions.parameters import LocalParameters, means_and_slopes, profile
from tissueid.identification.partitions.regression import PartitionedKernels
from tissueid.identification.partitions.simulated_tissue import Contrast
from tissueid.identification.preparation import SAMPLES_PER_PARAMETER
from tissueid.identification.second_order_fit import SecondOrderFit
from tissueid.identification.validation import vaf_percent
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Estimate, Record

_SIGNIFICANT = 2.6
"""Standard deviations beyond which a change with depth or direction is significant (99 % of a normal variable)."""

_LARGE_LOSS_POINTS = 5.0
"""Difference of scheduled and free-run VAF, percentage points, above which a warning is given."""

_SHARES = {"mass_kg": "mass", "damping_n_s_per_m": "damping", "stiffness_n_per_m": "stiffness"}


def by_direction(local: LocalEstimates, way: int) -> LocalParameters:
    """Return the local parameters of inward (1) or outward (-1) motion; the mass is the same."""
    if local.contrast is None:
        return local.local
    share = np.clip(way * local.contrast.share, -0.95, None)  # (K, 2)
    more = local.contrast.root.shape[2]
    logs, root = local.local.log_parameters.copy(), np.pad(local.local.root, ((0, 0), (0, 0), (0, more)))
    logs[:, 1:] += np.log1p(share)
    root[:, 1:, -more:] = (way / (1.0 + share))[:, :, None] * local.contrast.root
    return replace(local.local, log_parameters=logs, root=root)


def profile_of(local: LocalEstimates, partitions: Partitions, cells: Cells, used: Mask) -> DepthProfile:
    """Return one row for each cell; with directions, rows of inward and then of outward motion."""
    support = np.bincount(cells[used], minlength=partitions.count)
    if not local.certain:
        local = replace(local, local=replace(local.local, root=np.full_like(local.local.root, np.nan)))
    if not partitions.directional or local.local.position.size == partitions.count:
        return profile(local.local, partitions, support)
    ways = [by_direction(local, way) for way in (1, -1)]
    both = LocalParameters(
        position=np.concatenate([way.position for way in ways]),
        log_parameters=np.concatenate([way.log_parameters for way in ways]),
        root=np.concatenate([way.root for way in ways]),
        sign=local.local.sign,
    )
    return profile(both, partitions, support)


def named_parameters(
    local: LocalEstimates, partitions: Partitions, position: float, linear: SecondOrderFit
) -> dict[str, Estimate]:
    """Return mass, damping and stiffness at a position, m, and their slopes; a gain for other signals."""
    if not linear.mechanical:
        return linear.parameters
    found = means_and_slopes(local.local, position)
    if local.contrast is not None:
        for way, word in ((1, "in"), (-1, "out")):
            there = means_and_slopes(by_direction(local, way), position)
            for name, unit in (("damping", "n_s_per_m"), ("stiffness", "n_per_m")):
                found[f"{name}_{word}_{unit}"] = there.get(f"{name}_{unit}", Estimate(math.nan))
    if not local.certain:
        found = {name: Estimate(estimate.value) for name, estimate in found.items()}
    missing = {name: linear.parameters[name] for name in _SHARES if name not in found}
    return found | missing


def details_of(
    model: PartitionedModel, record: Record, scored: Mask, scheduled: Array, solved: PartitionedKernels
) -> dict[str, float]:
    """Return figures beyond the common ones.

    ``vaf_of_place_percent`` is the VAF of the mean output of each partition, without any input: a baseline of the
    scheduled VAF.
    """
    y = record.output[scored]
    cells = model.partitions.cells(record.output)[scored]
    means = np.bincount(cells, weights=y, minlength=model.partitions.count).astype(np.float64)
    means /= np.maximum(np.bincount(cells, minlength=model.partitions.count), 1)
    return {
        "vaf_scheduled_fitted_percent": vaf_percent(y, scheduled[scored]),
        "vaf_of_place_percent": vaf_percent(y, means[cells]),
        "condition_number": solved.condition,
        "partitions": float(model.partitions.count),
        "lags": float(model.lag_s.size),
        "lag_spacing": float(model.lag_spacing),
    }


def fit_warnings(vaf: float, details: dict[str, float], local: LocalEstimates, few: bool) -> tuple[str, ...]:
    """Return warnings on the fit."""
    found = list(local.warnings)
    if few:
        found.append(
            Message(
                "partitions.few_samples",
                "fewer than {fewest} usable samples for each parameter: record longer, or take fewer partitions",
                fewest=SAMPLES_PER_PARAMETER,
            )
        )
    lost = details["vaf_scheduled_fitted_percent"] - vaf
    if lost > _LARGE_LOSS_POINTS:
        found.append(
            Message(
                "partitions.needs_measured_depth",
                "in free run the model loses {points:.1f} points of VAF: the score with the measured output as the "
                "schedule depends on the measured depth",
                points=lost,
            )
        )
    missing = int(np.count_nonzero(~local.local.known))
    if missing:
        found.append(
            Message(
                "partitions.not_second_order",
                "{missing} of {kernels} kernels are not those of a second-order system",
                missing=missing,
                kernels=int(local.local.known.size),
            )
        )
    return tuple(found)


def findings(local: LocalEstimates, partitions: Partitions, linear: SecondOrderFit) -> tuple[str, ...]:
    """Return how stiffness, damping and mass change with depth, and whether damping depends on the direction.

    Nothing is stated where the standard deviations do not hold.
    """
    if not linear.mechanical or np.count_nonzero(local.local.known) < 2 or not local.certain:
        return ()
    known = np.flatnonzero(local.local.known)
    first, last = known[np.argmin(local.local.position[known])], known[np.argmax(local.local.position[known])]
    found: list[str] = []
    for index, name, unit in (
        (2, marked("stiffness"), "N/m"),
        (1, marked("damping"), "N·s/m"),
        (0, marked("mass"), "g"),
    ):
        values = np.exp(local.local.log_parameters[:, index]) * (1e3 if unit == "g" else 1.0)
        change = float(np.log(values[last] / values[first]))
        spread = float(np.linalg.norm(local.local.root[last, index] - local.local.root[first, index]))
        place = {"low": 1e3 * local.local.position[first], "high": 1e3 * local.local.position[last]}
        ends = {"start": number(values[first], 3), "end": number(values[last], 3), "unit": unit}
        if abs(change) <= _SIGNIFICANT * spread:
            found.append(
                Message(
                    "depth.constant",
                    "{name} does not change beyond its uncertainty from {low:.2f} to {high:.2f} mm",
                    name=name,
                    **place,
                )
            )
        elif change > 0.0:
            found.append(
                Message(
                    "depth.rises",
                    "{name} rises from {start} to {end} {unit} from {low:.2f} to {high:.2f} mm",
                    name=name,
                    **ends,
                    **place,
                )
            )
        else:
            found.append(
                Message(
                    "depth.falls",
                    "{name} falls from {start} to {end} {unit} from {low:.2f} to {high:.2f} mm",
                    name=name,
                    **ends,
                    **place,
                )
            )
    if local.contrast is not None:
        found += [_direction_finding(local.contrast, kind) for kind in (1, 0)]
    return tuple(found)


def _direction_finding(contrast: Contrast, kind: int) -> Message:
    """Return whether damping (0) or stiffness (1) depends on the direction, by its weighted mean over the cells."""
    spread = np.linalg.norm(contrast.root[:, kind], axis=1)
    weight = 1.0 / np.maximum(spread, 1e-12) ** 2
    share = float(np.sum(weight * contrast.share[:, kind]) / np.sum(weight))
    std = float(np.linalg.norm(weight @ contrast.root[:, kind]) / np.sum(weight))
    name, prefix = (marked("stiffness"), "stiffness_") if kind else (marked("damping"), "")
    values = {"name": name, "percent": 100.0 * abs(share), "std": 100.0 * std}
    if abs(share) <= _SIGNIFICANT * std:
        return Message(
            f"direction.{prefix}none",
            "{name} does not depend on the direction beyond its uncertainty ({percent:.1f} ± {std:.1f} %)",
            **values | {"percent": 100.0 * share},
        )
    if share > 0.0:
        return Message(
            f"direction.{prefix}larger_inward",
            "{name} is larger in inward than in outward motion: {percent:.1f} ± {std:.1f} % above and below their mean",
            **values,
        )
    return Message(
        f"direction.{prefix}larger_outward",
        "{name} is larger in outward than in inward motion: {percent:.1f} ± {std:.1f} % above and below their mean",
        **values,
    )
