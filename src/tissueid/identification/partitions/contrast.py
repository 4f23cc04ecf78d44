"""Damping that differs between the way in and the way out.

The kernels of Eq. 5.3 do not tell a damping from a stiffness that depends on the direction: a push given on the way in
is still felt on the way out, so each kernel mixes both ways. A damping that is 30 % larger on the way in and 30 %
smaller on the way out shows as one that differs by a tenth to a quarter, and as a stiffness that does too. So the
difference is found from the record itself: by the error of the simulated tissue, whose curves are adjusted with it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tissueid.identification.base import Array, Mask
from tissueid.identification.dependence import dependence_samples, long_run_covariance
from tissueid.identification.partitions.tissue import Contrast, SimulatedTissue

_ITERATIONS = 15
_SETTLED = 1e-3
_PROBE = 1e-3
_LONGEST_STEP = 0.3


def fit_contrast(tissue: SimulatedTissue, log_parameters: Array, used: Mask) -> Contrast | None:
    """Contrast of the damping, on a line of depth, by the simulation error at the samples of a mask (n,).

    The curves of mass, damping and stiffness are fitted with it, from ``log_parameters`` (K, 3) on, and are then
    forgotten; a level of the output is free. Its covariance is the sandwich of a misspecified fit with dependent
    residuals (White 1982; Newey and West 1987). None when the tissue cannot be simulated or the search does not settle.
    """
    lines, record = tissue.lines, tissue.prepared.record
    start = lines.coefficients(log_parameters)  # (degree + 1, 3)
    logs, turns = start.size, lines.basis.shape[1]

    def simulated(theta: Array) -> Array | None:
        share = np.clip(lines.basis @ theta[logs:], -1.0, 1.0)
        run = tissue.output(theta[:logs].reshape(start.shape), Contrast(share, np.zeros((share.size, 0))))
        return None if run is None else run[used]

    measured = record.output[used]
    theta = np.concatenate([start.ravel(), np.zeros(turns)])
    run = simulated(theta)
    for _ in range(_ITERATIONS):
        if run is None:
            return None
        error = measured - run
        slopes = _slopes(simulated, theta, run)
        if slopes is None:
            return None
        step = np.linalg.lstsq(slopes, error - error.mean(), rcond=1e-8)[0]
        step /= max(1.0, float(np.max(np.abs(step))) / _LONGEST_STEP)
        bound = float(np.var(error)) * (1.0 + 1e-9)
        while np.max(np.abs(step)) > 0.1 * _SETTLED:
            tried = simulated(theta + step)
            if tried is not None and float(np.var(measured - tried)) <= bound:
                theta, run = theta + step, tried
                break
            step = 0.5 * step
        if np.max(np.abs(step)) < _SETTLED:
            return _contrast(tissue, theta, logs, slopes, measured - run)
    return None


def _slopes(simulated: Callable[[Array], Array | None], theta: Array, run: Array) -> Array | None:
    """Derivatives (rows, p) of a simulation (rows,), their means removed; None where one cannot be had."""
    columns = []
    for unit in np.eye(theta.size):
        moved = simulated(theta + _PROBE * unit)
        if moved is None:
            return None
        columns.append((moved - run) / _PROBE)
    slopes = np.array(columns).T
    return np.asarray(slopes - slopes.mean(axis=0), dtype=np.float64)


def _contrast(tissue: SimulatedTissue, theta: Array, logs: int, slopes: Array, error: Array) -> Contrast:
    lines = tissue.lines
    error = error - error.mean()
    influence = np.linalg.pinv(slopes)[logs:].T * error[:, None]  # (rows, lines)
    block = dependence_samples(error, tissue.prepared.record.sample_rate_hz)
    covariance = long_run_covariance(influence, block) * error.size / (error.size - theta.size)
    values, vectors = np.linalg.eigh(covariance)
    return Contrast(lines.basis @ theta[logs:], lines.basis @ (vectors * np.sqrt(np.maximum(values, 0.0))))
