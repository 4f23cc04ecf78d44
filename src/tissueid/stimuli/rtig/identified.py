"""Mass, damping and stiffness by depth from online adaptive least squares (Chen 2010, 6.3.2 and Fig. 6.12).

Adaptation converges quickly only for a white input, and the input is white up to the cutoff of its stochastic part.
Force and depth are therefore averaged to about twice that rate, and the slow sweep is removed from both by the same
high-pass. Each depth level has its own impulse response, adapted while the depth is in that level: a single response
would lag the depth by its adaptation time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import signal, special

from tissueid.identification import adaptive_least_squares as adaptation
from tissueid.identification.second_order import SecondOrder
from tissueid.language import marked
from tissueid.stimuli.base import BLOCK, Array
from tissueid.stimuli.rtig.static_map import DepthHistogram, StaticMap

LEVELS = 8
"""Number of depth levels."""
_HIGH_PASS_HZ = 10.0
"""Cutoff of the high-pass, Hz."""
_STEP = 0.5
"""Normalised step size of the adaptation, chosen so that it converges within a tenth of a second in a level."""

_FLOOR = 0.01
"""Regularisation of the normalised step, relative to the nominal energy of the stochastic part over the memory."""

_FREQUENCIES = 12
"""Number of frequencies for the second-order fit."""
_MIN_HZ, _MAX_NYQUIST_SHARE = 6.0, 0.5
"""Frequencies of the second-order fit: lowest, Hz, and highest, relative to the Nyquist frequency."""

_REFITS = 3
"""Iterations of the reweighted fit."""


class LocalIdentification:
    """Adaptive least-squares identification by depth level.

    Args:
        depth: depth range that is divided into levels, m.
        sample_rate: of the averages, Hz.
        memory: length of the impulse responses, s.
        amplitude: of the stochastic force, N.
    """

    def __init__(self, depth: tuple[float, float], sample_rate: float, memory: float, amplitude: float) -> None:
        self.bounds = np.linspace(depth[0], depth[1], LEVELS + 1)
        taps = max(8, round(memory * sample_rate))
        self.memory_s = taps / sample_rate
        floor = _FLOOR * taps * amplitude**2 / 3.0
        self._work, self._scalars = adaptation.start(taps, _STEP, floor, centred=False)
        self._responses = np.zeros((LEVELS, taps))
        self.updates = np.zeros(LEVELS)
        self._depths = np.zeros(LEVELS)
        self._fitted: list[SecondOrder | None] = [None] * LEVELS
        self._stale = np.zeros(LEVELS, dtype=bool)
        self._slow = signal.butter(1, min(_HIGH_PASS_HZ, sample_rate / 8.0), "highpass", fs=sample_rate)
        self._slow_state: Array | None = None
        self._last = np.full(2, np.nan)
        frequency = np.geomspace(min(_MIN_HZ, sample_rate / 16.0), _MAX_NYQUIST_SHARE * 0.5 * sample_rate, _FREQUENCIES)
        self._s = 2j * np.pi * frequency
        self._transform = np.exp(-np.outer(self._s / sample_rate, np.arange(taps)))
        self._edges = np.zeros(0)
        self._sums = np.zeros((1, taps))
        self._counts = np.zeros((1, 2))
        self._adapt(0, np.zeros((2, 0)), np.zeros(0))  # compiles before the test

    def learn(self, force: Array, depth: Array) -> None:
        """Update from averages of force (n,), N, and depth (n,), m, NaN where a sample was lost."""
        signals = np.stack([force, depth])
        lost = ~np.isfinite(signals).all(axis=0)
        for n in np.flatnonzero(lost):  # hold the last value for the high-pass; excluded from adaptation
            signals[:, n] = signals[:, n - 1] if n else self._last
        if force.size == 0 or not np.isfinite(signals).all():
            return
        self._last = signals[:, -1].copy()
        if self._slow_state is None:
            self._slow_state = np.outer(signals[:, 0], signal.lfilter_zi(*self._slow))
        fast, self._slow_state = signal.lfilter(*self._slow, signals, axis=1, zi=self._slow_state)
        fast[:, lost] = np.nan
        outside = (signals[1] < self.bounds[0]) | (signals[1] > self.bounds[-1])
        fast[1, outside] = np.nan
        level = self._level(signals[1])
        for piece in np.split(np.arange(force.size), np.flatnonzero(np.diff(level)) + 1):
            self._adapt(int(level[piece[0]]), fast[:, piece], signals[1, piece])

    def _level(self, depth: Array) -> NDArray[np.int64]:
        """Return the levels of depths (n,), m; the outermost level for depths outside the range."""
        share = (depth - self.bounds[0]) / (self.bounds[1] - self.bounds[0])
        return np.asarray(np.clip(np.floor(share), 0, LEVELS - 1), dtype=np.int64)

    def _adapt(self, level: int, fast: Array, depth: Array) -> None:
        """Adapt the response of a level to force and depth, fast (2, n), at depths (n,), m."""
        if self.updates[level] == 0.0 and self.updates.any():
            updated = np.flatnonzero(self.updates)
            self._responses[level] = self._responses[updated[np.argmin(np.abs(updated - level))]]
        self._work[adaptation.RESPONSE] = self._responses[level]
        errors = np.empty(depth.size)
        force, moved = np.ascontiguousarray(fast)
        adaptation.advance(self._work, self._scalars, self._sums, self._counts, self._edges, force, moved, errors)
        learnt = np.isfinite(errors)
        if learnt.any():
            self._responses[level] = self._work[adaptation.RESPONSE]
            self.updates[level] += np.count_nonzero(learnt)
            self._depths[level] += float(depth[learnt].sum())
            self._stale[level] = True

    @property
    def diverged(self) -> bool:
        """Whether the adaptation diverged."""
        return bool(self._scalars[adaptation.DIVERGED])

    def system(self, level: int) -> SecondOrder | None:
        """Return the current second-order system of a level; None before a physical one was fitted."""
        if self.diverged or self.updates[level] < self._responses.shape[1]:
            return None
        if self._stale[level]:
            self._fitted[level] = self._fit(self._responses[level])
            self._stale[level] = False
        return self._fitted[level]

    def depth(self, level: int) -> float | None:
        """Return the mean depth, m, of the samples of a level; None without samples."""
        return float(self._depths[level] / self.updates[level]) if self.updates[level] else None

    def at(self, depth: float) -> SecondOrder | None:
        """Return the second-order system of the level at a depth, m."""
        return self.system(int(self._level(np.array([depth]))[0]))

    def _fit(self, response: Array) -> SecondOrder | None:
        """Fit 1 / H = K + B s + M s^2 by least squares, weighted for equal errors of H (Sanathanan and
        Koerner 1963).
        """
        measured = self._transform @ response
        weight = np.ones(measured.size)
        powers = np.stack([np.ones_like(self._s), self._s, self._s**2], axis=1)
        scale = np.abs(powers[-1]).max() ** (np.arange(3) / 2.0)
        coefficients = np.zeros(3)
        for _ in range(_REFITS):
            rows = (weight * measured)[:, None] * powers / scale
            stacked = np.concatenate([rows.real, rows.imag])
            asked = np.concatenate([weight, np.zeros(weight.size)])
            coefficients = np.linalg.lstsq(stacked, asked, rcond=None)[0] / scale
            denominator = np.abs(powers @ coefficients)
            if not (np.isfinite(denominator).all() and denominator.min() > 0.0):
                return None
            weight = 1.0 / denominator
        stiffness, damping, mass = coefficients.tolist()
        if not (stiffness > 0.0 and damping > 0.0 and mass > 0.0 and math.isfinite(stiffness + damping + mass)):
            return None
        return SecondOrder(mass=mass, damping=damping, stiffness=stiffness)


_MIN_MISSING_SHARE = 0.2
"""Minimum share of the mean missing samples per bin for which a sweep extends to a bin at the end of the range."""

_MIN_DWELL, _MAX_DWELL = 0.35, 2.5
"""Shortest and longest dwell time in a bin, relative to an even sweep: limits the speed and avoids plateaus."""

_CROSSING_DWELL = 0.2
"""Time to cross a bin with a desired share of zero, relative to an even sweep of a uniform distribution."""

_MAX_REVERSALS = 8
"""Maximum number of turns in one block; ends the loop when the range is almost empty."""


class TargetSweep:
    """Generator of target depths. ``edges`` (bins + 1,), m; ``traverse``: samples in one even sweep."""

    def __init__(self, edges: Array, shares: Array, traverse: float) -> None:
        self._edges = edges
        self._shares = shares
        self._traverse = traverse
        self.depth = float(edges[0])
        self.rising = True

    def advance(self, want: Array, remaining: int, limits: tuple[float, float], n: int) -> Array:
        """Return the next n target depths (n,), m.

        Args:
            want: samples missing in each bin, (bins,), before this block.
            remaining: samples until the end of the test.
            limits: lowest and highest target depth, m.
            n: number of samples.
        """
        path = np.empty(n)
        done = 0
        asked = np.flatnonzero(want >= _MIN_MISSING_SHARE * want.sum() / want.size)
        low, high = limits
        if asked.size:
            low = max(low, float(self._edges[asked[0]]))
            high = max(low, min(high, float(self._edges[asked[-1] + 1])))
        self.depth = float(np.clip(self.depth, low, high))
        for _ in range(_MAX_REVERSALS):
            times, depths = self._plan_sweep(want, remaining - done, low, high)
            ask = np.arange(1, n - done + 1, dtype=np.float64)
            inside = ask <= times[-1]
            count = int(np.count_nonzero(inside))
            path[done : done + count] = np.interp(ask[:count], times, depths)
            done += count
            if done == n:
                self.depth = float(path[-1])
                return path
            self.depth = float(depths[-1])
            self.rising = not self.rising
        path[done:] = self.depth
        return path

    def _plan_sweep(self, want: Array, remaining: int, low: float, high: float) -> tuple[Array, Array]:
        """Return the rest of the current sweep: times in samples from now, and depths, m."""
        edges = self._edges
        if self.rising:
            depths = np.concatenate([[self.depth], edges[(edges > self.depth) & (edges < high)], [high]])
        else:
            depths = np.concatenate([[self.depth], edges[(edges < self.depth) & (edges > low)][::-1], [low]])
        middles = 0.5 * (depths[1:] + depths[:-1])
        widths = np.abs(np.diff(depths)) / (edges[1] - edges[0])
        bins = np.clip(np.searchsorted(edges, middles, side="right") - 1, 0, want.size - 1)
        even = self._traverse * self._shares
        ahead = float(np.sum(widths * even[bins]))
        after = max(0.0, np.round((remaining - ahead) / self._traverse))
        usual = np.maximum(even, _CROSSING_DWELL * self._traverse / want.size)
        dwell = np.clip(want / (after + 1.0), _MIN_DWELL * usual, _MAX_DWELL * usual)
        return np.concatenate([[0.0], np.cumsum(widths * dwell[bins])]), depths


SCATTER_LEVELS = 6
"""Depth levels of the scatter statistics."""
_ITERATIONS = 12
"""Iterations of the multiplicative update in :meth:`Scatter.targets`."""
_WEIGHT = 100.0
"""Weight of the initial scatter estimate, samples."""


class Scatter:
    """Mean and standard deviation of depth minus target, by level of the target; ``edges`` (bins + 1,), m."""

    def __init__(self, edges: Array, forget: float) -> None:
        self._edges = edges
        self._centres = 0.5 * (edges[1:] + edges[:-1])
        self._keep = 1.0 - forget
        span = float(edges[-1] - edges[0])
        self._bounds = np.linspace(edges[0], edges[-1], SCATTER_LEVELS + 1)[1:-1]
        self._middles = edges[0] + span * (np.arange(SCATTER_LEVELS) + 0.5) / SCATTER_LEVELS
        self._sums = np.zeros((3, SCATTER_LEVELS))  # samples, distances, squares
        self._sums[0] = _WEIGHT
        self._sums[2] = _WEIGHT * (0.05 * span) ** 2
        self._least = 0.25 * float(edges[1] - edges[0])

    def learn(self, target: Array, away: Array) -> None:
        """Update from targets (n,), m, and deviations of the depth from them (n,), m; no NaN."""
        level = np.searchsorted(self._bounds, target)
        new = np.stack([np.bincount(level, weight, SCATTER_LEVELS) for weight in (np.ones(away.size), away, away**2)])
        self._sums = self._keep ** new[0] * self._sums + new

    @property
    def bias(self) -> Array:
        """Mean deviation by level, m, (LEVELS,)."""
        return np.asarray(self._sums[1] / self._sums[0])

    @property
    def spread(self) -> Array:
        """Standard deviation of the deviation by level, m, (LEVELS,)."""
        return np.asarray(np.sqrt(np.maximum(self._sums[2] / self._sums[0] - self.bias**2, 0.0)))

    def targets(self, want: Array, remaining: int) -> Array:
        """Return the time at targets in each bin, (bins,), in samples that sum to ``remaining``.

        Richardson-Lucy deconvolution of ``want`` (bins,), the samples missing by depth, with the scatter; negative
        entries count as zero.
        """
        wanted = np.maximum(want, 0.0)
        wanted *= remaining / max(float(wanted.sum()), 1e-9)
        spread = np.maximum(np.interp(self._centres, self._middles, self.spread), self._least)
        mean = self._centres + np.interp(self._centres, self._middles, self.bias)
        below = special.ndtr((self._edges - mean[:, None]) / spread[:, None])  # (targets, edges)
        below[:, 0], below[:, -1] = 0.0, 1.0  # samples outside the range count for the outermost bins
        chance = np.diff(below, axis=1)
        time = np.full(wanted.size, remaining / wanted.size)
        for _ in range(_ITERATIONS):
            time *= chance @ (wanted / np.maximum(time @ chance, 1e-9 * remaining))
        return np.asarray(time * (remaining / max(float(time.sum()), 1e-9)))


_CORRECTION = 0.1
"""Share of the mean deviation that a block corrects; twice this value oscillates with a delay of four blocks."""

_FADE = 0.97
"""Decay of the correction from block to block."""
_MAX_CORRECTION = 0.25
"""Maximum correction, relative to the depth range."""

_STIFFNESS_LIMITS = (0.5, 2.0)
"""Accepted local stiffness, relative to the local slope of the static force."""

_SCATTER_S = 2.0
"""Time constant of the scatter statistics, s."""
_MIN_STOCHASTIC = 0.25
"""Minimum share of the stochastic part."""
_MAX_SCATTER = 0.06
"""Standard deviation of the depth, relative to its range, above which the stochastic part is attenuated."""


class IdentifiedController:
    """Controller of the offsets and of the amplitude of the stochastic part, block by block.

    ``density`` is the two-sided power density of the full stochastic part, N^2 s.
    """

    def __init__(
        self,
        histogram: DepthHistogram,
        static: StaticMap,
        local: LocalIdentification,
        sweep: TargetSweep,
        force: tuple[float, float],
        sample_rate: float,
        density: float,
    ) -> None:
        self._histogram = histogram
        self._static = static
        self._local = local
        self._sweep = sweep
        self._force = force
        self._rate = sample_rate
        self._density = density
        self._last_share = 1.0
        self._span = float(histogram.edges[-1] - histogram.edges[0])
        self._scatter = Scatter(histogram.edges, 1.0 / (_SCATTER_S * sample_rate))
        self._targets = np.full(histogram.samples + BLOCK, np.nan)
        self._correction = 0.0
        self._begun = False
        self.reachable = (float(histogram.edges[0]), float(histogram.edges[-1]))

    def learn(self, depth: Array, first: int) -> None:
        """Process depths (n,), m, NaN where a sample was lost, from sample index ``first`` of the test on."""
        target = self._targets[first : first + depth.size]
        depth = depth[: target.size]
        valid = np.isfinite(target) & np.isfinite(depth)
        if not valid.any():
            return
        away = depth[valid] - target[valid]
        self._scatter.learn(target[valid], away)
        share = _CORRECTION * away.size / BLOCK
        most = _MAX_CORRECTION * self._span
        self._correction = float(np.clip(_FADE * self._correction - share * away.mean(), -most, most))

    def offset(self, made: int, depth: float) -> tuple[Array, Array]:
        """Return the next offsets, N, (BLOCK,), and the share of the stochastic part to add, (BLOCK,).

        ``made`` is the number of samples generated before; ``depth``, m, is the starting depth when there was no
        target.
        """
        histogram, edges, static = self._histogram, self._histogram.edges, self._static
        if not self._begun:
            self._sweep.depth = float(np.clip(depth, edges[0], edges[-1]))
            self._begun = True
        ahead = self._targets[histogram.seen : made]
        low = max(float(edges[0]), min(static.depth(self._force[0]), float(edges[-1])))
        self.reachable = (low, max(low, min(float(edges[-1]), static.depth(self._force[1]))))
        remaining = max(BLOCK, histogram.samples - made)
        want = histogram.missing_samples(ahead[np.isfinite(ahead)], remaining, self.reachable)
        before = self._sweep.depth
        path = self._sweep.advance(self._scatter.targets(want, remaining), remaining, self.reachable, BLOCK)
        self._targets[made : made + BLOCK] = path[: max(0, self._targets.size - made)]
        speed = np.diff(path, prepend=before) * self._rate
        offset = static.force(path) + static.damping(path) * speed + self._gain(float(path.mean())) * self._correction
        return offset, self._stochastic_share(float(path.mean()))

    def reset(self) -> None:
        """Reset the path and the correction while another controller generates the blocks."""
        self._begun = False
        self._correction = 0.0

    def _gain(self, depth: float) -> float:
        """Return the stiffness at a depth, N/m: the identified one, limited to ``_STIFFNESS_LIMITS`` times the static
        slope.
        """
        slope = float(self._static.slope(np.array([depth]))[0])
        system = self._local.at(depth)
        return (
            slope
            if system is None
            else float(np.clip(system.stiffness, _STIFFNESS_LIMITS[0] * slope, _STIFFNESS_LIMITS[1] * slope))
        )

    def _stochastic_share(self, depth: float) -> Array:
        """Return the share of the stochastic part, (BLOCK,): reduced where it would scatter the depth too much.

        A force of two-sided power density S gives the depth of a second-order system the variance S / (2 B K).
        """
        system = self._local.at(depth)
        goal = 1.0
        if system is not None and self._density > 0.0:
            scatter = float(np.sqrt(self._density / (2.0 * system.damping * system.stiffness)))
            goal = float(np.clip(_MAX_SCATTER * self._span / scatter, _MIN_STOCHASTIC, 1.0))
        before, self._last_share = self._last_share, goal
        return before + (goal - before) * np.arange(1, BLOCK + 1) / BLOCK


_MIN_RECEIVED_SHARE = 0.6
"""Minimum share of received samples in an average."""


@dataclass(frozen=True)
class States:
    """Averages over ``every`` samples: force, N, depth, m, and its time derivatives; each (n,), NaN where unknown.

    Speed and acceleration are central differences, so a state lags the newest average by one.
    """

    force: Array
    depth: Array
    speed: Array
    acceleration: Array


class Averages:
    """Average samples in groups of ``every``, independently of how the input is split into calls."""

    def __init__(self, every: int, sample_rate: float) -> None:
        self._every = every
        self._step = every / sample_rate
        self._left = np.empty((2, 0))
        self._last = np.full((2, 2), np.nan)

    def take(self, force: Array, depth: Array) -> States:
        """Process force (k,), N, and depth (k,), m, NaN where a sample was lost; return the new states."""
        signals = np.concatenate([self._left, [force, depth]], axis=1)
        whole = signals.shape[1] // self._every
        cut = whole * self._every
        self._left = signals[:, cut:]
        parts = signals[:, :cut].reshape(2, whole, self._every)
        received = np.isfinite(parts[0])
        enough = received.sum(axis=1) >= _MIN_RECEIVED_SHARE * self._every
        share = received / np.maximum(received.sum(axis=1, keepdims=True), 1)
        averages = np.where(enough, (np.where(received, parts, 0.0) * share).sum(axis=2), np.nan)
        course = np.concatenate([self._last, averages], axis=1)  # (2, 2 + whole)
        self._last = course[:, -2:]
        depth = course[1]
        return States(
            force=course[0, 1:-1],
            depth=depth[1:-1],
            speed=(depth[2:] - depth[:-2]) / (2.0 * self._step),
            acceleration=(depth[2:] - 2.0 * depth[1:-1] + depth[:-2]) / self._step**2,
        )


_JUDGING_TIME_S = 0.5
"""Time constant, s, of the average by which the force prediction is judged."""

_REJECT_SHARE, _ACCEPT_SHARE = 0.4, 0.25
"""Unpredicted share of the force variance above which control by the model stops, and below which it resumes."""

_FAST_FORGETTING = 8.0
"""Factor on the forgetting rate while the model does not predict the force."""

_INITIAL_STD = 0.1
"""Standard deviation of the force assumed at the start, relative to the force range."""

_MIN_STD = 0.02
"""Standard deviation of the force, relative to its range, added so that a constant force is not judged."""


class OnlineIdentification:
    """Static force, local second-order parameters, and the controller that uses them."""

    def __init__(
        self,
        averages: Averages,
        static: StaticMap,
        local: LocalIdentification,
        controller: IdentifiedController,
        force_span: float,
        averages_rate: float,
    ) -> None:
        self.static = static
        self.local = local
        self.controller = controller
        self._averages = averages
        self._keep = 1.0 - 1.0 / (_JUDGING_TIME_S * averages_rate)
        self._least = (_MIN_STD * force_span) ** 2
        credit = _JUDGING_TIME_S * averages_rate
        # Exponentially weighted sums: samples, forces, squared forces, squared errors; initialised as for a good model.
        self._sums = np.array([credit, 0.0, credit * (_INITIAL_STD * force_span) ** 2, 0.0])
        self.good = True
        self.rejections = 0

    def take(self, force: Array, depth: Array, first: int) -> None:
        """Process force (k,), N, and depth (k,), m, NaN where a sample was lost, from sample index ``first`` on."""
        states = self._averages.take(force, depth)
        self.local.learn(states.force, states.depth)
        valid = np.isfinite(states.acceleration) & np.isfinite(states.force)
        if valid.any():
            at = tuple(part[valid] for part in (states.force, states.depth, states.speed, states.acceleration))
            errors = self.static.learn(*at)
            if first >= 0:
                self._judge(at[0], errors)
        if first + depth.size > 0:
            self.controller.learn(depth[max(0, -first) :], max(0, first))

    def _judge(self, force: Array, errors: Array) -> None:
        new = np.array([force.size, force.sum(), force @ force, errors @ errors])
        self._sums = self._keep**force.size * self._sums + new
        samples, forces, squares, missed = self._sums.tolist()
        varied = squares - forces**2 / samples + samples * self._least
        if self.good and missed > _REJECT_SHARE * varied:
            self.good = False
            self.rejections += 1
            self.static.forget(_FAST_FORGETTING)
        elif not self.good and missed < _ACCEPT_SHARE * varied:
            self.good = True
            self.static.forget(1.0)

    @property
    def verdict(self) -> str:
        """Text on whether the identified model controlled the input."""
        if not self.good:
            return marked("model rejected: it did not predict the force; controlled without it")
        if self.local.diverged:
            return marked("good, but the local impulse responses diverged: no parameters by depth")
        return marked("good, rejected for part of the test") if self.rejections else marked("good")

    def report(self) -> dict[str, Any]:
        """Return the parameters by depth (Fig. 6.12) and the static force as plain values."""
        levels = []
        for level in range(self.local.updates.size):
            system, depth = self.local.system(level), self.local.depth(level)
            if system is not None and depth is not None:
                levels.append(
                    {
                        "depth_m": depth,
                        "mass_kg": system.mass,
                        "damping_n_s_per_m": system.damping,
                        "stiffness_n_per_m": system.stiffness,
                        "samples": int(self.local.updates[level]),
                        "settling_s": system.settling_time_s(),
                    }
                )
        return {
            "verdict": self.verdict,
            "memory_s": self.local.memory_s,
            "levels": levels,
            "static_force": {
                "depth_m": self.static.knots.tolist(),
                "force_n": self.static.force(self.static.knots).tolist(),
            },
        }
