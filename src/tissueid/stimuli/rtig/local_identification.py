"""Mass, damping and stiffness by depth from online adaptive least squares (Chen 2010, 6.3.2 and Fig. 6.12).

Adaptation converges quickly only for a white input, and the input is white up to the cutoff of its stochastic part.
Force and depth are therefore averaged to about twice that rate, and the slow sweep is removed from both by the same
high-pass. Each depth level has its own impulse response, adapted while the depth is in that level: a single response
would lag the depth by its adaptation time.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from tissueid.identification.online import adaptive_least_squares as adaptation
from tissueid.identification.second_order import SecondOrder
from tissueid.stimuli.base import Array

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
        place = (depth - self.bounds[0]) / (self.bounds[1] - self.bounds[0])
        return np.asarray(np.clip(np.floor(place), 0, LEVELS - 1), dtype=np.int64)

    def _adapt(self, level: int, fast: Array, depth: Array) -> None:
        """Adapt the response of a level to force and depth, fast (2, n), at depths (n,), m."""
        if self.updates[level] == 0.0 and self.updates.any():
            known = np.flatnonzero(self.updates)
            self._responses[level] = self._responses[known[np.argmin(np.abs(known - level))]]
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
        found = np.zeros(3)
        for _ in range(_REFITS):
            rows = (weight * measured)[:, None] * powers / scale
            stacked = np.concatenate([rows.real, rows.imag])
            asked = np.concatenate([weight, np.zeros(weight.size)])
            found = np.linalg.lstsq(stacked, asked, rcond=None)[0] / scale
            denominator = np.abs(powers @ found)
            if not (np.isfinite(denominator).all() and denominator.min() > 0.0):
                return None
            weight = 1.0 / denominator
        stiffness, damping, mass = found.tolist()
        if not (stiffness > 0.0 and damping > 0.0 and mass > 0.0 and math.isfinite(stiffness + damping + mass)):
            return None
        return SecondOrder(mass=mass, damping=damping, stiffness=stiffness)
