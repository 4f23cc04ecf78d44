"""Breathing, pulse and tremor move the surface under the probe."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from scipy import optimize

from tissueid.twin import _estimates, bus
from tissueid.twin.effect import Effect, FloatArray, Parameter

BREATHING, PULSE, TREMOR = 0, 1, 2
SLOW = (BREATHING, PULSE)
ALL = (BREATHING, PULSE, TREMOR)
KINDS = ("breathing", "pulse", "tremor")
WAVES = ((1, 2, 3), (1, 2, 3, 4, 5), (1, 2, 3, 4, 5))
"""Harmonics of breathing and pulse; for tremor, lines on either side of the middle one."""
MIDDLE_LINE = 3

RATES = ("breathing_hz", "pulse_hz", "tremor_hz", "pulse_sway_cosine_rad", "pulse_sway_sine_rad", "tremor_spacing_hz")
RATE_BOUNDS = ((0.1, 0.5), (0.8, 2.0), (7.0, 13.0), (-1.5, 1.5), (-1.5, 1.5), (0.15, 0.8))
"""Bounds of the rates, Hz. Breathing modulates the pulse by at most a quarter of a beat."""
BEGINNING = (0.25, 1.2, 10.0, 0.0, 0.0, 0.4)
_FIRST_STEPS = (0.02, 0.02, 0.01, 0.3, 0.3, 0.1)
"""Steps of the search of the rates."""
_NEAR = (0.05, 0.15, 0.5, 3.0, 3.0, 0.8)
"""Largest difference of a test's rates from those of the session."""
_STEP_HZ = 0.04
"""Spacing of the grids of rates, Hz: a fifth of the resolution of a 4.5 s test."""
_LIKELY_SWAY_RAD = 0.4
_SPACINGS_HZ = (0.25, 0.4, 0.55)

MOST_M = (5e-3, 1e-3, 1e-3)
"""Bounds of the heights by kind, m; that of breathing holds for the mean as well."""
_ORDERS = (
    np.repeat(np.array(WAVES[BREATHING], np.float64), 2) ** 2,
    np.repeat(np.array(WAVES[PULSE], np.float64), 2),
    np.repeat(1.0 + 2.0 * np.abs(np.array(WAVES[TREMOR], np.float64) - MIDDLE_LINE), 2),
)
"""Growth of the ridge with the harmonic, which ties a rate to its lowest waves."""
LIKELY_M = (5e-4 / _ORDERS[BREATHING], 5e-5 / _ORDERS[PULSE], np.full(_ORDERS[TREMOR].size, 2e-5))
"""Standard deviations of the heights by wave, m."""
HEIGHTS = tuple(
    tuple(f"{name}_{part}_{wave}_m" for wave in waves for part in ("cosine", "sine"))
    for name, waves in zip(KINDS, WAVES, strict=True)
)
MEAN = "mean_m"
_NAMES = (*RATES, *(name for names in HEIGHTS for name in names), MEAN)
_MOST = np.array([*(most for most, names in zip(MOST_M, HEIGHTS, strict=True) for _ in names), MOST_M[BREATHING]])

_MEANS_HZ = 200.0
_SLOW_BLOCKS = 5
"""Number of means averaged in the search for breathing and pulse."""
_FEWEST = 40
"""Least number of means."""


def read(tests: Sequence[Mapping[str, FloatArray]], sample_rate_hz: float) -> Sequence[Mapping[str, float]]:
    """Return rates and heights by name within their bounds for each test; heights are 0 where there is too little data.

    The unexplained part of the position is used: a probe follows slow motion of the surface. Breathing and pulse
    overlap in a record of a few seconds and are searched together. Rates are searched in all tests together and then
    near the result in each test, with the modulation by breathing and the spacing of the lines of tremor.
    """
    swaying = [_Sway.of(signals, sample_rate_hz) for signals in tests]
    seen = [sway for sway in swaying if sway.enough]
    shared = _shared(seen) if seen else np.array(BEGINNING)
    return [sway.read(sway.own(shared) if sway.enough else shared) for sway in swaying]


def _shared(seen: Sequence[_Sway]) -> FloatArray:
    # Search grids in order: breathing with any pulse, the pulse with any modulation, and tremor in the residual.
    coarse = [sway.coarse() for sway in seen]
    breathing, pulse, tremor = (np.arange(*RATE_BOUNDS[kind], _STEP_HZ) for kind in ALL)
    rates: FloatArray = np.array(BEGINNING, np.float64)
    pairs = [np.r_[slow, fast, rates[2:]] for slow in breathing for fast in pulse]
    rates = max(pairs, key=lambda at: sum(sway.log_likelihood(at, SLOW) for sway in coarse))
    beats = [np.r_[rates[0], rate, rates[2:]] for rate in pulse]
    rates = max(beats, key=lambda at: sum(sway.log_likelihood(sway.swayed(at), SLOW) for sway in coarse))
    trembling = [sway.without(sway.swayed(rates), SLOW) for sway in coarse]
    tremors = [np.r_[rates[:2], rate, rates[3:]] for rate in tremor]
    return max(tremors, key=lambda at: sum(sway.log_likelihood(at, (TREMOR,)) for sway in trembling))


def _refined(about: FloatArray, places: Sequence[int], log_likelihood: Callable[[FloatArray], float]) -> FloatArray:
    # Rates at some places, improved by a local search.
    chosen = list(places)
    bounds = [
        (max(low, about[k] - near), min(high, about[k] + near))
        for k, (low, high), near in ((k, RATE_BOUNDS[k], _NEAR[k]) for k in chosen)
    ]
    steps = np.diag([_FIRST_STEPS[k] for k in chosen])
    simplex = about[chosen] + np.vstack((np.zeros(len(chosen)), steps))

    def at(values: FloatArray) -> FloatArray:
        moved = about.copy()
        moved[chosen] = values
        return moved

    optimum = optimize.minimize(
        lambda values: -log_likelihood(at(values)),
        about[chosen],
        method="Nelder-Mead",
        bounds=bounds,
        options={
            "initial_simplex": np.clip(simplex, *np.transpose(bounds)),
            "maxfev": 60 * len(chosen),
            "xatol": 1e-4,
            "fatol": 1e-3,
        },
    )
    return at(optimum.x)


@dataclass(frozen=True)
class _Sway:
    """The unexplained part of a position as means: shape (n,), m, around ``mean_m``, with their times, s."""

    residual: FloatArray
    time: FloatArray
    mean_m: float = 0.0

    @classmethod
    def of(cls, signals: Mapping[str, FloatArray], sample_rate_hz: float) -> _Sway:
        residual = _estimates.unexplained(signals, "position", sample_rate_hz)
        predicted = signals.get("predicted_position")
        difference = np.zeros(1) if predicted is None else (signals["position"] - predicted)[residual != 0.0]
        every = max(1, round(sample_rate_hz / _MEANS_HZ))
        blocks = residual[: residual.size // every * every].reshape(-1, every)
        received = (blocks != 0.0).any(axis=1)
        time = (np.flatnonzero(received) * every + 0.5 * (every + 1)) / sample_rate_hz
        mean = float(difference.mean()) if difference.size and np.isfinite(difference).all() else 0.0
        return cls(blocks.mean(axis=1)[received].astype(np.float64), time.astype(np.float64), mean)

    @property
    def enough(self) -> bool:
        """Return whether there is enough data."""
        return self.residual.size >= _FEWEST

    def coarse(self) -> _Sway:
        """Return the same data in fewer, longer means."""
        size = self.residual.size // _SLOW_BLOCKS * _SLOW_BLOCKS
        residual, time = (values[:size].reshape(-1, _SLOW_BLOCKS).mean(axis=1) for values in (self.residual, self.time))
        return replace(self, residual=residual, time=time)

    def own(self, shared: FloatArray) -> FloatArray:
        """Return the rates of this test, near those of the session."""
        coarse = self.coarse()
        rates = _refined(coarse.swayed(shared), (0, 1, 3, 4), lambda at: coarse.log_likelihood(at, SLOW))
        trembling = self.without(rates, SLOW)
        spaced = [np.r_[rates[:5], spacing] for spacing in _SPACINGS_HZ]
        rates = max(spaced, key=lambda at: trembling.log_likelihood(at, (TREMOR,)))
        return _refined(rates, (2, 5), lambda at: trembling.log_likelihood(at, (TREMOR,)))

    def swayed(self, rates: FloatArray) -> FloatArray:
        """Return the rates with the best modulation of the pulse, of none and eight phases."""
        turns = 0.25 * np.pi * np.arange(8)
        sways = _LIKELY_SWAY_RAD * np.stack((np.cos(turns), np.sin(turns)), axis=1)
        ways = [rates, *(np.r_[rates[:3], sway, rates[5:]] for sway in sways)]
        return max(ways, key=lambda at: self.log_likelihood(at, SLOW))

    def read(self, rates: FloatArray) -> Mapping[str, float]:
        """Return the rates, Hz, and heights, m, of breathing, pulse and tremor in the record, by parameter name."""
        values = np.zeros(_MOST.size)
        if self.enough:
            mean = self.mean_m + float(self.without(rates, ALL).residual.mean())
            values = np.append(self.fitted(rates, ALL)[1], mean)
        return dict(zip(_NAMES, [*rates.tolist(), *np.clip(values, -_MOST, _MOST).tolist()], strict=True))

    def fitted(self, rates: FloatArray, kinds: Sequence[int]) -> tuple[float, FloatArray]:
        """Return the squares explained by waves of some kinds, and the heights of the waves."""
        orders = np.concatenate([_ORDERS[kind] for kind in kinds])
        return _estimates.fitted(self.residual, self._columns(rates, kinds), orders)

    def log_likelihood(self, rates: FloatArray, kinds: Sequence[int]) -> float:
        """Return the log likelihood of rates, nats; quiet tests have the larger weight because less else is
        unexplained."""
        total = float(self.residual @ self.residual)
        taken = self.fitted(rates, kinds)[0]
        return -0.5 * self.residual.size * float(np.log(max(1.0 - taken / total, 1e-12))) if total > 0.0 else 0.0

    def without(self, rates: FloatArray, kinds: Sequence[int]) -> _Sway:
        """Return the residual of waves of some kinds."""
        return _Sway(self.residual - self._columns(rates, kinds) @ self.fitted(rates, kinds)[1], self.time)

    def _columns(self, rates: FloatArray, kinds: Sequence[int]) -> FloatArray:
        columns: FloatArray = _waves(self.time, rates, BREATHING in kinds, PULSE in kinds, TREMOR in kinds)
        return columns


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _waves(time: FloatArray, rates: FloatArray, breathing: bool, pulse: bool, tremor: bool) -> FloatArray:
    # Cosine and sine of each wave of the chosen kinds, shape (n, 2 waves), in the order of the heights. Harmonics count
    # from 1.
    slow, fast, lines = len(WAVES[0]), len(WAVES[1]), len(WAVES[2])
    columns = np.empty((time.size, 2 * (breathing * slow + pulse * fast + tremor * lines)))
    for k in range(time.size):
        breath = 2.0 * math.pi * rates[0] * time[k]
        column = 0
        if breathing:
            column = _harmonics(columns[k], column, breath, slow)
        if pulse:
            beat = 2.0 * math.pi * rates[1] * time[k] + rates[3] * math.cos(breath) + rates[4] * math.sin(breath)
            column = _harmonics(columns[k], column, beat, fast)
        if tremor:
            for line in range(1, lines + 1):
                hertz = rates[2] + rates[5] * (line - MIDDLE_LINE)
                column = _harmonics(columns[k], column, 2.0 * math.pi * hertz * time[k], 1)
    return columns


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _harmonics(row: FloatArray, column: int, angle: float, count: int) -> int:
    cosine, sine = math.cos(angle), math.sin(angle)
    real, imaginary = cosine, sine
    for _ in range(count):
        row[column], row[column + 1] = real, imaginary
        column += 2
        real, imaginary = real * cosine - imaginary * sine, imaginary * cosine + real * sine
    return column


_BREATHING = len(RATES)
"""Index of the first height of each kind among the parameters, and of the mean after them."""
_PULSE = _BREATHING + len(HEIGHTS[BREATHING])
_TREMOR = _PULSE + len(HEIGHTS[PULSE])
_MEAN = _TREMOR + len(HEIGHTS[TREMOR])
_TURNING = 16
"""State: whether the waves are initialised."""
_UNITS = ("Hz", "Hz", "Hz", "rad", "rad", "Hz")


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Move the surface by thirteen waves at the middle of the step; harmonics follow from the fundamental.

    ``s`` holds cosine and sine of each rate and of its change in a step, so that only the first step evaluates them.
    The pulse, which breathing modulates, is evaluated at every step. The velocity is the derivative of the waves and
    not a difference between steps, which would be an impact where a simulated instrument draws the next test.
    """
    if s[_TURNING] == 0.0:
        s[_TURNING] = 1.0
        for rate in range(4):
            hertz = p[rate] if rate < 3 else p[5]
            angle = 2.0 * math.pi * hertz * (b[bus.TIME] + 0.5 * dt)
            turn = 2.0 * math.pi * hertz * dt
            s[4 * rate], s[4 * rate + 1] = math.cos(angle), math.sin(angle)
            s[4 * rate + 2], s[4 * rate + 3] = math.cos(turn), math.sin(turn)
    moved, moving = 0.0, 0.0
    sway = p[3] * s[0] + p[4] * s[1]
    for kind, first, last in ((0, _BREATHING, _PULSE), (1, _PULSE, _TREMOR)):
        cosine, sine, speed = s[4 * kind], s[4 * kind + 1], p[kind]
        if kind == 1:
            forward, aside = math.cos(sway), math.sin(sway)
            cosine, sine = cosine * forward - sine * aside, sine * forward + cosine * aside
            speed += p[0] * (p[4] * s[0] - p[3] * s[1])
        real, imaginary, order = cosine, sine, 1.0
        for k in range(first, last, 2):
            moved += p[k] * real + p[k + 1] * imaginary
            moving += order * speed * (p[k + 1] * real - p[k] * imaginary)
            real, imaginary = real * cosine - imaginary * sine, imaginary * cosine + real * sine
            order += 1.0
    # Lines of tremor: the first two below the middle one, the last two above.
    cosine, sine = s[12], s[13]
    real, imaginary, speed = s[8], s[9], p[2] - 2.0 * p[5]
    for _ in range(2):
        real, imaginary = real * cosine + imaginary * sine, imaginary * cosine - real * sine
    for k in range(_TREMOR, _MEAN, 2):
        moved += p[k] * real + p[k + 1] * imaginary
        moving += speed * (p[k + 1] * real - p[k] * imaginary)
        real, imaginary = real * cosine - imaginary * sine, imaginary * cosine + real * sine
        speed += p[5]
    for rate in range(4):
        cosine, sine, turned, aside = s[4 * rate], s[4 * rate + 1], s[4 * rate + 2], s[4 * rate + 3]
        s[4 * rate] = cosine * turned - sine * aside
        s[4 * rate + 1] = sine * turned + cosine * aside
    b[bus.SURFACE_POSITION] += moved + p[_MEAN]
    b[bus.SURFACE_VELOCITY] += 2.0 * math.pi * moving


EFFECT = Effect(
    name="physiological_motion",
    stage="environment",
    title="Breathing, pulse or tremor moves the surface",
    equation="surface + m + sum of a cos(h x) + b sin(h x) over breathing (x = w t, h = 1 to 3), pulse (x = w t + "
    "c cos(breathing) + d sin(breathing), h = 1 to 5) and five lines of tremor side by side; vanishes with m and every "
    "a = b = 0",
    signature="position oscillates at 0.1 to 0.5, 0.8 to 2 or 8 to 12 Hz, in quiet tests as well and independent of the"
    " command, with different phases in every test; not on the spring",
    source="Fung, Biomechanics: Circulation (1997), ch. 3 (pulse); Hirsch & Bishop, Am. J. Physiol. 241 (1981) "
    "H620-H629 (breathing sways the pulse); Elble & Koller, Tremor (1990), ch. 2",
    parameters=(
        *(
            Parameter(name, unit, None, *bounds, per_test=True, fixed=True, meaning="estimated from the record")
            for name, unit, bounds in zip(RATES, _UNITS, RATE_BOUNDS, strict=True)
        ),
        *(
            Parameter(name, "m", 0.0, -most, most, per_test=True, prior=0.0, prior_std=std, meaning="surface motion")
            for names, likely, most in zip(HEIGHTS, LIKELY_M, MOST_M, strict=True)
            for name, std in zip(names, likely, strict=True)
        ),
        Parameter(
            MEAN,
            "m",
            0.0,
            -MOST_M[0],
            MOST_M[0],
            per_test=True,
            prior=0.0,
            prior_std=0.1 * MOST_M[0],
            meaning="mean height above the found surface",
        ),
    ),
    starts=(BEGINNING + (0.0,) * (_MEAN + 1 - _BREATHING),),
    mistaken_for=("preconditioning", "reflex", "mount_resonance", "mains_hum"),
    places=(bus.SURFACE,),
    hook=hook,
    needs=frozenset({"position"}),
    estimate_from_records=read,
    re_estimate=True,
    on_spring=False,
    at_rest=True,
    jointly=True,
    remedy="Ask the subject to hold the breath; support the limb; test longer or average over pulses.",
)
