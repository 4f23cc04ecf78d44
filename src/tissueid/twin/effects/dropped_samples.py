"""Undetected loss of samples: everything recorded after a loss is shifted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from tissueid.twin.effect import ActsOn, Effect, FloatArray, Parameter, Readings

IntArray = NDArray[np.int64]

MAX_LOST = 200
"""Most lost samples that are searched for."""
JUMP_COST = 20.0
"""Minimum gain of one loss in squared errors, in units of twice their variance."""
BACK_EMF_JUMP_COST = 40.0
"""The same for errors of the coil equation, which are coloured and not normal because of other effects."""
MAX_RESIDUAL_SHARE = 0.7
"""Largest remaining share of the squared error with which a loss is accepted."""
MIN_CORRELATION = 0.5
"""Least correlation of successive differences of position that counts as motion rather than noise."""
SETTLING = 600
"""Samples excluded at the start, in which the probe moves to its equilibrium and a slow command moves it fast."""
MAX_CONSTANT_LAG = 4
"""Constant lead or lag of the position that is allowed, samples."""
SEGMENT = 1000
"""Samples from which the coil's parameters are first estimated: the best fitting ones, probably without a loss."""
SMOOTHING_WINDOW = 201
"""Window over which errors of the coil's equation are averaged to remove drift, samples."""
MAX_COST = 8.0
"""Bound of a squared error in units of twice the variance: four standard deviations."""


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _path(errors, jump_cost):  # type: ignore[no-untyped-def]
    """Return the lag at each sample with the least total cost, shape (n,), from costs of shape (n, lags) (Viterbi
    1967).
    """
    size, lags = errors.shape
    came = np.empty((size, lags), np.int16)
    total = errors[0].copy()
    for n in range(1, size):
        best = 0
        least = total[0]
        for k in range(lags):
            here = total[k]
            if here <= least + jump_cost:
                came[n, k] = k
            else:
                came[n, k] = best
                total[k] = least + jump_cost
            if here < least:
                least, best = here, k
            total[k] += errors[n, k]
    path = np.empty(size, np.int64)
    path[-1] = np.argmin(total)
    for n in range(size - 1, 0, -1):
        path[n - 1] = came[n, path[n]]
    return path


def losses_in_record(command: FloatArray, voltage: FloatArray) -> list[tuple[int, int]]:
    """Return the losses of a whole record as ``(first sample after the loss, lost samples)``.

    The recorded voltage is compared with the command at any gain, offset and constant delay. A constant command shows
    no losses.
    """
    received = np.isfinite(voltage)
    if not np.isfinite(command).all() or received.sum() < SEGMENT:
        return []
    if np.std(voltage[received]) < 1e-3 or np.std(command) < 1e-3:
        return []
    lags = _lags(voltage)
    shifted = _shifted(command, lags)
    rows = np.arange(command.size)
    candidates: list[tuple[float, IntArray]] = []
    before = np.inf
    # With a slow command, losses and gain can only be estimated together: one search starts with the loss spread over
    # the test.
    for end in {0, _missing(voltage)}:
        path = np.linspace(0.0, end, command.size).astype(np.int64)
        for _ in range(6):
            gain, offset = _line(shifted[rows, path - lags[0]], voltage)
            residuals = voltage[:, None] - gain * shifted - offset
            before = min(before, float(np.nanmin(np.nanmean(residuals**2, axis=0))))
            path = _min_cost_path(_costs(residuals), lags, JUMP_COST)
        candidates.append((float(np.nanmean(residuals[rows, path - lags[0]] ** 2)), path))
    after, path = min(candidates, key=lambda candidate: candidate[0])
    missing = _missing(voltage)
    if missing:
        # No more was lost than is missing at the end. Without this bound a slow rise at the start can look early.
        path = np.maximum(path, path[-1] - missing)
    losses = [*_loss_before_motion(path, command), *_lag_changes(path)]
    # Late losses concern few samples; what is missing at the end shows them as well.
    as_missing = sum(lost for _, lost in losses) == missing > 0
    return losses if as_missing or after < MAX_RESIDUAL_SHARE * before else []


def losses_in_position(
    voltage: FloatArray, current: FloatArray, position: FloatArray, motion: FloatArray | None = None
) -> list[tuple[int, int]]:
    """Return losses of the position only, relative to the electrical record, by the back-EMF.

    Over the hold of one sample, ``u = R i + L' di + k dx + e`` with the differences of readings at its ends. A
    prediction of the position without losses (``motion``) is compared with the readings as well.
    """
    missing = _missing(position)
    # Samples missing at the end were lost earlier; a filter or a clock shifts a position by little.
    lags = np.arange(-MAX_CONSTANT_LAG, missing + MAX_CONSTANT_LAG + 1) if 0 < missing <= MAX_LOST else _lags(position)
    gained = np.diff(position, prepend=position[0])
    moves = _is_motion(gained) and int(np.isfinite(voltage + current).sum()) >= SEGMENT
    if motion is None:
        return _lag_changes(_by_back_emf(voltage, current, gained, lags, 0.0)) if moves else []
    costs = _costs(position[:, None] - _shifted(motion, lags))
    return _lag_changes(
        _by_back_emf(voltage, current, gained, lags, costs)
        if moves
        else _min_cost_path(costs, lags, BACK_EMF_JUMP_COST)
    )


def _by_back_emf(
    voltage: FloatArray, current: FloatArray, gained: FloatArray, lags: IntArray, added_costs: FloatArray | float
) -> IntArray:
    """Return the lag at each sample from the coil's equation and additional costs."""
    received = np.isfinite(voltage + current)
    # Neighbouring differences are included, so that a filter or a constant delay of the sensor is not a loss.
    moved = np.stack([np.roll(gained, -1), gained, np.roll(gained, 1)], axis=1)
    filled = np.where(received, current, 0.0)
    columns = np.stack([filled, np.diff(filled, prepend=filled[0]), np.ones(current.size)], axis=1)
    rows = np.arange(gained.size)
    path = np.zeros(gained.size, np.int64)
    whole = (rows >= SETTLING) & np.isfinite(moved).all(axis=1)
    starts = range(SETTLING, rows.size, SEGMENT // 2)
    stretches = [whole & (rows >= start) & (rows < start + SEGMENT) for start in starts]
    for turn in range(4):
        index = np.clip(rows + path, 0, gained.size - 1)
        parts = stretches if turn == 0 else [whole]
        fits = [_coil_equation(columns[index], moved, voltage[index], part & received[index]) for part in parts]
        weights = min(fits, key=lambda fit: fit[0])[1]
        opposing = np.where(received, voltage - columns @ weights[:3], np.nan)
        residuals = _high_passed(_shifted(opposing, lags)) - _high_passed(moved @ weights[3:])[:, None]
        residuals[:SETTLING] = np.nan
        path = _min_cost_path(_costs(residuals) + added_costs, lags, BACK_EMF_JUMP_COST)
    return path


def _coil_equation(
    columns: FloatArray, moved: FloatArray, voltage: FloatArray, usable: NDArray[np.bool_]
) -> tuple[float, FloatArray]:
    """Return the errors' variance relative to the back-EMF, and weights of current, its change, 1 and motion."""
    if usable.sum() < SEGMENT // 4:
        return np.inf, np.zeros(columns.shape[1] + moved.shape[1])
    both = np.concatenate((columns, moved), axis=1)[usable]
    weights: FloatArray = np.linalg.lstsq(both, voltage[usable], rcond=None)[0].astype(np.float64)
    back_emf = float(np.var(moved[usable] @ weights[columns.shape[1] :]))
    return float(np.var(voltage[usable] - both @ weights)) / max(back_emf, 1e-12), weights


def _is_motion(gained: FloatArray) -> bool:
    """Return whether differences of position are correlated, as in motion, or not, as in noise."""
    fast = _high_passed(gained)[SETTLING:]
    before, after = fast[:-1], fast[1:]
    received = np.isfinite(before + after)
    if received.sum() < SEGMENT or np.std(before[received]) < 1e-8:
        return False
    return float(np.corrcoef(before[received], after[received])[0, 1]) > MIN_CORRELATION


def _high_passed(values: FloatArray) -> FloatArray:
    """Subtract the moving mean over ``SMOOTHING_WINDOW`` samples along the first axis."""
    slow: FloatArray = uniform_filter1d(np.where(np.isfinite(values), values, 0.0), SMOOTHING_WINDOW, axis=0)
    return values - slow


def _missing(record: FloatArray) -> int:
    """Return the number of samples missing at the end: the number that was lost."""
    return int(np.argmax(np.isfinite(record[::-1]))) if np.isfinite(record).any() else 0


def _lags(record: FloatArray) -> IntArray:
    """Return the lags to search: the number of missing samples and a few more."""
    most = min(max(40, _missing(record) + 20), MAX_LOST, record.size // 4)
    return np.arange(-most // 2, most + 1)


def _shifted(values: FloatArray, lags: IntArray) -> FloatArray:
    """Return values shifted ahead by each lag, shape (n, lags); the ends are held."""
    index = np.arange(values.size)[:, None] + lags
    shifted: FloatArray = values[np.clip(index, 0, values.size - 1)]
    return shifted


def _line(x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Return gain and offset of y against x by robust regression."""
    received = np.isfinite(y)
    weight = np.ones(int(received.sum()))
    gain, offset = 1.0, 0.0
    for _ in range(5):
        gain, offset = np.polyfit(x[received], y[received], 1, w=np.sqrt(weight))
        residual = y[received] - gain * x[received] - offset
        spread = max(float(np.median(np.abs(residual))), 1e-6)
        weight = 1.0 / (1.0 + (residual / (3.0 * spread)) ** 2)
    return float(gain), float(offset)


def _min_cost_path(costs: FloatArray, lags: IntArray, jump_cost: float) -> IntArray:
    """Return the lag at each sample from the costs of each lag, shape (n, lags)."""
    path: IntArray = _path(costs, jump_cost) + lags[0]
    return path


def _costs(residuals: FloatArray) -> FloatArray:
    """Return the cost of each lag from its errors, shape (n, lags); 0 where not received."""
    received = np.isfinite(residuals)
    squares = np.where(received, residuals, 0.0) ** 2
    # The noise is estimated at the best constant lag over short blocks: losses inside some of them do not matter.
    stretch = 64
    whole = squares[: squares.shape[0] // stretch * stretch].reshape(-1, stretch, residuals.shape[1]).mean(axis=1)
    variance = max(float(np.median(whole.min(axis=1))), 1e-18)
    costs: FloatArray = np.minimum(squares / (2.0 * variance), MAX_COST)
    return costs


def _lag_changes(path: IntArray) -> list[tuple[int, int]]:
    """Return the changes of a path of lags. Its first lag is a constant delay and not a loss."""
    at = np.flatnonzero(np.diff(path)) + 1
    return [(int(n), int(path[n] - path[n - 1])) for n in at]


def _loss_before_motion(path: IntArray, command: FloatArray) -> list[tuple[int, int]]:
    """Return losses while the command was constant as one loss in the middle of that time."""
    moved = np.flatnonzero(command != command[0])
    still = int(moved[0]) if moved.size else 0
    return [(max(still // 2, 1), int(path[0]))] if path[0] > 0 else []


def losses_as_parameters(slips: list[tuple[int, int]], places: int) -> Mapping[str, float]:
    """Return losses by parameter name: the largest where there are too many; unused places get no sample."""
    kept = sorted(sorted(slips, key=lambda slip: -abs(slip[1]))[:places])
    parameters: dict[str, float] = {}
    for k in range(places):
        sample, lost = kept[k] if k < len(kept) else (0, 0)
        parameters[f"slip_{k + 1}_sample"], parameters[f"slip_{k + 1}_lost"] = float(sample), float(lost)
    return parameters


PLACES = 24
"""Most losses in a test."""


def recording(readings: Readings, values: FloatArray) -> Readings:
    """Shift all channels, or only the position, after each loss; hold the last value.

    Losses are rounded to whole samples; they are not fitted by derivatives.
    """
    size = readings.position.size
    at, lost = values[1::2], np.round(values[2::2])
    number = np.arange(size)
    ahead = ((number[:, None] >= at) * lost).sum(axis=1).astype(np.int64)
    index = np.clip(number + ahead, 0, size - 1)
    position = readings.position[index]
    if values[0] >= 0.5:
        return replace(readings, position=position)
    return replace(readings, position=position, voltage=readings.voltage[index], current=readings.current[index])


def estimate_from_record(signals: Mapping[str, FloatArray], sample_rate_hz: float) -> Mapping[str, float]:
    """Return losses of the whole record from the voltage, or else of the position from back-EMF and prediction."""
    slips = losses_in_record(signals["command"], signals["voltage"])
    alone = not slips
    if alone:
        motion = signals.get("predicted_position")
        slips = losses_in_position(signals["voltage"], signals["current"], signals["position"], motion)
    return {"position_alone": float(alone and bool(slips)), **losses_as_parameters(slips, PLACES)}


EFFECT = Effect(
    name="dropped_samples",
    stage="sensing",
    acts_on=ActsOn.LINK,
    title="Samples lost without notice",
    equation="y(n) = x(n + sum of lost(k) over slips k with sample(k) <= n); vanishes with every lost(k) = 0",
    signature="after certain samples, voltage, current and position are all early against the command by whole samples,"
    " at other places in every test; or only the position is early against the current's back-EMF",
    source="Viterbi, IEEE Trans. Information Theory 13 (1967) 260-269 (the path of lags)",
    parameters=(
        Parameter(
            "position_alone",
            "1",
            None,
            0.0,
            1.0,
            per_test=True,
            fixed=True,
            meaning="1: only the position loses samples",
        ),
        *(
            parameter
            for k in range(1, PLACES + 1)
            for parameter in (
                Parameter(
                    f"slip_{k}_sample", "1", None, 0.0, 1e7, per_test=True, fixed=True, meaning="first sample after it"
                ),
                Parameter(f"slip_{k}_lost", "1", 0.0, -200.0, 200.0, per_test=True, fixed=True, meaning="lost samples"),
            )
        ),
    ),
    starts=((0.0,) * (1 + 2 * PLACES),),
    mistaken_for=("clock_skew", "latency", "sensor_lag"),
    recording=recording,
    needs=frozenset({"command", "voltage", "current", "position"}),
    estimate_from_record=estimate_from_record,
    re_estimate=True,
    jointly=True,
    remedy="Check the link's counters and cable; record with sample numbers.",
)
