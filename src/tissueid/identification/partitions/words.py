"""What a partitioned fit reports: profile, named parameters, figures, findings and doubts."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from tissueid.identification.base import Array, Mask
from tissueid.identification.depth_profile import DepthProfile
from tissueid.identification.partitions.cells import Cells, Partitions
from tissueid.identification.partitions.estimation import LocalEstimates
from tissueid.identification.partitions.model import PartitionedModel
from tissueid.identification.partitions.parameters import LocalParameters, means_and_slopes, profile
from tissueid.identification.partitions.regression import PartitionedKernels
from tissueid.identification.partitions.tissue import Contrast
from tissueid.identification.second_order_fit import SecondOrderFit
from tissueid.identification.validation import vaf_percent
from tissueid.records import Estimate, Record
from tissueid.wording import number

_SIGNIFICANT = 2.6
"""Standard deviations (99 % of a normal variable) beyond which a change with depth or direction is called one."""

_LEANS = 5.0
"""Percentage points by which the scheduled VAF may exceed the free run's before it is told."""

_SHARES = {"mass_kg": "mass", "damping_n_s_per_m": "damping", "stiffness_n_per_m": "stiffness"}


def by_direction(local: LocalEstimates, way: int) -> LocalParameters:
    """The local parameters on the way in (1) or out (-1): the damping's alone differ."""
    if local.contrast is None:
        return local.local
    share = np.clip(way * local.contrast.share, -0.95, None)
    more = local.contrast.root.shape[1]
    logs, root = local.local.log_parameters.copy(), np.pad(local.local.root, ((0, 0), (0, 0), (0, more)))
    logs[:, 1] += np.log1p(share)
    root[:, 1, -more:] = (way / (1.0 + share))[:, None] * local.contrast.root
    return replace(local.local, log_parameters=logs, root=root)


def profile_of(local: LocalEstimates, partitions: Partitions, cells: Cells, used: Mask) -> DepthProfile:
    """One row for each cell; with directions, rows of the way in and then of the way out."""
    support = np.bincount(cells[used], minlength=partitions.count)
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
    """Mass, damping and stiffness at a position (m), and their slopes; what is not force and position as a gain."""
    if not linear.mechanical:
        return linear.parameters
    found = means_and_slopes(local.local, position)
    if local.contrast is not None:
        for way, word in ((1, "in"), (-1, "out")):
            name = "damping_n_s_per_m"
            found[f"damping_{word}_n_s_per_m"] = means_and_slopes(by_direction(local, way), position).get(
                name, Estimate(math.nan)
            )
    missing = {name: linear.parameters[name] for name in _SHARES if name not in found}
    return found | missing


def details_of(
    model: PartitionedModel, record: Record, scored: Mask, scheduled: Array, solved: PartitionedKernels
) -> dict[str, float]:
    """Figures beyond the common ones.

    ``vaf_of_place_percent`` is what the partition of the sample alone accounts for, without any input: the scheduled
    VAF has that to stand on.
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


def doubts(vaf: float, details: dict[str, float], local: LocalEstimates, few: bool) -> tuple[str, ...]:
    """What a reader should know before trusting the answer."""
    told = list(local.warnings)
    if few:
        told.append("fewer than 3 usable samples for each parameter: record longer, or take fewer partitions")
    lost = details["vaf_scheduled_fitted_percent"] - vaf
    if lost > _LEANS:
        told.append(
            f"driven by its own depth the model loses {lost:.1f} points of VAF: the scheduled figure leans on the "
            "measured depth"
        )
    missing = int(np.count_nonzero(~local.local.known))
    if missing:
        told.append(f"{missing} of {local.local.known.size} kernels are not those of a second-order system")
    return tuple(told)


def found_words(local: LocalEstimates, partitions: Partitions, linear: SecondOrderFit) -> tuple[str, ...]:
    """What was found, in words: how stiffness and damping go with depth, and whether directions differ."""
    if not linear.mechanical or np.count_nonzero(local.local.known) < 2:
        return ()
    known = np.flatnonzero(local.local.known)
    first, last = known[np.argmin(local.local.position[known])], known[np.argmax(local.local.position[known])]
    words = []
    for index, name, unit in ((2, "stiffness", "N/m"), (1, "damping", "N·s/m"), (0, "mass", "g")):
        values = np.exp(local.local.log_parameters[:, index]) * (1e3 if unit == "g" else 1.0)
        change = float(np.log(values[last] / values[first]))
        spread = float(np.linalg.norm(local.local.root[last, index] - local.local.root[first, index]))
        where = f"from {1e3 * local.local.position[first]:.2f} to {1e3 * local.local.position[last]:.2f} mm"
        if abs(change) > _SIGNIFICANT * spread:
            going = "rises" if change > 0.0 else "falls"
            words.append(f"{name} {going} from {number(values[first], 3)} to {number(values[last], 3)} {unit} {where}")
        else:
            words.append(f"{name} does not change beyond its uncertainty {where}")
    if local.contrast is not None:
        words.append(_direction_words(local.contrast))
    return tuple(words)


def _direction_words(contrast: Contrast) -> str:
    spread = np.linalg.norm(contrast.root, axis=1)
    weight = 1.0 / np.maximum(spread, 1e-12) ** 2
    share = float(np.sum(weight * contrast.share) / np.sum(weight))
    std = float(np.linalg.norm(weight @ contrast.root) / np.sum(weight))
    if abs(share) <= _SIGNIFICANT * std:
        return (
            f"damping does not depend on the direction beyond its uncertainty ({100 * share:+.1f} ± {100 * std:.1f} %)"
        )
    larger, smaller = ("in", "out") if share > 0.0 else ("out", "in")
    return (
        f"damping is larger on the way {larger} than on the way {smaller}: {100 * abs(share):.0f} ± {100 * std:.0f} % "
        "above and below their mean"
    )
